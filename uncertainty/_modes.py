"""Circulant modes of n cylinders, one event apart.

At the cycle phase ``theta`` (``zeta = exp(j theta)`` per cycle) mode ``q`` of equal cylinders
has the event shift ``z = exp(j (theta + 2 pi q)/n)``, with ``z^n = zeta``: over the events of a
cycle its signals go as ``v = (1, z, ..., z^(n-1))``, and ``H(zeta) v = g(z) v``. For one
``zeta`` the n vectors are orthogonal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from plant._checks import whole
from plant.air_path import ComplexArray, PulseResponse
from plant.kinematics import FloatArray


def mode_points(theta: ArrayLike, q: int, n: int) -> ComplexArray:
    """Shift per event of mode `q` at cycle phases `theta` (rad), of its shape."""
    angle = (np.asarray(theta, dtype=float) + 2.0 * np.pi * q) / n
    return np.asarray(np.exp(1j * angle))


def mode_vectors(theta: FloatArray, n: int) -> ComplexArray:
    """Unit mode vectors (f, n, n); those of mode q in column q."""
    z = np.stack([mode_points(theta, q, n) for q in range(n)], axis=-1)
    return np.asarray(z[:, None, :] ** np.arange(n)[:, None] / np.sqrt(n))


def in_modes(response: ComplexArray, theta: FloatArray) -> ComplexArray:
    """Lifted response (f, n, n) between modes: entry ``(p, q)`` goes from mode q to mode p."""
    v = mode_vectors(theta, response.shape[1])
    return np.asarray(np.conj(v.transpose(0, 2, 1)) @ response @ v)


def lifted_matrix(columns: Sequence[PulseResponse], theta: FloatArray) -> ComplexArray:
    """Lifted response (f, n, n) at cycle phases, from the response to each event's input.

    Column j holds every n-th term of its response, counted from each output's own event. The
    mean over the n roots ``z`` of ``zeta`` picks them out, tail included:
    ``H_ij(zeta) = 1/n sum_q z_q^(i-j) h_j(z_q)``.
    """
    n = len(columns)
    z = np.stack([mode_points(theta, q, n) for q in range(n)], axis=-1)  # (f, roots)
    lags = np.arange(n)[:, None] - np.arange(n)  # i - j
    values = np.stack([column(z) for column in columns], axis=-1)  # (f, roots, j)
    powers = z[:, :, None, None] ** lags  # (f, roots, i, j)
    return np.asarray((powers * values[:, :, None, :]).mean(axis=1))


def checked_mode(q: int, n: int) -> int:
    """Return a mode number after checking that it is one of ``0 ... n - 1``."""
    return whole("mode q", q, 0, n - 1, remedy=f"{n} cylinders have {n} modes")
