"""Compiled integration of one segment, between two cuts of the valve motions.

All forcing (volume, runner, lift) is a sum of exponentials in time, which turn from stage to
stage by a multiplication. A step is ESDIRK3(2)4L[2]SA, a third-order, L-stable, stiffly
accurate Runge-Kutta method of stage order 2; each of its three implicit stages solves every
orifice in closed form, coupled through the manifold pressure by a Newton sweep. Steps are the
segment's length over a power of two, chosen by an estimate of the local error in mass and work.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ._compile import compiled
from ._implicit import exact_step, fill_from_ambient, simplified_step
from ._layout import (
    APPROACH,
    CAM,
    DURATION,
    FALL,
    FLOW,
    INFLOW,
    LIFT,
    MANIFOLD_MASS,
    MASS,
    NO_STAGE_SOLUTION,
    OK,
    PHASE,
    RETREAT,
    RISE,
    RUNNER_COLLAPSED,
    SAME_TIME,
    SINCE,
    THROTTLE_FLOW,
    TRACE_FIRST,
    TRACE_FLOW,
    TRACE_LIFT,
    TRACE_MASS,
    TRACE_PRESSURE,
    TRACE_RUNNER,
    TRACE_STRIDE,
    TRACE_THROTTLE,
    TURNED,
    WORK,
    KernelEngine,
    Window,
)

# ESDIRK3(2)4L[2]SA of Kennedy and Carpenter (2003): nodes 0, C_1, C_2, 1; the last stage is
# the step's end.
GAMMA = 1767732205903 / 4055673282236
C_1, C_2 = 2.0 * GAMMA, 0.6
A_20, A_21 = 2746238789719 / 10658868560708, -640167445237 / 6845629431997
B_0, B_1 = 1471266399579 / 7840856788654, -4482444167858 / 7529755066697
B_2 = 11266239266428 / 11593286722821
# Weights of the error estimate: the step less the embedded second-order one.
E_0 = B_0 - 2756255671327 / 12835298489170
E_1 = B_1 + 10771552573575 / 22201958757719
E_2 = B_2 - 9247589265047 / 10645013368117
E_3 = GAMMA - 2193209047091 / 5459859503100
TOLERANCE = 5e-6  # local error of a mass over that mass, at resolution 1
WORK_TOLERANCE = 5e-5  # local error of the work over itself or 0.5 J, at resolution 1
LEAST_WORK = 0.5  # J
GROW_BELOW = 0.1  # local error over the tolerance at which the step may double
LONGEST_STEP_DEG = 10.0
# A step may not leap over forcing that its nodes do not see: e-folds of the lift's exponential
# and radians of its oscillation while they are a share of the lift, radians of the runner.
LONGEST_FOLD = 1.5
LONGEST_SWING = 1.0
SEEN_SHARE = 1e-3
SWEEP_TOLERANCE = 1e-4  # change of the manifold pressure, relative, that needs no more sweeps
MOST_SWEEPS = 60
LEVELS = 14  # the shortest step is a segment over 2 to this power

# Columns of the workspace, one row a cylinder. The first seven turn with time.
SIN, COS = 0, 1  # of the crank angle
FREE_RE, FREE_IM = 2, 3  # phasor of the free runner acceleration
SWING_RE, SWING_IM = 4, 5  # of the oscillation (Im) or the cam (Re)
EXPONENTIAL = 6  # part of the lift
TURNING = 7
OLD = 7  # the same seven at the start of the step: columns 7 to 13
GROWTH_1, GROWTH_2, GROWTH_3 = 14, 15, 16  # factors of the exponential from stage to stage
CONSTANT, SLOPE, SCALE, RATE = 17, 18, 19, 20  # lift = constant + slope t + exp. + scale swing
START, BASE, STAGE = 21, 22, 23  # masses: at the start of the step, known, solved
AREA, CAPACITY, SENSITIVITY = 24, 25, 26  # gamma h A_v; K/p_m; dM/dp_m
PRESSURE_PER_MASS = 27  # R T/V
FLOW_0, FLOW_1, FLOW_2, FLOW_3 = 28, 29, 30, 31  # port flow at the nodes
POWER_0, POWER_1, POWER_2, POWER_3 = 32, 33, 34, 35  # (p_exh - p_c) dV/dt at the nodes
WORKSPACE_COLUMNS = 36


class _Turn(NamedTuple):
    """Factors by which the phasors turn over one stage."""

    crank_sin: float
    crank_cos: float
    free_re: float
    free_im: float
    swing_re: float
    swing_im: float


@compiled
def _turn(window: Window, swing_rate: float, swing_decay: float, time: float) -> _Turn:
    free = math.exp(window.pole_re * time)
    swing = math.exp(-swing_decay * time)
    return _Turn(
        math.sin(window.omega * time),
        math.cos(window.omega * time),
        free * math.cos(window.pole_im * time),
        free * math.sin(window.pole_im * time),
        swing * math.cos(swing_rate * time),
        swing * math.sin(swing_rate * time),
    )


@compiled
def _start_lift(
    engine: KernelEngine,
    work: np.ndarray,
    j: int,
    cylinders: np.ndarray,
    corners: np.ndarray,
) -> None:
    """Write a cylinder's lift over the segment as constant + slope + exponential + phasor."""
    phase = int(cylinders[j, PHASE])
    t = cylinders[j, SINCE]
    lift = cylinders[j, LIFT]
    constant, slope, exponential, rate = 0.0, 0.0, 0.0, 0.0
    swing_re, swing_im, scale = 0.0, 0.0, 0.0
    soft = engine.roundness * lift
    if phase == CAM:
        # u_l sin^2(a) = u_l/2 - u_l/2 cos(2 a)
        turned = 2.0 * math.pi / cylinders[j, DURATION] * cylinders[j, TURNED]
        swing_re, swing_im = math.cos(turned), math.sin(turned)
        constant, scale = 0.5 * lift, -0.5 * lift
    elif phase == RISE:
        constant, slope = engine.opening_slope * t, engine.opening_slope
    elif phase == APPROACH:
        constant, rate = lift, -engine.opening_slope / soft
        exponential = -soft * math.exp(rate * (t - corners[j, RISE - 1]))
    elif phase == RETREAT:
        constant, rate = lift, engine.closing_slope / soft
        exponential = -soft * math.exp(-rate * (corners[j, RETREAT - 1] - t))
    elif phase == FALL:
        ramp = (1.0 - engine.roundness) * lift
        slope = -engine.closing_slope
        constant = ramp + slope * (t - corners[j, RETREAT - 1])
    else:
        slope = -engine.seating_slope
        constant = slope * (t - cylinders[j, DURATION])
    if APPROACH <= phase < CAM and engine.oscillation_amplitude > 0.0:
        since = t - corners[j, RISE - 1]
        size = math.exp(-engine.oscillation_decay * since)
        turned = engine.oscillation_frequency * since
        swing_re, swing_im = size * math.cos(turned), size * math.sin(turned)
        scale = engine.oscillation_amplitude * lift
    work[j, CONSTANT], work[j, SLOPE], work[j, EXPONENTIAL] = constant, slope, exponential
    work[j, RATE] = rate
    work[j, SWING_RE], work[j, SWING_IM], work[j, SCALE] = swing_re, swing_im, scale


@compiled
def _lift(engine: KernelEngine, work: np.ndarray, j: int, tau: float) -> float:
    """Lift in mm where the phasors stand, `tau` after the segment's start."""
    swing = work[j, SWING_RE] if engine.cam else work[j, SWING_IM]
    lift = work[j, CONSTANT] + work[j, SLOPE] * tau + work[j, EXPONENTIAL]
    # The oscillation of Appendix B does not take the valve below its seat.
    return max(lift + work[j, SCALE] * swing, 0.0)


@compiled
def _runner(engine: KernelEngine, window: Window, work: np.ndarray, j: int) -> float:
    """``p_r/p_m`` where the phasors stand (Eq. 5 and 6)."""
    return 1.0 - engine.runner_gain * (
        window.acceleration_sin * work[j, SIN]
        + window.acceleration_cos * work[j, COS]
        + work[j, FREE_RE]
    )


@compiled
def _turn_forcing(work: np.ndarray, j: int, turn: _Turn, growth: float) -> None:
    s, c = work[j, SIN], work[j, COS]
    work[j, SIN] = s * turn.crank_cos + c * turn.crank_sin
    work[j, COS] = c * turn.crank_cos - s * turn.crank_sin
    re, im = work[j, FREE_RE], work[j, FREE_IM]
    work[j, FREE_RE] = re * turn.free_re - im * turn.free_im
    work[j, FREE_IM] = re * turn.free_im + im * turn.free_re
    re, im = work[j, SWING_RE], work[j, SWING_IM]
    work[j, SWING_RE] = re * turn.swing_re - im * turn.swing_im
    work[j, SWING_IM] = re * turn.swing_im + im * turn.swing_re
    work[j, EXPONENTIAL] *= growth


@compiled
def _solve_stage(
    engine: KernelEngine,
    work: np.ndarray,
    breathing: np.ndarray,
    n_breathing: int,
    throttle_step: float,  # gamma h A_phi, kg
    manifold_base: float,  # kg
    guess: float,  # Pa
) -> tuple[bool, float, float, float]:
    """Solve the implicit stage.

    Returns (solved, manifold pressure, throttle inflow in kg, damping of the manifold's error).
    Each sweep solves the cylinders at a guessed manifold pressure, then the manifold with
    the cylinders' linear response to it and the throttle in full. The last correction is
    passed on to the cylinders, so that mass is conserved to rounding.
    """
    p_amb = engine.ambient_pressure
    for _ in range(MOST_SWEEPS):
        taken, coupling = 0.0, 0.0
        for i in range(n_breathing):
            j = breathing[i]
            capacity = work[j, CAPACITY]
            full = guess * capacity
            per_full = 1.0 / full
            base = work[j, BASE]
            if engine.exact_orifice:
                b = work[j, AREA] * engine.exact_scale * work[j, PRESSURE_PER_MASS]
                x, sensitivity = exact_step(base * per_full, b)
            else:
                x, sensitivity = simplified_step(base * per_full, work[j, AREA] * per_full)
            work[j, STAGE] = x * full
            work[j, SENSITIVITY] = sensitivity * capacity
            taken += x * full - base
            coupling += sensitivity * capacity
        full = (engine.capacity + coupling) * p_amb
        per_full = 1.0 / full
        m = (manifold_base - taken + coupling * guess) * per_full
        b = throttle_step * per_full
        if engine.exact_orifice:
            x, sensitivity = exact_step(m, b * p_amb * engine.exact_scale)
        else:
            x, sensitivity = simplified_step(m, b)
        change = x * p_amb - guess
        guess = x * p_amb
        if abs(change) <= SWEEP_TOLERANCE * p_amb:
            for i in range(n_breathing):
                j = breathing[i]
                work[j, STAGE] += work[j, SENSITIVITY] * change
            inflow = engine.capacity * guess - manifold_base + taken + coupling * change
            return True, guess, inflow, 1.0 - sensitivity / x
    return False, guess, 0.0, 1.0


@compiled
def integrate_segment(
    engine: KernelEngine,
    window: Window,
    flow_coefficients: np.ndarray,
    cylinders: np.ndarray,
    corners: np.ndarray,
    manifold: np.ndarray,
    work: np.ndarray,
    breathing: np.ndarray,
    n_breathing: int,
    now: float,
    length: float,
    hint: float,
    trace: np.ndarray,
    first: int,
    sample: int,
) -> tuple[int, int, float]:
    """Integrate one segment; returns (status, next trace sample, step for the next segment)."""
    swing_rate, swing_decay = engine.oscillation_frequency, engine.oscillation_decay
    if engine.cam and n_breathing > 0:
        swing_rate = 2.0 * math.pi / cylinders[breathing[0], DURATION] * window.degree_rate
        swing_decay = 0.0
    for i in range(n_breathing):
        j = breathing[i]
        _start_lift(engine, work, j, cylinders, corners)
        work[j, START] = cylinders[j, MASS]
    tracing = window.samples > 0
    tighter = window.resolution**3
    longest = LONGEST_STEP_DEG / window.degree_rate / window.resolution
    if engine.runner_gain > 0.0:
        longest = min(longest, LONGEST_SWING / window.pole_im)
    span = 1 << LEVELS
    stride = span
    h = length
    while stride > 1 and (h > longest or h > 1.5 * hint):
        stride >>= 1
        h *= 0.5
    position = 0
    fresh = True  # the turning factors belong to another step
    turn_1 = _turn(window, swing_rate, swing_decay, 0.0)
    turn_2, turn_3 = turn_1, turn_1
    mass = manifold[MANIFOLD_MASS]
    pressure = mass / engine.capacity
    pressure_rate = 0.0
    for i in range(n_breathing):
        work[breathing[i], FLOW_0] = cylinders[breathing[i], FLOW]
    inlet_0 = manifold[THROTTLE_FLOW]
    while position < span:
        if fresh:
            h = length * (stride / span)
            turn_1 = _turn(window, swing_rate, swing_decay, C_1 * h)
            turn_2 = _turn(window, swing_rate, swing_decay, (C_2 - C_1) * h)
            turn_3 = _turn(window, swing_rate, swing_decay, (1.0 - C_2) * h)
            for i in range(n_breathing):
                j = breathing[i]
                rate = work[j, RATE]
                if rate != 0.0:
                    work[j, GROWTH_1] = math.exp(rate * C_1 * h)
                    work[j, GROWTH_2] = math.exp(rate * (C_2 - C_1) * h)
                    work[j, GROWTH_3] = math.exp(rate * (1.0 - C_2) * h)
                else:
                    work[j, GROWTH_1], work[j, GROWTH_2], work[j, GROWTH_3] = 1.0, 1.0, 1.0
            fresh = False
        if stride > 1 and not _seen(work, breathing, n_breathing, h, swing_rate):
            stride >>= 1
            fresh = True
            continue
        step = GAMMA * h
        per_step = 1.0 / step
        begin = length * (position / span)
        throttle_step = step * window.throttle_area

        # Stage at C_1; the flows at node 0 are known.
        net_0 = inlet_0
        for i in range(n_breathing):
            j = breathing[i]
            for c in range(TURNING):
                work[j, OLD + c] = work[j, c]
            net_0 -= work[j, FLOW_0]
            work[j, BASE] = work[j, START] + step * work[j, FLOW_0]
            _turn_forcing(work, j, turn_1, work[j, GROWTH_1])
            area = step * flow_coefficients[j]
            if not _set_stage(engine, window, work, j, begin + C_1 * h, area):
                return RUNNER_COLLAPSED, sample, h
        base = mass + step * net_0
        guess = pressure + pressure_rate * (C_1 * h)
        solved, pressure_1, inlet_1, _ = _solve_stage(
            engine, work, breathing, n_breathing, throttle_step, base, guess
        )
        if not solved:
            return NO_STAGE_SOLUTION, sample, h
        # Stage at C_2.
        inlet_1 *= per_step
        net_1 = inlet_1
        for i in range(n_breathing):
            j = breathing[i]
            flow = (work[j, STAGE] - work[j, BASE]) * per_step
            net_1 -= flow
            work[j, FLOW_1] = flow
            work[j, POWER_1] = _power(engine, window, work, j)
            work[j, BASE] = work[j, START] + h * (A_20 * work[j, FLOW_0] + A_21 * flow)
            _turn_forcing(work, j, turn_2, work[j, GROWTH_2])
            area = step * flow_coefficients[j]
            if not _set_stage(engine, window, work, j, begin + C_2 * h, area):
                return RUNNER_COLLAPSED, sample, h
        base = mass + h * (A_20 * net_0 + A_21 * net_1)
        guess = pressure + (pressure_1 - pressure) * (C_2 / C_1)
        solved, pressure_2, inlet_2, _ = _solve_stage(
            engine, work, breathing, n_breathing, throttle_step, base, guess
        )
        if not solved:
            return NO_STAGE_SOLUTION, sample, h
        # Stage at the end of the step.
        inlet_2 *= per_step
        net_2 = inlet_2
        for i in range(n_breathing):
            j = breathing[i]
            flow = (work[j, STAGE] - work[j, BASE]) * per_step
            net_2 -= flow
            work[j, FLOW_2] = flow
            work[j, POWER_2] = _power(engine, window, work, j)
            work[j, BASE] = work[j, START] + h * (
                B_0 * work[j, FLOW_0] + B_1 * work[j, FLOW_1] + B_2 * flow
            )
            _turn_forcing(work, j, turn_3, work[j, GROWTH_3])
            area = step * flow_coefficients[j]
            if not _set_stage(engine, window, work, j, begin + h, area):
                return RUNNER_COLLAPSED, sample, h
        base = mass + h * (B_0 * net_0 + B_1 * net_1 + B_2 * net_2)
        guess = pressure_1 + (pressure_2 - pressure_1) * ((1.0 - C_1) / (C_2 - C_1))
        solved, pressure_3, inlet_3, damping = _solve_stage(
            engine, work, breathing, n_breathing, throttle_step, base, guess
        )
        if not solved:
            return NO_STAGE_SOLUTION, sample, h
        inlet_3 *= per_step
        net_3 = inlet_3

        # Local error, relative to the tolerance. The share of a stiff component is damped as
        # the implicit step damps it.
        error = 0.0
        for i in range(n_breathing):
            j = breathing[i]
            flow = (work[j, STAGE] - work[j, BASE]) * per_step
            net_3 -= flow
            work[j, FLOW_3] = flow
            per_mass = 1.0 / work[j, STAGE]
            damped = 1.0 - work[j, SENSITIVITY] * pressure_3 * per_mass
            defect = E_0 * work[j, FLOW_0] + E_1 * work[j, FLOW_1] + E_2 * work[j, FLOW_2]
            defect = abs(defect + E_3 * flow) * h * per_mass
            error = max(error, defect * damped * (1.0 / TOLERANCE))
            work[j, POWER_3] = _power(engine, window, work, j)
            defect = E_0 * work[j, POWER_0] + E_1 * work[j, POWER_1] + E_2 * work[j, POWER_2]
            defect = abs(defect + E_3 * work[j, POWER_3]) * h
            allowed = WORK_TOLERANCE * max(abs(cylinders[j, WORK]), LEAST_WORK)
            error = max(error, defect / allowed)
        defect = abs(E_0 * net_0 + E_1 * net_1 + E_2 * net_2 + E_3 * net_3) * h
        allowed = TOLERANCE * engine.capacity * pressure_3
        error = tighter * max(error, defect * damping / allowed)
        if error > 1.0 and stride > 1:
            for i in range(n_breathing):
                j = breathing[i]
                for c in range(TURNING):
                    work[j, c] = work[j, OLD + c]
            stride >>= 1
            fresh = True
            continue

        if tracing:
            sample = _record(
                engine, window, manifold, work, breathing, n_breathing, now, begin, h,
                swing_rate, swing_decay, inlet_0, inlet_2, inlet_3, pressure_3, trace,
                first, sample,
            )  # fmt: skip
        for i in range(n_breathing):
            j = breathing[i]
            power = B_0 * work[j, POWER_0] + B_1 * work[j, POWER_1] + B_2 * work[j, POWER_2]
            cylinders[j, WORK] += h * (power + GAMMA * work[j, POWER_3])
            work[j, POWER_0] = work[j, POWER_3]
            work[j, FLOW_0] = work[j, FLOW_3]
            work[j, START] = work[j, STAGE]
        pressure_rate = (pressure_3 - pressure_2) / ((1.0 - C_2) * h)
        pressure = pressure_3
        mass = engine.capacity * pressure
        manifold[INFLOW] += h * (B_0 * inlet_0 + B_1 * inlet_1 + B_2 * inlet_2 + GAMMA * inlet_3)
        inlet_0 = inlet_3
        position += stride
        doubled = 2 * stride
        if (
            error < GROW_BELOW
            and position < span
            and position % doubled == 0
            and position + doubled <= span
            and 2.0 * h <= longest
        ):
            stride = doubled
            fresh = True
    for i in range(n_breathing):
        j = breathing[i]
        cylinders[j, MASS] = work[j, START]
        cylinders[j, FLOW] = work[j, FLOW_0]
    manifold[MANIFOLD_MASS] = mass
    manifold[THROTTLE_FLOW] = inlet_0
    return OK, sample, h


@compiled
def _seen(
    work: np.ndarray, breathing: np.ndarray, n_breathing: int, h: float, swing_rate: float
) -> bool:
    """Whether a step is short enough for the lifts' exponentials and oscillations."""
    for i in range(n_breathing):
        j = breathing[i]
        share = SEEN_SHARE * work[j, CONSTANT]
        rate = work[j, RATE]
        if abs(rate) * h > LONGEST_FOLD:
            largest = -work[j, EXPONENTIAL]
            if rate > 0.0:
                largest *= work[j, GROWTH_1] * work[j, GROWTH_2] * work[j, GROWTH_3]
            if largest > share:
                return False
        if swing_rate * h > LONGEST_SWING and work[j, SCALE] != 0.0:
            size = abs(work[j, SWING_RE]) + abs(work[j, SWING_IM])
            if abs(work[j, SCALE]) * size > 10.0 * share:
                return False
    return True


@compiled
def _bend(value_0: float, value_1: float, value_2: float) -> float:
    """Second divided difference over the nodes 0, C_2 and 1."""
    return (value_2 - value_1) / (1.0 - C_2) - (value_1 - value_0) / C_2


@compiled
def _power(engine: KernelEngine, window: Window, work: np.ndarray, j: int) -> float:
    """``(p_exh - p_c) dV/dt`` at the stage, W."""
    pressure = work[j, STAGE] * work[j, PRESSURE_PER_MASS]
    rate = engine.half_stroke_volume * window.omega * work[j, SIN]
    return (engine.exhaust_pressure - pressure) * rate


@compiled
def _set_stage(
    engine: KernelEngine, window: Window, work: np.ndarray, j: int, tau: float, area_step: float
) -> bool:
    """Write area and capacity of a cylinder at a stage; False if the runner has collapsed."""
    runner = _runner(engine, window, work, j)
    volume = engine.clearance_volume + engine.half_stroke_volume * (1.0 - work[j, COS])
    work[j, AREA] = area_step * _lift(engine, work, j, tau)
    work[j, CAPACITY] = runner * volume / engine.gas
    work[j, PRESSURE_PER_MASS] = engine.gas / volume
    return runner > 0.0


@compiled
def _record(
    engine: KernelEngine,
    window: Window,
    manifold: np.ndarray,
    work: np.ndarray,
    breathing: np.ndarray,
    n_breathing: int,
    now: float,
    begin: float,
    h: float,
    swing_rate: float,
    swing_decay: float,
    throttle_0: float,
    throttle_1: float,
    throttle_2: float,
    pressure: float,
    trace: np.ndarray,
    first: int,
    sample: int,
) -> int:
    """Write the trace samples inside one step.

    Masses by the cubic, flows by the quadratic that the step's nodes define; lift and runner
    by turning the forcing from the start of the step. `manifold` still holds the start
    of the step.
    """
    start = now + begin
    here = np.empty((1, WORKSPACE_COLUMNS))
    while sample < window.samples and sample * window.spacing < start + h - SAME_TIME:
        u = max((sample * window.spacing - start) / h, 0.0)
        turn = _turn(window, swing_rate, swing_decay, u * h)
        net_0, net_2 = throttle_0, throttle_2
        for i in range(n_breathing):
            j = breathing[i]
            flow_0, flow_1, flow_2 = work[j, FLOW_0], work[j, FLOW_2], work[j, FLOW_3]
            net_0, net_2 = net_0 - flow_0, net_2 - flow_2
            here[0] = work[j]
            for c in range(TURNING):
                here[0, c] = work[j, OLD + c]
            _turn_forcing(here, 0, turn, math.exp(work[j, RATE] * u * h))
            r = TRACE_FIRST + TRACE_STRIDE * j
            trace[r + TRACE_MASS, first + sample] = _cubic(
                u, h, work[j, START], work[j, STAGE], flow_0, flow_2
            )
            trace[r + TRACE_FLOW, first + sample] = _quadratic(u, flow_0, flow_1, flow_2)
            trace[r + TRACE_RUNNER, first + sample] = _runner(engine, window, here, 0)
            trace[r + TRACE_LIFT, first + sample] = _lift(engine, here, 0, begin + u * h)
        old_mass, new_mass = manifold[MANIFOLD_MASS], engine.capacity * pressure
        trace[TRACE_PRESSURE, first + sample] = (
            _cubic(u, h, old_mass, new_mass, net_0, net_2) / engine.capacity
        )
        trace[TRACE_THROTTLE, first + sample] = _quadratic(u, throttle_0, throttle_1, throttle_2)
        sample += 1
    manifold[MANIFOLD_MASS] = engine.capacity * pressure
    return sample


@compiled
def _cubic(u: float, h: float, y_0: float, y_2: float, slope_0: float, slope_2: float) -> float:
    """Hermite cubic through the ends of a step."""
    v = 1.0 - u
    end = u * u * (3.0 - 2.0 * u)
    return y_0 + end * (y_2 - y_0) + u * v * h * (v * slope_0 - u * slope_2)


@compiled
def _quadratic(u: float, y_0: float, y_1: float, y_2: float) -> float:
    """Parabola through the nodes 0, C_2 and 1."""
    slope = (y_1 - y_0) / C_2
    return y_0 + u * (slope + (u - C_2) * _bend(y_0, y_1, y_2))


@compiled
def fill_segment(
    engine: KernelEngine,
    window: Window,
    manifold: np.ndarray,
    now: float,
    length: float,
    trace: np.ndarray,
    first: int,
    sample: int,
) -> int:
    """Fill the manifold while no cylinder breathes, exactly; returns the next trace sample."""
    full = engine.capacity * engine.ambient_pressure
    rate = window.throttle_area / full
    x = manifold[MANIFOLD_MASS] / full
    while sample < window.samples and sample * window.spacing < now + length - SAME_TIME:
        y = fill_from_ambient(x, rate * max(sample * window.spacing - now, 0.0))
        trace[TRACE_PRESSURE, first + sample] = y * engine.ambient_pressure
        trace[TRACE_THROTTLE, first + sample] = window.throttle_area * _throttle_flow(y)
        sample += 1
    y = fill_from_ambient(x, rate * length)
    manifold[INFLOW] += full * (y - x)
    manifold[MANIFOLD_MASS] = full * y
    manifold[THROTTLE_FLOW] = window.throttle_area * _throttle_flow(y)
    return sample


@compiled
def _throttle_flow(x: float) -> float:
    """Eq. 13-14 for the pressure ratio `x` of a volume behind the throttle."""
    if x <= 1.0:
        return 1.0 if x <= 0.5 else 2.0 * math.sqrt(x - x * x)
    return -1.0 if x >= 2.0 else -2.0 * math.sqrt(x - 1.0) / x
