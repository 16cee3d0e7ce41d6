"""Compiled arithmetic of the plausibility monitors. Imported when a monitor is first used."""

from __future__ import annotations

import math

import numba
import numpy as np

from plant.kinematics import FloatArray

from .alarms import Alarm
from .event_data import PARTS

# What a monitor remembers: single numbers, then rows of one number a cylinder
(
    EVENTS,  # events seen
    SCORE,  # sum of excess innovations
    LEVEL,  # slow mean of the learnt level, 1
    AMBIENT,  # pressure before the throttle that is believed, Pa
    FLOW_BIAS,  # slow mean of ln of measured over expected flow, 1
    TAIL,  # inflow of the last event after its own window, kg
    MAF_LAST,  # last reading, kg/s
    MAF_SAME,  # readings in a row that equal it
    MAF_STILL,  # time since it changed, s
    MAF_GONE,  # time without a reading, s
    MAP_LAST,  # Pa
    MAP_SAME,
    MAP_STILL,
    MAP_GONE,
    UNTOLD,  # events with a lift since a duration was told
    LEARNT,  # events in a row in which the model was right; then less than 0: s since, and 1
    WAIT,  # events until estimates are judged again
    MAF_GOOD,  # events in a row without a finding against the sensor
    MAP_GOOD,
    DURATION_GOOD,
    ALARMS,
    CALM,  # whether nothing at all is suspicious
    MAF_OFF,  # events in a row in which the air flow contradicts the rest
    LATE,  # events in a row in which all durations are off alike
    SPREAD,  # slow mean square of the duration errors about their median, s2
    MAF_OUT,  # time for which the alarm of a sensor stands, s
    MAP_OUT,
    ALONE,  # time for which INNOVATION stands and no sensor is named, s
    BASE,  # innovations of most cylinders as they are without a fault, 1
    HEAD,
) = range(30)
RATIO, FLOW, ERROR, PRESSURE, DROP, LEVELS, ODD, SILENT, BAD, GOOD, ROUGH = range(11)  # rows
ROWS = 11

# Numbers of a monitor, in the order of its fields
(
    MAF_TIME,
    AREA,
    RATIO_LIMIT,
    FIRST_RATIO,
    FLOW_LIMIT,
    LEVEL_LIMIT,
    LEVEL_TIME,
    ALLOWANCE,
    SCORE_LIMIT,
    SAME,
    GONE,
    PRESSURE_LIMIT,
    PRESSURE_RATE,
    ERROR_LIMIT,
    LARGEST_ERROR,
    VALVE_LIMIT,
    RECOVERY,
    LEVEL_BOUND,
    PATIENCE,
) = range(19)

_MAF, _MAP, _DURATION, _VALVE, _INNOVATION = (
    int(a) for a in (Alarm.MAF, Alarm.MAP, Alarm.DURATION, Alarm.VALVE, Alarm.INNOVATION)
)
_SENSORS = _MAF | _MAP | _DURATION | _INNOVATION
_GATE = 10.0  # to which one normalised innovation counts; a window that is refused counts as it
_LATENCY = 3  # events from an IVO until it is estimated, but for long delays
_FLOW_TIME = 2.0  # s, over which the bias of the flow is followed
_PULSE = 1.3  # mean square of the flow over the square of its mean
_HALF = 0.5  # of a limit, under which nothing is suspicious
_ESTABLISHED = 5  # cycles in a row in which the model is right, after which it is held to that
_UNTOLD_CYCLES = 2  # without any duration
_SILENT_CYCLES = 3  # without a duration of one valve
_YOUNG = 0.25  # of the time since the start, over which the level is averaged at first
_SCATTER = 0.7  # limits of a duration error, 1 sigma, beyond which valves scatter
_ROUGH = 0.9  # the same of one valve, over some cycles
_JUMP = 2.5  # limits that a change from cycle to cycle may count: one jump is no scatter
_ROUGH_SHARE = 0.2  # of the last error in its mean square
_SPREAD_SHARE = 0.05  # of the last error in the slow mean square
TWICE = 2  # times in a row that a valve has to be off
_SETTLED = 15  # cycles from the start, after which the learnt level is to be a possible one
_ODD_FACTOR = 1.5  # over the innovations without a fault, that is allowed
_ODD_SHARE = 0.02  # of the last innovation in that, at the start; a tenth of it later
_LEVEL_RATE = 0.005  # 1/s, by which the level may have changed while MAF was not believed
_LARGEST_CHANGE = 0.15  # 1, of it
_THRICE = 3  # estimates in a row that clear a valve

_V = "Array(f8, 1, 'C', readonly=True)"
_A = "Array(f8, 1, 'A', readonly=True)"


@numba.njit(nogil=True, error_model="numpy")
def _ranked(row: FloatArray, ranked: FloatArray) -> int:
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


@numba.njit(nogil=True, error_model="numpy")
def _middle(row: FloatArray, ranked: FloatArray) -> tuple[float, int]:
    """Median of what is known, and how many are."""
    count = _ranked(row, ranked)
    if count == 0:
        return math.nan, 0
    return 0.5 * (ranked[(count - 1) // 2] + ranked[count // 2]), count


@numba.njit(nogil=True, error_model="numpy")
def _readings(values: FloatArray, at: int, readings: FloatArray, dt: float) -> float:
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


@numba.njit(nogil=True, error_model="numpy")
def _dead(values: FloatArray, at: int, numbers: FloatArray, dt: float, flows: bool) -> bool:
    """Whether a sensor holds one reading though air flows, or gives none."""
    still = flows and values[at + 1] >= numbers[SAME] and values[at + 2] >= dt
    return still or values[at + 3] > max(numbers[GONE], 1.5 * dt)


@numba.njit(nogil=True, error_model="numpy")
def _latched(values: FloatArray, good: int, bad: bool, fine: bool, bit: int, wait: float) -> None:
    """Raise an alarm at once, and clear it after enough events without a finding."""
    alarms = int(values[ALARMS])
    if bad:
        alarms |= bit
        values[good] = 0.0
    elif alarms & bit:
        values[good] = values[good] + 1.0 if fine else 0.0
        if values[good] >= wait:
            alarms &= ~bit
    values[ALARMS] = alarms


@numba.njit(nogil=True, error_model="numpy")
def _far(errors: FloatArray, cylinder: int, numbers: FloatArray) -> bool:
    """Whether a valve's duration is far off; what most of three or more share is the sensor's."""
    common, heard = _middle(errors, np.empty(errors.size))
    if errors.size < 3 or 2 * heard <= errors.size:
        common = 0.0
    return abs(errors[cylinder] - common) > numbers[LARGEST_ERROR]


@numba.njit(f"void(f8[::1], i8, i8, f8, {_V})", cache=True, nogil=True, error_model="numpy")
def told(values: FloatArray, n: int, cylinder: int, error: float, numbers: FloatArray) -> None:
    """Take in the error of a told duration, s, of a cylinder from 0 (NaN: kept shut); in place."""
    rows = values[HEAD:].reshape(ROWS, n)
    if math.isnan(error):
        rows[ERROR, cylinder], rows[SILENT, cylinder] = error, 0.0
        return
    if values[UNTOLD] > n:  # the sensor is back, and the others are still to come
        rows[SILENT, :] = 0.0
    values[UNTOLD] = 0.0
    before, most = rows[ERROR, cylinder], numbers[LARGEST_ERROR]
    if abs(before) <= most and abs(error) <= most:
        # Of steady durations half the square of a change is, in the mean, their variance.
        change = min(abs(error - before), _JUMP * numbers[ERROR_LIMIT])
        rows[ROUGH, cylinder] += _ROUGH_SHARE * (0.5 * change**2 - rows[ROUGH, cylinder])
    rows[ERROR, cylinder] = error
    rows[SILENT, cylinder] = 0.0
    middle, heard = _middle(rows[ERROR], np.empty(n))
    if math.isfinite(error) and 2 * heard > n:
        apart = min(abs(error - middle), numbers[LARGEST_ERROR])  # one cannot count for ever
        values[SPREAD] += _SPREAD_SHARE * (apart**2 - values[SPREAD])
    if _far(rows[ERROR], cylinder, numbers):
        rows[BAD, cylinder] += 1.0
        rows[GOOD, cylinder] = 0.0


@numba.njit(
    f"void(f8[::1], {_V}, i8, i8, f8, i8, f8, {_A}, {_A}, i8, f8, f8, b1, f8, f8, {_A})",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def judge(
    values: FloatArray,
    numbers: FloatArray,
    n: int,
    cylinder: int,
    dt: float,
    heard: int,
    late: float,
    maf: FloatArray,
    map_: FloatArray,
    of: int,
    ratio: float,
    innovation: float,
    refused: bool,
    level: float,
    charge: float,
    shares: FloatArray,
) -> None:
    """Take in one event and judge; in place.

    `cylinder` opens next, the duration of `heard` is told (-1 for none), `of` has the estimate.
    """
    if heard >= 0:
        told(values, n, heard, late, numbers)
    rows = values[HEAD:].reshape(ROWS, n)
    ranked = np.empty(n)
    before = int(values[ALARMS])
    values[EVENTS] += 1.0
    previous = values[MAF_LAST]
    flow = _readings(values, MAF_LAST, maf, dt)
    pressure = _readings(values, MAP_LAST, map_, dt)

    # What flowed in since the last IVO as the commands promise it, kg
    own = rest = 0.0
    for i in range(shares.size):
        if i < PARTS:
            own += shares[i]
        else:
            rest += shares[i]
    inflow = charge * own + values[TAIL]
    values[TAIL] = charge * rest
    # Measured over expected flow. The mean of a first-order lag's input is that of its output
    # and what the output has risen by, times the lag.
    last = (cylinder - 1) % n
    rows[FLOW, last] = math.nan
    drop = math.nan
    if inflow > 0.0 and dt > 0.0:
        if charge > 0.0 and math.isfinite(flow) and math.isfinite(previous):
            seen = flow * dt + numbers[MAF_TIME] * (values[MAF_LAST] - previous)
            rows[FLOW, last] = math.log(max(seen / inflow, 1e-3))
        drop = _PULSE * 0.25 * (inflow / dt / numbers[AREA]) ** 2  # Eq. 14, of small drops
    elif values[EVENTS] > 1.0:
        drop = 0.0  # all valves have been kept shut
    if charge == 0.0:
        rows[RATIO, last] = math.nan
    dead = _dead(values, MAP_LAST, numbers, dt, inflow > 0.0)
    rows[PRESSURE, last], rows[DROP, last] = math.nan if dead else pressure, drop
    if dead and values[MAP_STILL] * numbers[PRESSURE_RATE] > numbers[PRESSURE_LIMIT]:
        values[AMBIENT] = math.nan  # by now it may be another one
    rows[LEVELS, last] = level

    # Pressure before the throttle, against what it was
    press, known = _middle(rows[PRESSURE], ranked)
    part, _ = _middle(rows[DROP], ranked)
    ambient = press / (1.0 - part) if 2 * known > n and part < 0.5 else math.nan
    if not math.isfinite(values[AMBIENT]) or values[EVENTS] < 2.0 * n:
        values[AMBIENT] = ambient
    away = ambient - values[AMBIENT]
    off = abs(away) > numbers[PRESSURE_LIMIT]
    near = abs(away) < _HALF * numbers[PRESSURE_LIMIT]
    _latched(values, MAP_GOOD, dead or off, near and not dead, _MAP, numbers[RECOVERY])
    lost = int(values[ALARMS]) & _MAP != 0
    values[MAP_OUT] = values[MAP_OUT] + dt if lost and not dead else 0.0
    # A reading that stays where it is may be right: MAF corrects what it has wrong.
    if math.isfinite(away) and (not lost or values[MAP_OUT] > numbers[PATIENCE]):
        most = numbers[PRESSURE_RATE] * dt
        values[AMBIENT] += min(max((1.0 if lost else 0.1) * away, -most), most)

    # Estimated over expected charge
    if int(values[ALARMS]) & _MAP != before & _MAP:
        values[WAIT] = 2.0 * n  # the estimates have to settle without that sensor, or with it
    if values[WAIT] > 0.0:
        values[WAIT] -= 1.0
        values[SCORE] = 0.0
        rows[RATIO, :] = math.nan
    elif of >= 0:
        rows[RATIO, of] = ratio
    elif refused:
        rows[RATIO, (cylinder - _LATENCY) % n] = math.nan
    middle, count = _middle(rows[RATIO], ranked)
    enough = 2 * count >= n
    flows, some = _middle(rows[FLOW], ranked)
    bias = flows - values[FLOW_BIAS]

    # A valve by itself
    suspects = 0
    for i in range(n):
        if i == of and enough and values[WAIT] == 0.0 and not before & _MAF:
            apart = abs(rows[RATIO, i] - middle)
            if apart > numbers[VALVE_LIMIT]:
                rows[BAD, i] += 1.0
                rows[GOOD, i] = 0.0
            else:
                if rows[BAD, i] < TWICE and not _far(rows[ERROR], i, numbers):
                    rows[BAD, i] = 0.0
                if apart < _HALF * numbers[VALVE_LIMIT]:
                    rows[GOOD, i] += 1.0
        if i == cylinder:
            rows[SILENT, i] += 1.0
        alone = rows[SILENT, i] > _SILENT_CYCLES and values[UNTOLD] < n
        rough = rows[ROUGH, i] > (_ROUGH * numbers[ERROR_LIMIT]) ** 2
        smooth = rows[ROUGH, i] < (_HALF * _ROUGH * numbers[ERROR_LIMIT]) ** 2
        if rows[BAD, i] >= TWICE or alone or rough:
            rows[BAD, i] = max(rows[BAD, i], TWICE)
            near = smooth and not alone and not _far(rows[ERROR], i, numbers)
            if rows[GOOD, i] >= _THRICE and near:
                rows[BAD, i] = 0.0
        if rows[BAD, i] >= TWICE:
            suspects += 1
    alarms = int(values[ALARMS]) & ~_VALVE
    values[ALARMS] = alarms | _VALVE if suspects else alarms

    # Innovations of most cylinders: those of one are its valve's
    if refused:
        rows[ODD, (cylinder - _LATENCY) % n] = _GATE
    elif math.isfinite(innovation):
        rows[ODD, (cylinder - _LATENCY) % n] = min(innovation, _GATE)
    alarms = int(values[ALARMS])
    if values[WAIT] == 0.0 and (refused or math.isfinite(innovation)):
        _ranked(rows[ODD], ranked)
        odd = ranked[(n - 1) // 2]
        if values[LEARNT] >= 0.0 and odd < _GATE:
            odd = 0.0  # at the start the model may be wrong; windows that are refused count
        allowed = max(numbers[ALLOWANCE], _ODD_FACTOR * values[BASE])
        score = values[SCORE] + odd - min(allowed, _HALF * _GATE)
        values[SCORE] = min(max(score, 0.0), 2.0 * numbers[SCORE_LIMIT])
        if not alarms & _SENSORS:
            share = _ODD_SHARE if values[LEARNT] >= 0.0 else 0.1 * _ODD_SHARE
            values[BASE] += share * (min(ranked[(n - 1) // 2], _GATE) - values[BASE])
    if values[SCORE] > numbers[SCORE_LIMIT]:
        alarms |= _INNOVATION
    elif values[SCORE] < 0.25 * numbers[SCORE_LIMIT]:
        alarms &= ~_INNOVATION
    values[ALARMS] = alarms
    strange = alarms & _INNOVATION != 0

    # Valves that scatter are neither a sensor's fault nor a valve's
    scattered = values[SPREAD] > (_SCATTER * numbers[ERROR_LIMIT]) ** 2

    # Air flow against model and pressure
    limit = numbers[RATIO_LIMIT] if values[LEARNT] < 0.0 else numbers[FIRST_RATIO]
    levels, _ = _middle(rows[LEVELS], ranked)
    moved = levels - values[LEVEL]
    dead = _dead(values, MAF_LAST, numbers, dt, True) and inflow > 0.0
    # While it is not believed, the level may change as it does without a fault.
    lost = int(values[ALARMS]) & _MAF != 0
    values[MAF_OUT] = values[MAF_OUT] + dt if lost else 0.0
    room = _HALF * numbers[RATIO_LIMIT]
    room = max(room, min(room + _LEVEL_RATE * values[MAF_OUT], _LARGEST_CHANGE))
    off = enough and abs(middle) > max(limit, room)
    if 2 * some >= n:
        # Without estimates, or with strange ones, the flow itself has to say it.
        off = off or (not enough and abs(flows) > numbers[FIRST_RATIO])
        doubt = strange and values[LEARNT] < 0.0 and not lost
        off = off or (doubt and abs(bias) > numbers[FLOW_LIMIT])
    # What has been learnt of a drift, and what has not been yet
    drift = moved + middle if enough and not lost else moved
    off = off or (values[LEARNT] < 0.0 and abs(drift) > numbers[LEVEL_LIMIT])
    off = off or (values[EVENTS] > _SETTLED * n and abs(levels) > numbers[LEVEL_BOUND])
    off = off and suspects == 0 and values[WAIT] == 0.0 and not scattered
    values[MAF_OFF] = values[MAF_OFF] + 1.0 if off else 0.0
    off = 2.0 * values[MAF_OFF] > n
    near = enough and abs(middle) < room and not off
    _latched(values, MAF_GOOD, dead or off, near and not dead, _MAF, numbers[RECOVERY])
    if lost and not int(values[ALARMS]) & _MAF and abs(middle) > _HALF * numbers[RATIO_LIMIT]:
        values[LEARNT] = 0.0  # what holds now is to be found

    # Durations
    values[UNTOLD] += 1.0 if charge > 0.0 else 0.0
    late, some = _middle(rows[ERROR], ranked)
    missing = values[UNTOLD] > _UNTOLD_CYCLES * n and charge > 0.0
    off = 2 * some > n and abs(late) > numbers[ERROR_LIMIT] and not scattered
    values[LATE] = values[LATE] + 1.0 if off else 0.0
    off = values[LATE] >= n
    near = not abs(late) > _HALF * numbers[ERROR_LIMIT]
    _latched(values, DURATION_GOOD, missing or off, near and not missing, _DURATION,
             numbers[RECOVERY])  # fmt: skip

    # Slow means, and whether all is calm
    alarms = int(values[ALARMS])
    if alarms & _DURATION & ~before:
        values[WAIT] = 2.0 * n  # events that were commanded with what was learnt of it
    unnamed = alarms & _SENSORS == _INNOVATION
    values[ALONE] = values[ALONE] + dt if unnamed else 0.0
    calm = alarms & ~_VALVE == 0 and values[SCORE] < 0.25 * numbers[SCORE_LIMIT]
    calm = calm and enough and abs(middle) < _HALF * numbers[RATIO_LIMIT]
    calm = calm and not abs(moved) > _HALF * numbers[LEVEL_LIMIT]
    values[CALM] = calm
    if values[LEARNT] >= 0.0:
        right = enough and abs(middle) < _HALF * numbers[RATIO_LIMIT]
        values[LEARNT] = values[LEARNT] + 1.0 if right else 0.0
        if values[LEARNT] >= _ESTABLISHED * n:
            values[LEARNT] = -1.0
        values[LEVEL] = levels
        values[FLOW_BIAS] = flows
    elif not alarms & _SENSORS:
        # What was learnt last at the start is not what holds: the mean is a young one at first.
        values[LEARNT] -= dt
        time = min(numbers[LEVEL_TIME], _YOUNG * (1.0 - values[LEARNT]))
        if math.isfinite(levels):
            values[LEVEL] += (levels - values[LEVEL]) * -math.expm1(-dt / time)
        if math.isfinite(bias):
            values[FLOW_BIAS] += bias * -math.expm1(-dt / _FLOW_TIME)
