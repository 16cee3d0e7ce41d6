"""All faults of a run at work: on sensors, durations, valves, the speed told, the computation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plant import ParameterError
from plant.sensors import SensorSet

from ._sample_faults import SampleFaults
from .fault_kinds import SPIKE_EVENTS
from .faults import Fault

_STREAM = 0xFA  # of a seed, from which the random numbers of faults come


class ValveFault(NamedTuple):
    """What a valve does otherwise than commanded at one event."""

    lift_factor: float  # delivered over commanded lift, 1
    late: float  # s, added to the delivered duration


SOUND = ValveFault(1.0, 0.0)


class FaultEffects:
    """Faults of a run; times are those since its first event, in s.

    The random numbers of each fault are a stream of their own, so that noise and jitter of the
    run are the same with and without it.
    """

    def __init__(self, faults: Sequence[Fault], n_cylinders: int, seed: int) -> None:
        self.all = tuple(faults)
        for fault in self.all:
            if not isinstance(fault, Fault):
                raise ParameterError(f"faults holds {fault!r}, but must hold Fault only")
            if fault.cylinder is not None and fault.cylinder > n_cylinders:
                raise ParameterError(
                    f"the fault {fault.kind!r} is one of cylinder {fault.cylinder}, but the engine "
                    f"has {n_cylinders}"
                )
        self._with_random = [
            (fault, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, i))))
            for i, fault in enumerate(self.all)
        ]
        self._valve = self._of("valve")
        self._duration = [fault for fault, _ in self._of("duration")]
        self._computation = [fault for fault, _ in self._of("computation")]
        self._speed = [fault for fault, _ in self._of("speed")]
        self._spikes = [0] * len(self._speed)  # events since the start of each

    def _of(self, target: str) -> list[tuple[Fault, np.random.Generator]]:
        return [pair for pair in self._with_random if pair[0].of_kind.target == target]

    def samples(
        self, sensors: SensorSet, zero: float, last: tuple[float, float]
    ) -> tuple[SampleFaults | None, SampleFaults | None]:
        """Faults of MAF and MAP sensor, None where there are none.

        `zero` is the time of the first event on the sensors' clock (s), and `last` the readings
        before it (kg/s, Pa).
        """
        maf, map_ = self._of("maf"), self._of("map")
        return (
            SampleFaults("maf", maf, sensors.maf, zero, last[0]) if maf else None,
            SampleFaults("map", map_, sensors.map, zero, last[1]) if map_ else None,
        )

    def valve(self, cylinder: int, time: float) -> ValveFault:
        """What the valve of a cylinder (from 1) does that opens at a time."""
        if not self._valve:
            return SOUND
        lift_factor, late = 1.0, 0.0
        for fault, random in self._valve:
            if not fault.hits(cylinder, time):
                continue
            if fault.kind == "valve-stuck":
                lift_factor = 0.0
            elif fault.kind == "valve-lift":
                lift_factor *= fault.size
            elif fault.kind == "valve-late":
                late += fault.size
            else:
                late += fault.size * float(random.standard_normal())
        return ValveFault(lift_factor, late)

    def duration(self, cylinder: int, time: float, measured: float) -> float | None:
        """Duration (s) that is told of a valve that shuts at a time; None if none is."""
        for fault in self._duration:
            if fault.hits(cylinder, time):
                if fault.kind == "duration-missing":
                    return None
                measured += fault.size
        return measured

    def told_speed(self, time: float, speed_rpm: float) -> float:
        """Speed that is told; to be asked once at each event."""
        for i, fault in enumerate(self._speed):
            if fault.active(time):
                if self._spikes[i] % SPIKE_EVENTS == 0:
                    speed_rpm += fault.size
                self._spikes[i] += 1
        return speed_rpm

    def missed(self, time: float) -> bool:
        """Whether the controller is not called for the event at a time."""
        return any(fault.active(time) for fault in self._computation)
