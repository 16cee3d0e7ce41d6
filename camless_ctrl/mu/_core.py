"""Both bounds over the frequency, for the plain and for the skewed structured singular value."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ._ascent import Problem, State, ascend
from ._guarantee import prove
from ._points import Points, frequencies
from ._response import Response
from ._search import peaks, search
from .lower import LowerBound, best_of, sweep
from .result import MuResult

_RAISED = 20  # times that a proof may find a higher peak

Progress: TypeAlias = Callable[[int, int], None]


def run(
    response: Response,
    problem: Problem,
    omega: ArrayLike | None,
    *,
    tolerance: float,
    gap: float,
    seed: int,
    progress: Progress | None,
) -> MuResult:
    """Bound, search, refine and prove.

    Parameters
    ----------
    response : Response
        Of a stable system.
    problem : Problem
        Structure, and the blocks whose size is sought.
    omega : array_like or None
        Frequencies, rad per time unit.
    tolerance, gap : float
        Accuracy of the peak; gap from which the search is intensified.
    seed : int
        Seed of the starts.
    progress : callable or None
        Called with the frequencies done and their number.
    """
    structure = problem.structure
    points = Points(response, problem, tolerance)
    fine = not points.padding.repeated and problem.plain
    points.add(frequencies(response, omega, fine=fine), progress)
    grid = points.omega
    state = sweep(problem, grid, points.matrices(), points.vectors(), seed)
    found = [best_of(problem, state.row(k)) for k in range(len(grid))]
    # real parameters alone cross the boundary at single frequencies: look everywhere
    alone = structure.only_real
    worst = search(
        problem,
        response,
        grid,
        state.D,
        list(range(len(grid))) if alone else _places(points, found),
        starts=1 if alone else 6,
        steps=30,
        seed=seed,
    )
    _add(points, worst)
    if response.omega is None:
        points.refine()
    guaranteed = _proved(points, float(grid[-1]))
    for most, starts, steps in ((tolerance, 6, 30), (gap, 40, 60)):
        if worst.value >= (1.0 - most) * points.upper().max():
            break
        places = peaks(points.upper(), 2)  # on the refined grid
        nearest = np.abs(points.omega[:, None] - grid).argmin(axis=1)
        again = search(
            problem,
            response,
            points.omega,
            state.D[nearest],
            places,
            starts=starts,
            steps=steps,
            seed=seed + starts,
        )
        worst = again if again.value > worst.value else worst
        _add(points, worst)
    bounds = _lower(points, state, found, worst)
    worst = max((*bounds, worst), key=lambda bound: bound.value)
    lower = np.array([bound.value for bound in bounds])
    upper = points.upper()
    return MuResult(
        structure,
        points.omega,
        upper,
        lower,
        float(upper.max()),
        worst.value,
        float(points.omega[np.argmax(upper)]),
        worst.delta,
        worst.omega if worst.delta is not None else math.nan,
        guaranteed,
        tolerance,
        gap,
        response.dt,
        tuple(n for n, free in zip(structure.names, problem.free, strict=True) if not free),
    )


def _places(points: Points, found: Sequence[LowerBound]) -> list[int]:
    values = np.array([bound.value for bound in found])
    return list(dict.fromkeys(peaks(points.upper()) + peaks(values)))


def _proved(points: Points, top: float) -> bool:
    """Prove the peak at all frequencies; points at which it is exceeded join the others."""
    peak = float(points.upper().max())
    if points.response.matrices is None or not math.isfinite(peak):
        return False
    if points.problem.plain:
        proof = prove(points.response, points.padding, peak, points.tolerance)
        points.include(proof.omega, proof.bounds, top)
        return proof.holds
    for _ in range(_RAISED):
        # mu = 1 with the free blocks at this size: what is to be proved
        scaled = points.scaled(peak * (1.0 + points.tolerance))
        proof = prove(scaled, points.padding, 0.0, 0.0, fixed=1.0)
        if proof.holds:
            return True
        last = float(proof.omega[-1])
        if proof.bounds[-1].value < 1.0 or last > top:
            return False
        points.add(np.array([last]))
        new = float(points.upper().max())
        if not math.isfinite(new) or new <= peak:
            return False
        peak = new
    return False


def _add(points: Points, worst: LowerBound) -> None:
    """Evaluate the upper bound where the worst perturbation is."""
    if worst.delta is not None:
        points.add(np.array([worst.omega]))


def _lower(
    points: Points, state: State, found: Sequence[LowerBound], worst: LowerBound
) -> list[LowerBound]:
    """Lower bounds at all frequencies: those that were added start from their neighbours."""
    omega = points.omega
    known = {bound.omega: bound for bound in found}
    new = omega[~np.isin(omega, state.omega)]
    if new.size:
        nearest = np.abs(new[:, None] - state.omega).argmin(axis=1)
        more = ascend(points.problem, new, points.response.at(new), state.D[nearest], 15)
        known |= {float(w): best_of(points.problem, more.row(k)) for k, w in enumerate(new)}
    if worst.delta is not None and worst.value > known[worst.omega].value:
        known[worst.omega] = worst
    return [known[float(w)] for w in omega]
