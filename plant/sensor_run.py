"""Sensors at work: what they remember from window to window, and the samples they give."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import lag
from ._checks import in_range, positive, whole
from .errors import ParameterError
from .kinematics import FloatArray, degrees_per_second
from .sampling import SensorSamples
from .trace import Trace

if TYPE_CHECKING:
    from .sensors import AirSensor, DurationSensor

Seed = int | np.random.SeedSequence


@dataclass(frozen=True, slots=True)
class SensorState:
    """Where a sensor stands; immutable, so keeping it is saving it.

    Attributes
    ----------
    time, signal, crank_angle_deg : ndarray (k,)
        Points of the signal that later samples need (s, unit of the signal, deg).
    response : float
        Response of the lag when the first of them has passed the delay.
    next_sample : int
        Number of the next sample.
    clock : float
        Time at which the next trace starts, s.
    random : mapping
        State of the random number generator.
    """

    time: FloatArray
    signal: FloatArray
    crank_angle_deg: FloatArray
    response: float
    next_sample: int
    clock: float
    random: Mapping[str, Any] = field(repr=False)


class SensorRun:
    """A flow or pressure sensor at work; made by the ``start`` of a sensor.

    Attributes
    ----------
    sensor : MafSensor or MapSensor
        Its parameters.
    state : SensorState
        Where it stands; assign a kept one to go back to it.
    """

    def __init__(self, sensor: AirSensor, seed: Seed) -> None:
        self.sensor = sensor
        self._random = _generator(seed)
        empty = np.empty(0)
        self.state = SensorState(empty, empty, empty, 0.0, 0, 0.0, self._random.bit_generator.state)

    def copy(self) -> SensorRun:
        """Return a second run that goes on from here, with the same random numbers."""
        other = SensorRun(self.sensor, 0)
        other.state = self.state
        return other

    def observe(self, trace: Trace) -> SensorSamples:
        """Measure over the window of a trace, which follows on the windows observed before.

        The window ends one step after the last point of the trace, where the next one starts.
        A sample that falls into that last step is given with the next window. The trace of a
        periodic cycle may be observed again and again: its crank angle goes on by whole cycles.

        Parameters
        ----------
        trace : Trace
            At least two points.

        Raises
        ------
        ParameterError
            If the trace has a single point.
        """
        m = trace.time.size
        if m < 2:
            raise ParameterError(
                f"the trace has {m} point, but must have at least 2: record it at a finer step"
            )
        start, angle = self.state.clock, trace.crank_angle_deg
        if self.state.time.size:
            behind = self.state.crank_angle_deg[-1] - angle[0]
            angle = angle + 720.0 * max(math.ceil(behind / 720.0), 0)
        samples = self.measure(start + trace.time, getattr(trace, self.sensor.signal), angle)
        clock = start + float(trace.time[-1] - trace.time[0]) * m / (m - 1)
        self.state = replace(self.state, clock=clock)
        return samples

    def measure(
        self, time: ArrayLike, signal: ArrayLike, crank_angle_deg: ArrayLike | None = None
    ) -> SensorSamples:
        """Measure a signal, which goes on from that measured before.

        Parameters
        ----------
        time : array_like (m,)
            Times of the points on the sensor's clock, s, not falling; a repeated time is a
            jump.
        signal : array_like (m,)
            True signal at the points, linear between them and from the last point before.
        crank_angle_deg : array_like (m,), optional
            Crank angle at the points, deg, rising; needed by `CrankSampling`.

        Returns
        -------
        SensorSamples
            The samples up to ``time[-1]``.

        Raises
        ------
        ParameterError
            If the points are not finite, not in order, or start before the last one measured;
            the sensor then stands where it stood.
        """
        sensor, before = self.sensor, self.state
        self._random.bit_generator.state = before.random
        t, u = lag.points(time, signal)
        if crank_angle_deg is not None:
            angle, _ = lag.points(crank_angle_deg, t, name="crank_angle_deg", unit="deg")
        elif sensor.sampling.needs_crank_angle:
            raise ParameterError(
                "crank_angle_deg is missing, but the sensor samples on the crank: give it, or "
                "use TimeSampling"
            )
        else:
            angle = np.full(t.size, np.nan)
        first = before.time.size == 0
        if not first:
            _follows("time", t, before.time, "s")
            _follows("crank_angle_deg", angle, before.crank_angle_deg, "deg")
        response = float(u[0]) if first else before.response
        index = sensor.sampling.first_index(t[0], angle[0]) if first else before.next_sample
        t = np.concatenate((before.time, t))
        u = np.concatenate((before.signal, u))
        angle = np.concatenate((before.crank_angle_deg, angle))

        at_knots = lag.at_knots(t, u, response, float(sensor.time_constant))
        instants = sensor.sampling.instants(index, t, angle)
        lagged = lag.between_knots(
            instants - sensor.delay, t, u, at_knots, float(sensor.time_constant)
        )
        value, saturated = self._output(lagged)
        # The last point that has passed the delay carries the response on.
        keep = max(int(np.searchsorted(t, t[-1] - sensor.delay, side="right")) - 1, 0)
        self.state = SensorState(
            _frozen(t[keep:]),
            _frozen(u[keep:]),
            _frozen(angle[keep:]),
            float(at_knots[keep]),
            index + instants.size,
            float(t[-1]),
            self._random.bit_generator.state,
        )
        return SensorSamples(
            sensor.quantity, sensor.unit, instants, np.interp(instants, t, angle), value, saturated
        )

    def _output(self, lagged: FloatArray) -> tuple[FloatArray, np.ndarray]:
        """Readings of the lagged signal: gain, offset, noise, then range and quantisation."""
        sensor = self.sensor
        reading = (1.0 + sensor.gain_error) * lagged + sensor.offset
        deviation = np.hypot(sensor.noise, sensor.relative_noise * reading)
        reading = reading + deviation * self._random.standard_normal(reading.size)
        return lag.quantise(reading, sensor.lowest, sensor.highest, sensor.bits)


@dataclass(frozen=True, slots=True)
class DurationSamples:
    """Measured valve durations, in time and at their speed in crank angle."""

    duration: FloatArray  # s
    duration_deg: FloatArray  # deg

    def __str__(self) -> str:
        """Return the durations in ms and deg."""
        pairs = zip(np.ravel(self.duration), np.ravel(self.duration_deg), strict=True)
        return "valve duration: " + ", ".join(f"{1e3 * t:.3f} ms ({d:.2f} deg)" for t, d in pairs)


class DurationRun:
    """A valve-duration sensor at work; made by `DurationSensor.start`.

    Attributes
    ----------
    sensor : DurationSensor
        Its parameters.
    """

    def __init__(self, sensor: DurationSensor, seed: Seed) -> None:
        self.sensor = sensor
        self._random = _generator(seed)

    @property
    def state(self) -> dict[str, Any]:
        """State of the random number generator; assign a kept one to go back to it."""
        return dict(self._random.bit_generator.state)

    @state.setter
    def state(self, state: dict[str, Any]) -> None:
        self._random.bit_generator.state = state

    def copy(self) -> DurationRun:
        """Return a second run that goes on from here, with the same random numbers."""
        other = DurationRun(self.sensor, 0)
        other.state = self.state
        return other

    def measure(self, duration_deg: ArrayLike, speed_rpm: ArrayLike) -> DurationSamples:
        """Measure true durations (deg) at a speed; one value each, or arrays of one shape.

        Raises
        ------
        ParameterError
            If a duration is negative, a speed not above zero, or a value not finite.
        """
        angle = np.asarray(duration_deg, dtype=float)
        rate = degrees_per_second(speed_rpm)
        for value in np.ravel(angle):
            in_range("duration_deg", float(value), 0.0, 720.0, "deg")
        for value in np.ravel(rate):
            positive("speed_rpm", float(value) / 6.0, "rpm")
        true = angle / rate
        duration = (
            true + self.sensor.offset + self.sensor.noise * self._random.standard_normal(true.shape)
        )
        return DurationSamples(duration, duration * rate)


@dataclass(frozen=True, slots=True)
class AirPathSamples:
    """Samples of air flow and manifold pressure over one window."""

    maf: SensorSamples
    map: SensorSamples

    def __str__(self) -> str:
        """Return one line a sensor."""
        return f"{self.maf}\n{self.map}"


@dataclass(frozen=True, slots=True)
class SensorSetRun:
    """The sensors of a `SensorSet` at work, each to be used by itself as well."""

    maf: SensorRun
    map: SensorRun
    duration: DurationRun

    def observe(self, trace: Trace) -> AirPathSamples:
        """Measure flow and pressure over the window of a trace: see `SensorRun.observe`."""
        return AirPathSamples(self.maf.observe(trace), self.map.observe(trace))

    def copy(self) -> SensorSetRun:
        """Return a second run of all three that goes on from here."""
        return SensorSetRun(self.maf.copy(), self.map.copy(), self.duration.copy())


def _follows(name: str, new: FloatArray, before: FloatArray, unit: str) -> None:
    if math.isnan(new[0]) != math.isnan(before[-1]):
        raise ParameterError(f"{name} was given for some windows only: give it for all or none")
    if new[0] < before[-1]:
        raise ParameterError(
            f"{name} starts at {new[0]:g} {unit}, but the signal was measured up to "
            f"{before[-1]:g} {unit} already: measure windows in order, or start another run"
        )


def _frozen(array: FloatArray) -> FloatArray:
    copy = array.copy()
    copy.setflags(write=False)
    return copy


def _generator(seed: Seed) -> np.random.Generator:
    if not isinstance(seed, np.random.SeedSequence):
        seed = whole("seed", seed, 0, 2**63 - 1)
    return np.random.default_rng(seed)
