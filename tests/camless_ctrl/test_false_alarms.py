"""Fault-free operation of sampled engines: what is sampled, and that alarms are counted."""

import json

import numpy as np
import pytest

from camless_ctrl import false_alarms
from camless_ctrl.alarms import Alarm
from camless_ctrl.closed_loop import simulate
from camless_ctrl.false_alarms import FalseAlarmCount, check_false_alarms, random_operation
from camless_ctrl.faults import Fault
from plant.errors import ParameterError
from plant.sensors import (
    MAF_DELAYS,
    MAF_GAIN_TOLERANCE,
    MAF_TIME_CONSTANTS,
    MAP_OFFSET_TOLERANCE,
)

CYCLES = 60


@pytest.fixture(scope="module")
def operations(narrow_design):
    return [random_operation(narrow_design, CYCLES, seed) for seed in range(40)]


def test_an_operation_is_that_of_its_seed(narrow_design, operations):
    again = random_operation(narrow_design, CYCLES, 3)
    same, other = operations[3], operations[4]
    assert again.engine == same.engine
    assert again.sensors == same.sensors
    assert again.valves == same.valves
    np.testing.assert_array_equal(again.demand, same.demand)
    np.testing.assert_array_equal(again.speed_rpm, same.speed_rpm)
    assert other.engine != same.engine
    assert other.sensors != same.sensors
    assert not np.array_equal(other.demand, same.demand)


def spread(values, low, high, share=0.6):
    """Whether values lie between bounds, and fill a share of the room between them."""
    values = np.ravel(values)
    assert values.min() >= low
    assert values.max() <= high
    return np.ptp(values) > share * (high - low)


def test_engines_and_sensors_fill_their_tolerances(narrow_design, operations):
    base = narrow_design.engine
    engines = [o.engine for o in operations]
    mafs = [o.sensors.maf for o in operations]
    assert spread([e.cylinder_flow_factors for e in engines], 0.88, 1.08)
    assert spread([e.flow_coefficient / base.flow_coefficient for e in engines], 0.9, 1.1)
    assert spread([e.temperature for e in engines], 270.0, 320.0)
    assert spread([e.ambient_pressure / base.ambient_pressure for e in engines], 0.75, 1.03)
    assert spread([o.valves.duration_offset for o in operations], -2e-4, 2e-4)
    assert spread([m.gain_error for m in mafs], -MAF_GAIN_TOLERANCE, MAF_GAIN_TOLERANCE)
    assert spread([m.time_constant for m in mafs], *MAF_TIME_CONSTANTS)
    assert spread([m.delay for m in mafs], *MAF_DELAYS)
    offsets = [o.sensors.map.offset for o in operations]
    assert spread(offsets, -MAP_OFFSET_TOLERANCE, MAP_OFFSET_TOLERANCE)
    for e in engines:
        assert e.exhaust_pressure - e.ambient_pressure == pytest.approx(1e4)
        assert len(e.cylinder_flow_factors) == base.n_cylinders


def test_speeds_and_demands_stay_in_reach(narrow_design, operations):
    model, base = narrow_design.model, narrow_design.engine
    speeds = np.concatenate([o.speed_rpm for o in operations])
    assert spread(speeds, 1300.0, 1700.0)
    shares = []
    for o in operations:
        assert o.demand.shape == o.speed_rpm.shape == (CYCLES * base.n_cylinders,)
        density = (
            o.engine.ambient_pressure / base.ambient_pressure
            * base.temperature / o.engine.temperature
        )  # fmt: skip
        for k in range(0, o.demand.size, 40):
            low, high = model.limits(float(o.speed_rpm[k]))
            # Limits between knots are interpolated
            assert o.demand[k] >= min(density, 1.0) * low * 0.995
            assert o.demand[k] <= min(density, 1.0) * high * 1.005
            shares.append((o.demand[k] / min(density, 1.0) - low) / (high - low))
    assert spread(shares, 0.04, 0.96)


def test_speeds_change_as_an_engine_can(narrow_design, operations):
    n, fastest = narrow_design.engine.n_cylinders, 0.0
    for o in operations:
        elapsed = 120.0 / (n * o.speed_rpm[:-1])
        rate = np.abs(np.diff(o.speed_rpm)) / elapsed
        assert rate.max() <= 3000.0 * 1.03  # the last event's speed, or this one's
        fastest = max(fastest, rate.max())
    assert fastest > 1000.0


def test_demands_step_and_ramp(operations):
    jumps = np.concatenate([np.abs(np.diff(np.log(o.demand))) for o in operations])
    assert jumps.max() > 0.5  # a step
    assert np.count_nonzero((jumps > 1e-3) & (jumps < 0.2)) > 100  # a ramp


def test_a_good_controller_raises_nothing(narrow_design):
    found = check_false_alarms(narrow_design, cycles=300, seed=7, processes=1)
    assert (found.cycles, found.runs, found.events) == (500, 2, 2000)  # whole runs of 250
    assert found.alarms == 0
    assert found.by_name == {}
    assert found.seeds == ()
    assert "no alarm" in str(found)


def test_alarms_are_counted(narrow_design, monkeypatch):
    """The same counter, with a fault in the second of two runs."""
    faults = {12: (Fault("map-nan", 1.0, 2.0),)}
    clear = narrow_design.controller.faults.monitor.recovery_events

    def failing(*args, seed, **options):
        return simulate(*args, seed=seed, faults=faults.get(seed, ()), **options)

    monkeypatch.setattr(false_alarms, "simulate", failing)
    monkeypatch.setattr(false_alarms, "RUN_CYCLES", 60)
    found = check_false_alarms(narrow_design, cycles=120, seed=11, processes=1)
    assert (found.runs, found.seeds) == (2, (12,))
    assert set(found.by_name) == {"map"}
    # One second is 43 to 57 events of 1300 to 1700 rpm; it is found within 3 and ends after
    # most cylinders are heard, and so many events more
    assert 40 + clear < found.alarms < 60 + clear + 5
    assert found.alarms == found.by_name["map"]
    told = json.loads(json.dumps(found.to_dict()))
    assert told["alarm_events"] == found.alarms
    assert f"map {found.alarms}" in str(found)


def test_an_event_with_two_alarms_is_one_event(narrow_design, monkeypatch):
    class Run:
        alarms = np.array([0, int(Alarm.MAF | Alarm.MAP), int(Alarm.MAF), 0])

    monkeypatch.setattr(false_alarms, "simulate", lambda *args, **options: Run)
    found = check_false_alarms(narrow_design, cycles=1, processes=1)
    assert found == FalseAlarmCount(1, 4, 1, 2, {"maf": 2, "map": 1}, (0,))


@pytest.mark.parametrize(
    "options", [{"cycles": 0}, {"cycles": 1.5}, {"processes": 0}, {"seed": -1}]
)
def test_impossible_checks_are_refused(narrow_design, options):
    with pytest.raises(ParameterError):
        check_false_alarms(narrow_design, **{"processes": 1, "cycles": 1, **options})


@pytest.mark.slow
def test_ten_thousand_cycles_without_a_false_alarm(narrow_design):
    found = check_false_alarms(narrow_design, cycles=10_000, processes=2)
    assert found.cycles >= 10_000
    assert found.alarms == 0, str(found)
