"""The time below which the kernel's method cannot go on this machine.

A stage solves the cylinder's orifice, then the manifold's: two closed-form steps of which one
waits for the other, each a root and a handful of products. All else of a step could, in
principle, be done meanwhile. So steps times stages times the time of that chain is a floor.
"""

from __future__ import annotations

import time
from functools import cache
from typing import Any

import numba

from plant._implicit import simplified_step

STAGES = 3  # implicit stages of a step
_CHAIN = 100_000


@cache
def stage_time_ns() -> float:
    """Time of two closed-form steps that wait for one another, ns."""
    run = _chain()
    run(2)  # compiles
    times = []
    for _ in range(20):
        started = time.perf_counter()
        run(_CHAIN)
        times.append(time.perf_counter() - started)
    return 1e9 * min(times) / _CHAIN


def _chain() -> Any:
    step = simplified_step.dispatcher

    @numba.njit(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
    def chain(n: int) -> float:
        mass = 0.9
        for _ in range(n):
            flow, _ = step(mass, 0.05, 1.0)
            flow, _ = step(0.9 - 1e-3 * flow, 0.05, 1.0)
            mass = 0.9 + 1e-3 * flow
        return mass

    return chain
