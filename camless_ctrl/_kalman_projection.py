"""Projection of what the Kalman adaptation believes onto the set of allowed parameters.

Private to `kalman_adaptation`. This project's own design.
"""

from __future__ import annotations

import numpy as np

from plant.kinematics import FloatArray

from ._kalman_update import KalmanMemory, read_only
from .adaptation_laws import AdaptationState, ParameterBounds, clipper

_GUESSES = 20  # of the bounds that hold a projection
_CHANGES = 200  # of the bounds, one by one


def projected_state(
    bounds: ParameterBounds,
    outside: bool,
    x: FloatArray,
    P: FloatArray,
    before: AdaptationState,
    information: list[float],
    scores: list[float],
) -> tuple[AdaptationState, bool]:
    """State with the values `x` of the filter, and whether a bound has held one.

    Parameters
    ----------
    bounds : ParameterBounds
        The set.
    outside : bool
        Whether a flow gain or an offset lies outside.
    x, P : ndarray (m,), (m, m)
        Values and covariance of the filter, as in `KalmanMemory`.
    before : AdaptationState
        State before the event.
    information, scores : list of float
        The rest of the memory.
    """
    n, values, factors = len(before.log_flow_gain), x.tolist(), before.log_charge_factor
    gains, offsets = values[:n], values[n : 2 * n]
    least, most = bounds.log_charge_factor
    learnt = len(values) > 2 * n
    if learnt:
        factors = shifted(factors, before.memory.x.item(2 * n), values[-1])
    projected = outside or (learnt and (min(factors) < least or max(factors) > most))
    if projected:
        (low, high), (first, last) = bounds.log_flow_gain, bounds.duration_offset
        lower, upper = [low] * n + [first] * n, [high] * n + [last] * n
        if learnt:  # such that the factors of all cylinders are within
            lower.append(least + values[-1] - min(factors))
            upper.append(most + values[-1] - max(factors))
        values = project_onto_box(x, P, lower, upper)
        gains, offsets = values[:n], values[n : 2 * n]
        if learnt:
            clip = clipper(least, most)  # of rounding
            factors = tuple(map(clip, shifted(factors, x.item(2 * n), values[-1])))
        x = np.array(values)
    memory = KalmanMemory(read_only(x), read_only(P), tuple(information), tuple(scores))
    return AdaptationState(tuple(gains), tuple(offsets), factors, memory), projected


def project_onto_box(
    x: FloatArray, P: FloatArray, low: list[float], high: list[float]
) -> list[float]:
    """Return the point of a box that is nearest to `x` in the norm of the inverse of `P`.

    It is ``x - P m`` with a multiplier ``m`` for each bound that holds it. Which bounds do is
    found by the primal-dual active-set method (Hintermueller, Ito and Kunisch 2002), which solves
    the bounds of the last guess together. Where it goes round in circles, the bounded least
    squares of scipy take over. What rounding leaves outside is clipped.
    """
    lower, upper, variance = np.array(low), np.array(high), P.diagonal()
    m, y = np.zeros(x.size), x
    held = np.zeros(x.size)
    for _ in range(_GUESSES):
        pull = m * variance + y  # where a bound pulls back, or a value lies outside
        guess = np.where(pull > upper, 1.0, np.where(pull < lower, -1.0, 0.0))
        if np.array_equal(guess, held):
            break
        held, at = guess, guess != 0.0
        bound = np.where(guess > 0.0, upper, lower)
        m = np.zeros(x.size)
        m[at] = np.linalg.solve(P[np.ix_(at, at)], (x - bound)[at])
        y = np.where(at, bound, x - P @ m)
    else:
        y = bounded_least_squares(x, P, lower, upper)
    return [min(max(value, a), b) for value, a, b in zip(y.tolist(), low, high, strict=True)]


def bounded_least_squares(
    x: FloatArray, P: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Return the same point by active sets that change by one bound at a time (some ms)."""
    from scipy.linalg import cholesky, solve_triangular
    from scipy.optimize import lsq_linear

    size = np.sqrt(P.diagonal())  # of different units: scaled
    root = cholesky(P / size[:, None] / size, lower=True)
    inverse = solve_triangular(root, np.eye(x.size), lower=True)
    found = lsq_linear(
        inverse,
        inverse @ (x / size),
        (lower / size, upper / size),
        method="bvls",
        tol=1e-14,
        max_iter=_CHANGES,
    )
    return np.asarray(found.x * size)


def shifted(factors: tuple[float, ...], before: float, after: float) -> tuple[float, ...]:
    """Logarithms that move with a common one; what equals it stays equal to it."""
    if factors == (before,) * len(factors):
        return (after,) * len(factors)
    change = after - before
    return tuple([after if value == before else value + change for value in factors])
