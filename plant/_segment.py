"""Compiled integration of one segment, between two cuts of the valve motions.

All forcing (volume, runner, lift) is a sum of exponentials in time, which turn from stage to
stage by a multiplication. A step is ESDIRK3(2)4L[2]SA, a third-order, L-stable, stiffly
accurate Runge-Kutta method of stage order 2; each of its three implicit stages solves every
orifice in closed form, coupled through the manifold pressure by a Newton sweep. Steps are the
segment's length over a power of two, chosen by an estimate of the local error in mass and work.
"""

from __future__ import annotations

import math

import numpy as np

from ._compile import compiled
from ._forcing import LONGEST_RING, forcing_is_seen, start_lift, turn_forcing, turn_over
from ._layout import (
    DURATION,
    FLOW,
    INFLOW,
    MANIFOLD_MASS,
    MASS,
    NO_STAGE_SOLUTION,
    OK,
    PHASE,
    RETREAT,
    RUNNER_COLLAPSED,
    THROTTLE_FLOW,
    WORK,
    KernelEngine,
    Window,
)
from ._method import A_20, A_21, B_0, B_1, B_2, C_1, C_2, E_0, E_1, E_2, E_3, GAMMA
from ._record import record_step
from ._stage import power_at, set_stage, solve_stage
from ._workspace import (
    BASE,
    FLOW_0,
    FLOW_1,
    FLOW_2,
    FLOW_3,
    GROWTH_1,
    GROWTH_2,
    GROWTH_3,
    OLD,
    POWER_0,
    POWER_1,
    POWER_2,
    POWER_3,
    RATE,
    RESTED,
    SENSITIVITY,
    STAGE,
    START,
    TURNING,
)

TOLERANCE = 4e-6  # local error of a mass over that mass, at resolution 1
WORK_TOLERANCE = 5e-5  # local error of the work over itself or 0.5 J, at resolution 1
LEAST_WORK = 0.5  # J
KINK = 20.0  # weight of an error where the flow turns round or the valve rests: no smooth slope
REVERSAL = 1e-3  # error of a step over a reversal, of the air that its first flow would move
NEAR_REVERSAL = 0.25  # share of the flow at the start of a step below which it is about to turn
GROW_BELOW = 0.1  # local error over the tolerance at which the step may double
LONGEST_STEP_DEG = 10.0
LEVELS = 14  # the shortest step is a segment over 2 to this power


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
        start_lift(engine, work, j, cylinders, corners)
        work[j, START] = cylinders[j, MASS]
    tracing = window.samples > 0
    tighter = window.resolution**3
    longest = LONGEST_STEP_DEG / window.degree_rate / window.resolution
    if engine.runner_gain > 0.0:
        longest = min(longest, LONGEST_RING / window.pole_im)
    span = 1 << LEVELS
    stride = span
    h = length
    while stride > 1 and (h > longest or h > 1.5 * hint):
        stride >>= 1
        h *= 0.5
    position = 0
    fresh = True  # the turning factors belong to another step
    turn_1 = turn_over(window, swing_rate, swing_decay, 0.0)
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
            turn_1 = turn_over(window, swing_rate, swing_decay, C_1 * h)
            turn_2 = turn_over(window, swing_rate, swing_decay, (C_2 - C_1) * h)
            turn_3 = turn_over(window, swing_rate, swing_decay, (1.0 - C_2) * h)
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
        if stride > 1 and not forcing_is_seen(work, breathing, n_breathing, h, swing_rate):
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
            work[j, RESTED] = 0.0
            work[j, BASE] = work[j, START] + step * work[j, FLOW_0]
            turn_forcing(work, j, turn_1, work[j, GROWTH_1])
            area = step * flow_coefficients[j]
            if not set_stage(engine, window, work, j, begin + C_1 * h, area):
                return RUNNER_COLLAPSED, sample, h
        base = mass + step * net_0
        guess = pressure + pressure_rate * (C_1 * h)
        solved, pressure_1, inlet_1, _ = solve_stage(
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
            work[j, POWER_1] = power_at(engine, window, work, j)
            work[j, BASE] = work[j, START] + h * (A_20 * work[j, FLOW_0] + A_21 * flow)
            turn_forcing(work, j, turn_2, work[j, GROWTH_2])
            area = step * flow_coefficients[j]
            if not set_stage(engine, window, work, j, begin + C_2 * h, area):
                return RUNNER_COLLAPSED, sample, h
        base = mass + h * (A_20 * net_0 + A_21 * net_1)
        guess = pressure + (pressure_1 - pressure) * (C_2 / C_1)
        solved, pressure_2, inlet_2, _ = solve_stage(
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
            work[j, POWER_2] = power_at(engine, window, work, j)
            work[j, BASE] = work[j, START] + h * (
                B_0 * work[j, FLOW_0] + B_1 * work[j, FLOW_1] + B_2 * flow
            )
            turn_forcing(work, j, turn_3, work[j, GROWTH_3])
            area = step * flow_coefficients[j]
            if not set_stage(engine, window, work, j, begin + h, area):
                return RUNNER_COLLAPSED, sample, h
        base = mass + h * (B_0 * net_0 + B_1 * net_1 + B_2 * net_2)
        guess = pressure_1 + (pressure_2 - pressure_1) * ((1.0 - C_1) / (C_2 - C_1))
        solved, pressure_3, inlet_3, damping = solve_stage(
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
            least = NEAR_REVERSAL * abs(work[j, FLOW_0])
            turned = work[j, FLOW_0] * work[j, FLOW_2] < 0.0 or work[j, FLOW_0] * flow < 0.0
            turned = turned or abs(flow) < least
            if turned and cylinders[j, PHASE] <= RETREAT:  # the area does not vanish
                defect = max(defect, REVERSAL * abs(work[j, FLOW_0]) * h * per_mass)
            if turned or work[j, RESTED] > 0.0:
                defect *= KINK
            error = max(error, defect * damped * (1.0 / TOLERANCE))
            work[j, POWER_3] = power_at(engine, window, work, j)
            defect = E_0 * work[j, POWER_0] + E_1 * work[j, POWER_1] + E_2 * work[j, POWER_2]
            defect = abs(defect + E_3 * work[j, POWER_3]) * h
            allowed = WORK_TOLERANCE * max(abs(cylinders[j, WORK]), LEAST_WORK)
            error = max(error, defect / allowed)
        defect = abs(E_0 * net_0 + E_1 * net_1 + E_2 * net_2 + E_3 * net_3) * h
        if inlet_0 * inlet_3 < 0.0 or inlet_0 * inlet_2 < 0.0:
            defect *= KINK
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

        inlet_mean = B_0 * inlet_0 + B_1 * inlet_1 + B_2 * inlet_2 + GAMMA * inlet_3
        if tracing:
            sample = record_step(
                engine, window, manifold, work, breathing, n_breathing, now, begin, h,
                swing_rate, swing_decay, inlet_0, inlet_mean, inlet_3, pressure_3, trace,
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
        manifold[INFLOW] += h * inlet_mean
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
