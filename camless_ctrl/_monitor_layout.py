"""Where a monitor keeps what it remembers, and the numbers that its rules use."""

from __future__ import annotations

from .alarms import Alarm

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

# Numbers of a `FaultMonitor`, in the order of its fields
(
    AREA,
    MAF_TIME,
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

MAF, MAP, DURATION, VALVE, INNOVATION = (
    int(a) for a in (Alarm.MAF, Alarm.MAP, Alarm.DURATION, Alarm.VALVE, Alarm.INNOVATION)
)
SENSORS = MAF | MAP | DURATION | INNOVATION

# The rules' own numbers
GATE = 10.0  # to which one normalised innovation counts; a window that is refused counts as it
LATENCY = 3  # events from an IVO until it is estimated, but for long delays
FLOW_TIME = 2.0  # s, over which the bias of the flow is followed
PULSE = 1.3  # mean square of the flow over the square of its mean
HALF = 0.5  # of a limit, under which nothing is suspicious
ESTABLISHED = 5  # cycles in a row in which the model is right, after which it is held to that
UNTOLD_CYCLES = 2  # without any duration
SILENT_CYCLES = 3  # without a duration of one valve
YOUNG = 0.25  # of the time since the start, over which the level is averaged at first
SCATTER = 0.7  # limits of a duration error, 1 sigma, beyond which valves scatter
ROUGH_LIMIT = 0.9  # the same of one valve, over some cycles
JUMP = 2.5  # limits that a change from cycle to cycle may count: one jump is no scatter
ROUGH_SHARE = 0.2  # of the last error in its mean square
SPREAD_SHARE = 0.05  # of the last error in the slow mean square
TWICE = 2  # times in a row that a valve has to be off
SETTLED = 15  # cycles from the start, after which the learnt level is to be a possible one
ODD_FACTOR = 1.5  # over the innovations without a fault, that is allowed
ODD_SHARE = 0.02  # of the last innovation in that, at the start; a tenth of it later
LEVEL_RATE = 0.005  # 1/s, by which the level may have changed while MAF was not believed
LARGEST_CHANGE = 0.15  # 1, of it
THRICE = 3  # estimates in a row that clear a valve
