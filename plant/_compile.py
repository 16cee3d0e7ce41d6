"""Compilation of the kernel, and where its machine code is kept on disk.

What is kept lies in a folder named after the contents of every file of the kernel, so that a
change of any of them is never served stale. That folder lies in ``NUMBA_CACHE_DIR`` if it is
set, else beside the package, else in the user's cache; where none can be written, the code is
compiled anew in each process.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import stat
import time
import uuid
import warnings
from collections.abc import Callable
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

_FOLDER = Path(__file__).parent
_SOURCES = (
    "_batch_kernel.py",
    "_compile.py",
    "_engine_numbers.py",
    "_entries.py",
    "_error.py",
    "_fill.py",
    "_forcing.py",
    "_implicit.py",
    "_kernel.py",
    "_layout.py",
    "_method.py",
    "_native.py",
    "_native_call.py",
    "_periodic.py",
    "_record.py",
    "_segment.py",
    "_stage.py",
    "_workspace.py",
    "intake_problem.py",
    "lag.py",
    "orifice.py",
    "parameters.py",
    "right_hand_side.py",
    "runner.py",
    "valve.py",
)
# What LLVM may round otherwise: a product and a sum in one, a quotient as a product.
_ROUNDING = {"contract", "arcp", "nsz"}
_UNUSED_DAYS = 30  # after which the code of another version is removed


@cache
def _name() -> str:
    """Name of the folder of this very kernel."""
    digest = hashlib.sha256()
    for name in _SOURCES:
        digest.update((_FOLDER / name).read_bytes())
    return f"kernel-{digest.hexdigest()[:16]}"


def _homes() -> list[Path]:
    """Where that folder may lie, the best place first."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return [Path(chosen)]
    user = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    homes = [_FOLDER / "__pycache__", Path(user) / "camless-ctrl"]
    return [home for home in homes if home.is_absolute()]  # a user may have no home


def read(file: str) -> bytes | None:
    """Return what was stored under a name, or None if it is missing or damaged."""
    for home in _homes():
        folder = home / _name()
        try:
            if _anyone_may_write(folder) or _anyone_may_write(folder / file):
                continue  # what is in it would be run
            kept = (folder / file).read_bytes()
        except OSError:
            continue
        if hashlib.sha256(kept[32:]).digest() == kept[:32]:
            with contextlib.suppress(OSError):
                os.utime(folder)  # still in use
            return kept[32:]
    return None


def _anyone_may_write(path: Path) -> bool:
    return os.name == "posix" and bool(path.stat().st_mode & stat.S_IWOTH)


def store(file: str, content: bytes) -> None:
    """Keep content under a name for later processes, or warn that it cannot be kept."""
    refused = []
    for home in _homes():
        folder = home / _name()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            unfinished = folder / f"{file}.{uuid.uuid4().hex}"  # others may write it as well
            try:
                unfinished.write_bytes(hashlib.sha256(content).digest() + content)
                unfinished.replace(folder / file)
            finally:
                unfinished.unlink(missing_ok=True)
        except OSError as error:
            refused.append(f"{home} ({error.strerror})")
            continue
        _remove_unused(home)
        return
    warnings.warn(
        f"the compiled plant cannot be kept in {' or '.join(refused)}: each process compiles it "
        "anew, which takes about a minute; set NUMBA_CACHE_DIR to a folder that can be written",
        RuntimeWarning,
        stacklevel=2,
    )


def _remove_unused(home: Path) -> None:
    """Remove the code of other versions that no process has asked for in a long time."""
    oldest = time.time() - 86400.0 * _UNUSED_DAYS
    for folder in home.glob("kernel-" + 16 * "[0-9a-f]"):
        with contextlib.suppress(OSError):  # another process may be removing it
            if folder.name != _name() and folder.stat().st_mtime < oldest:
                shutil.rmtree(folder, ignore_errors=True)


class Compiled:
    """A function of the kernel, which Numba compiles when it is called first.

    Other compiled functions call it as they call any function of Numba's. Numba itself is
    imported no earlier, since that takes its time.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.py_func = function
        self.__doc__ = function.__doc__

    def __call__(self, *arguments: Any) -> Any:
        """Call the function."""
        return self.dispatcher(*arguments)

    @cached_property
    def dispatcher(self) -> Any:
        """The function as Numba knows it."""
        numba: Any = import_module("numba")

        dispatcher = numba.njit(error_model="numpy", nogil=True, fastmath=_ROUNDING)(self.py_func)
        template = dispatcher.get_call_template

        def one_template(arguments: Any, names: Any) -> Any:
            # Numba would compile anew for each constant that a caller hands in.
            return template(tuple(numba.types.unliteral(kind) for kind in arguments), names)

        dispatcher.get_call_template = one_template
        return dispatcher

    @property
    def _numba_type_(self) -> Any:  # what Numba asks of a global that it meets in a function
        return self.dispatcher._numba_type_


def compiled(function: Callable[..., Any]) -> Compiled:
    """Compile a function of the kernel on its first call."""
    return Compiled(function)
