import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear

from camless_ctrl._gain_search import GainSearch
from camless_ctrl._rank_one import (
    RankOneLoop,
    UncertainValues,
    distance_from_one,
    largest_real,
    mode_grid,
)
from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.gain_synthesis import MU_LIMIT, design_gains, design_schedule, vanishing_modes
from camless_ctrl.mu import (
    Delta,
    lft,
    mu_upper,
    robust_performance,
    robust_stability,
    worst_case_gain,
)
from camless_ctrl.nominal_loop import NominalLoop
from camless_ctrl.synthesis import SynthesisError
from camless_ctrl.uncertain_loop import REMAINDER, UncertainLoop
from plant import ParameterError


@pytest.fixture(scope="module")
def slow(measured):
    return measured(1500.0)


@pytest.fixture(scope="module")
def fast(measured):
    return measured(6000.0)


@pytest.fixture(scope="module")
def design(slow):
    return design_gains(slow)


def random_samples(loop, count, seed):
    """Members of the set: real parameters anywhere, the remainder an all-pass of size 1."""
    rng = np.random.default_rng(seed)
    T = loop.measurement.event_time
    for _ in range(count):
        values = dict(zip(loop.measurement.directions, rng.uniform(-1.0, 1.0, 3), strict=True))
        values[REMAINDER] = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi))
        yield Delta(loop.structure, values).realise(float(rng.uniform(0.05, 3.1)) / T, T)


def random_segments(seed, count=5):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 40)) + 1j * rng.normal(size=(count, 40))


def test_largest_real_number_of_a_zonotope_is_that_of_a_linear_program():
    segments = 0.5 * random_segments(1)
    found = largest_real(segments, np.zeros(40))
    for c, value in zip(segments.T, found, strict=True):
        best = linprog(-c.real, A_eq=c.imag[None], b_eq=[0.0], bounds=[(-1.0, 1.0)] * 5)
        assert value == pytest.approx(-best.fun, rel=1e-8)


def test_disk_alone_and_parallel_segments_have_known_values():
    nothing = np.zeros((2, 1), dtype=complex)
    assert largest_real(nothing, np.array([0.7]))[0] == pytest.approx(0.7)
    real = np.array([[0.3 + 0j], [-0.2 + 0j]])
    assert largest_real(real, np.array([0.1]))[0] == pytest.approx(0.6)
    across = np.array([[0.3j], [0.2j]])  # across the axis, 0.5 long: no help to the disk
    assert largest_real(across, np.array([0.1]))[0] == pytest.approx(0.1)
    assert distance_from_one(real)[0] == pytest.approx(0.5)
    assert distance_from_one(across)[0] == pytest.approx(1.0)
    assert distance_from_one(4.0 * real)[0] == 0.0


def test_distance_from_one_is_that_of_bounded_least_squares():
    segments = 0.35 * random_segments(2)
    found = distance_from_one(segments)
    for c, value in zip(segments.T, found, strict=True):
        best = lsq_linear(np.vstack((c.real, c.imag)), [1.0, 0.0], (-1.0, 1.0), tol=1e-14)
        assert value == pytest.approx(np.sqrt(2.0 * best.cost), abs=1e-5)
    assert np.any(found == 0.0)
    assert np.any(found > 0.1)


@pytest.mark.parametrize("gains", [AdaptationGains(0.4, 0.4), AdaptationGains(0.9, 0.6)])
def test_closed_form_of_mu_and_of_worst_sensitivity_is_that_of_mu_analysis(slow, gains):
    loop = UncertainLoop.adaptive(slow, gains)
    angle = mode_grid(4)
    one = RankOneLoop.of_law(UncertainValues.of(slow, angle), loop.law)
    stability = robust_stability(loop.system, loop.structure)
    performance = robust_performance(loop.system, loop.structure)
    assert one.mu_stability().max() == pytest.approx(stability.peak_upper, rel=0.01)
    assert one.mu_performance(2.0).max() == pytest.approx(performance.peak_upper, rel=0.01)
    worst = worst_case_gain(loop.system, loop.structure)
    assert one.worst_sensitivity().max() == pytest.approx(2.0 * worst.peak_lower, rel=0.01)
    # And at single frequencies, below the peak.
    some = angle[[5, 40, 90]]
    values = loop.system(np.exp(1j * some))
    inner = np.moveaxis(np.atleast_3d(values), 2, 0)[:, :4, :4]
    upper = np.array([mu_upper(M, loop.structure).value for M in inner])
    np.testing.assert_allclose(one.mu_stability()[[5, 40, 90]], upper, rtol=0.01)


def test_design_is_proved_and_five_per_cent_more_gain_breaks_what_it_names(slow, design):
    assert design.confirmation is not None
    assert design.confirmation.robust is True
    assert design.limit == "robust performance"
    more = UncertainLoop.adaptive(slow, design.gains.scaled(1.05))
    assert robust_performance(more.system, more.structure).peak_lower > 1.0
    assert design.worst_sensitivity < 2.0


def test_no_robust_pair_of_gains_on_a_grid_settles_faster(slow, design):
    values = UncertainValues.of(slow, mode_grid(4))
    total = sum(design.time_constants)
    better = 0
    for mean, imbalance in itertools.product(np.linspace(0.2, 1.4, 9), np.linspace(0.2, 1.2, 9)):
        loop = UncertainLoop.adaptive(slow, AdaptationGains(mean, imbalance))
        if not loop.stable:
            continue
        mu = RankOneLoop.of_law(values, loop.law).mu_performance(2.0).max()
        turn = np.abs(np.angle(loop.poles)) * 2.0 / np.pi
        slowest = [np.abs(loop.poles)[turn <= 0.575].max(), np.abs(loop.poles)[turn >= 0.425].max()]
        faster = np.sum(-0.25 / np.log(slowest)) < total
        better += bool(faster)
        assert not (faster and mu <= MU_LIMIT)
    assert better  # only the constraint stands in their way


def test_differences_are_held_where_the_measurement_can_vanish(slow, fast):
    def least(m, q):
        """Smallest |E| over the real parameters, by bounded least squares."""
        z = np.exp(0.5j * np.pi * q)
        c = np.array([h(z) for h in m.directions.values()])
        e = complex(m.centre(z))
        best = lsq_linear(np.vstack((c.real, c.imag)), [-e.real, -e.imag], (-1.0, 1.0))
        return np.sqrt(2.0 * best.cost) - float(m.weight.magnitude(0.5 * np.pi * q / m.event_time))

    for m in (slow, fast):
        assert vanishing_modes(m) == tuple(q for q in (1, 2) if least(m, q) <= 0.0)
    assert vanishing_modes(slow) == ()
    assert 2 in vanishing_modes(fast)
    design = design_gains(fast, confirm=False)
    assert design.held
    assert design.gains.mean > 0.2
    assert "held" in str(design)
    # All poles are then the mean's, at whatever angle they lie.
    for gain in (design.gains.mean, 3.0):
        loop = UncertainLoop.adaptive(fast, AdaptationGains(gain, 0.0))
        radius = np.abs(NominalLoop.of_uncertain_loop(loop).poles).max()
        tau = GainSearch(fast, 2.0, 0.99).time_constants(np.array([gain]), np.array([0.0]))
        assert tau[0] == pytest.approx(-1.0 / (4.0 * np.log(radius)), rel=1e-9)
    # A small gain is unstable for some member of the set.
    loop = UncertainLoop.adaptive(fast, AdaptationGains(design.gains.mean, 0.02))
    corners = itertools.product((-1.0, 1.0), repeat=4)
    names = loop.structure.names
    assert any(loop.spectral_radius(dict(zip(names, d, strict=True))) > 1.0 for d in corners)


def test_members_of_the_set_are_stable_and_within_the_bound(design):
    loop = design.loop
    z = np.exp(1j * mode_grid(4))
    for delta in random_samples(loop, 200, seed=3):
        closed = lft(loop.system, delta)
        assert np.abs(np.linalg.eigvals(closed.A)).max() < 1.0
        assert np.abs(closed(z)).max() * loop.sensitivity_bound < 2.0


def test_stricter_bound_gives_smaller_gains(slow, design):
    strict = design_gains(slow, sensitivity_bound=1.6, confirm=False)
    assert strict.worst_sensitivity < 1.6
    assert sum(strict.time_constants) > sum(design.time_constants)


def test_bound_that_no_loop_can_meet_is_refused(slow):
    with pytest.raises(SynthesisError, match="no gain keeps"):
        design_gains(slow, sensitivity_bound=0.9, confirm=False)


def test_schedule_holds_the_differences_at_once_and_compares(measured, slow, fast):
    middle = measured(3000.0)
    found = design_schedule([fast, slow, middle], confirm=False)
    assert [d.speed_rpm for d in found.designs] == [1500.0, 3000.0, 6000.0]
    for d in found.designs:
        assert found.schedule.at(d.speed_rpm).mean == pytest.approx(d.gains.mean)
        assert found.schedule.at(d.speed_rpm).imbalance == pytest.approx(d.gains.imbalance)
    last = max(d.speed_rpm for d in found.designs if not d.held)
    assert found.schedule.at(1.03 * last).imbalance == 0.0
    # The present gains at 1500 rpm, by mu analysis.
    loop = UncertainLoop.adaptive(slow, GainSchedule().at(1500.0))
    mu = robust_performance(loop.system, loop.structure).peak_upper
    assert found.present_mu[0] == pytest.approx(mu, rel=0.01)
    assert len(str(found).splitlines()) == 5
    assert found.plot().get_xlabel() == "speed (rpm)"


def test_best_estimator_is_taken_and_speeds_must_agree(slow):
    # Less uncertainty under another estimator's name: it must be preferred.
    sure = {name: h.scaled(0.5) for name, h in slow.directions.items()}
    other = replace(slow, estimator=ChargeEstimator(taper=1e-3), directions=sure)
    found = design_schedule([slow, other], confirm=False)
    assert found.estimator.taper == 1e-3
    assert len(found.estimators) == 2
    with pytest.raises(ParameterError, match="one a speed"):
        design_schedule([slow, slow], confirm=False)
