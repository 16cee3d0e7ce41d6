"""Stamp of the sources that are compiled into an entry.

Numba keeps the machine code of an entry on disk and notices a change of its own file alone. An
entry that carries a stamp of all files that are compiled into it is compiled anew when any of
them changes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path


def stamp_of(files: Iterable[Path]) -> int:
    """Return a number above 0 that tells the present contents of files apart."""
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files))
    return 1 + int.from_bytes(digest.digest()[:7], "big")
