import numpy as np

from plant._surface import Surface

NODES = (
    np.array([0.0, 1.0, 2.5, 4.0, 7.0]),
    np.linspace(0.0, 1.0, 6),
    np.linspace(0.0, 1.0, 21),
)


def surface(f):
    return Surface.through(NODES, f(*np.meshgrid(*NODES, indexing="ij")))


def points(count=60):
    random = np.random.default_rng(7)
    return tuple(random.uniform(n[0], n[-1], count) for n in NODES)


def test_a_cubic_polynomial_and_its_derivatives_are_exact():
    s = surface(lambda x, y, z: x**3 * y - 2.0 * y**2 * z**3 + x * y * z)
    x, y, z = points()
    np.testing.assert_allclose(s(x, y, z), x**3 * y - 2 * y**2 * z**3 + x * y * z, atol=1e-11)
    np.testing.assert_allclose(s(x, y, z, order=(1, 0, 0)), 3 * x**2 * y + y * z, atol=1e-11)
    np.testing.assert_allclose(s(x, y, z, order=(0, 1, 0)), x**3 - 4 * y * z**3 + x * z, atol=1e-11)
    np.testing.assert_allclose(s(x, y, z, order=(0, 0, 1)), -6 * y**2 * z**2 + x * y, atol=1e-11)


def test_lines_are_cuts_of_the_surface():
    s = surface(lambda x, y, z: np.sin(x) * np.exp(y * z) + z)
    x, y, z = points()
    lines = s.lines(x, y)
    np.testing.assert_allclose(lines.at(z), s(x, y, z), atol=1e-13)
    np.testing.assert_allclose(lines.derivative().at(z), s(x, y, z, order=(0, 0, 1)), atol=1e-11)
    np.testing.assert_allclose(np.diag(lines.on(z)), s(x, y, z), atol=1e-13)


def test_peak_and_first_rise_of_a_parabola_are_exact():
    # z (2 y' - z) with y' = 0.3 + y/2 in [0.3, 0.8]: the peak is y'^2 at y'.
    s = surface(lambda x, y, z: z * (2.0 * (0.3 + 0.5 * y) - z) + 0.0 * x)
    x, y, _ = points()
    lines, top = s.lines(x, y), 0.3 + 0.5 * y
    peak = lines.peak()
    np.testing.assert_allclose(peak.at, top, atol=1e-10)
    np.testing.assert_allclose(peak.value, top**2, atol=1e-13)
    level = 0.75 * top**2
    np.testing.assert_allclose(lines.first_rise(level, peak).at, 0.5 * top, atol=1e-12)
    assert np.isnan(lines.first_rise(1.01 * top**2, peak).at).all()


def test_the_first_of_several_rises_is_taken():
    # sin(4.5 pi z) + z rises through 0.5 three times before z = 1, where it is highest.
    f = lambda x, y, z: np.sin(4.5 * np.pi * z) + z + 0.0 * x * y  # noqa: E731
    lines = surface(f).lines(np.array([1.0]), np.array([0.5]))
    peak = lines.peak()
    assert peak.at[0] > 0.9
    z = np.linspace(0.0, 1.0, 100001)
    first = z[np.argmax(f(1.0, 0.5, z) >= 0.5)]
    assert abs(lines.first_rise(np.array([0.5]), peak).at[0] - first) < 2e-3
