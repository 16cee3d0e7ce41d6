"""Figures of a closed loop per event: settling of each mode, pole radii, noise."""

from __future__ import annotations

import math

import numpy as np

from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._realised import Matrices
from .event_loop import MODE_WIDTH

SETTLED = 0.02  # share of a disturbance that counts as settled


def mode_responses(closed: Matrices, n_cylinders: int, cycles: int) -> ComplexArray:
    """Responses to a disturbance of each mode from the first event on (..., modes, events).

    Mode q is the disturbance ``exp(j 2 pi q k/n)`` of event k, so that its modulus is 1.

    Parameters
    ----------
    closed : Matrices
        From the disturbance to the error; ``A`` and ``C`` may be stacks (..., s, s), (..., 1, s).
    n_cylinders : int
        Number of cylinders.
    cycles : int
        Length.
    """
    A, B, C, D = closed
    turn = np.exp(2j * np.pi * np.arange(n_cylinders // 2 + 1) / n_cylinders)
    x = np.zeros((*A.shape[:-1], turn.size), dtype=complex)
    d = np.ones(turn.size, dtype=complex)
    found = np.empty((n_cylinders * cycles, *A.shape[:-2], turn.size), dtype=complex)
    for k in range(len(found)):
        found[k] = (C @ x)[..., 0, :] + D[0, 0] * d
        x = A @ x + B * d
        d = d * turn
    return np.moveaxis(found, 0, -1)


def settling(responses: ComplexArray, n_cylinders: int) -> FloatArray:
    """Cycles after which each response stays within 2 %; infinite if it never does."""
    late = np.abs(responses) > SETTLED
    events = late.shape[-1] - np.argmax(late[..., ::-1], axis=-1)
    events = np.where(late.any(axis=-1), events, 0)
    return np.where(events == late.shape[-1], math.inf, events / n_cylinders)


def radii(poles: ComplexArray, n_cylinders: int) -> FloatArray:
    """Largest pole radius per cycle in the band of each mode; 0 where there is no pole."""
    turn = np.abs(np.angle(poles)) * n_cylinders / (2.0 * np.pi)
    size = np.abs(poles) ** n_cylinders
    return np.array(
        [
            np.max(size, where=np.abs(turn - q) <= MODE_WIDTH, initial=0.0)
            for q in range(n_cylinders // 2 + 1)
        ]
    )


def noise_gain(closed: Matrices) -> float:
    """Standard deviation of the output for white noise of unit deviation at the input."""
    from scipy.linalg import solve_discrete_lyapunov

    A, B, C, D = closed
    P = solve_discrete_lyapunov(A, B @ B.T)
    return math.sqrt(float((C @ P @ C.T + D @ D.T)[0, 0]))
