"""Smooth surface over a box: a tensor product of cubic splines (C2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from ._shape import shape_preserving
from .kinematics import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import NdBSpline
    from scipy.sparse import csr_array

DEGREE = 3
_SCAN_PER_SPAN = 8


class Peak(NamedTuple):
    """Largest value of a spline."""

    at: FloatArray
    value: FloatArray


class Rise(NamedTuple):
    """First rise of a spline through a level."""

    at: FloatArray  # NaN if there is none
    lowest: FloatArray  # lowest value before the peak


@dataclass(frozen=True, eq=False)
class Surface:
    """Cubic spline in three coordinates (C2).

    Attributes
    ----------
    knots : tuple of 3 ndarray
        Knots in each coordinate, those at the ends four times.
    coefficients : ndarray (n1, n2, n3, ...)
        Coefficients; more than three axes make as many surfaces at once.
    """

    knots: tuple[FloatArray, FloatArray, FloatArray]
    coefficients: FloatArray

    @classmethod
    def through(cls, nodes: tuple[FloatArray, FloatArray, FloatArray], values: FloatArray) -> Self:
        """Return the spline through values at strictly rising nodes, at least 4 a coordinate.

        The third derivative is continuous at the second and the last but one node.
        """
        from scipy.interpolate import make_interp_spline

        coefficients, knots = values, list[FloatArray]()
        for axis, x in enumerate(nodes):
            line = make_interp_spline(x, np.moveaxis(coefficients, axis, 0), k=DEGREE)
            coefficients = np.moveaxis(line.c, 0, axis)
            knots.append(line.t)
        return cls((knots[0], knots[1], knots[2]), np.ascontiguousarray(coefficients))

    @classmethod
    def shaped(
        cls,
        nodes: tuple[FloatArray, FloatArray, FloatArray],
        values: FloatArray,
        most_moved: float = np.inf,
    ) -> Self:
        """Return the spline near the values that has their shape, see `_shape`."""
        exact = cls.through(nodes, values)
        shaped = shape_preserving(exact.coefficients, exact.knots, nodes, values, most_moved)
        return cls(exact.knots, shaped)

    @cached_property
    def spline(self) -> NdBSpline:
        """The spline as SciPy's."""
        from scipy.interpolate import NdBSpline

        return NdBSpline(self.knots, self.coefficients, DEGREE)

    def __call__(self, *x: FloatArray, order: tuple[int, int, int] = (0, 0, 0)) -> FloatArray:
        """Value, or derivative of an order in each coordinate, at points of one shape."""
        points = np.stack(x, axis=-1)
        return np.asarray(self.spline(points, nu=list(order)), dtype=float)

    def lines(self, first: FloatArray, second: FloatArray) -> Lines:
        """Curves along the third coordinate at `p` points of the first and second."""
        from scipy.interpolate import BSpline

        t1, t2, t3 = self.knots
        rows1 = BSpline.design_matrix(first, t1, DEGREE)
        rows2 = BSpline.design_matrix(second, t2, DEGREE)
        rows = _contracted(rows1, rows2, self.coefficients)
        return Lines(t3, rows, DEGREE)


def _contracted(first: csr_array, second: csr_array, coefficients: FloatArray) -> FloatArray:
    """Sum of coefficients weighed by the four weights in a row of each matrix, (p, n3)."""
    width = DEGREE + 1
    i, j = (m.indices.reshape(-1, width) for m in (first, second))
    a, b = (m.data.reshape(-1, width) for m in (first, second))
    total = np.zeros((len(i), coefficients.shape[2]))
    for k in range(width):
        for m in range(width):
            total += (a[:, k] * b[:, m])[:, None] * coefficients[i[:, k], j[:, m]]
    return total


@dataclass(frozen=True, eq=False)
class Lines:
    """Splines of one variable that share their knots, one a row of `coefficients`."""

    knots: FloatArray
    coefficients: FloatArray  # (p, n)
    degree: int

    def on(self, x: FloatArray) -> FloatArray:
        """Values of all `p` splines at the same `m` points, (p, m)."""
        return np.asarray(self._basis(x) @ self.coefficients.T).T

    def at(self, x: FloatArray) -> FloatArray:
        """Value of each spline at its own point, (p,)."""
        return np.asarray(self._basis(x).multiply(self.coefficients).sum(axis=1), float).ravel()

    def derivative(self) -> Lines:
        """First derivative of each spline."""
        from scipy.interpolate import BSpline

        d = BSpline(self.knots, self.coefficients.T, self.degree).derivative()
        n = len(d.t) - d.k - 1  # SciPy pads the coefficients to the number of knots
        return Lines(d.t, np.asarray(d.c[:n]).T, d.k)

    def root(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Where each spline passes zero between two points of one knot span, by bisection.

        The bracket is halved until it is as short as rounding allows.
        """
        # In a knot span a spline is its own Taylor polynomial, which is cheap to evaluate.
        centre = 0.5 * (low + high)
        terms, line = [], self
        for order in range(self.degree + 1):
            terms.append(line.at(centre) / math.factorial(order))
            if order < self.degree:
                line = line.derivative()

        def value(offset: FloatArray) -> FloatArray:
            total = np.zeros_like(offset)
            for term in reversed(terms):
                total = total * offset + term
            return total

        low, high = low - centre, high - centre
        positive_low = value(low) > 0.0
        for _ in range(54):
            middle = 0.5 * (low + high)
            same = (value(middle) > 0.0) == positive_low
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return centre + 0.5 * (low + high)

    def peak(self) -> Peak:
        """Largest value of each spline, and where it is."""
        grid = self._scan()
        slope = self.derivative()
        highest = np.argmax(self.on(grid), axis=1)
        left = slope.at(grid[highest]) < 0.0  # falling already: the peak is before this point
        low = grid[np.maximum(highest - left, 0)]
        high = grid[np.minimum(highest + ~left, len(grid) - 1)]
        # Without a change from rising to falling the peak is at an end of the line.
        inner = (slope.at(low) > 0.0) & (slope.at(high) < 0.0)
        at = np.where(inner, slope.root(low, high), grid[highest])
        return Peak(at, self.at(at))

    def first_rise(self, level: FloatArray, peak: Peak) -> Rise:
        """First place before its peak where each spline rises through a level of its own."""
        grid = self._scan()
        beyond = grid[None, :] >= peak.at[:, None]
        x = np.where(beyond, peak.at[:, None], grid[None, :])
        values = np.where(beyond, peak.value[:, None], self.on(grid))
        rises = (values[:, :-1] < level[:, None]) & (values[:, 1:] >= level[:, None])
        row, first = np.arange(len(level)), np.argmax(rises, axis=1)
        # The basis sums to one, so a constant comes off the coefficients.
        shifted = Lines(self.knots, self.coefficients - level[:, None], self.degree)
        at = shifted.root(x[row, first], x[row, first + 1])
        return Rise(np.where(rises.any(axis=1), at, np.nan), values.min(axis=1))

    def _scan(self) -> FloatArray:
        """Points close enough together to bracket every peak and crossing of the splines."""
        breaks = np.unique(self.knots)
        inside = np.arange(_SCAN_PER_SPAN) / _SCAN_PER_SPAN
        points = breaks[:-1, None] + np.diff(breaks)[:, None] * inside
        return np.append(points.ravel(), breaks[-1])

    def _basis(self, x: FloatArray) -> csr_array:
        from scipy.interpolate import BSpline

        return BSpline.design_matrix(x, self.knots, self.degree)
