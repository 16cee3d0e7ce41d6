"""Time, speed and number of an event as told: the clock against them, by hand."""

import math

import numpy as np
import pytest

from camless_ctrl._event_timing import LONGEST_GAP, MOST_REFUSED, usable
from camless_ctrl.alarms import Alarm
from camless_ctrl.controller_state import ControllerState
from camless_ctrl.event_data import Measurement
from camless_ctrl.fault_monitor import FaultMonitor
from camless_ctrl.fault_reaction import FaultReaction

N, RANGE = 4, (100.0, 10_000.0)
FAULTS = FaultReaction(FaultMonitor(N, 0.2))
SPEED, CLOCK = int(Alarm.SPEED), int(Alarm.CLOCK)
EVENT = 0.02  # s, at 1500 rpm
NONE = np.empty(0)


def before(index=10, time=1.0, speed_rpm=1500.0, refused=0):
    return ControllerState(
        index, None, None, (), (None,) * N, 1.0, 1.0, 0, refused, time, speed_rpm
    )


def told(time, speed_rpm=1500.0, index=None):
    return Measurement(time, speed_rpm, NONE, NONE, event_index=index)


def judged(measurement, state=None, faults=FAULTS, n=N):
    return usable(before() if state is None else state, measurement, n, RANGE, faults)


def test_what_can_be_is_left_alone():
    measurement = told(1.0 + EVENT, index=10)
    timing = judged(measurement)
    assert timing.measurement is measurement
    assert timing[1:5] == (10, 0, 0, 0)
    assert timing.elapsed == pytest.approx(EVENT)


@pytest.mark.parametrize("rate", [8000.0, -8000.0])
@pytest.mark.parametrize("n", [1, 3, 6])
def test_the_fastest_ramp_is_believed(rate, n):
    """Events of a speed that changes all the time: the clock shows the mean over an event."""
    speed = 1500.0 if rate > 0.0 else 5500.0
    state = before(0, 0.0, speed)
    for k in range(1, 40 * n):
        # Crank angle over an event: v t + r t2/2 = 120/n rpm s
        t = (-speed + math.sqrt(speed**2 + 2.0 * rate * 120.0 / n)) / rate
        speed += rate * t
        if not 1450.0 < speed < 6000.0:
            break
        timing = judged(told(state.time + t, speed, k), state._replace(event_index=k), n=n)
        assert timing.alarms == 0
        assert timing.measurement.speed_rpm == speed
        state = state._replace(time=state.time + t, speed_rpm=speed)
    assert abs(speed - (1500.0 if rate > 0.0 else 5500.0)) > 1000.0  # a ramp it was


@pytest.mark.parametrize("spike", [400.0, -400.0, 2000.0, 1e9, math.nan, math.inf, -math.inf, 0.0])
def test_a_spike_is_replaced_by_the_clocks_speed(spike):
    # At 1500 rpm 10 % and 8000 rpm/s over 20 ms are 310 rpm
    wrong = 0.0 if spike == 0.0 else 1500.0 + spike
    timing = judged(told(1.0 + EVENT, wrong, 10), before(speed_rpm=1450.0))
    assert timing.alarms == SPEED
    assert timing.measurement.speed_rpm == pytest.approx(1500.0)  # 120/(4 cylinders * 20 ms)
    assert timing.measurement.time == 1.0 + EVENT


@pytest.mark.parametrize("off", [300.0, -300.0])
def test_less_than_tolerance_and_acceleration_is_believed(off):
    assert judged(told(1.0 + EVENT, 1500.0 + off, 10)).alarms == 0


def test_without_a_number_or_monitors_the_last_speed_stands_in():
    for faults, index in ((FAULTS, None), (None, 10)):
        timing = judged(told(1.0 + EVENT, 3000.0, index), faults=faults)
        assert timing.alarms == 0  # nothing to hold it against
        assert timing.measurement.speed_rpm == 3000.0
        timing = judged(told(1.0 + EVENT, math.nan, index), before(speed_rpm=1430.0), faults)
        assert timing.alarms == SPEED
        assert timing.measurement.speed_rpm == 1430.0


@pytest.mark.parametrize("missed", [1, 3, 25])
def test_missed_events_are_counted_and_are_in_the_clock(missed):
    timing = judged(told(1.0 + (missed + 1) * EVENT, 1500.0, 10 + missed))
    assert (timing.event_index, timing.missed, timing.alarms) == (10 + missed, missed, CLOCK)
    assert timing.measurement.speed_rpm == 1500.0
    assert timing.elapsed == pytest.approx((missed + 1) * EVENT)
    spiked = judged(told(1.0 + (missed + 1) * EVENT, 9000.0, 10 + missed))
    assert spiked.alarms == CLOCK | SPEED  # 8000 rpm/s explain 4160 rpm at most
    assert spiked.measurement.speed_rpm == pytest.approx(1500.0)


@pytest.mark.parametrize("index", [9, 0, -5, 10**9, -(10**9)])
def test_a_number_that_goes_back_or_jumps_far_says_nothing_of_the_speed(index):
    timing = judged(told(1.0 + EVENT, 1500.0, index))
    assert (timing.event_index, timing.missed, timing.alarms) == (index, index - 10, CLOCK)
    assert timing.measurement.speed_rpm == 1500.0
    assert timing.measurement.time == 1.0 + EVENT


def test_the_first_event_starts_the_clock():
    start = before(0, -math.inf, math.nan)
    for time in (0.0, 12.5, -3.0):
        timing = judged(told(time, 2000.0, 0), start)
        assert (timing.alarms, timing.refused, timing.missed) == (0, 0, 0)
        assert (timing.measurement.time, timing.measurement.speed_rpm) == (time, 2000.0)
        assert 0.0 < timing.elapsed < LONGEST_GAP


def test_a_first_event_without_time_and_speed_gets_some():
    timing = judged(told(math.nan, math.nan, 0), before(0, -math.inf, math.nan))
    assert timing.alarms == CLOCK | SPEED
    assert timing.measurement.speed_rpm == 1000.0
    assert timing.measurement.time == pytest.approx(0.03)  # an event of it


@pytest.mark.parametrize(
    "time", [1.0, 0.5, -1e300, 1.0 + LONGEST_GAP + 1e-6, 1e300, math.nan, math.inf, -math.inf]
)
@pytest.mark.parametrize("missed", [0, 2])
def test_a_time_that_cannot_be_is_replaced_by_the_expected_one(time, missed):
    timing = judged(told(time, 1500.0, 10 + missed))
    assert timing.alarms & CLOCK
    assert timing.refused == 1
    assert timing.measurement.time == pytest.approx(1.0 + (missed + 1) * EVENT)
    assert timing.measurement.speed_rpm == 1500.0  # no clock to judge it by


def test_a_clock_that_was_set_is_believed_after_some_refusals():
    state, times = before(), []
    for k in range(MOST_REFUSED + 3):
        timing = judged(told(500.0 + k * EVENT, 1500.0, 10 + k), state)
        times.append(timing.measurement.time)
        state = state._replace(
            event_index=11 + k, time=timing.measurement.time, refused=timing.refused
        )
    expected = 1.0 + EVENT * np.arange(1, MOST_REFUSED + 1)
    np.testing.assert_allclose(times[:MOST_REFUSED], expected)
    np.testing.assert_allclose(times[MOST_REFUSED:], 500.0 + EVENT * np.arange(8, 11))
    assert timing.alarms == 0


def test_a_time_that_is_no_number_is_never_believed():
    timing = judged(told(math.nan, 1500.0, 10), before(refused=MOST_REFUSED + 5))
    assert timing.refused == MOST_REFUSED + 6
    assert timing.measurement.time == pytest.approx(1.0 + EVENT)
