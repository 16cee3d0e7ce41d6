from types import SimpleNamespace

import control
import matplotlib as mpl
import numpy as np
import pytest

from camless_ctrl._closed_loop_runs import (
    LoopCase,
    at_speed,
    in_processes,
    sampled_cases,
    step_response,
)
from camless_ctrl._lti_members import random_all_passes, sensitivity_peaks, spectral_radii
from camless_ctrl._step_response import StepResponse, mode_growth
from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.mu import Delta, lft
from camless_ctrl.pulse_bank import PulseSum
from camless_ctrl.soundness import check_lti, check_sampled_plants
from camless_ctrl.uncertain_loop import REMAINDER, UncertainLoop
from camless_ctrl.uncertain_measurement import UncertainMeasurement, uncertain_measurement
from plant import CrankAnglePlant, MafSensor, ParameterError, PulseResponse
from uncertainty.parameters import UncertaintySet
from uncertainty.sampling import draw
from uncertainty.weights import fit_weight

mpl.use("Agg")

SPEED, N, T = 1500.0, 4, 0.02
GAIN = 0.4
NAME = "MAF gain error"


def ideal(size, remainder=1e-6):
    """Loop whose estimate is the charge times ``1 + size d``: each cylinder an integrator."""
    charge = PulseSum(((1.0, PulseResponse(T, 0, np.ones(1), 0.0)),))
    omega = np.linspace(0.0, np.pi, 9) / T
    measurement = UncertainMeasurement(
        local=SimpleNamespace(speed_rpm=SPEED, n_cylinders=N),
        demand=2.5e-4,
        estimator=ChargeEstimator(delay=0.0, taper=0.0),
        uncertain=UncertaintySet.sensors().only([NAME]),
        nominal=charge,
        centre=charge,
        directions={NAME: charge.scaled(size)},
        weight=fit_weight(omega, np.full(9, remainder), dt=T, orders=(0,)),
    )
    return UncertainLoop.adaptive(measurement, AdaptationGains(GAIN, GAIN))


@pytest.fixture(scope="module")
def plant():
    return CrankAnglePlant(runner=True, oscillation=True)


@pytest.fixture(scope="module")
def feedforward(charge_map):
    return Feedforward(charge_map)


@pytest.fixture(scope="module")
def measurement(plant, feedforward):
    return uncertain_measurement(
        plant, feedforward, 2.5e-4, SPEED, share=0.8, confidence=0.8, design=8, fresh=5
    )


def case(plant, feedforward, *, estimator=None, gains=(0.4, 0.4), delay=1e-3, speed=SPEED, **more):
    return LoopCase(
        plant,
        MafSensor(delay=delay).ideal(),
        at_speed(feedforward, speed),
        ChargeEstimator() if estimator is None else estimator,
        AdaptationGains(*gains),
        2.5e-4,
        speed,
        **{"cycles": 20, **more},
    )


# -- growth of a response ----------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_growth_of_a_known_series(noise):
    k = np.arange(100)
    turned = 0.9**0.25 * np.exp(0.5j * np.pi)
    series = 0.3 * 0.5 ** (k / 4) + 0.5 * (turned**k).real + 0.2 * (-1.0) ** k * 1.05 ** (k / 4)
    series = series + noise * np.random.default_rng(1).standard_normal(k.size)
    response = StepResponse(N, False, series)
    found = [response.growth(q) for q in response.modes]
    assert found == pytest.approx([0.5, 0.9, 1.05], abs=1e-6 if noise == 0.0 else 0.05)
    assert response.worst_growth[1] == 2
    assert not response.stable
    decaying = StepResponse(N, False, series * 0.8 ** (k / 4))
    assert decaying.stable
    assert decaying.worst_growth[0] == pytest.approx(0.84, abs=0.01)


def test_growth_of_a_mode_takes_its_own_poles_alone():
    poles = np.array([0.9, 0.8j, -0.8j, -0.5])
    assert [mode_growth(poles, q, 4) for q in range(3)] == pytest.approx([0.9**4, 0.8**4, 0.5**4])
    assert mode_growth(poles[:1], 2, 4) == 0.0


def test_held_differences_have_to_stay():
    cycles = np.arange(25)[:, None]
    mean = 0.25 * 0.6**cycles  # decays, the differences of one cylinder stay
    series = (mean + np.array([0.75, -0.25, -0.25, -0.25])).ravel()
    held = StepResponse(N, True, series)
    assert held.growth(1) == pytest.approx(1.0, abs=5e-3)
    assert held.stable
    assert not StepResponse(N, False, series).stable  # adapted differences should decay
    assert not StepResponse(N, True, series * np.repeat(1.02 ** np.arange(25), 4)).stable


def test_sensitivity_of_an_integrator_from_its_response():
    y = np.zeros(200)
    y[::N] = (1.0 - GAIN) ** np.arange(50)
    peak = StepResponse(N, False, y).sensitivity_peak
    assert peak == pytest.approx(2.0 / (2.0 - GAIN), rel=1e-4)  # at zeta = -1


def test_short_response_is_refused():
    with pytest.raises(ParameterError, match="run longer"):
        _ = StepResponse(N, False, np.ones(5)).poles


# -- linear members ----------------------------------------------------------------------------


def test_random_remainders_are_all_passes():
    numerator, denominator = random_all_passes(200, np.random.default_rng(3))
    z = np.exp(1j * np.array([0.3, 1.1, 2.9]))
    powers = z ** -np.arange(4)[:, None]
    response = (numerator @ powers) / (denominator @ powers)
    np.testing.assert_allclose(np.abs(response), 1.0, rtol=1e-9)
    assert np.ptp(np.angle(response[:, 1])) > 3.0  # phases all around
    assert all(np.all(np.abs(np.roots(row)) < 1.0) for row in denominator)


def test_members_of_the_ideal_loop_by_hand():
    deltas = np.array([[-1.0], [-0.3], [0.0], [0.6], [1.0]])
    none, one = np.zeros((5, 4)), np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))
    loop = ideal(5.0)
    seen = 1.0 + 5.0 * deltas[:, 0]
    radius = spectral_radii(loop, deltas, none, one)
    np.testing.assert_allclose(radius, np.abs(1.0 - GAIN * seen), atol=1e-6)
    peak = sensitivity_peaks(loop, deltas[2:3], none[:1], one[:1])
    assert peak[0] == pytest.approx(2.0 / (2.0 - GAIN), rel=1e-4)


def test_members_with_a_remainder_agree_with_the_transformation():
    loop = ideal(0.5, remainder=0.3)
    numerator, denominator = random_all_passes(12, np.random.default_rng(5))
    deltas = np.random.default_rng(6).uniform(-1.0, 1.0, (12, 1))
    radius = spectral_radii(loop, deltas, numerator, denominator)
    peak = sensitivity_peaks(loop, deltas, numerator, denominator)
    angle = np.pi * (np.arange(721) + 0.5) / 721
    for k in range(12):
        own = control.ss(control.tf(numerator[k], denominator[k], T))
        both = control.append(control.ss([], [], [], [[deltas[k, 0]]], T), own)
        closed = lft(loop.system, both)
        assert np.max(np.abs(closed.poles())) ** N == pytest.approx(radius[k], rel=1e-4)
        if radius[k] < 1.0:
            gains = np.abs(closed(np.exp(1j * angle))) * loop.sensitivity_bound
            assert gains.max() == pytest.approx(peak[k], rel=1e-6)


def test_unstable_members_are_counted():
    found = check_lti(ideal(5.0), samples=200, seed=2)  # stable for -0.2 < d < 0.8 alone
    assert found.unstable >= 100  # all corners, and some of the others
    assert 0.3 < (found.unstable - 100) / 100 < 0.7
    assert found.violations == found.unstable + found.beyond
    assert np.all(np.isnan(found.peak[~(found.radius < 1.0)]))
    assert "unstable" in str(found)


def test_bound_of_the_sensitivity_is_tight_and_kept():
    worst = 2.0 / (2.0 - 1.5 * GAIN)  # at d = 1
    loop = ideal(0.5)
    assert check_lti(loop, samples=100, seed=1, bound=1.001 * worst).violations == 0
    beyond = check_lti(loop, samples=100, seed=1, bound=0.999 * worst)
    assert beyond.unstable == 0
    assert beyond.beyond >= 10  # every other member is at a corner


def test_members_of_the_measured_loop(measurement):
    loop = UncertainLoop.adaptive(measurement, AdaptationGains(0.4, 0.4))
    found = check_lti(loop, samples=300, seed=4)
    assert found.violations == 0
    again = check_lti(loop, samples=300, seed=4)
    np.testing.assert_array_equal(found.radius, again.radius)
    assert not np.array_equal(found.radius, check_lti(loop, samples=300, seed=5).radius)
    fast = UncertainLoop.adaptive(measurement, AdaptationGains(3.0, 3.0))
    assert check_lti(fast, samples=50, seed=4).unstable == 50


def test_radius_of_the_measured_loop_for_real_values(measurement):
    loop = UncertainLoop.adaptive(measurement, AdaptationGains(0.4, 0.2))
    names = list(measurement.directions)
    deltas = np.random.default_rng(8).uniform(-1.0, 1.0, (3, len(names)))
    none, one = np.zeros((3, 4)), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    for row, radius in zip(deltas, spectral_radii(loop, deltas, one, one), strict=True):
        values = dict(zip(names, row.tolist(), strict=True)) | {REMAINDER: 1.0}
        poles = lft(loop.system, Delta(loop.structure, values)).poles()
        assert np.max(np.abs(poles)) ** N == pytest.approx(radius, rel=1e-6)
    alone = spectral_radii(loop, deltas, none, one)
    wanted = [loop.spectral_radius(dict(zip(names, row.tolist(), strict=True))) for row in deltas]
    np.testing.assert_allclose(alone, wanted, rtol=1e-6)


# -- full plants -------------------------------------------------------------------------------


def test_default_schedule_has_no_violation(measurement, feedforward):
    found = check_sampled_plants(
        [measurement], feedforward, samples=3, cycles=16, seed=11, processes=1
    )
    assert len(found.runs) == 3
    assert found.violations == ()
    # The description without its remainder comes close to each plant.
    for run in found.runs:
        assert run.worst_growth == pytest.approx(run.predicted_radius, abs=0.12)
        assert 1.0 < run.peak < 1.6
    assert "0 unstable" in str(found)
    assert found.plot().get_xlabel()


def test_samples_follow_from_the_seed_in_any_number_of_processes(measurement, feedforward):
    options = {"samples": 2, "cycles": 8}
    one = check_sampled_plants([measurement], feedforward, seed=1, processes=1, **options)
    two = check_sampled_plants([measurement], feedforward, seed=1, processes=2, **options)
    other = check_sampled_plants([measurement], feedforward, seed=2, processes=1, **options)
    assert one.runs == two.runs
    assert one.runs != other.runs


def test_corners_are_run_once_each(measurement, feedforward):
    found = check_sampled_plants([measurement], feedforward, at_corners=True, cycles=6, processes=1)
    names = list(measurement.directions)
    assert names == ["temperature", "flow coefficient", "MAF time constant", "MAF delay"]
    assert len(found.runs) == 2**4
    assert len({tuple(run.values[name] for name in names) for run in found.runs}) == 2**4
    assert all(run.values["exhaust pressure"] == 1.0 for run in found.runs)
    assert all(run.values["MAF gain error"] == 0.0 for run in found.runs)
    assert found.violations == ()


def test_gains_that_are_too_high_are_violations(measurement, feedforward):
    found = check_sampled_plants(
        [measurement],
        feedforward,
        GainSchedule.constant(3.0, 3.0),
        samples=1,
        cycles=12,
        processes=1,
    )
    assert found.unstable == 1
    assert "violation" in str(found)


def test_bound_that_is_too_low_is_a_violation(measurement, feedforward):
    found = check_sampled_plants(
        [measurement], feedforward, samples=1, cycles=12, bounds={SPEED: 1.01}, processes=1
    )
    assert found.unstable == 0
    assert len(found.violations) == 1


@pytest.mark.parametrize(("delay", "stable"), [(1e-3, True), (15e-3, False)])
def test_delay_decides_on_the_full_plant(plant, feedforward, delay, stable):
    response = step_response(case(plant, feedforward, delay=delay))
    assert response.stable == stable
    assert (response.worst_growth[0] < 1.0) == stable


def test_held_differences_stay_on_the_full_plant(plant, feedforward):
    response = step_response(case(plant, feedforward, gains=(0.4, 0.0)))
    assert response.held
    assert response.stable
    assert [response.growth(q) for q in (1, 2)] == pytest.approx([1.0, 1.0], abs=5e-3)
    assert response.growth(0) < 0.9


def test_demand_out_of_reach_is_refused(plant, feedforward):
    far = LoopCase(
        plant,
        MafSensor().ideal(),
        at_speed(feedforward, SPEED),
        ChargeEstimator(),
        AdaptationGains(0.4, 0.4),
        9e-4,
        SPEED,
    )
    with pytest.raises(ParameterError, match="lower the demand"):
        step_response(far)


def test_cylinders_that_differ_are_refused(plant, feedforward, measurement):
    sample = draw(UncertaintySet.cylinders(4), 1, 0)
    with pytest.raises(ParameterError, match="cylinders"):
        sampled_cases(measurement, feedforward, GainSchedule(), sample, plant, 10)


def test_table_of_one_speed_is_the_feedforward_itself(feedforward):
    small = at_speed(feedforward, SPEED)
    for charge in (1.5e-4, 2.5e-4, 3.5e-4):
        assert small.command(charge, SPEED) == feedforward.command(charge, SPEED)
        assert small.sensitivity(charge, SPEED) == feedforward.sensitivity(charge, SPEED)


def test_progress_counts_every_item():
    told = []
    assert in_processes(abs, [-1, 2, -3], 1, lambda done, total: told.append((done, total))) == [
        1,
        2,
        3,
    ]
    assert told == [(1, 3), (2, 3), (3, 3)]
