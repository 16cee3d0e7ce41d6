"""Design, analysis and closed-loop simulation of the camless engine's air-charge controller.

The names below are loaded on first use, so that the command line starts without them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._schedule_design import ScheduleDesign
    from .adaptation import AdaptationGains, AdaptationLaw, GainSchedule, NormalisedGradient
    from .closed_loop import ClosedLoopResult, averaged, run_load_step, simulate
    from .confirmation import GrowthCheck, PlantCheck, check_growth, check_plants
    from .controller import AirChargeController
    from .delay_boundary import BoundaryRun, DelayBoundary
    from .delay_margin import DelayMargin
    from .disk_margins import (
        DiskMargin,
        DiskMargins,
        ModeMargins,
        all_loops_at_once,
        loop_at_a_time,
    )
    from .estimator import ChargeEstimator
    from .event_loop import EventLoop, ModeLoop
    from .feedforward import ChargeMap, Feedforward, LiftSchedule
    from .gain_synthesis import GainDesign, design_gains, design_schedule
    from .gang_of_four import GangOfFour, ModeFunctions
    from .law_comparison import LawComparison, LawFigures, compare_laws, standard_laws
    from .linearise import LocalResponse, local_response
    from .lti_synthesis import LtiLaw, dk_law, hinf_law
    from .margins import StabilityMargins, stability_margins
    from .measurement_response import FlowShape, MeasurementResponse
    from .nominal_loop import NominalLoop
    from .pulse_bank import PulseSum
    from .report import Report, build_report
    from .requirements import REQUIREMENTS, Requirement, RequirementResult, evaluate
    from .robust_analysis import RobustAnalysis, SpeedAnalysis, analyse_robustness
    from .robustness import ModeVerdict, RobustnessResult, analyse, analyse_point
    from .soundness import (
        LtiCheck,
        SampledPlantRun,
        SampledPlantsCheck,
        check_lti,
        check_sampled_plants,
    )
    from .structured_robustness import StructuredRobustness, analyse_structured
    from .tightness import TightnessCheck, check_tightness
    from .uncertain_loop import UncertainLoop, adaptation_law
    from .uncertain_measurement import UncertainMeasurement

_HOME = {
    "AdaptationGains": "adaptation",
    "AdaptationLaw": "adaptation",
    "AirChargeController": "controller",
    "BoundaryRun": "delay_boundary",
    "ChargeEstimator": "estimator",
    "ChargeMap": "feedforward",
    "ClosedLoopResult": "closed_loop",
    "DelayBoundary": "delay_boundary",
    "DelayMargin": "delay_margin",
    "DiskMargin": "disk_margins",
    "DiskMargins": "disk_margins",
    "EventLoop": "event_loop",
    "Feedforward": "feedforward",
    "FlowShape": "measurement_response",
    "GainDesign": "gain_synthesis",
    "GainSchedule": "adaptation",
    "GangOfFour": "gang_of_four",
    "GrowthCheck": "confirmation",
    "LawComparison": "law_comparison",
    "LawFigures": "law_comparison",
    "LiftSchedule": "feedforward",
    "LocalResponse": "linearise",
    "LtiCheck": "soundness",
    "LtiLaw": "lti_synthesis",
    "MeasurementResponse": "measurement_response",
    "ModeFunctions": "gang_of_four",
    "ModeLoop": "event_loop",
    "ModeMargins": "disk_margins",
    "ModeVerdict": "robustness",
    "NominalLoop": "nominal_loop",
    "NormalisedGradient": "adaptation",
    "PlantCheck": "confirmation",
    "PulseSum": "pulse_bank",
    "REQUIREMENTS": "requirements",
    "Report": "report",
    "Requirement": "requirements",
    "RequirementResult": "requirements",
    "RobustAnalysis": "robust_analysis",
    "RobustnessResult": "robustness",
    "SampledPlantRun": "soundness",
    "SampledPlantsCheck": "soundness",
    "ScheduleDesign": "_schedule_design",
    "SpeedAnalysis": "robust_analysis",
    "StabilityMargins": "margins",
    "StructuredRobustness": "structured_robustness",
    "TightnessCheck": "tightness",
    "UncertainLoop": "uncertain_loop",
    "UncertainMeasurement": "uncertain_measurement",
    "adaptation_law": "uncertain_loop",
    "all_loops_at_once": "disk_margins",
    "analyse": "robustness",
    "analyse_point": "robustness",
    "analyse_robustness": "robust_analysis",
    "analyse_structured": "structured_robustness",
    "averaged": "closed_loop",
    "build_report": "report",
    "check_growth": "confirmation",
    "check_lti": "soundness",
    "check_plants": "confirmation",
    "check_sampled_plants": "soundness",
    "check_tightness": "tightness",
    "compare_laws": "law_comparison",
    "design_gains": "gain_synthesis",
    "design_schedule": "gain_synthesis",
    "dk_law": "lti_synthesis",
    "evaluate": "requirements",
    "hinf_law": "lti_synthesis",
    "local_response": "linearise",
    "loop_at_a_time": "disk_margins",
    "run_load_step": "closed_loop",
    "simulate": "closed_loop",
    "stability_margins": "margins",
    "standard_laws": "law_comparison",
}

__all__ = [
    "REQUIREMENTS",
    "AdaptationGains",
    "AdaptationLaw",
    "AirChargeController",
    "BoundaryRun",
    "ChargeEstimator",
    "ChargeMap",
    "ClosedLoopResult",
    "DelayBoundary",
    "DelayMargin",
    "DiskMargin",
    "DiskMargins",
    "EventLoop",
    "Feedforward",
    "FlowShape",
    "GainDesign",
    "GainSchedule",
    "GangOfFour",
    "GrowthCheck",
    "LawComparison",
    "LawFigures",
    "LiftSchedule",
    "LocalResponse",
    "LtiCheck",
    "LtiLaw",
    "MeasurementResponse",
    "ModeFunctions",
    "ModeLoop",
    "ModeMargins",
    "ModeVerdict",
    "NominalLoop",
    "NormalisedGradient",
    "PlantCheck",
    "PulseSum",
    "Report",
    "Requirement",
    "RequirementResult",
    "RobustAnalysis",
    "RobustnessResult",
    "SampledPlantRun",
    "SampledPlantsCheck",
    "ScheduleDesign",
    "SpeedAnalysis",
    "StabilityMargins",
    "StructuredRobustness",
    "TightnessCheck",
    "UncertainLoop",
    "UncertainMeasurement",
    "adaptation_law",
    "all_loops_at_once",
    "analyse",
    "analyse_point",
    "analyse_robustness",
    "analyse_structured",
    "averaged",
    "build_report",
    "check_growth",
    "check_lti",
    "check_plants",
    "check_sampled_plants",
    "check_tightness",
    "compare_laws",
    "design_gains",
    "design_schedule",
    "dk_law",
    "evaluate",
    "hinf_law",
    "local_response",
    "loop_at_a_time",
    "run_load_step",
    "simulate",
    "stability_margins",
    "standard_laws",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
