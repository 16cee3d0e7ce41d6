"""Uncertainty of the mean-value plant: what it leaves out, as deltas."""

from .delta_result import DeltaResult, WorstChange
from .deltas import ActuatorOscillationDelta, Delta, HelmholtzDelta, PlantDelta

__all__ = [
    "ActuatorOscillationDelta",
    "Delta",
    "DeltaResult",
    "HelmholtzDelta",
    "PlantDelta",
    "WorstChange",
]
