"""Closed-loop runs over throttle, boundary conditions, deactivated cylinders; what they record."""

import math

import numpy as np
import pytest

from camless_ctrl.closed_loop import Conditions, simulate
from camless_ctrl.closed_loop_result import ClosedLoopResult, averaged
from camless_ctrl.faults import Fault
from plant import CrankAnglePlant, Engine, ValveCommand
from plant.errors import ParameterError

N, SPEED = 4, 1500.0
PLANT = CrankAnglePlant(oscillation=True)
SIGNALS = ("charge", "pumping_loss", "lift_mm", "duration_deg", "estimate", "time")


@pytest.fixture(scope="module")
def steady(narrow_design):
    """Controller whose commands follow from demand and speed alone."""
    return narrow_design.controller.replace(adapt=False, density_gain=0.0, faults=None)


def cycles(n, demand=2.5e-4):
    return np.full(N * n, demand)


def last_steady_charge(result, engine, throttle_deg=90.0):
    """Charge that the steady cycle of an engine has with the last commands of a run."""
    commands = [
        ValveCommand(lift, duration)
        for lift, duration in zip(result.lift_mm[-N:], result.duration_deg[-N:], strict=True)
    ]
    return PLANT.with_engine(engine).steady_cycle(SPEED, commands, throttle_deg).air_charge


# -- throttle and conditions of the true engine --------------------------------------------------


def test_the_throttle_is_that_of_each_event(steady):
    throttle = np.repeat((90.0, 25.0), N * 30)
    result = simulate(PLANT, steady, cycles(60), SPEED, throttle_deg=throttle)
    np.testing.assert_array_equal(result.throttle_deg, throttle)
    wide = last_steady_charge(result, PLANT.engine)
    nearly_shut = last_steady_charge(result, PLANT.engine, 25.0)
    assert result.charge[N * 29 : N * 30] == pytest.approx(wide, rel=1e-5)
    assert result.charge[-N:-1] == pytest.approx(nearly_shut[:-1], rel=1e-4)
    assert nearly_shut.mean() < 0.95 * wide.mean()


def test_a_run_that_starts_throttled_starts_at_rest(steady):
    result = simulate(PLANT, steady, cycles(4), SPEED, throttle_deg=25.0)
    at_rest = last_steady_charge(result, PLANT.engine, 25.0)
    assert result.charge[:N] == pytest.approx(at_rest, rel=1e-5)


def test_constant_conditions_are_those_of_another_plant(narrow_design):
    controller = narrow_design.controller
    changes = {"ambient_pressure": 9e4, "temperature": 300.0, "exhaust_pressure": 1.05e5}
    engine = PLANT.engine.replace(**changes, flow_coefficient=PLANT.engine.flow_coefficient * 0.95)
    plain = simulate(PLANT.with_engine(engine), controller, cycles(6), SPEED, seed=2)
    given = simulate(
        PLANT, controller, cycles(6), SPEED, seed=2,
        conditions=Conditions(**changes, flow_factor=np.full(6 * N, 0.95)),
    )  # fmt: skip
    for name in SIGNALS:
        np.testing.assert_array_equal(getattr(given, name), getattr(plain, name))


def test_conditions_of_the_plant_change_nothing(narrow_design):
    controller = narrow_design.controller
    plain = simulate(PLANT, controller, cycles(5), SPEED, seed=2)
    given = simulate(
        PLANT, controller, cycles(5), SPEED, seed=2, throttle_deg=90.0, record_deg=10.0,
        conditions=Conditions(ambient_pressure=1e5, flow_factor=1.0),
    )  # fmt: skip
    for name in SIGNALS:
        np.testing.assert_array_equal(getattr(given, name), getattr(plain, name))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ambient_pressure", (1e5, 8e4)),
        ("temperature", (290.0, 320.0)),
        ("flow_factor", (1.0, 0.8)),
    ],
)
def test_a_step_of_a_condition_ends_in_the_new_steady_cycle(steady, name, values):
    steps = np.repeat(values, N * 25)
    result = simulate(PLANT, steady, cycles(50), SPEED, conditions=Conditions(**{name: steps}))
    engine = PLANT.engine
    if name == "flow_factor":
        after = engine.replace(flow_coefficient=0.8 * engine.flow_coefficient)
    else:
        after = engine.replace(**{name: values[1]})
    assert result.charge[: N * 24] == pytest.approx(result.charge[:N].repeat(24), rel=1e-5)
    settled = last_steady_charge(result, after)
    assert result.charge[-N:-1] == pytest.approx(settled[:-1], rel=1e-5)
    assert settled.mean() < 0.99 * result.charge[:N].mean()


def test_a_slow_ramp_of_ambient_pressure_is_followed(steady):
    m = N * 60
    ramp = np.linspace(1e5, 9e4, m)
    result = simulate(PLANT, steady, cycles(60), SPEED, conditions=Conditions(ramp))
    late = m - N - 1
    at_end = last_steady_charge(result, PLANT.engine.replace(ambient_pressure=ramp[late]))
    at_start = last_steady_charge(result, PLANT.engine)
    assert result.charge[0] == pytest.approx(at_start[0], rel=1e-4)
    # 42 Pa an event, 0.04 %: the manifold is less than two events behind
    assert result.charge[late] == pytest.approx(at_end[-1], rel=1e-3)
    assert np.all(np.diff(result.charge[N:-N]) < 0.0)


# -- cylinders that are shut -----------------------------------------------------------------------


def test_a_demand_of_zero_keeps_the_valve_shut(narrow_design):
    demand = cycles(40)
    off = (np.arange(demand.size) % N == 2) & (np.arange(demand.size) // N >= 10)
    off &= np.arange(demand.size) // N < 25
    demand[off] = 0.0
    result = simulate(PLANT, narrow_design.controller, demand, SPEED, seed=1)
    for name in ("charge", "lift_mm", "delivered_lift_mm", "delivered_duration_deg"):
        assert set(getattr(result, name)[off]) == {0.0}
    assert np.isnan(result.relative_error[10:25, 2]).all()
    assert np.isfinite(np.delete(result.relative_error[:-1], 2, axis=1)).all()
    assert result.segments == (slice(0, 10), slice(10, 25), slice(25, 40))
    assert np.isnan(result.cylinder_errors(5, 1)).tolist() == [False, False, True, False]
    assert result.worst_error(5) < 0.02
    assert result.imbalance(5, 1) < 0.02
    assert result.settling_cycles(0.05, 1) == 0
    assert "shut" in str(result)


def test_a_cylinder_may_be_shut_from_the_start(narrow_design):
    demand = cycles(8)
    demand[0::N] = 0.0
    result = simulate(PLANT, narrow_design.controller, demand, SPEED)
    assert set(result.charge[0::N]) == {0.0}
    others = np.arange(demand.size - N) % N != 0
    assert result.charge[:-N][others] == pytest.approx(2.5e-4, rel=0.03)


def test_all_cylinders_may_be_shut(narrow_design):
    result = simulate(PLANT, narrow_design.controller, cycles(6, 0.0), SPEED)
    assert set(result.charge) == {0.0}
    assert math.isnan(result.worst_error(2))
    assert math.isnan(result.worst_imbalance(2))


def test_figures_of_a_run_with_a_shut_cylinder_by_hand():
    # two cylinders, six cycles; the second is shut in cycles 2 to 4, the first is 2 % high then
    demand = np.tile((2e-4, 1e-4), 6)
    charge = demand.copy()
    demand[5:10:2] = charge[5:10:2] = 0.0
    charge[4:10:2] *= 1.02
    ones = np.ones(12)
    result = ClosedLoopResult(
        "by hand", 2, 0, 0.04 * np.arange(12), np.tile((1, 2), 6), 1500.0 * ones, demand, charge,
        demand, ones, ones, 3.0 * ones, 100.0 * ones, ones, 0.0 * ones, ones,
        np.zeros(12, dtype=bool), np.zeros(12, dtype=bool),
    )  # fmt: skip
    assert result.segments == (slice(0, 2), slice(2, 5), slice(5, 6))
    assert result.worst_error(0) == pytest.approx(0.02)
    assert result.cylinder_errors(0, 1)[0] == pytest.approx(0.02)
    assert result.imbalance(0, 1) == 0.0
    assert result.settling_cycles(0.01, 1, average=1) is None
    assert result.settling_cycles(0.03, 1, average=1) == 0
    # what was not given is what was commanded
    np.testing.assert_array_equal(result.delivered_lift_mm, result.lift_mm)
    np.testing.assert_array_equal(result.told_speed_rpm, result.speed_rpm)
    assert result.mode.tolist() == result.alarms.tolist() == [0] * 12


# -- what is recorded --------------------------------------------------------------------------


def test_crank_level_signals_hold_the_charges(steady):
    result = simulate(PLANT, steady, cycles(4), SPEED, record_deg=1.0)
    trace = result.trace
    assert np.diff(trace.crank_angle_deg) == pytest.approx(1.0)
    assert trace.crank_angle_deg[0] == -5.0
    assert trace.crank_angle_deg.size == 4 * 720
    assert np.diff(trace.time) == pytest.approx(1.0 / (6.0 * SPEED))
    # the flow through a valve adds up to the charge of its event
    for event in range(4, 8):
        part = slice(event * 180, event * 180 + 180)
        inflow = trace.port_flow[part, event % N].sum() / (6.0 * SPEED)
        assert inflow == pytest.approx(result.charge[event], rel=2e-3)


def test_crank_level_time_is_that_of_the_events(steady):
    speeds = np.linspace(1350.0, 1650.0, 4 * N)
    result = simulate(PLANT, steady, cycles(4), speeds, record_deg=5.0)
    data = result.crank_dataset()
    opening = 180.0 * np.arange(4 * N)
    at_opening = np.interp(opening, data["crank_angle"], data["time"])
    assert at_opening == pytest.approx(result.time, abs=1e-9)
    assert data["time"].attrs["units"] == "s"
    assert data["manifold_pressure"].dims == ("crank_angle",)


def test_the_recorded_step_divides_the_windows_evenly(steady):
    # 360 points a window: the divisor nearest to 14 points, by ratio, is 15
    result = simulate(PLANT, steady, cycles(1), SPEED, record_deg=7.0)
    assert np.diff(result.trace.crank_angle_deg) == pytest.approx(7.5)


def test_without_record_there_are_no_crank_level_signals(steady):
    result = simulate(PLANT, steady, cycles(1), SPEED)
    assert result.trace is None
    with pytest.raises(ParameterError, match="give simulate"):
        result.crank_dataset()


def test_the_data_set_tells_what_was_delivered_and_what_failed(steady):
    fault = Fault("valve-stuck", 0.05, cylinder=1)
    result = simulate(PLANT, steady, cycles(2), SPEED, faults=[fault], throttle_deg=60.0)
    data = result.to_dataset()
    assert data["delivered_lift"].values[4] == 0.0
    assert set(data["throttle"].values) == {60.0}
    assert data["told_speed"].attrs["units"] == "rpm"
    assert data["alarms"].dtype.kind == data["mode"].dtype.kind == "i"
    assert data.attrs["faults"] == "valve-stuck of cylinder 1 from 0.05 s"


def test_progress_is_told_to_the_end(steady):
    told = []
    simulate(PLANT, steady, cycles(27), SPEED, progress=lambda *call: told.append(call))
    assert told == [(50, 108), (100, 108), (108, 108)]


def test_runs_with_faults_are_averaged_with_their_alarms(steady):
    fault = (Fault("maf-offset", 0.1),)
    runs = [simulate(PLANT, steady, cycles(3), SPEED, faults=fault, seed=s) for s in (0, 1)]
    alarms = [np.where(np.arange(12) == k, 1 << k, 0) for k in (2, 3)]
    for run, bits in zip(runs, alarms, strict=True):
        run.alarms[:] = bits
    mean = averaged(runs)
    assert mean.alarms.tolist() == [0, 0, 4, 8] + [0] * 8
    assert mean.charge == pytest.approx(0.5 * (runs[0].charge + runs[1].charge), nan_ok=True)
    with pytest.raises(ParameterError, match="faults"):
        averaged([runs[0], simulate(PLANT, steady, cycles(3), SPEED)])


# -- errors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"throttle_deg": np.full(3, 90.0)}, r"throttle_deg has shape \(3,\)"),
        ({"throttle_deg": 2.0}, "throttle_deg is 2 deg"),
        (
            {"conditions": Conditions(temperature=np.full(3, 290.0))},
            r"temperature has shape \(3,\)",
        ),
        ({"record_deg": 0.0}, "record_deg is 0 deg"),
    ],
)
def test_wrong_conditions_are_named(steady, options, message):
    with pytest.raises(ParameterError, match=message):
        simulate(PLANT, steady, cycles(2), SPEED, **options)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"ambient_pressure": [1e5, -1.0]}, "ambient_pressure is -1 Pa"),
        ({"temperature": math.nan}, "temperature is nan K"),
        ({"flow_factor": "much"}, "flow_factor is 'much'"),
    ],
)
def test_conditions_must_be_positive_numbers(values, message):
    with pytest.raises(ParameterError, match=message):
        Conditions(**values)


def test_another_engine_is_left_alone(steady):
    # the conditions change the true engine only while the run lasts
    before = PLANT.engine
    simulate(PLANT, steady, cycles(1), SPEED, conditions=Conditions(temperature=300.0))
    assert PLANT.engine is before == Engine.paper()
    assert CrankAnglePlant(oscillation=True).fingerprint == PLANT.fingerprint
