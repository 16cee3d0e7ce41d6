"""Plausibility monitors: whether sensors, valves and clock tell what can be.

Once per event they hold against each other what is measured, what was commanded, and what the
charge model promises of it. None of the thresholds is published: they are this project's own,
wide enough that ten thousand cycles of sampled engines, sensors and operating points raise no
alarm, and narrow enough that what passes under them is harmless. `docs/faults.md` tells both.

=============  ================================================================================
MAF            Readings that stay the same or fail to come. Estimated over promised charge, the
               median of the cylinders, away from 1; measured flow over that which the commands
               promise, where there are no estimates; a learnt level that runs away.
MAP            Readings that stay the same or fail to come. Pressure before the throttle, from the
               reading and the drop that the promised flow makes, away from what it was.
DURATION       None told. Measured less expected duration, the median of the cylinders.
VALVE          The estimate of one cylinder apart from that of the others, twice in a row; its
               duration far off, twice in a row, or not told while those of others are.
INNOVATION     Sum of normalised innovations over what is allowed; a refused window counts most.
SPEED, CLOCK   Judged by the controller, before anything else uses them.
=============  ================================================================================
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, fields
from types import ModuleType
from typing import Any, NamedTuple, Self

import numpy as np

from plant import Engine
from plant._checks import positive, replace_fields, whole
from plant.kinematics import FloatArray
from plant.sampling import TimeSampling
from plant.sensors import AirSensor, SensorSet

from . import _monitor_layout as k
from ._pickling import by_fields
from .event_data import EventRecord, Measurement

_LEAST_GAP = 5e-3  # s
_NO_SHARES = np.zeros(0)
_UNITS = {
    "maf_time": "s",
    "throttle_area": "kg/s",
    "level_time": "s",
    "longest_gap": "s",
    "pressure_limit": "Pa",
    "pressure_rate": "Pa/s",
    "duration_limit": "s",
    "largest_duration_error": "s",
    "patience": "s",
}


class MonitorState(NamedTuple):
    """What a monitor remembers; do not write into its array."""

    values: FloatArray
    alarms: int  # `Alarm` bits that stand; a plain number, which is ten times as fast
    suspects: tuple[int, ...]  # cylinders (from 1) with a VALVE alarm
    calm: bool  # whether nothing is suspicious, so that what is learnt now can be trusted
    unnamed: float = 0.0  # s, for which INNOVATION stands and no sensor is named

    @property
    def ambient_pressure(self) -> float:
        """Pressure before the throttle that is believed, Pa; NaN before it is known."""
        return float(self.values[k.AMBIENT])


class EventFacts(NamedTuple):
    """What is known of one event when it is judged."""

    cylinder: int  # from 1, that opens next
    elapsed: float  # s, since the IVO before
    measurement: Measurement
    estimated: int  # cylinder (from 1) that was estimated; 0 for none
    log_ratio: float  # ln of estimated over promised charge
    innovation: float  # normalised, over its degrees of freedom
    refused: bool  # whether the samples of a window were refused
    level: float  # ln of the promised charge over that of nominal parameters, last command
    last: EventRecord | None  # event commanded before
    # Cylinder, and measured less expected duration in s; NaN of a valve that was kept shut
    duration_errors: tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True)
class FaultMonitor:
    """Plausibility monitors of one engine.

    Attributes
    ----------
    n_cylinders : int
        Number of cylinders.
    throttle_area : float
        Throttle at sonic flow, Eq. 19, kg/s.
    maf_time : float
        Time constant of the MAF sensor, s.
    ratio_limit : float
        |ln| of estimated over promised charge, the median of the cylinders, once the model has
        been right for some cycles, 1.
    first_ratio_limit : float
        The same before, 1.
    flow_limit : float
        Change of |ln| of measured over promised flow that names the MAF sensor as the cause of
        strange innovations, 1.
    level_limit : float
        Change of |ln| of the level, what is not learnt of it yet included, within `level_time`, 1.
    level_time : float
        s.
    innovation_allowance : float
        Normalised innovation over its degrees of freedom that is allowed, 1.
    score_limit : float
        Sum of what exceeds it, 1.
    same_readings : int
        Readings in a row that may be equal.
    longest_gap : float
        Time without a reading, s.
    pressure_limit : float
        Change of the pressure before the throttle, Pa, beyond what `pressure_rate` explains.
    pressure_rate : float
        Fastest change of the ambient pressure, Pa/s (100 Pa/s is a drive down a pass, 500 leaves
        room).
    duration_limit : float
        Measured less expected duration, median of the cylinders, s.
    largest_duration_error : float
        The same of one valve, s.
    valve_limit : float
        |ln| of a cylinder's estimated over promised charge less that of the others, 1.
    recovery_events : int
        Events without a finding that clear an alarm.
    level_bound : float
        |ln| of the learnt level that is possible, 1.
    patience : float
        Time for which a pressure that has jumped is not believed, s; then it is followed, slowly.
    """

    n_cylinders: int  # 1
    throttle_area: float  # kg/s
    maf_time: float = 0.015  # s
    ratio_limit: float = 0.10  # 1
    first_ratio_limit: float = 0.5  # 1
    flow_limit: float = 0.08  # 1
    level_limit: float = 0.085  # 1
    level_time: float = 5.0  # s
    innovation_allowance: float = 1.5  # 1
    score_limit: float = 8.0  # 1
    same_readings: int = 25  # 1
    longest_gap: float = 5e-3  # s
    pressure_limit: float = 2000.0  # Pa
    pressure_rate: float = 500.0  # Pa/s
    duration_limit: float = 0.25e-3  # s
    largest_duration_error: float = 1e-3  # s
    valve_limit: float = 0.25  # 1
    recovery_events: int = 12  # 1
    level_bound: float = 0.30  # 1
    patience: float = 10.0  # s
    _numbers: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        whole("n_cylinders", self.n_cylinders, 1, 24)
        whole("same_readings", self.same_readings, 2, 100_000)
        whole("recovery_events", self.recovery_events, 1, 100_000)
        names = [f.name for f in fields(self) if f.init]
        for name in names:
            positive(name, getattr(self, name), _UNITS.get(name, "1"))
        # All but the number of cylinders, in the order of `_monitor_layout`
        numbers = np.array([getattr(self, name) for name in names[1:]], dtype=float)
        numbers.setflags(write=False)
        object.__setattr__(self, "_numbers", numbers)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a copy is made: from its fields."""
        return by_fields(self)

    @classmethod
    def of(cls, engine: Engine, sensors: SensorSet | None = None, **options: Any) -> Self:
        """Return the monitors of an unthrottled engine.

        Parameters
        ----------
        engine : Engine
            The engine.
        sensors : SensorSet, optional
            What is assumed of the sensors: lag of the MAF, time between two readings.
        **options
            The other fields.
        """
        area = engine.throttle.area(engine.throttle.wide_open_deg)
        known = SensorSet() if sensors is None else sensors
        readings = [s for s in (known.maf, known.map) if isinstance(s, AirSensor)]
        periods = [s.sampling.period for s in readings if isinstance(s.sampling, TimeSampling)]
        found: dict[str, Any] = {"longest_gap": max(2.5 * max(periods, default=0.0), _LEAST_GAP)}
        if isinstance(known.maf, AirSensor) and known.maf.time_constant > 0.0:
            found["maf_time"] = known.maf.time_constant
        return cls(n_cylinders=engine.n_cylinders, throttle_area=area, **{**found, **options})

    def replace(self, **changes: Any) -> Self:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def start(self) -> MonitorState:
        """Return the state before the first event."""
        n = self.n_cylinders
        values = np.zeros(k.HEAD + k.ROWS * n)
        for name in (k.LEVEL, k.AMBIENT, k.FLOW_BIAS, k.MAF_LAST, k.MAP_LAST):
            values[name] = math.nan
        rows = values[k.HEAD :].reshape(k.ROWS, n)
        rows[[k.RATIO, k.FLOW, k.ERROR, k.PRESSURE, k.DROP, k.LEVELS]] = math.nan
        return MonitorState(values, 0, (), False)

    def judge(self, state: MonitorState, facts: EventFacts) -> MonitorState:
        """Return the state after one event.

        Parameters
        ----------
        state : MonitorState
            State before; not changed.
        facts : EventFacts
            What is known of the event.
        """
        kernel, n, numbers = _kernel(), self.n_cylinders, self._numbers
        values = state.values.copy()
        told, late = -1, math.nan
        for cylinder, error in facts.duration_errors:
            if told >= 0:
                kernel.told(values, n, told, late, numbers)
            told, late = cylinder - 1, error
        last, measurement = facts.last, facts.measurement
        kernel.judge(
            values,
            numbers,
            n,
            facts.cylinder - 1,
            facts.elapsed,
            told,
            late,
            measurement.sample_flow,
            measurement.pressure,
            facts.estimated - 1,
            facts.log_ratio,
            facts.innovation,
            facts.refused,
            facts.level,
            0.0 if last is None or last.point.lift_mm == 0.0 else last.point.charge,
            _NO_SHARES if last is None else last.point.shares,
        )
        alarms = int(values[k.ALARMS])
        suspects: tuple[int, ...] = ()
        if alarms & k.VALVE:
            bad = values[k.HEAD + k.BAD * n : k.HEAD + (k.BAD + 1) * n]
            suspects = tuple(int(i) + 1 for i in np.flatnonzero(bad >= k.TWICE))
        calm, unnamed = values[k.CALM] > 0.0, float(values[k.ALONE])
        return MonitorState(values, alarms, suspects, bool(calm), unnamed)


@functools.cache
def _kernel() -> ModuleType:
    from . import _monitor_kernel

    return _monitor_kernel
