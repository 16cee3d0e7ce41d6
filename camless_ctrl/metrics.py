"""The metrics that requirements on closed-loop runs are stated with, by kind."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from plant._checks import one_of
from plant.errors import ParameterError

from ._metric import Measured, Metric
from ._metric_alarms import AlarmTime, FalseAlarms
from ._metric_commands import CommandViolations
from ._metric_errors import FirstEventsError, SteadyError, WorstError
from ._metric_imbalance import Imbalance
from ._metric_loss import LossExcess
from ._metric_modes import ModeShare, ModeTime, RecoveryBump
from ._metric_settling import Overshoot, Settling

__all__ = [
    "METRICS",
    "AlarmTime",
    "CommandViolations",
    "FalseAlarms",
    "FirstEventsError",
    "Imbalance",
    "LossExcess",
    "Measured",
    "Metric",
    "ModeShare",
    "ModeTime",
    "Overshoot",
    "RecoveryBump",
    "Settling",
    "SteadyError",
    "WorstError",
    "metric_from_dict",
]

METRICS: Mapping[str, type[Metric]] = MappingProxyType(
    {
        metric.kind: metric
        for metric in (
            Settling,
            Overshoot,
            SteadyError,
            WorstError,
            FirstEventsError,
            Imbalance,
            LossExcess,
            CommandViolations,
            AlarmTime,
            FalseAlarms,
            ModeShare,
            ModeTime,
            RecoveryBump,
        )
    }
)


def metric_from_dict(data: Mapping[str, Any]) -> Metric:
    """Make a metric of plain data: ``kind``, and the parameters of that kind.

    Raises
    ------
    ParameterError
        For a missing or unknown kind, an unknown or missing parameter, or a value out of range.
    """
    if "kind" not in data:
        raise ParameterError(f"kind is missing: give one of {', '.join(METRICS)}")
    return METRICS[one_of("kind", data["kind"], METRICS)].from_dict(data)
