"""Compiled filling of a manifold from which no cylinder breathes: exact, in one go."""

from __future__ import annotations

import math

import numpy as np

from ._compile import compiled
from ._implicit import fill_from_ambient
from ._layout import (
    INFLOW,
    MANIFOLD_MASS,
    SAME_TIME,
    THROTTLE_FLOW,
    TRACE_PRESSURE,
    TRACE_THROTTLE,
    KernelEngine,
    Window,
)


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
        trace[TRACE_THROTTLE, first + sample] = window.throttle_area * throttle_flow_at(y)
        sample += 1
    y = fill_from_ambient(x, rate * length)
    manifold[INFLOW] += full * (y - x)
    manifold[MANIFOLD_MASS] = full * y
    manifold[THROTTLE_FLOW] = window.throttle_area * throttle_flow_at(y)
    return sample


@compiled
def throttle_flow_at(x: float) -> float:
    """Eq. 13-14 for the pressure ratio `x` of a volume behind the throttle."""
    if x <= 1.0:
        return 1.0 if x <= 0.5 else 2.0 * math.sqrt(x - x * x)
    return -1.0 if x >= 2.0 else -2.0 * math.sqrt(x - 1.0) / x
