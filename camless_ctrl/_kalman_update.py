"""Arithmetic of the Kalman adaptation: covariances, one update, renewal of doubt.

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

from .adaptation_laws import AdaptationState, ParameterBounds


class KalmanMemory(NamedTuple):
    """What the filter remembers beside its parameters; arrays are read-only."""

    x: FloatArray  # (m,) state: ln g (1) of all cylinders, d (s) of all, c (1) if it is learnt
    covariance: FloatArray  # (m, m) of it
    information: tuple[float, ...]  # (m,) on each parameter in the recent memory, 1 and 1/s2
    scores: tuple[float, ...]  # (2n + 1,) faded sums: charge, duration a cylinder; all events


class Workspace(NamedTuple):
    """What an engine of n cylinders needs, with m states as in `KalmanMemory`."""

    prior: FloatArray  # (m, m)
    walk: FloatArray  # (m, m), of one event
    walks: tuple[float, float, float]  # its variances: ln g (1), d (s2), c (1; 0 if no state)
    still: FloatArray  # (m, m), no walk
    common: FloatArray  # (m, m), what of the prior all cylinders share
    variances: tuple[float, float, float]  # of the prior: ln g (1), d (s2), c (1; 0 if no state)
    factor: float  # of exponential forgetting, on the covariance per event
    bounds: tuple[float, float, float, float]  # of ln g (1), of d (s)
    kept: tuple[float, float]  # share of information left after a cycle, after an event


def workspace(
    n: int,
    prior: FloatArray,
    walk: FloatArray,
    common: FloatArray,
    factor: float,
    memory_cycles: float,
    bounds: ParameterBounds,
) -> Workspace:
    """Return the workspace of n cylinders for covariances (m, m) of prior, walk, common part."""
    walks, variances = (
        (float(P[0, 0]), float(P[n, n]), float(P[2 * n :, -1].sum())) for P in (walk, prior)
    )
    limits = *bounds.log_flow_gain, *bounds.duration_offset
    kept = 1.0 - 1.0 / memory_cycles, 1.0 - 1.0 / (n * memory_cycles)
    return Workspace(
        prior, walk, walks, np.zeros_like(walk), common, variances, factor, limits, kept
    )


def structured(
    n: int, flow: tuple[float, float], offset: tuple[float, float], charge: float, learnt: bool
) -> FloatArray:
    """Covariance of standard deviations (own, common) of flow gains, of offsets, and of c.

    Where c is not learnt, it is no state.
    """
    P = np.zeros((2 * n + learnt, 2 * n + learnt))
    for block, (own, common) in ((slice(0, n), flow), (slice(n, 2 * n), offset)):
        P[block, block] = own**2 * np.eye(n) + common**2
    if learnt:
        P[-1, -1] = charge**2
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
    values = state.log_flow_gain + state.duration_offset
    x = np.array(values + state.log_charge_factor[: len(P) - len(values)])
    return AdaptationState(
        state.log_flow_gain,
        state.duration_offset,
        state.log_charge_factor,
        KalmanMemory(read_only(x), read_only(P), information, scores),
    )


def by_parameter(values: FloatArray, n: int) -> FloatArray:
    """Values (m,) of the states as rows (3, n); what all cylinders share is told of each."""
    shared = values[2 * n :].sum()  # one, or none
    return np.vstack((values[: 2 * n].reshape(2, n), np.full(n, shared)))


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
def kernel() -> ModuleType:
    """Return the compiled part, which takes a second to import."""
    from . import _adaptation_kernel

    return _adaptation_kernel
