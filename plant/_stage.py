"""Compiled solution of one implicit stage: every orifice in closed form.

The cylinders are coupled through the manifold pressure by a Newton sweep.
"""

from __future__ import annotations

import numpy as np

from ._compile import compiled
from ._forcing import lift_at, runner_at
from ._implicit import exact_step, simplified_step
from ._layout import KernelEngine, Window
from ._workspace import (
    AREA,
    BASE,
    CAPACITY,
    COS,
    PRESSURE_PER_MASS,
    RESTED,
    SENSITIVITY,
    SIN,
    STAGE,
)

SWEEP_TOLERANCE = 1e-4  # change of the manifold pressure, relative, that needs no more sweeps
MOST_SWEEPS = 60
RESTING = 1e-6  # mm, below zero: not rounding but the seat


@compiled
def set_stage(
    engine: KernelEngine, window: Window, work: np.ndarray, j: int, tau: float, area_step: float
) -> bool:
    """Write area and capacity of a cylinder at a stage; False if the runner has collapsed."""
    lift = lift_at(engine, work, j, tau)
    if lift < -RESTING:
        work[j, RESTED] = 1.0
    runner = runner_at(engine, window, work, j)
    volume = engine.clearance_volume + engine.half_stroke_volume * (1.0 - work[j, COS])
    work[j, AREA] = area_step * max(lift, 0.0)
    work[j, CAPACITY] = runner * volume / engine.gas
    work[j, PRESSURE_PER_MASS] = engine.gas / volume
    return runner > 0.0


@compiled
def power_at(engine: KernelEngine, window: Window, work: np.ndarray, j: int) -> float:
    """``(p_exh - p_c) dV/dt`` at the stage, W."""
    pressure = work[j, STAGE] * work[j, PRESSURE_PER_MASS]
    rate = engine.half_stroke_volume * window.omega * work[j, SIN]
    return (engine.exhaust_pressure - pressure) * rate


@compiled
def solve_stage(
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
