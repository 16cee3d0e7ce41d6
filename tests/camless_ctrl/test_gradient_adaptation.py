import math

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.adaptation_laws import ParameterBounds
from camless_ctrl.cylinder_parameters import ParameterSet
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_data import ChargeEvidence
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.gradient_adaptation import GradientAdaptation
from camless_ctrl.nominal_loop import NominalLoop
from plant.errors import ParameterError

TRUE = np.array([1.03, 0.85, 0.96, 1.05])
SLOPE = 0.5


def law_of(mean, imbalance, **changes):
    return GradientAdaptation(GainSchedule.constant(mean, imbalance), dead_zone=0.0).replace(
        **changes
    )


def evidence(cylinder, error, used, *, slope=SLOPE, duration=math.nan):
    return ChargeEvidence(cylinder, error, 1e-4, duration, slope, 60.0, used, 1500.0)


def errors(state):
    return np.subtract(state.log_flow_gain, np.log(TRUE))


def run(law, cycles, slope=SLOPE):
    """Ideal measurement: all of a cycle commanded with the parameters before it."""
    state = law.start(4)
    history = [errors(state)]
    for _ in range(cycles):
        before = state
        for i in range(4):
            error = slope * -errors(before)[i]
            state = law.update(state, evidence(i + 1, error, before.of(i + 1), slope=slope)).state
        history.append(errors(state))
    return np.array(history)


def test_mean_and_imbalance_decay_with_their_own_gains():
    law = law_of(0.4, 0.2)
    left = run(law, 12)
    share = SLOPE**2 / (SLOPE**2 + law.weak_slope**2)
    mean, imbalance = left.mean(axis=1), left - left.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(mean[1:] / mean[:-1], 1.0 - 0.4 * share, rtol=1e-9)
    np.testing.assert_allclose(imbalance[5], (1.0 - 0.2 * share) ** 5 * imbalance[0], rtol=1e-9)


@pytest.mark.parametrize("slope", [0.2, 0.9, -0.5])
def test_predicted_charge_moves_by_the_gain_whatever_the_slope(slope):
    law = law_of(0.3, 0.3, weak_slope=1e-6)
    state = law.start(4)
    after = law.update(state, evidence(2, 0.02, state.of(2), slope=slope)).state
    assert slope * after.log_flow_gain[1] == pytest.approx(0.3 * 0.02, rel=1e-6)
    assert after.log_flow_gain[0] == 0.0


def test_loop_with_a_lagging_sensor_is_that_of_the_analysis():
    # Truth: the closed loop as python-control simulates it.
    gains = AdaptationGains(0.4, 0.3)
    loop = EventLoop.at_speed(1500.0, ChargeEstimator(), gains, time_constant=20e-3, delay=3e-3)
    disturbance = np.tile([0.01, -0.02, 0.005, 0.0], 25)
    closed = NominalLoop.of_event_loop(loop).closed["charge", "disturbance"]
    expected = control.forced_response(closed, inputs=disturbance).outputs.ravel()

    law = law_of(0.4, 0.3, weak_slope=1e-9)
    A, B, C = loop.measurement.matrices(loop.latency)
    state, x, found = law.start(4), np.zeros((len(A), 1)), []
    for k, outer in enumerate(disturbance):
        estimate = float((C @ x).item())
        cylinder = (k - loop.latency) % 4 + 1
        state = law.update(state, evidence(cylinder, estimate, state.of(cylinder))).state
        left = outer - SLOPE * state.log_flow_gain[k % 4]
        x = A @ x + B * left
        found.append(left)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_dead_zone_leaves_small_errors_alone():
    law = law_of(0.5, 0.5, dead_zone=0.01)
    state = law.start(4)
    step = law.update(state, evidence(1, 0.009, state.of(1)))
    assert step.error == 0.0
    assert not step.moved
    assert step.state is state
    assert law.update(state, evidence(1, -0.03, state.of(1))).error == pytest.approx(-0.02)


@pytest.mark.parametrize("slope", [0.0, 0.01, -0.019])
def test_flow_gain_is_held_where_the_charge_does_not_depend_on_it(slope):
    law = law_of(0.4, 0.4)
    state = law.start(4)
    step = law.update(state, evidence(1, 0.1, state.of(1), slope=slope))
    assert not step.moved
    assert not step.determined
    assert law.effective_gain(slope) == 0.0


def test_weak_slopes_lower_the_gain():
    law = law_of(0.4, 0.4)
    assert law.effective_gain(law.weak_slope) == pytest.approx(0.5)
    assert run(law, 1, slope=law.weak_slope)[1] == pytest.approx(0.8 * -np.log(TRUE))


def test_duration_error_moves_the_offset_of_its_cylinder_alone():
    law = law_of(0.4, 0.4, duration_gain=0.2, duration_dead_zone=0.0)
    state = law.start(4)
    for k in range(1, 9):
        state = law.update(state, evidence(3, math.nan, state.of(3), duration=0.2e-3)).state
        assert state.duration_offset[2] == pytest.approx(0.2e-3 * (1.0 - 0.8**k))
    assert state.duration_offset[:2] == (0.0, 0.0)
    assert state.log_flow_gain == (0.0,) * 4


def test_charge_error_without_a_measured_duration_moves_no_offset():
    law = law_of(0.4, 0.4)
    state = law.start(4)
    after = law.update(state, evidence(3, 0.05, state.of(3))).state
    assert after.duration_offset == state.duration_offset
    assert after.log_flow_gain != state.log_flow_gain


def test_parameters_are_projected():
    law = law_of(0.9, 0.9, bounds=ParameterBounds(flow_gain=(0.9, 1.02)))
    state = law.start(4)
    for _ in range(30):
        for i in range(4):
            error = -SLOPE * errors(state)[i]
            step = law.update(state, evidence(i + 1, error, state.of(i + 1)))
            state = step.state
    np.testing.assert_allclose(state.parameters.flow_gain, [1.02, 0.9, 0.96, 1.02], atol=2e-4)
    assert law.bounds.contain(state.parameters)
    assert step.projected
    late = law.update(state, evidence(1, 0.0, state.of(1), duration=1.9e-3))
    for _ in range(20):
        late = law.update(late.state, evidence(1, 0.0, late.state.of(1), duration=1.9e-3))
    assert late.projected
    assert late.state.duration_offset[0] == law.bounds.duration_offset[1]


def test_state_survives_export_and_the_start_from_parameters():
    law = GradientAdaptation()
    given = ParameterSet(TRUE, np.array([1e-4, 0.0, -2e-4, 0.0]), np.array([1.0, 1.1, 0.9, 1.0]))
    state = law.start(4, given)
    for name in ("flow_gain", "duration_offset", "charge_factor"):
        np.testing.assert_allclose(getattr(state.parameters, name), getattr(given, name))
    again = law.from_dict(law.to_dict(state))
    assert again.log_flow_gain == state.log_flow_gain
    assert again.of(2) == state.of(2)
    np.testing.assert_allclose(state.of(3), (0.96, -2e-4, 0.9))


def test_schedule_is_that_of_the_analysis():
    schedule, law = GainSchedule(), GradientAdaptation()
    for speed in (500.0, 750.0, 1100.0, 3550.0, 3600.0, 7000.0):
        gains = schedule.at(speed)
        assert law._at(speed) == pytest.approx((gains.mean, gains.imbalance))


@pytest.mark.parametrize(
    "build",
    [
        lambda: GradientAdaptation(duration_gain=1.5),
        lambda: GradientAdaptation(dead_zone=math.nan),
        lambda: GradientAdaptation(weak_slope=0.0),
        lambda: GradientAdaptation().replace(gain=1.0),
        lambda: ParameterBounds(flow_gain=(1.1, 1.4)),
        lambda: ParameterBounds(duration_offset=(1e-4, 2e-4)),
        lambda: GradientAdaptation().start(3, ParameterSet.nominal(4)),
        lambda: GradientAdaptation().start(0),
        lambda: GradientAdaptation().start(
            4, ParameterSet.nominal(4).replace(flow_gain=[1, 1, 1, 1.7])
        ),
        lambda: GradientAdaptation().from_dict({"law": "normalised gradient"}),
        lambda: GradientAdaptation().from_dict(
            {**GradientAdaptation().to_dict(GradientAdaptation().start(4)), "law": "integral"}
        ),
        lambda: GradientAdaptation().from_dict(
            {
                **GradientAdaptation().to_dict(GradientAdaptation().start(2)),
                "log_flow_gain": [0.0, math.nan],
            }
        ),
    ],
)
def test_impossible_parameters_are_refused(build):
    with pytest.raises(ParameterError):
        build()
