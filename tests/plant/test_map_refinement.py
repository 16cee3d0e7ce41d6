import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from plant._map_refinement import FIRST_GRID, refined_grid

BOX = np.array([[-1.0, -0.125], [np.log(0.5), np.log(8.0)], [0.0, 1.0]])
FRONT, WIDTH = 0.6, 0.04
KINK = -0.4137


class Analytic:
    """Charge with a front across the third coordinate, a smooth loss; counts its calls."""

    def __init__(self, kink=0.0, amplitude=(0.1, 0.1, 1.0)):
        self.kink, self.amplitude, self.points = kink, amplitude, 0

    def charge(self, x, y, z):
        a, b, c = self.amplitude
        return (
            3.0
            + a * np.sin(6.0 * x)
            + b * np.cos(2.0 * y)
            + c * np.tanh((z - FRONT) / WIDTH)
            + self.kink * np.abs(x - KINK)
        )

    def loss(self, x, y, z):
        return 2.0 + 0.1 * x * y * z

    def __call__(self, x, y, z):
        assert x.shape == y.shape == z.shape
        self.points += x.size
        return self.charge(x, y, z), self.loss(x, y, z)


@pytest.fixture(scope="module")
def front():
    plant = Analytic()
    return plant, refined_grid(plant, BOX, 1e-4, 60_000)


def worst_between_nodes(plant, grid, axis):
    """Largest error of one-dimensional splines through nodes, seen on fine lines."""
    fine = np.linspace(*BOX[axis], 5001)
    random = np.random.default_rng(17)
    worst = 0.0
    for _ in range(12):
        line = [grid.nodes[k][random.integers(len(grid.nodes[k]))] for k in range(3)]
        largest = np.abs(grid.charge).max()
        line[axis] = grid.nodes[axis]
        spline = make_interp_spline(grid.nodes[axis], plant.charge(*np.broadcast_arrays(*line)))
        line[axis] = fine
        error = np.abs(spline(fine) - plant.charge(*np.broadcast_arrays(*line)))
        worst = max(worst, error.max() / largest)
    return worst


def test_nodes_start_and_end_on_the_bounds_and_hold_the_plant_s_values(front):
    plant, grid = front
    for nodes, (low, high) in zip(grid.nodes, BOX, strict=True):
        assert (nodes[0], nodes[-1]) == (low, high)
        assert (np.diff(nodes) > 0.0).all()
    mesh = np.meshgrid(*grid.nodes, indexing="ij")
    np.testing.assert_array_equal(grid.charge, plant.charge(*mesh))
    np.testing.assert_array_equal(grid.loss, plant.loss(*mesh))
    assert grid.simulated == plant.points


def test_nodes_cluster_at_a_front_and_nowhere_else(front):
    _, grid = front
    z = grid.nodes[2]
    distance, middle = np.diff(z), 0.5 * (z[1:] + z[:-1])
    # tanh bends most at 0.66 widths from its middle, and not at all 6 widths away.
    assert np.abs(middle[np.argmin(distance)] - FRONT) < 2.0 * WIDTH
    near, far = np.abs(middle - FRONT) < 2.0 * WIDTH, np.abs(middle - FRONT) > 6.0 * WIDTH
    assert distance[far].min() > 1.5 * distance[near].mean()
    for nodes in grid.nodes[:2]:
        assert np.ptp(np.diff(nodes)) < 0.7 * np.diff(nodes).max()


def test_neighbouring_distances_grow_gradually(front):
    for nodes in front[1].nodes:
        ratio = np.diff(nodes)[1:] / np.diff(nodes)[:-1]
        assert np.abs(np.log(ratio)).max() < np.log(1.25)


def test_the_error_told_is_what_a_dense_look_finds(front):
    plant, grid = front
    assert max(grid.error) <= 1e-4  # the tolerance is met
    for axis in range(3):
        # The middle between two nodes need not be the very worst place.
        assert worst_between_nodes(plant, grid, axis) <= 1.5 * grid.error[axis]
    assert worst_between_nodes(plant, grid, 2) >= 0.3 * grid.error[2]


def test_a_smooth_plant_needs_the_first_grid_only():
    plant = Analytic(amplitude=(0.01, 0.01, 0.0))
    grid = refined_grid(plant, BOX, 1e-3, 60_000, [KINK])
    assert grid.charge.shape == FIRST_GRID
    assert max(grid.error) <= 1e-3


def test_loss_asks_for_nodes_too():
    class Loss(Analytic):
        def loss(self, x, y, z):
            return 2.0 + np.tanh((y - 1.0) / 0.2)

    plant = Loss(amplitude=(0.0, 0.0, 0.0))
    y = refined_grid(plant, BOX, 1e-3, 60_000).nodes[1]
    narrow = np.argmin(np.diff(y))
    assert abs(0.5 * (y[narrow] + y[narrow + 1]) - 1.0) < 0.4
    assert np.diff(y).max() > 2.0 * np.diff(y).min()


def test_kinks_become_nodes_and_are_refined():
    places = [KINK, -0.7, -2.0]  # the last one lies outside
    grid = refined_grid(Analytic(kink=1.0), BOX, 1e-3, 60_000, places)
    x = grid.nodes[0]
    assert KINK in x
    assert -0.7 in x
    assert -2.0 not in x
    assert abs(x[np.argmin(np.diff(x))] - KINK) < 0.1
    assert KINK not in refined_grid(Analytic(kink=1.0), BOX, 1e-3, 60_000).nodes[0]


@pytest.mark.parametrize("most", [512, 1500, 8000])
@pytest.mark.parametrize(
    "amplitude", [(0.1, 0.1, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)]
)
def test_most_points_are_not_exceeded(most, amplitude):
    grid = refined_grid(Analytic(amplitude=amplitude, kink=0.2), BOX, 1e-7, most, [KINK])
    assert grid.charge.size <= most
    assert min(grid.charge.shape) >= 4
    if amplitude != (0.0, 0.0, 0.0):
        assert grid.charge.size > 0.4 * most
