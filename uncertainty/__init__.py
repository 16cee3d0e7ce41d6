"""Uncertainty of the mean-value plant: how wrong it is, where, at which frequency, and why.

The names below are loaded on first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .attribution import attribute
    from .attribution_result import SobolIndex, SobolResult
    from .channels import Channel, ChannelUncertainty
    from .combined_deltas import CombinedResult, JointDelta, JointResult, SumDelta
    from .coverage import (
        FreshCheck,
        ScoreBound,
        bound_from_scores,
        check_fresh,
        confidence_of,
        covered_share,
        samples_needed,
    )
    from .delta import Case, Delta, Nominal, PlantDelta
    from .delta_result import DeltaResult, WorstChange
    from .deltas import AllDeltas, default_deltas, evaluate_all
    from .disks import CoveringDisks, DiskGain, smallest_disks
    from .frequency import LiftedResponse, ModeResponses
    from .lifted_full_plant import full_plant_response
    from .lifted_mean_value import mean_value_modes, mean_value_response
    from .local_attribution import TornadoBar, TornadoResult, tornado
    from .parameters import UncertainParameter, UncertaintySet
    from .perturbed import PerturbedPlants
    from .plant_deltas import ActuatorOscillationDelta, HelmholtzDelta, ParametricDelta
    from .pulse_sampling import SampledPulses, sampled_pulses
    from .quantification import default_set, quantify
    from .quantification_result import Quantification
    from .residuals import Residual, residual
    from .sampled_responses import sampled_mode_responses
    from .sampled_result import SampledResiduals, SampledResponses
    from .sampling import Sample, corners, draw, nominal_sample, one_at_a_time
    from .section_six import figure_11, figure_12, figure_13, figure_14
    from .section_six_result import (
        LoopComparison,
        MotionComparison,
        RunnerComparison,
        SectionSixFigure,
    )
    from .sensor_delta import ModeChanges, SensorDelta
    from .weight_result import OverboundingWeight, WeightCheck, WeightTable
    from .weights import fit_weight, fit_weights

_HOME = {
    "ActuatorOscillationDelta": "plant_deltas",
    "AllDeltas": "deltas",
    "Case": "delta",
    "Channel": "channels",
    "ChannelUncertainty": "channels",
    "CombinedResult": "combined_deltas",
    "CoveringDisks": "disks",
    "Delta": "delta",
    "DeltaResult": "delta_result",
    "DiskGain": "disks",
    "FreshCheck": "coverage",
    "HelmholtzDelta": "plant_deltas",
    "JointDelta": "combined_deltas",
    "JointResult": "combined_deltas",
    "LiftedResponse": "frequency",
    "LoopComparison": "section_six_result",
    "ModeChanges": "sensor_delta",
    "ModeResponses": "frequency",
    "MotionComparison": "section_six_result",
    "Nominal": "delta",
    "OverboundingWeight": "weight_result",
    "ParametricDelta": "plant_deltas",
    "PerturbedPlants": "perturbed",
    "PlantDelta": "delta",
    "Quantification": "quantification_result",
    "Residual": "residuals",
    "RunnerComparison": "section_six_result",
    "Sample": "sampling",
    "SampledPulses": "pulse_sampling",
    "SampledResiduals": "sampled_result",
    "SampledResponses": "sampled_result",
    "ScoreBound": "coverage",
    "SectionSixFigure": "section_six_result",
    "SensorDelta": "sensor_delta",
    "SobolIndex": "attribution_result",
    "SobolResult": "attribution_result",
    "SumDelta": "combined_deltas",
    "TornadoBar": "local_attribution",
    "TornadoResult": "local_attribution",
    "UncertainParameter": "parameters",
    "UncertaintySet": "parameters",
    "WeightCheck": "weight_result",
    "WeightTable": "weight_result",
    "WorstChange": "delta_result",
    "attribute": "attribution",
    "bound_from_scores": "coverage",
    "check_fresh": "coverage",
    "confidence_of": "coverage",
    "corners": "sampling",
    "covered_share": "coverage",
    "default_deltas": "deltas",
    "default_set": "quantification",
    "draw": "sampling",
    "evaluate_all": "deltas",
    "figure_11": "section_six",
    "figure_12": "section_six",
    "figure_13": "section_six",
    "figure_14": "section_six",
    "fit_weight": "weights",
    "fit_weights": "weights",
    "full_plant_response": "lifted_full_plant",
    "mean_value_modes": "lifted_mean_value",
    "mean_value_response": "lifted_mean_value",
    "nominal_sample": "sampling",
    "one_at_a_time": "sampling",
    "quantify": "quantification",
    "residual": "residuals",
    "sampled_mode_responses": "sampled_responses",
    "sampled_pulses": "pulse_sampling",
    "samples_needed": "coverage",
    "smallest_disks": "disks",
    "tornado": "local_attribution",
}

__all__ = [
    "ActuatorOscillationDelta",
    "AllDeltas",
    "Case",
    "Channel",
    "ChannelUncertainty",
    "CombinedResult",
    "CoveringDisks",
    "Delta",
    "DeltaResult",
    "DiskGain",
    "FreshCheck",
    "HelmholtzDelta",
    "JointDelta",
    "JointResult",
    "LiftedResponse",
    "LoopComparison",
    "ModeChanges",
    "ModeResponses",
    "MotionComparison",
    "Nominal",
    "OverboundingWeight",
    "ParametricDelta",
    "PerturbedPlants",
    "PlantDelta",
    "Quantification",
    "Residual",
    "RunnerComparison",
    "Sample",
    "SampledPulses",
    "SampledResiduals",
    "SampledResponses",
    "ScoreBound",
    "SectionSixFigure",
    "SensorDelta",
    "SobolIndex",
    "SobolResult",
    "SumDelta",
    "TornadoBar",
    "TornadoResult",
    "UncertainParameter",
    "UncertaintySet",
    "WeightCheck",
    "WeightTable",
    "WorstChange",
    "attribute",
    "bound_from_scores",
    "check_fresh",
    "confidence_of",
    "corners",
    "covered_share",
    "default_deltas",
    "default_set",
    "draw",
    "evaluate_all",
    "figure_11",
    "figure_12",
    "figure_13",
    "figure_14",
    "fit_weight",
    "fit_weights",
    "full_plant_response",
    "mean_value_modes",
    "mean_value_response",
    "nominal_sample",
    "one_at_a_time",
    "quantify",
    "residual",
    "sampled_mode_responses",
    "sampled_pulses",
    "samples_needed",
    "smallest_disks",
    "tornado",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
