"""Compiled look-up and inverse of the charge model.

The table is a uniform bicubic B-spline (C2) over slowness (1/speed) and position: one cell and
sixteen weights give all quantities of a point. Imported when a model is first asked.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from plant.kinematics import FloatArray

# Columns of the table.
CHARGE = 0  # kg
LIFT = 1  # mm
DURATION = 2  # s, as delivered
LOSS = 3  # J
FLOW = 4  # four columns: ln of the charge by powers 1 to 4 of the ln of the flow gain, 1
POWERS = 4
LIFT_SLOPE = 8  # two columns: ln of the charge by powers 1, 2 of lift that is taken off, mm
THROTTLE = 10  # two columns: ln of the charge by powers 1, 2 of ln of the throttle's gain, 1
DURATION_SLOPE = 12  # of the ln of the charge, at fixed lift, 1/s
NARROW = 13  # columns that the inverse reads
SHARES = 13  # as many columns as there are parts

# Entries of the settings.
LOG_GAIN_LOW, LOG_GAIN_HIGH = 0, 1  # ln of the fitted flow gains
SHORTEST_REST, SHORTEST_RATE = 2, 3  # shortest duration at zero lift, s, and its growth, s/mm
LOWEST_LIFT, MOST_DROP = 4, 5  # mm
LONGEST_DEG = 6
FIRST_SLOWNESS, SLOWNESS_STEP = 7, 8  # min, from the lowest speed, and min
HIGHEST_LIFT = 9  # mm
LOG_DENSITY_LOW, LOG_DENSITY_HIGH = 10, 11  # ln of the fitted densities

_ROUNDING = 1e-9  # relative miss of a charge at an end of the path that counts as on it
_MOST_STEPS = 80
_ON_TARGET = 1e-12  # of the ln of a charge

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")
# Said beforehand, so that a whole number as an argument is no reason to compile anew.
_INVERT = (
    "Tuple((f8, f8, f8, b1, f8, f8, f8))(Array(f8, 3, 'C', readonly=True), "
    "Array(f8, 1, 'C', readonly=True), f8, f8, f8, f8, f8, f8, f8[::1])"
)


@_jit
def _place(coordinate: float, cells: int) -> tuple[int, float]:
    """Cell of a coordinate in ``[0, cells]`` and where in the cell it is."""
    cell = min(max(int(coordinate), 0), cells - 1)
    return cell, coordinate - cell


@_jit
def _weights(t: float) -> tuple[float, float, float, float]:
    """Weights of the uniform cubic B-spline."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 - t * t * (6.0 - 3.0 * t)) / 6.0,
        (4.0 - s * s * (6.0 - 3.0 * s)) / 6.0,
        t * t * t / 6.0,
    )


@_jit
def _row(spline: FloatArray, coordinate: float, columns: int) -> FloatArray:
    """Coefficients along the path at one speed, (positions + 2, columns)."""
    i, t = _place(coordinate, spline.shape[0] - 3)
    w0, w1, w2, w3 = _weights(t)
    row = np.empty((spline.shape[1], columns))
    for j in range(spline.shape[1]):
        for k in range(columns):
            row[j, k] = (
                w0 * spline[i, j, k]
                + w1 * spline[i + 1, j, k]
                + w2 * spline[i + 2, j, k]
                + w3 * spline[i + 3, j, k]
            )
    return row


@_jit
def _clamped(value: float, low: float, high: float) -> tuple[float, bool]:
    inside = min(max(value, low), high)
    return inside, inside != value


@_jit
def _row_in(
    spline: FloatArray, coordinate: float, log_density: float, settings: FloatArray
) -> tuple[FloatArray, bool]:
    """Row at one speed in air of a density, and whether that was limited.

    What a throttle does that is wider by comparison comes to stand in the column THROTTLE.
    """
    low, high = settings[LOG_DENSITY_LOW], settings[LOG_DENSITY_HIGH]
    inside, limited = _clamped(log_density, low, high)
    row = _row(spline, coordinate, NARROW)
    for j in range(row.shape[0]):
        row[j, THROTTLE] = -inside * (row[j, THROTTLE] - inside * row[j, THROTTLE + 1])
    return row, limited


@_jit
def _at(row: FloatArray, position: float, column: int) -> float:
    j, t = _place(position, row.shape[0] - 3)
    w0, w1, w2, w3 = _weights(t)
    return (
        w0 * row[j, column]
        + w1 * row[j + 1, column]
        + w2 * row[j + 2, column]
        + w3 * row[j + 3, column]
    )


@_jit
def _flow(row: FloatArray, position: float, x: float) -> tuple[float, float]:
    """Ln of the charge over the nominal at ln of the flow gain `x`, and its slope."""
    value = slope = 0.0
    for k in range(POWERS - 1, -1, -1):  # Horner's scheme
        a = _at(row, position, FLOW + k)
        slope = slope * x + (k + 1) * a
        value = (value + a) * x
    return value, slope


@_jit
def _log_charge(
    row: FloatArray, position: float, x: float, offset: float, settings: FloatArray
) -> tuple[float, float]:
    """Ln of the charge at a position, and the lift that can be commanded there.

    A valve that shuts late by `offset` needs a shorter command, which may not allow the path's
    lift. The highest lift that it allows is then commanded.
    """
    # Where the path comes to lie on the highest lift, the spline may exceed it a little.
    lift = min(_at(row, position, LIFT), settings[HIGHEST_LIFT])
    value, _ = _flow(row, position, x)
    value += _at(row, position, THROTTLE)
    value += math.log(max(_at(row, position, CHARGE), 1e-30))
    command = _at(row, position, DURATION) - offset
    highest = (command - settings[SHORTEST_REST]) / settings[SHORTEST_RATE]
    drop = lift - highest
    if drop > 0.0:
        slope, curve = _at(row, position, LIFT_SLOPE), _at(row, position, LIFT_SLOPE + 1)
        value += drop * (slope + drop * curve)
        lift = highest
    return value, lift


@_jit
def _room(
    row: FloatArray, position: float, offset: float, longest: float, settings: FloatArray
) -> tuple[float, float]:
    """Room of the command to the shortest and to the longest one at a position, s."""
    command = _at(row, position, DURATION) - offset
    lowest = max(settings[LOWEST_LIFT], _at(row, position, LIFT) - settings[MOST_DROP])
    return command - settings[SHORTEST_REST] - settings[SHORTEST_RATE] * lowest, longest - command


@_jit
def _end(
    row: FloatArray, from_top: int, offset: float, longest: float, settings: FloatArray
) -> float:
    """First (0) or last (1) position whose command is allowed; beyond the table if none is."""
    cells = row.shape[0] - 3
    node, step = (cells, -1) if from_top else (0, 1)
    while 0 <= node <= cells:
        if _room(row, float(node), offset, longest, settings)[from_top] >= 0.0:
            break
        node += step
    inside, outside = float(node), float(node - step)
    if not (0 <= node <= cells and 0 <= node - step <= cells):
        return inside
    for _ in range(50):
        middle = 0.5 * (inside + outside)
        if _room(row, middle, offset, longest, settings)[from_top] < 0.0:
            outside = middle
        else:
            inside = middle
    return inside


@_jit
def _ends(
    row: FloatArray, offset: float, speed_rpm: float, settings: FloatArray
) -> tuple[float, float]:
    """First and last position whose command is allowed; the first is the larger if none is."""
    longest = settings[LONGEST_DEG] / (6.0 * speed_rpm)
    first = _end(row, 0, offset, longest, settings)
    return first, _end(row, 1, offset, longest, settings)


@_jit
def _peak(
    row: FloatArray, low: float, high: float, x: float, offset: float, settings: FloatArray
) -> tuple[float, float]:
    """Last position up to which the charge rises, to a node, and the ln of the charge there."""
    # With a larger flow gain than the path was made for, flow reverses a little earlier.
    value = _log_charge(row, high, x, offset, settings)[0]
    while high > low:
        before = max(math.ceil(high) - 1.0, low)
        other = _log_charge(row, before, x, offset, settings)[0]
        if other < value:
            break
        high, value = before, other
    return high, value


@_jit
def _position(
    row: FloatArray,
    target: float,
    a: float,
    b: float,
    x: float,
    offset: float,
    settings: FloatArray,
) -> float:
    """Position between two ends whose ln of charge enclose the target."""
    fa = _log_charge(row, a, x, offset, settings)[0] - target
    fb = _log_charge(row, b, x, offset, settings)[0] - target
    while b - a > 1.0:  # down to the width of a cell
        middle = 0.5 * (a + b)
        f = _log_charge(row, middle, x, offset, settings)[0] - target
        if f > 0.0:
            b, fb = middle, f
        else:
            a, fa = middle, f
    side, middle = 0, a
    for step in range(_MOST_STEPS):
        # Regula falsi with the Illinois weights; bisection should that stall.
        if fb - fa > 0.0 and step < _MOST_STEPS // 2:
            middle = (a * fb - b * fa) / (fb - fa)
        else:
            middle = 0.5 * (a + b)
        f = _log_charge(row, middle, x, offset, settings)[0] - target
        if abs(f) < _ON_TARGET or b - a < 1e-14 * max(b, 1.0):
            break
        if f > 0.0:
            b, fb = middle, f
            if side == 1:
                fa *= 0.5
            side = 1
        else:
            a, fa = middle, f
            if side == -1:
                fb *= 0.5
            side = -1
    return middle


@_jit
def _coordinate(speed_rpm: float, nodes: int, settings: FloatArray) -> tuple[float, bool, float]:
    """Coordinate of a speed in the table, whether it was limited, and the limited speed."""
    place = settings[FIRST_SLOWNESS] - 1.0 / max(speed_rpm, 1e-3)
    place /= settings[SLOWNESS_STEP]
    inside, _ = _clamped(place, 0.0, nodes - 1.0)
    limited = abs(inside - place) > 1e-9 * nodes  # rounding at an end is no limit
    reached = 1.0 / (settings[FIRST_SLOWNESS] - inside * settings[SLOWNESS_STEP])
    return inside, limited, reached if limited else speed_rpm


@_jit
def _write(spline: FloatArray, place: float, position: float, first: int, out: FloatArray) -> None:
    """Write the columns from `first` on at a point of the table."""
    i, s = _place(place, spline.shape[0] - 3)
    j, t = _place(position, spline.shape[1] - 3)
    u, v = _weights(s), _weights(t)
    out[:] = 0.0
    for m in range(4):
        for n in range(4):
            weight = u[m] * v[n]
            for k in range(out.size):
                out[k] += weight * spline[i + m, j + n, first + k]


@numba.njit(_INVERT, cache=True, nogil=True, error_model="numpy")
def invert(
    spline: FloatArray,
    settings: FloatArray,
    demand: float,
    speed_rpm: float,
    gain: float,
    offset: float,
    factor: float,
    density: float,
    shares: FloatArray,
) -> tuple[float, float, float, bool, float, float, float]:
    """Solve the model for the position that gives a demand; write the shares.

    Returns lift (mm), commanded duration (deg), charge (kg), whether something was out of reach,
    the flow and the duration slope, and the position in cells; -1 if the offset leaves no command.
    """
    place, slow, speed = _coordinate(speed_rpm, spline.shape[0] - 2, settings)
    x, poor = _clamped(math.log(gain / density), settings[LOG_GAIN_LOW], settings[LOG_GAIN_HIGH])
    row, thin = _row_in(spline, place, math.log(density), settings)
    limited = slow or poor or thin
    low, high = _ends(row, offset, speed, settings)
    if low > high:
        return 0.0, 0.0, 0.0, True, 0.0, 0.0, -1.0
    scale = factor * density
    least = _log_charge(row, low, x, offset, settings)[0]
    high, most = _peak(row, low, high, x, offset, settings)
    target = math.log(demand / scale) if demand > 0.0 else least - 1.0
    if target <= least:
        position = low
        limited = limited or least - target > _ROUNDING
    elif target >= most:
        position = high
        limited = limited or target - most > _ROUNDING
    else:
        position = _position(row, target, low, high, x, offset, settings)
    value, lift = _log_charge(row, position, x, offset, settings)
    _, flow_slope = _flow(row, position, x)
    command = 6.0 * speed * (_at(row, position, DURATION) - offset)
    if speed_rpm > speed:  # held in degrees: what the shorter time leaves of the lift
        highest = command / (6.0 * speed_rpm) - settings[SHORTEST_REST]
        lift = max(min(lift, highest / settings[SHORTEST_RATE]), settings[LOWEST_LIFT])
    _write(spline, place, position, SHARES, shares)
    slopes = np.empty_like(shares)
    _write(spline, place, position, SHARES + shares.size, slopes)
    shares += x * slopes  # a weak valve fills its cylinder in another rhythm
    return (
        lift,
        command,
        scale * math.exp(value),
        limited,
        flow_slope,
        _at(row, position, DURATION_SLOPE),
        position,
    )


@_jit
def look_up(
    spline: FloatArray,
    settings: FloatArray,
    speeds_rpm: FloatArray,
    positions: FloatArray,
    out: FloatArray,
) -> None:
    """Write all columns at points (p,) of speed and position in cells to (p, columns)."""
    for p in range(out.shape[0]):
        place, _, _ = _coordinate(speeds_rpm[p], spline.shape[0] - 2, settings)
        _write(spline, place, positions[p], 0, out[p])
        out[p, LIFT] = min(out[p, LIFT], settings[HIGHEST_LIFT])  # as in _log_charge
