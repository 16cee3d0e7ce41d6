import json
import math
import pickle
from types import SimpleNamespace

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.adaptation_laws import ParameterBounds
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_data import ChargeEvidence
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.integral_adaptation import IntegralAdaptation
from camless_ctrl.lti_adaptation import LtiAdaptation
from camless_ctrl.nominal_loop import NominalLoop
from plant.errors import ParameterError

GAINS = AdaptationGains(0.4, 0.3)


def loop_of(gains=GAINS):
    return EventLoop.at_speed(1500.0, ChargeEstimator(), gains, time_constant=18e-3, delay=2e-3)


def system_of(gains=GAINS):
    return NominalLoop.of_event_loop(loop_of(gains)).law


def evidence(cylinder, error, used, speed=1500.0):
    return ChargeEvidence(cylinder, error, 1e-4, math.nan, 0.5, 60.0, used, speed)


def respond(law, loop, disturbance):
    """Charge errors with the law behind the sensor of a loop."""
    A, B, C = loop.measurement.matrices(loop.latency)
    state, x, found = law.start(4), np.zeros((len(A), 1)), []
    for k, outer in enumerate(disturbance):
        estimate = float((C @ x).item())
        cylinder = (k - loop.latency) % 4 + 1
        state = law.update(state, evidence(cylinder, estimate, state.of(cylinder))).state
        left = outer - state.log_charge_factor[k % 4]
        x = A @ x + B * left
        found.append(left)
    return np.array(found)


DISTURBANCE = np.tile([0.02, -0.05, 0.01, 0.0], 30)


@pytest.mark.parametrize("order", [0, 2])
def test_loop_is_that_of_the_analysis(order):
    # Truth: the closed loop as python-control simulates it; order 2 adds a lead and a lag.
    loop = loop_of()
    law = system_of()
    if order:
        shaped = control.tf([1.0, -0.1, 0.02], [1.0, 0.2, 0.05], law.dt)
        law = control.series(control.ss(shaped), law)
    nominal = NominalLoop(law, loop.measurement.system(loop.latency), 4)
    assert nominal.stable
    closed = nominal.closed["charge", "disturbance"]
    expected = control.forced_response(closed, inputs=DISTURBANCE).outputs.ravel()
    found = respond(LtiAdaptation(((1500.0, law),), loop.latency), loop, DISTURBANCE)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("high", [10.0, 1.03])
def test_law_of_integrators_is_the_integral_adaptation_projection_included(high):
    bounds = ParameterBounds(charge_factor=(0.97 if high < 2 else 0.5, min(high, 1.9)))
    gains = AdaptationGains(0.3, 0.3)  # each factor moves by its own cylinder alone
    loop = loop_of(gains)
    lti = LtiAdaptation(((1500.0, system_of(gains)),), loop.latency, bounds)
    integral = IntegralAdaptation(GainSchedule.constant(0.3, 0.3), bounds)
    there_and_back = np.concatenate((2.0 * DISTURBANCE, -2.0 * DISTURBANCE))
    np.testing.assert_allclose(
        respond(lti, loop, there_and_back), respond(integral, loop, there_and_back), atol=1e-12
    )


def test_missing_evidence_moves_nothing_and_keeps_the_order():
    law = LtiAdaptation(((1500.0, system_of(AdaptationGains(0.3, 0.3))),))
    state = law.start(4)
    for k in range(40):
        state = law.update(state, evidence(k % 4 + 1, 0.01 * (k % 4), state.of(1))).state
    for k in range(4):  # until each factor has been given out
        state = law.update(state, evidence(k + 1, 0.0, state.of(1))).state
    learnt = state.log_charge_factor
    for error in (math.nan, math.inf, 5.0):
        step = law.update(state, evidence(state.memory.next_cylinder, error, state.of(1)))
        assert not step.moved
        assert step.state.log_charge_factor == learnt
        state = step.state
    # Two events without any word, then no error: the factors stay each with its cylinder.
    due = state.memory.next_cylinder
    for k in range(2, 10):
        state = law.update(state, evidence((due - 1 + k) % 4 + 1, 0.0, state.of(1))).state
    np.testing.assert_allclose(state.log_charge_factor, learnt, atol=1e-12)


def test_nearest_law_holds_and_takes_over_without_a_bump():
    slow, fast = AdaptationGains(0.1, 0.1), AdaptationGains(0.5, 0.5)
    law = LtiAdaptation(((1000.0, system_of(slow)), (3000.0, system_of(fast))))
    state = law.start(4)
    for k in range(60):
        error = 0.004 * (k % 4) if k < 56 else 0.0
        state = law.update(state, evidence(k % 4 + 1, error, state.of(1), 1900.0)).state
    learnt = state.log_charge_factor
    assert state.memory.node == 0
    for k in range(60, 68):
        state = law.update(state, evidence(k % 4 + 1, 0.0, state.of(1), 2100.0)).state
    assert state.memory.node == 1
    np.testing.assert_allclose(state.log_charge_factor, learnt, atol=1e-12)
    for k in range(4):  # the error of the first moves it at its next turn
        error = 0.01 if k == 0 else 0.0
        state = law.update(state, evidence(k + 1, error, state.of(1), 2100.0)).state
    np.testing.assert_allclose(
        np.subtract(state.log_charge_factor, learnt), [0.005, 0.0, 0.0, 0.0], atol=1e-12
    )


def test_unstable_law_without_evidence_is_started_anew():
    law = LtiAdaptation(((1500.0, control.ss(3.0, 1.0, 0.1, 0.0, 0.02)),))
    state = law.start(4)
    for k in range(200):
        state = law.update(
            state, evidence(k % 4 + 1, 0.5 if k < 3 else math.nan, state.of(1))
        ).state
    assert np.all(np.abs(state.memory.x) < 1e7)
    assert law.bounds.contain(state.parameters)


def test_state_survives_export():
    law = LtiAdaptation(((1500.0, system_of()),))
    state = law.start(4)
    for k in range(11):
        state = law.update(state, evidence(k % 4 + 1, 0.01, state.of(1))).state
    again = law.from_dict(json.loads(json.dumps(law.to_dict(state))))
    following = [law.update(s, evidence(4, -0.02, s.of(4))).state for s in (state, again)]
    assert law.to_dict(following[0]) == law.to_dict(following[1])


def test_laws_of_a_synthesis_are_taken_over():
    def found(speed, latency=2):
        return SimpleNamespace(
            measurement=SimpleNamespace(speed_rpm=speed, latency=latency), system=system_of()
        )

    law = LtiAdaptation.of_laws([found(3000.0), found(1500.0)])
    assert [speed for speed, _ in law.systems] == [1500.0, 3000.0]
    assert law.latency == 2
    with pytest.raises(ParameterError, match="latencies"):
        LtiAdaptation.of_laws([found(1500.0), found(3000.0, 3)])


@pytest.mark.parametrize(
    "build",
    [
        lambda: LtiAdaptation(()),
        lambda: LtiAdaptation(((3000.0, system_of()), (1500.0, system_of()))),
        lambda: LtiAdaptation(((1500.0, system_of()),), latency=0),
        lambda: LtiAdaptation(((1500.0, control.ss(0, [[1, 1]], 1, [[0, 0]], 0.02)),)),
        lambda: LtiAdaptation(((1500.0, system_of()),)).replace(delay=1),
    ],
)
def test_impossible_laws_are_refused(build):
    with pytest.raises(ParameterError):
        build()


def test_state_of_another_law_is_refused():
    law = LtiAdaptation(((1500.0, system_of()),))
    state = law.start(4)
    state = law.update(state, evidence(1, 0.01, state.of(1))).state
    data = law.to_dict(state)
    for change in ({"x": [0.0]}, {"node": 3}, {"x": [math.nan] * 4}, {"law": "Kalman"}):
        with pytest.raises(ParameterError):
            law.from_dict({**data, **change})


def test_a_copy_has_the_same_laws():
    law = LtiAdaptation(((1500.0, system_of()), (3000.0, system_of(AdaptationGains(0.2, 0.1)))))
    copy = pickle.loads(pickle.dumps(law))
    assert copy.latency == law.latency
    for (speed, system), (other, copied) in zip(law.systems, copy.systems, strict=True):
        assert speed == other
        for name in "ABCD":
            np.testing.assert_array_equal(getattr(system, name), getattr(copied, name))
