"""Nodes of the mean-value maps: dense where the maps curve, graded in between.

Along each coordinate the full plant is compared with the spline half-way between the nodes,
on lines through nodes of the other two coordinates: there the spline of three coordinates is
a spline of one, so the error belongs to that coordinate alone. A cubic spline's error falls
as the fourth power of the distance of its nodes, which gives the distance that each place
needs; neighbouring distances may differ by a given ratio only, because a spline's
coefficients swing where its nodes change their distance abruptly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ._surface import DEGREE, Surface
from .kinematics import FloatArray

Nodes = tuple[FloatArray, FloatArray, FloatArray]
Simulate = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]

FIRST_GRID = (14, 7, 15)  # slowness, logarithm of lift, share
GRIDS = 3  # at most, the first one included
_LINES = 64  # that each distance is judged on
_RATIO = 1.15  # of neighbouring distances
_LOSS_WEIGHT = 0.5  # loss is allowed twice the error of charge
_SPARE = 1.1  # nodes beyond what the estimate asks for
_FLOOR = 1e-3  # of the largest error: where it is smaller, it is noise
_FINE = 4001  # points of a density
_SEED = 0


@dataclass(frozen=True)
class RefinedGrid:
    """Nodes and what the full plant gives there.

    Attributes
    ----------
    nodes : tuple of 3 ndarray
        Rising nodes.
    charge, loss : ndarray (n1, n2, n3)
        Values at the nodes, kg and J per event.
    error : tuple of 3 float
        Largest error seen between the nodes of each coordinate, relative to the largest charge
        (or half of that to the largest loss) at the place's first coordinate.
    simulated : int
        Cycles simulated in all.
    """

    nodes: Nodes
    charge: FloatArray
    loss: FloatArray
    error: tuple[float, float, float]
    simulated: int


class _Distances(NamedTuple):
    """Largest error between neighbouring nodes along one coordinate."""

    nodes: FloatArray
    error: FloatArray


def refined_grid(
    simulate: Simulate,
    box: FloatArray,
    tolerance: float,
    most_points: int,
    kinks: Sequence[float] = (),
) -> RefinedGrid:
    """Choose nodes in a box until the spline meets a tolerance, or the points are used up.

    Parameters
    ----------
    simulate : callable
        Charge and loss at coordinates of one shape.
    box : ndarray (3, 2)
        Lowest and highest value of each coordinate.
    tolerance : float
        Error to aim at, relative as in `RefinedGrid.error`.
    most_points : int
        Most nodes of the grid.
    kinks : sequence of float
        Values of the first coordinate at which the plant has a kink: they become nodes.
    """
    random = np.random.default_rng(_SEED)
    bounds = box.tolist()
    shrink = min(1.0, (most_points / np.prod(FIRST_GRID)) ** (1.0 / 3.0))
    nodes = _as_nodes(
        np.linspace(low, high, max(int(count * shrink), DEGREE + 1))
        for (low, high), count in zip(bounds, FIRST_GRID, strict=True)
    )
    simulated = 0
    for grid in range(GRIDS):
        charge, loss = simulate(*np.meshgrid(*nodes, indexing="ij"))
        simulated += charge.size
        found = [_judge(simulate, nodes, charge, loss, axis, random) for axis in range(3)]
        simulated += _LINES * sum(len(f.error) for f in found)
        worst = [float(f.error.max()) for f in found]
        if max(worst) <= tolerance or grid == GRIDS - 1:
            break
        finer = _finer(found, tolerance, most_points)
        if all(len(new) <= len(old) for new, old in zip(finer, nodes, strict=True)):
            break
        nodes = (_snapped(finer[0], kinks), finer[1], finer[2])
    return RefinedGrid(nodes, charge, loss, (worst[0], worst[1], worst[2]), simulated)


def _judge(
    simulate: Simulate,
    nodes: Nodes,
    charge: FloatArray,
    loss: FloatArray,
    axis: int,
    random: np.random.Generator,
) -> _Distances:
    x = nodes[axis]
    middle = 0.5 * (x[1:] + x[:-1])
    points = [np.empty(0)] * 3
    points[axis] = np.repeat(middle, _LINES)
    for other in {0, 1, 2} - {axis}:
        line = nodes[other][random.integers(0, len(nodes[other]), _LINES)]
        points[other] = np.tile(line, len(middle))
    truth = simulate(points[0], points[1], points[2])
    error = np.zeros(len(points[0]))
    for values, true, weight in zip((charge, loss), truth, (1.0, _LOSS_WEIGHT), strict=True):
        largest = np.interp(points[0], nodes[0], np.abs(values).max(axis=(1, 2)))
        relative = np.abs(Surface.through(nodes, values)(*points) - true) / largest
        error = np.maximum(error, weight * relative)
    return _Distances(x, error.reshape(len(middle), _LINES).max(axis=1))


def _finer(found: list[_Distances], tolerance: float, most_points: int) -> Nodes:
    """Nodes whose distances the errors ask for, fewer where there would be too many."""
    places, densities = [], []
    for x, error in found:
        asked = np.maximum(error, _FLOOR * error.max()) / tolerance
        distance = np.diff(x) * asked ** (-1.0 / (DEGREE + 1))
        fine = np.linspace(x[0], x[-1], _FINE)
        spacing = np.exp(np.interp(fine, 0.5 * (x[1:] + x[:-1]), np.log(distance)))
        places.append(fine)
        densities.append(1.0 / _graded(fine, spacing))
    counts = np.array([_SPARE * np.trapezoid(d, x) for x, d in zip(places, densities, strict=True)])
    counts = _limited(np.maximum(np.ceil(counts), DEGREE + 1), most_points)
    return _as_nodes(
        _equidistributed(x, d, int(count))
        for x, d, count in zip(places, densities, counts, strict=True)
    )


def _limited(intervals: FloatArray, most_points: int) -> FloatArray:
    """Reduce the nodes of the three coordinates alike until they make few enough points."""
    nodes = intervals + 1.0
    for _ in nodes:  # each time it is enough, or one more coordinate has its fewest nodes
        free = nodes > DEGREE + 1
        excess = np.prod(nodes) / most_points
        if excess <= 1.0 or not free.any():
            break
        fewer = np.floor(nodes * excess ** (-1.0 / free.sum()))
        nodes = np.where(free, np.maximum(fewer, DEGREE + 1), nodes)
    return nodes - 1.0


def _graded(x: FloatArray, spacing: FloatArray) -> FloatArray:
    """Reduce spacings until they grow by no more than the logarithm of the ratio along `x`."""
    growth = np.log(_RATIO) * x
    rising = np.minimum.accumulate(spacing - growth) + growth
    falling = np.minimum.accumulate((rising + growth)[::-1])[::-1] - growth
    return np.asarray(falling, dtype=float)


def _equidistributed(x: FloatArray, density: FloatArray, intervals: int) -> FloatArray:
    """Nodes between which the density integrates to equal parts; both ends are exact."""
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(x)
    total = np.concatenate(([0.0], np.cumsum(steps)))
    nodes = np.interp(np.linspace(0.0, total[-1], intervals + 1), total, x)
    nodes[[0, -1]] = x[[0, -1]]
    return nodes


def _snapped(nodes: FloatArray, places: Sequence[float]) -> FloatArray:
    """Move the inner node next to each place there."""
    moved = nodes.copy()
    for place in places:
        if nodes[0] < place < nodes[-1]:
            moved[1 + int(np.argmin(np.abs(nodes[1:-1] - place)))] = place
    return moved


def _as_nodes(lines: Iterable[FloatArray]) -> Nodes:
    first, second, third = lines
    return first, second, third
