"""Proof that a bound holds at every frequency, not on a grid alone.

Scalings that prove a level at one frequency prove it at all frequencies around it up to the
first one at which ``M^H D M + j(G M - M^H G) - level^2 D`` becomes singular. Those are
eigenvalues of a Hamiltonian pencil on the stability boundary (Ferreres, Magni and Biannic,
2003, do so for real parameters). Intervals are proved and set aside until none is left; where
the level cannot be proved, it is raised.

Frequencies are mapped to an angle in ``[0, pi]``: ``omega dt`` in discrete time, else
``2 atan(omega/omega_0)``, in which infinity has a place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ._response import FloatArray, Response, StateMatrices
from ._scalings import central
from .blocks import ComplexArray
from .upper import Padding, UpperBound, bound_of, certificate

_MOST = 600  # intervals
_NARROW = 1e-9  # rad of the angle
_ON_BOUNDARY = 1e-6
_SAMPLES = 6  # on either side of a frequency


@dataclass(frozen=True)
class Proof:
    """What was proved: the level, whether it holds throughout, and points seen on the way."""

    holds: bool
    peak: float
    intervals: int
    omega: FloatArray
    bounds: tuple[UpperBound, ...]


def prove(
    response: Response,
    padding: Padding,
    peak: float,
    tolerance: float,
    *,
    fixed: float | None = None,
) -> Proof:
    """Prove that the upper bound is nowhere above ``peak (1 + tolerance)``, or raise `peak`.

    Parameters
    ----------
    response : Response
        Of a state-space system.
    padding : Padding
        Structure.
    peak : float
        Largest upper bound that is known.
    tolerance : float
        Share by which the bound may be exceeded between the points.
    fixed : float, optional
        Level to prove; the proof ends where it does not hold.
    """
    m = response.matrices
    if m is None:
        return Proof(False, peak, 0, np.zeros(0), ())
    A, B, C, D = _square(m, padding)
    poles = np.abs(response.poles)
    centre = float(np.exp(np.mean(np.log(poles)))) if poles.size and poles.min() > 0.0 else 1.0
    todo = [(0.0, math.pi)]
    omegas: list[float] = []
    bounds: list[UpperBound] = []
    count = 0
    while todo and count < _MOST:
        count += 1
        low, high = todo.pop()
        angle = 0.5 * (low + high)
        omega = float(_frequencies(np.array([angle]), response.dt, centre)[0])
        M = response.at(np.array([omega]))[0]
        bound = bound_of(M, padding)
        omegas.append(omega)
        bounds.append(bound)
        peak = max(peak, bound.value)
        level = peak * (1.0 + tolerance) if fixed is None else fixed
        if bound.value >= level > 0.0:
            break
        if level == 0.0:
            return Proof(len(A) == 0, peak, count, np.array(omegas), tuple(bounds))
        full = padding.fill(M)
        size = float(np.linalg.norm(full, 2))
        scale_D, scale_G = central(full / size, padding, bound.D, bound.G / size, level / size)
        scale_G = scale_G * size
        if not certificate(full, scale_D, scale_G)[0] < level:
            scale_D, scale_G = bound.D, bound.G
        edges = _crossings(A, B, C, D, scale_D, scale_G, level, response.dt)
        if response.dt <= 0.0:
            edges = 2.0 * np.arctan(edges / centre)
        left = float(np.max(edges[edges <= angle], initial=0.0))
        right = float(np.min(edges[edges >= angle], initial=math.pi))
        left, right = _sampled(
            response, padding, centre, (left, angle, right), (scale_D, scale_G, level)
        )
        if left - low > _NARROW:
            todo.append((low, left))
        if high - right > _NARROW:
            todo.append((right, high))
    return Proof(not todo, peak, count, np.array(omegas), tuple(bounds))


def _frequencies(angles: FloatArray, dt: float, centre: float) -> FloatArray:
    """Frequencies of the angles."""
    return angles / dt if dt > 0.0 else centre * np.tan(0.5 * angles)


def _sampled(
    response: Response,
    padding: Padding,
    centre: float,
    interval: tuple[float, float, float],
    scalings: tuple[ComplexArray, ComplexArray, float],
) -> tuple[float, float]:
    """Shorten an interval to what samples of the inequality confirm.

    An eigenvalue that rounding moves off the boundary would make the interval too long.
    """
    left, angle, right = interval
    D, G, level = scalings
    angles = np.concatenate(
        (
            np.linspace(left, angle, _SAMPLES + 2)[1:-1],
            np.linspace(angle, right, _SAMPLES + 2)[1:-1],
        )
    )
    M = padding.fill(response.at(_frequencies(angles, response.dt, centre)))
    M_h = np.conj(np.swapaxes(M, 1, 2))
    form = M_h @ D @ M + 1j * (G @ M - M_h @ G) - level**2 * D
    root = np.linalg.inv(np.linalg.cholesky(D))
    form = root @ (0.5 * (form + np.conj(np.swapaxes(form, 1, 2)))) @ root.conj().T
    bad = angles[np.linalg.eigvalsh(form)[:, -1] > 1e-9 * level**2]
    left = float(np.max(bad[bad < angle], initial=left))
    return left, float(np.min(bad[bad > angle], initial=right))


def _square(m: StateMatrices, padding: Padding) -> StateMatrices:
    """Return the system filled up to square blocks."""
    B = np.zeros((len(m.A), padding.n))
    C = np.zeros((padding.n, len(m.A)))
    B[:, padding.columns], C[padding.rows] = m.B, m.C
    return StateMatrices(m.A, B, C, padding.fill(m.D.astype(complex)).real)


def _crossings(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    D: FloatArray,
    scale_D: ComplexArray,
    scale_G: ComplexArray,
    level: float,
    dt: float,
) -> FloatArray:
    """Frequencies (discrete: angles) at which the inequality becomes singular.

    What is near the boundary counts as on it: an interval too short is safe, one too long is
    not.
    """
    from scipy.linalg import eigvals

    n, k = B.shape
    P = np.block([[scale_D, -1j * scale_G], [1j * scale_G, -(level**2) * scale_D]])
    T = np.block([[C, D], [np.zeros((k, n)), np.eye(k)]])
    form = T.T @ P @ T
    Q, S, R = form[:n, :n], form[:n, n:], form[n:, n:]
    weight = 1.0 / max(float(np.abs(R).max()), 1e-300)  # the form is known up to a factor
    Q, S, R = Q * weight, S * weight, R * weight
    O_nk, O_n, O_k = np.zeros((n, k)), np.zeros((n, n)), np.zeros((k, k))
    eye = np.eye(n)
    if dt > 0.0:
        left = np.block([[A, O_n, B], [Q, -eye, S], [S.conj().T, O_nk.T, R]])
        right = np.block([[eye, O_n, O_nk], [O_n, -A.T, O_nk], [O_nk.T, -B.T, O_k]])
    else:
        left = np.block([[A, O_n, B], [-Q, -A.T, -S], [S.conj().T, B.T, R]])
        right = np.block([[eye, O_n, O_nk], [O_n, eye, O_nk], [O_nk.T, O_nk.T, O_k]])
    values = eigvals(left, right)
    values = values[np.isfinite(values)]
    if dt > 0.0:
        on = np.abs(np.abs(values) - 1.0) <= _ON_BOUNDARY
        return np.abs(np.angle(values[on]))
    on = np.abs(values.real) <= _ON_BOUNDARY * np.abs(values) + 1e-12
    return np.abs(values[on].imag)
