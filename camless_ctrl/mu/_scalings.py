"""Full D and G scalings of repeated scalars, by the method of centres (Boyd, El Ghaoui, 1993).

For a level ``c = beta^2`` the scalings are moved to the centre of the set in which
``F = c D - M^H D M - j (G M - M^H G)`` and D are positive definite; then the level is lowered
towards the value that they certify, and so on. Every iterate certifies a bound.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .blocks import ComplexArray, FullBlock, is_real

if TYPE_CHECKING:
    from .upper import Padding

FloatArray = NDArray[np.float64]
_ROUNDS, _NEWTON_STEPS = 30, 12
_SHARE = 0.1  # of the old level in the new one
_SMALL = 1e-8  # weight that keeps G bounded where it does not matter


def improve(
    M: ComplexArray, padding: Padding, D: ComplexArray, G: ComplexArray, tolerance: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return scalings at least as good as the given ones, for M of norm about one.

    Parameters
    ----------
    M : ndarray (n, n)
        Matrix, filled up.
    padding : Padding
        Its structure.
    D, G : ndarray (n, n)
        Scalings to start from.
    tolerance : float
        Relative improvement of the bound at which the search ends.
    """
    basis_D, basis_G = _basis(padding)
    p = np.concatenate((_coordinates(basis_D, D), _coordinates(basis_G, G)))
    m = len(basis_D)
    trace = np.concatenate((np.trace(basis_D, axis1=1, axis2=2).real, np.zeros(len(basis_G))))
    p = p * padding.n / (trace @ p)
    M_h = M.conj().T
    squeezed = M_h @ basis_D @ M
    turned = 1j * (basis_G @ M - M_h @ basis_G)
    best = _level(p, m, basis_D, squeezed, turned)
    best_p, quiet = p, 0
    level = best * 1.05 + 1e-9
    for _ in range(_ROUNDS):
        F_k = np.concatenate((level * basis_D - squeezed, -turned))
        p = _centre(p, m, F_k, basis_D, trace)
        now = _level(p, m, basis_D, squeezed, turned)
        quiet = quiet + 1 if now > best * (1.0 - tolerance) else 0
        if now < best:
            best, best_p = now, p
        if quiet >= 2 or best < 1e-10:
            break
        level = (1.0 - _SHARE) * max(now, 0.0) + _SHARE * level + 1e-12
    return np.tensordot(best_p[:m], basis_D, 1), _sum(best_p[m:], basis_G, padding.n)


def central(
    M: ComplexArray, padding: Padding, D: ComplexArray, G: ComplexArray, level: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return the scalings at the centre of those that certify ``beta = level``.

    They hold over a wider range of frequencies than the scalings of the least bound.
    """
    basis_D, basis_G = _basis(padding)
    p = np.concatenate((_coordinates(basis_D, D), _coordinates(basis_G, G)))
    m = len(basis_D)
    trace = np.concatenate((np.trace(basis_D, axis1=1, axis2=2).real, np.zeros(len(basis_G))))
    p = p * padding.n / (trace @ p)
    M_h = M.conj().T
    F_k = np.concatenate(
        (
            level**2 * basis_D - M_h @ basis_D @ M,
            -1j * (basis_G @ M - M_h @ basis_G),
        )
    )
    p = _centre(p, m, F_k, basis_D, trace)
    return np.tensordot(p[:m], basis_D, 1), _sum(p[m:], basis_G, padding.n)


def _centre(
    p: FloatArray, m: int, F_k: ComplexArray, basis_D: ComplexArray, trace: FloatArray
) -> FloatArray:
    """Newton's method for the centre of the set at one level, the trace of D held."""
    count, n = len(p), len(basis_D[0])
    weight = np.zeros(count)
    weight[m:] = _SMALL
    flat_F, flat_D = F_k.reshape(count, -1), basis_D.reshape(m, -1)
    system = np.zeros((count + 1, count + 1))  # the last row holds the trace of D
    system[count, :count] = system[:count, count] = trace
    right = np.zeros(count + 1)
    for _ in range(_NEWTON_STEPS):
        A = _normalised((p @ flat_F).reshape(n, n), F_k)
        E = _normalised((p[:m] @ flat_D).reshape(n, n), basis_D)
        if A is None or E is None:
            return p
        gradient = weight * p - np.einsum("kii->k", A).real
        gradient[:m] -= np.einsum("kii->k", E).real
        a, e = (X.reshape(len(X), -1).view(float) for X in (A, E))
        hessian = a @ a.T
        hessian[:m, :m] += e @ e.T
        hessian[np.arange(count), np.arange(count)] += weight
        system[:count, :count] = hessian
        right[:count] = -gradient
        try:
            step = np.linalg.solve(system, right)[:count]
        except np.linalg.LinAlgError:
            return p
        decrement = float(np.sqrt(max(-gradient @ step, 0.0)))
        p = p + step / (1.0 + decrement)
        if decrement < 0.3:
            break
    return p


def _normalised(total: ComplexArray, parts: ComplexArray) -> ComplexArray | None:
    """``L^-1 part L^-H`` with ``total = L L^H``; None if it is not positive definite."""
    try:
        L = np.linalg.cholesky(total)
    except np.linalg.LinAlgError:
        return None
    inverse = np.linalg.inv(L)
    return np.ascontiguousarray(inverse @ parts @ inverse.conj().T)


def _level(
    p: FloatArray, m: int, basis_D: ComplexArray, squeezed: ComplexArray, turned: ComplexArray
) -> float:
    """Level ``beta^2`` that scalings certify."""
    from scipy.linalg import eigh

    form = np.tensordot(p[:m], squeezed, 1) + _sum(p[m:], turned, squeezed.shape[1])
    D = np.tensordot(p[:m], basis_D, 1)
    return float(eigh(0.5 * (form + form.conj().T), D, eigvals_only=True)[-1])


def _basis(padding: Padding) -> tuple[ComplexArray, ComplexArray]:
    """Hermitian matrices that span D and G."""
    n, start = padding.n, 0
    D, G = [], []
    for block, size in zip(padding.structure.blocks, padding.sizes, strict=True):
        if isinstance(block, FullBlock):
            unit = np.zeros((n, n), dtype=complex)
            unit[start : start + size, start : start + size] = np.eye(size)
            D.append(unit)
        else:
            entries = _hermitian(n, range(start, start + size))
            D += entries
            if is_real(block):
                G += entries
        start += size
    return np.array(D), np.array(G, dtype=complex).reshape(-1, n, n)


def _hermitian(n: int, places: range) -> list[ComplexArray]:
    """Orthogonal Hermitian matrices with entries at the places."""
    result = []
    for i in places:
        for j in places:
            unit = np.zeros((n, n), dtype=complex)
            if i == j:
                unit[i, i] = 1.0
            elif i < j:
                unit[i, j] = unit[j, i] = np.sqrt(0.5)
            else:
                unit[i, j], unit[j, i] = 1j * np.sqrt(0.5), -1j * np.sqrt(0.5)
            result.append(unit)
    return result


def _coordinates(basis: ComplexArray, matrix: ComplexArray) -> FloatArray:
    """Coordinates of a matrix in an orthogonal basis."""
    if len(basis) == 0:
        return np.zeros(0)
    products = np.einsum("kij,ij->k", basis.conj(), matrix).real
    return np.asarray(products / np.einsum("kij,kij->k", basis.conj(), basis).real)


def _sum(p: FloatArray, basis: ComplexArray, n: int) -> ComplexArray:
    return np.tensordot(p, basis, 1) if len(p) else np.zeros((n, n), dtype=complex)
