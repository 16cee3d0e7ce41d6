"""Crank-angle and mean-value plants of a camless engine's intake, sensors and identification."""

from ._engine_fields import engine_fields, replace_engine_fields
from .crank_angle import CrankAnglePlant
from .cycle import CompletedEvent, Cycle, EventResult
from .errors import ConvergenceError, InfeasibleProfileError, ParameterError, SimulationError
from .identification import identify
from .identification_result import FreeParameter, IdentificationResult
from .lag import first_order_lag
from .map_results import ChargeInverse, MapError, MapGradient
from .mean_value import MeanValuePlant
from .observations import ChargeObservation, Experiment, TraceObservation, charge_observation
from .parameters import Engine, HelmholtzRunner, Throttle, Valvetrain
from .published import PUBLISHED_CLAIMS, PUBLISHED_POINTS, published_point
from .region import OperatingPoint, OperatingRegion
from .run import PlantRun
from .sampling import CrankSampling, SensorSamples, TimeSampling
from .sensor_run import (
    AirPathSamples,
    DurationSamples,
    SensorRun,
    SensorSetRun,
    SensorState,
)
from .sensors import DurationSensor, MafSensor, MapSensor, Sensor, SensorSet
from .state import PlantState
from .sweep import SweepResult
from .trace import Trace
from .validation import ValidationReport, validate
from .valve import ValveCommand
from .valve_profile import ValveProfile

__all__ = [
    "PUBLISHED_CLAIMS",
    "PUBLISHED_POINTS",
    "AirPathSamples",
    "ChargeInverse",
    "ChargeObservation",
    "CompletedEvent",
    "ConvergenceError",
    "CrankAnglePlant",
    "CrankSampling",
    "Cycle",
    "DurationSamples",
    "DurationSensor",
    "Engine",
    "EventResult",
    "Experiment",
    "FreeParameter",
    "HelmholtzRunner",
    "IdentificationResult",
    "InfeasibleProfileError",
    "MafSensor",
    "MapError",
    "MapGradient",
    "MapSensor",
    "MeanValuePlant",
    "OperatingPoint",
    "OperatingRegion",
    "ParameterError",
    "PlantRun",
    "PlantState",
    "Sensor",
    "SensorRun",
    "SensorSamples",
    "SensorSet",
    "SensorSetRun",
    "SensorState",
    "SimulationError",
    "SweepResult",
    "Throttle",
    "TimeSampling",
    "Trace",
    "TraceObservation",
    "ValidationReport",
    "ValveCommand",
    "ValveProfile",
    "Valvetrain",
    "charge_observation",
    "engine_fields",
    "first_order_lag",
    "identify",
    "published_point",
    "replace_engine_fields",
    "validate",
]
