"""Crank-angle and mean-value plants of a camless engine's intake, sensors and identification.

The names below are loaded on first use, so that what needs few of them starts without the rest.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_HOME = {
    "PUBLISHED_CLAIMS": "published",
    "PUBLISHED_POINTS": "published",
    "AirPathSamples": "sensor_run",
    "ChargeInverse": "map_results",
    "ChargeObservation": "observations",
    "CompletedEvent": "cycle",
    "ConvergenceError": "errors",
    "CrankAnglePlant": "crank_angle",
    "CrankSampling": "sampling",
    "Cycle": "cycle",
    "DurationSamples": "sensor_run",
    "DurationSensor": "sensors",
    "Engine": "parameters",
    "EventResult": "cycle",
    "Experiment": "observations",
    "FreeParameter": "identification_result",
    "HelmholtzRunner": "parameters",
    "IdentificationResult": "identification_result",
    "InfeasibleProfileError": "errors",
    "MafSensor": "sensors",
    "MapError": "map_results",
    "MapGradient": "map_results",
    "MapSensor": "sensors",
    "MeanValuePlant": "mean_value",
    "OperatingPoint": "region",
    "OperatingRegion": "region",
    "ParameterError": "errors",
    "PlantRun": "run",
    "PlantState": "state",
    "Sensor": "sensors",
    "SensorRun": "sensor_run",
    "SensorSamples": "sampling",
    "SensorSet": "sensors",
    "SensorSetRun": "sensor_run",
    "SensorState": "sensor_run",
    "SimulationError": "errors",
    "SweepResult": "sweep",
    "Throttle": "parameters",
    "TimeSampling": "sampling",
    "Trace": "trace",
    "TraceObservation": "observations",
    "ValidationReport": "validation",
    "ValveCommand": "valve",
    "ValveProfile": "valve_profile",
    "Valvetrain": "parameters",
    "charge_observation": "observations",
    "engine_fields": "_engine_fields",
    "first_order_lag": "lag",
    "identify": "identification",
    "published_point": "published",
    "replace_engine_fields": "_engine_fields",
    "validate": "validation",
}

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


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
