"""Compilation of the kernel: machine code that runs without the GIL and is kept on disk.

Numba keys its cache by the file that holds a function, so a function that calls into another
file would be served stale after a change there. The cache folder here is named after the
contents of every file of the kernel instead. It lies in ``NUMBA_CACHE_DIR`` if that is set,
else beside the package, else in the user's cache; where none can be written, the code is
compiled anew in each process.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

_FOLDER = Path(__file__).parent
_SOURCES = (
    "_compile.py",
    "_fill.py",
    "_forcing.py",
    "_implicit.py",
    "_kernel.py",
    "_layout.py",
    "_method.py",
    "_record.py",
    "_segment.py",
    "_stage.py",
    "_workspace.py",
    "lag.py",
    "valve.py",
)


def _cache_folder() -> str:
    """Folder for this very kernel, made and writable; empty if there is none."""
    digest = hashlib.sha256()
    for name in _SOURCES:
        digest.update((_FOLDER / name).read_bytes())
    name = f"kernel-{digest.hexdigest()[:16]}"
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    user = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    homes = [Path(chosen)] if chosen else [_FOLDER / "__pycache__", Path(user) / "camless-ctrl"]
    for home in homes:
        try:
            (home / name).mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=home / name):
                return str(home / name)
        except OSError:
            continue  # not writable: try the next
    return ""


_CACHE = _cache_folder()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function of the kernel on its first call."""
    if not _CACHE:
        return numba.njit(error_model="numpy", nogil=True)(function)
    config = vars(numba.config)
    before = config["CACHE_DIR"]
    config["CACHE_DIR"] = _CACHE  # read when a function is decorated
    try:
        return numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    finally:
        config["CACHE_DIR"] = before
