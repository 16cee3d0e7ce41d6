"""Compiled solution of one implicit stage: every orifice in closed form.

The cylinders are coupled through the manifold pressure by a Newton sweep. The cylinders' response
to that pressure is the one of the stage before, so that the manifold need not wait for it.
"""

from __future__ import annotations

import numpy as np

from ._compile import compiled
from ._implicit import exact_step, simplified_step
from ._layout import NO_STAGE_SOLUTION, OK, RUNNER_COLLAPSED, KernelEngine
from ._workspace import (
    AREA,
    BASE,
    CAPACITY,
    FLOW,
    FRESH_SENSITIVITY,
    LANES,
    POWER,
    PRESSURE_PER_MASS,
    SENSITIVITY,
    STAGE,
    VOLUME_RATE,
)

# The sweep is repeated where the manifold pressure changes by more than this, relative to the
# ambient one, or a stale response makes it wrong by more than that, at resolution 1. The error
# of a linear response is as the square of the change.
FARTHEST = 3e-3
STALE = 2e-6
MOST_SWEEPS = 60


@compiled
def solve_stage(
    engine: KernelEngine,
    work: np.ndarray,
    forcing: np.ndarray,
    k: int,  # number of the stage, from 0
    n_breathing: int,
    implicit: float,  # gamma h, s
    throttle_area: float,  # kg/s
    manifold_base: float,  # known mass of the manifold, kg
    guess: float,  # of the manifold pressure, Pa
    coupling: float,  # response of all cylinders to the manifold pressure, kg/Pa
    tighter: float,  # factor by which all tolerances are divided
) -> tuple[int, float, float, float]:
    """Solve the implicit stage and write its flows.

    Returns status, manifold pressure in Pa, response of the cylinders in kg/Pa and damping of
    the manifold's error. Each sweep solves the cylinders at a guessed manifold pressure, then
    the manifold with the cylinders' linear response to it and the throttle in full. The last
    correction is passed on to the cylinders, so that mass is conserved to rounding.
    """
    p_amb = engine.ambient_pressure
    exact = engine.exact_orifice
    throttle_step = implicit * throttle_area
    if exact:
        throttle_step *= p_amb * engine.exact_scale
    sweeps = 0
    while True:
        capacity = engine.capacity + coupling
        full = capacity * p_amb
        per_capacity = 1.0 / capacity
        taken, fresh = 0.0, 0.0
        for i in range(n_breathing):
            base, area = work[i, BASE], forcing[i, LANES * AREA + k]
            cylinder_full = guess * forcing[i, LANES * CAPACITY + k]
            if cylinder_full <= 0.0:
                return RUNNER_COLLAPSED, guess, fresh, 1.0
            if exact:
                area *= (
                    engine.exact_scale * forcing[i, LANES * PRESSURE_PER_MASS + k] * cylinder_full
                )
                flow, sensitivity = exact_step(base, area, cylinder_full)
            else:
                flow, sensitivity = simplified_step(base, area, cylinder_full)
            flow *= area
            sensitivity *= forcing[i, LANES * CAPACITY + k]
            work[i, STAGE] = base + flow
            work[i, FRESH_SENSITIVITY] = sensitivity
            taken += flow
            fresh += sensitivity
        base = manifold_base - taken + coupling * guess
        if exact:
            flow, sensitivity = exact_step(base, throttle_step, full)
        else:
            flow, sensitivity = simplified_step(base, throttle_step, full)
        inflow = throttle_step * flow
        pressure = (base + inflow) * per_capacity
        change = pressure - guess
        stale = tighter * abs(change * (fresh - coupling))
        far = tighter * change * change > (FARTHEST * p_amb) ** 2
        if not far and stale <= STALE * full:
            break
        sweeps += 1
        if sweeps == MOST_SWEEPS:
            return NO_STAGE_SOLUTION, pressure, fresh, 1.0
        guess, coupling = pressure, fresh
        for i in range(n_breathing):
            work[i, SENSITIVITY] = work[i, FRESH_SENSITIVITY]
    manifold = work.shape[0] - 1
    per_implicit = 1.0 / implicit
    net = inflow * per_implicit
    work[manifold, POWER + 1 + k] = net
    for i in range(n_breathing):
        mass = work[i, STAGE] + work[i, SENSITIVITY] * change
        flow = (mass - work[i, BASE]) * per_implicit
        net -= flow
        work[i, STAGE] = mass
        work[i, FLOW + 1 + k] = flow
        work[i, SENSITIVITY] = work[i, FRESH_SENSITIVITY]
        excess = engine.exhaust_pressure - mass * forcing[i, LANES * PRESSURE_PER_MASS + k]
        work[i, POWER + 1 + k] = excess * forcing[i, LANES * VOLUME_RATE + k]
    work[manifold, FLOW + 1 + k] = net
    return OK, pressure, fresh, 1.0 - sensitivity * p_amb / pressure
