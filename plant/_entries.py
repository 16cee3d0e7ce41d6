"""What Python calls of the compiled kernel: its functions with their scratch space."""

from __future__ import annotations

import numpy as np

from ._engine_numbers import Options
from ._layout import Event, KernelEngine, Window
from ._native import Library
from ._native_call import INDICES, MATRIX, VECTOR, Array
from ._workspace import FORCED, LANES, SCRATCH_COLUMNS
from .kinematics import FloatArray

_KERNEL, _LAG = Library("kernel"), Library("lag")
_SCRATCH = (MATRIX, MATRIX, INDICES)

make_window = _KERNEL.entry(
    "_kernel",
    "make_window",
    *(KernelEngine, float, float, float, float, float, float, int),
    returns=Window,
)
_advance_window = _KERNEL.entry(
    "_kernel",
    "advance_window",
    *(KernelEngine, Window, Event, VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, int, *_SCRATCH),
    returns=int,
)
_advance_cycles = _KERNEL.entry(
    "_kernel",
    "advance_cycles",
    *(KernelEngine, Window, MATRIX, VECTOR, float, MATRIX, VECTOR, MATRIX, int, *_SCRATCH, VECTOR),
    returns=int,
)
_solve_points = _KERNEL.entry(
    "_batch_kernel",
    "solve_points",
    *(Options, int, int, float, MATRIX, MATRIX, MATRIX, MATRIX, MATRIX, Array(3), MATRIX),
    *_SCRATCH,
    returns=int,
)
kernel_engine_of = _KERNEL.entry(
    "_engine_numbers", "kernel_engine_of", VECTOR, Options, returns=KernelEngine
)
fill_response = _LAG.entry("lag", "fill_response", VECTOR, VECTOR, float, VECTOR)


def advance_window(
    engine: KernelEngine,
    window: Window,
    event: Event,
    flow_coefficients: FloatArray,
    angles: FloatArray,
    cylinders: FloatArray,
    manifold: FloatArray,
    trace: FloatArray,
    first: int,
) -> int:
    """Advance the plant by one window, in which one cylinder opens. Returns a status."""
    status: int = _advance_window(
        engine,
        window,
        event,
        flow_coefficients,
        angles,
        cylinders,
        manifold,
        trace,
        first,
        *_scratch(engine.n_cylinders),
    )
    return status


def advance_cycles(
    engine: KernelEngine,
    windows: Window,
    commands: FloatArray,
    flow_coefficients: FloatArray,
    advance_deg: float,
    cylinders: FloatArray,
    manifold: FloatArray,
    trace: FloatArray,
    cycles: int = 1,
) -> int:
    """Advance the plant by cycles of equal windows. Returns a status."""
    n = engine.n_cylinders
    status: int = _advance_cycles(
        engine,
        windows,
        commands,
        flow_coefficients,
        advance_deg,
        cylinders,
        manifold,
        trace,
        cycles,
        *_scratch(n),
        np.empty(n),
    )
    return status


def _scratch(n: int) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Space for the kernel to work in, which allocates nothing itself."""
    work, forcing = np.empty((n + 1, SCRATCH_COLUMNS)), np.empty((n + 1, FORCED * LANES))
    return work, forcing, np.empty(n, np.int64)


def solve_points(
    options: Options,
    limit: int,
    most_cycles: int,
    tolerance: float,
    rows: FloatArray,
    points: FloatArray,
    commands: FloatArray,
    results: FloatArray,
    space: FloatArray,
    tables: FloatArray,
    manifolds: FloatArray,
) -> int:
    """Solve each point, and return how many have failed; see `_batch_kernel.solve_points`."""
    failed: int = _solve_points(
        options,
        limit,
        most_cycles,
        tolerance,
        rows,
        points,
        commands,
        results,
        space,
        tables,
        manifolds,
        *_scratch(options.n_cylinders),
    )
    return failed
