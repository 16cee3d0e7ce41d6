"""Fit of a weight that over-bounds a residual of uncertainty, as tightly as its order allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant import ConvergenceError, ParameterError
from plant._checks import in_range, whole
from plant.kinematics import FloatArray

from ._spectral_factor import ComplexArray, FrequencyAxis, factor, response
from ._weight_program import Problem, SquaredMagnitude, constant, settled, tightened
from .weight_result import (
    GOOD_RATIO,
    OverboundingWeight,
    WeightCheck,
    WeightTable,
    checked_residual,
    lowest_order,
)

__all__ = ["OverboundingWeight", "WeightCheck", "WeightTable", "fit_weight", "fit_weights"]

HIGHEST_ORDER = 4
FINER = 8  # parts into which the finer grid cuts each interval: midpoints are among them
ROUNDS = 30  # of adding points from the finer grid
BEYOND = 100.0  # poles and zeros lie within this factor of the grid's frequencies
_LOWEST = 0.1  # |W| between and beyond the grid's points, over the floor
_LIFT = 1e-9  # relative: keeps the bound through the rounding of a realisation
_LARGEST_SCALING = 1e-4  # relative; the factorisation is wrong if it takes more

Residual = Callable[[FloatArray], ArrayLike]


def fit_weight(
    omega: ArrayLike,
    residual: ArrayLike,
    *,
    order: int | None = None,
    dt: float | None = None,
    orders: Iterable[int] = (0, 1, 2, 3, 4),
    floor: float = 1e-3,
    slack: float = 0.02,
    finer: Residual | None = None,
    name: str = "",
) -> OverboundingWeight:
    """Return the stable, minimum-phase weight that over-bounds a residual most tightly.

    The largest ratio of |W| to the residual over the grid is the least that the order allows, or
    up to `slack` more; of the weights within that, one with a small mean of log |W| over the
    grid is taken. Without this second aim a dip of the residual, where no weight is tight, would
    leave |W| free everywhere else.

    Between and beyond the grid's points |W| stays between about a tenth of the floor and ten
    times the largest residual; poles and zeros lie within a factor of 100 of the grid's
    frequencies (other than 0 and pi/dt) and are damped by about 0.01 or more.

    Parameters
    ----------
    omega : array-like, shape (points,)
        Rising frequencies, rad/s; in discrete time up to pi/dt.
    residual : array-like, shape (points,)
        Magnitude to bound, at least zero.
    order : int, optional
        From 0 to 4. If it is None: the lowest of `orders` with a largest ratio of at most 1.25;
        if there is none, the lowest within 5 % of the tightest.
    dt : float, optional
        Sampling time, s; None or 0 for continuous time.
    orders : iterable of int
        Orders to choose from.
    floor : float
        The weight bounds at least this share of the largest residual, and its tightness is
        measured against that: |W| >= max(residual, floor max residual). Raise it where dips of
        the residual do not matter.
    slack : float
        Share by which the largest ratio may exceed the least one, so that |W| is smaller in the
        mean; a ratio of at most 1.25 stays so.
    finer : callable, optional
        Residual at given frequencies (rad/s). With it the weight is checked on a grid eight
        times finer; points at which it falls short are added and the fit is repeated.
    name : str
        Name of the weight.

    Raises
    ------
    ParameterError
        If an argument is out of range, or the residual is zero everywhere.
    ConvergenceError
        If the finer check does not pass in 30 rounds, or the factorisation fails.

    Examples
    --------
    >>> import numpy as np
    >>> from uncertainty.weights import fit_weight
    >>> omega = np.geomspace(0.1, 1000.0, 80)
    >>> late = lambda w: np.abs(np.exp(-1e-3j * w) - 1.0)
    >>> weight = fit_weight(omega, late(omega), order=1, finer=late)
    >>> weight.check(omega, late(omega)).holds
    True
    """
    time = 0.0 if dt is None else in_range("dt", dt, 0.0, np.inf, "s")
    share = in_range("floor", floor, 1e-6, 1.0, "1", remedy="a share of the largest residual")
    free = in_range("slack", slack, 0.0, 1.0, "1")
    choices = _orders(orders) if order is None else _orders((order,))
    frequency, wanted = checked_residual(omega, residual, time)
    if (np.diff(frequency) <= 0.0).any():
        at = frequency[1:][np.diff(frequency) <= 0.0][0]
        raise ParameterError(f"the frequencies do not rise at {at:g} rad/s: sort them, each once")
    fine = fine_residual = np.zeros(0)
    if finer is not None:
        fine = _finer_grid(frequency)
        fine, fine_residual = checked_residual(fine, finer(fine), time)
    peak = max(float(wanted.max()), float(fine_residual.max(initial=0.0)))
    if peak <= 0.0:
        raise ParameterError("the residual is 0 at every frequency: there is nothing to bound")

    given = frequency.size
    for _ in range(ROUNDS):
        bound = np.maximum(wanted, share * peak)
        axis = FrequencyAxis.of(frequency, time)
        problem = _problem(frequency, bound / peak, share, axis)
        climbed = _climb(problem, choices)
        tried = tuple((m.order, float(np.sqrt(m.ratio))) for m in climbed)
        taken = lowest_order(tuple(pair for pair in tried if pair[0] in choices))
        tightest = next(m for m in climbed if m.order == taken)
        limit = _limit(float(np.sqrt(tightest.ratio)), free)
        magnitude = settled(problem, tightest, limit**2)
        zeros, poles, gain = _scaled(magnitude, axis, frequency, bound, peak)

        size = np.abs(response(axis.points(fine), zeros, poles, gain))
        missed = size < np.maximum(fine_residual, share * peak)
        if not missed.any():
            ratio = np.abs(response(axis.points(frequency), zeros, poles, gain)) / bound
            return OverboundingWeight(
                order=taken,
                zeros=zeros,
                poles=poles,
                gain=gain,
                dt=time,
                name=name,
                omega=frequency,
                residual=wanted,
                floor=share,
                min_ratio=float(ratio.min()),
                max_ratio=float(ratio.max()),
                tried=tried,
                added=frequency.size - given,
                converged=magnitude.converged,
            )
        frequency, at = np.unique(np.concatenate((frequency, fine[missed])), return_index=True)
        wanted = np.concatenate((wanted, fine_residual[missed]))[at]
    raise ConvergenceError(
        f"the weight still under-bounds {int(missed.sum())} of {fine.size} finer points after "
        f"{ROUNDS} rounds, first at {fine[missed][0]:g} rad/s: refine the grid or lower the order"
    )


def fit_weights(
    omega: ArrayLike,
    residual: ArrayLike,
    *,
    orders: Iterable[int] = (0, 1, 2, 3, 4),
    **options: Any,
) -> WeightTable:
    """Return the weights of several orders side by side.

    The options are those of `fit_weight`, but for `order`.
    """
    return WeightTable(
        tuple(fit_weight(omega, residual, order=n, **options) for n in _orders(orders))
    )


def _orders(orders: Iterable[int]) -> tuple[int, ...]:
    checked = {whole("order", n, 0, HIGHEST_ORDER) for n in orders}
    if not checked:
        raise ParameterError("orders is empty: name at least one order from 0 to 4")
    return tuple(sorted(checked))


def _problem(omega: FloatArray, bound: FloatArray, floor: float, axis: FrequencyAxis) -> Problem:
    """Return the problem for a bound of 1 at the most."""
    u, v = axis.shares(omega)
    inner = (u > 1e-12) & (v > 1e-12)
    s = u[inner] / v[inner] if inner.any() else np.ones(1)
    roots = (float(s.min()) / BEYOND**2, float(s.max()) * BEYOND**2)
    return Problem(u, v, bound**2, _LOWEST * floor, roots)


def _climb(problem: Problem, choices: tuple[int, ...]) -> list[SquaredMagnitude]:
    """Return the fits of order 0 and up: each starts from the last, so none is worse.

    The climb ends at the highest choice or at the first one that is good enough.
    """
    climbed = [constant(problem)]
    while climbed[-1].order < choices[-1]:
        last = climbed[-1]
        if last.order in choices and np.sqrt(last.ratio) <= GOOD_RATIO:
            break
        climbed.append(tightened(problem, last.raised()))
    return climbed


def _limit(ratio: float, slack: float) -> float:
    """Return the largest ratio that the slack allows."""
    limit = ratio * (1.0 + slack)
    return min(limit, GOOD_RATIO) if ratio <= GOOD_RATIO else limit


def _scaled(
    magnitude: SquaredMagnitude,
    axis: FrequencyAxis,
    omega: FloatArray,
    bound: FloatArray,
    peak: float,
) -> tuple[ComplexArray, ComplexArray, float]:
    """Return the factor in the residual's unit, lifted so that it is nowhere below the bound."""
    zeros, poles, gain = factor(magnitude, axis)
    gain *= peak
    if magnitude.order == 0:
        return zeros, poles, gain
    least = float((np.abs(response(axis.points(omega), zeros, poles, gain)) / bound).min())
    if not abs(1.0 - least) <= _LARGEST_SCALING:
        raise ConvergenceError(
            f"the factor of order {magnitude.order} is {least:.6g} times the bound at the least, "
            "and not 1: the roots lost their precision; narrow the grid or lower the order"
        )
    return zeros, poles, gain / least * (1.0 + _LIFT)


def _finer_grid(omega: FloatArray) -> FloatArray:
    """Return the grid with each interval cut into 8 parts: even in logarithm, else even."""
    low, high = omega[:-1, None], omega[1:, None]
    step = np.arange(FINER) / FINER
    ratio = np.divide(high, low, out=np.ones_like(high), where=low > 0.0)
    parts = np.where(low > 0.0, low * ratio**step, low + (high - low) * step)
    return np.append(parts.ravel(), omega[-1])
