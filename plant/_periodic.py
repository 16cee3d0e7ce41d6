"""Compiled periodic solution: the cycle that repeats, in few cycles.

A window hands on the masses of manifold and open cylinders; runner and valve motion repeat by
themselves after one event. Most of what is handed on is forgotten at once; what lasts is the
filling of the manifold, over tens of events behind a nearly shut throttle. That one slow motion
is extrapolated by the secant through two windows (Anderson's method with a memory of one).

Equal cylinders do the same one event apart, so that each window, with the cylinders' places
moved on by one, is an iteration. Else an iteration is a cycle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ._compile import compiled
from ._kernel import advance_window
from ._layout import (
    CHARGE,
    COMPLETED,
    FLOW,
    INFLOW,
    LOSS,
    MANIFOLD_MASS,
    MASS,
    NO_STAGE_SOLUTION,
    OK,
    PHASE,
    SHUT,
    STEPS,
    THROTTLE_FLOW,
    WORK,
    Event,
    KernelEngine,
    Window,
)

NOT_PERIODIC = 4  # status: the most cycles are done

# The choice of steps makes a window's result jump by about 1e-6 between neighbouring starts.
APART = 1e-4  # least distance of the secant's two points, relative: the jumps do not tilt it
JITTER = 1e-6  # change that those jumps alone may cause, at resolution 1
JITTER_PATIENCE = 3  # extrapolations without a smaller change after which such a one is the end
FORGIVEN = 1e-5  # change that may rise from one iteration to the next
PATIENCE = 8  # extrapolations without a smaller change after which plain cycling goes on
PLAIN_PATIENCE = 20  # plain cycles without a smaller change after which it is an alternation
SMALLER = 0.7  # a change by this factor is a smaller one
ALTERNATING = 5e-5  # largest change of an alternation: a quarter of the accuracy
MOST_STRIKES = 3  # extrapolations that failed after which plain cycling goes on

# Tables of the workspace: states at the start and at the end of iterations.
BEFORE, AFTER, BEST_BEFORE, BEST_AFTER, PAST_BEFORE, PAST_AFTER, NEXT, TABLES = range(8)

# Rows of the cylinders' data: delivered lift, duration, crank angle from the start of the
# window to IVO, flow coefficient in kg/s/mm, and (workspace) crank angle at the start.
LIFT, DURATION, UNTIL_OPENING, COEFFICIENT, ANGLE, CYLINDER_ROWS = range(6)


class Periodic(NamedTuple):
    """How an iteration ended."""

    status: int
    windows: int  # windows simulated
    residual: float  # change over the last iteration
    inflow: float  # through the throttle over a cycle, kg


@compiled
def solve_periodic(
    engine: KernelEngine,
    window: Window,
    cylinders: np.ndarray,  # (CYLINDER_ROWS, n), commands and flow coefficients of the cylinders
    advance_deg: float,
    tolerance: float,
    most_cycles: int,
    tables: np.ndarray,  # (TABLES, n, CYLINDER_COLUMNS), workspace
    manifolds: np.ndarray,  # (TABLES, MANIFOLD_ENTRIES), workspace
    work: np.ndarray,  # scratch, see advance_window
    forcing: np.ndarray,
    breathing: np.ndarray,
) -> Periodic:
    """Iterate to the cycle that repeats.

    ``tables[BEFORE]`` and ``manifolds[BEFORE]`` are then the state at the start of that cycle,
    with charge and loss of every cylinder's event in it.
    """
    n = engine.n_cylinders
    turns = 1 if _alike(cylinders) else n  # windows an iteration
    tables[BEFORE] = 0.0
    manifolds[BEFORE] = 0.0
    manifolds[BEFORE, MANIFOLD_MASS] = engine.capacity * engine.ambient_pressure
    windows, strikes, idle = 0, 0, 0
    best, least, last = np.inf, np.inf, np.inf
    remembers, extrapolated, plain = False, False, False
    while True:
        if windows + turns > most_cycles * n:
            return Periodic(NOT_PERIODIC, windows, best, 0.0)
        _copy(tables, manifolds, BEFORE, AFTER)
        status = OK
        for k in range(turns):
            for j in range(n):
                cylinders[ANGLE, j] = ((k - j) % n) * (720.0 / n) - advance_deg
            event = Event(
                k, cylinders[UNTIL_OPENING, k], cylinders[LIFT, k], cylinders[DURATION, k]
            )
            status = advance_window(
                engine,
                window,
                event,
                cylinders[COEFFICIENT],
                cylinders[ANGLE],
                tables[AFTER],
                manifolds[AFTER],
                tables[NEXT],  # in place of a trace: without samples it is not touched
                0,
                work,
                forcing,
                breathing,
            )
            windows += 1
            if status != OK:
                break
        if status != OK:
            if not extrapolated:
                return Periodic(status, windows, best, 0.0)
            plain, extrapolated, idle = True, False, 0
            _copy(tables, manifolds, BEST_AFTER, BEFORE)
            continue
        if turns < n:
            _move_on(tables[AFTER])
        if not _same_phases(tables):  # valves that overlap have yet to open once
            _copy(tables, manifolds, AFTER, BEFORE)
            continue

        change = _change(engine, tables, manifolds)
        if not change < np.inf:
            return Periodic(NO_STAGE_SOLUTION, windows, best, 0.0)
        idle += 1
        if change < SMALLER * least:
            least, idle = change, 0
        if change < best:
            best = change
            _copy(tables, manifolds, BEFORE, BEST_BEFORE)
            _copy(tables, manifolds, AFTER, BEST_AFTER)
        if best <= tolerance:
            break
        if idle > JITTER_PATIENCE and best * window.resolution**3 <= JITTER:
            break
        if plain and idle * turns > PLAIN_PATIENCE * n and best <= ALTERNATING:
            break
        if not plain and idle > PATIENCE:
            plain, extrapolated, idle = True, False, 0
            _copy(tables, manifolds, BEST_AFTER, BEFORE)
            continue
        if extrapolated and change > 2.0 * last and change > FORGIVEN:
            strikes += 1
            plain = strikes == MOST_STRIKES
            remembers = False
        last = change
        extrapolated = remembers and not plain
        _copy(tables, manifolds, AFTER, NEXT)
        if extrapolated:
            _extrapolate(tables, manifolds)
        if not remembers or _distance(tables, manifolds) > APART:
            _copy(tables, manifolds, BEFORE, PAST_BEFORE)
            _copy(tables, manifolds, AFTER, PAST_AFTER)
            remembers = True
        _copy(tables, manifolds, NEXT, BEFORE)
    inflow = manifolds[BEST_AFTER, INFLOW] - manifolds[BEST_BEFORE, INFLOW]
    _write_cycle(tables, manifolds, turns)
    return Periodic(OK, windows, best, inflow * (n / turns))


@compiled
def _alike(cylinders: np.ndarray) -> bool:
    """Whether all cylinders do the same, one event apart."""
    for j in range(1, cylinders.shape[1]):
        for r in range(ANGLE):
            if cylinders[r, j] != cylinders[r, 0]:
                return False
    return True


@compiled
def _copy(tables: np.ndarray, manifolds: np.ndarray, source: int, target: int) -> None:
    for j in range(tables.shape[1]):
        for c in range(tables.shape[2]):
            tables[target, j, c] = tables[source, j, c]
    for c in range(manifolds.shape[1]):
        manifolds[target, c] = manifolds[source, c]


@compiled
def _move_on(table: np.ndarray) -> None:
    """Move the cylinders' places on by one: the next to open comes first."""
    last = table.shape[0] - 1
    for c in range(table.shape[1]):
        first = table[0, c]
        for j in range(last):
            table[j, c] = table[j + 1, c]
        table[last, c] = first


@compiled
def _same_phases(tables: np.ndarray) -> bool:
    same = True
    for j in range(tables.shape[1]):
        same = same and tables[BEFORE, j, PHASE] == tables[AFTER, j, PHASE]
    return same


@compiled
def _change(engine: KernelEngine, tables: np.ndarray, manifolds: np.ndarray) -> float:
    """Largest change of what an iteration hands on.

    Of the manifold mass, relative; of the masses of open cylinders, relative to a displaced
    volume of ambient air; of their work, relative to its volume work.
    """
    work = engine.ambient_pressure * 2.0 * engine.half_stroke_volume
    mass = work / engine.gas
    change = abs(manifolds[AFTER, MANIFOLD_MASS] / manifolds[BEFORE, MANIFOLD_MASS] - 1.0)
    for j in range(tables.shape[1]):
        if tables[BEFORE, j, PHASE] != SHUT:
            change = max(change, abs(tables[AFTER, j, MASS] - tables[BEFORE, j, MASS]) / mass)
            change = max(change, abs(tables[AFTER, j, WORK] - tables[BEFORE, j, WORK]) / work)
    return change


@compiled
def _distance(tables: np.ndarray, manifolds: np.ndarray) -> float:
    """Distance of this iteration's start from the remembered one, in manifold masses."""
    square = (manifolds[BEFORE, MANIFOLD_MASS] - manifolds[PAST_BEFORE, MANIFOLD_MASS]) ** 2
    for j in range(tables.shape[1]):
        if tables[BEFORE, j, PHASE] != SHUT:
            square += (tables[BEFORE, j, MASS] - tables[PAST_BEFORE, j, MASS]) ** 2
    return np.sqrt(square) / manifolds[BEFORE, MANIFOLD_MASS]


@compiled
def _extrapolate(tables: np.ndarray, manifolds: np.ndarray) -> None:
    """Write to NEXT where the secant through this and the remembered iteration ends.

    All that is handed on goes in proportion. No mass more than doubles or halves.
    """
    n = tables.shape[1]
    change = manifolds[AFTER, MANIFOLD_MASS] - manifolds[BEFORE, MANIFOLD_MASS]
    past = manifolds[PAST_AFTER, MANIFOLD_MASS] - manifolds[PAST_BEFORE, MANIFOLD_MASS]
    product, square = change * (change - past), (change - past) ** 2
    for j in range(n):
        if tables[BEFORE, j, PHASE] != SHUT:
            change = tables[AFTER, j, MASS] - tables[BEFORE, j, MASS]
            past = tables[PAST_AFTER, j, MASS] - tables[PAST_BEFORE, j, MASS]
            product += change * (change - past)
            square += (change - past) ** 2
    share = product / square if square > 0.0 else 0.0
    for _ in range(8):
        mass, old = manifolds[AFTER, MANIFOLD_MASS], manifolds[PAST_AFTER, MANIFOLD_MASS]
        fits = 0.5 * mass <= mass - share * (mass - old) <= 2.0 * mass
        for j in range(n):
            if tables[BEFORE, j, PHASE] != SHUT:
                mass, old = tables[AFTER, j, MASS], tables[PAST_AFTER, j, MASS]
                fits = fits and 0.5 * mass <= mass - share * (mass - old) <= 2.0 * mass
        if fits:
            break
        share *= 0.5
    if not fits:
        return
    for c in (MANIFOLD_MASS, THROTTLE_FLOW):
        manifolds[NEXT, c] -= share * (manifolds[AFTER, c] - manifolds[PAST_AFTER, c])
    for j in range(n):
        if tables[BEFORE, j, PHASE] != SHUT:
            for c in (MASS, WORK, FLOW):
                tables[NEXT, j, c] -= share * (tables[AFTER, j, c] - tables[PAST_AFTER, j, c])


@compiled
def _write_cycle(tables: np.ndarray, manifolds: np.ndarray, turns: int) -> None:
    """Write the best iteration's start to BEFORE, each cylinder with its event in the cycle."""
    n = tables.shape[1]
    done = 0  # place whose event was completed in the window
    if turns < n:
        for j in range(n):
            if tables[BEST_AFTER, j, COMPLETED] > tables[BEST_BEFORE, (j + 1) % n, COMPLETED]:
                done = j
    for j in range(n):
        event = j if turns == n else done
        source = BEST_AFTER if tables[BEST_BEFORE, j, PHASE] == SHUT else BEST_BEFORE
        row = event if source == BEST_AFTER else j
        for c in range(tables.shape[2]):
            tables[BEFORE, j, c] = tables[source, row, c]
        tables[BEFORE, j, CHARGE] = tables[BEST_AFTER, event, CHARGE]
        tables[BEFORE, j, LOSS] = tables[BEST_AFTER, event, LOSS]
        tables[BEFORE, j, COMPLETED] = 1.0
    for c in range(manifolds.shape[1]):
        manifolds[BEFORE, c] = manifolds[BEST_BEFORE, c]
    manifolds[BEFORE, INFLOW] = 0.0
    manifolds[BEFORE, STEPS] = 0.0
