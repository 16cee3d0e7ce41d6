"""Files that scenarios are read from: their own, and the tables that they name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ._profile_signal import inside
from .operating_profile import QUANTITIES
from .scenario_toml import read_toml, toml_files, toml_tables


def input_files(path: Path) -> tuple[Path, ...]:
    """Return the files that `load_scenarios` reads, without reading the tables.

    Parameters
    ----------
    path : Path
        A scenario file, or a folder of them, that can be loaded.

    Raises
    ------
    ParameterError
        If a file cannot be read, or is no TOML.
    """
    found: dict[Path, None] = {}
    for file in toml_files(path):
        found[file] = None
        for scenario in toml_tables(read_toml(file)[1]):
            for name in _named(scenario.data):
                found[inside(name, file.parent)] = None
    return tuple(found)


def _named(scenario: Any) -> Iterator[str]:
    """Names of the tables of a scenario."""
    profile = scenario.get("profile", {})
    for quantity in QUANTITIES:
        signal = profile.get(quantity)
        if isinstance(signal, dict) and "file" in signal:
            yield signal["file"]
