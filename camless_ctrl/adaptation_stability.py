"""Checks of the stability argument of the adaptation laws: `docs/adaptation.md`.

Two arguments, both this project's own use of standard results. With an ideal measurement a
Lyapunov function of the parameter error does not increase. Through lag, delay and overlap the loop
of constant gains is analysed (`EventLoop`, mu), and gains that vary around them in time are held
by the small-gain theorem: with ``e`` the measured error, own gains within ``1 +- r`` and shared
ones within ``1 +- r`` of the constant ones add ``w_1 = d_1 e`` and ``w_2 = d_2 e``, and

    e = -M_1 w_1 - M_2 w_2,   M_1 + M_2 = T,

so that the loop is stable for all of them if ``r (|M_1| + |M_2|) < 1``, each the largest over the
circle. Where mean and imbalance have one gain, this is ``r |T| < 1``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant._checks import positive
from plant.errors import ParameterError
from plant.kinematics import FloatArray

from .adaptation import AdaptationGains
from .adaptation_laws import AdaptationLaw, AdaptationState
from .cylinder_parameters import ParameterSet
from .estimator import ChargeEstimator
from .event_data import ChargeEvidence
from .event_loop import EventLoop
from .uncertain_loop import SENSITIVITY_BOUND

TIME_CONSTANTS = (10e-3, 15e-3, 20e-3)  # of the assumed sensors, s
DELAYS = (0.0, 1e-3, 3e-3)  # s
SENSITIVITIES = (0.9, 1.0, 1.1)  # true over assumed slope of the charge, 1
_POINTS = 4000  # of the half circle; even, so that none lies where the law is infinite


def lyapunov_value(
    state: AdaptationState, true: ParameterSet, *, offset_scale: float = 1e-3
) -> float:
    """Sum over cylinders of squared parameter errors.

    Parameters
    ----------
    state : AdaptationState
        What has been learnt.
    true : ParameterSet
        What there is to learn.
    offset_scale : float
        Error of a duration offset that weighs like one of 1 in a logarithm, s.
    """
    scale = positive("offset_scale", offset_scale, "s")
    log_gain = np.subtract(state.log_flow_gain, np.log(true.flow_gain))
    offset = np.subtract(state.duration_offset, true.duration_offset) / scale
    factor = np.subtract(state.log_charge_factor, np.log(true.charge_factor))
    return float(log_gain @ log_gain + offset @ offset + factor @ factor)


def weighted_value(state: AdaptationState, true: ParameterSet) -> float:
    """Squared parameter errors weighed with the inverse of the covariance of a Kalman law.

    Where the law learns a charge factor, it is one that all cylinders share, told by the first.
    """
    P = np.asarray(state.memory.covariance)
    factor = np.subtract(state.log_charge_factor, np.log(true.charge_factor))
    error = np.concatenate(
        (
            np.subtract(state.log_flow_gain, np.log(true.flow_gain)),
            np.subtract(state.duration_offset, true.duration_offset),
            factor[: len(P) - 2 * state.n_cylinders],
        )
    )
    size = np.sqrt(np.diag(P))  # of different units: scaled for the solution
    return float((error / size) @ np.linalg.solve(P / size[:, None] / size, error / size))


@dataclass(frozen=True, slots=True)
class GainSector:
    """How far gains may vary in time around constant ones, whatever the sensor of a set is.

    Attributes
    ----------
    speed_rpm : float
        Speed.
    gains : AdaptationGains
        Constant gains that were analysed.
    stable : bool
        Whether the loop of constant gains is stable for every sensor; if not, the peaks are
        infinite.
    peak : float
        Largest ``|T|`` over circle and sensors, 1.
    own_peak, shared_peak : float
        Largest ``|M_1|`` and ``|M_2|``, 1.
    sensors : int
        Number of combinations of lag, delay and sensitivity.
    """

    speed_rpm: float
    gains: AdaptationGains
    stable: bool
    peak: float
    own_peak: float
    shared_peak: float
    sensors: int

    @property
    def together(self) -> float:
        """Largest relative variation of both gains by one factor, 1."""
        return 1.0 / self.peak

    @property
    def apart(self) -> float:
        """Largest relative variation of own and shared gain, each by a factor of its own, 1."""
        return 1.0 / (self.own_peak + self.shared_peak)

    def __str__(self) -> str:
        """Return the sector in a sentence."""
        at = (
            f"{self.speed_rpm:g} rpm, gains {self.gains.mean:.3f} (mean) and "
            f"{self.gains.imbalance:.3f} (imbalance)"
        )
        if not self.stable:
            return f"{at}: unstable for some sensor"
        return (
            f"{at}: both may vary by +-{100.0 * self.together:.0f} % together, each by "
            f"+-{100.0 * self.apart:.0f} %"
        )


def gain_sector(
    speed_rpm: float,
    gains: AdaptationGains,
    *,
    estimator: ChargeEstimator | None = None,
    n_cylinders: int = 4,
    time_constants: Sequence[float] = TIME_CONSTANTS,
    delays: Sequence[float] = DELAYS,
    sensitivities: Sequence[float] = SENSITIVITIES,
) -> GainSector:
    """Return the small-gain bound on gains that vary in time.

    Parameters
    ----------
    speed_rpm : float
        Speed.
    gains : AdaptationGains
        Constant gains per cycle.
    estimator : ChargeEstimator, optional
        Estimator with the lag and delay that it assumes.
    n_cylinders : int
        Number of cylinders.
    time_constants, delays : sequence of float
        Lags and transport delays that the MAF sensor may have, s.
    sensitivities : sequence of float
        True over assumed sensitivities of the charge, 1.
    """
    window = estimator or ChargeEstimator()
    peaks = [
        loop_peaks(
            EventLoop.at_speed(
                speed_rpm,
                window,
                gains,
                n_cylinders=n_cylinders,
                time_constant=lag,
                delay=delay,
                sensitivity=sensitivity,
            )
        )
        for lag in time_constants
        for delay in delays
        for sensitivity in sensitivities
    ]
    peak, own, shared = np.max(peaks, axis=0).tolist()
    return GainSector(speed_rpm, gains, math.isfinite(peak), peak, own, shared, len(peaks))


def proved_sector(sensitivity_bound: float = SENSITIVITY_BOUND) -> float:
    """Relative variation of both gains that a proved bound on ``|S|`` allows by itself.

    Robust performance (mu below 1) proves ``|S|`` for every member of the uncertain set, and
    ``|T| = |1 - S|`` is at most one more.
    """
    return 1.0 / (1.0 + positive("sensitivity_bound", sensitivity_bound, "1"))


def loop_peaks(loop: EventLoop) -> tuple[float, float, float]:
    """Largest ``|T|``, ``|M_1|`` and ``|M_2|`` over the circle; infinite if unstable."""
    if not np.all(np.abs(loop.poles()) < 1.0) and loop.gains.mean > 0.0:
        return math.inf, math.inf, math.inf
    # Between the angles of the modes, where the law is infinite.
    z = np.exp(1j * np.pi * (np.arange(_POINTS) + 0.5) / _POINTS)
    n, gains = loop.n_cylinders, loop.gains
    seen = loop.sensitivity * z**-loop.latency * loop.measurement(z)
    own = gains.imbalance * z ** -(-loop.latency % n) / (1.0 - z**-n)
    shared = (gains.mean - gains.imbalance) / n / (1.0 - 1.0 / z)
    sensitivity = 1.0 / (1.0 + seen * (own + shared))
    found = [np.abs(seen * part * sensitivity).max() for part in (own + shared, own, shared)]
    return float(found[0]), float(found[1]), float(found[2])


def gain_limit(loop: EventLoop, most: float = 100.0) -> float:
    """Constant factor on both gains at which the loop is first unstable, up to `most`."""
    if _stable(loop, most):
        return math.inf
    low, high = 0.0, most
    for factor in np.geomspace(1e-2, most, 200):
        if not _stable(loop, float(factor)):
            high = float(factor)
            break
        low = float(factor)
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _stable(loop, middle) else (low, middle)
    return high


def varied_response(
    loop: EventLoop, disturbance: ArrayLike, own: ArrayLike, shared: ArrayLike
) -> FloatArray:
    """Charge error of each event with gains that vary from event to event.

    Parameters
    ----------
    loop : EventLoop
        Loop of constant gains.
    disturbance : array_like (m,)
        Relative charge error of each event without correction.
    own, shared : array_like (m,)
        Factors on the own and on the shared part of the gain at each event.

    Returns
    -------
    ndarray (m,)
        Relative charge errors that are left.
    """
    A, B, C = loop.measurement.matrices(loop.latency)
    n, gains = loop.n_cylinders, loop.gains
    x, correction = np.zeros((len(A), 1)), np.zeros(n)
    error = np.array(disturbance, dtype=float)
    for k, (one, all_) in enumerate(
        zip(np.asarray(own, float), np.asarray(shared, float), strict=True)
    ):
        estimate = float((C @ x).item())
        correction += all_ * (gains.mean - gains.imbalance) / n * estimate
        correction[(k - loop.latency) % n] += one * gains.imbalance * estimate
        error[k] -= loop.sensitivity * correction[k % n]
        x = A @ x + B * error[k]
    return error


class GainRange(NamedTuple):
    """Constant gains in the middle of a range, and how far it reaches around them."""

    centre: AdaptationGains
    spread: float  # relative, of own and of shared gain, 1


def gain_range(gains: Iterable[AdaptationGains]) -> GainRange:
    """Return the middle of gains and the largest relative distance from it.

    Own gain and shared gain are each taken between their least and their largest value.
    """
    found = np.array([(g.imbalance, g.mean - g.imbalance) for g in gains])
    if not found.size:
        raise ParameterError("gains is empty, but must hold at least one pair of gains")
    low, high = found.min(axis=0), found.max(axis=0)
    own, shared = (0.5 * (low + high)).tolist()
    reach, middle = 0.5 * (high - low), 0.5 * np.abs(high + low)
    spread = np.divide(reach, middle, out=np.where(reach > 0.0, np.inf, 0.0), where=middle > 0.0)
    return GainRange(AdaptationGains(own + shared, own), float(spread.max()))


def compensation_size(gains: AdaptationGains, n_cylinders: int, latency: int) -> float:
    """Size of the dynamics that current parameters in the residual add to the gains, 1.

    A residual formed with the current parameters takes off what the events between command and
    estimate have moved already, ``latency - 1`` times the shared gain. The law is that of
    `EventLoop` after ``1/(1 + a (z^-1 + ... + z^-(latency-1)))``, whose distance from 1 this is.
    """
    part = abs(gains.mean - gains.imbalance) / n_cylinders * (latency - 1)
    return part / (1.0 - part) if part < 1.0 else math.inf


def moved_charge(
    law: AdaptationLaw, state: AdaptationState, evidence: ChargeEvidence, step: float = 1e-4
) -> AdaptationGains:
    """Gains with which a law moves the predicted charge in a given state, by a small error.

    Parameters
    ----------
    law, state : AdaptationLaw, AdaptationState
        The law and its state.
    evidence : ChargeEvidence
        Event; its charge error is taken `step` larger, and what that moves is told.
    step : float
        Charge error, 1.
    """
    without = law.update(state, evidence).state
    with_step = law.update(state, evidence._replace(log_ratio=evidence.log_ratio + step)).state
    moved = (
        evidence.flow_slope * np.subtract(with_step.log_flow_gain, without.log_flow_gain)
        + evidence.duration_slope * np.subtract(with_step.duration_offset, without.duration_offset)
        + np.subtract(with_step.log_charge_factor, without.log_charge_factor)
    ) / step
    i, n = evidence.cylinder - 1, moved.size
    if n == 1:
        return AdaptationGains(float(moved[0]), float(moved[0]))
    others = float(np.delete(moved, i).mean())
    return AdaptationGains(float(moved.sum()), float(moved[i]) - others)


def _stable(loop: EventLoop, factor: float) -> bool:
    scaled = EventLoop(
        loop.n_cylinders,
        loop.measurement,
        loop.gains.scaled(factor),
        loop.latency,
        loop.sensitivity,
    )
    return bool(np.all(np.abs(scaled.poles()) < 1.0))
