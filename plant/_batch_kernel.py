"""Compiled batch: checks and periodic solutions of many operating points in one call."""

from __future__ import annotations

import math

import numpy as np

from ._compile import compiled
from ._engine_numbers import (
    FACTORS,
    EngineNumbers,
    Options,
    ValvetrainNumbers,
    damping_ratio,
    engine_numbers,
    highest_lift_mm,
    kernel_engine,
    lowest_lift_mm,
    natural_frequency,
    throttle_area,
    throttle_closed_deg,
)
from ._kernel import make_window
from ._layout import CHARGE, LOSS, OK
from ._periodic import (
    BEFORE,
    COEFFICIENT,
    DURATION,
    LIFT,
    UNTIL_OPENING,
    solve_periodic,
)
from .valve import EARLIEST_OPENING_DEG, LATEST_CLOSING_DEG, LATEST_OPENING_DEG

REFUSED, INFEASIBLE = 5, 6  # status: what the operating point's checks refuse
HIGHEST_SPEED_RPM = 20000.0

# Columns of the operating points.
SPEED, THROTTLE, ADVANCE = 0, 1, 2  # ADVANCE: of the windows, deg; the least for NaN
POINT_COLUMNS = 3
# Columns of the results: these, then n each of delivered lift, charge and loss.
STATUS, WINDOWS, RESIDUAL, INFLOW_PER_CYCLE, DELIVERED = 0, 1, 2, 3, 4


@compiled
def solve_points(
    options: Options,
    limit: int,  # 1 to limit a lift that the duration does not allow, 0 to refuse it
    most_cycles: int,  # 0 to do the checks alone
    tolerance: float,
    rows: np.ndarray,  # (points or 1, numbers): an engine each
    points: np.ndarray,  # (points, POINT_COLUMNS)
    commands: np.ndarray,  # (points, 3 n or 3): lift, duration and opening, of a cylinder or all
    results: np.ndarray,  # (points, DELIVERED + 3 n)
    space: np.ndarray,  # (CYLINDER_ROWS, n), workspace
    tables: np.ndarray,  # see solve_periodic
    manifolds: np.ndarray,
    work: np.ndarray,  # scratch, see advance_window
    forcing: np.ndarray,
    breathing: np.ndarray,
) -> int:
    """Solve each point, and return how many have failed.

    The state at the start of the last point's cycle is left in `tables` and `manifolds`.
    """
    n = options.n_cylinders
    failed = 0
    for i in range(points.shape[0]):
        row = rows[i if rows.shape[0] > 1 else 0]
        engine = engine_numbers(row)
        speed, angle = points[i, SPEED], points[i, THROTTLE]
        status = _check_point(engine, speed, angle)
        least = 0.0
        for j in range(n):
            place = 3 * j if commands.shape[1] > 3 else 0
            least = max(least, -commands[i, place + 2])
        advance = least if math.isnan(points[i, ADVANCE]) else points[i, ADVANCE]
        for j in range(n):
            place = 3 * j if commands.shape[1] > 3 else 0
            lift, duration = commands[i, place], commands[i, place + 1]
            opening = commands[i, place + 2]
            if status == OK:
                status = _check_command(lift, duration, opening, 720.0 / n - advance)
            if status == OK and not options.cam and lift > 0.0:
                status, lift = _deliver(engine.valvetrain, lift, duration / (6.0 * speed), limit)
            results[i, DELIVERED + j] = lift
            space[LIFT, j], space[DURATION, j], space[UNTIL_OPENING, j] = (
                lift,
                duration,
                opening + advance,
            )
        results[i, STATUS] = status
        if status != OK:
            failed += 1
        if most_cycles == 0 or status != OK:
            continue
        kernel = kernel_engine(engine, options)
        window = make_window(
            kernel,
            720.0 / n,
            speed,
            throttle_area(engine.throttle, angle),
            natural_frequency(engine.helmholtz, speed),
            damping_ratio(engine.helmholtz, speed),
            options.resolution,
            0,
        )
        for j in range(n):
            space[COEFFICIENT, j] = engine.flow_coefficient * row[FACTORS + j]
        solution = solve_periodic(
            kernel,
            window,
            space,
            advance,
            tolerance,
            most_cycles,
            tables,
            manifolds,
            work,
            forcing,
            breathing,
        )
        results[i, STATUS] = solution.status
        results[i, WINDOWS] = solution.windows
        results[i, RESIDUAL] = solution.residual
        results[i, INFLOW_PER_CYCLE] = solution.inflow
        for j in range(n):
            results[i, DELIVERED + n + j] = tables[BEFORE, j, CHARGE]
            results[i, DELIVERED + 2 * n + j] = tables[BEFORE, j, LOSS]
        if solution.status != OK:
            failed += 1
    return failed


@compiled
def _check_point(engine: EngineNumbers, speed_rpm: float, throttle_deg: float) -> int:
    """Check what lies between several numbers of an engine, speed and throttle."""
    throttle, helmholtz = engine.throttle, engine.helmholtz
    allowed = helmholtz.low_speed_rpm < helmholtz.high_speed_rpm
    allowed = allowed and throttle_area(throttle, throttle.wide_open_deg) > 0.0
    allowed = allowed and 0.0 < speed_rpm <= HIGHEST_SPEED_RPM
    allowed = allowed and throttle_closed_deg(throttle) < throttle_deg <= throttle.wide_open_deg
    return OK if allowed else REFUSED


@compiled
def _check_command(lift: float, duration: float, opening: float, last_opening: float) -> int:
    """Check a command as `ValveCommand` does, and that it opens in its window."""
    allowed = 0.0 <= lift < math.inf and 0.0 < duration <= 360.0
    allowed = allowed and EARLIEST_OPENING_DEG <= opening < LATEST_OPENING_DEG
    allowed = allowed and opening + duration <= LATEST_CLOSING_DEG and opening < last_opening
    return OK if allowed else REFUSED


@compiled
def _deliver(
    valvetrain: ValvetrainNumbers, lift: float, duration: float, limit: int
) -> tuple[int, float]:
    """Lift that a camless actuator delivers; see `valve.deliverable_lift_mm`."""
    lowest = lowest_lift_mm(valvetrain)
    if not lowest <= lift <= valvetrain.maximum_lift_mm:
        return REFUSED, lift
    highest = highest_lift_mm(duration, valvetrain)
    if lift <= highest:
        return OK, lift
    if highest < lowest or limit == 0:
        return INFEASIBLE, lift
    return OK, highest
