"""Steps of a D-K iteration: mu over frequency, fitted scalings, the scaled plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ._realisation import ComplexArray, FloatArray, Realisation, axis_points
from .mu_bound import MuBound, ScaledBound, Structure, largest_gain, scaled_bound
from .scaling_fit import MinimumPhaseFit, fit_minimum_phase

UNITY = MinimumPhaseFit(1.0, np.zeros((0, 2)), np.zeros((0, 4)), 0.0)

_PER_DECADE = 15
_REFINED_PEAKS = 3
_LEAST_WEIGHT = 0.05  # of a point far below the peak, in the fit
_FIT_LOSS = 0.01  # loss of a fit that needs no higher order


@dataclass(frozen=True)
class MuOverFrequency:
    """Upper bound of mu of a loop on a grid with its peaks refined, rad/s."""

    frequency: FloatArray
    responses: ComplexArray
    bound: ScaledBound

    @property
    def peak(self) -> float:
        """Largest value."""
        return float(self.bound.values.max())

    @property
    def peak_frequency(self) -> float:
        """Where it is."""
        return float(self.frequency[int(np.argmax(self.bound.values))])


def mu_over_frequency(
    loop: Realisation, structure: Structure, scalings: MuBound | None, grid: FloatArray | None
) -> MuOverFrequency:
    """Bound mu of a stable loop; without a grid, one around its poles."""
    if grid is None:
        ends = np.abs(axis_points(loop, False, 2)[[0, -1]])
        decades = float(np.log10(ends[1] / ends[0]))
        points = int(np.clip(_PER_DECADE * decades, 60, 300))
        grid = axis_points(loop, False, points).imag

    def at(omega: FloatArray) -> tuple[ComplexArray, ScaledBound]:
        responses = loop.response(np.asarray(1j * omega, dtype=complex))
        return responses, scaled_bound(responses, structure, scalings)

    responses, bound = at(grid)
    omega = _refined(grid, bound.values, lambda w: float(at(np.array([w]))[1].values[0]))
    if omega.size:
        grid = np.unique(np.concatenate((grid, omega)))
        responses, bound = at(grid)
    return MuOverFrequency(grid, responses, bound)


def _refined(
    grid: FloatArray, values: FloatArray, function: Callable[[float], float]
) -> FloatArray:
    """Places of the highest peaks between points of the grid."""
    from scipy.optimize import minimize_scalar

    inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    highest = inner[np.argsort(values[inner])[::-1][:_REFINED_PEAKS]]
    found = []
    for k in highest:
        bounds = (float(np.log(grid[k - 1])), float(np.log(grid[k + 1])))
        best = minimize_scalar(
            lambda x: -function(float(np.exp(x))), bounds=bounds, method="bounded",
            options={"xatol": 1e-4, "maxiter": 25},
        )  # fmt: skip
        if -best.fun > values[k]:
            found.append(float(np.exp(best.x)))
    return np.array(found)


def fitted_scalings(
    mu: MuOverFrequency, structure: Structure, orders: tuple[int, ...], fully: bool = False
) -> tuple[tuple[MinimumPhaseFit, ...], float]:
    """Fit the scalings; the loss of the peak by the fit, relative.

    Orders rise together up to `orders`, until the loss is small; or they are taken `fully`.
    """
    weight = np.maximum((mu.bound.values / mu.peak) ** 2, _LEAST_WEIGHT)
    best: tuple[tuple[MinimumPhaseFit, ...], float] | None = None
    for top in range(max(orders) if fully else 0, max(orders) + 1):
        fits = [
            fit_minimum_phase(
                mu.frequency, mu.bound.scalings[:, k], min(top, orders[k]), weight=weight
            )
            for k in range(len(structure) - 1)
        ]
        d = np.column_stack([np.abs(fit(mu.frequency)) for fit in (*fits, UNITY)])
        loss = float(largest_gain(mu.responses, structure, d).max()) / mu.peak - 1.0
        if best is None or loss < best[1]:
            best = (*fits, UNITY), loss
        if loss <= _FIT_LOSS:
            break
    if best is None:  # the loop above runs at least once
        raise AssertionError("no order was tried")
    return best


def scaled_plant(
    P: Realisation, fits: tuple[MinimumPhaseFit, ...], structure: Structure
) -> Realisation:
    """Plant between the scalings: ``D`` on its errors, the inverse on its disturbances."""
    p, m = P.D.shape
    left = [
        fit.realisation() for fit, b in zip(fits, structure, strict=True) for _ in range(b.inputs)
    ]
    right = [
        fit.inverse().realisation()
        for fit, b in zip(fits, structure, strict=True)
        for _ in range(b.outputs)
    ]
    return _series(_parallel(left, p), _series(P, _parallel(right, m)))


def _parallel(channels: list[Realisation], size: int) -> Realisation:
    """Channels side by side, the signals beyond them passed through."""
    n = sum(c.order for c in channels)
    A, B, C, D = np.zeros((n, n)), np.zeros((n, size)), np.zeros((size, n)), np.eye(size)
    start = 0
    for k, channel in enumerate(channels):
        states = slice(start, start + channel.order)
        A[states, states], B[states, k] = channel.A, channel.B[:, 0]
        C[k, states], D[k, k] = channel.C[0], channel.D[0, 0]
        start += channel.order
    return Realisation(A, B, C, D)


def _series(second: Realisation, first: Realisation) -> Realisation:
    """System whose output is that of `second`, driven by `first`."""
    A = np.block([[first.A, np.zeros((first.order, second.order))], [second.B @ first.C, second.A]])
    B = np.vstack([first.B, second.B @ first.D])
    return Realisation(A, B, np.hstack([second.D @ first.C, second.C]), second.D @ first.D)
