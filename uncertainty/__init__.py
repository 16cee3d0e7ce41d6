"""Uncertainty of the mean-value plant: what it leaves out, as deltas.

The names below are loaded on first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .delta_result import DeltaResult, WorstChange
    from .deltas import ActuatorOscillationDelta, Delta, HelmholtzDelta, PlantDelta

_HOME = {
    "ActuatorOscillationDelta": "deltas",
    "Delta": "deltas",
    "DeltaResult": "delta_result",
    "HelmholtzDelta": "deltas",
    "PlantDelta": "deltas",
    "WorstChange": "delta_result",
}

__all__ = [
    "ActuatorOscillationDelta",
    "Delta",
    "DeltaResult",
    "HelmholtzDelta",
    "PlantDelta",
    "WorstChange",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
