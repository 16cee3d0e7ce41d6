"""What holds of every law for any evidence at all."""

import json
import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.adaptation_laws import ParameterBounds
from camless_ctrl.cylinder_parameters import CylinderParameters, ParameterSet
from camless_ctrl.event_data import ChargeEvidence
from camless_ctrl.event_loop import _adaptation_matrices
from camless_ctrl.gradient_adaptation import GradientAdaptation
from camless_ctrl.integral_adaptation import IntegralAdaptation
from camless_ctrl.kalman_adaptation import KalmanAdaptation
from camless_ctrl.lti_adaptation import LtiAdaptation

N = 4
INTEGRATORS = control.ss(*_adaptation_matrices(N, 2, AdaptationGains(0.4, 0.3)), 0.02)
LAWS = {
    "gradient": GradientAdaptation(),
    "Kalman": KalmanAdaptation(),
    "Kalman without factor": KalmanAdaptation(charge_spread=0.0),
    "forgetting Kalman": KalmanAdaptation(forgetting=0.9, gate=2.0),
    "integral": IntegralAdaptation(),
    "LTI": LtiAdaptation(((1500.0, INTEGRATORS), (3000.0, 0.5 * INTEGRATORS))),
}
ANYTHING = st.floats(allow_nan=True, allow_infinity=True)
BOUNDS = ParameterBounds()


def used_of():
    inside = st.builds(
        CylinderParameters,
        st.floats(0.5, 1.6),
        st.floats(-5e-4, 5e-4),
        st.floats(0.6, 1.4),
    )
    return inside | st.builds(CylinderParameters, ANYTHING, ANYTHING, ANYTHING)


def sound():
    return st.builds(
        ChargeEvidence,
        st.integers(1, N),
        st.floats(-1.0, 1.0) | st.just(math.nan),
        st.floats(1e-6, 0.1),
        st.floats(-1e-3, 1e-3) | st.just(math.nan),
        st.floats(-1.0, 1.5),
        st.floats(-500.0, 500.0),
        st.builds(
            CylinderParameters,
            st.floats(0.5, 1.6),
            st.floats(-5e-4, 5e-4),
            st.floats(0.6, 1.4),
        ),
        st.floats(700.0, 6500.0),
    )


def anything():
    return sound() | st.builds(
        ChargeEvidence,
        st.integers(-2, N + 3),
        ANYTHING,
        ANYTHING,
        ANYTHING,
        ANYTHING,
        ANYTHING,
        used_of(),
        ANYTHING,
    )


def parameters():
    def arrays(low, high):
        return st.lists(st.floats(low, high), min_size=N, max_size=N).map(np.array)

    return st.builds(ParameterSet, arrays(0.5, 1.6), arrays(-5e-4, 5e-4), arrays(0.6, 1.4))


def run(law, events, start=None):
    state = law.start(N, start)
    for event in events:
        state = law.update(state, event).state
    return state


def as_text(law, state):
    return json.dumps(law.to_dict(state), allow_nan=False)


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=80, deadline=None)
@given(events=st.lists(anything(), max_size=30), start=st.none() | parameters())
def test_parameters_stay_in_the_projection_set_whatever_comes(name, events, start):
    law = LAWS[name]
    state = law.start(N, start)
    for event in events:
        step = law.update(state, event)
        assert law.bounds.contain(step.state.parameters)
        for cylinder in range(1, N + 1):
            gain, offset, factor = step.state.of(cylinder)
            assert BOUNDS.flow_gain[0] <= gain <= BOUNDS.flow_gain[1]
            assert BOUNDS.duration_offset[0] <= offset <= BOUNDS.duration_offset[1]
            assert BOUNDS.charge_factor[0] <= factor <= BOUNDS.charge_factor[1]
        if not step.moved:
            for field in ("log_flow_gain", "duration_offset", "log_charge_factor"):
                assert getattr(step.state, field) == getattr(state, field)
        state = step.state
    json.dumps(law.to_dict(state), allow_nan=False)  # nothing that is not finite is remembered


def broken():
    """Evidence of which neither charge nor duration can be used."""
    bad = st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e9, 50.0])
    one = st.builds(
        ChargeEvidence,
        st.integers(1, N),
        bad,
        ANYTHING,
        bad,
        ANYTHING,
        ANYTHING,
        used_of(),
        ANYTHING,
    )
    return one | st.builds(
        ChargeEvidence,
        st.sampled_from([0, -1, N + 1]),
        ANYTHING,
        ANYTHING,
        ANYTHING,
        ANYTHING,
        ANYTHING,
        used_of(),
        ANYTHING,
    )


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=60, deadline=None)
@given(before=st.lists(sound(), max_size=8), events=st.lists(broken(), min_size=1, max_size=8))
def test_broken_evidence_moves_nothing(name, before, events):
    law = LAWS[name]
    learnt = state = run(law, before)
    for event in events:
        step = law.update(state, event)
        assert not step.moved
        state = step.state
    for field in ("log_flow_gain", "duration_offset", "log_charge_factor"):
        assert getattr(state, field) == getattr(learnt, field)


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=40, deadline=None)
@given(events=st.lists(anything(), max_size=20), others=st.lists(anything(), max_size=3))
def test_same_evidence_gives_the_same_result_whatever_was_done_between(name, events, others):
    law = LAWS[name]
    first = as_text(law, run(law, events))
    run(law, others)
    assert as_text(law, run(law, events)) == first


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=40, deadline=None)
@given(
    events=st.lists(sound(), min_size=2, max_size=20),
    cut=st.integers(1, 19),
    start=st.none() | parameters(),
)
def test_a_warm_start_goes_on_as_if_nothing_had_been(name, events, cut, start):
    law = LAWS[name]
    half = run(law, events[:cut], start)
    again = law.from_dict(json.loads(as_text(law, half)))
    for event in events[cut:]:
        half, again = law.update(half, event).state, law.update(again, event).state
    assert as_text(law, half) == as_text(law, again)


ORDERS = st.permutations(range(1, N + 1))
TURNS = st.integers(0, N - 1).map(lambda k: [(i + k) % N + 1 for i in range(N)])


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=60, deadline=None)
@given(events=st.lists(sound(), max_size=24), start=parameters(), order=st.data())
def test_permuting_cylinders_permutes_the_result(name, events, start, order):
    # A law per event knows cylinders by their turn: there the firing order must stay.
    law = LAWS[name]
    order = order.draw(TURNS if name == "LTI" else ORDERS)
    place = {cylinder: i + 1 for i, cylinder in enumerate(order)}
    relabelled = [event._replace(cylinder=place[event.cylinder]) for event in events]
    found = run(law, relabelled, start.permuted(order)).parameters
    expected = run(law, events, start).parameters.permuted(order)
    np.testing.assert_allclose(found.flow_gain, expected.flow_gain, rtol=1e-7)
    np.testing.assert_allclose(found.duration_offset, expected.duration_offset, atol=1e-11)
    np.testing.assert_allclose(found.charge_factor, expected.charge_factor, rtol=1e-7)


@pytest.mark.parametrize("name", ["gradient", "Kalman"])
@settings(max_examples=40, deadline=None)
@given(event=sound(), before=st.lists(sound(), max_size=6))
def test_what_is_not_measured_moves_only_what_it_must(name, event, before):
    law = LAWS[name]
    state = run(law, before)
    if name == "gradient":
        charge = law.update(state, event._replace(duration_error=math.nan)).state
        assert charge.duration_offset == state.duration_offset
        duration = law.update(state, event._replace(log_ratio=math.nan)).state
        assert duration.log_flow_gain == state.log_flow_gain
    for step in (
        law.update(state, event._replace(duration_error=math.nan, log_ratio=math.nan)),
        law.update(state, event._replace(duration_error=1.0, log_ratio=-40.0)),
    ):
        assert not step.moved
