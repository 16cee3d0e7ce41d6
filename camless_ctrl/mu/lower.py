"""Lower bound of the structured singular value: a perturbation that destabilises.

Every bound is the reciprocal size of a perturbation with ``det(I - M Delta) = 0``, which is
verified. The search is a local one from several starts, see `camless_ctrl.mu._ascent`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant._checks import whole

from ._ascent import Problem, State, ascend, evaluate
from .blocks import BlockStructure, ComplexArray, Delta, FullBlock, is_real
from .upper import checked

FloatArray = NDArray[np.float64]
DETERMINANT = 1e-6  # largest relative |det(I - M Delta)| of a destabilising perturbation

_REAL = 1e-11  # relative imaginary part up to which an eigenvalue counts as real


@dataclass(frozen=True)
class LowerBound:
    """Lower bound of the structured singular value.

    Attributes
    ----------
    value : float
        The bound, ``1/|Delta|``; 0 if no destabilising perturbation was found.
    delta : Delta or None
        The perturbation, with ``det(I - M Delta) = 0``.
    omega : float
        Frequency, rad per time unit; NaN for a matrix.
    determinant : float
        ``|det(I - M Delta)|`` over the product of ``max(1, |e|)`` of the eigenvalues ``e`` of
        ``M Delta``; at most `DETERMINANT`.
    """

    value: float
    delta: Delta | None
    omega: float = float("nan")
    determinant: float = float("nan")

    def __float__(self) -> float:
        return self.value


def mu_lower(
    M: ArrayLike, structure: BlockStructure, *, starts: int = 24, steps: int = 60, seed: int = 0
) -> LowerBound:
    """Lower bound of the structured singular value of a matrix.

    Parameters
    ----------
    M : array_like (inputs, outputs)
        Matrix from what the perturbation gives to what it takes.
    structure : BlockStructure
        Structure of the perturbation.
    starts : int
        Number of random starts, beside the one that the upper bound suggests.
    steps : int
        Most steps of a search.
    seed : int
        Seed of the starts.
    """
    from .upper import mu_upper

    matrix = checked(M, structure)
    whole("starts", starts, 1, 10000)
    whole("steps", steps, 1, 10000)
    hint = hinted(structure, matrix[None], mu_upper(matrix, structure).vector[None])
    D = np.concatenate((hint, random_starts(structure, starts, seed)))
    omega = np.full(len(D), np.nan)
    problem = standard(structure)
    state = ascend(problem, omega, np.repeat(matrix[None], len(D), axis=0), D, steps)
    return best_of(problem, state)


def standard(structure: BlockStructure) -> Problem:
    """Return the problem in which the size of every block is sought."""
    return Problem(structure, np.ones(len(structure), dtype=bool))


def random_starts(structure: BlockStructure, count: int, seed: int) -> ComplexArray:
    """Return `count` perturbations (count, outputs, inputs), half of them with reals at an end."""
    seeds = np.random.default_rng(seed).integers(2**31, size=count)
    result = np.array([structure.random(int(s)).matrix() for s in seeds])
    for block, (rows, columns) in zip(structure.blocks, structure.slices(), strict=True):
        if is_real(block):
            result[::2, rows, columns] = np.sign(result[::2, rows, columns].real)
    return result


def hinted(structure: BlockStructure, M: ComplexArray, w: ComplexArray) -> ComplexArray:
    """Return the perturbations that best turn ``M w`` into the direction of `w`.

    Parameters
    ----------
    structure : BlockStructure
        Structure.
    M : ndarray (B, inputs, outputs)
        Matrices.
    w : ndarray (B, outputs)
        Directions in which the upper bound is tight.
    """
    z = np.einsum("bij,bj->bi", M, w)
    D = np.zeros((len(M), structure.outputs, structure.inputs), dtype=complex)
    for block, (rows, columns) in zip(structure.blocks, structure.slices(), strict=True):
        a, b = w[:, rows], z[:, columns]
        if isinstance(block, FullBlock):
            norm = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
            outer = a[:, :, None] * b.conj()[:, None, :]
            D[:, rows, columns] = outer / np.maximum(norm, 1e-300)[:, None, None]
            continue
        product = np.einsum("bi,bi->b", b.conj(), a)
        if is_real(block):
            value: ComplexArray = np.where(product.real >= 0.0, 1.0, -1.0).astype(complex)
        else:
            value = np.exp(1j * np.angle(product))
        D[:, rows, columns] = value[:, None, None] * np.eye(block.inputs)
    return D


def best_of(problem: Problem, state: State) -> LowerBound:
    """Return the best verified perturbation of a state of the search."""
    promise = state.value.real - np.abs(state.value.imag)
    best = LowerBound(0.0, None, float(state.omega[0]))
    for k in np.argsort(-promise):
        if state.value[k].real <= best.value:
            continue
        bound = verified(problem, float(state.omega[k]), state.M[k], state.D[k])
        if bound.value > best.value:
            best = bound
        elif promise[k] <= best.value:
            break
    return best


def verified(problem: Problem, omega: float, M: ComplexArray, D: ComplexArray) -> LowerBound:
    """Return the bound of one normalised perturbation after its eigenvalue is made real.

    Blocks whose size is not sought must stay within 1.
    """
    slope = np.array([10.0])
    at = np.array([omega])
    D = D.copy()
    for _ in range(12):
        state = evaluate(problem, at, M[None], D[None], slope)
        value = complex(state.value[0])
        if value.real <= 0.0 or not np.isfinite(value):
            return LowerBound(0.0, None, omega)
        if abs(value.imag) <= 1e-13 * abs(value):
            break
        _turn(problem, state, D)
    # real blocks alone cannot turn it at most frequencies: a small remainder does not count as none
    if abs(value.imag) > _REAL * abs(value):
        return LowerBound(0.0, None, omega)
    f, c = problem.selected()
    size = value.real
    raw = D * (c + f / size)
    delta = problem.structure.delta(_of_rank_one(problem.structure, raw, state.x[0]))
    held = [n for n, free in zip(problem.structure.names, problem.free, strict=True) if not free]
    sizes = delta.sizes
    if any(sizes[name] > 1.0 + 1e-9 for name in held):
        return LowerBound(0.0, None, omega)
    determinant = relative_determinant(M, delta)
    largest = max(sizes[name] for name in sizes if name not in held)
    if not determinant <= DETERMINANT or largest == 0.0:
        return LowerBound(0.0, None, omega, determinant)
    return LowerBound(1.0 / largest, delta, omega, determinant)


def relative_determinant(M: ComplexArray, delta: Delta) -> float:
    """``|det(I - M Delta)|`` relative to the sizes of the eigenvalues of ``M Delta``."""
    values = np.linalg.eigvals(M @ delta.matrix())
    return float(np.prod(np.abs(1.0 - values) / np.maximum(1.0, np.abs(values))))


def _turn(problem: Problem, state: State, D: ComplexArray) -> None:
    """Take one Newton step of least size that makes the eigenvalue real; `D` is changed."""
    f, c = problem.selected()
    value = complex(state.value[0])
    x = np.asarray(state.x[0] * (f + value * c), dtype=complex)
    k = state.gain[0]
    moves, total = [], 0.0
    s = problem.structure
    for block, (rows, columns) in zip(s.blocks, s.slices(), strict=True):
        if isinstance(block, FullBlock):
            move = np.asarray(1j * np.outer(k[rows].conj(), x[columns].conj()), dtype=complex)
            effect = float(np.linalg.norm(k[rows]) ** 2 * np.linalg.norm(x[columns]) ** 2)
        else:
            slope = complex(k[rows] @ x[columns])
            if is_real(block):
                room = max(1.0 - abs(D[rows.start, columns.start].real), 0.0) + 1e-6
                number: complex = room * slope.imag
                effect = room * slope.imag**2
            else:
                number = 1j * slope.conjugate()
                effect = abs(slope) ** 2
            move = np.asarray(number * np.eye(block.inputs), dtype=complex)
        moves.append((rows, columns, move))
        total += effect
    if total <= 1e-14 * abs(value) ** 2:
        return
    for rows, columns, move in moves:
        D[rows, columns] -= value.imag / total * move
    for free, (rows, columns) in zip(problem.free, s.slices(), strict=True):
        if not free:
            D[rows, columns] /= max(float(np.linalg.norm(D[rows, columns], 2)), 1.0)


def _of_rank_one(structure: BlockStructure, raw: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Return the perturbation with full blocks of rank one that act on `x` alike.

    With ``x = M Delta x``, a full block may be replaced by ``Delta_i x_i x_i^H/|x_i|^2``, which
    is not larger.
    """
    result = raw.copy()
    for block, (rows, columns) in zip(structure.blocks, structure.slices(), strict=True):
        part = x[columns]
        norm = float(np.linalg.norm(part))
        if isinstance(block, FullBlock) and norm > 1e-12 * float(np.linalg.norm(x)):
            result[rows, columns] = np.outer(raw[rows, columns] @ part, part.conj()) / norm**2
        elif isinstance(block, FullBlock):
            result[rows, columns] = 0.0
    return result


def sweep(
    problem: Problem, omega: FloatArray, M: ComplexArray, w: ComplexArray, seed: int
) -> State:
    """Search at every frequency, then once more from what the neighbours found.

    Parameters
    ----------
    problem : Problem
        Structure, and the blocks whose size is sought.
    omega : ndarray (N,)
        Frequencies.
    M : ndarray (N, inputs, outputs)
        Matrices.
    w : ndarray (N, outputs)
        Directions in which the upper bounds are tight.
    seed : int
        Seed of the random starts.

    Returns
    -------
    State
        The best perturbation of each frequency.
    """
    structure = problem.structure
    N = len(M)
    starts = np.concatenate((hinted(structure, M, w), random_starts(structure, N, seed)))
    state = ascend(problem, np.tile(omega, 2), np.tile(M, (2, 1, 1)), starts, 12)
    best = _better(state, N)
    order = np.arange(N)
    for shift in (1, -1):
        neighbour = np.clip(order + shift, 0, N - 1)
        again = ascend(problem, omega, M, best.D[neighbour], 6)
        joined = State(*(np.concatenate((getattr(best, n), getattr(again, n))) for n in _FIELDS))
        best = _better(joined, N)
    return best


_FIELDS = tuple(State.__dataclass_fields__)


def _better(state: State, N: int) -> State:
    """Return the better one of two states for each of N matrices."""
    promise = (state.value.real - 10.0 * np.abs(state.value.imag)).reshape(2, N)
    index = np.argmax(promise, axis=0) * N + np.arange(N)
    return replace(state, **{name: getattr(state, name)[index] for name in _FIELDS})
