"""What faults of an air-flow or pressure sensor make of its signal and of its samples.

They act in the order of the signal chain, whatever the order in which they are given: lag,
noise, offset, drift, then what is stuck, no number, or lost. A faulty reading is not held within
the sensor's range.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from plant import ParameterError, Trace
from plant.kinematics import FloatArray
from plant.lag import first_order_lag
from plant.sensors import AirSensor, Sensor

from .fault_kinds import SAME_TIME
from .faults import Fault

Samples = tuple[FloatArray, FloatArray]  # time in s, reading
_Effect = Callable[[FloatArray, FloatArray], Samples]  # what one fault makes of samples
_SIGNALS = {"maf": "throttle_flow", "map": "manifold_pressure"}
_CHAIN = ("noise", "offset", "drift", "stuck", "nan", "dropout")


class SampleFaults:
    """Faults of one sensor at work; `zero` is the time of the first event on its clock."""

    def __init__(
        self,
        target: str,
        faults: Sequence[tuple[Fault, np.random.Generator]],
        sensor: Sensor,
        zero: float,
        last: float,
    ) -> None:
        self._lags = [
            _Lag(f, zero, _SIGNALS[target]) for f, _ in faults if f.kind.endswith("-slow")
        ]
        chained: list[tuple[int, _Effect]] = []
        for fault, random in faults:
            what = fault.kind.removeprefix(f"{target}-")
            if what == "noise":
                chained.append((0, _Noise(fault, zero, sensor, random)))
            elif what == "stuck":
                chained.append((_CHAIN.index(what), _Stuck(fault, zero, last)))
            elif what in _CHAIN:
                chained.append((_CHAIN.index(what), _plain(what, fault, zero)))
        self._effects = [effect for _, effect in sorted(chained, key=lambda pair: pair[0])]

    def shown(self, trace: Trace, clock: float) -> Trace:
        """Return what the sensor sees of a trace that starts at a time on its clock."""
        for lagging in self._lags:
            trace = lagging(trace, clock)
        return trace

    def told(self, time: FloatArray, value: FloatArray) -> Samples:
        """Return what the sensor tells in place of its samples."""
        for effect in self._effects:
            time, value = effect(time, value)
        return time, value


def _acts(fault: Fault, zero: float, time: FloatArray) -> np.ndarray:
    """Where a fault acts, bool (m,)."""
    since = time - zero + SAME_TIME
    return np.asarray((since >= fault.start) & (since < fault.end))


def _plain(what: str, fault: Fault, zero: float) -> _Effect:
    """Effect of a fault that remembers nothing."""

    def offset(time: FloatArray, value: FloatArray) -> Samples:
        return time, np.where(_acts(fault, zero, time), value + fault.size, value)

    def drift(time: FloatArray, value: FloatArray) -> Samples:
        moved = value + fault.size * (time - zero - fault.start)
        return time, np.where(_acts(fault, zero, time), moved, value)

    def nan(time: FloatArray, value: FloatArray) -> Samples:
        return time, np.where(_acts(fault, zero, time), math.nan, value)

    def dropout(time: FloatArray, value: FloatArray) -> Samples:
        left = ~_acts(fault, zero, time)
        return time[left], value[left]

    effects: dict[str, _Effect] = {
        "offset": offset, "drift": drift, "nan": nan, "dropout": dropout,
    }  # fmt: skip
    return effects[what]


class _Noise:
    """Independent noise that brings that of the samples to a multiple."""

    def __init__(
        self, fault: Fault, zero: float, sensor: Sensor, random: np.random.Generator
    ) -> None:
        if not isinstance(sensor, AirSensor):
            raise ParameterError(
                f"the fault {fault.kind!r} needs the noise of the sensor, but it is {sensor!r}: "
                "use a MafSensor"
            )
        self._fault, self._zero, self._random = fault, zero, random
        self._noise, self._relative = sensor.noise, sensor.relative_noise
        self._factor = math.sqrt(fault.size**2 - 1.0)

    def __call__(self, time: FloatArray, value: FloatArray) -> Samples:
        acts = _acts(self._fault, self._zero, time)
        if not acts.any():
            return time, value
        value = value.copy()
        own = np.hypot(self._noise, self._relative * value[acts])
        value[acts] += self._factor * own * self._random.standard_normal(own.size)
        return time, value


class _Stuck:
    """Holds a reading."""

    def __init__(self, fault: Fault, zero: float, last: float) -> None:
        self._fault, self._zero = fault, zero
        self._last = last if math.isnan(fault.size) else fault.size
        self._given = not math.isnan(fault.size)

    def __call__(self, time: FloatArray, value: FloatArray) -> Samples:
        before = value[time - self._zero + SAME_TIME < self._fault.start]
        if before.size and not self._given:
            self._last = float(before[-1])
        acts = _acts(self._fault, self._zero, time)
        if not acts.any():
            return time, value
        if math.isnan(self._last):  # there was none before: the first one is held
            self._last = float(value[acts][0])
        return time, np.where(acts, self._last, value)


class _Lag:
    """A further first-order lag of the signal, exact for a signal linear between the points.

    It stands before the sensor, which is the same as after the sensor's own lag and before its
    noise. The lag starts settled at the signal; at the end the signal jumps back.
    """

    def __init__(self, fault: Fault, zero: float, signal: str) -> None:
        self._fault, self._zero, self._signal = fault, zero, signal
        self._knot: tuple[float, float, float] | None = None  # last time, signal, response

    def __call__(self, trace: Trace, clock: float) -> Trace:
        time, signal = clock + trace.time, getattr(trace, self._signal)
        where = np.flatnonzero(_acts(self._fault, self._zero, time))
        if not where.size:
            self._knot = None
            return trace
        part = slice(int(where[0]), int(where[-1]) + 1)
        t, u = time[part], signal[part]
        if self._knot is None:
            response = first_order_lag(t, u, self._fault.size)
        else:
            t_0, u_0, y_0 = self._knot
            response = first_order_lag(
                np.concatenate(((t_0,), t)), np.concatenate(((u_0,), u)), self._fault.size, y_0
            )[1:]
        lasts = part.stop == time.size
        self._knot = (float(t[-1]), float(u[-1]), float(response[-1])) if lasts else None
        lagging = signal.copy()
        lagging[part] = response
        return replace(trace, **{self._signal: lagging})
