"""Shape of a spline surface: no rise or fall between its nodes that the values do not have.

A line of a tensor-product spline is a mean, with weights that are not negative, of the lines
of its coefficients. So the surface is monotone in a coordinate wherever these lines are. Where
one of them goes against the values, although these rise (or fall) all around, its coefficients
are moved, as little as needed, until neighbours there step with the values: a spline rises
where its coefficients rise. All other places are left as they are. Where the nodes are too far
apart for that, so that some would be left by more than is allowed, ever larger steps of the
values count as level, and in the end the spline is left as it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .kinematics import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_RELAXATION = 1.7  # of the projections: below 2 they settle, above 1 they settle sooner
_ENOUGH = 1e-7  # of the largest value: a step against the values that may be left
_MOST_SWEEPS = 1000
_MOST_ROUNDS = 30
_SLOPES = 48  # looked at from one node to the next
_DEGREE = 3
_SLACKS = (0.0, 1e-4, 1e-3, 1e-2)  # of the largest value: smaller steps have no direction


def shape_preserving(
    coefficients: FloatArray,
    knots: tuple[FloatArray, ...],
    nodes: tuple[FloatArray, ...],
    values: FloatArray,
    most_moved: float = np.inf,
) -> FloatArray:
    """Coefficients near the given ones whose lines do not go against the values.

    Parameters
    ----------
    coefficients : ndarray
        Of the spline through the values, of their shape.
    knots, nodes : tuple of ndarray
        Knots of the cubic spline and its nodes in each coordinate.
    values : ndarray
        Values at the nodes.
    most_moved : float
        Most by which the surface may leave a node, relative to the largest value.
    """
    largest = float(np.abs(values).max())
    for slack in _SLACKS:
        c = _held_to(coefficients, knots, nodes, values, slack * largest)
        at_nodes = c - coefficients
        for axis, (t, x) in enumerate(zip(knots, nodes, strict=True)):
            at_nodes = _on(at_nodes, t, x, axis)
        if np.abs(at_nodes).max(initial=0.0) <= most_moved * largest:
            return c
    return np.array(coefficients)


def _on(coefficients: FloatArray, knots: FloatArray, nodes: FloatArray, axis: int) -> FloatArray:
    """Values along an axis at the nodes, from coefficients along it."""
    from scipy.interpolate import BSpline

    basis = BSpline.design_matrix(nodes, knots, _DEGREE)
    line = np.moveaxis(coefficients, axis, 0)
    on = np.asarray(basis @ line.reshape(len(line), -1), dtype=float)
    return np.moveaxis(on.reshape(line.shape), 0, axis)


def _held_to(
    coefficients: FloatArray,
    knots: tuple[FloatArray, ...],
    nodes: tuple[FloatArray, ...],
    values: FloatArray,
    slack: float,
) -> FloatArray:
    """Coefficients that step with the values where these change by more than a slack."""
    c = np.array(coefficients)
    axes = [
        _Axis.of(np.moveaxis(values, axis, 0), t, x, slack)
        for axis, (t, x) in enumerate(zip(knots, nodes, strict=True))
    ]
    enough = _ENOUGH * float(np.abs(values).max())
    held = [np.zeros_like(axis.direction) for axis in axes]
    for _ in range(_MOST_ROUNDS):
        fresh = False
        for k, axis in enumerate(axes):
            wrong = axis.wrong_steps(np.moveaxis(c, k, 0), enough) & (held[k] == 0.0)
            held[k][wrong] = axis.direction[wrong]
            fresh |= bool(wrong.any())
        if not fresh:
            break
        _project(c, held, enough)
    return c


def _project(c: FloatArray, held: list[FloatArray], enough: float) -> None:
    """Move coefficients until the steps that are held have their sign; `c` is changed."""
    for _ in range(_MOST_SWEEPS):
        worst = 0.0
        for k, direction in enumerate(held):
            line = np.moveaxis(c, k, 0)  # a view: c itself is moved
            for first in (0, 1):  # pairs that share no coefficient
                step = direction[first::2]
                low, high = line[first:-1:2], line[first + 1 :: 2]
                wrong = np.minimum(step * (high - low), 0.0)
                worst = max(worst, -float(wrong.min(initial=0.0)))
                move = 0.5 * _RELAXATION * step * wrong
                low += move
                high -= move
        if worst <= 0.1 * enough:
            return


@dataclass(frozen=True)
class _Axis:
    """One coordinate, its axis first: which steps of coefficients the values decide."""

    direction: FloatArray  # (n - 1, ...) sign that a step must not go against; 0 for any
    slope: csr_array  # from coefficients to slopes at points, times the distance of nodes
    spans: csr_array  # from points to the steps that act there
    required: FloatArray  # (points, ...) sign of the slope; 0 for any

    @classmethod
    def of(cls, values: FloatArray, knots: FloatArray, nodes: FloatArray, slack: float) -> _Axis:
        """Read the signs off the values at the nodes."""
        from scipy.interpolate import BSpline
        from scipy.sparse import csr_array

        n = len(nodes)
        direction = _directions(values, knots, nodes, slack)
        inside = np.arange(_SLOPES) / _SLOPES
        x = (nodes[:-1, None] + np.diff(nodes)[:, None] * inside).ravel()
        lower = BSpline.design_matrix(x, knots[1:-1], _DEGREE - 1)  # of the derivative
        rate = _DEGREE / (knots[_DEGREE + 1 : -1] - knots[1 : -_DEGREE - 1])
        steps = csr_array(np.diff(np.eye(n), axis=0) * rate[:, None])
        distance = np.repeat(np.diff(nodes), _SLOPES)[:, None]
        slope = csr_array((lower @ steps).multiply(distance))
        acting = lower.toarray() > 0.0
        signs = np.array(
            [
                np.where((direction[on] == direction[on][:1]).all(axis=0), direction[on][0], 0.0)
                for on in acting
            ]
        )
        return cls(direction, slope, csr_array(acting.T.astype(float)), signs)

    def wrong_steps(self, line: FloatArray, enough: float) -> np.ndarray:
        """Whether steps act where the line goes against the values."""
        shape = line.shape[1:]
        slope = (self.slope @ line.reshape(len(line), -1)).reshape(-1, *shape)
        against = (self.required * slope < -enough).astype(float)
        touched = (self.spans @ against.reshape(len(against), -1)).reshape(-1, *shape)
        steps = np.diff(line, axis=0)
        return np.asarray((touched > 0.0) & (self.direction * steps < 0.0))


def _directions(
    values: FloatArray, knots: FloatArray, nodes: FloatArray, slack: float
) -> FloatArray:
    """Sign that each step of the coefficients along the first axis must have; 0 for any."""
    steps = np.diff(values, axis=0)
    steps = np.where(np.abs(steps) > slack, np.sign(steps), 0.0)
    result = np.zeros_like(steps)
    for j in range(len(nodes) - 1):
        # The slope's weight of this step lives on the three spans between these knots.
        low, high = knots[j + 1], knots[j + 4]
        first = int(np.searchsorted(nodes, low, side="right")) - 1
        last = int(np.searchsorted(nodes, high, side="left"))
        around = steps[first:last]
        result[j] = np.where((around == around[:1]).all(axis=0), around[0], 0.0)
    return result
