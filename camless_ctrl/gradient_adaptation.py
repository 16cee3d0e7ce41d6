"""Normalised gradient with projection and dead zone; the law is this project's own.

With ``e`` the charge error of an event relative to what was predicted with the parameters of
its command, and ``s`` the slope of ln charge over ln flow gain, the gradient of ``e^2`` moves

    ln g  by  gain e s/(s^2 + c),

so that the predicted charge moves by ``gain e`` where the slope is far above ``sqrt(c)``, and
nothing moves where the charge does not depend on the flow. A part that all cylinders share has a
gain of its own. The error is not renewed with what was learnt since the command: the law is the
integrator with delay of `EventLoop`, whose gains are analysed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from plant._checks import in_range, replace_fields

from .adaptation import GainSchedule
from .adaptation_laws import (
    MOST_DURATION_ERROR,
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

_NAME = "normalised gradient"


@dataclass(frozen=True, slots=True)
class GradientAdaptation:
    """Normalised gradient on flow gain and duration offset.

    Parameters
    ----------
    gains : GainSchedule
        Gains per cycle on the charge error over speed.
    duration_gain : float
        Gain per cycle on the duration error, 1.
    bounds : ParameterBounds
        Projection set.
    dead_zone : float
        Charge error below which nothing moves, 1; above, the error counts from there on.
    duration_dead_zone : float
        The same for the duration error, s.
    weak_slope : float
        ``sqrt(c)``: flow slope at which half of the gain is left, 1.
    least_slope : float
        Flow slope below which the flow gain is held, 1.
    """

    gains: GainSchedule = field(default_factory=GainSchedule)
    duration_gain: float = 0.15
    bounds: ParameterBounds = field(default_factory=ParameterBounds)
    dead_zone: float = 0.002
    duration_dead_zone: float = 5e-6  # s
    weak_slope: float = 0.05
    least_slope: float = 0.02
    _at: ScheduledGains = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        in_range("duration_gain", self.duration_gain, 0.0, 1.0, "1")
        in_range("dead_zone", self.dead_zone, 0.0, 1.0, "1")
        in_range("duration_dead_zone", self.duration_dead_zone, 0.0, MOST_DURATION_ERROR, "s")
        in_range("weak_slope", self.weak_slope, 0.0, 1.0, "1", open_low=True)
        in_range("least_slope", self.least_slope, 0.0, 1.0, "1")
        object.__setattr__(self, "_at", ScheduledGains(self.gains))

    def replace(self, **changes: object) -> GradientAdaptation:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def start(self, n_cylinders: int, parameters: ParameterSet | None = None) -> AdaptationState:
        """Return the state before any evidence, from given or nominal parameters."""
        return initial_state(self.bounds, n_cylinders, parameters)

    def effective_gain(self, flow_slope: float) -> float:
        """Share of its gain with which the law moves the predicted charge at a flow slope."""
        if abs(flow_slope) < self.least_slope:
            return 0.0
        return flow_slope**2 / (flow_slope**2 + self.weak_slope**2)

    def update(self, state: AdaptationState, evidence: ChargeEvidence) -> AdaptationStep:
        """Return the state after the evidence of one event.

        The charge error moves the flow gains, the duration error the offset of its cylinder;
        either may be missing.
        """
        gain, offset = state.log_flow_gain, state.duration_offset
        n = len(gain)
        error, duration = screened(evidence, n)
        i = evidence.cylinder - 1
        projected = determined = False
        if error == error:
            error = beyond(error, self.dead_zone)
            slope = float(evidence.flow_slope)
            determined = abs(slope) >= self.least_slope
            if determined and error != 0.0:
                step = error * slope / (slope * slope + self.weak_slope**2)
                mean, imbalance = self._at(evidence.speed_rpm)
                gain, projected = moved_and_clipped(
                    gain,
                    i,
                    imbalance * step,
                    (mean - imbalance) / n * step,
                    self.bounds.log_flow_gain,
                )
        if duration == duration:
            late = beyond(duration - float(evidence.used.duration_offset), self.duration_dead_zone)
            offset, held = moved_and_clipped(
                offset, i, self.duration_gain * late, 0.0, self.bounds.duration_offset
            )
            projected = projected or held
        if gain == state.log_flow_gain and offset == state.duration_offset:
            return AdaptationStep(state, error, projected, False, determined)
        moved = AdaptationState(gain, offset, state.log_charge_factor)
        return AdaptationStep(moved, error, projected, True, determined)

    def to_dict(self, state: AdaptationState) -> dict[str, Any]:
        """Return a state as plain lists and numbers, for JSON."""
        return state_to_dict(_NAME, state)

    def from_dict(self, data: Mapping[str, Any]) -> AdaptationState:
        """Return the state of `to_dict`; raises `ParameterError` for data that do not fit."""
        return state_from_dict(_NAME, self.bounds, data)
