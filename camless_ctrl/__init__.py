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
    from .adaptation_stability import GainSector, gain_sector
    from .analysed_control import AnalysedControl, DesignedControl, WindowControl
    from .baselines import baseline_controllers, lti_controller
    from .charge_model import ChargeModel, MotionPath
    from .closed_loop import ValveErrors, simulate
    from .closed_loop_result import ClosedLoopResult, averaged
    from .command_limits import CommandLimits
    from .confirmation import GrowthCheck, PlantCheck, check_growth, check_plants
    from .controller import AirChargeController, ControllerState, ControlStep, Diagnostics
    from .controller_cases import PerformanceCase, performance_cases
    from .controller_design import ControllerDesign, design_controller, path_adaptation
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
    from .estimation_check import (
        EstimationCheck,
        EstimationPoint,
        EstimationResult,
        check_estimator,
    )
    from .estimator import ChargeEstimator
    from .event_data import ChargeEstimate, ChargeEvidence, EventRecord, Measurement, ModelPoint
    from .event_loop import EventLoop, ModeLoop
    from .feedforward import ChargeMap, Feedforward, LiftSchedule
    from .feedforward_check import FeedforwardCheck, check_feedforward
    from .gain_break import GainBreak, check_gain_break
    from .gain_synthesis import GainDesign, design_gains, design_schedule
    from .gang_of_four import GangOfFour, ModeFunctions
    from .gradient_adaptation import GradientAdaptation
    from .integral_adaptation import IntegralAdaptation
    from .kalman_adaptation import KalmanAdaptation
    from .kalman_estimator import EstimatorState, EstimatorUpdate, KalmanEstimator
    from .law_comparison import LawComparison, LawFigures, compare_laws, standard_laws
    from .least_loss_motion import (
        FeedforwardOptions,
        OptimalityCertificate,
        OptimalMotion,
        optimal_motion,
    )
    from .linearise import LocalResponse, local_response
    from .load_step import run_load_step
    from .loss_reference import LossReference, loss_references
    from .lti_adaptation import LtiAdaptation
    from .lti_synthesis import LtiLaw, dk_law, hinf_law
    from .margins import StabilityMargins, stability_margins
    from .measurement_response import FlowShape, MeasurementResponse
    from .mu_optimal import mu_optimal_law
    from .nominal_loop import NominalLoop
    from .optimal_path import OptimalPath, PathPoint
    from .performance import PerformanceRow, PerformanceTable, measure_performance, run_case
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
    "AnalysedControl": "analysed_control",
    "BoundaryRun": "delay_boundary",
    "ChargeEstimate": "event_data",
    "ChargeEstimator": "estimator",
    "ChargeEvidence": "event_data",
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
    "DesignedControl": "analysed_control",
    "Diagnostics": "controller",
    "DiskMargin": "disk_margins",
    "DiskMargins": "disk_margins",
    "EstimationCheck": "estimation_check",
    "EstimationPoint": "estimation_check",
    "EstimationResult": "estimation_check",
    "EstimatorState": "kalman_estimator",
    "EstimatorUpdate": "kalman_estimator",
    "EventLoop": "event_loop",
    "EventRecord": "event_data",
    "Feedforward": "feedforward",
    "FeedforwardCheck": "feedforward_check",
    "FeedforwardOptions": "least_loss_motion",
    "FlowShape": "measurement_response",
    "GainBreak": "gain_break",
    "GainDesign": "gain_synthesis",
    "GainSchedule": "adaptation",
    "GainSector": "adaptation_stability",
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
    "LossReference": "loss_reference",
    "LtiAdaptation": "lti_adaptation",
    "LtiCheck": "soundness",
    "LtiLaw": "lti_synthesis",
    "Measurement": "event_data",
    "MeasurementResponse": "measurement_response",
    "ModeFunctions": "gang_of_four",
    "ModeLoop": "event_loop",
    "ModeMargins": "disk_margins",
    "ModeVerdict": "robustness",
    "ModelPoint": "event_data",
    "MotionPath": "charge_model",
    "NominalLoop": "nominal_loop",
    "OptimalMotion": "least_loss_motion",
    "OptimalPath": "optimal_path",
    "OptimalityCertificate": "least_loss_motion",
    "ParameterBounds": "adaptation_laws",
    "ParameterSet": "cylinder_parameters",
    "PathPoint": "optimal_path",
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
    "WindowControl": "analysed_control",
    "WindowEstimator": "window_estimator",
    "adaptation_law": "uncertain_loop",
    "all_loops_at_once": "disk_margins",
    "analyse": "robustness",
    "analyse_point": "robustness",
    "analyse_robustness": "robust_analysis",
    "analyse_structured": "structured_robustness",
    "averaged": "closed_loop_result",
    "baseline_controllers": "baselines",
    "build_report": "report",
    "check_estimator": "estimation_check",
    "check_feedforward": "feedforward_check",
    "check_gain_break": "gain_break",
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
    "gain_sector": "adaptation_stability",
    "hinf_law": "lti_synthesis",
    "local_response": "linearise",
    "loop_at_a_time": "disk_margins",
    "loss_references": "loss_reference",
    "lti_controller": "baselines",
    "measure_performance": "performance",
    "mu_optimal_law": "mu_optimal",
    "optimal_motion": "least_loss_motion",
    "path_adaptation": "controller_design",
    "performance_cases": "controller_cases",
    "run_case": "performance",
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
    "AnalysedControl",
    "BoundaryRun",
    "ChargeEstimate",
    "ChargeEstimator",
    "ChargeEvidence",
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
    "DesignedControl",
    "Diagnostics",
    "DiskMargin",
    "DiskMargins",
    "EstimationCheck",
    "EstimationPoint",
    "EstimationResult",
    "EstimatorState",
    "EstimatorUpdate",
    "EventLoop",
    "EventRecord",
    "Feedforward",
    "FeedforwardCheck",
    "FeedforwardOptions",
    "FlowShape",
    "GainBreak",
    "GainDesign",
    "GainSchedule",
    "GainSector",
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
    "LossReference",
    "LtiAdaptation",
    "LtiCheck",
    "LtiLaw",
    "Measurement",
    "MeasurementResponse",
    "ModeFunctions",
    "ModeLoop",
    "ModeMargins",
    "ModeVerdict",
    "ModelPoint",
    "MotionPath",
    "NominalLoop",
    "OptimalMotion",
    "OptimalPath",
    "OptimalityCertificate",
    "ParameterBounds",
    "ParameterSet",
    "PathPoint",
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
    "WindowControl",
    "WindowEstimator",
    "adaptation_law",
    "all_loops_at_once",
    "analyse",
    "analyse_point",
    "analyse_robustness",
    "analyse_structured",
    "averaged",
    "baseline_controllers",
    "build_report",
    "check_estimator",
    "check_feedforward",
    "check_gain_break",
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
    "gain_sector",
    "hinf_law",
    "local_response",
    "loop_at_a_time",
    "loss_references",
    "lti_controller",
    "measure_performance",
    "mu_optimal_law",
    "optimal_motion",
    "path_adaptation",
    "performance_cases",
    "run_case",
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
