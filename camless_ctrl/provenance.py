"""Where a result comes from: versions, platform and engine, as plain data."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from plant import CrankAnglePlant

PACKAGES = ("camless-ctrl", "numpy", "numba", "llvmlite", "scipy")  # that the numbers depend on
_SOURCE = "run from its source folder"
_ENGINE = "plant_fingerprint"


def run_provenance(plant: CrankAnglePlant) -> dict[str, Any]:
    """Return what a closed-loop run was computed with.

    Parameters
    ----------
    plant : CrankAnglePlant
        The true plant of the run.

    Returns
    -------
    dict
        ``python``, `PACKAGES` by name, ``platform``, ``processor`` (the one that the kernels are
        compiled for) and ``plant_fingerprint``, all as text.
    """
    return {
        "python": platform.python_version(),
        **{name: _version(name) for name in PACKAGES},
        "platform": f"{platform.system()} {platform.machine()}",
        "processor": str(import_module("llvmlite.binding").get_host_cpu_name()),
        _ENGINE: plant.fingerprint,
    }


def provenance_differences(
    stored: Mapping[str, Any], now: Mapping[str, Any], names: tuple[str, str] = ("stored", "now")
) -> tuple[str, ...]:
    """Return a sentence for each entry in which two origins differ.

    Parameters
    ----------
    stored, now : mapping
        As of `run_provenance`.
    names : (str, str)
        What to call them.
    """
    found = []
    for key in dict.fromkeys((*stored, *now)):
        before, after = stored.get(key, "not told"), now.get(key, "not told")
        if before != after:
            found.append(f"{key}: {before} {names[0]}, {after} {names[1]}")
    return tuple(found)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return _SOURCE
