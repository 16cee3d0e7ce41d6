"""Compilation of the kernel: machine code that runs without the GIL and is kept on disk.

Numba keys its cache by the file that holds a function, so a function that calls into another
file would be served stale after a change there. The cache folder here is named after the
contents of every file of the kernel instead. Where no folder can be written, the code is
compiled anew in each process.
"""

from __future__ import annotations

import hashlib
import os
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
    digest = hashlib.sha256()
    for name in _SOURCES:
        digest.update((_FOLDER / name).read_bytes())
    return str(_FOLDER / "__pycache__" / f"kernel-{digest.hexdigest()[:16]}")


_CACHE = _cache_folder()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function of the kernel on its first call."""
    config = vars(numba.config)
    before = config["CACHE_DIR"]
    if "NUMBA_CACHE_DIR" not in os.environ:
        config["CACHE_DIR"] = _CACHE  # read when a function is decorated
    try:
        return numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    except RuntimeError:  # no folder to cache in: neither here nor the user's
        return numba.njit(error_model="numpy", nogil=True)(function)
    finally:
        config["CACHE_DIR"] = before
