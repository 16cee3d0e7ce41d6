import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.command_limits import CommandLimits
from camless_ctrl.cylinder_parameters import ParameterSet
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_data import Measurement
from camless_ctrl.feedforward import Feedforward, LiftSchedule
from camless_ctrl.window_loop import window_controller
from plant.errors import ParameterError

T = 0.02  # event at 1500 rpm of four cylinders


def controller_of(linear_map, **changes):
    """Integral of gain 0.5 on a map of 2 mg per deg above 20 deg."""
    found = window_controller(Feedforward(linear_map), ChargeEstimator(), AdaptationGains(0.5, 0.5))
    return found.replace(**changes)


@pytest.fixture
def controller(linear_map):
    return controller_of(linear_map)


def constant_flow(k, charge, durations=()):
    """Samples of the event before IVO `k`, at a flow that gives `charge` per event."""
    time = np.arange(round((k - 1) * T * 1000), round(k * T * 1000)) / 1000.0
    return Measurement(
        k * T, 1500.0, time, np.full(time.size, charge / T), durations=tuple(durations)
    )


def drive(controller, events, charge, demand, state=None, first=0, **options):
    state, steps = controller.initial_state() if state is None else state, []
    for k in range(first, first + events):
        steps.append(controller.step(state, constant_flow(k, charge), demand, **options))
        state = steps[-1].state
    return steps


def factors(state):
    return state.adaptation.parameters.charge_factor


def test_feedforward_inverts_the_map(controller):
    step = controller.step(controller.initial_state(), constant_flow(0, 2e-4), 2e-4)
    assert step.command.duration_deg == pytest.approx(120.0, abs=1e-9)  # 2 mg per deg above 20
    assert step.command.lift_mm == pytest.approx(3.0)  # scheduled for 1500 rpm
    assert not step.diagnostics.limited


def test_estimate_and_first_correction_by_hand(controller):
    # 10 % less than the map promises: an integral of gain 0.5 takes half of ln(0.9) off at once.
    steps = drive(controller, 8, charge=1.8e-4, demand=2e-4)
    first = next(s for s in steps if s.diagnostics.estimate)
    estimate = first.diagnostics.estimate
    assert (estimate.event_index, estimate.cylinder) == (0, 1)
    assert estimate.charge == pytest.approx(1.8e-4, rel=1e-9)
    assert factors(first.state)[0] == pytest.approx(math.sqrt(0.9), rel=1e-9)
    # cylinder 1 opens again at event 4
    wanted = 20.0 + 100.0 / math.sqrt(0.9)
    assert steps[4].command.duration_deg == pytest.approx(wanted, abs=1e-9)


def test_step_is_a_pure_function(controller):
    steps = drive(controller, 6, charge=1.9e-4, demand=2e-4)
    before = steps[-1].state
    kept = factors(before).copy(), before.estimator.time.copy()
    again = [controller.step(before, constant_flow(6, 1.9e-4), 2e-4) for _ in range(2)]
    assert again[0].command == again[1].command
    np.testing.assert_array_equal(factors(again[0].state), factors(again[1].state))
    np.testing.assert_array_equal(factors(before), kept[0])
    np.testing.assert_array_equal(before.estimator.time, kept[1])


def test_bad_samples_move_nothing(controller):
    state = drive(controller, 6, charge=2e-4, demand=2e-4)[-1].state
    bad = constant_flow(6, float("nan"))
    rejected = []
    for k in range(6, 11):
        step = controller.step(state, bad if k == 6 else constant_flow(k, 2e-4), 2e-4)
        np.testing.assert_allclose(factors(step.state), 1.0, atol=1e-9)
        rejected.append(step.diagnostics.rejected)
        state = step.state
    assert any(rejected)
    assert not rejected[-1]


def test_after_bad_samples_learning_is_held(linear_map):
    controller = controller_of(linear_map, hold_events=5)
    state = drive(controller, 8, charge=2e-4, demand=2e-4)[-1].state
    state = controller.step(state, constant_flow(8, math.nan), 2e-4).state
    steps = drive(controller, 12, charge=1.8e-4, demand=2e-4, state=state, first=9)
    adapted = [s.diagnostics.adapted for s in steps]
    last = max(k for k, s in enumerate(steps) if s.diagnostics.rejected)
    assert not any(adapted[: last + 5])
    assert all(adapted[last + 5 :])


def test_charge_out_of_reach_is_limited_and_told(controller):
    step = controller.step(controller.initial_state(), constant_flow(0, 2e-4), 5e-4)
    assert step.diagnostics.limited
    assert step.command.duration_deg == pytest.approx(180.0)
    # what the map promises is what can be reached, so nothing winds up
    assert step.diagnostics.predicted == pytest.approx(3.2e-4)
    settled = drive(controller, 60, charge=3.2e-4, demand=5e-4)[-1].state
    np.testing.assert_allclose(factors(settled), 1.0, atol=1e-9)


def test_without_adaptation_the_factors_stay(linear_map):
    steps = drive(controller_of(linear_map, adapt=False), 9, charge=1.5e-4, demand=2e-4)
    np.testing.assert_array_equal(factors(steps[-1].state), np.ones(4))
    assert any(s.diagnostics.estimate for s in steps)


def test_what_was_learnt_is_taken_out_and_brought_back_without_a_bump(linear_map):
    controller = controller_of(linear_map, blend_events=20)
    state = drive(controller, 80, charge=1.6e-4, demand=2e-4)[-1].state
    learnt = factors(state)
    assert learnt[0] == pytest.approx(0.6, abs=1e-6)  # its bound
    off = drive(controller, 40, 1.6e-4, 2e-4, state=state, first=80, active=False)
    np.testing.assert_array_equal(factors(off[-1].state), learnt)  # nothing is lost
    assert off[-1].command.duration_deg == pytest.approx(120.0)  # feedforward alone
    on = drive(controller, 40, 2e-4, 2e-4, state=off[-1].state, first=120)
    durations = [s.command.duration_deg for s in (*off, *on)]
    # one twentieth of ln(0.6) an event
    assert np.abs(np.diff(np.log(np.array(durations) - 20.0))).max() < 0.51 / 20 + 0.02


def test_warm_start_keeps_what_was_learnt(controller, linear_map):
    state = drive(controller, 30, charge=1.8e-4, demand=2e-4)[-1].state
    data = json.loads(json.dumps(controller.export_state(state)))
    warm = controller.import_state(data)
    np.testing.assert_array_equal(factors(warm), factors(state))
    step = controller.step(warm, constant_flow(0, 1.8e-4), 2e-4)
    wanted = 20.0 + 100.0 / factors(state)[0]
    assert step.command.duration_deg == pytest.approx(wanted, abs=1e-9)
    three = window_controller(
        Feedforward(linear_map), ChargeEstimator(), AdaptationGains(0.5, 0.5), n_cylinders=3
    )
    with pytest.raises(ParameterError, match="n_cylinders 4, but this controller has 3"):
        three.import_state(data)


def test_measured_duration_tells_jitter_from_flow(linear_map):
    """A valve that closes late once, and is seen to: half of it is believed to be jitter."""
    controller = controller_of(linear_map, duration_jitter=1e-4, duration_noise=1e-4)
    state = controller.initial_state()
    for k in range(4):
        # 1 deg late is 2 mg or 1 %; the flow shows it, and the duration sensor as well
        told = [(0, (120.0 + 1.0) / 9000.0)] if k == 1 else []
        step = controller.step(state, constant_flow(k, 2.02e-4, told), 2e-4)
        state = step.state
        if step.diagnostics.estimate:
            break
    # of ln(1.01), half of the slope times 1 deg is explained by the jitter
    error = math.log(1.01) - 0.5 * 0.01
    assert math.log(factors(state)[0]) == pytest.approx(0.5 * error, rel=1e-6)


def test_a_duration_that_cannot_be_is_no_measurement(linear_map):
    controller = controller_of(linear_map, duration_jitter=1e-4, duration_noise=1e-4)
    for duration in (0.0, 0.02, math.nan):
        state = controller.initial_state()
        for k in range(4):
            told = [(0, duration)] if k == 1 else []
            step = controller.step(state, constant_flow(k, 2.02e-4, told), 2e-4)
            state = step.state
            if step.diagnostics.estimate:
                break
        # as if no duration had been measured: gain 0.5 of the whole error
        assert math.log(factors(state)[0]) == pytest.approx(0.5 * math.log(1.01), rel=1e-6)


def shifted(k, charge, by):
    told = constant_flow(k, charge)
    return Measurement(told.time + by, 1500.0, told.sample_time + by, told.sample_flow)


def test_one_wrong_time_is_passed_over(controller):
    state = drive(controller, 8, charge=2e-4, demand=2e-4)[-1].state
    odd = constant_flow(8, 2e-4)
    state = controller.step(
        state, Measurement(1e9, 1500.0, odd.sample_time, odd.sample_flow), 2e-4
    ).state
    assert state.time == pytest.approx(8 * T)
    steps = drive(controller, 4, charge=1.9e-4, demand=2e-4, state=state, first=9)
    assert all(s.diagnostics.adapted for s in steps[1:])


@pytest.mark.parametrize("by", [1e4, -0.1])
def test_a_clock_that_was_set_is_followed_after_some_events(controller, by):
    state = drive(controller, 8, charge=2e-4, demand=2e-4)[-1].state
    adapted = []
    for k in range(8, 30):
        step = controller.step(state, shifted(k, 1.9e-4, by), 2e-4)
        state = step.state
        adapted.append(step.diagnostics.adapted)
    assert all(adapted[-8:])
    assert state.time == pytest.approx(29 * T + by)


def test_a_limit_that_acts_is_told_and_not_learnt_from(linear_map):
    limits = CommandLimits(lift_mm=(0.5, 2.0))  # below the 3 mm of the schedule
    steps = drive(controller_of(linear_map, limits=limits), 8, charge=1.5e-4, demand=2e-4)
    assert all(s.diagnostics.limited for s in steps)
    assert not any(s.diagnostics.adapted for s in steps)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"adaptation": None}, "lacks what was learnt"),
        ({"density": 50.0}, "density is 50"),
        ({"n_cylinders": 3}, "n_cylinders 3"),
        ({"law": "Other"}, "law 'Other'"),
    ],
)
def test_exported_state_is_checked(controller, change, message):
    data = {**controller.export_state(controller.initial_state()), **change}
    with pytest.raises(ParameterError, match=message):
        controller.import_state(data)
    short = controller.export_state(controller.initial_state())
    for values in short["adaptation"].values():
        if isinstance(values, list):
            values.pop()
    with pytest.raises(ParameterError, match="parameters are of 3 cylinders"):
        controller.import_state(short)
    with pytest.raises(ParameterError, match="lacks density and adaptation"):
        controller.import_state({"n_cylinders": 4, "law": "IntegralAdaptation"})


def test_density_follows_the_ambient_pressure_that_is_seen(linear_map):
    class Thin:
        """Estimator that sees 0.8 bar and nothing else."""

        def start(self):
            return None

        def commanded(self, state, record):
            return state

        def update(self, state, measurement):
            return self

        state, final, rejected, ambient_pressure = None, None, False, 0.8e5

    controller = controller_of(linear_map, estimator=Thin(), density_gain=0.5)
    steps = drive(controller, 30, charge=2e-4, demand=2e-4)
    assert steps[0].diagnostics.density == pytest.approx(0.9)
    assert steps[-1].diagnostics.density == pytest.approx(0.8, abs=1e-6)
    assert steps[-1].command.duration_deg == pytest.approx(20.0 + 100.0 / 0.8, abs=1e-3)


def test_branch_stops_where_the_charge_no_longer_rises():
    class Peaked:
        def air_charge(self, lift_mm, duration_deg, speed_rpm, /):
            return 4e-4 - 4e-8 * (np.asarray(duration_deg) - 120.0) ** 2

    feedforward = Feedforward(Peaked())
    assert feedforward.command(1.0, 1500.0).command.duration_deg == pytest.approx(120.0, abs=0.6)
    assert feedforward.command(3e-4, 1500.0).command.duration_deg == pytest.approx(70.0, abs=0.01)
    # 2 * 4e-8 * 50 kg/deg
    assert feedforward.sensitivity(3e-4, 1500.0) == pytest.approx(4e-6, rel=1e-2)


WILD = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, width=64),
    st.sampled_from([0.0, 0.01, 1500.0, 6000.0, -1.0]),
)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            WILD,
            st.one_of(WILD, st.floats(750.0, 6000.0)),
            st.lists(st.tuples(WILD, WILD), max_size=6),
            WILD,
            st.floats(1e-6, 1e-3),
        ),
        max_size=25,
    )
)
def test_whatever_is_measured_commands_keep_limits_and_rates(steps):
    class Linear:
        def air_charge(self, lift_mm, duration_deg, speed_rpm, /):
            return 2e-6 * (np.asarray(duration_deg) - 20.0)

    limits = CommandLimits(lift_mm=(0.5, 8.0), longest_duration_deg=200.0, lift_rate_mm=1.0,
                           duration_rate=4e-3)  # fmt: skip
    schedule = LiftSchedule((750.0, 6000.0), (2.0, 4.0))
    controller = controller_of(Linear(), limits=limits).replace(
        model=Feedforward(Linear(), schedule)
    )
    state, before = controller.initial_state(), {}
    for k, (time, speed, samples, duration, demand) in enumerate(steps):
        if math.isfinite(speed) and not 750.0 <= speed <= 6000.0:
            speed = math.nan  # beyond the model, which is another matter
        told = Measurement(
            time,
            speed,
            np.array([s[0] for s in samples]),
            np.array([s[1] for s in samples]),
            durations=((k - 1, duration),),
        )
        step = controller.step(state, told, demand)
        state, command = step.state, step.command
        rate = 6.0 * state.speed_rpm
        duration = command.duration_deg / rate
        assert 0.5 <= command.lift_mm <= 8.0
        assert command.duration_deg <= 200.0 * (1.0 + 1e-12)
        assert duration >= limits.shortest(command.lift_mm) * (1.0 - 1e-12)
        if k % 4 in before:
            lift, last = before[k % 4]
            # The longest duration at a new speed comes before the rates.
            assert abs(command.lift_mm - lift) <= 1.0 + 1e-9 or duration * rate > 200.0 - 1e-9
            assert abs(duration - last) <= 4e-3 + 1e-12 or duration * rate > 200.0 - 1e-9
        before[k % 4] = command.lift_mm, duration
        assert controller.adaptation.bounds.contain(state.adaptation.parameters)


@pytest.mark.parametrize(
    "build",
    [
        lambda m: Feedforward(m, lift=LiftSchedule((1500.0,), (9.0,))),
        lambda m: Feedforward(m).duration_limits_deg(9000.0),
        lambda m: LiftSchedule((1500.0, 3000.0), (3.0,)),
        lambda m: controller_of(m).initial_state(ParameterSet.nominal(3)),
        lambda m: controller_of(m, n_cylinders=0),
        lambda m: controller_of(m, blend_events=0),
        lambda m: controller_of(m, density_gain=math.nan),
        lambda m: CommandLimits(lift_mm=(2.0, 1.0)),
        lambda m: CommandLimits(duration_rate=0.0),
        lambda m: CommandLimits(longest_duration_deg=10.0).apply(1.0, 90.0, 6000.0, None),
    ],
)
def test_impossible_set_up_is_refused(build, linear_map):
    with pytest.raises(ParameterError):
        build(linear_map)


@pytest.mark.parametrize("demand", [-1e-4, float("nan"), float("inf")])
def test_impossible_demand_is_refused(controller, demand):
    with pytest.raises(ParameterError, match="demand"):
        controller.step(controller.initial_state(), constant_flow(0, 2e-4), demand)
