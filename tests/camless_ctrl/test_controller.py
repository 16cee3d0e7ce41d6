import numpy as np
import pytest

from camless_ctrl.adaptation import GainSchedule, NormalisedGradient
from camless_ctrl.controller import AirChargeController, Measurement
from camless_ctrl.feedforward import Feedforward, LiftSchedule
from plant.errors import ParameterError

T = 0.02  # event at 1500 rpm of four cylinders


@pytest.fixture
def controller(linear_map):
    return AirChargeController(
        Feedforward(linear_map), adaptation=NormalisedGradient(GainSchedule.constant(0.5, 0.5))
    )


def constant_flow(k, charge):
    """Samples of the event before IVO `k`, at a flow that gives `charge` per event."""
    time = np.arange(round((k - 1) * T * 1000), round(k * T * 1000)) / 1000.0
    return Measurement(k * T, 1500.0, time, np.full(time.size, charge / T))


def drive(controller, events, charge, demand):
    state, steps = controller.initial_state(), []
    for k in range(events):
        steps.append(controller.step(state, constant_flow(k, charge), demand))
        state = steps[-1].state
    return steps


def test_feedforward_inverts_the_map(controller):
    step = controller.step(controller.initial_state(), constant_flow(0, 2e-4), 2e-4)
    assert step.command.duration_deg == pytest.approx(120.0, abs=1e-9)  # 2 mg per deg above 20
    assert step.command.lift_mm == pytest.approx(3.0)  # scheduled for 1500 rpm
    assert not step.diagnostics.limited


def test_estimate_and_first_correction_by_hand(controller):
    # 10 % less than the map promises: an integral of gain 0.5 takes half of it off at once.
    steps = drive(controller, 8, charge=1.8e-4, demand=2e-4)
    first = next(s for s in steps if s.diagnostics.estimates)
    estimate = first.diagnostics.estimates[0]
    assert (estimate.event_index, estimate.cylinder) == (0, 1)
    assert estimate.charge == pytest.approx(1.8e-4, rel=1e-9)
    assert estimate.error == pytest.approx(-0.1, rel=1e-9)
    assert first.state.factors[0] == pytest.approx(0.95, rel=1e-9)
    # cylinder 1 opens again at event 4, with its duration for 2e-4/0.95
    assert steps[4].command.duration_deg == pytest.approx(20.0 + 100.0 / 0.95, abs=1e-9)


def test_step_is_a_pure_function(controller):
    steps = drive(controller, 6, charge=1.9e-4, demand=2e-4)
    before = steps[-1].state
    kept = before.factors.copy(), before.sample_time.copy()
    again = [controller.step(before, constant_flow(6, 1.9e-4), 2e-4) for _ in range(2)]
    assert again[0].command == again[1].command
    np.testing.assert_array_equal(again[0].state.factors, again[1].state.factors)
    np.testing.assert_array_equal(before.factors, kept[0])
    np.testing.assert_array_equal(before.sample_time, kept[1])


def test_bad_samples_move_nothing(controller):
    steps = drive(controller, 6, charge=2e-4, demand=2e-4)
    state = steps[-1].state
    bad = constant_flow(6, float("nan"))
    for k in (6, 7):
        step = controller.step(state, bad if k == 6 else constant_flow(k, 2e-4), 2e-4)
        np.testing.assert_allclose(step.state.factors, 1.0, atol=1e-9)
        state = step.state
    assert step.diagnostics.skipped


def test_charge_out_of_reach_is_limited_and_told(controller):
    step = controller.step(controller.initial_state(), constant_flow(0, 2e-4), 5e-4)
    assert step.diagnostics.limited
    assert step.command.duration_deg == 180.0
    # what the map promises is what can be reached, so nothing winds up
    assert step.state.pending[0].map_charge == pytest.approx(3.2e-4)


def test_without_adaptation_the_factors_stay(linear_map):
    fixed = AirChargeController(Feedforward(linear_map), adapt=False)
    steps = drive(fixed, 9, charge=1.5e-4, demand=2e-4)
    np.testing.assert_array_equal(steps[-1].state.factors, np.ones(4))
    assert any(s.diagnostics.estimates for s in steps)


def test_branch_stops_where_the_charge_no_longer_rises():
    class Peaked:
        def air_charge(self, lift_mm, duration_deg, speed_rpm, /):
            return 4e-4 - 4e-8 * (np.asarray(duration_deg) - 120.0) ** 2

    feedforward = Feedforward(Peaked())
    assert feedforward.command(1.0, 1500.0).command.duration_deg == pytest.approx(120.0, abs=0.6)
    assert feedforward.command(3e-4, 1500.0).command.duration_deg == pytest.approx(70.0, abs=0.01)
    # 2 * 4e-8 * 50 kg/deg
    assert feedforward.sensitivity(3e-4, 1500.0) == pytest.approx(4e-6, rel=1e-2)


@pytest.mark.parametrize(
    "build",
    [
        lambda m: Feedforward(m, lift=LiftSchedule((1500.0,), (9.0,))),
        lambda m: Feedforward(m).duration_limits_deg(9000.0),
        lambda m: LiftSchedule((1500.0, 3000.0), (3.0,)),
        lambda m: AirChargeController(Feedforward(m)).initial_state(np.ones(3)),
        lambda m: AirChargeController(Feedforward(m), n_cylinders=0),
    ],
)
def test_impossible_set_up_is_refused(build, linear_map):
    with pytest.raises(ParameterError):
        build(linear_map)


@pytest.mark.parametrize("demand", [0.0, -1e-4, float("nan")])
def test_impossible_demand_is_refused(controller, demand):
    with pytest.raises(ParameterError, match="demand"):
        controller.step(controller.initial_state(), constant_flow(0, 2e-4), demand)
