"""Search for the smallest destabilising perturbation, for many matrices at once.

The perturbation is written ``Delta = D (S_c + S_f/lambda)`` with a normalised ``|D| <= 1``: the
columns that ``S_f`` selects belong to the blocks whose size is sought, those of ``S_c`` to
blocks held at ``|Delta| <= 1``. Then ``det(I - M Delta) = 0`` is the eigenvalue problem

    ``M D S_f x = lambda (I - M D S_c) x``,

and the largest real ``lambda`` over all D is the structured singular value (the skewed one, if
``S_c`` is not zero). With the left eigenvector ``y``, scaled to ``y^H (I - M D S_c) x = 1``,

    ``d lambda = y^H M dD (S_f + lambda S_c) x``.

Each step maximises the real part of this linear form over the whole set ``|D| <= 1`` while its
imaginary part takes ``lambda`` to the real axis. Complex and full blocks become aligned with
``y^H M`` and ``x``, real ones go to an end or, one of them, between: what Young and Doyle's
power iteration (1990) does, with exact eigenvectors instead of iterated ones, with an exact
multiplier, and with a line search that never accepts a worse perturbation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .blocks import BlockStructure, ComplexArray, FullBlock, is_real

FloatArray = NDArray[np.float64]
_LARGEST_SLOPE = 200.0  # of the multiplier, in the merit function
_STEPS = (1.0, 0.5, 0.2, 0.05)
_BISECTIONS = 36


@dataclass(frozen=True)
class Problem:
    """Structure and the blocks whose size is sought.

    Parameters
    ----------
    structure : BlockStructure
        The blocks.
    free : ndarray of bool (blocks,)
        Blocks whose size is sought; the others are held at 1.
    """

    structure: BlockStructure
    free: NDArray[np.bool_]

    @property
    def plain(self) -> bool:
        """Whether the size of every block is sought."""
        return bool(self.free.all())

    def selected(self) -> tuple[FloatArray, FloatArray]:
        """Diagonals of ``S_f`` and ``S_c``, (inputs of the perturbation,)."""
        inputs = [block.inputs for block in self.structure.blocks]
        f = np.repeat(self.free.astype(float), inputs)
        return f, 1.0 - f


@dataclass
class State:
    """Where the search stands: for each of B problems a perturbation and its eigenvalue."""

    omega: FloatArray  # (B,)
    M: ComplexArray  # (B, inputs, outputs) of the perturbation
    D: ComplexArray  # (B, outputs, inputs)
    value: ComplexArray  # (B,) eigenvalue lambda
    x: ComplexArray  # (B, inputs) right eigenvector
    y: ComplexArray  # (B, inputs) y^H, left eigenvector
    gain: ComplexArray  # (B, outputs) y^H M: what a change of the perturbation meets

    def row(self, k: int) -> State:
        """Return one of the problems."""
        return _take(self, np.array([k]))


Matrices = Callable[[FloatArray], ComplexArray]


def evaluate(
    problem: Problem, omega: FloatArray, M: ComplexArray, D: ComplexArray, slope: FloatArray
) -> State:
    """Return the eigenvalue of largest merit ``Re - slope |Im|`` and its eigenvectors."""
    f, c = problem.selected()
    MD = M @ D
    K = MD * f
    if c.any():
        # where this is singular lambda is infinite: the blocks held at 1 destabilise alone
        n = M.shape[1]
        W = np.asarray(np.linalg.inv((1.0 + 1e-14) * np.eye(n) - MD * c), dtype=complex)
        K = W @ K
    values, X = np.linalg.eig(K)
    merit = values.real - slope[:, None] * np.abs(values.imag)
    best = np.argmax(merit, axis=1)
    rows = np.arange(len(M))
    left = _left_vectors(K, X, values, best)
    x = X[rows, :, best]
    # Of a defective eigenvalue the product is zero and its slope infinite: the vector as it is
    # still points upwards, and all that is found is verified.
    product = np.einsum("bi,bi->b", left, x)
    y = left / np.where(product == 0.0, 1.0, product)[:, None]
    if c.any():
        y = np.einsum("bi,bij->bj", y, W)
    return State(omega, M, D, values[rows, best], x, y, np.einsum("bi,bij->bj", y, M))


def _left_vectors(
    K: ComplexArray, X: ComplexArray, values: ComplexArray, best: NDArray[np.intp]
) -> ComplexArray:
    """Left eigenvectors (conjugated) that belong to the chosen eigenvalues."""
    n = K.shape[1]
    unit = np.zeros((len(K), n, 1), dtype=complex)
    unit[np.arange(len(K)), best, 0] = 1.0
    scale = 1e-13 * (1.0 + np.abs(X).max(axis=(1, 2)))
    regular = X + scale[:, None, None] * np.eye(n)  # a defective K has dependent eigenvectors
    return np.linalg.solve(np.swapaxes(regular, 1, 2), unit)[..., 0]


def linear_step(
    problem: Problem,
    state: State,
    omega_slope: ComplexArray | None,
    bounds: tuple[FloatArray, FloatArray] | None,
    reach: FloatArray,
    omega_reach: FloatArray,
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Return the best perturbation of the linear form, its frequency and the multiplier.

    Parameters
    ----------
    omega_slope : ndarray (B,) or None
        ``d lambda/d omega``, if the frequency is free.
    bounds : pair of ndarray (B,) or None
        Bounds on the frequency.
    reach, omega_reach : ndarray (B,)
        How far a real scalar and the frequency may move, in [0, 2]: 2 is everywhere.
    """
    f, c = problem.selected()
    s = problem.structure
    xs = state.x * (f + state.value[:, None] * c)
    B = len(state.x)
    coefficients, low, high = [], [], []  # real degrees of freedom
    radius = np.zeros(B)  # of the disc that the complex ones span
    for block, (rows, columns) in zip(s.blocks, s.slices(), strict=True):
        k, z = state.gain[:, rows], xs[:, columns]
        if isinstance(block, FullBlock):
            radius += np.linalg.norm(k, axis=1) * np.linalg.norm(z, axis=1)
        else:
            slope = np.einsum("bi,bi->b", k, z)
            if is_real(block):
                now = state.D[:, rows.start, columns.start].real
                coefficients.append(slope)
                low.append(np.maximum(-1.0, now - reach))
                high.append(np.minimum(1.0, now + reach))
            else:
                radius += np.abs(slope)
    now_linear = np.einsum("bi,bij,bj->b", state.gain, state.D, xs)
    wanted = now_linear.imag - state.value.imag  # imaginary part that the form should take
    if omega_slope is not None and bounds is not None:
        coefficients.append(omega_slope)
        far = 0.5 * omega_reach * (bounds[1] - bounds[0])
        low.append(np.maximum(bounds[0] - state.omega, -far))
        high.append(np.minimum(bounds[1] - state.omega, far))
    g = np.stack(coefficients, axis=1) if coefficients else np.zeros((B, 0), dtype=complex)
    lo = np.stack(low, axis=1) if low else np.zeros((B, 0))
    hi = np.stack(high, axis=1) if high else np.zeros((B, 0))
    first, last, share = _multiplier(g, lo, hi, radius, wanted)
    real_first, real_last = _ends(g, lo, hi, first), _ends(g, lo, hi, last)
    real = (1.0 - share)[:, None] * real_first + share[:, None] * real_last
    angle = (1.0 - share) * first + share * last  # of the complex part, equal to both in the limit
    turn = np.exp(1j * angle)
    D = np.zeros_like(state.D)
    j = 0
    for block, (rows, columns) in zip(s.blocks, s.slices(), strict=True):
        k, z = state.gain[:, rows], xs[:, columns]
        if isinstance(block, FullBlock):
            norm = np.linalg.norm(k, axis=1) * np.linalg.norm(z, axis=1)
            outer = k.conj()[:, :, None] * z.conj()[:, None, :]
            D[:, rows, columns] = (turn / np.maximum(norm, 1e-300))[:, None, None] * outer
            continue
        if is_real(block):
            value: ComplexArray = real[:, j].astype(complex)
            j += 1
        else:
            slope = np.einsum("bi,bi->b", k, z)
            value = turn * slope.conj() / np.maximum(np.abs(slope), 1e-300)
        D[:, rows, columns] = value[:, None, None] * np.eye(block.inputs)
    omega = state.omega + real[:, j] if omega_slope is not None else state.omega
    return D, omega, np.tan(np.clip(angle, -1.5707, 1.5707))


def _ends(g: ComplexArray, lo: FloatArray, hi: FloatArray, angle: FloatArray) -> FloatArray:
    """Ends of the intervals that maximise the form in the direction of `angle`."""
    return np.where((g * np.exp(-1j * angle)[:, None]).real > 0.0, hi, lo)


def _multiplier(
    g: ComplexArray, lo: FloatArray, hi: FloatArray, radius: FloatArray, wanted: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bisect the angle in which the best form has the imaginary part `wanted`.

    The set of values of the form is convex (a zonotope and a disc), so that the imaginary part
    of its support point rises with the angle. Returns the two last angles and the share of the
    second one.
    """
    first = np.full(len(g), -0.5 * np.pi)
    last = -first

    def imaginary(angle: FloatArray) -> FloatArray:
        real = np.einsum("bi,bi->b", g.imag, _ends(g, lo, hi, angle))
        return real + radius * np.sin(angle)

    for _ in range(_BISECTIONS):
        middle = 0.5 * (first + last)
        below = imaginary(middle) < wanted
        first = np.where(below, middle, first)
        last = np.where(below, last, middle)
    i_first, i_last = imaginary(first), imaginary(last)
    gap = i_last - i_first
    share = np.where(gap > 0.0, (wanted - i_first) / np.where(gap > 0.0, gap, 1.0), 0.0)
    return first, last, np.clip(share, 0.0, 1.0)


def ascend(
    problem: Problem,
    omega: FloatArray,
    M: ComplexArray,
    D: ComplexArray,
    steps: int,
    *,
    matrices: Matrices | None = None,
    bounds: tuple[FloatArray, FloatArray] | None = None,
) -> State:
    """Improve perturbations `D` by `steps` steps; with `matrices` the frequency is free too."""
    slope = np.ones(len(M))
    state = evaluate(problem, omega, M, D, slope)
    reach, omega_reach = np.full(len(M), 2.0), np.full(len(M), 1.0)
    active = np.arange(len(M))
    for _ in range(steps):
        part = _take(state, active)
        limits = None
        rate = None
        if matrices is not None and bounds is not None:
            limits = bounds[0][active], bounds[1][active]
            rate = _omega_slope(problem, part, matrices, limits)
        D_new, omega_new, tangent = linear_step(
            problem, part, rate, limits, reach[active], omega_reach[active]
        )
        slope[active] = np.minimum(
            np.maximum(0.5 * slope[active], 1.0 + 2.0 * np.abs(tangent)), _LARGEST_SLOPE
        )
        merit = part.value.real - slope[active] * np.abs(part.value.imag)
        waiting = np.arange(len(active))
        moved = np.zeros(len(active), dtype=bool)
        gained = np.zeros(len(active))
        for step in _STEPS:
            w = part.omega[waiting]
            if limits is not None:
                w = w + step * (omega_new[waiting] - w)
                w = np.clip(w, limits[0][waiting], limits[1][waiting])
            trial_D = (1.0 - step) * part.D[waiting] + step * D_new[waiting]
            trial_M = part.M[waiting] if matrices is None else matrices(w)
            trial = evaluate(problem, w, trial_M, trial_D, slope[active[waiting]])
            new = trial.value.real - slope[active[waiting]] * np.abs(trial.value.imag)
            gain = new - merit[waiting]
            better = gain > 1e-12 * np.abs(merit[waiting])
            _put(state, active[waiting[better]], _take(trial, np.flatnonzero(better)))
            moved[waiting[better]] = True
            gained[waiting[better]] = gain[better]
            taken = active[waiting[better]]
            reach[taken] = np.minimum(reach[taken] * (2.0 if step == 1.0 else 0.5), 2.0)
            omega_reach[taken] = np.minimum(
                omega_reach[taken] * (2.0 if step == 1.0 else 0.4 * step + 0.1), 2.0
            )
            waiting = waiting[~better]
            if waiting.size == 0:
                break
        reach[active[~moved]] *= 0.3
        omega_reach[active[~moved]] *= 0.1
        settled = moved & (gained <= 1e-9 * np.abs(merit))
        active = active[~settled & ((reach[active] > 1e-3) | (omega_reach[active] > 1e-8))]
        if active.size == 0:
            break
    return state


def _omega_slope(
    problem: Problem, state: State, matrices: Matrices, bounds: tuple[FloatArray, FloatArray]
) -> ComplexArray:
    """``d lambda/d omega``, from central differences of M."""
    h = 1e-5 * np.maximum(np.abs(state.omega), bounds[1] - bounds[0])
    high = np.minimum(state.omega + h, bounds[1])
    low = np.maximum(state.omega - h, bounds[0])
    dM = matrices(high) - matrices(low)
    width = np.maximum(high - low, 1e-300)
    f, c = problem.selected()
    xs = state.x * (f + state.value[:, None] * c)
    return np.einsum("bi,bij,bjk,bk->b", state.y, dM, state.D, xs) / width


def _take(state: State, index: NDArray[np.intp]) -> State:
    return State(*(getattr(state, name)[index] for name in State.__dataclass_fields__))


def _put(state: State, index: NDArray[np.intp], part: State) -> None:
    for name in State.__dataclass_fields__:
        getattr(state, name)[index] = getattr(part, name)
