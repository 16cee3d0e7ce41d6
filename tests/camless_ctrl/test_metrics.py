import math
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.alarms import Alarm, Mode
from camless_ctrl.closed_loop_result import ClosedLoopResult
from camless_ctrl.faults import Fault
from camless_ctrl.metrics import (
    AlarmTime,
    CommandViolations,
    FalseAlarms,
    FirstEventsError,
    Imbalance,
    LossExcess,
    ModeShare,
    ModeTime,
    Overshoot,
    RecoveryBump,
    Settling,
    SteadyError,
    WorstError,
)
from plant.errors import ParameterError

STEP = 0.02  # s, from event to event at 1500 rpm with four cylinders
HIGH, LOW = 4e-4, 2e-4  # kg


def result_of(error, demand=LOW, *, n=4, faults=(), first=0.0, **signals):
    """Result of given relative errors (m,), at a demand (m,), whose time begins at `first`."""
    error = np.asarray(error, dtype=float)
    m = error.size
    demand = np.broadcast_to(np.asarray(demand, dtype=float), (m,)).copy()
    ones = np.ones(m)
    given = {
        "lift_mm": 3.0 * ones,
        "duration_deg": 100.0 * ones,
        "alarms": np.zeros(m, dtype=np.int64),
        "mode": np.zeros(m, dtype=np.int64),
        "speed_rpm": 1500.0 * ones,
        "charge": demand * (1.0 + error),
    } | signals
    run = ClosedLoopResult(
        "synthetic",
        n,
        0,
        time=first + STEP * np.arange(m),
        cylinder=np.arange(m) % n + 1,
        demand=demand,
        estimate=demand,
        estimate_sigma=0.01 * demand,
        pumping_loss=ones,
        flow_gain=ones,
        duration_offset=0.0 * ones,
        charge_factor=ones,
        limited=np.zeros(m, dtype=bool),
        adapted=np.zeros(m, dtype=bool),
        **given,
    )
    return SimpleNamespace(run=run, scenario=SimpleNamespace(faults=tuple(faults)))


def test_steady_error_is_that_of_the_cylinder_with_the_largest_mean():
    # cylinder 3 is 2 % low from cycle 10 on, and 50 % off before, where nothing counts
    error = np.zeros((40, 4))
    error[:10, 0], error[10:, 2] = 0.5, -0.02
    found = SteadyError(after_cycles=10, average_cycles=30).measure(result_of(error.ravel()))
    assert found.value == pytest.approx(2.0)
    assert found.cylinder == 3
    assert found.event in range(40 + 2, 160, 4)
    assert found.time == pytest.approx(STEP * found.event)
    assert SteadyError(10, 30, without_cylinders=(3,)).measure(
        result_of(error.ravel())
    ).value == pytest.approx(0.0, abs=1e-12)


def test_steady_error_takes_the_worst_of_all_held_demands_and_of_the_stretch_asked_for():
    error, demand = np.zeros((60, 4)), np.full((60, 4), LOW)
    demand[20:40] = HIGH
    error[5:20, 1], error[25:40, 2], error[45:, 3] = 0.01, 0.03, 0.02
    result = result_of(error.ravel(), demand.ravel())
    metric = SteadyError(after_cycles=5, average_cycles=15)
    assert metric.measure(result).value == pytest.approx(3.0)
    early = SteadyError(5, 15, until_s=20 * 4 * STEP).measure(result)
    assert (early.value, early.cylinder) == (pytest.approx(1.0), 2)
    late = SteadyError(5, 15, from_s=40 * 4 * STEP).measure(result)
    assert (late.value, late.cylinder) == (pytest.approx(2.0), 4)


def test_the_warm_up_does_not_count():
    error = np.where(np.arange(200) < 100, 0.1, 0.01)
    result = result_of(error, first=-100 * STEP)
    for metric in (SteadyError(0, 100), WorstError()):
        assert metric.measure(result).value == pytest.approx(1.0)
    assert WorstError(from_s=-math.inf).measure(result).value == pytest.approx(10.0)


def test_shut_valves_and_unfinished_events_have_no_error():
    error, demand = np.zeros((20, 4)), np.full((20, 4), LOW)
    demand[5:10, 1] = 0.0  # no step for the other cylinders, either
    error = error.ravel()
    error[[3, -1]] = 0.04, math.nan
    charge = demand.ravel() * (1.0 + error)
    charge[demand.ravel() == 0.0] = 1e-6  # leaks
    result = result_of(error, demand.ravel(), charge=charge)
    assert WorstError().measure(result)[:3] == (pytest.approx(4.0), pytest.approx(3 * STEP), 3)
    assert SteadyError(1, 19).measure(result).value == pytest.approx(0.0, abs=1e-12)
    assert Imbalance(1, 19).measure(result).value == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(FirstEventsError().measure(result).value)


def test_no_data_is_no_value_but_a_note():
    result = result_of(np.full(40, math.nan), faults=[Fault("maf-nan", 0.2)])
    for metric in (
        SteadyError(),
        SteadyError(0, 5),
        WorstError(),
        WorstError(window="after"),
        FirstEventsError(),
        Imbalance(0, 5),
        Settling(),
        Overshoot(),
        ModeTime(),
        RecoveryBump(),
        LossExcess(),
        FalseAlarms(from_s=0.3),
        ModeShare(from_s=5.0),
        CommandViolations(from_s=5.0),
    ):
        found = metric.measure(result)
        assert math.isnan(found.value), metric
        assert found.note


def test_worst_error_around_a_fault():
    # 1 s of 1 %, then a fault of 1 s with 10 % of which the first 0.2 s have 30 %, then a tail
    error = np.full(150, 0.01)
    error[50:60], error[60:100], error[100:110], error[110:] = 0.3, -0.1, 0.2, 0.02
    result = result_of(error, faults=[Fault("maf-nan", 5.0), Fault("maf-nan", 1.0, 2.0)])

    def worst(window, settle_s=0.0, mean_events=1):
        return (
            WorstError(mean_events=mean_events, window=window, fault=2, settle_s=settle_s)
            .measure(result)
            .value
        )

    assert worst("before") == pytest.approx(1.0)
    assert worst("during") == pytest.approx(30.0)
    assert worst("during", 0.2) == pytest.approx(10.0)
    assert worst("after") == pytest.approx(20.0)
    assert worst("after", 0.2) == pytest.approx(2.0)
    assert worst("all") == pytest.approx(30.0)
    # 4 events with 30 %, or 2 of 30 and 2 of -10 %: in groups of 4 from the fault's start on
    assert worst("during", 0.0, 4) == pytest.approx(30.0)
    assert worst("during", 0.0, 20) == pytest.approx(10.0)


def test_first_events_after_a_step_and_in_a_ramp():
    demand = np.full((20, 4), LOW)
    demand[10:] = HIGH
    error = np.zeros((20, 4))
    error[10, 2], error[11, 1] = -0.03, 0.5  # the second is no first event
    found = FirstEventsError().measure(result_of(error.ravel(), demand.ravel()))
    assert (found.value, found.event, found.cylinder) == (pytest.approx(3.0), 42, 3)
    demand[10:14] = np.linspace(LOW, HIGH, 16).reshape(4, 4)  # a ramp: all of it, and one cycle
    assert FirstEventsError().measure(
        result_of(error.ravel(), demand.ravel())
    ).value == pytest.approx(50.0)
    error[14, 2], error[14, 3] = 0.6, 0.7  # cylinder 4 was the first at the last demand
    found = FirstEventsError().measure(result_of(error.ravel(), demand.ravel()))
    assert (found.value, found.event, found.cylinder) == (pytest.approx(60.0), 58, 3)


def test_settling_counts_from_the_last_change_of_demand():
    demand = np.full((40, 4), LOW)
    demand[15:] = HIGH
    error = np.zeros((40, 4))
    error[:15, 0] = 0.5  # another demand
    error[15:, 1] = 0.08 * 0.5 ** np.arange(25)  # 8, 4, 2, 1, 0.5 %
    result = result_of(error.ravel(), demand.ravel())
    single = Settling(tolerance_percent=1.5, average_cycles=1).measure(result)
    assert (single.value, single.cylinder) == (3.0, 2)
    assert single.event == (15 + 2) * 4 + 1  # 2 % is the last one outside
    # means of two: 6, 3, 1.5, 0.75 %
    assert Settling(1.5001, 2).measure(result).value == 2.0
    assert Settling(1.4999, 2).measure(result).value == 3.0
    assert Settling(60.0, 1, from_s=0.0).measure(result).value == 0.0
    assert Settling(1.0, 1, from_s=0.0).measure(result).value == 15 + 4
    error[39, 0] = 0.1
    assert Settling(1.5, 1).measure(result_of(error.ravel(), demand.ravel())).value == math.inf


def test_overshoot_is_a_share_of_the_step_on_either_way():
    demand = np.full((40, 4), LOW)
    demand[10:25] = HIGH
    error = np.zeros((40, 4))
    error[12, 0] = 0.02  # 8 mg of 200 mg
    error[13, 1] = -0.3  # not beyond
    result = result_of(error.ravel(), demand.ravel())
    found = Overshoot().measure(result)
    assert (found.value, found.event, found.cylinder) == (pytest.approx(4.0), 48, 1)
    assert Overshoot(average_cycles=2).measure(result).value == pytest.approx(2.0)
    error[30, 2] = -0.06  # 12 mg of 200 mg, downwards
    result = result_of(error.ravel(), demand.ravel())
    assert Overshoot().measure(result)[:3] == (pytest.approx(6.0), pytest.approx(2.44), 122)
    # 200 mg are 50 % of the new demand one way, 100 % the other
    assert Overshoot(least_change_percent=60.0).measure(result).event == 122
    assert Overshoot(until_s=1.0).measure(result).event == 48


def test_imbalance_by_hand():
    error = np.tile([0.01, -0.01, 0.02, -0.03], (30, 1))
    error[:10] = 0.0
    found = Imbalance(after_cycles=10, average_cycles=20).measure(result_of(error.ravel()))
    assert found.value == pytest.approx(100.0 * 0.05 / (1.0 - 0.01 / 4.0))
    assert found.cylinder == 4
    assert Imbalance(10, 20, without_cylinders=(4,)).measure(
        result_of(error.ravel())
    ).value == pytest.approx(100.0 * 0.03 / (1.0 + 0.02 / 3.0))


def test_commands_beyond_their_limits_are_counted_one_by_one():
    lift, duration = np.full(80, 3.0), np.full(80, 90.0)  # 10 ms
    lift[8], lift[20] = 8.1, 0.4
    duration[31] = 240.5
    found = CommandViolations().measure(
        result_of(np.zeros(80), lift_mm=lift, duration_deg=duration)
    )
    assert found.value == 3.0
    assert found.event == 20  # 20 % below: the others are nearer to their limits
    lift[8], lift[20], duration[31] = 8.0, 0.5, 240.0  # on the limit is within
    result = result_of(np.zeros(80), lift_mm=lift, duration_deg=duration)
    assert CommandViolations().measure(result).value == 0.0
    # there and back: two changes of 5 mm, two of 2.5 mm, two of 150 deg in 16.7 ms
    assert CommandViolations(lift_rate_mm=4.0).measure(result).value == 2.0
    assert CommandViolations(lift_rate_mm=2.0).measure(result).value == 4.0
    assert CommandViolations(duration_rate_ms=16.6).measure(result).value == 2.0
    assert CommandViolations(duration_rate_ms=16.7).measure(result).value == 0.0
    duration[50] = math.nan
    result = result_of(np.zeros(80), lift_mm=lift, duration_deg=duration)
    assert CommandViolations().measure(result)[:3] == (1.0, pytest.approx(1.0), 50)


def test_a_valve_that_is_kept_shut_breaks_no_limit():
    lift = np.full(80, 7.9)
    lift[21:60:4] = 0.0
    result = result_of(np.zeros(80), lift_mm=lift)
    assert CommandViolations().measure(result).value == 0.0
    lift[21:60:4] = 0.5  # open, and far from 7.9 mm: there and back
    result = result_of(np.zeros(80), lift_mm=lift)
    assert CommandViolations().measure(result).value == 2.0


def test_alarm_time_counts_events_from_the_start_of_the_fault():
    alarms = np.zeros(100, dtype=np.int64)
    alarms[5:8] = int(Alarm.MAP)
    alarms[62:80] = int(Alarm.MAF)
    alarms[70:] |= int(Alarm.VALVE)
    faults = [Fault("maf-nan", 0.1), Fault("maf-nan", 1.0, 1.5)]
    result = result_of(np.zeros(100), alarms=alarms, faults=faults)
    found = AlarmTime("maf", fault=2).measure(result)
    assert found[:3] == (12.0, pytest.approx(1.24), 62)  # the fault begins at event 50
    assert AlarmTime("valve", fault=2).measure(result).value == 20.0
    assert AlarmTime("any", fault=1).measure(result).value == 0.0
    assert AlarmTime("clock", fault=1).measure(result).value == math.inf
    alarms[30:62] = int(Alarm.MAF)
    early = AlarmTime("maf", fault=2).measure(
        result_of(np.zeros(100), alarms=alarms, faults=faults)
    )
    assert early.value == 0.0
    assert "stood before" in early.note
    with pytest.raises(ParameterError, match=r"fault is 3, but the scenario has 2.*from 1 to 2"):
        AlarmTime("maf", fault=3).measure(result)
    with pytest.raises(ParameterError, match="did you mean 'maf'"):
        AlarmTime("maff")


def test_false_alarms_are_those_outside_of_the_faults():
    alarms = np.zeros(200, dtype=np.int64)
    alarms[[10, 11, 60, 80, 90, 150]] = int(Alarm.MAF)
    faults = [Fault("maf-nan", 1.0, 1.5)]  # events 50 to 74 from event 0 at 0 s
    result = result_of(np.zeros(200), alarms=alarms, faults=faults)
    found = FalseAlarms(margin_s=0.2).measure(result)  # to event 84
    assert (found.value, found.event) == (4.0, 10)
    assert FalseAlarms(margin_s=0.5).measure(result).value == 3.0
    assert FalseAlarms(margin_s=0.5, from_s=0.3).measure(result).value == 1.0
    assert FalseAlarms(margin_s=0.5, from_s=0.3, until_s=2.5).measure(result).value == 0.0


def test_modes_share_return_and_bump():
    mode = np.zeros(200, dtype=np.int64)
    mode[60:70], mode[70:90], mode[92:95] = Mode.DEGRADED, Mode.SAFE, Mode.DEGRADED
    error = np.zeros(200)
    error[91:] = 0.04  # a bump of 4 % in every cylinder, within a cycle of a return
    error[30:34] = 0.5  # far from it
    faults = [Fault("maf-nan", 1.0, 1.6)]  # ends before event 80
    result = result_of(error, mode=mode, faults=faults)
    share = ModeShare().measure(result)
    assert (share.value, share.event) == (pytest.approx(100.0 * 33 / 200), 60)
    back = ModeTime().measure(result)
    assert (back.value, back.event) == (15.0, 95)
    assert ModeTime(until_s=92 * STEP).measure(result).value == 10.0
    assert ModeTime(until_s=85 * STEP).measure(result).value == math.inf
    bump = RecoveryBump(around_cycles=2).measure(result)
    assert bump.value == pytest.approx(4.0)
    assert bump.event in range(91, 95)


def test_a_cylinder_that_the_engine_does_not_have():
    with pytest.raises(ParameterError, match="names cylinder 5, but the engine has 4"):
        WorstError(without_cylinders=(5,)).measure(result_of(np.zeros(40)))
