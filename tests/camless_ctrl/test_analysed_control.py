from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl._closed_loop_runs import step_response
from camless_ctrl._model_cases import model_cases
from camless_ctrl._step_response import mode_growth
from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.adaptation_stability import moved_charge
from camless_ctrl.analysed_control import DesignedControl
from camless_ctrl.controller import AirChargeController
from camless_ctrl.controller_design import ControllerDesign
from camless_ctrl.event_data import ChargeEvidence
from camless_ctrl.gradient_adaptation import GradientAdaptation
from camless_ctrl.integral_adaptation import IntegralAdaptation
from camless_ctrl.kalman_adaptation import KalmanAdaptation
from camless_ctrl.robust_analysis import analyse_robustness
from camless_ctrl.uncertain_loop import UncertainLoop, adaptation_law
from plant import ParameterError
from uncertainty.sampling import nominal_sample

N, LATENCY, T = 4, 3, 0.02
DEMAND = 250e-6
MEASURED = SimpleNamespace(n_cylinders=N, latency=LATENCY, event_time=T)
NO_OFFSET = {"individual_offset": 1e-9, "common_offset": 0.0, "offset_walk": 1e-12}


@pytest.fixture(scope="module")
def design(high_lift):
    controller = AirChargeController(high_lift.model, high_lift.estimator, KalmanAdaptation())
    return ControllerDesign(high_lift.plant.engine, None, None, high_lift.model, controller)


@pytest.fixture(scope="module")
def analysis(design, high_lift):
    return analyse_robustness(
        design,
        (high_lift.speed_rpm,),
        adaptation=IntegralAdaptation(GainSchedule.constant(0.35, 0.3)),
        samples=3,
        processes=1,
    )


def converged(law, variance, slope, cycles=500):
    state = law.start(N)
    for k in range(N * cycles):
        cylinder = k % N + 1
        evidence = ChargeEvidence(
            cylinder, 0.0, variance, np.nan, slope, 0.0, state.of(cylinder), 1500.0
        )
        state = law.update(state, evidence).state
    return state


def test_kalman_law_is_an_integral_correction_with_its_steady_gains():
    # The law itself event by event: each error is told against what the command used.
    slope, variance = 0.5, 1e-4
    law = KalmanAdaptation(**NO_OFFSET, flow_walk=2e-3, common_flow_walk=4e-3, gate=50.0)
    law = law.replace(common_offset_walk=1e-12)
    state = converged(law, variance, slope)
    gains = law.steady_gains(variance, slope, N)
    assert gains.mean > 1.5 * gains.imbalance
    errors = 1e-4 * np.random.default_rng(0).standard_normal(120)
    used, moved = {}, []
    for k, error in enumerate(errors):
        of = k - LATENCY
        if of >= 0:
            cylinder = of % N + 1
            told = ChargeEvidence(cylinder, error, variance, np.nan, slope, 0.0, used[of], 1500.0)
            state = law.update(state, told).state
        used[k] = state.of(k % N + 1)
        moved.append(slope * np.log(used[k].flow_gain) + np.log(used[k].charge_factor))
    known = np.where(np.arange(errors.size) < LATENCY, 0.0, errors)
    A, B, C, D = (np.asarray(getattr(adaptation_law(MEASURED, gains), m)) for m in "ABCD")
    x, found = np.zeros((len(A), 1)), []
    for error in known:
        found.append(float((C @ x + D * error).item()))
        x = A @ x + B * error
    gap = np.abs(np.array(found) - moved).max() / np.abs(moved).max()
    assert gap < 0.04  # the gains are those of a cycle, not of an event


def test_gains_of_the_kalman_law_are_those_it_moves_charges_with(design, high_lift):
    law = KalmanAdaptation(**NO_OFFSET, common_offset_walk=1e-12)
    control = DesignedControl(high_lift.plant, design, law)
    point = high_lift.model.inverse(DEMAND, high_lift.speed_rpm)
    measured = SimpleNamespace(demand=DEMAND, speed_rpm=high_lift.speed_rpm, n_cylinders=N)
    gains = control.gains(measured)
    # Estimate: noise of half a per cent at this speed; half of 0.05 ms of jitter is not measured.
    deviation = control._loops(measured).nominal.deviation
    assert 1e-3 < deviation < 0.02
    variance = deviation**2 + 0.5 * (point.duration_slope * 0.05e-3) ** 2
    state = converged(law, variance, point.flow_slope)
    evidence = ChargeEvidence(
        1, 0.0, variance, np.nan, point.flow_slope, 0.0, state.of(1), high_lift.speed_rpm
    )
    moved = moved_charge(law, state, evidence)
    assert gains.mean == pytest.approx(moved.mean, rel=0.06)
    assert gains.imbalance == pytest.approx(moved.imbalance, rel=0.06)


class Converged:
    """Kalman law that starts with its steady covariance."""

    def __init__(self, law, variance, slope):
        self.law, self.variance, self.slope = law, variance, slope

    def start(self, n_cylinders, parameters=None):
        assert n_cylinders == N
        return converged(self.law, self.variance, self.slope)

    def update(self, state, evidence):
        return self.law.update(state, evidence)


def test_running_kalman_law_decays_as_its_steady_gains_say(design, high_lift, analysis):
    # The controller with the law itself on the full plant, durations not told to it.
    law = KalmanAdaptation(**NO_OFFSET, common_offset_walk=1e-12)
    measurement = analysis.measurements[0]
    control = DesignedControl(high_lift.plant, design, law)
    gains = control.gains(measurement)
    point = high_lift.model.inverse(DEMAND, high_lift.speed_rpm)
    variance = control._loops(measurement).nominal.deviation ** 2  # no jitter in the run
    law = Converged(law, variance, point.flow_slope)
    (case,) = model_cases(
        measurement,
        high_lift.model,
        GainSchedule.constant(gains.mean, gains.imbalance),
        nominal_sample(measurement.uncertain),
        high_lift.plant,
        40,
        law=law,
    )
    run = step_response(replace(case, amplitude=0.004))
    gains = law.law.steady_gains(variance, point.flow_slope, N)
    loop = UncertainLoop.adaptive(measurement, gains)
    poles = np.linalg.eigvals(np.asarray(loop.perturbed(measurement.deltas({})).A))
    assert run.growth(0) == pytest.approx(mode_growth(poles, 0, N), abs=0.01)
    for q in (1, 2):  # of 40 cycles; jumps at the edges of windows stay
        assert run.left(q) == pytest.approx(mode_growth(poles, q, N) ** 40, abs=0.06)


def test_gains_of_schedules(design, high_lift):
    measured = SimpleNamespace(demand=DEMAND, speed_rpm=high_lift.speed_rpm, n_cylinders=N)
    schedule = GainSchedule.constant(0.4, 0.2)
    integral = DesignedControl(high_lift.plant, design, IntegralAdaptation(schedule))
    assert integral.gains(measured) == AdaptationGains(0.4, 0.2)
    gradient = GradientAdaptation(schedule)
    slope = high_lift.model.inverse(DEMAND, high_lift.speed_rpm).flow_slope
    found = DesignedControl(high_lift.plant, design, gradient).gains(measured)
    share = slope**2 / (slope**2 + gradient.weak_slope**2)
    assert found.mean == pytest.approx(0.4 * share)
    assert found.imbalance == pytest.approx(0.2 * share)
    with pytest.raises(ParameterError, match="gains are not known here"):
        DesignedControl(high_lift.plant, design, SimpleNamespace()).gains(measured)


def test_designed_controller_is_robust_sound_and_tight(analysis):
    (found,) = analysis.speeds
    assert found.structured.robust_performance
    assert analysis.sound
    assert len(found.plants) == 3
    assert not found.plants[0].held
    assert found.tightness is None
    assert found.gain_break.tight
    assert analysis.schedule.at(1500.0) == AdaptationGains(0.35, 0.3)
    record = analysis.records()[0]
    assert record["confirmed"]["gain_break"]["simulated"] == found.gain_break.simulated
    text = str(analysis)
    assert "0 of 3 full plants contradict it" in text
    assert "the full plant with" in text


def test_verdict_is_that_of_the_loop_put_together_by_hand(analysis):
    (found,) = analysis.speeds
    measurement = found.measurement
    loop = UncertainLoop.adaptive(measurement, AdaptationGains(0.35, 0.3))
    np.testing.assert_allclose(np.sort(loop.poles), np.sort(found.structured.loop.poles))
    # Nominal margins and the middle of the set are near each other.
    assert found.gang.peak("S", 0).value == pytest.approx(found.structured.nominal_peak, abs=0.1)


def test_parts_of_the_other_controller_are_refused(design):
    with pytest.raises(ParameterError, match="beside a design"):
        analyse_robustness(design, (1500.0,), gains=GainSchedule())
    with pytest.raises(ParameterError, match="give gains, or a design"):
        analyse_robustness(None, (1500.0,), adaptation=KalmanAdaptation())
