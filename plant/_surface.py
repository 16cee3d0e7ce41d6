"""Smooth surface through values on a box: a tensor product of cubic splines (C2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

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
    """Cubic spline in three coordinates that passes through all its nodes.

    Attributes
    ----------
    nodes : tuple of 3 ndarray
        Strictly rising nodes of each coordinate, at least 4.
    values : ndarray (n1, n2, n3)
        Values at the nodes.
    """

    nodes: tuple[FloatArray, FloatArray, FloatArray]
    values: FloatArray

    @cached_property
    def spline(self) -> NdBSpline:
        """The spline: knots, coefficients and degree (not-a-knot at the ends)."""
        from scipy.interpolate import NdBSpline, make_interp_spline

        coefficients, knots = self.values, list[FloatArray]()
        # make_interp_spline puts the axis it worked on first: after the last, middle and first
        # axis, each taken from the end, all are in order again.
        for nodes in reversed(self.nodes):
            line = make_interp_spline(nodes, coefficients, k=DEGREE, axis=2)
            coefficients = line.c
            knots.insert(0, line.t)
        return NdBSpline(tuple(knots), coefficients, DEGREE)

    def __call__(self, *x: FloatArray, by: int | None = None) -> FloatArray:
        """Value, or first derivative by coordinate `by` (0, 1, 2), at points of one shape."""
        points = np.stack(x, axis=-1)
        nu = None if by is None else [int(k == by) for k in range(3)]
        return np.asarray(self.spline(points, nu=nu), dtype=float)

    def lines(self, first: FloatArray, second: FloatArray) -> Lines:
        """Curves along the third coordinate at `p` points of the first and second."""
        from scipy.interpolate import BSpline

        t1, t2, t3 = self.spline.t
        rows1 = BSpline.design_matrix(first, t1, DEGREE).toarray()
        rows2 = BSpline.design_matrix(second, t2, DEGREE).toarray()
        rows = np.einsum("pi,pj,ijk->pk", rows1, rows2, self.spline.c, optimize=True)
        return Lines(t3, rows, DEGREE)


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
