"""Crank-angle and mean-value plants of a camless engine's intake process."""

from .crank_angle import CrankAnglePlant, PlantRun
from .cycle import CompletedEvent, Cycle, EventResult
from .errors import ConvergenceError, InfeasibleProfileError, ParameterError, SimulationError
from .parameters import Engine, HelmholtzRunner, Throttle, Valvetrain
from .state import PlantState
from .trace import Trace
from .valve import ValveCommand, ValveProfile

__all__ = [
    "CompletedEvent",
    "ConvergenceError",
    "CrankAnglePlant",
    "Cycle",
    "Engine",
    "EventResult",
    "HelmholtzRunner",
    "InfeasibleProfileError",
    "ParameterError",
    "PlantRun",
    "PlantState",
    "SimulationError",
    "Throttle",
    "Trace",
    "ValveCommand",
    "ValveProfile",
    "Valvetrain",
]
