"""What a kept design depends on, and where it is kept. Private to `model_store`."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

from plant import CrankAnglePlant

from ._design_file import FORMAT
from .least_loss_motion import FeedforwardOptions

FOLDER_VARIABLE = "CAMLESS_CACHE"
NOTHING = "off"  # value of that variable
# Modules of this package that make tables of the path and the charge model, read or write them.
MODULES = (
    "_design_file",
    "_design_key",
    "_model_checks",
    "_model_data",
    "_model_fit",
    "_model_kernel",
    "_model_lookup",
    "_model_table",
    "_path_certificates",
    "_path_data",
    "_path_fit",
    "_path_limits",
    "_path_plots",
    "_path_problem",
    "_path_scan",
    "_path_search",
    "_path_selection",
    "_path_surface",
    "charge_model",
    "controller_design",
    "cylinder_parameters",
    "event_data",
    "feedforward",
    "inflow_shares",
    "least_loss_motion",
    "model_store",
    "optimal_path",
)
_NUMERICS = ("numpy", "scipy", "numba", "casadi")  # whose versions may round otherwise


def design_key(
    plant: CrankAnglePlant, options: FeedforwardOptions, grid: Mapping[str, Any] | None
) -> str:
    """Hash of all that the tables of a design follow from.

    Parameters
    ----------
    plant : CrankAnglePlant
        Full plant, that is engine and options.
    options : FeedforwardOptions
        Of the feedforward.
    grid : mapping or None
        Range and nodes; None for the default ones.
    """
    text = json.dumps(
        {
            "format": FORMAT,
            "plant": plant.fingerprint,
            "options": asdict(options),
            "grid": grid,
            "sources": SOURCES,
            "numerics": {name: _version(name) for name in _NUMERICS},
            "machine": [platform.system(), platform.machine()],
        },
        sort_keys=True,
    )
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def source_digest() -> str:
    """Hash of the source of the plant and of the modules that make the tables."""
    total = hashlib.sha256()
    plant, here = files("plant"), files(__package__)
    sources = {f"plant/{e.name}": e for e in plant.iterdir() if e.name.endswith(".py")}
    sources |= {f"{name}.py": here / f"{name}.py" for name in MODULES}
    for name in sorted(sources):
        content = sources[name].read_bytes()
        total.update(f"{name} {len(content)}\n".encode())
        total.update(content)
    return total.hexdigest()


def design_folder() -> Path | None:
    """Folder in which designs are kept, or None where none are to be kept.

    ``$CAMLESS_CACHE``, else ``$XDG_CACHE_HOME/camless-ctrl``, else ``~/.cache/camless-ctrl``;
    ``CAMLESS_CACHE=off`` keeps nothing, and so does a user without a home.
    """
    own = os.environ.get(FOLDER_VARIABLE, "")
    if own:
        return None if own == NOTHING else Path(own)
    shared = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not shared.is_absolute():  # as its specification asks
        try:
            shared = Path.home() / ".cache"
        except RuntimeError:
            return None
    return shared / "camless-ctrl"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


SOURCES = source_digest()  # when this module was loaded, and with it, nearly, the others
