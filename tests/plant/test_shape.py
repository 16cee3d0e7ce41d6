import numpy as np
import pytest

from plant._surface import Surface

# Uneven, but graded like a map's: distances grow by a half at most.
NODES = tuple(
    np.concatenate(([0.0], np.cumsum(d) / np.sum(d)))
    for d in (1.0 + 0.4 * np.sin(np.arange(n)) for n in (11, 8, 14))
)
GRID = np.meshgrid(*NODES, indexing="ij")


def steps():
    """Heights that many small and a few large steps lead to, rising in each coordinate."""
    rise = 1e-4 + np.random.default_rng(2).uniform(size=GRID[0].shape) ** 8
    return rise.cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)


def saturating():
    x, y, z = GRID
    return (1.05 - np.exp(-6.0 * y)) * (1.2 + np.tanh(25.0 * (z - 0.4))) - 0.5 * x


def steep_then_flat():
    x, y, z = GRID
    front = 0.3 + 0.2 * x  # where the steep part ends moves with another coordinate
    return np.where(z < front, z / front, 1.0 + 0.01 * (z - front)) * (1.0 + y) + 0.2 * y - x


DATA = {"steps": steps, "saturating": saturating, "steep then flat": steep_then_flat}


def along(surface, axis, count=200, fine=2001):
    """Values on lines along a coordinate, those of the others at random places."""
    random = np.random.default_rng(4)
    places = [np.broadcast_to(random.uniform(size=(count, 1)), (count, fine)) for _ in range(3)]
    places[axis] = np.broadcast_to(np.linspace(0.0, 1.0, fine), (count, fine))
    return surface(*places)


def against(surface, values):
    """Largest step against the values' own direction in each coordinate, of their range."""
    found = []
    for axis in range(3):
        sign = np.sign(np.diff(values, axis=axis))
        assert (sign == sign.flat[0]).all()  # else the data is not monotone
        lines = np.diff(sign.flat[0] * along(surface, axis), axis=1)
        # A fall counts in whole: the sum of its steps, however fine the line is.
        found.append(-np.minimum(lines, 0.0).sum(axis=1).min() / np.ptp(values))
    return found


@pytest.mark.parametrize("name", DATA)
def test_monotone_data_gives_a_monotone_surface_where_interpolation_overshoots(name):
    values = DATA[name]()
    assert max(against(Surface.through(NODES, values), values)) > 1e-3
    shaped = Surface.shaped(NODES, values)
    assert max(against(shaped, values)) < 1e-5
    # It leaves the values a little for that, and passes their extremes by no more.
    left = np.abs(shaped(*GRID) - values).max()
    assert left < 0.05 * np.ptp(values)
    dense = along(shaped, 2)
    assert values.min() - left <= dense.min() < dense.max() <= values.max() + left


def test_falling_data_is_the_mirror_image():
    rising = Surface.shaped(NODES, saturating()).coefficients
    falling = Surface.shaped(NODES, -saturating()).coefficients
    np.testing.assert_allclose(falling, -rising, atol=1e-12)


def test_smooth_data_that_is_resolved_is_left_as_interpolated():
    x, y, z = GRID
    for values in (x**3 + y + 2.0 * z**2 + x * y * z, z * (1.3 + 0.2 * y - z) - x**2, 0.0 * x + 3):
        exact = Surface.through(NODES, values)
        np.testing.assert_array_equal(
            Surface.shaped(NODES, values).coefficients, exact.coefficients
        )


@pytest.mark.parametrize("width", [0.05, 0.1, 0.3])
def test_data_with_a_peak_keeps_one_peak(width):
    x, y, z = GRID
    top = NODES[2][6]
    values = (1.0 + x + y) * (np.exp(-(((z - top) / width) ** 2)) + 0.01 / (1.0 + (z - top) ** 2))

    def peaks(surface):
        rising = np.diff(along(surface, 2), axis=1) > 1e-7
        return (rising[:, :-1] & ~rising[:, 1:]).sum(axis=1)

    assert (peaks(Surface.shaped(NODES, values)) == 1).all()
    if width < 0.1:
        assert (peaks(Surface.through(NODES, values)) > 1).all()
