"""Crank-angle and mean-value plants of a camless engine's intake, sensors and identification.

The names below are loaded on first use, so that what needs few of them starts without the rest.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._engine_fields import engine_fields, replace_engine_fields
    from .air_path import FlowShape, PulseResponse
    from .boundary import BoundaryConditions
    from .crank_angle import CrankAnglePlant
    from .cycle import CompletedEvent, Cycle, EventResult
    from .errors import ConvergenceError, InfeasibleProfileError, ParameterError, SimulationError
    from .identification import identify
    from .identification_result import FreeParameter, IdentificationResult
    from .lag import first_order_lag
    from .map_error import MapDerivativeError, MapErrorField
    from .map_regions import MapRegions
    from .map_results import BoundaryError, ChargeInverse, MapError, MapGradient, MapHessian
    from .mean_value import MeanValuePlant
    from .mean_value_dynamics import DynamicOperatingPoint, MeanValueDynamics
    from .observations import ChargeObservation, Experiment, TraceObservation, charge_observation
    from .parameters import Engine, HelmholtzRunner, Throttle, Valvetrain
    from .profile_plots import plot_valve_profiles
    from .published import PUBLISHED_CLAIMS, PUBLISHED_POINTS, published_point
    from .pumping_comparison import PumpingComparison, PumpingSaving, compare_pumping
    from .region import OperatingPoint, OperatingRegion
    from .run import PlantRun
    from .sampling import CrankSampling, SensorSamples, TimeSampling
    from .sensor_run import AirPathSamples, DurationSamples, SensorRun, SensorSetRun, SensorState
    from .sensors import DurationSensor, MafSensor, MapSensor, Sensor, SensorSet
    from .state import PlantState
    from .sweep import SweepResult
    from .throttled import (
        ThrottledMapError,
        ThrottledMeanValuePlant,
        ThrottledRun,
        ThrottleInverse,
        ThrottlePoint,
        ThrottleStep,
        throttle_step,
    )
    from .trace import Trace
    from .validation import ValidationReport, validate
    from .valve import ValveCommand
    from .valve_profile import ValveProfile

_HOME = {
    "PUBLISHED_CLAIMS": "published",
    "PUBLISHED_POINTS": "published",
    "AirPathSamples": "sensor_run",
    "BoundaryConditions": "boundary",
    "BoundaryError": "map_results",
    "ChargeInverse": "map_results",
    "ChargeObservation": "observations",
    "CompletedEvent": "cycle",
    "ConvergenceError": "errors",
    "CrankAnglePlant": "crank_angle",
    "CrankSampling": "sampling",
    "Cycle": "cycle",
    "DurationSamples": "sensor_run",
    "DurationSensor": "sensors",
    "DynamicOperatingPoint": "mean_value_dynamics",
    "Engine": "parameters",
    "EventResult": "cycle",
    "Experiment": "observations",
    "FlowShape": "air_path",
    "FreeParameter": "identification_result",
    "HelmholtzRunner": "parameters",
    "IdentificationResult": "identification_result",
    "InfeasibleProfileError": "errors",
    "MafSensor": "sensors",
    "MapDerivativeError": "map_error",
    "MapError": "map_results",
    "MapErrorField": "map_error",
    "MapGradient": "map_results",
    "MapHessian": "map_results",
    "MapRegions": "map_regions",
    "MapSensor": "sensors",
    "MeanValueDynamics": "mean_value_dynamics",
    "MeanValuePlant": "mean_value",
    "OperatingPoint": "region",
    "OperatingRegion": "region",
    "ParameterError": "errors",
    "PlantRun": "run",
    "PlantState": "state",
    "PulseResponse": "air_path",
    "PumpingComparison": "pumping_comparison",
    "PumpingSaving": "pumping_comparison",
    "Sensor": "sensors",
    "SensorRun": "sensor_run",
    "SensorSamples": "sampling",
    "SensorSet": "sensors",
    "SensorSetRun": "sensor_run",
    "SensorState": "sensor_run",
    "SimulationError": "errors",
    "SweepResult": "sweep",
    "Throttle": "parameters",
    "ThrottleInverse": "throttled",
    "ThrottlePoint": "throttled",
    "ThrottleStep": "throttled",
    "ThrottledMapError": "throttled",
    "ThrottledMeanValuePlant": "throttled",
    "ThrottledRun": "throttled",
    "TimeSampling": "sampling",
    "Trace": "trace",
    "TraceObservation": "observations",
    "ValidationReport": "validation",
    "ValveCommand": "valve",
    "ValveProfile": "valve_profile",
    "Valvetrain": "parameters",
    "charge_observation": "observations",
    "compare_pumping": "pumping_comparison",
    "engine_fields": "_engine_fields",
    "first_order_lag": "lag",
    "identify": "identification",
    "plot_valve_profiles": "profile_plots",
    "published_point": "published",
    "replace_engine_fields": "_engine_fields",
    "throttle_step": "throttled",
    "validate": "validation",
}

__all__ = [
    "PUBLISHED_CLAIMS",
    "PUBLISHED_POINTS",
    "AirPathSamples",
    "BoundaryConditions",
    "BoundaryError",
    "ChargeInverse",
    "ChargeObservation",
    "CompletedEvent",
    "ConvergenceError",
    "CrankAnglePlant",
    "CrankSampling",
    "Cycle",
    "DurationSamples",
    "DurationSensor",
    "DynamicOperatingPoint",
    "Engine",
    "EventResult",
    "Experiment",
    "FlowShape",
    "FreeParameter",
    "HelmholtzRunner",
    "IdentificationResult",
    "InfeasibleProfileError",
    "MafSensor",
    "MapDerivativeError",
    "MapError",
    "MapErrorField",
    "MapGradient",
    "MapHessian",
    "MapRegions",
    "MapSensor",
    "MeanValueDynamics",
    "MeanValuePlant",
    "OperatingPoint",
    "OperatingRegion",
    "ParameterError",
    "PlantRun",
    "PlantState",
    "PulseResponse",
    "PumpingComparison",
    "PumpingSaving",
    "Sensor",
    "SensorRun",
    "SensorSamples",
    "SensorSet",
    "SensorSetRun",
    "SensorState",
    "SimulationError",
    "SweepResult",
    "Throttle",
    "ThrottleInverse",
    "ThrottlePoint",
    "ThrottleStep",
    "ThrottledMapError",
    "ThrottledMeanValuePlant",
    "ThrottledRun",
    "TimeSampling",
    "Trace",
    "TraceObservation",
    "ValidationReport",
    "ValveCommand",
    "ValveProfile",
    "Valvetrain",
    "charge_observation",
    "compare_pumping",
    "engine_fields",
    "first_order_lag",
    "identify",
    "plot_valve_profiles",
    "published_point",
    "replace_engine_fields",
    "throttle_step",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
