from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from plant import ParameterError
from uncertainty.disks import smallest_disks


def only(points):
    disks = smallest_disks(np.asarray(points, dtype=complex)[:, None])
    return complex(disks.centers[0]), float(disks.radii[0])


def brute_force(points):
    """Least radius over all pairs and triples whose circle covers all points."""
    xy = np.column_stack((np.real(points), np.imag(points)))
    best = np.inf
    for i, j in combinations(range(len(xy)), 2):
        center = 0.5 * (xy[i] + xy[j])
        best = _covering(xy, center, np.linalg.norm(xy[i] - center), best)
    for triple in combinations(range(len(xy)), 3):
        a, b, c = xy[list(triple)]
        matrix = 2.0 * np.array([b - a, c - a])
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        center = np.linalg.solve(matrix, [b @ b - a @ a, c @ c - a @ a])
        best = _covering(xy, center, np.linalg.norm(a - center), best)
    return best


def _covering(xy, center, radius, best):
    covers = (np.linalg.norm(xy - center, axis=1) <= radius * (1.0 + 1e-9)).all()
    return min(best, radius) if covers else best


@pytest.mark.parametrize("seed", range(60))
def test_radius_is_that_of_all_pairs_and_triples(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=rng.integers(2, 10)) + 1j * rng.normal(size=1)
    points = points + 1j * rng.normal(size=points.size) * rng.choice([0.01, 1.0])
    center, radius = only(points)
    assert radius == pytest.approx(brute_force(points), rel=1e-9)
    assert np.abs(points - center).max() <= radius


def test_lattice_points_with_many_ties():
    points = np.array([x + 1j * y for x in range(5) for y in range(4)])
    center, radius = only(points)
    assert center == pytest.approx(2.0 + 1.5j)
    assert radius == pytest.approx(2.5)  # half the diagonal of 4 by 3


def test_known_shapes():
    center, radius = only(3.0 - 2.0j + 0.5 * np.exp(1j * np.linspace(0.0, 6.0, 101)))
    assert center == pytest.approx(3.0 - 2.0j, abs=1e-12)
    assert radius == pytest.approx(0.5, rel=1e-12)
    # Equilateral: side over sqrt(3). Obtuse: half the longest side.
    equilateral = [0.0, 1.0, 0.5 + 0.5j * np.sqrt(3.0)]
    assert only(equilateral)[1] == pytest.approx(1.0 / np.sqrt(3.0))
    assert only([0.0, 4.0, 1.0 + 0.5j]) == (pytest.approx(2.0), pytest.approx(2.0))
    # 3, 4, 5: half the hypotenuse
    assert only([0.0, 3.0, 4.0j]) == (pytest.approx(1.5 + 2.0j), pytest.approx(2.5))


def test_degenerate_sets():
    assert only([2.0 + 1.0j]) == (2.0 + 1.0j, 0.0)
    assert only([2.0 + 1.0j] * 7) == (2.0 + 1.0j, 0.0)
    line = (1.0 + 2.0j) * np.linspace(-1.0, 3.0, 23)
    center, radius = only(np.concatenate((line, line)))
    assert center == pytest.approx(1.0 + 2.0j)
    assert radius == pytest.approx(2.0 * np.sqrt(5.0))
    almost = line + 1e-15j * np.random.default_rng(0).normal(size=line.size)
    assert only(almost)[1] == pytest.approx(2.0 * np.sqrt(5.0))
    assert only([0.0, 1.0, 1.0 + 1e-16j, 1e-300j])[1] == pytest.approx(0.5)


@pytest.mark.parametrize("scale", [1e-150, 1e-9, 1.0, 1e9, 1e150])
def test_radius_scales_and_moves_with_the_samples(scale):
    rng = np.random.default_rng(5)
    points = rng.normal(size=50) + 1j * rng.normal(size=50)
    center, radius = only(points)
    moved = scale * (points * np.exp(0.7j) + 2.0 - 1.0j)
    assert only(moved)[1] == pytest.approx(scale * radius, rel=1e-11)
    assert only(moved)[0] == pytest.approx(scale * (center * np.exp(0.7j) + 2.0 - 1.0j), rel=1e-10)


def test_small_disk_far_from_the_origin():
    rng = np.random.default_rng(6)
    points = rng.normal(size=40) + 1j * rng.normal(size=40)
    assert only(1e6 + 1e-3 * points)[1] == pytest.approx(1e-3 * only(points)[1], rel=1e-6)


def test_the_minimax_problem_has_the_same_solution():
    rng = np.random.default_rng(7)
    points = rng.exponential(size=80) + 1j * rng.normal(size=80)
    center, radius = only(points)

    def slack(x):  # r^2 - |z - c|^2
        return x[2] - np.abs(points - x[0] - 1j * x[1]) ** 2

    found = minimize(
        lambda x: x[2],
        [points.real.mean(), points.imag.mean(), 50.0],
        method="SLSQP",
        constraints={"type": "ineq", "fun": slack},
        options={"ftol": 1e-13, "maxiter": 300},
    )
    assert found.success
    assert radius == pytest.approx(np.sqrt(found.x[2]), rel=1e-6)
    assert center == pytest.approx(found.x[0] + 1j * found.x[1], rel=1e-4)


def test_the_centre_is_in_the_hull_of_the_farthest_samples():
    # The optimality condition of the smallest disk, as a feasibility problem.
    rng = np.random.default_rng(8)
    points = rng.normal(size=(300, 20)) + 1j * rng.standard_t(3, size=(300, 20))
    disks = smallest_disks(points)
    for k in range(20):
        distance = np.abs(points[:, k] - disks.centers[k])
        rim = points[distance >= disks.radii[k] * (1.0 - 1e-9), k]
        hull = linprog(
            np.zeros(rim.size),
            A_eq=np.vstack((rim.real, rim.imag, np.ones(rim.size))),
            b_eq=[disks.centers[k].real, disks.centers[k].imag, 1.0],
        )
        assert hull.status == 0


def test_no_other_nominal_has_a_smaller_radius():
    rng = np.random.default_rng(9)
    points = rng.normal(size=(40, 12)) + 1j * rng.normal(size=(40, 12))
    disks = smallest_disks(points, np.arange(1.0, 13.0))
    for nominal in (points[0], points.mean(axis=0), np.median(points.real, axis=0), 0.2j):
        gain = disks.gain_over(nominal)
        assert (gain.ratio <= 1.0 + 1e-14).all()
        by_hand = [np.max(np.abs(points[:, k] - np.broadcast_to(nominal, 12)[k])) for k in (0, 7)]
        assert gain.nominal_radii[[0, 7]] == pytest.approx(by_hand)
    for shift in 1e-3 * np.exp(1j * np.linspace(0.0, 6.0, 9)):
        assert (disks.gain_over(disks.centers + shift).ratio < 1.0).all()
    assert disks.gain_over(disks.centers).ratio == pytest.approx(1.0)
    assert "times that about the nominal" in str(disks.gain_over(points[0]))


def test_a_sample_as_nominal_costs_at_most_twice_the_radius():
    disks = smallest_disks([[0.0, 5.0], [2.0, 5.0]])
    assert disks.gain_over([0.0, 5.0]).ratio.tolist() == [0.5, 1.0]


def test_relative_radius_and_sentence():
    disks = smallest_disks([[1.0, -1.0, 0.0], [3.0, 1.0, 0.0]], [1.0, 2.0, 3.0])
    assert disks.relative_radius.tolist() == [0.5, np.inf, 0.0]
    assert "2 samples at 3 frequencies" in str(disks)
    assert "at 2 rad/s" in str(disks)
    assert "frequency 0" in str(smallest_disks([[1.0], [3.0]]))


def test_frequency_response_data_of_the_centre():
    omega = np.array([0.5, 1.0, 2.0])
    gains = np.array([0.8, 1.0, 1.2])
    lag = 1.0 / (1.0 + 1j * omega)
    disks = smallest_disks(gains[:, None] * lag, omega)
    frd = disks.to_frd(dt=0.1)
    assert frd.dt == 0.1
    assert frd.omega == pytest.approx(omega)
    assert frd.frdata[0, 0] == pytest.approx(lag)
    assert disks.radii == pytest.approx(0.2 * np.abs(lag))


def test_the_disks_of_a_campaign_cover_all_and_are_held_by_two_at_least():
    rng = np.random.default_rng(10)
    points = rng.normal(size=(1200, 60)) + 1j * rng.normal(size=(1200, 60))
    disks = smallest_disks(points)
    distance = np.abs(points - disks.centers)
    assert (distance <= disks.radii).all()
    # One point alone on the rim would let the disk shrink.
    assert ((distance > disks.radii * (1.0 - 1e-9)).sum(axis=0) >= 2).all()


def test_plot_has_all_parts():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rng = np.random.default_rng(11)
    disks = smallest_disks(rng.normal(size=(10, 30)) + 1j * rng.normal(size=(10, 30)))
    ax = disks.plot(most=4)
    assert len(ax.lines) == 12
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["sample", "disk", "centre"]
    assert "4 of 30" in ax.get_title(loc="left")
    plt.close(ax.figure)


@pytest.mark.parametrize(
    ("responses", "omega", "words"),
    [
        ([1.0, 2.0], None, "hand in a column"),
        (np.zeros((0, 3)), None, "at least one of each"),
        ([[1.0, np.nan]], None, "sample 0 at frequency 1"),
        ([[1.0, 2.0]], [1.0], "2 finite and rising"),
        ([[1.0, 2.0]], [2.0, 1.0], "rising"),
    ],
)
def test_bad_input_is_named(responses, omega, words):
    with pytest.raises(ParameterError, match=words):
        smallest_disks(responses, omega)


def test_missing_frequencies_and_bad_nominal_are_named():
    disks = smallest_disks([[1.0, 2.0]])
    with pytest.raises(ParameterError, match="hand omega"):
        disks.to_frd()
    with pytest.raises(ParameterError, match="one for each frequency"):
        disks.gain_over([1.0, 2.0, 3.0])
