"""Compiled rules of the plausibility monitors: one function for what is judged by itself.

All work in place on what a monitor remembers, laid out as in `_monitor_layout`: `values` are its
single numbers, `rows` those of each cylinder, `ranked` is room for `n` numbers. The entries of
`_monitor_kernel` call them; what they are for is told in `fault_monitor`.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from plant.kinematics import FloatArray

from . import _monitor_layout as k
from .event_data import PARTS

inlined = numba.njit(nogil=True, error_model="numpy")


@inlined
def ranks(row: FloatArray, ranked: FloatArray) -> int:
    """Write what is known of a row in rising order; return how many are."""
    count = 0
    for x in row:
        if not math.isfinite(x):
            continue
        place = count
        while place > 0 and ranked[place - 1] > x:
            ranked[place] = ranked[place - 1]
            place -= 1
        ranked[place] = x
        count += 1
    return count


@inlined
def median(row: FloatArray, ranked: FloatArray) -> tuple[float, int]:
    """Median of what is known, and how many are."""
    count = ranks(row, ranked)
    if count == 0:
        return math.nan, 0
    return 0.5 * (ranked[(count - 1) // 2] + ranked[count // 2]), count


@inlined
def latch(values: FloatArray, good: int, bad: bool, fine: bool, bit: int, wait: float) -> None:
    """Raise an alarm at once, and clear it after enough events without a finding."""
    alarms = int(values[k.ALARMS])
    if bad:
        alarms |= bit
        values[good] = 0.0
    elif alarms & bit:
        values[good] = values[good] + 1.0 if fine else 0.0
        if values[good] >= wait:
            alarms &= ~bit
    values[k.ALARMS] = alarms


@inlined
def take_readings(values: FloatArray, at: int, readings: FloatArray, dt: float) -> float:
    """Take in readings of a sensor; return their mean, NaN without any."""
    total, count = 0.0, 0
    values[at + 2] += dt
    for x in readings:
        if not math.isfinite(x):
            continue
        total += x
        count += 1
        if x == values[at]:
            values[at + 1] += 1.0
        else:
            values[at], values[at + 1], values[at + 2] = x, 0.0, 0.0
    values[at + 3] = 0.0 if count else values[at + 3] + dt
    return total / count if count else math.nan


@inlined
def is_dead(values: FloatArray, at: int, numbers: FloatArray, dt: float, flows: bool) -> bool:
    """Whether a sensor holds one reading though air flows, or gives none."""
    still = flows and values[at + 1] >= numbers[k.SAME] and values[at + 2] >= dt
    return still or values[at + 3] > max(numbers[k.GONE], 1.5 * dt)


@inlined
def is_far(errors: FloatArray, cylinder: int, numbers: FloatArray) -> bool:
    """Whether a valve's duration is far off; what most of three or more share is the sensor's."""
    common, heard = median(errors, np.empty(errors.size))
    if errors.size < 3 or 2 * heard <= errors.size:
        common = 0.0
    return abs(errors[cylinder] - common) > numbers[k.LARGEST_ERROR]


@inlined
def take_duration(
    values: FloatArray, rows: FloatArray, n: int, cylinder: int, error: float, numbers: FloatArray
) -> None:
    """Take in the error of a told duration, s, of a cylinder from 0 (NaN: kept shut)."""
    if math.isnan(error):
        rows[k.ERROR, cylinder], rows[k.SILENT, cylinder] = error, 0.0
        return
    if values[k.UNTOLD] > n:  # the sensor is back, and the others are still to come
        rows[k.SILENT, :] = 0.0
    values[k.UNTOLD] = 0.0
    before, most = rows[k.ERROR, cylinder], numbers[k.LARGEST_ERROR]
    if abs(before) <= most and abs(error) <= most:
        # Of steady durations half the square of a change is, in the mean, their variance.
        change = min(abs(error - before), k.JUMP * numbers[k.ERROR_LIMIT])
        rows[k.ROUGH, cylinder] += k.ROUGH_SHARE * (0.5 * change**2 - rows[k.ROUGH, cylinder])
    rows[k.ERROR, cylinder] = error
    rows[k.SILENT, cylinder] = 0.0
    middle, heard = median(rows[k.ERROR], np.empty(n))
    if math.isfinite(error) and 2 * heard > n:
        apart = min(abs(error - middle), numbers[k.LARGEST_ERROR])  # one cannot count for ever
        values[k.SPREAD] += k.SPREAD_SHARE * (apart**2 - values[k.SPREAD])
    if is_far(rows[k.ERROR], cylinder, numbers):
        rows[k.BAD, cylinder] += 1.0
        rows[k.GOOD, cylinder] = 0.0


@inlined
def promised_inflow(values: FloatArray, charge: float, shares: FloatArray) -> float:
    """What flowed in since the last IVO as the commands promise it, kg."""
    own = rest = 0.0
    for i in range(shares.size):
        if i < PARTS:
            own += shares[i]
        else:
            rest += shares[i]
    inflow = charge * own + values[k.TAIL]
    values[k.TAIL] = charge * rest
    return inflow


@inlined
def compare_flow(
    values: FloatArray,
    numbers: FloatArray,
    dt: float,
    inflow: float,
    charge: float,
    flow: float,
    previous: float,
) -> tuple[float, float]:
    """Return ln of measured over promised flow, and the share of the pressure that it drops.

    The mean of a first-order lag's input is that of its output and what the output has risen by,
    times the lag.
    """
    ratio = drop = math.nan
    if inflow > 0.0 and dt > 0.0:
        if charge > 0.0 and math.isfinite(flow) and math.isfinite(previous):
            seen = flow * dt + numbers[k.MAF_TIME] * (values[k.MAF_LAST] - previous)
            ratio = math.log(max(seen / inflow, 1e-3))
        drop = k.PULSE * 0.25 * (inflow / dt / numbers[k.AREA]) ** 2  # Eq. 14, of small drops
    elif values[k.EVENTS] > 1.0:
        drop = 0.0  # all valves have been kept shut
    return ratio, drop


@inlined
def judge_pressure(
    values: FloatArray,
    rows: FloatArray,
    numbers: FloatArray,
    n: int,
    dt: float,
    dead: bool,
    ranked: FloatArray,
) -> None:
    """Hold the pressure before the throttle against what it was."""
    if dead and values[k.MAP_STILL] * numbers[k.PRESSURE_RATE] > numbers[k.PRESSURE_LIMIT]:
        values[k.AMBIENT] = math.nan  # by now it may be another one
    press, known = median(rows[k.PRESSURE], ranked)
    part, _ = median(rows[k.DROP], ranked)
    ambient = press / (1.0 - part) if 2 * known > n and part < 0.5 else math.nan
    if not math.isfinite(values[k.AMBIENT]) or values[k.EVENTS] < 2.0 * n:
        values[k.AMBIENT] = ambient
    away = ambient - values[k.AMBIENT]
    off = abs(away) > numbers[k.PRESSURE_LIMIT]
    near = abs(away) < k.HALF * numbers[k.PRESSURE_LIMIT]
    latch(values, k.MAP_GOOD, dead or off, near and not dead, k.MAP, numbers[k.RECOVERY])
    lost = int(values[k.ALARMS]) & k.MAP != 0
    values[k.MAP_OUT] = values[k.MAP_OUT] + dt if lost and not dead else 0.0
    # A reading that stays where it is may be right: MAF corrects what it has wrong.
    if math.isfinite(away) and (not lost or values[k.MAP_OUT] > numbers[k.PATIENCE]):
        most = numbers[k.PRESSURE_RATE] * dt
        values[k.AMBIENT] += min(max((1.0 if lost else 0.1) * away, -most), most)


@inlined
def take_ratio(
    values: FloatArray,
    rows: FloatArray,
    n: int,
    cylinder: int,
    of: int,
    ratio: float,
    refused: bool,
    before: int,
) -> None:
    """Take in the estimated over the promised charge of `of` (-1 for none)."""
    if int(values[k.ALARMS]) & k.MAP != before & k.MAP:
        values[k.WAIT] = 2.0 * n  # the estimates have to settle without that sensor, or with it
    if values[k.WAIT] > 0.0:
        values[k.WAIT] -= 1.0
        values[k.SCORE] = 0.0
        rows[k.RATIO, :] = math.nan
    elif of >= 0:
        rows[k.RATIO, of] = ratio
    elif refused:
        rows[k.RATIO, (cylinder - k.LATENCY) % n] = math.nan


@inlined
def judge_valves(
    values: FloatArray,
    rows: FloatArray,
    numbers: FloatArray,
    n: int,
    cylinder: int,
    of: int,
    middle: float,
) -> int:
    """Hold each valve against the others; return how many are suspect.

    `of` is the cylinder whose estimate is to be judged (-1 for none), `middle` that of all.
    """
    suspects = 0
    for i in range(n):
        if i == of:
            apart = abs(rows[k.RATIO, i] - middle)
            if apart > numbers[k.VALVE_LIMIT]:
                rows[k.BAD, i] += 1.0
                rows[k.GOOD, i] = 0.0
            else:
                if rows[k.BAD, i] < k.TWICE and not is_far(rows[k.ERROR], i, numbers):
                    rows[k.BAD, i] = 0.0
                if apart < k.HALF * numbers[k.VALVE_LIMIT]:
                    rows[k.GOOD, i] += 1.0
        if i == cylinder:
            rows[k.SILENT, i] += 1.0
        alone = rows[k.SILENT, i] > k.SILENT_CYCLES and values[k.UNTOLD] < n
        rough = rows[k.ROUGH, i] > (k.ROUGH_LIMIT * numbers[k.ERROR_LIMIT]) ** 2
        smooth = rows[k.ROUGH, i] < (k.HALF * k.ROUGH_LIMIT * numbers[k.ERROR_LIMIT]) ** 2
        if rows[k.BAD, i] >= k.TWICE or alone or rough:
            rows[k.BAD, i] = max(rows[k.BAD, i], k.TWICE)
            near = smooth and not alone and not is_far(rows[k.ERROR], i, numbers)
            if rows[k.GOOD, i] >= k.THRICE and near:
                rows[k.BAD, i] = 0.0
        if rows[k.BAD, i] >= k.TWICE:
            suspects += 1
    alarms = int(values[k.ALARMS]) & ~k.VALVE
    values[k.ALARMS] = alarms | k.VALVE if suspects else alarms
    return suspects


@inlined
def judge_innovations(
    values: FloatArray,
    rows: FloatArray,
    numbers: FloatArray,
    n: int,
    cylinder: int,
    innovation: float,
    refused: bool,
    ranked: FloatArray,
) -> None:
    """Sum up the innovations of most cylinders: those of one are its valve's."""
    if refused:
        rows[k.ODD, (cylinder - k.LATENCY) % n] = k.GATE
    elif math.isfinite(innovation):
        rows[k.ODD, (cylinder - k.LATENCY) % n] = min(innovation, k.GATE)
    alarms = int(values[k.ALARMS])
    if values[k.WAIT] == 0.0 and (refused or math.isfinite(innovation)):
        ranks(rows[k.ODD], ranked)
        odd = ranked[(n - 1) // 2]
        if values[k.LEARNT] >= 0.0 and odd < k.GATE:
            odd = 0.0  # at the start the model may be wrong; windows that are refused count
        allowed = max(numbers[k.ALLOWANCE], k.ODD_FACTOR * values[k.BASE])
        score = values[k.SCORE] + odd - min(allowed, k.HALF * k.GATE)
        values[k.SCORE] = min(max(score, 0.0), 2.0 * numbers[k.SCORE_LIMIT])
        if not alarms & k.SENSORS:
            share = k.ODD_SHARE if values[k.LEARNT] >= 0.0 else 0.1 * k.ODD_SHARE
            values[k.BASE] += share * (min(ranked[(n - 1) // 2], k.GATE) - values[k.BASE])
    if values[k.SCORE] > numbers[k.SCORE_LIMIT]:
        alarms |= k.INNOVATION
    elif values[k.SCORE] < 0.25 * numbers[k.SCORE_LIMIT]:
        alarms &= ~k.INNOVATION
    values[k.ALARMS] = alarms


@inlined
def judge_air_flow(
    values: FloatArray,
    rows: FloatArray,
    numbers: FloatArray,
    n: int,
    dt: float,
    dead: bool,
    doubted: bool,
    middle: float,
    enough: bool,
    ranked: FloatArray,
) -> None:
    """Hold the air flow against model and pressure; `doubted` if valves may be the cause."""
    strange = int(values[k.ALARMS]) & k.INNOVATION != 0
    limit = numbers[k.RATIO_LIMIT] if values[k.LEARNT] < 0.0 else numbers[k.FIRST_RATIO]
    flows, some = median(rows[k.FLOW], ranked)
    levels, _ = median(rows[k.LEVELS], ranked)
    moved = levels - values[k.LEVEL]
    # While it is not believed, the level may change as it does without a fault.
    lost = int(values[k.ALARMS]) & k.MAF != 0
    values[k.MAF_OUT] = values[k.MAF_OUT] + dt if lost else 0.0
    room = k.HALF * numbers[k.RATIO_LIMIT]
    room = max(room, min(room + k.LEVEL_RATE * values[k.MAF_OUT], k.LARGEST_CHANGE))
    off = enough and abs(middle) > max(limit, room)
    if 2 * some >= n:
        # Without estimates, or with strange ones, the flow itself has to say it.
        off = off or (not enough and abs(flows) > numbers[k.FIRST_RATIO])
        odd = strange and values[k.LEARNT] < 0.0 and not lost
        off = off or (odd and abs(flows - values[k.FLOW_BIAS]) > numbers[k.FLOW_LIMIT])
    # What has been learnt of a drift, and what has not been yet
    drift = moved + middle if enough and not lost else moved
    off = off or (values[k.LEARNT] < 0.0 and abs(drift) > numbers[k.LEVEL_LIMIT])
    off = off or (values[k.EVENTS] > k.SETTLED * n and abs(levels) > numbers[k.LEVEL_BOUND])
    off = off and values[k.WAIT] == 0.0 and not doubted
    values[k.MAF_OFF] = values[k.MAF_OFF] + 1.0 if off else 0.0
    off = 2.0 * values[k.MAF_OFF] > n
    near = enough and abs(middle) < room and not off
    latch(values, k.MAF_GOOD, dead or off, near and not dead, k.MAF, numbers[k.RECOVERY])
    back = lost and not int(values[k.ALARMS]) & k.MAF
    if back and abs(middle) > k.HALF * numbers[k.RATIO_LIMIT]:
        values[k.LEARNT] = 0.0  # what holds now is to be found


@inlined
def judge_durations(
    values: FloatArray,
    rows: FloatArray,
    numbers: FloatArray,
    n: int,
    charge: float,
    scattered: bool,
    ranked: FloatArray,
) -> None:
    """Judge what all durations share."""
    values[k.UNTOLD] += 1.0 if charge > 0.0 else 0.0
    late, heard = median(rows[k.ERROR], ranked)
    missing = values[k.UNTOLD] > k.UNTOLD_CYCLES * n and charge > 0.0
    off = 2 * heard > n and abs(late) > numbers[k.ERROR_LIMIT] and not scattered
    values[k.LATE] = values[k.LATE] + 1.0 if off else 0.0
    off = values[k.LATE] >= n
    near = not abs(late) > k.HALF * numbers[k.ERROR_LIMIT] and not missing
    latch(values, k.DURATION_GOOD, missing or off, near, k.DURATION, numbers[k.RECOVERY])


@inlined
def follow(
    values: FloatArray,
    rows: FloatArray,
    numbers: FloatArray,
    n: int,
    dt: float,
    middle: float,
    enough: bool,
    before: int,
    ranked: FloatArray,
) -> None:
    """Move the slow means, and say whether all is calm."""
    alarms = int(values[k.ALARMS])
    if alarms & k.DURATION & ~before:
        values[k.WAIT] = 2.0 * n  # events that were commanded with what was learnt of it
    unnamed = alarms & k.SENSORS == k.INNOVATION
    values[k.ALONE] = values[k.ALONE] + dt if unnamed else 0.0
    levels, _ = median(rows[k.LEVELS], ranked)
    flows, _ = median(rows[k.FLOW], ranked)
    right = enough and abs(middle) < k.HALF * numbers[k.RATIO_LIMIT]
    calm = alarms & ~k.VALVE == 0 and values[k.SCORE] < 0.25 * numbers[k.SCORE_LIMIT]
    steady = not abs(levels - values[k.LEVEL]) > k.HALF * numbers[k.LEVEL_LIMIT]
    values[k.CALM] = calm and right and steady
    if values[k.LEARNT] >= 0.0:
        values[k.LEARNT] = values[k.LEARNT] + 1.0 if right else 0.0
        if values[k.LEARNT] >= k.ESTABLISHED * n:
            values[k.LEARNT] = -1.0
        values[k.LEVEL], values[k.FLOW_BIAS] = levels, flows
    elif not alarms & k.SENSORS:
        # What was learnt last at the start is not what holds: the mean is a young one at first.
        values[k.LEARNT] -= dt
        time = min(numbers[k.LEVEL_TIME], k.YOUNG * (1.0 - values[k.LEARNT]))
        if math.isfinite(levels):
            values[k.LEVEL] += (levels - values[k.LEVEL]) * -math.expm1(-dt / time)
        bias = flows - values[k.FLOW_BIAS]
        if math.isfinite(bias):
            values[k.FLOW_BIAS] += bias * -math.expm1(-dt / k.FLOW_TIME)
