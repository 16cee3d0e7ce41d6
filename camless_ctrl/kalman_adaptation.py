"""Recursive least squares as a random-walk Kalman filter; the law is this project's own.

The state of the filter holds ``ln g`` and the duration offset ``d`` of every cylinder, and the
logarithm ``c`` of a charge factor that all share: air density that the model does not know, the
intake temperature above all. All walk at random, gains and offsets each cylinder by itself and all
in common, and so does what is believed of them at the start: an error of one cylinder tells of the
others as far as they share it. An event measures

    ln(estimated/predicted charge) = s_g (ln g - ln g_used) + (1 - w) s_d (d - d_used)
                                     + c - c_used + noise
    measured - commanded duration  = d + noise,

the two noises uncorrelated by the assumption of `adaptation_laws`, where ``w`` is explained.
What was used is part of the equation, so that it does not matter how long ago the command was.

- *Forgetting*: the walk, and an exponential one on request. *Limits of the covariance*: no
  variance above its prior one is used, and none falls below one event's walk.
- *Outliers*: beyond `gate` standard deviations the noise of an event is taken as so large that it
  moves what `gate` would, however large it is, and is trusted that much less.
- *Sudden changes*: normalised innovations, limited one by one, are summed with a fading memory
  for each cylinder and for all events. No single one reaches the threshold, but two or three in a
  row with one sign do. Then the covariance grows, of the one cylinder towards its prior or of
  all by what they have in common, just as far as makes the innovation likely.
- *Excitation*: a parameter on which the events of the recent memory say less than the prior
  does not move by the charge error; its doubt counts as noise. Where data determine only a
  combination (flow or duration, no measured duration, one operating point; density or all
  flows, one flow slope), that combination moves, shared out by the prior covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plant._checks import in_range, positive, replace_fields
from plant.kinematics import FloatArray

from . import _kalman_update as algebra
from ._kalman_projection import projected_state
from ._kalman_update import KalmanMemory, Workspace, structured
from .adaptation import AdaptationGains
from .adaptation_laws import (
    AdaptationState,
    AdaptationStep,
    ParameterBounds,
    initial_state,
    screened,
    state_from_dict,
    state_to_dict,
)
from .cylinder_parameters import ParameterSet
from .event_data import ChargeEvidence

_NAME = "Kalman"
# Sums of normalised innovations: the share that is left at the next event that enters, and the
# size above which one is no chance: above four standard deviations, and more than one event can
# reach unless others already lean its way.
_OWN_FADE, _OWN_THRESHOLD = 0.7, 5.8  # of one cylinder's charge or duration
_COMMON_FADE, _COMMON_THRESHOLD = 0.5, 5.0  # of all charges
_LARGEST = 3.5  # normalised innovation that enters them, at most
_LEAST_VARIANCE = 1e-6  # of a charge error: no estimate is surer than 0.1 %


@dataclass(frozen=True, slots=True)
class KalmanAdaptation:
    """Random-walk Kalman filter on flow gains, duration offsets and a common charge factor.

    Parameters
    ----------
    bounds : ParameterBounds
        Projection set.
    common_flow, individual_flow : float
        Prior standard deviation of ln flow gain: of all cylinders in common, of each, 1.
    common_offset, individual_offset : float
        The same of the duration offset, s.
    common_flow_walk, flow_walk : float
        Standard deviation of the walk of ln flow gain in one cycle, 1.
    common_offset_walk, offset_walk : float
        The same of the duration offset, s.
    duration_noise : float
        Standard deviation of a measured duration around the valve's mean one: jitter and
        measurement, s.
    duration_share : float
        ``w``: share of jitter in that variance.
    charge_spread : float
        Prior standard deviation of the logarithm of the charge factor that all cylinders share, 1.
        With 0 it is not learnt.
    charge_walk : float
        Standard deviation of its walk in one cycle, 1.
    forgetting : float
        Factor on the information per cycle; 1 leaves forgetting to the walk.
    gate : float
        Normalised innovation beyond which an event counts less.
    memory_cycles : float
        Cycles over which information counts as recent.
    least_information : float
        Recent information over that of the prior below which a parameter is held.
    """

    bounds: ParameterBounds = field(default_factory=ParameterBounds)
    common_flow: float = 0.15
    individual_flow: float = 0.08
    common_offset: float = 0.05e-3  # s
    individual_offset: float = 0.1e-3  # s
    common_flow_walk: float = 1.0e-3
    flow_walk: float = 1.3e-3
    common_offset_walk: float = 1e-6  # s
    offset_walk: float = 3e-6  # s
    duration_noise: float = 0.0707e-3  # s
    duration_share: float = 0.5
    charge_spread: float = 0.05
    charge_walk: float = 5e-4
    forgetting: float = 1.0
    gate: float = 3.0
    memory_cycles: float = 20.0
    least_information: float = 1.0
    _work: dict[int, Workspace] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("individual_flow", "flow_walk"):
            in_range(name, getattr(self, name), 0.0, 1.0, "1", open_low=True)
        for name in ("common_flow", "common_flow_walk", "charge_spread", "charge_walk"):
            in_range(name, getattr(self, name), 0.0, 1.0, "1")
        for name in ("individual_offset", "offset_walk", "duration_noise"):
            in_range(name, getattr(self, name), 0.0, 1e-2, "s", open_low=True)
        for name in ("common_offset", "common_offset_walk"):
            in_range(name, getattr(self, name), 0.0, 1e-2, "s")
        in_range("duration_share", self.duration_share, 0.0, 1.0, "1")
        in_range("forgetting", self.forgetting, 0.5, 1.0, "1")
        in_range("gate", self.gate, 1.0, 100.0, "1")
        in_range("memory_cycles", self.memory_cycles, 1.0, 1e6, "cycles")
        in_range("least_information", self.least_information, 0.0, 1e6, "1")

    def replace(self, **changes: object) -> KalmanAdaptation:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def prior_covariance(self, n_cylinders: int) -> FloatArray:
        """Covariance (m, m) at the start, the limit of later ones: see `KalmanMemory`."""
        flow = self.individual_flow, self.common_flow
        offset = self.individual_offset, self.common_offset
        return structured(n_cylinders, flow, offset, self.charge_spread, self.charge_spread > 0.0)

    def walk_covariance(self, n_cylinders: int) -> FloatArray:
        """Covariance (m, m) that the walk of one event adds."""
        flow = self.flow_walk, self.common_flow_walk
        offset = self.offset_walk, self.common_offset_walk
        cycle = structured(n_cylinders, flow, offset, self.charge_walk, self.charge_spread > 0.0)
        return cycle / n_cylinders

    def steady_gains(
        self, variance: float, flow_slope: float, n_cylinders: int = 4
    ) -> AdaptationGains:
        """Gains per cycle with which the converged filter moves the predicted charge.

        They solve the Riccati equation of one cycle in which each cylinder is measured once, with
        the offsets known. It falls apart into the mean and the imbalance modes, each a scalar
        equation.

        Parameters
        ----------
        variance : float
            Of the charge error of an event, 1.
        flow_slope : float
            ``d ln charge/d ln flow_gain``, 1.
        n_cylinders : int
            Number of cylinders.
        """
        R = positive("variance", variance, "1")
        own, common = (flow_slope * self.flow_walk) ** 2, (flow_slope * self.common_flow_walk) ** 2
        common += self.charge_walk**2 if self.charge_spread else 0.0
        return AdaptationGains(
            algebra.steady_gain(own + n_cylinders * common, R, self.forgetting),
            algebra.steady_gain(own, R, self.forgetting),
        )

    def start(self, n_cylinders: int, parameters: ParameterSet | None = None) -> AdaptationState:
        """Return the state before any evidence, from given or nominal parameters."""
        state = initial_state(self.bounds, n_cylinders, parameters)
        n = state.n_cylinders
        P = self.prior_covariance(n)
        return algebra.with_memory(state, P, (0.0,) * len(P), (0.0,) * (2 * n + 1))

    def update(self, state: AdaptationState, evidence: ChargeEvidence) -> AdaptationStep:
        """Return the state after the evidence of one event.

        Charge error or duration error may be missing.
        """
        n = len(state.log_flow_gain)
        charge, duration = screened(evidence, n)
        has_charge, has_duration = charge == charge, duration == duration
        if not (has_charge or has_duration):
            return AdaptationStep(state, charge)
        work = self._work.get(n) or self._workspace(n)
        x, P, known, sums = state.memory
        information, scores = list(known), list(sums)
        i = evidence.cylinder - 1
        j, k = n + i, 2 * n
        learnt = k < len(information)  # whether the charge factor is a state
        prior_g, prior_d, prior_c = work.variances
        walk, factor, (walk_g, walk_d, walk_c) = work.walk, work.factor, work.walks
        place, kernel = k if learnt else i, algebra.kernel()
        p_g, p_d = P.item(i, i) * factor + walk_g, P.item(j, j) * factor + walk_d
        p_c = P.item(k, k) * factor + walk_c if learnt else 0.0
        if p_g > prior_g or p_d > prior_d or p_c > prior_c:
            P = kernel.grown(P, walk, factor, work.prior, i, j, place)
            walk, factor = work.still, 1.0
            p_g, p_d, p_c = P.item(i, i), P.item(j, j), P.item(k, k) if learnt else 0.0
        p_gd = P.item(i, j) * factor

        # Innovations against what is believed now, whatever the command was made with, and the
        # information on each parameter in the recent memory.
        used, (keep, keep_c) = evidence.used, work.kept
        known_g, known_d = keep * information[i], keep * information[j]
        known_c = keep_c * information[k] if learnt else 0.0
        s_g = s_d = s_c = spread = spread_d = size = size_d = noise = noise_d = 0.0
        offset = state.duration_offset[i]
        if has_duration:
            duration -= offset
            noise_d = self.duration_noise**2
            spread_d = p_d + noise_d
            size_d = duration / math.sqrt(spread_d)
            known_d += 1.0 / noise_d
        if has_charge:
            s_g, s_d = float(evidence.flow_slope), float(evidence.duration_slope)
            if has_duration:
                s_d *= 1.0 - self.duration_share
            charge -= s_g * (state.log_flow_gain[i] - math.log(used.flow_gain))
            charge -= s_d * (offset - float(used.duration_offset))
            charge -= state.log_charge_factor[i] - math.log(used.charge_factor)
            noise = float(evidence.variance)
            if noise < _LEAST_VARIANCE:
                noise = _LEAST_VARIANCE
            known_g += s_g * s_g / noise
            known_d += s_d * s_d / noise
            known_c += 1.0 / noise
        least = self.least_information
        determined_g, determined_d = known_g * prior_g >= least, known_d * prior_d >= least
        determined_c = not learnt or known_c * prior_c >= least
        information[i], information[j] = known_g, known_d
        if learnt:
            information[k] = known_c
        if has_charge:
            if not determined_g:
                noise, s_g = noise + s_g * s_g * p_g, 0.0
            if not determined_d:
                noise, s_d = noise + s_d * s_d * p_d, 0.0
            shared = 0.0  # what the doubt about the charge factor adds
            if learnt and determined_c:
                s_c = 1.0
                shared = p_c + 2.0 * factor * (s_g * P.item(i, k) + s_d * P.item(j, k))
            else:
                noise += p_c
            spread = s_g * s_g * p_g + 2.0 * s_g * s_d * p_gd + s_d * s_d * p_d + shared + noise
            size = charge / math.sqrt(spread)
            entering = _LARGEST if size > _LARGEST else -_LARGEST if size < -_LARGEST else size
            scores[i] = _OWN_FADE * scores[i] + entering
            scores[-1] = _COMMON_FADE * scores[-1] + entering
        if has_duration:
            scores[j] = _OWN_FADE * scores[j] + min(max(size_d, -_LARGEST), _LARGEST)

        # What persists renews the doubt; what does not counts less if it lies far out.
        common = abs(scores[-1]) > _COMMON_THRESHOLD
        reset = common or abs(scores[i]) > _OWN_THRESHOLD or abs(scores[j]) > _OWN_THRESHOLD
        if reset:
            P, walk, factor = P * factor + walk, work.still, 1.0
            if common:
                more = (s_g * self.common_flow) ** 2 + (s_d * self.common_offset) ** 2
                share = algebra.share_of_doubt(charge, spread, spread + more + s_c * prior_c)
                P = algebra.limited(P + share * work.common, work.prior)
            else:
                likely = s_g * s_g * prior_g + s_d * s_d * prior_d + noise
                share = algebra.share_of_doubt(charge, spread, likely + s_c * p_c)
                if has_duration:
                    share = max(
                        share, algebra.share_of_doubt(duration, spread_d, prior_d + noise_d)
                    )
                P = algebra.renewed(P, (i, j), share, work.prior)
            scores[i] = scores[j] = scores[-1] = 0.0
        else:
            if size > self.gate or size < -self.gate:
                noise += spread * (abs(size) / self.gate - 1.0)
            if size_d > self.gate or size_d < -self.gate:
                noise_d += spread_d * (abs(size_d) / self.gate - 1.0)

        x, P, outside = kernel.update(
            x, P, walk, factor, i, j, place,
            has_charge, s_g, s_d, s_c, charge, noise, has_duration, duration, noise_d,
            work.bounds,
        )  # fmt: skip
        after, projected = projected_state(self.bounds, outside, x, P, state, information, scores)
        moved = (
            after.log_flow_gain != state.log_flow_gain
            or after.duration_offset != state.duration_offset
            or after.log_charge_factor != state.log_charge_factor
        )
        determined = determined_g and determined_d and determined_c
        return AdaptationStep(after, charge, projected, moved, determined, reset)

    def excitation(self, state: AdaptationState) -> FloatArray:
        """Recent information on each parameter over that of its prior, (3, n).

        Flow gains first, then duration offsets, then the charge factor that all share (0 where
        it is not learnt); below `least_information` one is held.
        """
        prior = np.diag(self.prior_covariance(state.n_cylinders))
        return algebra.by_parameter(np.asarray(state.memory.information) * prior, state.n_cylinders)

    def deviations(self, state: AdaptationState) -> FloatArray:
        """Standard deviations (3, n) of ln flow gain (1), duration offset (s), ln factor (1)."""
        found = np.sqrt(np.diag(state.memory.covariance))
        return algebra.by_parameter(found, state.n_cylinders)

    def to_dict(self, state: AdaptationState) -> dict[str, Any]:
        """Return a state as plain lists and numbers, for JSON."""
        memory: KalmanMemory = state.memory
        return state_to_dict(
            _NAME,
            state,
            covariance=memory.covariance.tolist(),
            information=list(memory.information),
            scores=list(memory.scores),
        )

    def from_dict(self, data: Mapping[str, Any]) -> AdaptationState:
        """Return the state of `to_dict`; raises `ParameterError` for data that do not fit."""
        state = state_from_dict(_NAME, self.bounds, data, "covariance", "information", "scores")
        n = state.n_cylinders
        m = 2 * n + bool(self.charge_spread)
        P = algebra.covariance_checked(algebra.numbers("covariance", data["covariance"], (m, m)))
        information = algebra.numbers("information", data["information"], (m,))
        scores = algebra.numbers("scores", data["scores"], (2 * n + 1,))
        return algebra.with_memory(state, P, tuple(information.tolist()), tuple(scores.tolist()))

    def _workspace(self, n: int) -> Workspace:
        """Return the workspace for n cylinders, made at its first use."""
        prior, walk = self.prior_covariance(n), self.walk_covariance(n)
        shared = (0.0, self.common_flow), (0.0, self.common_offset), self.charge_spread
        common = structured(n, *shared, self.charge_spread > 0.0)
        factor = self.forgetting ** (-1.0 / n)
        return self._work.setdefault(
            n, algebra.workspace(n, prior, walk, common, factor, self.memory_cycles, self.bounds)
        )
