import math
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest

from camless_ctrl._closed_loop_runs import sampled_cases, step_response, widened
from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.pulse_bank import PulseSum
from camless_ctrl.tightness import FARTHEST, _Walk, check_tightness, gain_factor_for, physical
from camless_ctrl.uncertain_measurement import UncertainMeasurement, uncertain_measurement
from plant import CrankAnglePlant, ParameterError, PulseResponse
from uncertainty.parameters import UncertaintySet
from uncertainty.sampling import Sample
from uncertainty.weights import fit_weight

mpl.use("Agg")

SPEED = 3000.0
T = 0.01
GAINS = AdaptationGains(0.3, 0.2)


@pytest.fixture(scope="module")
def feedforward(charge_map):
    return Feedforward(charge_map)


@pytest.fixture(scope="module")
def measurement(feedforward):
    return uncertain_measurement(
        CrankAnglePlant(runner=True, oscillation=True),
        feedforward,
        2.5e-4,
        SPEED,
        share=0.8,
        confidence=0.8,
        design=8,
        fresh=5,
    )


@pytest.fixture(scope="module")
def result(measurement, feedforward):
    return check_tightness(measurement, feedforward, GAINS, cycles=30)


def ideal(size):
    """Measurement that shows the charge times ``1 + size d``, d the gain error in its bounds."""
    charge = PulseSum(((1.0, PulseResponse(T, 0, np.ones(1), 0.0)),))
    return UncertainMeasurement(
        local=SimpleNamespace(speed_rpm=SPEED, n_cylinders=4),
        demand=2.5e-4,
        estimator=ChargeEstimator(delay=0.0, taper=0.0),
        uncertain=UncertaintySet.sensors().only(["MAF gain error"]),
        nominal=charge,
        centre=charge,
        directions={"MAF gain error": charge.scaled(size)},
        weight=fit_weight(np.linspace(0.0, np.pi, 9) / T, np.full(9, 1e-6), dt=T, orders=(0,)),
    )


@pytest.mark.parametrize("target", [0.7, 1.3])
def test_gains_of_the_ideal_loop_by_hand(target):
    # An integrator per cylinder breaks at a loop gain of 2.
    factor = gain_factor_for(ideal(0.5), AdaptationGains(0.4, 0.4), target)
    assert factor == pytest.approx(2.0 / (1.0 + 0.5 * target) / 0.4, rel=2e-3)


def test_target_out_of_reach_is_refused():
    # Beyond d = 2 the gain turns its sign: no gains are stable there.
    with pytest.raises(ParameterError, match="smaller target"):
        gain_factor_for(ideal(0.5), AdaptationGains(0.4, 0.4), 2.5)
    with pytest.raises(ParameterError, match="above 0"):
        gain_factor_for(ideal(0.5), AdaptationGains(0.0, 0.0), 0.9)


def test_parameters_stay_physical(measurement):
    direction = {"MAF delay": -1.0, "MAF time constant": -1.0}
    deltas, held = physical(measurement, direction, 0.9)
    assert held == ()
    assert deltas["MAF delay"] == pytest.approx(-0.9)
    deltas, held = physical(measurement, direction, 3.5)
    values = measurement.values(deltas)
    assert held == ("MAF delay", "MAF time constant")
    assert values["MAF delay"] == pytest.approx(0.0, abs=1e-12)
    assert values["MAF time constant"] == pytest.approx(1e-3)


def test_full_plant_breaks_near_the_prediction(result):
    assert result.predicted == pytest.approx(0.9, rel=0.1)  # what the gains were scaled to
    assert result.tight
    # Too high a gain: the error overshoots, and changes sign from cycle to cycle.
    assert result.predicted_turns % 1.0 == pytest.approx(0.5, abs=0.1)
    assert result.simulated_turns % 1.0 == pytest.approx(0.5, abs=0.1)
    assert max(abs(value) for value in result.direction.values()) == 1.0


def test_break_is_bracketed_by_runs(result):
    worst = result.growth.max(axis=1)
    below, above = result.scales < result.simulated, result.scales > result.simulated
    assert np.all(worst[below] < 1.0)
    assert np.all(worst[above] >= 1.0)
    assert result.scales[above][0] / result.scales[below][-1] < 1.03
    # The real parameters alone leave more than they do together with the remainder.
    assert result.stability.margin < result.real_margin
    assert result.real_margin <= result.predicted * 1.01


def test_plant_beyond_the_break_diverges_and_one_inside_does_not(result, measurement, feedforward):
    schedule = GainSchedule.constant(result.gains.mean, result.gains.imbalance)
    for scale, stable in ((0.8, True), (1.25, False)):
        deltas, _ = physical(measurement, result.direction, scale * result.simulated)
        values = measurement.values(deltas)
        uncertain = widened(measurement.uncertain, values)
        row = [values.get(p.name, p.nominal) for p in uncertain]
        plant = CrankAnglePlant(runner=True, oscillation=True)
        sample = Sample(uncertain, np.array([row]))
        (case,) = sampled_cases(measurement, feedforward, schedule, sample, plant, 30)
        assert step_response(case).stable == stable


def test_result_prints_and_plots(result):
    text = str(result)
    assert "ratio" in text
    assert "MAF delay" in text
    labels = {entry.get_text() for entry in result.plot().get_legend().get_texts()}
    assert {"mean, predicted", "mean, full plant", "q=2, full plant"} <= labels


def test_gains_in_service_that_never_break_are_refused(measurement, feedforward):
    with pytest.raises(ParameterError, match=f"within {FARTHEST:g} times"):
        check_tightness(measurement, feedforward, AdaptationGains(0.02, 0.0), target=None)


def test_unstable_middle_is_refused(measurement, feedforward):
    with pytest.raises(ParameterError, match="unstable in the middle"):
        check_tightness(measurement, feedforward, AdaptationGains(3.0, 3.0), target=None)


def test_widened_set_holds_the_values(measurement):
    found = widened(measurement.uncertain, {"MAF delay": 5e-3, "temperature": 1.0})
    assert found["MAF delay"].high == 5e-3
    assert found["temperature"] == measurement.uncertain["temperature"]
    assert math.isclose(found["MAF delay"].low, measurement.uncertain["MAF delay"].low)


@pytest.mark.parametrize(
    ("growth", "distance"),
    [
        (lambda scale: 0.5 + 0.5 * scale / 0.8, 0.8),
        (lambda scale: 0.5 + 0.5 * scale / 1.3, 1.3),
        (lambda scale: 0.9, math.inf),
        (lambda scale: 1.1, 0.0),  # unstable all the way down: the search ends
    ],
)
def test_the_search_on_the_plant_finds_where_a_known_growth_is_one(growth, distance):
    class Known(_Walk):
        def __init__(self):
            self.runs = {}

        def full(self, scale):
            self.runs[scale] = np.array([0.3, growth(scale)])
            return self.runs[scale]

    assert Known().simulated(1.0, None) == pytest.approx(distance, rel=1e-9)
