"""Search for the worst perturbation over the frequency as well."""

from __future__ import annotations

import numpy as np

from ._ascent import Problem, ascend
from ._response import FloatArray, Response
from .blocks import ComplexArray
from .lower import LowerBound, best_of, random_starts

_PEAKS = 4  # frequencies around which to search


def peaks(values: FloatArray, count: int = _PEAKS) -> list[int]:
    """Return the places of the largest local maxima, largest first."""
    padded = np.concatenate(([-np.inf], values, [-np.inf]))
    top = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
    return [int(k) for k in top[np.argsort(-values[top])][:count]]


def search(
    problem: Problem,
    response: Response,
    omega: FloatArray,
    found: ComplexArray,
    at: list[int],
    *,
    starts: int,
    steps: int,
    seed: int,
) -> LowerBound:
    """Return the worst perturbation around some points of the grid.

    The frequency is free between the neighbours of a point, except for frequency data.

    Parameters
    ----------
    problem : Problem
        Structure, and the blocks whose size is sought.
    response : Response
        Of the system.
    omega : ndarray (N,)
        Grid.
    found : ndarray (N, outputs, inputs)
        Perturbations to start from.
    at : list of int
        Points of the grid.
    starts : int
        Random starts a point.
    steps : int
        Most steps of a search.
    seed : int
        Seed.
    """
    D, w, low, high = [], [], [], []
    last = len(omega) - 1
    for j, k in enumerate(at):
        D += [
            found[max(k - 1, 0)],
            found[k],
            found[min(k + 1, last)],
            *random_starts(problem.structure, starts, seed + j),
        ]
        count = starts + 3
        w += [omega[k]] * count
        low += [omega[max(k - 1, 0)]] * count
        high += [omega[min(k + 1, last)]] * count
    points = np.array(w)
    free = response.omega is None
    state = ascend(
        problem,
        points,
        response.at(points),
        np.array(D),
        steps,
        matrices=response.at if free else None,
        bounds=(np.array(low), np.array(high)) if free else None,
    )
    return best_of(problem, state)
