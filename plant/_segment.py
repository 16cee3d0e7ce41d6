"""Compiled integration of one segment, between two cuts of the valve motions.

A step is ESDIRK3(2)4L[2]SA. Its forcing is evaluated at all nodes at once; each of its three
implicit stages then solves every orifice in closed form. Steps are chosen by an estimate of the
local error in mass and work.
"""

from __future__ import annotations

import math

import numpy as np

from ._compile import compiled
from ._error import local_error
from ._forcing import (
    LARGEST_EXPONENT,
    LONGEST_RING,
    LONGEST_SWING,
    force,
    longest_step,
    start_lift,
    turn_over,
)
from ._layout import (
    DURATION,
    INFLOW,
    MANIFOLD_MASS,
    MASS,
    OK,
    STEPS,
    THROTTLE_FLOW,
    TOO_MANY_STEPS,
    WORK,
    KernelEngine,
    Window,
)
from ._layout import FLOW as PORT_FLOW
from ._method import B_0, B_1, B_2, C_1, C_2, EXPLICIT, GAMMA
from ._record import record_step
from ._stage import solve_stage
from ._workspace import BASE, FLOW, LANES, PHASORS, POWER, SENSITIVITY, STAGE, START

LONGEST_STEP_DEG = 10.0
SHORTEST_STEP_DEG = 1e-6
MOST_STEPS = 1e6  # of a segment: one takes about ten
SAFETY = 0.8  # share of the step that is expected to have just the error allowed
LARGEST_GROWTH = 2.5
LEAST_REDUCTION, LARGEST_REDUCTION = 0.7, 0.1


@compiled
def integrate_segment(
    engine: KernelEngine,
    window: Window,
    cylinders: np.ndarray,
    manifold: np.ndarray,
    work: np.ndarray,
    forcing: np.ndarray,
    breathing: np.ndarray,
    n_breathing: int,
    now: float,
    length: float,
    first_step: float,
    trace: np.ndarray,
    first: int,
    sample: int,
) -> tuple[int, int, float]:
    """Integrate one segment; returns (status, next trace sample, step for the next segment)."""
    swing_rate, swing_decay = 0.0, 0.0
    if engine.oscillation_amplitude > 0.0:
        swing_rate, swing_decay = engine.oscillation_frequency, engine.oscillation_decay
    if engine.cam and n_breathing > 0:
        swing_rate = 2.0 * math.pi / cylinders[breathing[0], DURATION] * window.degree_rate
    swing_step = LONGEST_SWING / swing_rate if swing_rate > 0.0 else math.inf
    coupling = 0.0
    for i in range(n_breathing):
        j = breathing[i]
        start_lift(engine, work, i, cylinders, j)
        work[i, START] = cylinders[j, MASS]
        work[i, FLOW] = cylinders[j, PORT_FLOW]
        coupling += work[i, SENSITIVITY]
    m = work.shape[0] - 1  # row of the manifold
    turns = forcing[m]
    work[m, POWER] = manifold[THROTTLE_FLOW]
    mass = manifold[MANIFOLD_MASS]
    pressure = mass / engine.capacity
    pressure_rate = 0.0
    tighter = window.resolution**3
    longest = LONGEST_STEP_DEG / window.degree_rate / window.resolution
    shortest = SHORTEST_STEP_DEG / window.degree_rate / window.resolution
    if engine.runner_gain > 0.0:
        longest = min(longest, LONGEST_RING / window.pole_im)
        longest = min(longest, -LARGEST_EXPONENT / window.pole_re)
    tau, step, tried = 0.0, first_step, 0.0
    while True:
        step = min(step, longest, longest_step(work, n_breathing, tau, swing_step))
        h = _divided(step, length - tau)
        tried += 1.0
        if tried > MOST_STEPS:
            return TOO_MANY_STEPS, sample, h
        implicit = GAMMA * h
        turn_over(engine, window, swing_rate, swing_decay, h, turns)
        net = work[m, POWER]
        for i in range(n_breathing):
            net -= work[i, FLOW]
            force(engine, window, work, i, tau, h, swing_rate > 0.0, turns, forcing[i])
        work[m, FLOW] = net
        pressure_1, pressure_2, pressure_3, damping = pressure, pressure, pressure, 1.0
        for k in range(3):
            e_0, e_1, e_2 = h * EXPLICIT[k, 0], h * EXPLICIT[k, 1], h * EXPLICIT[k, 2]
            for i in range(n_breathing):
                known = e_0 * work[i, FLOW] + e_1 * work[i, FLOW + 1] + e_2 * work[i, FLOW + 2]
                work[i, BASE] = work[i, START] + known
            known = e_0 * work[m, FLOW] + e_1 * work[m, FLOW + 1] + e_2 * work[m, FLOW + 2]
            if k == 0:
                guess = pressure + pressure_rate * (C_1 * h)
            elif k == 1:
                guess = pressure + (pressure_1 - pressure) * (C_2 / C_1)
            else:
                guess = pressure_1 + (pressure_2 - pressure_1) * ((1.0 - C_1) / (C_2 - C_1))
            status, found, coupling, damping = solve_stage(
                engine, work, forcing, k, n_breathing, implicit, window.throttle_area,
                mass + known, guess, coupling, tighter,
            )  # fmt: skip
            if status != OK:
                return status, sample, h
            if k == 0:
                pressure_1 = found
            elif k == 1:
                pressure_2 = found
            else:
                pressure_3 = found

        error, reverses = local_error(
            engine, cylinders, work, forcing, breathing, n_breathing, h, pressure_3, damping
        )
        error *= tighter
        if not error <= 1.0 and h > shortest:  # NaN too
            # Over a reversal the error falls as the square of the step, else as its cube.
            factor = SAFETY * error ** (-0.5 if reverses else -1.0 / 3.0)
            step = max(min(factor, LEAST_REDUCTION), LARGEST_REDUCTION) * h
            continue

        inlet_0, inlet_3 = work[m, POWER], work[m, POWER + 3]
        inlet = B_0 * inlet_0 + B_1 * work[m, POWER + 1] + B_2 * work[m, POWER + 2]
        inlet += GAMMA * inlet_3
        if window.samples > 0:
            sample = record_step(
                engine, window, manifold, work, breathing, n_breathing, now, tau, h, swing_rate,
                swing_decay, inlet, pressure_3, trace, first, sample,
            )  # fmt: skip
        for i in range(n_breathing):
            power = B_0 * work[i, POWER] + B_1 * work[i, POWER + 1] + B_2 * work[i, POWER + 2]
            cylinders[breathing[i], WORK] += h * (power + GAMMA * work[i, POWER + 3])
            work[i, POWER] = work[i, POWER + 3]
            work[i, FLOW] = work[i, FLOW + 3]
            work[i, START] = work[i, STAGE]
            for c in range(PHASORS):
                work[i, c] = forcing[i, LANES * c + 2]
        pressure_rate = (pressure_3 - pressure_2) / ((1.0 - C_2) * h)
        pressure = pressure_3
        mass = engine.capacity * pressure
        manifold[INFLOW] += h * inlet
        work[m, POWER] = inlet_3
        tau += h
        following = h * min(_growth(error), LARGEST_GROWTH)
        if tau >= length * (1.0 - 1e-12):
            step = min(step, following)  # what was wanted, not what was left
            break
        step = following
    for i in range(n_breathing):
        j = breathing[i]
        cylinders[j, MASS] = work[i, START]
        cylinders[j, PORT_FLOW] = work[i, FLOW]
    manifold[MANIFOLD_MASS] = mass
    manifold[THROTTLE_FLOW] = work[m, POWER]
    manifold[STEPS] += tried
    return OK, sample, step


@compiled
def _divided(step: float, remaining: float) -> float:
    """Take the step, but all that remains or half of it where that is near."""
    if step >= remaining:
        return remaining
    return 0.5 * remaining if 2.0 * step > remaining else step


@compiled
def _growth(error: float) -> float:
    """Factor of the next step, ``SAFETY * error**(-1/3)``, to 3 % for errors from 0.04 to 1."""
    return SAFETY * (0.342 + 0.745 * error) / (0.0871 + error)
