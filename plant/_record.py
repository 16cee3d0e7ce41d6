"""Compiled writing of trace samples inside a step."""

from __future__ import annotations

import numpy as np

from ._compile import compiled
from ._forcing import forcing_at
from ._layout import (
    MANIFOLD_MASS,
    SAME_TIME,
    TRACE_FIRST,
    TRACE_FLOW,
    TRACE_LIFT,
    TRACE_MASS,
    TRACE_PRESSURE,
    TRACE_RUNNER,
    TRACE_STRIDE,
    TRACE_THROTTLE,
    KernelEngine,
    Window,
)
from ._workspace import FLOW, POWER, STAGE, START


@compiled
def record_step(
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
    throttle_mean: float,
    pressure: float,
    trace: np.ndarray,
    first: int,
    sample: int,
) -> int:
    """Write the trace samples inside one step.

    Masses by a cubic through the ends of the step, flows by its slope; lift and runner
    from the phasors at the start of the step. `manifold` still holds the start of the step.
    """
    start = now + begin
    m = work.shape[0] - 1
    throttle_0, throttle_3 = work[m, POWER], work[m, POWER + 3]
    while sample < window.samples and sample * window.spacing < start + h - SAME_TIME:
        u = max((sample * window.spacing - start) / h, 0.0)
        net_0, net_3 = throttle_0, throttle_3
        for i in range(n_breathing):
            flow_0, flow_3 = work[i, FLOW], work[i, FLOW + 3]
            mean = (work[i, STAGE] - work[i, START]) / h
            net_0, net_3 = net_0 - flow_0, net_3 - flow_3
            lift, runner = forcing_at(
                engine, window, work, i, swing_rate, swing_decay, begin, u * h
            )
            r = TRACE_FIRST + TRACE_STRIDE * breathing[i]
            trace[r + TRACE_MASS, first + sample] = _cubic(
                u, h, work[i, START], work[i, STAGE], flow_0, flow_3
            )
            trace[r + TRACE_FLOW, first + sample] = _cubic_slope(u, mean, flow_0, flow_3)
            trace[r + TRACE_RUNNER, first + sample] = runner
            trace[r + TRACE_LIFT, first + sample] = lift
        old_mass, new_mass = manifold[MANIFOLD_MASS], engine.capacity * pressure
        trace[TRACE_PRESSURE, first + sample] = (
            _cubic(u, h, old_mass, new_mass, net_0, net_3) / engine.capacity
        )
        trace[TRACE_THROTTLE, first + sample] = _cubic_slope(
            u, throttle_mean, throttle_0, throttle_3
        )
        sample += 1
    manifold[MANIFOLD_MASS] = engine.capacity * pressure
    return sample


@compiled
def _cubic(u: float, h: float, y_0: float, y_3: float, slope_0: float, slope_3: float) -> float:
    """Hermite cubic through the ends of a step."""
    v = 1.0 - u
    end = u * u * (3.0 - 2.0 * u)
    return y_0 + end * (y_3 - y_0) + u * v * h * (v * slope_0 - u * slope_3)


@compiled
def _cubic_slope(u: float, mean: float, slope_0: float, slope_3: float) -> float:
    """Slope of that cubic, whose mean over the step is `mean`: what flows is what is stored."""
    v = 1.0 - u
    return 6.0 * u * v * mean + v * (1.0 - 3.0 * u) * slope_0 + u * (3.0 * u - 2.0) * slope_3
