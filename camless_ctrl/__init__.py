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
    from .alarms import Alarm, Mode
    from .analysed_control import AnalysedControl, DesignedControl, WindowControl
    from .baselines import baseline_controllers, lti_controller
    from .charge_model import ChargeModel, MotionPath
    from .closed_loop import ValveErrors, simulate
    from .closed_loop_requirement import ClosedLoopRequirement, Verdict
    from .closed_loop_result import ClosedLoopResult, averaged
    from .command_limits import CommandLimits
    from .conditions import Conditions
    from .confirmation import GrowthCheck, PlantCheck, check_growth, check_plants
    from .controller import AirChargeController
    from .controller_cases import PerformanceCase, performance_cases
    from .controller_design import ControllerDesign, design_controller, path_adaptation
    from .controller_state import ControllerState, ControlStep, Diagnostics
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
    from .false_alarms import FalseAlarmCount, Operation, check_false_alarms, random_operation
    from .fault_check import FaultRow, FaultTable, check_faults
    from .fault_kinds import FAULT_KINDS, FaultKind
    from .fault_monitor import FaultMonitor
    from .fault_reaction import FaultReaction
    from .faults import Fault
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
    from .metrics import (
        METRICS,
        AlarmTime,
        CommandViolations,
        FalseAlarms,
        FirstEventsError,
        Imbalance,
        LossExcess,
        Measured,
        Metric,
        ModeShare,
        ModeTime,
        Overshoot,
        RecoveryBump,
        Settling,
        SteadyError,
        WorstError,
        metric_from_dict,
    )
    from .model_store import load_design, save_design, stored_design
    from .mu_optimal import mu_optimal_law
    from .nominal_loop import NominalLoop
    from .operating_profile import Deactivation, OperatingProfile, ProfileEvents, Signal
    from .optimal_path import OptimalPath, PathPoint
    from .performance import PerformanceRow, PerformanceTable, measure_performance, run_case
    from .pulse_bank import PulseSum
    from .replay import Replay, replay_result
    from .report import Report, build_report
    from .requirements import REQUIREMENTS, Requirement, RequirementResult, evaluate
    from .robust_analysis import RobustAnalysis, SpeedAnalysis, analyse_robustness
    from .robustness import ModeVerdict, RobustnessResult, analyse, analyse_point
    from .scenario import ControllerChoice, Scenario, ScenarioError
    from .scenario_result import ScenarioResult, load_result
    from .scenario_run import run_scenario, scenario_design
    from .scenario_toml import load_scenario, load_scenarios
    from .shipped import shipped_scenario, shipped_scenarios
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
    "Alarm": "alarms",
    "AlarmTime": "metrics",
    "AnalysedControl": "analysed_control",
    "BoundaryRun": "delay_boundary",
    "ChargeEstimate": "event_data",
    "ChargeEstimator": "estimator",
    "ChargeEvidence": "event_data",
    "ChargeMap": "feedforward",
    "ChargeModel": "charge_model",
    "ClosedLoopRequirement": "closed_loop_requirement",
    "ClosedLoopResult": "closed_loop_result",
    "CommandLimits": "command_limits",
    "CommandViolations": "metrics",
    "Conditions": "conditions",
    "ControlStep": "controller_state",
    "ControllerChoice": "scenario",
    "ControllerDesign": "controller_design",
    "ControllerState": "controller_state",
    "CylinderParameters": "cylinder_parameters",
    "Deactivation": "operating_profile",
    "DelayBoundary": "delay_boundary",
    "DelayMargin": "delay_margin",
    "DesignedControl": "analysed_control",
    "Diagnostics": "controller_state",
    "DiskMargin": "disk_margins",
    "DiskMargins": "disk_margins",
    "EstimationCheck": "estimation_check",
    "EstimationPoint": "estimation_check",
    "EstimationResult": "estimation_check",
    "EstimatorState": "kalman_estimator",
    "EstimatorUpdate": "kalman_estimator",
    "EventLoop": "event_loop",
    "EventRecord": "event_data",
    "FAULT_KINDS": "fault_kinds",
    "FalseAlarmCount": "false_alarms",
    "FalseAlarms": "metrics",
    "Fault": "faults",
    "FaultKind": "fault_kinds",
    "FaultMonitor": "fault_monitor",
    "FaultReaction": "fault_reaction",
    "FaultRow": "fault_check",
    "FaultTable": "fault_check",
    "Feedforward": "feedforward",
    "FeedforwardCheck": "feedforward_check",
    "FeedforwardOptions": "least_loss_motion",
    "FirstEventsError": "metrics",
    "FlowShape": "measurement_response",
    "GainBreak": "gain_break",
    "GainDesign": "gain_synthesis",
    "GainSchedule": "adaptation",
    "GainSector": "adaptation_stability",
    "GangOfFour": "gang_of_four",
    "GradientAdaptation": "gradient_adaptation",
    "GrowthCheck": "confirmation",
    "Imbalance": "metrics",
    "IntegralAdaptation": "integral_adaptation",
    "KalmanAdaptation": "kalman_adaptation",
    "KalmanEstimator": "kalman_estimator",
    "LawComparison": "law_comparison",
    "LawFigures": "law_comparison",
    "LiftSchedule": "feedforward",
    "LocalResponse": "linearise",
    "LossExcess": "metrics",
    "LossReference": "loss_reference",
    "LtiAdaptation": "lti_adaptation",
    "LtiCheck": "soundness",
    "LtiLaw": "lti_synthesis",
    "METRICS": "metrics",
    "Measured": "metrics",
    "Measurement": "event_data",
    "MeasurementResponse": "measurement_response",
    "Metric": "metrics",
    "Mode": "alarms",
    "ModeFunctions": "gang_of_four",
    "ModeLoop": "event_loop",
    "ModeMargins": "disk_margins",
    "ModeShare": "metrics",
    "ModeTime": "metrics",
    "ModeVerdict": "robustness",
    "ModelPoint": "event_data",
    "MotionPath": "charge_model",
    "NominalLoop": "nominal_loop",
    "OperatingProfile": "operating_profile",
    "Operation": "false_alarms",
    "OptimalMotion": "least_loss_motion",
    "OptimalPath": "optimal_path",
    "OptimalityCertificate": "least_loss_motion",
    "Overshoot": "metrics",
    "ParameterBounds": "adaptation_laws",
    "ParameterSet": "cylinder_parameters",
    "PathPoint": "optimal_path",
    "PerformanceCase": "controller_cases",
    "PerformanceRow": "performance",
    "PerformanceTable": "performance",
    "PlantCheck": "confirmation",
    "ProfileEvents": "operating_profile",
    "PulseSum": "pulse_bank",
    "REQUIREMENTS": "requirements",
    "RecoveryBump": "metrics",
    "Replay": "replay",
    "Report": "report",
    "Requirement": "requirements",
    "RequirementResult": "requirements",
    "RobustAnalysis": "robust_analysis",
    "RobustnessResult": "robustness",
    "SampledPlantRun": "soundness",
    "SampledPlantsCheck": "soundness",
    "Scenario": "scenario",
    "ScenarioError": "scenario",
    "ScenarioResult": "scenario_result",
    "ScheduleDesign": "_schedule_design",
    "Settling": "metrics",
    "Signal": "operating_profile",
    "SpeedAnalysis": "robust_analysis",
    "StabilityMargins": "margins",
    "SteadyError": "metrics",
    "StructuredRobustness": "structured_robustness",
    "TightnessCheck": "tightness",
    "UncertainLoop": "uncertain_loop",
    "UncertainMeasurement": "uncertain_measurement",
    "ValveErrors": "closed_loop",
    "Verdict": "closed_loop_requirement",
    "WindowControl": "analysed_control",
    "WindowEstimator": "window_estimator",
    "WorstError": "metrics",
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
    "check_false_alarms": "false_alarms",
    "check_faults": "fault_check",
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
    "load_design": "model_store",
    "load_result": "scenario_result",
    "load_scenario": "scenario_toml",
    "load_scenarios": "scenario_toml",
    "local_response": "linearise",
    "loop_at_a_time": "disk_margins",
    "loss_references": "loss_reference",
    "lti_controller": "baselines",
    "measure_performance": "performance",
    "metric_from_dict": "metrics",
    "mu_optimal_law": "mu_optimal",
    "optimal_motion": "least_loss_motion",
    "path_adaptation": "controller_design",
    "performance_cases": "controller_cases",
    "random_operation": "false_alarms",
    "replay_result": "replay",
    "run_case": "performance",
    "run_load_step": "load_step",
    "run_scenario": "scenario_run",
    "save_design": "model_store",
    "scenario_design": "scenario_run",
    "shipped_scenario": "shipped",
    "shipped_scenarios": "shipped",
    "simulate": "closed_loop",
    "stability_margins": "margins",
    "standard_laws": "law_comparison",
    "stored_design": "model_store",
    "window_controller": "window_loop",
}

__all__ = [
    "FAULT_KINDS",
    "METRICS",
    "REQUIREMENTS",
    "AdaptationGains",
    "AdaptationLaw",
    "AdaptationState",
    "AdaptationStep",
    "AirChargeController",
    "Alarm",
    "AlarmTime",
    "AnalysedControl",
    "BoundaryRun",
    "ChargeEstimate",
    "ChargeEstimator",
    "ChargeEvidence",
    "ChargeMap",
    "ChargeModel",
    "ClosedLoopRequirement",
    "ClosedLoopResult",
    "CommandLimits",
    "CommandViolations",
    "Conditions",
    "ControlStep",
    "ControllerChoice",
    "ControllerDesign",
    "ControllerState",
    "CylinderParameters",
    "Deactivation",
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
    "FalseAlarmCount",
    "FalseAlarms",
    "Fault",
    "FaultKind",
    "FaultMonitor",
    "FaultReaction",
    "FaultRow",
    "FaultTable",
    "Feedforward",
    "FeedforwardCheck",
    "FeedforwardOptions",
    "FirstEventsError",
    "FlowShape",
    "GainBreak",
    "GainDesign",
    "GainSchedule",
    "GainSector",
    "GangOfFour",
    "GradientAdaptation",
    "GrowthCheck",
    "Imbalance",
    "IntegralAdaptation",
    "KalmanAdaptation",
    "KalmanEstimator",
    "LawComparison",
    "LawFigures",
    "LiftSchedule",
    "LocalResponse",
    "LossExcess",
    "LossReference",
    "LtiAdaptation",
    "LtiCheck",
    "LtiLaw",
    "Measured",
    "Measurement",
    "MeasurementResponse",
    "Metric",
    "Mode",
    "ModeFunctions",
    "ModeLoop",
    "ModeMargins",
    "ModeShare",
    "ModeTime",
    "ModeVerdict",
    "ModelPoint",
    "MotionPath",
    "NominalLoop",
    "OperatingProfile",
    "Operation",
    "OptimalMotion",
    "OptimalPath",
    "OptimalityCertificate",
    "Overshoot",
    "ParameterBounds",
    "ParameterSet",
    "PathPoint",
    "PerformanceCase",
    "PerformanceRow",
    "PerformanceTable",
    "PlantCheck",
    "ProfileEvents",
    "PulseSum",
    "RecoveryBump",
    "Replay",
    "Report",
    "Requirement",
    "RequirementResult",
    "RobustAnalysis",
    "RobustnessResult",
    "SampledPlantRun",
    "SampledPlantsCheck",
    "Scenario",
    "ScenarioError",
    "ScenarioResult",
    "ScheduleDesign",
    "Settling",
    "Signal",
    "SpeedAnalysis",
    "StabilityMargins",
    "SteadyError",
    "StructuredRobustness",
    "TightnessCheck",
    "UncertainLoop",
    "UncertainMeasurement",
    "ValveErrors",
    "Verdict",
    "WindowControl",
    "WindowEstimator",
    "WorstError",
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
    "check_false_alarms",
    "check_faults",
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
    "load_design",
    "load_result",
    "load_scenario",
    "load_scenarios",
    "local_response",
    "loop_at_a_time",
    "loss_references",
    "lti_controller",
    "measure_performance",
    "metric_from_dict",
    "mu_optimal_law",
    "optimal_motion",
    "path_adaptation",
    "performance_cases",
    "random_operation",
    "replay_result",
    "run_case",
    "run_load_step",
    "run_scenario",
    "save_design",
    "scenario_design",
    "shipped_scenario",
    "shipped_scenarios",
    "simulate",
    "stability_margins",
    "standard_laws",
    "stored_design",
    "window_controller",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
