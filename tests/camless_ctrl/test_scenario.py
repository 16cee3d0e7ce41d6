import json
import math

import numpy as np
import pytest

from camless_ctrl import scenario_run
from camless_ctrl.closed_loop import ValveErrors, simulate
from camless_ctrl.closed_loop_requirement import ClosedLoopRequirement
from camless_ctrl.faults import Fault
from camless_ctrl.metrics import AlarmTime, ModeTime, SteadyError, WorstError
from camless_ctrl.operating_profile import OperatingProfile, Signal
from camless_ctrl.scenario import ControllerChoice, Scenario, ScenarioError
from camless_ctrl.scenario_run import run_scenario
from plant import CrankAnglePlant, Engine, ParameterError
from plant.sampling import CrankSampling
from plant.sensors import MafSensor, MapSensor, SensorSet

WEAK = (1.03, 0.85, 0.96, 1.05)


def scenario(**changes):
    given = {
        "name": "test",
        "description": "a step",
        "profile": OperatingProfile(
            Signal.steps([200.0, 300.0], at=[2.0]), 1500.0, axis="cycles", length=6.0
        ),
    }
    return Scenario(**given | changes)


def asked(metric):
    return ClosedLoopRequirement(metric.kind, metric, 1.0, metric.unit, "test")


def full():
    engine = Engine.paper()
    return scenario(
        profile=OperatingProfile(
            Signal.points([[0.0, 100.0], [0.1, 1.0 / 3.0 * 1e3]]),
            Signal.ramp(1000.0, 1500.0, end=0.3),
            temperature=Signal.constant(300.0),
            deactivated=((2, 0.1, 0.2),),
        ),
        engine=engine.replace(
            n_cylinders=3, valvetrain=engine.valvetrain.replace(maximum_lift_mm=7.9)
        ),
        true={
            "cylinder_flow_factors": WEAK[:3],
            "flow_factor": 1.1,
            "throttle": {"scale": 1.2e-4},
        },
        sensors=SensorSet(
            maf=MafSensor(gain_error=0.02, bits=None, sampling=CrankSampling(6.0, 1.0))
        ),
        valves=ValveErrors((0.0, 1e-4, -1e-4), 5e-5),
        faults=(Fault("valve-lift", 0.1, size=0.5, cylinder=3), Fault("maf-nan", 0.1, 0.2)),
        controller=ControllerChoice("gradient", 7, (900.0, 1600.0), False),
        requirements=(
            ClosedLoopRequirement("a", SteadyError(3), 1.0, "%", "test"),
            ClosedLoopRequirement("b", WorstError(window="during", fault=2), 9.0, "%", "test"),
        ),
        seed=11,
    )


@pytest.mark.parametrize("make", [scenario, full])
def test_a_scenario_is_the_same_after_json(make):
    before = make()
    again = Scenario.from_dict(json.loads(json.dumps(before.to_dict(), allow_nan=False)))
    assert again == before
    assert again.true_engine == before.true_engine
    assert again.to_dict() == before.to_dict()


def test_the_data_do_not_lean_on_the_defaults():
    data = scenario().to_dict()
    assert data["engine"]["temperature"] == Engine.paper().temperature
    assert data["engine"]["valvetrain"]["opening_slope_mm_s"] == 3500.0
    assert data["sensors"]["maf"]["time_constant"] == MafSensor().time_constant


def test_the_true_engine_differs_where_it_is_told():
    base = Engine.paper()
    true = full().true_engine
    assert true.flow_coefficient == pytest.approx(1.1 * base.flow_coefficient, rel=1e-15)
    assert true.cylinder_flow_factors == WEAK[:3]
    assert true.throttle == base.throttle.replace(scale=1.2e-4)
    assert true.n_cylinders == 3
    assert true.valvetrain.maximum_lift_mm == 7.9
    assert true.temperature == base.temperature
    assert full().engine.cylinder_flow_factors == ()


def test_the_assumed_sensors_are_the_default_ones_if_they_are_not_known():
    assert full().assumed_sensors == SensorSet()
    known = full().replace(controller=ControllerChoice())
    assert known.assumed_sensors == full().sensors


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name": "  "}, ["name", "empty"]),
        ({"seed": -1}, ["seed", "-1"]),
        ({"engine": Engine(cylinder_flow_factors=WEAK)}, ["equal cylinders", "true engine"]),
        ({"true": {"temprature": 300.0}}, ["temprature", "'temperature'"]),
        ({"true": {"n_cylinders": 3}}, ["n_cylinders"]),
        ({"true": {"temperature": -1.0}}, ["temperature", "-1 K"]),
        ({"true": {"cylinder_flow_factors": [1.0, 1.1]}}, ["2 values", "4 cylinders"]),
        ({"true": {"flow_factor": 1.1, "flow_coefficient": 0.02}}, ["one of them"]),
        ({"valves": ValveErrors((0.0, 0.0))}, ["duration_offset", "2 values", "4 cylinders"]),
        ({"faults": (Fault("valve-stuck", 0.0, cylinder=5),)}, ["5", "4 cylinders"]),
        (
            {"profile": OperatingProfile(1.0, 900.0, length=1.0, deactivated=((6, 0.0, 1.0),))},
            ["6", "4 cylinders"],
        ),
        # Six cycles at 1500 rpm take 0.48 s, the last of 24 events is one gap of 20 ms before.
        ({"faults": (Fault("maf-nan", 0.4), Fault("maf-nan", 0.47))}, ["2 start", "0.46 s"]),
        ({"requirements": (asked(AlarmTime("maf")),)}, ["1 fault", "has none"]),
        (
            {"faults": (Fault("maf-nan", 0.1),), "requirements": (asked(ModeTime(2)),)},
            ["1 fault", "fault is 2", "from 1 to 1"],
        ),
        ({"requirements": (asked(WorstError(window="before")),)}, ["1 fault", "has none"]),
        (
            {"requirements": (asked(SteadyError(without_cylinders=(1, 7))),)},
            ["without_cylinders", "7", "4 cylinders"],
        ),
        (
            {"requirements": (ClosedLoopRequirement("a", SteadyError(), 1.0, "%", "x"),) * 2},
            ["'a'", "name of its own"],
        ),
    ],
)
def test_a_scenario_that_contradicts_itself_says_why(changes, words):
    with pytest.raises(ParameterError) as error:
        scenario(**changes)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"law": "magic"}, ["'magic'", "least-squares", "feedforward"]),
        ({"warm_up_cycles": 1.5}, ["warm_up_cycles", "whole"]),
        ({"speed_range_rpm": (1500.0, 1500.0)}, ["speed_range_rpm[1]", "1500"]),
        ({"speed_range_rpm": 1500.0}, ["speed_range_rpm", "lowest and the highest"]),
    ],
)
def test_a_controller_that_cannot_be_says_why(changes, words):
    with pytest.raises(ParameterError) as error:
        ControllerChoice(**changes)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("path", "value", "place"),
    [
        (("seed",), math.inf, ("seed",)),
        (("profile", "speed_rpm", "points"), [[0.0, math.nan]], ("profile", "speed_rpm", "points")),
        (("profile", "colour"), 1, ("profile", "colour")),
        (("sensors", "maf", "delay"), -1.0, ("sensors", "maf", "delay")),
        (("sensors", "maf", "sampling"), {}, ("sensors", "maf", "sampling")),
        (("engine", "valvetrain", "roundness"), 2.0, ("engine", "valvetrain", "roundness")),
        (("faults", 1, "end"), 0.0, ("faults", 1, "end")),
        (("requirements", 0, "bound"), "x", ("requirements", 0, "bound")),
        (("controller", "law"), 3, ("controller", "law")),
        (("true", "throttle"), 3.0, ("true", "throttle")),
    ],
)
def test_wrong_data_are_told_by_their_place(path, value, place):
    data = full().to_dict()
    at = data
    for step in path[:-1]:
        at = at[step]
    at[path[-1]] = value
    with pytest.raises(ScenarioError) as error:
        Scenario.from_dict(data)
    assert error.value.place == place


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"profile": OperatingProfile(200.0, 700.0, length=0.2)}, ["700 rpm", "750 to 6000"]),
        (
            {"controller": ControllerChoice(speed_range_rpm=(1600.0, 2000.0))},
            ["1500 rpm", "1600 to 2000", "widen"],
        ),
        (
            {"controller": ControllerChoice(speed_range_rpm=(1000.0, 6500.0))},
            ["1000 to 6500", "750 to 6000"],
        ),
        ({"sensors": SensorSet(maf=MafSensor(bits=None))}, ["[sensors.maf] noise", "solution"]),
        ({"sensors": SensorSet(map=MapSensor(noise=0.0, bits=None))}, ["[sensors.map] noise"]),
    ],
)
def test_what_no_design_can_be_made_for_is_told_before_one_is(monkeypatch, changes, words):
    def made(*_args, **_kwargs):
        pytest.fail("a design is being made")

    monkeypatch.setattr(scenario_run, "stored_design", made)
    with pytest.raises(ScenarioError) as error:
        run_scenario(scenario(**changes))
    for word in words:
        assert word in str(error.value)


def test_a_design_of_its_own_may_know_sensors_that_the_estimator_would_refuse(narrow_design):
    exact = SensorSet(maf=MafSensor(bits=None, relative_noise=0.0))
    which = scenario(sensors=exact)
    assert Scenario.from_dict(which.to_dict()) == which  # and its results can be read again
    assert np.isfinite(run_scenario(which, narrow_design).run.charge[:-4]).all()


def test_a_run_is_the_simulation_of_the_warm_up_and_the_profile(narrow_design):
    which = scenario(
        true={"cylinder_flow_factors": WEAK},
        valves=ValveErrors(0.0, 5e-5),
        controller=ControllerChoice(warm_up_cycles=3),
        seed=5,
    )
    result = run_scenario(which, narrow_design)
    plant = CrankAnglePlant(
        Engine.paper().replace(cylinder_flow_factors=WEAK), runner=True, oscillation=True
    )
    demand = np.repeat([200e-6, 300e-6], [20, 16])
    by_hand = simulate(
        plant, narrow_design.controller, demand, 1500.0, valves=ValveErrors(0.0, 5e-5), seed=5
    )
    np.testing.assert_allclose(result.run.demand, demand, rtol=1e-12)
    np.testing.assert_allclose(result.run.charge, by_hand.charge, rtol=1e-9)
    np.testing.assert_allclose(result.run.time, by_hand.time - 0.24, atol=1e-9)
    assert result.run.time[12] == 0.0
    assert result.seed == 5
    other = run_scenario(which, narrow_design, seed=6)
    assert not np.allclose(other.run.charge, result.run.charge, rtol=1e-9, equal_nan=True)


def test_conditions_that_hold_throughout_are_those_of_another_engine(narrow_design):
    profile = {"demand_mg": 250.0, "speed_rpm": 1500.0, "axis": "cycles", "length": 5.0}
    over_time = scenario(
        profile=OperatingProfile(
            **profile,
            ambient_pressure=80e3,
            exhaust_pressure=90e3,
            temperature=300.0,
            flow_factor=0.8,
        )
    )
    other_engine = scenario(
        profile=OperatingProfile(**profile),
        true={
            "ambient_pressure": 80e3,
            "exhaust_pressure": 90e3,
            "temperature": 300.0,
            "flow_factor": 0.8,
        },
    )
    one, two = (run_scenario(s, narrow_design).run for s in (over_time, other_engine))
    np.testing.assert_allclose(one.charge, two.charge, rtol=1e-9)
    nominal = run_scenario(scenario(profile=OperatingProfile(**profile)), narrow_design).run
    assert one.charge[0] < 0.9 * nominal.charge[0]


def test_faults_and_deactivation_count_from_the_start_of_the_profile(narrow_design):
    which = scenario(
        profile=OperatingProfile(250.0, 1500.0, length=0.8, deactivated=((3, 0.4, 0.6),)),
        faults=(Fault("valve-stuck", 0.2, 0.4, cylinder=2),),
        controller=ControllerChoice(warm_up_cycles=4),
    )
    result = run_scenario(which, narrow_design)
    run = result.run
    shut = np.flatnonzero(run.delivered_lift_mm == 0.0)
    # Events come each 20 ms: 2 opens at 0.02 + 0.08 k, 3 at 0.04 + 0.08 k.
    np.testing.assert_allclose(run.time[shut], [0.26, 0.34, 0.44, 0.52], atol=1e-9)
    np.testing.assert_array_equal(run.cylinder[shut], [2, 2, 3, 3])
    np.testing.assert_array_equal(np.flatnonzero(run.demand == 0.0), shut[2:])
    assert run.faults == which.faults


def test_laws_are_those_that_are_asked_for(narrow_design):
    profile = OperatingProfile(250.0, 1500.0, axis="cycles", length=12.0)
    late = {"profile": profile, "valves": ValveErrors((0.0, 2e-4, 0.0, 0.0))}
    runs = {
        law: run_scenario(scenario(**late, controller=ControllerChoice(law)), narrow_design).run
        for law in ("least-squares", "gradient", "integral", "feedforward")
    }
    assert not runs["feedforward"].adapted.any()
    assert all(runs[law].adapted.any() for law in ("least-squares", "gradient", "integral"))
    # The integral law moves charge factors alone, the others offsets of the duration.
    assert not runs["integral"].duration_offset.any()
    assert runs["gradient"].duration_offset.any()
    assert not np.array_equal(runs["gradient"].charge, runs["least-squares"].charge)


def test_crank_level_signals_count_from_the_start_of_the_profile(narrow_design):
    which = scenario(controller=ControllerChoice(warm_up_cycles=2))
    run = run_scenario(which, narrow_design, record_deg=5.0).run
    lift, time = run.trace.lift_mm[:, 0], run.trace.time
    # The first cylinder opens at the start: the first lift from then on comes at once.
    opens = time[np.flatnonzero((lift > 0.0) & (time > -1e-3))[0]]
    assert opens == pytest.approx(0.0, abs=10.0 / (6.0 * 1500.0))
    assert time[0] < -0.15


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"engine": Engine(temperature=300.0)}, ["nominal engine", "scenario_design"]),
        (
            {"profile": OperatingProfile(200.0, 3000.0, length=0.2)},
            ["3000", "1300", "1700", "speed_range_rpm"],
        ),
    ],
)
def test_a_run_that_makes_no_sense_is_refused(narrow_design, changes, words):
    with pytest.raises(ParameterError) as error:
        run_scenario(scenario(**changes), narrow_design)
    for word in words:
        assert word in str(error.value)
