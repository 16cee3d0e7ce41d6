"""Linear program for the tightest squared magnitude of a given order.

The frequency axis is `s` = (w/a)^2 from 0 to infinity, `w` the frequency or, in discrete time,
tan(omega dt/2) (the bilinear map), and `a` a frequency amid the grid. With u = s/(1 + s) and
v = 1 - u (so that x = v - u is the cosine of the bilinear map) numerator P and denominator Q are

    P = sum_j p_j u^j v^(n-j),    Q = sum_j q_j u^j v^(n-j),    |W|^2 = P/Q.

This basis is positive and keeps its relative accuracy over decades. The least lam with
b <= P/Q <= lam b on the grid (b the squared residual) comes from differential correction
(Barrodale, Powell and Roberts, SIAM J. Numer. Anal. 9, 1972): a sequence of linear programs,
each scaled by the last solution, that converges quadratically and never gets worse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plant.kinematics import FloatArray

# |W|, over the largest residual, at every frequency: on the grid, between and beyond it.
LARGEST = 10.0
# Q >= DAMPING^2 sum_j |q_j| u^j v^(n-j), likewise P: a lower bound on the damping of roots.
DAMPING = 0.01
# The check of the whole axis grants this share of a bound; the program asks for all of it.
_SHARE = 0.5
_SEEDS = 48
_STEPS = 60
_SETTLED = 1e-4  # gain in the mean of log P/Q that is not worth another step
# Least P and Q over the last ones, at each step: within the precision and the slope's reach.
_STRIDE = 0.01
_SHORT_STRIDE = 0.3
_CUTS = 20
_STOP = 2e-6  # relative gain in lam that is not worth another step


@dataclass(frozen=True)
class SquaredMagnitude:
    """Ratio of two positive polynomials.

    Attributes
    ----------
    numerator, denominator : ndarray, shape (order + 1,)
        Coefficients p_j and q_j.
    ratio : float
        Largest P/(Q b) on the grid, where the least one is 1.
    converged : bool
        Whether the steps ended because nothing was left to gain.
    """

    numerator: FloatArray
    denominator: FloatArray
    ratio: float
    converged: bool

    @property
    def order(self) -> int:
        """Degree of the polynomials."""
        return self.numerator.size - 1

    def raised(self) -> SquaredMagnitude:
        """Return the same ratio with one degree more: both times u + v = 1."""
        p, q = (np.convolve(c, (1.0, 1.0)) for c in (self.numerator, self.denominator))
        return SquaredMagnitude(p, q, self.ratio, self.converged)


@dataclass(frozen=True)
class Problem:
    """What the squared magnitude has to meet.

    Attributes
    ----------
    u, v : ndarray, shape (points,)
        Grid.
    bound : ndarray, shape (points,)
        Squared residual over the square of the largest one, above zero.
    lowest : float
        Least |W| at every frequency, over the largest residual.
    roots : tuple of float
        Least and largest magnitude of a root in `s`.
    """

    u: FloatArray
    v: FloatArray
    bound: FloatArray
    lowest: float
    roots: tuple[float, float]


def basis(u: FloatArray, v: FloatArray, order: int) -> FloatArray:
    """Return u^j v^(order - j), shape (points, order + 1)."""
    j = np.arange(order + 1)
    return np.asarray(u)[:, None] ** j * np.asarray(v)[:, None] ** (order - j)


def constant(problem: Problem) -> SquaredMagnitude:
    """Return the tightest constant."""
    high, low = float(problem.bound.max()), float(problem.bound.min())
    return SquaredMagnitude(np.array([high]), np.ones(1), high / low, True)


def tightened(problem: Problem, start: SquaredMagnitude) -> SquaredMagnitude:
    """Return the tightest ratio of the order of `start`, which has to meet the problem."""
    axis, best = _axis(problem), start
    for _ in range(_STEPS):
        if best.ratio <= 1.0 + _STOP:
            break
        new, axis = _cut(problem, best, axis, None)
        if new is None:  # the solver or the cuts gave up: the last ratio stands
            return replace(best, converged=False)
        gain = 1.0 - new.ratio / best.ratio
        best = new if gain > 0.0 else best
        if gain <= _STOP:
            break
    else:
        return replace(best, converged=False)
    return replace(best, converged=True)


def settled(problem: Problem, start: SquaredMagnitude, limit: float) -> SquaredMagnitude:
    """Return the ratio with the least mean of log P/Q that is nowhere looser than a limit.

    The worst ratio leaves a weight free wherever another frequency is the worst. Steps are those
    of a linear program with the slope of the mean, halved until the mean falls.
    """
    axis, best = _axis(problem), start
    limit = max(limit, start.ratio * (1.0 + _STOP))
    for _ in range(_STEPS if start.order else 0):
        new, axis = _cut(problem, best, axis, limit)
        if new is None:
            break
        mean, better = _mean(problem, best), best
        for part in 0.5 ** np.arange(8):
            p = best.numerator + part * (new.numerator - best.numerator)
            q = best.denominator + part * (new.denominator - best.denominator)
            trial = _normalised(problem, p, q)
            if trial and _mean(problem, trial) < _mean(problem, better):
                better = trial
        if mean - _mean(problem, better) <= _SETTLED:
            break
        best = better
    return replace(best, converged=start.converged)


def _axis(problem: Problem) -> FloatArray:
    """Return the `s` at which the program bounds the whole axis to begin with."""
    return np.concatenate(([0.0], np.geomspace(*problem.roots, _SEEDS), [np.inf]))


def _mean(problem: Problem, magnitude: SquaredMagnitude) -> float:
    grid = basis(problem.u, problem.v, magnitude.order)
    return float(np.log((grid @ magnitude.numerator) / (grid @ magnitude.denominator)).mean())


def _normalised(problem: Problem, p: FloatArray, q: FloatArray) -> SquaredMagnitude | None:
    """Return p and q with a least ratio of 1 (None if they are not positive on the grid)."""
    grid = basis(problem.u, problem.v, p.size - 1)
    above, below = grid @ p, grid @ q
    if not ((above > 0.0).all() and (below > 0.0).all()):
        return None
    ratio = above / below / problem.bound
    return SquaredMagnitude(p / ratio.min(), q, float(ratio.max() / ratio.min()), True)


def _cut(
    problem: Problem, last: SquaredMagnitude, axis: FloatArray, limit: float | None
) -> tuple[SquaredMagnitude | None, FloatArray]:
    """Return the next ratio, positive on the whole axis, and the axis with the cuts it took."""
    for _ in range(_CUTS):
        new = _step(problem, last, axis, limit)
        cuts = _violations(problem, new) if new else []
        if not cuts:
            return new, axis
        axis = np.concatenate((axis, cuts))
    return None, axis


def _step(
    problem: Problem, last: SquaredMagnitude, axis: FloatArray, limit: float | None
) -> SquaredMagnitude | None:
    """Return the next ratio (None if the program is not solved).

    Without a limit: least t with P/(lam b) - Q <= t Q_last. With one: least mean of
    P/P_last - Q/Q_last, where P <= limit b Q.
    """
    from scipy.optimize import linprog

    n, p, q = last.order, last.numerator, last.denominator
    lam = last.ratio if limit is None else limit
    stride = _STRIDE if limit is None else _SHORT_STRIDE
    grid, whole = basis(problem.u, problem.v, n), basis(*_ends(axis), n)
    # Variables: p+, p-, q+, q- (p = p+ - p-), each scaled by its largest entry, and t.
    q_grid = grid / (grid @ q)[:, None]
    p_grid = q_grid / problem.bound[:, None]
    p_scale, q_scale = _largest(p_grid) / lam, _largest(q_grid)
    p_grid, q_grid = p_grid / p_scale, q_grid / q_scale
    p_size, q_size = whole @ np.abs(p), whole @ np.abs(q)
    p_whole = whole / p_size[:, None] / p_scale
    q_whole = whole / q_size[:, None] / q_scale
    none, d = np.zeros_like(p_whole), DAMPING**2
    low = (problem.lowest**2 * q_size / p_size)[:, None]
    high = (p_size / (LARGEST**2 * q_size))[:, None]
    rows = np.concatenate(
        (
            _row(p_grid / lam, -q_grid),
            _row(-p_grid, q_grid) / np.sqrt(lam),
            np.hstack((none, none, -(1.0 - d) * q_whole, (1.0 + d) * q_whole)),
            np.hstack((-(1.0 - d) * p_whole, (1.0 + d) * p_whole, none, none)),
            _row(-p_whole, low * q_whole),
            _row(high * p_whole, -q_whole),
            _root_rows(p, p_scale, problem.roots, 0),
            _root_rows(q, q_scale, problem.roots, 1),
            _row(-whole / (whole @ p)[:, None] / p_scale, none),
            _row(none, -whole / (whole @ q)[:, None] / q_scale),
        )
    )
    most = np.zeros(rows.shape[0])
    most[-2 * axis.size :] = -stride
    t = np.zeros((rows.shape[0], 1))
    total = np.append(_row(np.zeros((1, n + 1)), q_grid.mean(axis=0)[None, :])[0], 0.0)
    if limit is None:
        t[: problem.u.size] = -1.0
        cost = np.eye(4 * n + 5)[-1]
    else:
        slope = (grid / (grid @ p)[:, None]).mean(axis=0) / p_scale
        cost = np.append(_row(slope[None, :], -q_grid.mean(axis=0)[None, :])[0], 0.0)
    found = linprog(
        cost,
        A_ub=np.hstack((rows, t)),
        b_ub=most,
        A_eq=total[None, :],
        b_eq=[1.0],
        bounds=[(0.0, None)] * (4 * n + 4) + [(None, None) if limit is None else (0.0, 0.0)],
        method="highs",
    )
    if found.status != 0:
        return None
    plus_p, minus_p, plus_q, minus_q = np.asarray(found.x)[:-1].reshape(4, n + 1)
    return _normalised(problem, (plus_p - minus_p) / p_scale, (plus_q - minus_q) / q_scale)


def _largest(columns: FloatArray) -> FloatArray:
    """Return the largest entry of each column, and 1 for a column of zeros."""
    largest: FloatArray = columns.max(axis=0)
    return np.where(largest > 0.0, largest, 1.0)


def _row(p: FloatArray, q: FloatArray) -> FloatArray:
    return np.hstack((p, -p, q, -q))


def _root_rows(
    c: FloatArray, scale: FloatArray, roots: tuple[float, float], which: int
) -> FloatArray:
    """Rows of c_0 >= sum |c_j| low^j and c_n >= sum |c_j| high^(j-n): no root below or above."""
    n = c.size - 1
    rows = np.zeros((2, 4, n + 1))
    for row, end, weights in (
        (0, 0, roots[0] ** np.arange(n + 1)),
        (1, n, roots[1] ** (np.arange(n + 1.0) - n)),
    ):
        plus, minus = weights.copy(), weights.copy()
        plus[end], minus[end] = -1.0, 1.0
        rows[row, 2 * which], rows[row, 2 * which + 1] = plus / scale, minus / scale
        rows[row] /= np.abs(c[end]) if c[end] else 1.0
    return rows.reshape(2, -1)


def _violations(problem: Problem, magnitude: SquaredMagnitude) -> list[float]:
    """Return the `s` at which a bound of the whole axis is missed by more than its share."""
    p, q = magnitude.numerator, magnitude.denominator
    low, high = _SHARE * problem.lowest**2, LARGEST**2 / _SHARE
    cuts = []
    for value, reference, share in (
        (q, np.abs(q), _SHARE * DAMPING**2),
        (p, np.abs(p), _SHARE * DAMPING**2),
        (p - low * q, p + low * np.abs(q), 0.0),
        (high * q - p, high * np.abs(q) + np.abs(p), 0.0),
    ):
        at, least = lowest_ratio(value, reference)
        if least < share:
            cuts.append(at)
    return cuts


def lowest_ratio(value: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Return where on the axis value/reference is least, and the least: by its critical points."""
    a, b = value[::-1], reference[::-1]
    slope: FloatArray = np.polysub(np.polymul(np.polyder(a), b), np.polymul(a, np.polyder(b)))
    roots = np.roots(slope)
    inner = np.concatenate((roots.real, np.abs(roots)))  # a real root may come with rounding
    at = np.concatenate(([0.0], inner[(inner > 0.0) & np.isfinite(inner)], [np.inf]))
    values = basis(*_ends(at), value.size - 1)
    ratio = (values @ value) / (values @ reference)
    worst = int(np.argmin(ratio))
    return float(at[worst]), float(ratio[worst])


def _ends(s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return u and v of `s`, infinity included."""
    v = 1.0 / (1.0 + s)
    u = np.where(np.isinf(s), 1.0, np.where(np.isinf(s), 0.0, s) * v)
    return u, v
