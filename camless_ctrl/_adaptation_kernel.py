"""Compiled update of the Kalman adaptation. Imported when a law is first used."""

from __future__ import annotations

import numba
import numpy as np

from plant.kinematics import FloatArray

_TYPES = (
    "Tuple((f8[::1], f8[:, ::1]))(Array(f8, 1, 'C', readonly=True), "
    "Array(f8, 2, 'C', readonly=True), i8, i8, b1, f8, f8, f8, f8, b1, f8, f8)"
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _measured(
    x: FloatArray,
    P: FloatArray,
    i: int,
    j: int,
    slope_i: float,
    slope_j: float,
    innovation: float,
    noise: float,
) -> None:
    """Take in one scalar measurement of two states, in place (Joseph's form)."""
    n = x.size
    towards = np.empty(n)
    for a in range(n):
        towards[a] = slope_i * P[a, i] + slope_j * P[a, j]
    spread = slope_i * towards[i] + slope_j * towards[j] + noise
    for a in range(n):
        x[a] += towards[a] * innovation / spread
    # (I - K h)P(I - K h)' + K r K' with K = P h'/spread, multiplied out: symmetric by itself.
    for a in range(n):
        for b in range(a, n):
            P[a, b] -= towards[a] * towards[b] / spread
            P[b, a] = P[a, b]


@numba.njit(_TYPES, cache=True, nogil=True, error_model="numpy")
def update(
    x: FloatArray,
    P: FloatArray,
    i: int,
    j: int,
    has_charge: bool,
    slope_i: float,
    slope_j: float,
    charge: float,
    charge_noise: float,
    has_duration: bool,
    duration: float,
    duration_noise: float,
) -> tuple[FloatArray, FloatArray]:
    """State and covariance after a charge and a duration error with independent noises.

    Innovations are against the state before; measurements are taken in one after the other,
    which for independent noises is the same as both at once.
    """
    after, spread = x.copy(), P.copy()
    if has_duration:
        _measured(after, spread, j, j, 1.0, 0.0, duration, duration_noise)
    if has_charge:
        moved = slope_i * (after[i] - x[i]) + slope_j * (after[j] - x[j])
        _measured(after, spread, i, j, slope_i, slope_j, charge - moved, charge_noise)
    return after, spread
