"""Errors that the package raises on purpose.

Every message names the value, the bound, the unit and the remedy.
"""

from __future__ import annotations


class ParameterError(ValueError):
    """A parameter or command is outside the range in which the model has a meaning."""


class InfeasibleProfileError(ParameterError):
    """A camless profile cannot be driven: the duration is too short for the lift.

    Attributes
    ----------
    highest_lift_mm : float
        Highest lift that the duration allows at that speed.
    """

    def __init__(self, message: str, highest_lift_mm: float) -> None:
        super().__init__(message)
        self.highest_lift_mm = highest_lift_mm


class ConvergenceError(RuntimeError):
    """An iteration ended without meeting its criterion."""


class SimulationError(RuntimeError):
    """The model left the region in which its equations hold."""
