import math

import matplotlib as mpl
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.confirmation import check_growth, check_plants
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.linearise import LocalResponse, local_response
from camless_ctrl.measurement_response import FlowShape
from camless_ctrl.requirements import evaluate
from camless_ctrl.robustness import SPEEDS_RPM, analyse, analyse_point
from plant import CrankAnglePlant, ValveCommand

mpl.use("Agg")


@pytest.fixture(scope="module")
def results(charge_map):
    return {result.speed_rpm: result for result in analyse(charge_map)}


@pytest.fixture(scope="module")
def adapting(charge_map):
    """Loops whose imbalance modes are adapted at every speed, to show where that breaks."""
    gains = GainSchedule(
        (750.0, 1500.0, 3000.0, 6000.0), (0.4, 0.4, 0.3, 0.2), (0.4, 0.4, 0.2, 0.08)
    )
    return {result.speed_rpm: result for result in analyse(charge_map, gains=gains)}


def even(sensitivity=1.0, speed_rpm=1500.0):
    return LocalResponse(
        speed_rpm, 4, ValveCommand(3.0, 100.0), 2e-4, 1.0, sensitivity, FlowShape.even()
    )


def test_ideal_loop_by_hand():
    # Matched, untapered: every mode is the integrator kappa/(zeta - 1) of its cylinder.
    estimator = ChargeEstimator(taper=0.0)
    result = analyse_point(even(), 2e-4, estimator, AdaptationGains(0.4, 0.4), 0.3)
    assert result.stable
    for mode in result.modes:
        assert mode.spectral_radius == pytest.approx(0.6, abs=1e-9)
        assert mode.margins.gain_margin == pytest.approx(5.0, rel=1e-6)
        assert mode.small_gain == pytest.approx(0.3, rel=1e-6)  # |T| peaks at 1, at zero
    assert result.withstands_gain_error
    assert "withstood" in str(result)


def test_unstable_loop_gets_no_margin():
    result = analyse_point(even(), 2e-4, ChargeEstimator(), AdaptationGains(2.5, 2.5), 0.1)
    assert not result.stable
    assert math.isnan(result.disk_margin)
    assert not result.withstands_gain_error
    assert "unstable" in str(result)
    assert not evaluate("loop-disk-margin", result.disk_margin).met


def test_gain_error_beyond_one_is_not_withstood():
    result = analyse_point(even(), 2e-4, ChargeEstimator(), AdaptationGains(0.4, 0.4), 1.1)
    assert result.stable
    assert not result.withstands_gain_error


def test_nominal_loop_is_stable_with_margin_at_all_speeds(results):
    assert tuple(results) == SPEEDS_RPM
    for result in results.values():
        assert result.stable
        assert evaluate("loop-gain-margin", result.gain_margin).met
        assert evaluate("loop-disk-margin", result.disk_margin).met
        assert result.withstands_gain_error


def test_boundary_of_the_alternating_mode_falls_with_speed(adapting):
    limits = [adapting[speed].delay_limit for speed in SPEEDS_RPM]
    assert limits == sorted(limits, reverse=True)
    assert all(adapting[speed].delay_limit_mode == 2 for speed in SPEEDS_RPM)
    # up to 4500 rpm the assumed range of lag and delay is withstood, at 6000 rpm it is not
    assert [adapting[speed].withstands_sensor for speed in SPEEDS_RPM] == [True] * 4 + [False]
    assert "NOT stable at every lag and delay" in str(adapting[6000.0])


def test_held_imbalance_leaves_nothing_to_destabilise(results, charge_map):
    result = results[6000.0]
    assert [mode.held for mode in result.modes] == [False, True, True]
    assert result.robustly_stable
    # at a delay with which adapting it diverges, a held imbalance neither grows nor decays
    growth = check_growth(result, charge_map, 2, delay=3e-3, cycles=20)
    assert growth.simulated == pytest.approx(1.0, abs=2e-3)


def test_worst_of_the_sweep_is_in_the_sweep(adapting):
    result = adapting[6000.0]
    radius, tau, delay = result.worst
    error, nominal = result.sensitivity_error, result.local.sensitivity
    loops = [
        result.loop(time_constant=tau, delay=delay, sensitivity=gain * nominal)
        for gain in (1.0 - error, 1.0, 1.0 + error)
    ]
    assert max(np.max(np.abs(loop.poles())) ** 4 for loop in loops) == pytest.approx(radius)


def test_plain_event_averages_are_found_unstable(charge_map):
    (result,) = analyse(charge_map, [3000.0], estimator=ChargeEstimator.event_average())
    assert not result.stable
    unstable = [mode.q for mode in result.modes if mode.spectral_radius >= 1.0]
    assert 2 in unstable
    assert 0 not in unstable
    growth = check_growth(result, charge_map, 2)
    assert growth.simulated > 1.0
    assert growth.simulated == pytest.approx(growth.predicted, abs=0.01)


@pytest.mark.parametrize("beyond", [-0.5e-3, 0.5e-3])
def test_full_plant_breaks_where_predicted(adapting, charge_map, beyond):
    result = adapting[6000.0]
    growth = check_growth(result, charge_map, 2, delay=result.delay_limit + beyond)
    assert growth.agrees
    assert (growth.simulated > 1.0) == (beyond > 0.0)
    assert growth.simulated == pytest.approx(growth.predicted, abs=0.01)


@pytest.mark.parametrize("share", [0.85, 1.15])
def test_full_plant_breaks_at_the_gain_margin(results, charge_map, share):
    result = results[1500.0]
    growth = check_growth(result, charge_map, 1, gain_factor=share * result.gain_margin, cycles=30)
    assert growth.agrees
    assert (growth.simulated > 1.0) == (share > 1.0)


def test_sampled_plants_settle_as_predicted(results, charge_map):
    chosen = [results[1500.0], results[4500.0]]
    checks = check_plants(chosen, charge_map, samples=1, cycles=60, seed=1)
    assert len(checks) == 2
    assert all(check.agrees and check.settled for check in checks)
    (again,) = check_plants(chosen[:1], charge_map, samples=1, cycles=60, seed=1)
    assert again == checks[0]


def test_sampled_plant_outside_the_boundary_does_not_settle(charge_map):
    (result,) = analyse(charge_map, [3000.0], estimator=ChargeEstimator.event_average())
    (check,) = check_plants([result], charge_map, samples=1, cycles=60, seed=0)
    assert check.predicted_radius > 1.0
    assert not check.settled
    assert check.agrees


def test_corrections_flow_in_around_closing(charge_map):
    plant = CrankAnglePlant(runner=False)
    local = local_response(plant, Feedforward(charge_map), 2.5e-4, 1500.0)
    assert local.charge == pytest.approx(2.5e-4, rel=1e-3)
    assert local.sensitivity == pytest.approx(1.0, abs=0.03)  # the map is this plant's own
    # Air that a later closing lets in flows between the old and the new falling flank.
    closing = local.command.duration_deg / 180.0
    assert closing - 0.2 < local.shape.centre < closing


def test_plot_shows_all_modes(results):
    ax = results[3000.0].plot()
    labels = {text.get_text() for text in ax.get_legend().get_texts()}
    assert {"mean", "imbalance q=1", "imbalance q=2"} <= labels
