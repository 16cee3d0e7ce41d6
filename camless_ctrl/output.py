"""Output files and folders that appear whole or not at all, and are proven writable first."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


class OutputError(OSError):
    """A result cannot be written where it was asked for."""


@dataclass
class OutputFile:
    """A text file to be; `write` it inside the `reserved_file` block."""

    path: Path
    text: str | None = None

    def write(self, text: str) -> None:
        """Set the content; it reaches the disk when the block ends without an error."""
        self.text = text


@contextmanager
def reserved_file(path: Path | None) -> Iterator[OutputFile | None]:
    """Reserve a place for a text file before the work that fills it.

    A hidden temporary file is made beside `path` at once, so that a place that cannot be
    written is known before any work; it becomes `path` when the block ends, and vanishes
    when the block raises. None reserves nothing.

    Raises
    ------
    OutputError
        If the file cannot be made there; the message names path and remedy.
    """
    if path is None:
        yield None
        return
    path = Path(path)
    require_place(path)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise OutputError(_cannot_write(path.parent, error)) from error
    os.close(handle)
    try:
        output = OutputFile(path)
        yield output
        if output.text is not None:
            Path(temporary).write_text(output.text, encoding="utf-8")
            os.chmod(temporary, 0o666 & ~_umask())
            os.replace(temporary, path)
    finally:
        Path(temporary).unlink(missing_ok=True)


@contextmanager
def reserved_path(path: Path) -> Iterator[Path]:
    """Reserve a place for a file that another library writes; yields where to write meanwhile.

    As `reserved_file`: what is yielded becomes `path` when the block ends, and vanishes when the
    block raises. Its name ends like that of `path`, which may tell the format.

    Raises
    ------
    OutputError
        If the file cannot be made there; the message names path and remedy.
    """
    path = Path(path)
    require_place(path)
    try:
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.stem}.", suffix=path.suffix
        )
    except OSError as error:
        raise OutputError(_cannot_write(path.parent, error)) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def require_place(path: Path) -> None:
    """Check that a file can be made at a path, before the work that fills it.

    Raises
    ------
    OutputError
        If there is a folder of that name, or none to put it in.
    """
    if path.is_dir():
        raise OutputError(f"{path} is a folder, but must be a file: name a file in it")
    if not path.parent.is_dir():
        raise OutputError(
            f"folder {path.parent} does not exist, so {path.name} cannot be written there: "
            "create it or name another file"
        )


@contextmanager
def reserved_folder(path: Path) -> Iterator[Path]:
    """Reserve a folder before the work that fills it; yields a staging folder to write into.

    When the block ends, the files of the staging folder are moved to `path` (which is made if
    need be; other files in it stay). When it raises, everything made is removed.

    Raises
    ------
    OutputError
        If the folder cannot be made or written; the message names path and remedy.
    """
    target = Path(path).absolute()
    if target.exists() and not target.is_dir():
        raise OutputError(f"{path} is a file, but must be a folder: name another --out folder")
    # On the file system of the target, so that moving a file there cannot stop half-way.
    host = target
    while not host.exists():
        host = host.parent
    if not host.is_dir():
        raise OutputError(f"{host} is a file, but must be a folder: name another --out folder")
    try:
        staging = Path(tempfile.mkdtemp(dir=host, prefix=f".{target.name}."))
    except OSError as error:
        raise OutputError(_cannot_write(host, error)) from error
    try:
        yield staging
        target.mkdir(parents=True, exist_ok=True)
        for file in sorted(staging.iterdir()):
            os.replace(file, target / file.name)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _cannot_write(folder: Path, error: OSError) -> str:
    reason = error.strerror or str(error)
    return (
        f"folder {folder} cannot be written ({reason}): name another folder or change its "
        "permissions"
    )


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
