"""Design, analysis and closed-loop simulation of the camless engine's air-charge controller.

The names below are loaded on first use, so that the command line starts without them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .adaptation import AdaptationGains, AdaptationLaw, GainSchedule, NormalisedGradient
    from .closed_loop import ClosedLoopResult, averaged, run_load_step, simulate
    from .confirmation import GrowthCheck, PlantCheck, check_growth, check_plants
    from .controller import AirChargeController
    from .estimator import ChargeEstimator
    from .event_loop import EventLoop, ModeLoop
    from .feedforward import ChargeMap, Feedforward, LiftSchedule
    from .linearise import LocalResponse, local_response
    from .margins import StabilityMargins, stability_margins
    from .measurement_response import FlowShape, MeasurementResponse
    from .report import Report, build_report
    from .requirements import REQUIREMENTS, Requirement, RequirementResult, evaluate
    from .robustness import ModeVerdict, RobustnessResult, analyse, analyse_point

_HOME = {
    "REQUIREMENTS": "requirements",
    "AdaptationGains": "adaptation",
    "AdaptationLaw": "adaptation",
    "AirChargeController": "controller",
    "ChargeEstimator": "estimator",
    "ChargeMap": "feedforward",
    "ClosedLoopResult": "closed_loop",
    "EventLoop": "event_loop",
    "Feedforward": "feedforward",
    "FlowShape": "measurement_response",
    "GainSchedule": "adaptation",
    "GrowthCheck": "confirmation",
    "LiftSchedule": "feedforward",
    "LocalResponse": "linearise",
    "MeasurementResponse": "measurement_response",
    "ModeLoop": "event_loop",
    "ModeVerdict": "robustness",
    "NormalisedGradient": "adaptation",
    "PlantCheck": "confirmation",
    "Report": "report",
    "Requirement": "requirements",
    "RequirementResult": "requirements",
    "RobustnessResult": "robustness",
    "StabilityMargins": "margins",
    "analyse": "robustness",
    "analyse_point": "robustness",
    "averaged": "closed_loop",
    "build_report": "report",
    "check_growth": "confirmation",
    "check_plants": "confirmation",
    "evaluate": "requirements",
    "local_response": "linearise",
    "stability_margins": "margins",
    "run_load_step": "closed_loop",
    "simulate": "closed_loop",
}

__all__ = [
    "REQUIREMENTS",
    "AdaptationGains",
    "AdaptationLaw",
    "AirChargeController",
    "ChargeEstimator",
    "ChargeMap",
    "ClosedLoopResult",
    "EventLoop",
    "Feedforward",
    "FlowShape",
    "GainSchedule",
    "GrowthCheck",
    "LiftSchedule",
    "LocalResponse",
    "MeasurementResponse",
    "ModeLoop",
    "ModeVerdict",
    "NormalisedGradient",
    "PlantCheck",
    "Report",
    "Requirement",
    "RequirementResult",
    "RobustnessResult",
    "StabilityMargins",
    "analyse",
    "analyse_point",
    "averaged",
    "build_report",
    "check_growth",
    "check_plants",
    "evaluate",
    "local_response",
    "run_load_step",
    "simulate",
    "stability_margins",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
