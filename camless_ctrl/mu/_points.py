"""Frequencies with their matrices and upper bounds, kept in rising order."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError

from ._ascent import Problem
from ._grid import frequency_grid
from ._response import FloatArray, Response
from ._search import peaks
from ._skewed import skewed_bound
from .blocks import ComplexArray
from .upper import Padding, UpperBound, bound_of

_POLISHED, _POLISH_TOLERANCE = 12, 1e-5  # points at the peak, and their scalings' accuracy
_GRID_TOLERANCE = 3e-3  # of the scalings of repeated scalars


class Points:
    """Upper bounds of a response at the frequencies that have been looked at."""

    def __init__(self, response: Response, problem: Problem, tolerance: float) -> None:
        self.response = response
        self.problem = problem
        self.tolerance = tolerance
        self.padding = Padding(problem.structure)
        self._bounds: dict[float, UpperBound] = {}
        self._last = math.nan

    @property
    def ceiling(self) -> float:
        """Largest bound, and the tolerance on top of it."""
        return float(self.upper().max()) * (1.0 + self.tolerance)

    def scaled(self, level: float) -> Response:
        """Return the response with the rows of the free blocks divided by `level`."""
        inputs = [block.inputs for block in self.problem.structure.blocks]
        return self.response.rows_times(
            np.where(np.repeat(self.problem.free, inputs), 1.0 / level, 1.0)
        )

    @property
    def omega(self) -> FloatArray:
        """Frequencies, rising, rad per time unit."""
        return np.array(sorted(self._bounds))

    def upper(self) -> FloatArray:
        """Upper bounds (N,)."""
        return np.array([self._bounds[w].value for w in sorted(self._bounds)])

    def vectors(self) -> ComplexArray:
        """Directions in which the upper bounds are tight (N, outputs of the perturbation)."""
        return np.array([self._bounds[w].vector for w in sorted(self._bounds)])

    def matrices(self) -> ComplexArray:
        """Matrices (N, outputs, inputs)."""
        return self.response.at(self.omega)

    def add(
        self, omega: FloatArray, progress: Callable[[int, int], None] | None = None
    ) -> FloatArray:
        """Evaluate the bound at more frequencies and return it."""
        M = self.response.at(omega)
        if not np.all(np.isfinite(M)):
            bad = omega[~np.isfinite(M).all(axis=(1, 2))][0]
            raise ParameterError(
                f"the response at {bad:g} rad per time unit is not finite: leave the frequency out"
            )
        for k, w in enumerate(omega):
            if float(w) not in self._bounds:
                self._bounds[float(w)] = self._bound(M[k])
            if progress is not None:
                progress(k + 1, len(omega))
        return np.array([self._bounds[float(w)].value for w in omega])

    def _bound(self, M: ComplexArray) -> UpperBound:
        if self.problem.plain:
            return bound_of(M, self.padding, _GRID_TOLERANCE)
        tolerance = 0.3 * self.tolerance
        bound = skewed_bound(M, self.problem, self.padding, 1.3 * self._last, tolerance)
        self._last = bound.value
        return bound

    def include(self, omega: FloatArray, bounds: Sequence[UpperBound], top: float) -> None:
        """Take over bounds found elsewhere; those beyond `top` only if they are the largest."""
        peak = float(self.upper().max())
        for w, bound in zip(omega, bounds, strict=True):
            if w <= top or bound.value > peak:
                self._bounds.setdefault(float(w), bound)

    def refine(self) -> None:
        """Move towards the highest peaks between their neighbours."""
        from scipy.optimize import minimize_scalar

        omega, upper = self.omega, self.upper()
        if not np.all(np.isfinite(upper)):
            return
        for k in peaks(upper, 3):
            if upper[k] < 0.9 * upper.max() or len(omega) < 2:
                continue
            low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
            minimize_scalar(
                lambda w: -float(self.add(np.array([w]))[0]),
                bounds=(low, high),
                method="bounded",
                options={"maxiter": 10, "xatol": 0.1 * self.tolerance * (high - low)},
            )
        if self.problem.plain:
            self._polish()

    def _polish(self) -> None:
        """Improve the scalings where the bound peaks, until a peak is as good as it gets."""
        done: set[float] = set()
        for _ in range(_POLISHED):
            omega = float(self.omega[np.argmax(self.upper())])
            if omega in done:
                return
            done.add(omega)
            M = self.response.at(np.array([omega]))[0]
            better = bound_of(M, self.padding, _POLISH_TOLERANCE, polish=True)
            if better.value < self._bounds[omega].value:
                self._bounds[omega] = better


def frequencies(response: Response, omega: ArrayLike | None, *, fine: bool) -> FloatArray:
    """Return the frequencies to begin with, after checks; `fine` is for cheap bounds."""
    if response.omega is not None:
        return response.omega
    if omega is None:
        return frequency_grid(response, fine)
    grid = np.unique(np.asarray(omega, dtype=float).ravel())
    if grid.size == 0 or not np.all(np.isfinite(grid)) or grid[0] < 0.0:
        raise ParameterError("omega must hold finite frequencies of at least 0 rad per time unit")
    if grid[-1] > response.nyquist * (1.0 + 1e-12):
        raise ParameterError(
            f"omega goes up to {grid[-1]:g}, but must be at most the Nyquist frequency "
            f"{response.nyquist:g} rad per time unit"
        )
    return grid
