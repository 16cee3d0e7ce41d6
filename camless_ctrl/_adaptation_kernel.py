"""Compiled arithmetic of the Kalman adaptation. Imported when a law is first used."""

from __future__ import annotations

import math

import numba
import numpy as np

from plant.kinematics import FloatArray

_V, _M = (f"Array(f8, {dimensions}, 'C', readonly=True)" for dimensions in (1, 2))
_GROWN = f"f8[:, ::1]({_M}, {_M}, f8, {_M}, i8, i8, i8)"
_UPDATE = (
    f"Tuple((f8[::1], f8[:, ::1], b1))({_V}, {_M}, {_M}, f8, i8, i8, i8, "
    "b1, f8, f8, f8, f8, f8, b1, f8, f8, UniTuple(f8, 4))"
)


@numba.njit(_GROWN, cache=True, nogil=True, error_model="numpy")
def grown(
    P: FloatArray, walk: FloatArray, factor: float, prior: FloatArray, i: int, j: int, k: int
) -> FloatArray:
    """Covariance after forgetting and walk, no variance above its prior one.

    Cut where one of the three states that are used next is above; correlations stay.
    """
    n = len(P)
    after = np.empty((n, n))
    for a in range(n):
        for b in range(n):
            after[a, b] = P[a, b] * factor + walk[a, b]
    if after[i, i] > prior[i, i] or after[j, j] > prior[j, j] or after[k, k] > prior[k, k]:
        scale = np.ones(n)
        for a in range(n):
            if after[a, a] > prior[a, a]:
                scale[a] = math.sqrt(prior[a, a] / after[a, a])
        for a in range(n):
            for b in range(n):
                after[a, b] *= scale[a] * scale[b]
    return after


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _measured(
    x: FloatArray,
    P: FloatArray,
    at: tuple[int, int, int],
    slopes: tuple[float, float, float],
    innovation: float,
    noise: float,
) -> None:
    """Take in one scalar measurement of three states, in place (Joseph's form)."""
    n = x.size
    i, j, k = at
    s, t, u = slopes
    towards = np.empty(n)
    for a in range(n):
        towards[a] = s * P[a, i] + t * P[a, j] + u * P[a, k]
    spread = s * towards[i] + t * towards[j] + u * towards[k] + noise
    # (I - K h)P(I - K h)' + K r K' with K = P h'/spread, multiplied out: symmetric by itself.
    for a in range(n):
        gain = towards[a] / spread
        x[a] += gain * innovation
        for b in range(a, n):
            P[a, b] -= gain * towards[b]
            P[b, a] = P[a, b]


@numba.njit(_UPDATE, cache=True, nogil=True, error_model="numpy")
def update(
    x: FloatArray,
    P: FloatArray,
    walk: FloatArray,
    factor: float,
    i: int,
    j: int,
    k: int,
    has_charge: bool,
    slope_i: float,
    slope_j: float,
    slope_k: float,
    charge: float,
    charge_noise: float,
    has_duration: bool,
    duration: float,
    duration_noise: float,
    bounds: tuple[float, float, float, float],
) -> tuple[FloatArray, FloatArray, bool]:
    """State and covariance after the walk, a charge and a duration error; what lies outside.

    Their noises are independent, and they depend on three states alone. Innovations are against
    the state before; measurements are taken in one after the other, which for independent noises
    is the same as both at once.

    Parameters
    ----------
    x, P : ndarray (m,), (m, m)
        State and covariance before.
    walk, factor : ndarray (m, m), float
        What is added to the covariance first, after it is multiplied by the factor.
    i, j, k : int
        Places of ln g and d of the cylinder, and of c. Where c is no state, any and no slope.
    has_charge, has_duration : bool
        Whether there is such an error.
    slope_i, slope_j, slope_k : float
        Slopes of the charge over ln g, d (1/s) and c.
    charge, charge_noise : float
        Innovation and variance of the noise.
    duration, duration_noise : float
        Innovation (s) and variance of the noise (s2).
    bounds : tuple of float
        Lowest and highest ln g (1), lowest and highest d (s): whether one lies outside is told.
    """
    n = x.size
    after, spread = x.copy(), np.empty((n, n))
    for a in range(n):
        for b in range(n):
            spread[a, b] = P[a, b] * factor + walk[a, b]
    if has_duration:
        _measured(after, spread, (i, j, k), (0.0, 1.0, 0.0), duration, duration_noise)
    if has_charge:
        charge -= slope_i * (after[i] - x[i]) + slope_j * (after[j] - x[j])
        charge -= slope_k * (after[k] - x[k])
        _measured(after, spread, (i, j, k), (slope_i, slope_j, slope_k), charge, charge_noise)
    low, high, first, last = bounds
    outside, half = False, n // 2
    for a in range(half):
        if not (low <= after[a] <= high and first <= after[half + a] <= last):
            outside = True
    return after, spread, outside
