"""Time, speed and number of an event as they are told: whether they can be, and what stands in."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from plant.air_path import event_time

from .alarms import Alarm
from .controller_state import ControllerState
from .event_data import Measurement
from .fault_reaction import FaultReaction

LONGEST_GAP = 2.0  # s from one IVO to the next; a later time is not believed
MOST_REFUSED = 8  # times in a row that are refused, after which the clock is believed again
_SPEED, _CLOCK = int(Alarm.SPEED), int(Alarm.CLOCK)
_FIRST_SPEED_RPM = 1000.0  # if the first one cannot be


class Timing(NamedTuple):
    """A measurement whose time and speed can be used."""

    measurement: Measurement
    event_index: int  # of the event that opens next
    missed: int  # events before it that were not computed; negative if the number went back
    refused: int  # times in a row that were not believed
    alarms: int  # bits of `Alarm.SPEED` and `Alarm.CLOCK`
    elapsed: float  # s, since the IVO before


def usable(
    state: ControllerState,
    measurement: Measurement,
    n_cylinders: int,
    speed_range_rpm: tuple[float, float],
    faults: FaultReaction | None,
) -> Timing:
    """Return the measurement with a time and a speed that can be.

    A time that cannot be is replaced by the one expected. A speed that cannot be is replaced by
    that of the clock if events are numbered and faults are watched for, else by the last one.
    """
    speed, time, told = measurement.speed_rpm, measurement.time, measurement.event_index
    index = state.event_index if told is None else told
    missed = index - state.event_index
    low, high = speed_range_rpm
    elapsed, refused, alarms = time - state.time, 0, 0 if missed == 0 else _CLOCK
    if not 0.0 < elapsed <= LONGEST_GAP:
        known = _known(state, low)
        first = math.isinf(state.time)
        if not math.isfinite(time) or not (first or state.refused >= MOST_REFUSED):
            refused, alarms = state.refused + 1, alarms | _CLOCK
            step = event_time(known, n_cylinders) * max(missed + 1, 1)
            time = step if first else state.time + step
        elapsed = event_time(known, n_cylinders)
    elif faults is not None and told is not None and missed >= 0 and state.refused == 0:
        clock = 120.0 * (missed + 1) / (n_cylinders * elapsed)
        if faults.speed_is_wrong(speed, clock, elapsed) and low <= clock <= high:
            speed, alarms = clock, alarms | _SPEED
    if not low <= speed <= high:
        speed, alarms = _known(state, low), alarms | _SPEED
    if speed is not measurement.speed_rpm or time is not measurement.time:
        measurement = replace(measurement, speed_rpm=speed, time=time)
    return Timing(measurement, index, missed, refused, alarms, elapsed)


def _known(state: ControllerState, lowest_rpm: float) -> float:
    """Speed that was believed last."""
    known = state.speed_rpm
    return known if math.isfinite(known) else max(lowest_rpm, _FIRST_SPEED_RPM)
