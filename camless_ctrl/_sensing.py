"""Sensors at work in a closed-loop run: what the controller is told, faults included."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from plant import Trace
from plant.kinematics import FloatArray
from plant.sampling import SensorSamples
from plant.sensors import AirSensor, SensorSet

from ._fault_effects import FaultEffects
from ._sample_faults import SampleFaults
from .event_data import Measurement

SETTLING_LAGS = 12.0  # time constants that the sensors are given before the first event


class Sensing:
    """Sensors of a run, and what they have not yet told the controller."""

    def __init__(self, sensors: SensorSet, seed: int, effects: FaultEffects) -> None:
        self._sensors, self._effects = sensors, effects
        self._run = sensors.start(seed)
        slow = [s for s in (sensors.maf, sensors.map) if isinstance(s, AirSensor)]
        self._settling = SETTLING_LAGS * max((s.time_constant + s.delay for s in slow), default=0.0)
        # Time of closing, event, duration of each valve that has not shut.
        self._open: deque[tuple[float, int, float]] = deque()
        self._maf: list[tuple[FloatArray, FloatArray]] = []
        self._map: list[tuple[FloatArray, FloatArray]] = []
        self._maf_faults: SampleFaults | None = None
        self._map_faults: SampleFaults | None = None
        self._zero = 0.0

    @property
    def clock(self) -> float:
        """Time up to which the sensors have seen the plant, s."""
        return self._run.maf.state.clock

    def settle(self, cycle: Trace) -> None:
        """Show the sensors a periodic cycle until they have settled."""
        self.observe(cycle)
        while self.clock < self._settling:
            self._maf.clear()
            self._map.clear()
            self.observe(cycle)

    def begin(self, opening: float) -> None:
        """Let faults act from now on; the first event opens at a time in s."""
        self._zero = opening
        last = _last(self._maf), _last(self._map)
        self._maf_faults, self._map_faults = self._effects.samples(self._sensors, opening, last)

    def observe(self, trace: Trace) -> None:
        """Show the sensors what follows."""
        for run, faults, waiting in (
            (self._run.maf, self._maf_faults, self._maf),
            (self._run.map, self._map_faults, self._map),
        ):
            if faults is None:
                waiting.append(_told(run.observe(trace)))
            else:
                seen = faults.shown(trace, run.state.clock)
                waiting.append(faults.told(*_told(run.observe(seen))))

    def shuts(
        self, event: int, cylinder: int, opening: float, duration_deg: float, speed_rpm: float,
        opens: bool,
    ) -> None:  # fmt: skip
        """Note the duration of an event, to be told when its valve has shut.

        Of a valve that does not open nothing is told. Its noise is drawn all the same, so that
        later events have the same noise with and without the fault.
        """
        measured = float(self._run.duration.measure(max(duration_deg, 0.0), speed_rpm).duration)
        if not opens:
            return
        closing = opening + duration_deg / (6.0 * speed_rpm)
        told = self._effects.duration(cylinder, closing - self._zero, measured)
        if told is not None:
            self._open.append((closing, event, told))

    def measurement(self, event: int, opening: float, speed_rpm: float) -> Measurement:
        """Return what the controller is told before an IVO, all that has come since the last."""
        shut = []
        while self._open and self._open[0][0] <= self.clock:
            _, opened, measured = self._open.popleft()
            shut.append((opened, measured))
        return Measurement(
            opening, speed_rpm, *_taken(self._maf), *_taken(self._map), tuple(shut), event
        )


def _told(samples: SensorSamples) -> tuple[FloatArray, FloatArray]:
    return samples.time, samples.value


def _taken(waiting: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Times and readings that wait; none wait afterwards."""
    if len(waiting) == 1:
        return waiting.pop()
    time, value = (np.concatenate(parts) for parts in zip(*waiting, strict=True))
    waiting.clear()
    return time, value


def _last(waiting: list[tuple[FloatArray, FloatArray]]) -> float:
    """Last reading; NaN if there is none."""
    values = [value for _, value in waiting if value.size]
    return float(values[-1][-1]) if values else math.nan
