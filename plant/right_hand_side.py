"""The full plant as ``dy/dt = f(t, y, p)``, compiled, for any solver of ordinary equations.

Eq. 1 and 2 in mass form (``M = p V/(R T)``), 3, 5 to 8, 13 to 16, 19 and 20, Appendix B and the
cam of section 4. Everything is a flat array of floats, so that solvers written in C can call it.

The state is that of what breathes: the manifold's mass in kg, then four numbers for each
cylinder whose valve is open: its mass in kg, the port velocity of its runner in m/s and its rate
in m/s2, and the work ``integral of (p_exh - p_c) dV`` since IVO in J. The charge needs no state
of its own: it is the mass less that at IVO.

The right-hand side has corners where a valve opens, closes or changes its form of motion, and
the state changes its length where one opens or closes. `plant.intake_problem.IntakeProblem`
cuts a cycle there and gives the parameters between two cuts.
"""

from __future__ import annotations

import math

import numpy as np

from ._compile import compiled
from ._layout import APPROACH, CAM, FALL, RETREAT, RISE

# The state.
MANIFOLD = 0
FIRST_CYLINDER = 1
MASS, VELOCITY, RATE, WORK = 0, 1, 2, 3
STATE_STRIDE = 4

# The parameters: of engine and operating point, then of each breathing cylinder.
COUNT = 0  # breathing cylinders
GAS = 1  # R T, J/kg
CAPACITY = 2  # V_m/(R T), kg/Pa
HALF_STROKE_VOLUME, CLEARANCE_VOLUME = 3, 4  # V_d/2 and V_cl, m3
AMBIENT_PRESSURE, EXHAUST_PRESSURE = 5, 6  # Pa
RUNNER_GAIN = 7  # c of p_r = p_m (1 - c dv/dt), s2/m; 0 without runner
RUNNER_FORCING = 8  # amplitude of the right side of Eq. 7 over A_r, m/s
NATURAL_FREQUENCY, DAMPING = 9, 10  # rad/s (0 without runner), 1
OMEGA = 11  # crank speed, rad/s
THROTTLE_AREA = 12  # kg/s
OPENING_SLOPE, CLOSING_SLOPE, SEATING_SLOPE, ROUNDNESS = 13, 14, 15, 16  # mm/s, mm/s, mm/s, 1
SWING, SWING_FREQUENCY, SWING_DECAY = 17, 18, 19  # 1 (0: no oscillation), rad/s, 1/s
FIRST_VALVE = 20
TOP_TIME, OPENING_TIME = 0, 1  # of intake TDC and IVO, s
FLOW_COEFFICIENT = 2  # kg/s/mm
LIFT = 3  # mm
DURATION = 4  # s
FORM = 5  # of the valve's motion
RISE_END, DWELL_END = 6, 7  # times since IVO, s
VALVE_STRIDE = 8

# The slope of Eq. 14 is infinite at equal pressures, where a general solver stands still: a
# manifold at ambient pressure would stop it. Within this share of equality the flow is led
# through zero with a finite slope; that moves a pressure by less than this share of itself.
LINEAR_ZONE = 1e-9
_SHARP = 1e-4  # above this x - x^2 the zone is below rounding of any tolerance in use


@compiled
def _psi(x: float) -> tuple[float, float]:
    """Eq. 14 and its derivative, for ``x <= 1``."""
    if x <= 0.5:
        return 1.0, 0.0
    s = x - x * x
    if s > _SHARP:
        root = math.sqrt(s)
        return 2.0 * root, (1.0 - 2.0 * x) / root
    square = s * s + LINEAR_ZONE * LINEAR_ZONE
    root = math.sqrt(math.sqrt(square))
    slope = (s * s + 2.0 * LINEAR_ZONE * LINEAR_ZONE) / (square * root)
    return 2.0 * s / root, slope * (1.0 - 2.0 * x)


@compiled
def orifice_flow(downstream: float, upstream: float) -> tuple[float, float, float]:
    """Eq. 13 and its derivatives to the pressures downstream and upstream, 1/Pa."""
    if downstream <= upstream:
        x = downstream / upstream
        value, slope = _psi(x)
        return value, slope / upstream, -slope * x / upstream
    x = upstream / downstream
    value, slope = _psi(x)
    return -value, slope * x / downstream, -slope / downstream


@compiled
def valve_lift(t: float, parameters: np.ndarray, valve: int) -> float:
    """Lift in mm at time `t` of the valve whose parameters start at `valve`.

    Eq. 20 in its continuous form with Appendix B, or the cam of section 4.
    """
    p = parameters
    since = t - p[valve + OPENING_TIME]
    top, form = p[valve + LIFT], p[valve + FORM]
    if form == CAM:
        return top * math.sin(math.pi * since / p[valve + DURATION]) ** 2
    if form == RISE:
        return p[OPENING_SLOPE] * since
    soft = p[ROUNDNESS] * top
    if form == APPROACH:
        lift = top - soft * math.exp(-p[OPENING_SLOPE] / soft * (since - p[valve + RISE_END]))
    elif form == RETREAT:
        lift = top - soft * math.exp(-p[CLOSING_SLOPE] / soft * (p[valve + DWELL_END] - since))
    elif form == FALL:
        lift = top - soft - p[CLOSING_SLOPE] * (since - p[valve + DWELL_END])
    else:
        lift = p[SEATING_SLOPE] * (p[valve + DURATION] - since)
    if p[SWING] > 0.0:
        swung = since - p[valve + RISE_END]
        lift += (
            p[SWING] * top * math.exp(-p[SWING_DECAY] * swung)
            * math.sin(p[SWING_FREQUENCY] * swung)
        )  # fmt: skip
    return max(lift, 0.0)


@compiled
def right_hand_side(t: float, y: np.ndarray, parameters: np.ndarray, rate: np.ndarray) -> None:
    """Write ``dy/dt`` into `rate`.

    Parameters
    ----------
    t : float
        Time in s, on the clock of the parameters' opening times.
    y, rate : ndarray (1 + 4 k,)
        State of the manifold and of `k` breathing cylinders, and its rate of change.
    parameters : ndarray (20 + 8 k,)
        Of one segment of an `IntakeProblem`.
    """
    p = parameters
    p_m = y[MANIFOLD] / p[CAPACITY]
    flow, _, _ = orifice_flow(p_m, p[AMBIENT_PRESSURE])
    total = p[THROTTLE_AREA] * flow
    for i in range(int(p[COUNT])):
        o, valve = FIRST_CYLINDER + STATE_STRIDE * i, FIRST_VALVE + VALVE_STRIDE * i
        angle = p[OMEGA] * (t - p[valve + TOP_TIME])
        s = math.sin(angle)
        volume = p[HALF_STROKE_VOLUME] * (1.0 - math.cos(angle)) + p[CLEARANCE_VOLUME]
        p_c = y[o + MASS] * p[GAS] / volume
        p_r = p_m * (1.0 - p[RUNNER_GAIN] * y[o + RATE])
        flow, _, _ = orifice_flow(p_c, p_r)
        flow *= p[valve + FLOW_COEFFICIENT] * valve_lift(t, p, valve)
        w = p[NATURAL_FREQUENCY]
        rate[o + MASS] = flow
        rate[o + VELOCITY] = y[o + RATE]
        rate[o + RATE] = (
            w * w * (p[RUNNER_FORCING] * s - y[o + VELOCITY])
            - 2.0 * p[DAMPING] * w * y[o + RATE]
        )  # fmt: skip
        rate[o + WORK] = (p[EXHAUST_PRESSURE] - p_c) * p[HALF_STROKE_VOLUME] * p[OMEGA] * s
        total -= flow
    rate[MANIFOLD] = total


@compiled
def jacobian(t: float, y: np.ndarray, parameters: np.ndarray, out: np.ndarray) -> None:
    """Write the derivative of the right-hand side to the state into `out`, square.

    ``out[i, j]`` is that of rate `i` to state `j`; the other arguments are those of
    `right_hand_side`.
    """
    p = parameters
    out[:, :] = 0.0
    p_m = y[MANIFOLD] / p[CAPACITY]
    _, slope, _ = orifice_flow(p_m, p[AMBIENT_PRESSURE])
    out[MANIFOLD, MANIFOLD] = p[THROTTLE_AREA] * slope / p[CAPACITY]
    for i in range(int(p[COUNT])):
        o, valve = FIRST_CYLINDER + STATE_STRIDE * i, FIRST_VALVE + VALVE_STRIDE * i
        angle = p[OMEGA] * (t - p[valve + TOP_TIME])
        volume = p[HALF_STROKE_VOLUME] * (1.0 - math.cos(angle)) + p[CLEARANCE_VOLUME]
        per_mass = p[GAS] / volume
        share = 1.0 - p[RUNNER_GAIN] * y[o + RATE]
        _, by_cylinder, by_port = orifice_flow(y[o + MASS] * per_mass, p_m * share)
        area = p[valve + FLOW_COEFFICIENT] * valve_lift(t, p, valve)
        by_mass = area * by_cylinder * per_mass
        by_manifold = area * by_port * share / p[CAPACITY]
        by_rate = -area * by_port * p[RUNNER_GAIN] * p_m
        out[o + MASS, o + MASS] = by_mass
        out[o + MASS, MANIFOLD] = by_manifold
        out[o + MASS, o + RATE] = by_rate
        out[MANIFOLD, o + MASS] = -by_mass
        out[MANIFOLD, MANIFOLD] -= by_manifold
        out[MANIFOLD, o + RATE] = -by_rate
        w = p[NATURAL_FREQUENCY]
        out[o + VELOCITY, o + RATE] = 1.0
        out[o + RATE, o + VELOCITY] = -w * w
        out[o + RATE, o + RATE] = -2.0 * p[DAMPING] * w
        growth = p[HALF_STROKE_VOLUME] * p[OMEGA] * math.sin(angle)
        out[o + WORK, o + MASS] = -per_mass * growth
