"""Upper bound of the skewed structured singular value of one matrix.

Some blocks are held at ``|Delta| <= 1``; the size of the others, the free ones, is sought. With
the rows of the free blocks divided by ``c``, ``mu < 1`` proves that free blocks up to ``1/c``
are withstood. Scalings that prove one ``c`` prove a smaller one too; with those of the smaller
one this is repeated until nothing is gained.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ._ascent import Problem
from .blocks import ComplexArray
from .upper import Padding, UpperBound, bound_of, certificate

_LARGEST = 1e8  # bound, relative to the gain of the matrix, beyond which it counts as infinite
_ROUNDS = 15


def free_rows(problem: Problem, padding: Padding) -> np.ndarray:
    """Return which rows of the filled-up matrix belong to free blocks."""
    return np.repeat(problem.free, padding.sizes)


def skewed_bound(
    M: ComplexArray, problem: Problem, padding: Padding, guess: float, tolerance: float
) -> UpperBound:
    """Return the bound; infinite if it cannot be proved that the held blocks are withstood.

    Parameters
    ----------
    M : ndarray (inputs, outputs)
        Matrix.
    problem : Problem
        Structure and free blocks.
    padding : Padding
        The structure, filled up.
    guess : float
        A value to start from.
    tolerance : float
        Relative gain of a round at which to end.
    """
    full = padding.fill(M)
    free = free_rows(problem, padding)
    narrow = np.repeat(problem.free, [block.inputs for block in problem.structure.blocks])
    norm = float(np.linalg.norm(full, 2))
    level = guess if math.isfinite(guess) and guess > 0.0 else 2.0 * norm
    smallest = 1e-9 * norm

    def at(c: float, matrix: ComplexArray, rows: np.ndarray) -> ComplexArray:
        return np.asarray(matrix * np.where(rows, 1.0 / c, 1.0)[:, None])

    if norm == 0.0:
        return bound_of(M, padding)
    while True:
        bound = bound_of(at(level, M, narrow), padding)
        if bound.value < 1.0:
            break
        if level >= _LARGEST * norm:
            return replace(bound, value=math.inf)
        level = min(3.0 * level, _LARGEST * norm)
    for _ in range(_ROUNDS):
        high, low = level, max(1e-3 * level, smallest)
        while high > low * (1.0 + 0.1 * tolerance):
            middle = math.sqrt(high * low)
            proved = certificate(at(middle, full, free), bound.D, bound.G)[0] <= 1.0
            high, low = (middle, low) if proved else (high, middle)
        gained = 1.0 - high / level
        level = high
        if level <= smallest * 1.01:
            break
        new = bound_of(at(level, M, narrow), padding)
        if gained < tolerance or new.value >= 1.0:
            break
        bound = new
    return replace(bound, value=level)
