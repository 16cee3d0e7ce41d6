"""Design, analysis and closed-loop simulation of the camless engine's air-charge controller.

The names below are loaded on first use, so that the command line starts without them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._schedule_design import ScheduleDesign
    from .adaptation import AdaptationGains, GainSchedule
    from .adaptation_laws import AdaptationLaw, AdaptationState, AdaptationStep, ParameterBounds
    from .charge_model import ChargeModel
    from .closed_loop import ValveErrors, simulate
    from .closed_loop_result import ClosedLoopResult, averaged
    from .command_limits import CommandLimits
    from .confirmation import GrowthCheck, PlantCheck, check_growth, check_plants
    from .controller import AirChargeController, ControllerState, ControlStep
    from .controller_cases import PerformanceCase, performance_cases
    from .controller_design import ControllerDesign, design_controller
    from .cylinder_parameters import CylinderParameters, ParameterSet
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
    from .event_data import Measurement
    from .event_loop import EventLoop, ModeLoop
    from .feedforward import ChargeMap, Feedforward, LiftSchedule
    from .gain_synthesis import GainDesign, design_gains, design_schedule
    from .gang_of_four import GangOfFour, ModeFunctions
    from .gradient_adaptation import GradientAdaptation
    from .integral_adaptation import IntegralAdaptation
    from .kalman_adaptation import KalmanAdaptation
    from .kalman_estimator import KalmanEstimator
    from .law_comparison import LawComparison, LawFigures, compare_laws, standard_laws
    from .least_loss_motion import FeedforwardOptions, OptimalMotion, optimal_motion
    from .linearise import LocalResponse, local_response
    from .load_step import run_load_step
    from .lti_adaptation import LtiAdaptation
    from .lti_synthesis import LtiLaw, dk_law, hinf_law
    from .margins import StabilityMargins, stability_margins
    from .measurement_response import FlowShape, MeasurementResponse
    from .nominal_loop import NominalLoop
    from .optimal_path import OptimalPath
    from .performance import PerformanceRow, PerformanceTable, measure_performance
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
    from .window_estimator import WindowEstimator
    from .window_loop import window_controller

_HOME = {
    "AdaptationGains": "adaptation",
    "AdaptationLaw": "adaptation_laws",
    "AdaptationState": "adaptation_laws",
    "AdaptationStep": "adaptation_laws",
    "AirChargeController": "controller",
    "BoundaryRun": "delay_boundary",
    "ChargeEstimator": "estimator",
    "ChargeMap": "feedforward",
    "ChargeModel": "charge_model",
    "ClosedLoopResult": "closed_loop_result",
    "CommandLimits": "command_limits",
    "ControlStep": "controller",
    "ControllerDesign": "controller_design",
    "ControllerState": "controller",
    "CylinderParameters": "cylinder_parameters",
    "DelayBoundary": "delay_boundary",
    "DelayMargin": "delay_margin",
    "DiskMargin": "disk_margins",
    "DiskMargins": "disk_margins",
    "EventLoop": "event_loop",
    "Feedforward": "feedforward",
    "FeedforwardOptions": "least_loss_motion",
    "FlowShape": "measurement_response",
    "GainDesign": "gain_synthesis",
    "GainSchedule": "adaptation",
    "GangOfFour": "gang_of_four",
    "GradientAdaptation": "gradient_adaptation",
    "GrowthCheck": "confirmation",
    "IntegralAdaptation": "integral_adaptation",
    "KalmanAdaptation": "kalman_adaptation",
    "KalmanEstimator": "kalman_estimator",
    "LawComparison": "law_comparison",
    "LawFigures": "law_comparison",
    "LiftSchedule": "feedforward",
    "LocalResponse": "linearise",
    "LtiAdaptation": "lti_adaptation",
    "LtiCheck": "soundness",
    "LtiLaw": "lti_synthesis",
    "Measurement": "event_data",
    "MeasurementResponse": "measurement_response",
    "ModeFunctions": "gang_of_four",
    "ModeLoop": "event_loop",
    "ModeMargins": "disk_margins",
    "ModeVerdict": "robustness",
    "NominalLoop": "nominal_loop",
    "OptimalMotion": "least_loss_motion",
    "OptimalPath": "optimal_path",
    "ParameterBounds": "adaptation_laws",
    "ParameterSet": "cylinder_parameters",
    "PerformanceCase": "controller_cases",
    "PerformanceRow": "performance",
    "PerformanceTable": "performance",
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
    "ValveErrors": "closed_loop",
    "WindowEstimator": "window_estimator",
    "adaptation_law": "uncertain_loop",
    "all_loops_at_once": "disk_margins",
    "analyse": "robustness",
    "analyse_point": "robustness",
    "analyse_robustness": "robust_analysis",
    "analyse_structured": "structured_robustness",
    "averaged": "closed_loop_result",
    "build_report": "report",
    "check_growth": "confirmation",
    "check_lti": "soundness",
    "check_plants": "confirmation",
    "check_sampled_plants": "soundness",
    "check_tightness": "tightness",
    "compare_laws": "law_comparison",
    "design_controller": "controller_design",
    "design_gains": "gain_synthesis",
    "design_schedule": "gain_synthesis",
    "dk_law": "lti_synthesis",
    "evaluate": "requirements",
    "hinf_law": "lti_synthesis",
    "local_response": "linearise",
    "loop_at_a_time": "disk_margins",
    "measure_performance": "performance",
    "optimal_motion": "least_loss_motion",
    "performance_cases": "controller_cases",
    "run_load_step": "load_step",
    "simulate": "closed_loop",
    "stability_margins": "margins",
    "standard_laws": "law_comparison",
    "window_controller": "window_loop",
}

__all__ = [
    "REQUIREMENTS",
    "AdaptationGains",
    "AdaptationLaw",
    "AdaptationState",
    "AdaptationStep",
    "AirChargeController",
    "BoundaryRun",
    "ChargeEstimator",
    "ChargeMap",
    "ChargeModel",
    "ClosedLoopResult",
    "CommandLimits",
    "ControlStep",
    "ControllerDesign",
    "ControllerState",
    "CylinderParameters",
    "DelayBoundary",
    "DelayMargin",
    "DiskMargin",
    "DiskMargins",
    "EventLoop",
    "Feedforward",
    "FeedforwardOptions",
    "FlowShape",
    "GainDesign",
    "GainSchedule",
    "GangOfFour",
    "GradientAdaptation",
    "GrowthCheck",
    "IntegralAdaptation",
    "KalmanAdaptation",
    "KalmanEstimator",
    "LawComparison",
    "LawFigures",
    "LiftSchedule",
    "LocalResponse",
    "LtiAdaptation",
    "LtiCheck",
    "LtiLaw",
    "Measurement",
    "MeasurementResponse",
    "ModeFunctions",
    "ModeLoop",
    "ModeMargins",
    "ModeVerdict",
    "NominalLoop",
    "OptimalMotion",
    "OptimalPath",
    "ParameterBounds",
    "ParameterSet",
    "PerformanceCase",
    "PerformanceRow",
    "PerformanceTable",
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
    "ValveErrors",
    "WindowEstimator",
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
    "design_controller",
    "design_gains",
    "design_schedule",
    "dk_law",
    "evaluate",
    "hinf_law",
    "local_response",
    "loop_at_a_time",
    "measure_performance",
    "optimal_motion",
    "performance_cases",
    "run_load_step",
    "simulate",
    "stability_margins",
    "standard_laws",
    "window_controller",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
