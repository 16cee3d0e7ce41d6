"""Arithmetic of the Kalman adaptation: covariances, one update, renewal of doubt, projection.

Private to `kalman_adaptation`. This project's own design.
"""

from __future__ import annotations

import functools
import math
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant.errors import ParameterError
from plant.kinematics import FloatArray

from .adaptation_laws import AdaptationState

_GUESSES = 20  # of the bounds that hold a projection
_CHANGES = 200  # of the bounds, one by one


class KalmanMemory(NamedTuple):
    """What the filter remembers beside its parameters; arrays are read-only."""

    x: FloatArray  # (2n,) state of the filter: ln g (1) of all cylinders, then d (s)
    covariance: FloatArray  # (2n, 2n) of it
    information: tuple[float, ...]  # (2n,) on each parameter in the recent memory, 1 and 1/s2
    scores: tuple[float, ...]  # (2n + 1,) faded sums: charge, duration a cylinder; all events


class Workspace(NamedTuple):
    """What an engine of n cylinders needs; filters and arrays are scratch, set at each use."""

    prior: FloatArray  # (2n, 2n)
    walk: FloatArray  # (2n, 2n), of one event
    common: FloatArray  # (2n, 2n), what of the prior all cylinders share
    variances: tuple[float, float]  # of the prior, of ln g (1) and d (s2)
    factor: float  # of exponential forgetting, on the covariance per event


def workspace(prior: FloatArray, walk: FloatArray, common: FloatArray, factor: float) -> Workspace:
    """Return the workspace for covariances (2n, 2n) of prior, walk, and common part."""
    return Workspace(prior, walk, common, (float(prior[0, 0]), float(prior[-1, -1])), factor)


def structured(n: int, flow: tuple[float, float], offset: tuple[float, float]) -> FloatArray:
    """Covariance of standard deviations (own, common) of flow gains, then of offsets."""
    P = np.zeros((2 * n, 2 * n))
    for block, (own, common) in ((slice(0, n), flow), (slice(n, 2 * n), offset)):
        P[block, block] = own**2 * np.eye(n) + common**2
    return P


def steady_gain(walk: float, noise: float, forgetting: float) -> float:
    """Gain of the converged scalar filter of given variances of walk and noise.

    The variance before a measurement solves ``p = p R/(p + R)/forgetting + q``.
    """
    b = forgetting * noise - noise - forgetting * walk
    p = (-b + math.sqrt(b * b + 4.0 * forgetting**2 * walk * noise)) / (2.0 * forgetting)
    return p / (p + noise)


def limited(P: FloatArray, prior: FloatArray) -> FloatArray:
    """Covariance without a variance above its prior one; correlations stay."""
    scale = np.sqrt(np.minimum(prior.diagonal() / P.diagonal(), 1.0))
    return P * scale[:, None] * scale


def updated(
    x: FloatArray,
    P: FloatArray,
    at: tuple[int, int],
    charge: tuple[float, float, float, float] | None,
    duration: tuple[float, float] | None,
) -> tuple[FloatArray, FloatArray]:
    """State and covariance after measurements that depend on the two states `at` alone.

    Parameters
    ----------
    x, P : ndarray (2n,), (2n, 2n)
        State and covariance before.
    at : (int, int)
        Places of ln g and d of the cylinder.
    charge : tuple of float or None
        Slopes over ln g and d, innovation, variance of the noise.
    duration : tuple of float or None
        Innovation (s) and variance of the noise (s2).
    """
    s_g, s_d, error, noise = charge or (0.0, 0.0, 0.0, 1.0)
    late, noise_d = duration or (0.0, 1.0)
    found: tuple[FloatArray, FloatArray] = _kernel().update(
        x, P, *at, charge is not None, s_g, s_d, error, noise, duration is not None, late, noise_d
    )
    return found


def share_of_doubt(innovation: float, variance: float, prior: float) -> float:
    """Share of the way to the prior variance at which an innovation has its own size."""
    if not prior > variance:
        return 0.0
    return min(max((innovation * innovation - variance) / (prior - variance), 0.0), 1.0)


def renewed(P: FloatArray, at: tuple[int, int], share: float, prior: FloatArray) -> FloatArray:
    """Covariance of which two states are led towards their prior, apart from all others."""
    keep = np.ones(len(P))
    keep[list(at)] = math.sqrt(1.0 - share)
    P = P * keep[:, None] * keep
    for k in at:
        P[k, k] += share * prior[k, k]
    return P


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


def read_only(values: FloatArray) -> FloatArray:
    """Return an array after forbidding to write to it."""
    values.setflags(write=False)
    return values


def with_memory(
    state: AdaptationState,
    P: FloatArray,
    information: tuple[float, ...],
    scores: tuple[float, ...],
) -> AdaptationState:
    """Return a state with the memory of the filter."""
    x = np.array(state.log_flow_gain + state.duration_offset)
    return AdaptationState(
        state.log_flow_gain,
        state.duration_offset,
        state.log_charge_factor,
        KalmanMemory(read_only(x), read_only(P), information, scores),
    )


def numbers(name: str, values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return finite numbers of a shape; raises `ParameterError` for others."""
    found = np.array(values, dtype=float)
    if found.shape != shape or not np.all(np.isfinite(found)):
        raise ParameterError(
            f"{name} has shape {found.shape}, but must hold finite numbers of shape {shape}: "
            "export the state with to_dict"
        )
    return found


def covariance_checked(P: FloatArray) -> FloatArray:
    """Return a covariance; raises `ParameterError` if it cannot be one."""
    size = np.sqrt(np.abs(P.diagonal()))
    size = np.where(size > 0.0, size, 1.0)
    correlation = P / size[:, None] / size  # of like size, whatever the units
    lowest = np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min()
    if not np.allclose(correlation, correlation.T, atol=1e-9) or lowest < -1e-9:
        raise ParameterError(
            "the covariance must be symmetric without a negative eigenvalue, but is not: export "
            "the state with to_dict"
        )
    return P


@functools.cache
def _kernel() -> ModuleType:
    from . import _adaptation_kernel

    return _adaptation_kernel
