import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camless_ctrl.operating_profile import Deactivation, OperatingProfile, Signal
from plant import ParameterError

FINITE = st.floats(-1e6, 1e6, allow_nan=False)


def test_points_are_joined_and_held_at_the_ends():
    signal = Signal.points([[1.0, 10.0], [3.0, 20.0]])
    np.testing.assert_allclose(signal.at([0.0, 1.0, 1.5, 3.0, 9.0]), [10.0, 10.0, 12.5, 20.0, 20.0])


def test_held_points_jump_at_their_position():
    signal = Signal.points([[1.0, 10.0], [3.0, 20.0]], "hold")
    np.testing.assert_array_equal(signal.at([0.0, 2.999, 3.0, 4.0]), [10.0, 10.0, 20.0, 20.0])


def test_a_ramp_is_a_line_between_two_positions():
    signal = Signal.ramp(100.0, 200.0, start=2.0, end=4.0)
    np.testing.assert_allclose(signal.at([0.0, 2.0, 2.5, 4.0, 5.0]), [100, 100, 125, 200, 200])


@pytest.mark.parametrize("how", [{"every": 2.0}, {"at": [2.0, 4.0]}])
def test_steps_come_at_their_positions_or_at_even_distances(how):
    signal = Signal.steps([1.0, 5.0, 3.0], **how)
    np.testing.assert_array_equal(signal.at([0.0, 1.9, 2.0, 3.9, 4.0, 99.0]), [1, 1, 5, 5, 3, 3])


@given(st.lists(st.tuples(FINITE, FINITE), min_size=1, max_size=8, unique_by=lambda p: p[0]))
def test_a_signal_is_the_same_after_json(points):
    signal = Signal.points(sorted(points), "hold")
    again = Signal.from_dict(json.loads(json.dumps(signal.to_dict())))
    where = np.linspace(-2e6, 2e6, 31)
    np.testing.assert_array_equal(again.at(where), signal.at(where))
    assert again.to_dict() == signal.to_dict()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("fast", ["'fast'", "number"]),
        ([100.0, 200.0], ["[100.0, 200.0]", "number", "points, ramp, steps, file"]),
        (math.nan, ["nan", "1e+09"]),
        ({"points": [[0.0, 1.0]], "ramp": [1.0, 2.0]}, ["points, ramp", "exactly one"]),
        ({"pionts": [[0.0, 1.0]]}, ["pionts", "points"]),
        ({"points": [[0.0, 1.0], [0.0, 2.0]]}, ["point 2", "after point 1"]),
        ({"points": [[0.0, 1.0, 2.0]]}, ["point 1", "pair"]),
        ({"points": [[0.0, 1.0]], "betwen": "hold"}, ["betwen", "'between'"]),
        ({"points": [[0.0, 1.0]], "between": "spline"}, ["'spline'", "linear", "hold"]),
        ({"ramp": [1.0, 2.0]}, ["ramp", "end"]),
        ({"ramp": [1.0, 2.0], "start": 3.0, "end": 3.0}, ["point 2", "after"]),
        ({"steps": [1.0, 2.0]}, ["every", "at"]),
        ({"steps": [1.0, 2.0], "at": [1.0, 2.0]}, ["2 values", "one step fewer"]),
        ({"steps": [1.0, 2.0], "every": 0.0}, ["every is 0", "(0, 1e+09]"]),
        ({"file": "a.csv", "column": "x"}, ["a.csv", "no folder"]),
    ],
)
def test_a_signal_that_cannot_be_says_why(data, words):
    with pytest.raises(ParameterError) as error:
        Signal.from_dict(data)
    for word in words:
        assert word in str(error.value)


def test_columns_of_a_plain_table(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,speed_rpm,demand_mg\n0,1000,100\n1,1500,200\n")
    signal = Signal.from_dict({"file": "a.csv", "column": "demand_mg"}, tmp_path)
    assert signal == Signal((0.0, 1.0), (100.0, 200.0))


def test_columns_of_a_measurement_that_was_written_out(tmp_path):
    text = '"timestamps";"Load, total";"nEng"\n"s";"mg";"rpm"\n0.0;1.5;800\n0.5;2.5;900\n'
    (tmp_path / "m.csv").write_text(text, encoding="utf-8-sig")
    signal = Signal.column(tmp_path / "m.csv", "Load, total", between="hold")
    assert signal == Signal((0.0, 0.5), (1.5, 2.5), "hold")


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("time_s,demand_mg\n0,1\n1,2\n", "demand", ["'demand'", "did you mean 'demand_mg'"]),
        ("t,demand_mg\n0,1\n", "demand_mg", ["timestamps, time_s, time", "t, demand_mg"]),
        ("time_s,demand_mg\n0,1\n1,NaN\n", "demand_mg", ["row 3", "'demand_mg'", "'NaN'"]),
        ("time_s,demand_mg\n0,1\n1,x\n", "demand_mg", ["row 3", "'x'", "no number"]),
        ("time_s;demand_mg\n0;1,5\n", "demand_mg", ["row 2", "'1,5'", "point"]),
        ("time_s,demand_mg\n0,1\n2,1\n1,1\n", "demand_mg", ["row 4", "'time_s'", "above 2"]),
        (
            "time_s,demand_mg\n0,1\n1\n",
            "demand_mg",
            ["row 3 has 1 cell,", "ends before 'demand_mg'"],
        ),
        (
            "time_s,x,demand_mg\n0,1,2\n1,5,0,3\n",
            "demand_mg",
            ["row 3 has 4 cells", "has 3", "'3'"],
        ),
        ("time_s,demand_mg,x\n0,1\n", "demand_mg", ["row 2 has 2 cells", "has 3", "before 'x'"]),
        ("time_s,demand_mg\ns\n0,1\n", "demand_mg", ["row 2 has 1 cell,"]),
        ("time_s,demand_mg\n0,1\n1,\n", "demand_mg", ["row 3", "'demand_mg'", "empty"]),
        ("time_s,demand_mg\nms,mg\n0,1\n", "demand_mg", ["row 2", "'ms'", "seconds"]),
        ("time_s,demand_mg\n", "demand_mg", ["no row of numbers"]),
        ("time_s,x,x\n0,1,2\n", "x", ["several columns 'x'"]),
        ("", "demand_mg", ["empty"]),
    ],
)
def test_a_table_that_cannot_be_used_says_where(tmp_path, text, column, words):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ParameterError) as error:
        Signal.from_dict({"file": "a.csv", "column": column}, tmp_path)
    for word in ["a.csv", *words]:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("quantity", "told", "value", "wanted"),
    [
        ("demand_mg", "mg", 250.0, 250.0),
        ("demand_mg", "[g]", 0.25, 250.0),
        ("demand_mg", "kg", 2.5e-4, 250.0),
        ("demand_mg", "", 250.0, 250.0),
        ("speed_rpm", "1/min", 1500.0, 1500.0),
        ("throttle_deg", "°", 45.0, 45.0),
        ("ambient_pressure", "Pa", 1e5, 1e5),
        ("ambient_pressure", "hPa", 1013.25, 101325.0),
        ("exhaust_pressure", "mbar", 1013.25, 101325.0),
        ("ambient_pressure", "kPa", 101.325, 101325.0),
        ("ambient_pressure", "bar", 1.01325, 101325.0),
        ("temperature", "K", 290.0, 290.0),
        ("temperature", "degC", 20.0, 293.15),
        ("temperature", "°C", -13.15, 260.0),
        ("flow_factor", "1", 0.9, 0.9),
        ("flow_factor", "%", 90.0, 0.9),
    ],
)
def test_a_column_is_converted_to_the_unit_of_its_key(tmp_path, quantity, told, value, wanted):
    (tmp_path / "a.csv").write_text(f"time;x\ns;{told}\n0;{value!r}\n", encoding="utf-8")
    data = {"demand_mg": 100.0, "speed_rpm": 1500.0, "length": 1.0}
    data[quantity] = {"file": "a.csv", "column": "x"}
    (found,) = getattr(OperatingProfile.from_dict(data, tmp_path), quantity).values
    assert found == pytest.approx(wanted, rel=1e-14)


@pytest.mark.parametrize(
    ("quantity", "told", "allowed"),
    [
        ("demand_mg", "kg/h", "mg, g, kg"),
        ("speed_rpm", "rad/s", "rpm, 1/min"),
        ("throttle_deg", "%", "deg"),
        ("ambient_pressure", "psi", "Pa, hPa, mbar, kPa, bar"),
        ("ambient_pressure", "mPa", "Pa, hPa, mbar, kPa, bar"),
        ("temperature", "degF", "K, degC"),
        ("flow_factor", "kg/s", "1, -, %"),
    ],
)
def test_a_unit_that_does_not_fit_is_refused(tmp_path, quantity, told, allowed):
    (tmp_path / "a.csv").write_text(f"time,x\ns,{told}\n0,100\n")
    data = {"demand_mg": 100.0, "speed_rpm": 1500.0, "length": 1.0}
    data[quantity] = {"file": "a.csv", "column": "x"}
    with pytest.raises(ParameterError) as error:
        OperatingProfile.from_dict(data, tmp_path)
    for word in ("row 2", "'x'", repr(told), allowed, quantity):
        assert word in str(error.value)


def test_a_column_alone_is_taken_as_it_is_unless_its_unit_is_named(tmp_path):
    (tmp_path / "a.csv").write_text("time,p\ns,bar\n0,1\n")
    assert Signal.column(tmp_path / "a.csv", "p").values == (1.0,)
    assert Signal.column(tmp_path / "a.csv", "p", unit="Pa").values == (1e5,)
    with pytest.raises(ParameterError, match="unit is 'psi', but must be one of mg"):
        Signal.column(tmp_path / "a.csv", "p", unit="psi")


def test_a_table_that_is_not_there(tmp_path):
    with pytest.raises(ParameterError, match=r"missing\.csv cannot be read") as error:
        Signal.from_dict({"file": "missing.csv", "column": "x"}, tmp_path)
    assert str(error.value).count("missing.csv") == 1


@pytest.mark.parametrize("name", ["../a.csv", "link.csv", "{absolute}"])
def test_tables_outside_of_the_folder_are_refused(tmp_path, name):
    outside, folder = tmp_path / "a.csv", tmp_path / "in"
    outside.write_text("time,x\n0,1\n")
    folder.mkdir()
    (folder / "link.csv").symlink_to(outside)
    with pytest.raises(ParameterError, match="must lie in the scenario's folder"):
        Signal.from_dict({"file": name.format(absolute=outside), "column": "x"}, folder)


def test_events_of_constant_speed_are_even():
    events = OperatingProfile(100.0, 1500.0, length=0.1).events(4)
    np.testing.assert_allclose(events.time, [0.0, 0.02, 0.04, 0.06, 0.08], rtol=1e-12)
    np.testing.assert_allclose(events.demand, 100e-6, rtol=1e-12)
    assert events.throttle_deg is None
    assert events.conditions is None


def test_events_on_an_edge_are_not_moved_by_rounding():
    # 450 events of 20 ms: the sum of the intervals misses 9 s by rounding.
    profile = OperatingProfile(
        Signal.steps([100.0, 200.0], at=[7.0]),
        1500.0,
        length=9.0,
        deactivated=((3, 1.0, 5.0),),  # opens at 0.04 + 0.08 k: at 1.00 and at 5.00 too
    )
    demand = profile.events(4).demand
    assert demand.size == 450
    np.testing.assert_array_equal(np.flatnonzero(demand == 0.0), np.arange(50, 250, 4))
    assert np.argmax(demand > 150e-6) == 350


def test_events_follow_the_speed_over_time():
    profile = OperatingProfile(100.0, Signal.ramp(1000.0, 5000.0, end=2.0), length=2.0)
    events = profile.events(4)
    np.testing.assert_allclose(events.speed_rpm, 1000.0 + 2000.0 * events.time, rtol=1e-12)
    np.testing.assert_allclose(np.diff(events.time), 30.0 / events.speed_rpm[:-1], rtol=1e-9)
    # 2 s at 3000 rpm in the mean are 100 turns, and two events come in each.
    assert events.time.size == pytest.approx(200, rel=0.02)


def test_cycles_count_events_whatever_the_speed():
    profile = OperatingProfile(
        Signal.steps([100.0, 200.0], at=[2.0]),
        Signal.ramp(1000.0, 2000.0, end=4.0),
        axis="cycles",
        length=4.0,
    )
    events = profile.events(3)
    assert events.demand.size == 12
    np.testing.assert_allclose(events.demand, np.repeat([100e-6, 200e-6], 6), rtol=1e-12)
    np.testing.assert_allclose(events.speed_rpm, 1000.0 + 1000.0 / 12.0 * np.arange(12), rtol=1e-12)
    np.testing.assert_allclose(np.diff(events.time), 40.0 / events.speed_rpm[:-1], rtol=1e-9)


@pytest.mark.parametrize("axis", ["time", "cycles"])
def test_the_warm_up_holds_what_is_at_the_start(axis):
    profile = OperatingProfile(
        Signal.points([[0.0, 100.0], [1.0, 200.0]]),
        Signal.points([[0.0, 1200.0], [1.0, 1500.0]]),
        temperature=Signal.points([[0.0, 280.0], [1.0, 300.0]]),
        axis=axis,
    )
    bare, events = profile.events(4), profile.events(4, warm_up_cycles=3)
    assert events.time.size == bare.time.size + 12
    np.testing.assert_array_equal(events.time[12:], bare.time)
    np.testing.assert_allclose(events.time[:12], 0.025 * np.arange(-12, 0), atol=1e-12)
    np.testing.assert_array_equal(events.demand[12:], bare.demand)
    np.testing.assert_allclose(events.demand[:13], 100e-6, rtol=1e-12)
    assert set(events.speed_rpm[:13]) == {1200.0}
    assert set(events.conditions.temperature[:13]) == {280.0}


def test_conditions_are_those_that_are_given():
    profile = OperatingProfile(
        100.0, 1500.0, flow_factor=Signal.ramp(1.0, 0.8, end=1.0), throttle_deg=40.0
    )
    events = profile.events(4)
    np.testing.assert_allclose(events.conditions.flow_factor, 1.0 - 0.2 * events.time, rtol=1e-9)
    assert events.conditions.ambient_pressure is None
    np.testing.assert_array_equal(events.throttle_deg, np.full(events.time.size, 40.0))


def test_a_deactivated_cylinder_demands_nothing_from_start_to_end():
    profile = OperatingProfile(
        100.0, 1500.0, axis="cycles", length=6.0, deactivated=(Deactivation(2, 2.25, 4.0),)
    )
    demand = profile.events(4).demand.reshape(6, 4)
    shut = np.argwhere(demand == 0.0)
    # Cylinder 2 opens a quarter of a cycle after cylinder 1: at 2.25 the first time.
    np.testing.assert_array_equal(shut, [[2, 1], [3, 1]])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"demand_mg": -1.0}, ["demand_mg", "-1"]),
        ({"speed_rpm": Signal.ramp(1000.0, 0.0, end=1.0)}, ["speed_rpm", "0 rpm", "50"]),
        ({"temperature": 20.0}, ["temperature", "20 K", "150"]),
        ({"ambient_pressure": 75.0}, ["ambient_pressure", "75 Pa", "10000"]),
        ({"throttle_deg": 95.0}, ["throttle_deg", "95 deg", "90"]),
        ({"length": 0.0}, ["length", "0 s"]),
        ({"length": math.inf}, ["length", "inf"]),
        ({"axis": "angle"}, ["axis", "'angle'", "time", "cycles"]),
        ({"deactivated": ((0, 0.0, 1.0),)}, ["cylinder", "0"]),
        ({"deactivated": ((1, 1.0, 1.0),)}, ["end", "1"]),
    ],
)
def test_a_profile_that_cannot_be_says_why(changes, words):
    with pytest.raises(ParameterError) as error:
        OperatingProfile(**{"demand_mg": 100.0, "speed_rpm": 1500.0, "length": 1.0} | changes)
    for word in words:
        assert word in str(error.value)


def test_a_cylinder_that_is_not_there_cannot_be_shut_off():
    profile = OperatingProfile(100.0, 1500.0, length=1.0, deactivated=((4, 0.0, 1.0),))
    with pytest.raises(ParameterError, match="from 1 to 3"):
        profile.events(3)


@pytest.mark.parametrize("axis", ["time", "cycles"])
def test_a_length_without_bounds_is_refused_before_it_is_run(axis):
    profile = OperatingProfile(100.0, 20_000.0, length=1e6, axis=axis)
    with pytest.raises(ParameterError, match="more than 1000000 events"):
        profile.events(24)


def test_the_length_is_up_to_the_last_point():
    ramp = Signal.ramp(100.0, 200.0, end=3.0)
    assert OperatingProfile(ramp, 1500.0).length == 3.0


def test_a_profile_is_the_same_after_json():
    profile = OperatingProfile(
        Signal.steps([0.1, 1.0 / 3.0], at=[0.7]),
        1500.0,
        flow_factor=Signal.ramp(1.0, 0.9, end=math.pi),
        deactivated=((1, 0.1, 0.2),),
    )
    assert OperatingProfile.from_dict(json.loads(json.dumps(profile.to_dict()))) == profile
