"""Compiled integration of one segment: equal steps between two cuts of the valve motions.

All forcing (volume, runner, lift) is a sum of exponentials in time, which turn from stage to
stage by a multiplication. A step is SDIRK2, the L-stable second-order diagonally implicit
Runge-Kutta method with ``gamma = 1 - 1/sqrt(2)``; a stage solves every orifice in closed
form, coupled through the manifold pressure by a Newton sweep.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

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

GAMMA = 1.0 - math.sqrt(0.5)
CARRY = (1.0 - GAMMA) / GAMMA  # weight of the first stage's increment in the second stage
SWEEP_TOLERANCE = 1e-4  # change of the manifold pressure, relative, that needs no more sweeps
MOST_SWEEPS = 60

# Columns of the workspace, one row a cylinder.
SIN, COS = 0, 1  # of the crank angle
FREE_RE, FREE_IM = 2, 3  # phasor of the free runner acceleration
CONSTANT, SLOPE = 4, 5  # lift = constant + slope t + exponential + SCALE x phasor
EXPONENTIAL, GROWTH_1, GROWTH_2 = 6, 7, 8  # with its factors over the two stages
SWING_RE, SWING_IM, SCALE = 9, 10, 11  # oscillation (Im) or cam (Re)
START, BASE, STAGE, STAGE_1 = 12, 13, 14, 15  # masses: at the start of the step, known, solved
AREA, CAPACITY, PRESSURE_PER_MASS = 16, 17, 18  # gamma h A_v; K/p_m; R T/V
SENSITIVITY = 19  # dM/dp_m
OLD_LIFT, OLD_RUNNER = 20, 21  # at the start of the step, for the trace
NEW_LIFT, NEW_RUNNER = 22, 23  # at the stage
WORKSPACE_COLUMNS = 24


class _Turn(NamedTuple):
    """Factors by which the phasors turn over one stage."""

    crank_sin: float
    crank_cos: float
    free_re: float
    free_im: float
    swing_re: float
    swing_im: float


@njit(cache=True, error_model="numpy", nogil=True)
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


@njit(cache=True, error_model="numpy", nogil=True)
def _start_lift(
    engine: KernelEngine, space: np.ndarray, row: np.ndarray, corners: np.ndarray, h: float
) -> None:
    """Write a cylinder's lift over the segment as constant + slope + exponential + phasor."""
    phase = int(row[PHASE])
    t = row[SINCE]
    lift = row[LIFT]
    constant, slope, exponential, rate = 0.0, 0.0, 0.0, 0.0
    swing_re, swing_im, scale = 0.0, 0.0, 0.0
    soft = engine.roundness * lift
    if phase == CAM:
        # u_l sin^2(a) = u_l/2 - u_l/2 cos(2 a)
        turned = 2.0 * math.pi / row[DURATION] * row[TURNED]
        swing_re, swing_im = math.cos(turned), math.sin(turned)
        constant, scale = 0.5 * lift, -0.5 * lift
    elif phase == RISE:
        constant, slope = engine.opening_slope * t, engine.opening_slope
    elif phase == APPROACH:
        constant, rate = lift, -engine.opening_slope / soft
        exponential = -soft * math.exp(rate * (t - corners[RISE - 1]))
    elif phase == RETREAT:
        constant, rate = lift, engine.closing_slope / soft
        exponential = -soft * math.exp(-rate * (corners[RETREAT - 1] - t))
    elif phase == FALL:
        ramp = (1.0 - engine.roundness) * lift
        slope = -engine.closing_slope
        constant = ramp + slope * (t - corners[RETREAT - 1])
    else:
        slope = -engine.seating_slope
        constant = slope * (t - row[DURATION])
    if APPROACH <= phase < CAM and engine.oscillation_amplitude > 0.0:
        since = t - corners[RISE - 1]
        size = math.exp(-engine.oscillation_decay * since)
        turned = engine.oscillation_frequency * since
        swing_re, swing_im = size * math.cos(turned), size * math.sin(turned)
        scale = engine.oscillation_amplitude * lift
    space[CONSTANT], space[SLOPE], space[EXPONENTIAL] = constant, slope, exponential
    space[GROWTH_1] = math.exp(rate * GAMMA * h)
    space[GROWTH_2] = math.exp(rate * (1.0 - GAMMA) * h)
    space[SWING_RE], space[SWING_IM], space[SCALE] = swing_re, swing_im, scale


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _lift_and_runner(
    engine: KernelEngine, window: Window, space: np.ndarray, tau: float
) -> tuple[float, float]:
    """Lift in mm and ``p_r/p_m`` where the phasors stand, `tau` after the segment's start."""
    swing = space[SWING_RE] if engine.cam else space[SWING_IM]
    lift = space[CONSTANT] + space[SLOPE] * tau + space[EXPONENTIAL] + space[SCALE] * swing
    acceleration = (
        window.acceleration_sin * space[SIN] + window.acceleration_cos * space[COS] + space[FREE_RE]
    )
    # The oscillation of Appendix B does not take the valve below its seat.
    return max(lift, 0.0), 1.0 - engine.runner_gain * acceleration


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _turn_forcing(space: np.ndarray, turn: _Turn, growth: float) -> None:
    s, c = space[SIN], space[COS]
    space[SIN] = s * turn.crank_cos + c * turn.crank_sin
    space[COS] = c * turn.crank_cos - s * turn.crank_sin
    re, im = space[FREE_RE], space[FREE_IM]
    space[FREE_RE] = re * turn.free_re - im * turn.free_im
    space[FREE_IM] = re * turn.free_im + im * turn.free_re
    re, im = space[SWING_RE], space[SWING_IM]
    space[SWING_RE] = re * turn.swing_re - im * turn.swing_im
    space[SWING_IM] = re * turn.swing_im + im * turn.swing_re
    space[EXPONENTIAL] *= growth


@njit(cache=True, error_model="numpy", nogil=True)
def _solve_stage(
    engine: KernelEngine,
    work: np.ndarray,
    breathing: np.ndarray,
    throttle_step: float,  # gamma h A_phi, kg
    manifold_base: float,  # kg
    guess: float,  # Pa
) -> tuple[bool, float, float]:
    """Solve the implicit stage; returns (solved, manifold pressure, throttle inflow in kg).

    Each sweep solves the cylinders at a guessed manifold pressure, then the manifold with
    the cylinders' linear response to it and the throttle in full. The last correction is
    passed on to the cylinders, so that mass is conserved to rounding.
    """
    p_amb = engine.ambient_pressure
    for _ in range(MOST_SWEEPS):
        taken, coupling = 0.0, 0.0
        for j in breathing:
            capacity = work[j, CAPACITY]
            full = guess * capacity
            m = work[j, BASE] / full
            if engine.exact_orifice:
                b = work[j, AREA] * engine.exact_scale * work[j, PRESSURE_PER_MASS]
                x, sensitivity = exact_step(m, b)
            else:
                x, sensitivity = simplified_step(m, work[j, AREA] / full)
            work[j, STAGE] = x * full
            work[j, SENSITIVITY] = sensitivity * capacity
            taken += x * full - work[j, BASE]
            coupling += sensitivity * capacity
        full = (engine.capacity + coupling) * p_amb
        m = (manifold_base - taken + coupling * guess) / full
        b = throttle_step / full
        if engine.exact_orifice:
            x, _ = exact_step(m, b * p_amb * engine.exact_scale)
        else:
            x, _ = simplified_step(m, b)
        change = x * p_amb - guess
        guess = x * p_amb
        if abs(change) <= SWEEP_TOLERANCE * p_amb:
            for j in breathing:
                work[j, STAGE] += work[j, SENSITIVITY] * change
            inflow = engine.capacity * guess - manifold_base + taken + coupling * change
            return True, guess, inflow
    return False, guess, 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def integrate_segment(
    engine: KernelEngine,
    window: Window,
    flow_coefficients: np.ndarray,
    cylinders: np.ndarray,
    corners: np.ndarray,
    manifold: np.ndarray,
    work: np.ndarray,
    breathing: np.ndarray,
    now: float,
    length: float,
    steps: int,
    trace: np.ndarray,
    sample: int,
) -> tuple[int, int]:
    """Integrate one segment of equal steps; returns (status, next trace sample)."""
    h = length / steps
    swing_rate, swing_decay = engine.oscillation_frequency, engine.oscillation_decay
    if engine.cam and breathing.size > 0:
        swing_rate = 2.0 * math.pi / cylinders[breathing[0], DURATION] * window.degree_rate
        swing_decay = 0.0
    turn_1 = _turn(window, swing_rate, swing_decay, GAMMA * h)
    turn_2 = _turn(window, swing_rate, swing_decay, (1.0 - GAMMA) * h)
    for j in breathing:
        _start_lift(engine, work[j], cylinders[j], corners[j], h)
        work[j, START] = cylinders[j, MASS]
    throttle_step = GAMMA * h * window.throttle_area
    mass = manifold[MANIFOLD_MASS]
    pressure = mass / engine.capacity
    guess = pressure
    for k in range(steps):
        if trace.shape[1] > 0:
            for j in breathing:
                work[j, OLD_LIFT], work[j, OLD_RUNNER] = _lift_and_runner(
                    engine, window, work[j], k * h
                )
        old_pressure = pressure
        base = mass
        inflow = 0.0
        for stage in range(2):
            tau = (k + GAMMA) * h if stage == 0 else (k + 1) * h
            for j in breathing:
                space = work[j]
                if stage == 0:
                    _turn_forcing(space, turn_1, space[GROWTH_1])
                    space[BASE] = space[START]
                else:
                    _turn_forcing(space, turn_2, space[GROWTH_2])
                    space[BASE] = space[START] + CARRY * (space[STAGE_1] - space[START])
                lift, runner = _lift_and_runner(engine, window, space, tau)
                if runner <= 0.0:
                    return RUNNER_COLLAPSED, sample
                volume = engine.clearance_volume + engine.half_stroke_volume * (1.0 - space[COS])
                space[AREA] = GAMMA * h * flow_coefficients[j] * lift
                space[CAPACITY] = runner * volume / engine.gas
                space[PRESSURE_PER_MASS] = engine.gas / volume
                space[NEW_LIFT], space[NEW_RUNNER] = lift, runner
            solved, pressure, gained = _solve_stage(
                engine, work, breathing, throttle_step, base, guess
            )
            if not solved:
                return NO_STAGE_SOLUTION, sample
            weight = (1.0 - GAMMA) * h if stage == 0 else GAMMA * h
            for j in breathing:
                rate = engine.half_stroke_volume * window.omega * work[j, SIN]
                p_c = work[j, STAGE] * work[j, PRESSURE_PER_MASS]
                cylinders[j, WORK] += weight * (engine.exhaust_pressure - p_c) * rate
            if stage == 0:
                for j in breathing:
                    work[j, STAGE_1] = work[j, STAGE]
                base = mass + CARRY * (engine.capacity * pressure - mass)
                inflow = CARRY * gained
                guess = old_pressure + (pressure - old_pressure) / GAMMA
        inflow += gained
        throttle_flow = gained / (GAMMA * h)
        guess = pressure + (pressure - old_pressure) * GAMMA
        if trace.shape[1] > 0:
            sample = _record(
                window, cylinders, manifold, work, breathing, now + k * h, h,
                engine.capacity, pressure, throttle_flow, trace, sample,
            )  # fmt: skip
        for j in breathing:
            cylinders[j, FLOW] = (work[j, STAGE] - work[j, BASE]) / (GAMMA * h)
            cylinders[j, MASS] = work[j, STAGE]
            work[j, START] = work[j, STAGE]
        mass = engine.capacity * pressure
        manifold[MANIFOLD_MASS] = mass
        manifold[INFLOW] += inflow
        manifold[THROTTLE_FLOW] = throttle_flow
    return OK, sample


@njit(cache=True, error_model="numpy", nogil=True)
def _record(
    window: Window,
    cylinders: np.ndarray,
    manifold: np.ndarray,
    work: np.ndarray,
    breathing: np.ndarray,
    start: float,
    h: float,
    capacity: float,
    pressure: float,
    throttle_flow: float,
    trace: np.ndarray,
    sample: int,
) -> int:
    """Write the trace samples inside one step: masses by cubic, the rest by linear interpolation.

    `cylinders` and `manifold` still hold the start of the step, `work` its end.
    """
    while sample < trace.shape[1] and sample * window.spacing < start + h - SAME_TIME:
        u = max((sample * window.spacing - start) / h, 0.0)
        v = 1.0 - u
        # Hermite weights of the end value and the two slopes; the start value has the rest.
        end, slope_0, slope_1 = u * u * (3.0 - 2.0 * u), u * v * v * h, -u * u * v * h
        old_net, new_net = manifold[THROTTLE_FLOW], throttle_flow
        for j in breathing:
            old, new = cylinders[j, FLOW], (work[j, STAGE] - work[j, BASE]) / (GAMMA * h)
            old_net -= old
            new_net -= new
            r = TRACE_FIRST + TRACE_STRIDE * j
            start_mass = work[j, START]
            trace[r + TRACE_MASS, sample] = (
                start_mass + end * (work[j, STAGE] - start_mass) + slope_0 * old + slope_1 * new
            )
            trace[r + TRACE_FLOW, sample] = v * old + u * new
            trace[r + TRACE_RUNNER, sample] = v * work[j, OLD_RUNNER] + u * work[j, NEW_RUNNER]
            trace[r + TRACE_LIFT, sample] = v * work[j, OLD_LIFT] + u * work[j, NEW_LIFT]
        old_mass = manifold[MANIFOLD_MASS]
        mass = old_mass + end * (capacity * pressure - old_mass)
        mass += slope_0 * old_net + slope_1 * new_net
        trace[TRACE_PRESSURE, sample] = mass / capacity
        trace[TRACE_THROTTLE, sample] = v * manifold[THROTTLE_FLOW] + u * throttle_flow
        sample += 1
    return sample


@njit(cache=True, error_model="numpy", nogil=True)
def fill_segment(
    engine: KernelEngine,
    window: Window,
    manifold: np.ndarray,
    now: float,
    length: float,
    trace: np.ndarray,
    sample: int,
) -> int:
    """Fill the manifold while no cylinder breathes, exactly; returns the next trace sample."""
    full = engine.capacity * engine.ambient_pressure
    rate = window.throttle_area / full
    x = manifold[MANIFOLD_MASS] / full
    while sample < trace.shape[1] and sample * window.spacing < now + length - SAME_TIME:
        y = fill_from_ambient(x, rate * max(sample * window.spacing - now, 0.0))
        trace[TRACE_PRESSURE, sample] = y * engine.ambient_pressure
        trace[TRACE_THROTTLE, sample] = window.throttle_area * _throttle_flow(y)
        sample += 1
    y = fill_from_ambient(x, rate * length)
    manifold[INFLOW] += full * (y - x)
    manifold[MANIFOLD_MASS] = full * y
    manifold[THROTTLE_FLOW] = window.throttle_area * _throttle_flow(y)
    return sample


@njit(cache=True, error_model="numpy", nogil=True)
def _throttle_flow(x: float) -> float:
    """Eq. 13-14 for the pressure ratio `x` of a volume behind the throttle."""
    if x <= 1.0:
        return 1.0 if x <= 0.5 else 2.0 * math.sqrt(x - x * x)
    return -1.0 if x >= 2.0 else -2.0 * math.sqrt(x - 1.0) / x
