"""Plain integral correction of one charge factor per cylinder: the baseline.

It takes no notice of what the charge depends on: every error is one of the charge factor, which
corrects well only around the operating point at which it was learnt. The law is this project's
own, and the simplest that holds a demand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from plant._checks import in_range, replace_fields

from .adaptation import GainSchedule
from .adaptation_laws import (
    AdaptationState,
    AdaptationStep,
    ParameterBounds,
    ScheduledGains,
    beyond,
    initial_state,
    moved_and_clipped,
    screened,
    state_from_dict,
    state_to_dict,
)
from .cylinder_parameters import ParameterSet
from .event_data import ChargeEvidence

_NAME = "integral"


@dataclass(frozen=True, slots=True)
class IntegralAdaptation:
    """Integral correction of the charge factors; durations are ignored.

    Parameters
    ----------
    gains : GainSchedule
        Gains per cycle on the charge error over speed.
    bounds : ParameterBounds
        Projection set.
    dead_zone : float
        Charge error below which nothing moves, 1.
    """

    gains: GainSchedule = field(default_factory=GainSchedule)
    bounds: ParameterBounds = field(default_factory=ParameterBounds)
    dead_zone: float = 0.0
    _at: ScheduledGains = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        in_range("dead_zone", self.dead_zone, 0.0, 1.0, "1")
        object.__setattr__(self, "_at", ScheduledGains(self.gains))

    def replace(self, **changes: object) -> IntegralAdaptation:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def start(self, n_cylinders: int, parameters: ParameterSet | None = None) -> AdaptationState:
        """Return the state before any evidence, from given or nominal parameters."""
        return initial_state(self.bounds, n_cylinders, parameters)

    def update(self, state: AdaptationState, evidence: ChargeEvidence) -> AdaptationStep:
        """Return the state after the evidence of one event."""
        factor = state.log_charge_factor
        n = len(factor)
        error, _ = screened(evidence, n)
        if error != error:
            return AdaptationStep(state, error)
        error = beyond(error, self.dead_zone)
        mean, imbalance = self._at(evidence.speed_rpm)
        factor, projected = moved_and_clipped(
            factor,
            evidence.cylinder - 1,
            imbalance * error,
            (mean - imbalance) / n * error,
            self.bounds.log_charge_factor,
        )
        if factor == state.log_charge_factor:
            return AdaptationStep(state, error, projected, False, True)
        moved = AdaptationState(state.log_flow_gain, state.duration_offset, factor)
        return AdaptationStep(moved, error, projected, True, True)

    def to_dict(self, state: AdaptationState) -> dict[str, Any]:
        """Return a state as plain lists and numbers, for JSON."""
        return state_to_dict(_NAME, state)

    def from_dict(self, data: Mapping[str, Any]) -> AdaptationState:
        """Return the state of `to_dict`; raises `ParameterError` for data that do not fit."""
        return state_from_dict(_NAME, self.bounds, data)
