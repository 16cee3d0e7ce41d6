"""Compiled writing of trace samples inside a step."""

from __future__ import annotations

import math

import numpy as np

from ._compile import compiled
from ._forcing import lift_at, runner_at, turn_forcing, turn_over
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
from ._workspace import FLOW_0, FLOW_3, OLD, RATE, STAGE, START, TURNING, WORKSPACE_COLUMNS


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
    throttle_0: float,
    throttle_mean: float,
    throttle_2: float,
    pressure: float,
    trace: np.ndarray,
    first: int,
    sample: int,
) -> int:
    """Write the trace samples inside one step.

    Masses by the cubic through the ends of the step, flows by its slope; lift and runner
    by turning the forcing from the start of the step. `manifold` still holds the start
    of the step.
    """
    start = now + begin
    here = np.empty((1, WORKSPACE_COLUMNS))
    while sample < window.samples and sample * window.spacing < start + h - SAME_TIME:
        u = max((sample * window.spacing - start) / h, 0.0)
        turn = turn_over(window, swing_rate, swing_decay, u * h)
        net_0, net_2 = throttle_0, throttle_2
        for i in range(n_breathing):
            j = breathing[i]
            flow_0, flow_2 = work[j, FLOW_0], work[j, FLOW_3]
            mean = (work[j, STAGE] - work[j, START]) / h
            net_0, net_2 = net_0 - flow_0, net_2 - flow_2
            here[0] = work[j]
            for c in range(TURNING):
                here[0, c] = work[j, OLD + c]
            turn_forcing(here, 0, turn, math.exp(work[j, RATE] * u * h))
            r = TRACE_FIRST + TRACE_STRIDE * j
            trace[r + TRACE_MASS, first + sample] = _cubic(
                u, h, work[j, START], work[j, STAGE], flow_0, flow_2
            )
            trace[r + TRACE_FLOW, first + sample] = _cubic_slope(u, mean, flow_0, flow_2)
            trace[r + TRACE_RUNNER, first + sample] = runner_at(engine, window, here, 0)
            trace[r + TRACE_LIFT, first + sample] = max(
                lift_at(engine, here, 0, begin + u * h), 0.0
            )
        old_mass, new_mass = manifold[MANIFOLD_MASS], engine.capacity * pressure
        trace[TRACE_PRESSURE, first + sample] = (
            _cubic(u, h, old_mass, new_mass, net_0, net_2) / engine.capacity
        )
        trace[TRACE_THROTTLE, first + sample] = _cubic_slope(
            u, throttle_mean, throttle_0, throttle_2
        )
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
def _cubic_slope(u: float, mean: float, slope_0: float, slope_2: float) -> float:
    """Slope of that cubic, whose mean over the step is `mean`: what flows is what is stored."""
    v = 1.0 - u
    return 6.0 * u * v * mean + v * (1.0 - 3.0 * u) * slope_0 + u * (3.0 * u - 2.0) * slope_2
