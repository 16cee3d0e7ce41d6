"""What an estimator tells of one changed charge, found by feeding the estimator itself.

A window on the air flow has a response in closed form (`MeasurementResponse`). A Kalman filter on
flow and pressure has none that is worth its derivation: it learns lag and delay of the sensor, and
its gains come from a Riccati equation. So a full plant in periodic operation is shown to it
through noise-free sensors until its covariance stands still; then one event's motion is raised
in one run and lowered in another. Half the difference of the final estimates, event by event, is
the response. It holds for small changes around that operation. A filter that does not come to rest
from a cold start, as for a few sensors at high speed, begins with their lag and delay: an engine
has learnt them at lower speed. This route is this project's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from plant import MafSensor, ParameterError, PulseResponse, lag
from plant._checks import in_range, positive, whole
from plant.air_path import event_time
from plant.kinematics import FloatArray
from plant.sensors import AirSensor, MapSensor
from uncertainty.motion_pulses import FollowedPlant

from .controller_parts import Estimator
from .cylinder_parameters import CylinderParameters
from .event_data import ChargeEstimate, EventRecord, Measurement, ModelPoint
from .kalman_estimator import KalmanEstimator

SETTLING_EVENTS = 60  # after which the covariance stands still, within 1 % of the variance
FOLLOWED_EVENTS = 30  # after the change
SAMPLE_TIME = 1e-3  # s
PHASES = (0.5, 0.3, 0.7, 0.1, 0.9)  # of the samples within their interval, tried in turn
_STANDING = 0.01  # change of the variance per cycle that counts as none, relative
_DIED = 0.01  # of the largest tap, below which the last ones have to be
_DROPPED = 1e-3  # sum of the sizes of taps that are left out, of the largest tap

_USED = CylinderParameters()


class LatentEstimator(Protocol):
    """What the loop needs to know of an estimator besides its response."""

    def latency_events(self, event_time: float, /) -> int:
        """Events from an IVO to the first one at which its final estimate is used."""
        ...


@dataclass(frozen=True)
class AnalysedEstimator:
    """An estimator of the controller with the latency that it has at an operating point.

    Attributes
    ----------
    estimator : Estimator
        The estimator.
    latency : int
        Events from an IVO to the first one at which its final estimate is used.
    """

    estimator: Estimator
    latency: int

    def latency_events(self, event_time: float, /) -> int:
        """Return the latency, which was observed at one event time."""
        positive("event_time", event_time, "s")
        return self.latency

    def __str__(self) -> str:
        """Return kind and latency."""
        return f"{type(self.estimator).__name__}, used after {self.latency} events"


class ChangedPoint(NamedTuple):
    """What the controller believes of the motions of a `ChangedMotion`."""

    rest: ModelPoint
    raised: ModelPoint
    lowered: ModelPoint
    change: float  # relative change of the model's charge from rest to either, 1


@dataclass(frozen=True)
class EstimatorResponse:
    """Response of an estimator at one operating point.

    Attributes
    ----------
    response : PulseResponse
        Relative estimate of the events from the changed one on, over the relative change that
        the model promises.
    charge : float
        Estimate at rest, kg.
    deviation : float
        Standard deviation that the estimator tells of it, relative, 1.
    latency : int
        Events from an IVO to the first one at which its final estimate is used.
    standing : float
        Change of the variance over the last cycle before the change, relative.
    phase : float
        Place of the samples within their interval with which this was found, 1: not the first
        of `PHASES` where the estimator did not come to rest with that.
    """

    response: PulseResponse
    charge: float
    deviation: float
    latency: int
    standing: float
    phase: float = PHASES[0]

    def __str__(self) -> str:
        """Return level, deviation, latency and taps."""
        taps = ", ".join(f"{tap:.4f}" for tap in self.response.taps[:4])
        return (
            f"estimate {1e6 * self.charge:.2f} mg +- {100.0 * self.deviation:.2f} %, used after "
            f"{self.latency} events; response from event {self.response.first} on: {taps} ..."
        )


def estimator_response(
    estimator: Estimator,
    plant: FollowedPlant,
    points: ChangedPoint,
    speed_rpm: float,
    n_cylinders: int,
    *,
    maf: MafSensor | None = None,
    map: MapSensor | None = None,
    sample_time: float = SAMPLE_TIME,
    settling_events: int = SETTLING_EVENTS,
    followed_events: int = FOLLOWED_EVENTS,
) -> EstimatorResponse:
    """Feed an estimator with a plant's flow and pressure, and take the response of its estimate.

    Parameters
    ----------
    estimator : Estimator
        The estimator, as the controller has it.
    plant : FollowedPlant
        Plant in periodic operation, and what a changed motion does to it.
    points : ChangedPoint
        What the controller believes of the motions: charge at rest, and shares.
    speed_rpm : float
        Speed.
    n_cylinders : int
        Number of cylinders.
    maf, map : MafSensor, MapSensor, optional
        Sensors that the plant has, the default ones if not given. Noise and quantisation are
        left out.
    sample_time : float
        Sampling interval, about, s: each event gets the same number of samples, so that all
        events are alike.
    settling_events, followed_events : int
        Events before and after the change.

    Raises
    ------
    ParameterError
        If the estimator gives no estimates, or its variance still changes.
    """
    T = event_time(speed_rpm, n_cylinders)
    in_range("change", points.change, 0.0, 0.1, "1", open_low=True)
    whole("settling_events", settling_events, 2 * n_cylinders + 4, 100_000)
    whole("followed_events", followed_events, 8, 10_000)
    per_event = max(round(T / positive("sample_time", sample_time, "s")), 1)
    feed = _Feed(
        estimator,
        plant,
        points,
        speed_rpm,
        n_cylinders,
        MafSensor() if maf is None else maf,
        MapSensor() if map is None else map,
        settling_events,
        settling_events + followed_events,
    )
    for warm in (False, True):
        feed = replace(feed, warm=warm)
        for phase in PHASES:
            within: FloatArray = (np.arange(per_event, dtype=np.float64) + phase) * (T / per_event)
            found = feed.response(T, within)
            if found is not None:
                return replace(found, phase=phase)
    raise ParameterError(
        f"the estimates of {1e6 * points.rest.charge:.0f} mg at {speed_rpm:g} rpm have gaps or do "
        f"not come to rest within {settling_events} events, or {followed_events} after a change: "
        "raise settling_events and followed_events, or ask whether the model suits the plant"
    )


@dataclass(frozen=True)
class _Feed:
    """What an estimator is fed with."""

    estimator: Estimator
    plant: FollowedPlant
    points: ChangedPoint
    speed_rpm: float
    n_cylinders: int
    maf: MafSensor
    map: MapSensor
    start: int  # the changed event
    end: int
    warm: bool = False  # whether lag and delay are known in the first half of the events

    def response(self, T: float, within: FloatArray) -> EstimatorResponse | None:
        """Response with samples at times within each event; None if it is not at rest.

        Nor is it where windows are rejected, so that their events have no estimate. Where the
        learnt delay puts a sample on the edge of a window, it goes in and out of it for ever: a
        jump of about 0.1 % of a charge, however small the change is, and no response.
        """
        time = (np.arange(self.end) - 1.0)[:, None] * T + within
        plant, n = self.plant, self.n_cylinders
        flow = _readings(self.maf, time, self.start, T, plant.flow, plant.pulse.flow)
        pressure = _readings(self.map, time, self.start, T, plant.pressure, plant.pulse.pressure)
        first = self._knowing if self.warm else self.estimator
        state, before = self._run(T, time, flow, pressure, first.start(), 0.0)
        raised, lowered = (
            self._run(T, time, flow, pressure, state, sign)[1] for sign in (1.0, -1.0)
        )
        known = sorted(set(raised) & set(lowered))
        if not known or known != list(range(known[0], known[-1] + 1)) or not before:
            return None
        rest, used_at = before[max(before)]
        earlier = before.get(rest.event_index - n)
        if earlier is None:
            return None
        standing = abs(earlier.estimate.variance / rest.variance - 1.0)
        taps = np.array([raised[j].estimate.charge - lowered[j].estimate.charge for j in known])
        if standing > _STANDING or np.abs(taps[-n:]).max() > _DIED * np.abs(taps).max():
            return None
        return EstimatorResponse(
            _response(T, known[0] - self.start, taps / (2.0 * self.points.change * rest.charge)),
            rest.charge,
            math.sqrt(rest.variance) / rest.charge,
            used_at - rest.event_index,
            standing,
        )

    @cached_property
    def _knowing(self) -> Estimator:
        """Estimator that begins with the lags and the delay of these sensors.

        An engine comes to high speed from lower ones, at which they have been learnt.
        """
        estimator = self.estimator
        if not isinstance(estimator, KalmanEstimator):
            return estimator
        maf, lag_map = self.maf, self.map.time_constant
        return estimator.replace(
            maf=estimator.maf.replace(time_constant=maf.time_constant, delay=maf.delay),
            map=estimator.map.replace(time_constant=lag_map),
        )

    def _run(
        self,
        T: float,
        time: FloatArray,
        flow: tuple[FloatArray, FloatArray],
        pressure: tuple[FloatArray, FloatArray],
        state: Any,
        sign: float,
    ) -> tuple[Any, dict[int, _Final]]:
        """Feed the events up to the changed one, or with a sign those from it on."""
        found: dict[int, _Final] = {}
        seen, told = flow[0] + sign * flow[1], pressure[0] + sign * pressure[1]
        rest, speed, n = self.points.rest, self.speed_rpm, self.n_cylinders
        # Demand and promise stay, whatever motion the parameters learnt make of them.
        changed = (self.points.raised if sign > 0.0 else self.points.lowered)._replace(
            charge=rest.charge
        )
        for k in range(self.start, self.end) if sign else range(self.start):
            estimator = self._knowing if self.warm and 2 * k < self.start else self.estimator
            update = estimator.update(
                state, Measurement(k * T, speed, time[k], seen[k], time[k], told[k])
            )
            if update.final is not None:
                found[update.final.event_index] = _Final(update.final, k)
            point = changed if sign and k == self.start else rest
            record = EventRecord(k, k % n + 1, k * T, speed, point, _USED, math.nan)
            state = estimator.commanded(update.state, record)
        return state, found


class _Final(NamedTuple):
    estimate: ChargeEstimate
    used_at: int  # event before which it came


def _response(event_time: float, first: int, taps: FloatArray) -> PulseResponse:
    """Response with as few taps as leave little, which is added to the last one.

    So the gain of a steady change is exact.
    """
    least = _DROPPED * float(np.abs(taps).max())
    left = np.cumsum(np.abs(taps[::-1]))[::-1]  # of each tap and those after it
    begin = int(np.argmax(np.abs(taps) > least))
    end = max(int(np.count_nonzero(left > least)), begin + 1)
    kept = taps[begin:end].copy()
    kept[-1] += taps[end:].sum()
    return PulseResponse(event_time, first + begin, kept, 0.0)


def _readings(
    sensor: AirSensor,
    time: FloatArray,
    changed: int,
    event_time: float,
    signal: FloatArray,
    change: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Noise-free readings of a periodic signal, and how one changed event changes them.

    Parameters
    ----------
    sensor : AirSensor
        The sensor.
    time : ndarray (...)
        Times of the samples, s.
    changed : int
        Number of the changed event.
    event_time : float
        ``T``, s.
    signal : ndarray (samples,)
        The signal over an event, from IVO on.
    change : ndarray (events, samples)
        Its change from the changed event on.
    """
    T, tau, gain = event_time, sensor.time_constant, 1.0 + sensor.gain_error
    at = time - sensor.delay
    knots = np.linspace(0.0, T, signal.size + 1)
    closed = np.append(signal, signal[0])
    settled = float(lag.at_knots(knots, closed, 0.0, tau)[-1])  # from zero
    left = math.exp(-T / tau) if tau > 0.0 else 0.0
    periodic = lag.at_knots(knots, closed, settled / (1.0 - left), tau)
    reading = gain * np.interp(np.mod(at, T), knots, periodic) + sensor.offset
    since = at - changed * T
    knots = np.linspace(0.0, change.shape[0] * T, change.size + 1)
    lagged = lag.at_knots(knots, np.append(change.ravel(), 0.0), 0.0, tau)
    over = np.maximum(since - knots[-1], 0.0)
    decay = np.exp(-over / tau) if tau > 0.0 else np.where(over > 0.0, 0.0, 1.0)
    moved = np.where(since > 0.0, np.interp(since, knots, lagged) * decay, 0.0)
    return reading, gain * moved
