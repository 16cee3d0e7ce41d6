"""Plausibility monitors on samples made by hand, whose flow, pressure and faults are known."""

import math
import pickle

import numpy as np
import pytest

from camless_ctrl import _monitor_layout as layout
from camless_ctrl.alarms import Alarm
from camless_ctrl.cylinder_parameters import CylinderParameters
from camless_ctrl.event_data import EVENTS, PARTS, EventRecord, Measurement, ModelPoint
from camless_ctrl.fault_monitor import EventFacts, FaultMonitor
from plant import Engine
from plant.errors import ParameterError
from plant.lag import first_order_lag
from plant.orifice import simplified_flow

T = 0.02  # s, event of four cylinders at 1500 rpm
CHARGE, AMBIENT, AREA = 3e-4, 1e5, 0.2
START = 60  # event at which something goes wrong
NONE = np.empty(0)
OWN = np.concatenate((np.full(PARTS, 1.0 / PARTS), np.zeros((EVENTS - 1) * PARTS)))


def drop(flow, area=AREA):
    """Pressure drop over that before the throttle at a steady flow: Eq. 14, solved."""
    return 0.5 * (1.0 - math.sqrt(1.0 - (flow / area) ** 2))


PRESSURE = AMBIENT * (1.0 - drop(CHARGE / T))  # Pa, in the manifold


def samples(k, flow, pressure, count, scatter=1e-4):
    """Readings of one event, no two in a row the same."""
    ripple = 1.0 + scatter * np.array([(-1.0) ** i * (i + 2 + k % 7) for i in range(count)])
    return flow * ripple, pressure * ripple


def record(k, n, charge=CHARGE, shares=OWN, lift_mm=5.0):
    point = ModelPoint(lift_mm, 110.0, charge, False, 0.1, 100.0, shares)
    return EventRecord(k, k % n + 1, k * T, 1500.0, point, CylinderParameters(), math.nan)


def facts(
    k,
    n=4,
    *,
    dt=T,
    flow=CHARGE / T,
    pressure=PRESSURE,
    maf=None,
    map_=None,
    count=20,
    ratio=0.0,
    innovation=1.0,
    refused=False,
    level=0.0,
    charge=CHARGE,
    last=None,
    errors=None,
    estimated=True,
):
    """What is known at IVO `k` of a sound engine, but for what is given."""
    good_maf, good_map = samples(k, flow, pressure, count)
    maf, map_ = good_maf if maf is None else maf, good_map if map_ is None else map_
    time = np.zeros(maf.size)
    told = Measurement(k * dt, 1500.0, time, maf, np.zeros(map_.size), map_)
    opened = k - 1
    return EventFacts(
        k % n + 1,
        dt,
        told,
        (k - 2) % n + 1 if estimated and not refused else 0,
        ratio(k - 2) if callable(ratio) else ratio,
        innovation,
        refused,
        level,
        (record(opened, n, charge) if last is None else last) if k else None,
        (((opened % n + 1), 0.0),) if errors is None else errors,
    )


def drive(monitor, events, what=lambda k: {}, state=None, first=0, **options):
    """States after each event; `what` tells what differs from a sound engine at event `k`."""
    state, states = monitor.start() if state is None else state, []
    for k in range(first, first + events):
        state = monitor.judge(state, facts(k, monitor.n_cylinders, **{**options, **what(k)}))
        states.append(state)
    return states


# Limits that the hand computations are made for, whatever the default ones are
LIMITS = {
    "maf_time": 0.015, "ratio_limit": 0.10, "first_ratio_limit": 0.35, "flow_limit": 0.08,
    "level_limit": 0.08, "level_time": 5.0, "innovation_allowance": 1.8, "score_limit": 8.0,
    "same_readings": 25, "longest_gap": 5e-3, "pressure_limit": 2000.0, "pressure_rate": 500.0,
    "duration_limit": 0.25e-3, "largest_duration_error": 1e-3, "valve_limit": 0.25,
    "recovery_events": 12,
}  # fmt: skip


def monitor_of(n=4, area=AREA, **options):
    return FaultMonitor(n, area, **{**LIMITS, **options})


def from_start(**wrong):
    return lambda k: wrong if k >= START else {}


def first(states, alarm):
    """Events from `START` to the alarm; None if there is none."""
    for k, state in enumerate(states):
        if state.alarms & alarm:
            return k - START
    return None


def all_alarms(states):
    found = 0
    for state in states:
        found |= state.alarms
    return Alarm(found)


def row(state, which, n=4):
    return state.values[layout.HEAD + which * n : layout.HEAD + (which + 1) * n]


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_a_sound_engine_raises_nothing(n):
    states = drive(monitor_of(n), 300)
    assert not all_alarms(states)
    assert states[-1].calm
    assert states[-1].suspects == ()


# -- readings that stay the same or do not come ----------------------------------------------

SENSORS = pytest.mark.parametrize(
    ("name", "alarm", "value"), [("maf", Alarm.MAF, 0.0151), ("map_", Alarm.MAP, 9.9e4)]
)


@SENSORS
@pytest.mark.parametrize(
    ("count", "same", "events"),
    [
        (20, 25, 1),  # 19 equal the first one, then 20 more
        (2, 25, 12),  # after j events 2 j - 1 equal the first one: 25 with j = 13
        (20, 5, 1),  # enough at once, but not for an event's time
        (20, 60, 3),  # 19, 39, 59, 79
        (1, 3, 3),
    ],
)
def test_a_stuck_sensor_is_found_by_readings_and_time(name, alarm, value, count, same, events):
    stuck = from_start(**{name: np.full(count, value)})
    states = drive(monitor_of(same_readings=same), START + 40, stuck, count=count)
    assert first(states, alarm) == events
    assert not all_alarms(states[: START + events])


@SENSORS
def test_equal_readings_with_a_change_between_are_not_stuck(name, alarm, value):
    def coarse(k):
        return {name: np.repeat([value, value * 1.001], 10)}

    assert not all_alarms(drive(monitor_of(), 200, coarse)) & alarm


@SENSORS
@pytest.mark.parametrize(
    ("dt", "events"),
    [
        (T, 1),  # more than one and a half events: 20 ms are not, 40 are
        (2e-3, 2),  # more than 5 ms: 2, 4, 6
    ],
)
@pytest.mark.parametrize("bad", [NONE, np.full(20, math.nan), np.array([math.inf, -math.inf])])
def test_a_sensor_that_gives_no_numbers_is_found(name, alarm, value, dt, events, bad):
    options = {"dt": dt, "flow": CHARGE / dt, "count": 3, "charge": CHARGE}
    states = drive(monitor_of(area=10.0), START + 20, from_start(**{name: bad}), **options)
    assert first(states, alarm) == events
    assert all_alarms(states[: START + 3]) == alarm


def test_one_event_without_samples_is_no_fault():
    def once(k):
        return {"maf": NONE, "map_": NONE} if k % 10 == 5 else {}

    assert not all_alarms(drive(monitor_of(), 200, once))


# -- pressure before the throttle ------------------------------------------------------------


@pytest.mark.parametrize("ambient", [7e4, 9.5e4, 1.02e5])
@pytest.mark.parametrize("charge", [1e-4, 4e-4, 8e-4])
def test_ambient_pressure_is_recovered(ambient, charge):
    """Square pulses whose mean square is 1.3 times the square of their mean, as is assumed."""
    mean = charge / T
    pulse = drop(1.3 * mean, AREA)  # while it flows, 1/1.3 of the time
    np.testing.assert_allclose(simplified_flow(1.0 - pulse, 1.0), 1.3 * mean / AREA, rtol=1e-12)
    pressure = ambient * (1.0 - pulse / 1.3)
    states = drive(monitor_of(), 40, flow=mean, charge=charge, pressure=pressure)
    lost = ambient - pressure
    # Small drops; the ripple of the readings is 1e-5 of the pressure in the mean
    assert states[-1].ambient_pressure == pytest.approx(ambient, abs=0.02 * lost + 10.0)
    if charge == 8e-4:
        assert lost > 0.01 * ambient  # so that something had to be recovered


def test_ambient_pressure_is_not_known_before_most_cylinders_have_spoken():
    states = drive(monitor_of(), 4)
    assert math.isnan(monitor_of().start().ambient_pressure)
    assert [math.isfinite(s.ambient_pressure) for s in states] == [False, False, True, True]


@pytest.mark.parametrize("step", [3000.0, -3000.0])
def test_a_pressure_step_is_found_when_most_cylinders_see_it(step):
    states = drive(monitor_of(), START + 100, from_start(pressure=AMBIENT + step))
    # Median of four: three have to see it, as 1500 Pa of two are less than the limit
    assert first(states, Alarm.MAP) == 2
    assert states[-1].alarms == Alarm.MAP
    assert states[-1].ambient_pressure == pytest.approx(AMBIENT, abs=400.0)  # not followed


@pytest.mark.parametrize("step", [1500.0, -1500.0])
def test_a_small_pressure_step_is_followed(step):
    sound = drive(monitor_of(), START)[-1].ambient_pressure
    states = drive(monitor_of(), START + 400, from_start(pressure=PRESSURE + step))
    assert not all_alarms(states)
    assert states[-1].ambient_pressure - sound == pytest.approx(step, rel=0.03)


@pytest.mark.parametrize("rate", [400.0, -400.0])
def test_a_slope_that_can_be_is_followed(rate):
    def slope(k):
        return {"pressure": AMBIENT + rate * T * k}

    states = drive(monitor_of(), 2000, slope)
    assert not all_alarms(states)
    found = states[-1].ambient_pressure
    # A share of 0.1 of 8 Pa an event lags by 80 Pa, and the median of four by 1.5 events more
    assert found == pytest.approx(AMBIENT + rate * T * 1999, abs=300.0)


def test_a_slope_that_cannot_be_is_found():
    """900 Pa/s are 400 more than is followed: 2000 Pa after 5 s, 250 events."""
    states = drive(
        monitor_of(),
        START + 400,
        lambda k: {"pressure": AMBIENT - 900.0 * T * max(k - START, 0)},
    )
    assert first(states, Alarm.MAP) == pytest.approx(250, abs=30)


def test_a_sensor_that_starts_stuck_is_believed_when_it_moves():
    """What it told while it was stuck is not taken for the ambient pressure."""
    states = drive(monitor_of(), 120, lambda k: {"map_": np.full(20, 7e4)} if k < 30 else {})
    assert all_alarms(states[:30]) == Alarm.MAP
    assert states[-1].alarms == 0
    assert states[-1].ambient_pressure == pytest.approx(AMBIENT, rel=1e-3)


@pytest.mark.parametrize("bad", [NONE, np.full(20, 9e4)])
def test_after_a_long_time_without_pressure_another_one_is_believed(bad):
    """The ambient pressure may change by 2000 Pa in 4 s; after that it is not held to the old."""
    for seconds, believed in ((3.5, False), (4.5, True)):
        back = START + round(seconds / T)

        def what(k, back=back):
            return (
                {"map_": bad} if START <= k < back else {"pressure": PRESSURE - 3e3 * (k >= back)}
            )

        states = drive(monitor_of(), back + 60, what)
        assert states[back - 1].alarms == Alarm.MAP
        assert (states[-1].alarms == 0) == believed
        if believed:
            assert states[-1].ambient_pressure == pytest.approx(AMBIENT - 3e3, rel=1e-3)


# -- air flow --------------------------------------------------------------------------------


def pulses(charges, share, times):
    """Flow of one triangular pulse an event, which takes a share of it, at instants in s."""
    flow = np.zeros(times.size)
    for k, charge in enumerate(charges):
        length = share * T
        x = (times - k * T) / length
        peak = 2.0 * charge / length
        flow += np.where((x >= 0.0) & (x <= 1.0), peak * (1.0 - np.abs(2.0 * x - 1.0)), 0.0)
    return flow


@pytest.mark.parametrize("factor", [1.0, 1.2, 0.8])
@pytest.mark.parametrize("tau", [0.01, 0.015, 0.02])
def test_the_mean_flow_is_free_of_the_lag(factor, tau):
    """Pulsating flow through an exactly solved lag, while the charge steps up and down."""
    charges = np.where(np.arange(80) % 20 < 10, 1.5e-4, 4.5e-4)
    times = np.linspace(0.0, 80 * T, 80 * 2000 + 1)
    reading = first_order_lag(times, factor * pulses(charges, 0.8, times), tau)
    own = np.zeros(EVENTS * PARTS)  # all flows in within the first event angle
    own[0] = 1.0
    monitor, ratios, plain = monitor_of(maf_time=tau), [], []
    state = monitor.start()
    for k in range(1, 80):
        # Samples so dense that their mean is that of the event; the last one is at the IVO
        at = (k - 1) * T + 1e-5 * (np.arange(2000) + 1.0)
        maf = np.interp(at, times, reading)
        last = record(k - 1, 4, charges[k - 1], own)
        state = monitor.judge(state, facts(k, maf=maf, last=last))
        ratios.append(row(state, layout.FLOW)[(k - 1) % 4])
        plain.append(math.log(maf.mean() * T / charges[k - 1]))
    expected = math.log(factor)
    np.testing.assert_allclose(ratios[1:], expected, atol=2e-3)
    assert np.max(np.abs(np.array(plain[20:]) - expected)) > 0.2  # without the term of the lag


def test_what_flows_in_after_the_next_ivo_counts_there():
    """A quarter of each charge flows in during the event after its own."""
    shares = np.concatenate((np.full(PARTS, 0.75 / PARTS), np.full(PARTS, 0.25 / PARTS)))
    charges = np.array([2e-4, 4e-4, 3e-4, 1e-4, 2e-4, 2e-4])
    true = 0.75 * charges + 0.25 * np.concatenate(([0.0], charges[:-1]))
    monitor, state = monitor_of(), monitor_of().start()
    for k in range(1, 7):
        last = record(k - 1, 4, charges[k - 1], shares)
        # Readings that are the same throughout an event; they jump at the IVO
        state = monitor.judge(state, facts(k, maf=np.full(50, true[k - 1] / T), last=last))
        if k > 1:
            lag = monitor.maf_time * (true[k - 1] - true[k - 2]) / T
            seen = row(state, layout.FLOW)[(k - 1) % 4]
            assert seen == pytest.approx(math.log((true[k - 1] + lag) / true[k - 1]), abs=1e-9)


@pytest.mark.parametrize(("factor", "found"), [(1.5, True), (0.6, True), (1.3, False)])
def test_without_estimates_the_flow_itself_has_to_fit(factor, found):
    wrong = from_start(flow=factor * CHARGE / T)
    states = drive(monitor_of(), START + 60, wrong, estimated=False, ratio=math.nan)
    assert (abs(math.log(factor)) > 0.35) == found
    assert bool(all_alarms(states) & Alarm.MAF) == found


def test_the_model_is_held_to_what_it_was_once_it_has_been_right():
    """0.2 is no news at first, but is after five cycles in which the model was right."""
    monitor = monitor_of(level_limit=1.0)
    assert not all_alarms(drive(monitor, 200, ratio=0.2))
    states = drive(monitor, START + 40, from_start(ratio=0.2))
    # The median of four is 0.1 with two and 0.2 with three of them, and more than half of a
    # cycle has to pass so
    assert first(states, Alarm.MAF) == 2 + 2
    assert all_alarms(states) == Alarm.MAF
    assert first(drive(monitor, START + 40, from_start(ratio=0.09)), Alarm.MAF) is None


def test_far_too_much_is_found_at_once():
    states = drive(monitor_of(), START + 40, lambda k: {"ratio": 0.5})
    assert all_alarms(states) & Alarm.MAF


def test_a_learnt_level_that_runs_away_is_the_air_flow_sensors():
    def learnt(rate):
        return drive(monitor_of(), 2000, lambda k: {"level": rate * T * max(k - 300, 0)})

    # A mean over 5 s lags by 5 s: limit 0.08, or 0.016/s
    assert all_alarms(learnt(0.03)) == Alarm.MAF
    assert not all_alarms(learnt(0.008))


# -- innovations -----------------------------------------------------------------------------


def test_the_sum_of_strange_innovations_by_hand():
    """The lower median of four: 3 from the third event, then 3 - 1.8 is added each time."""
    states = drive(monitor_of(), START + 20, from_start(innovation=3.0))
    sums = [s.values[layout.SCORE] for s in states[START:]]
    np.testing.assert_allclose(sums[:9], [0.0, 0.0, 1.2, 2.4, 3.6, 4.8, 6.0, 7.2, 8.4])
    assert first(states, Alarm.INNOVATION) == 8
    # It is no more than twice the limit, and ends under a quarter of it: from the second good
    # one on it falls by 0.8 an event: 16, 15.2, ... 2.4, 1.6
    calm = drive(monitor_of(), 40, state=states[-1], first=START + 20)
    assert states[-1].values[layout.SCORE] == 16.0
    stands = [bool(s.alarms & Alarm.INNOVATION) for s in calm]
    assert stands == [True] * 18 + [False] * 22
    assert all_alarms(states + calm) == Alarm.INNOVATION


def test_innovations_that_are_allowed_add_up_to_nothing():
    assert not all_alarms(drive(monitor_of(), 400, innovation=1.75))


def test_one_innovation_counts_to_a_gate():
    wild = drive(monitor_of(), START + 3, from_start(innovation=1e300))
    assert wild[-1].values[layout.SCORE] == pytest.approx(10.0 - 1.8)


def test_refused_windows_count_most():
    states = drive(monitor_of(), START + 4, from_start(refused=True, innovation=math.nan))
    assert first(states, Alarm.INNOVATION) == 2  # 10 - 1.8 is more than 8


@pytest.mark.parametrize("n", [3, 4, 6])
def test_innovations_of_one_cylinder_are_its_valves(n):
    states = drive(monitor_of(n), 300, lambda k: {"innovation": 50.0 if k % n == 1 else 1.0})
    assert not all_alarms(states) & Alarm.INNOVATION


# -- durations -------------------------------------------------------------------------------


def told(error, n=4):
    """Durations told from `START` on, each off by a number or a function of event and cylinder."""

    def what(k):
        if k < START:
            return {}
        cylinder = (k - 1) % n + 1
        off = error(k, cylinder) if callable(error) else error
        return {"errors": () if off is None else ((cylinder, off),)}

    return what


@pytest.mark.parametrize("bias", [0.4e-3, -0.4e-3])
def test_a_bias_that_all_share_is_the_sensors(bias):
    states = drive(monitor_of(), START + 40, told(bias))
    # Half of it is the median of two of four; that of three lasts a cycle at the sixth
    assert first(states, Alarm.DURATION) == 5
    assert all_alarms(states) == Alarm.DURATION


def test_a_small_bias_is_none():
    assert not all_alarms(drive(monitor_of(), START + 200, told(0.2e-3)))


@pytest.mark.parametrize("n", [3, 4, 6])
@pytest.mark.parametrize("bias", [3e-3, -5e-3])
def test_a_large_bias_that_all_share_is_the_sensors_as_well(n, bias):
    states = drive(monitor_of(n), START + 200, told(bias, n))
    assert states[-1].alarms == Alarm.DURATION
    assert not all_alarms(states) & Alarm.VALVE
    assert first(states, Alarm.DURATION) <= 40
    back = drive(monitor_of(n), 100, state=states[-1], first=START + 200)
    assert not all_alarms(back) & Alarm.VALVE
    assert back[-1].alarms == 0


@pytest.mark.parametrize("n", [1, 3, 4, 6])
def test_one_valve_that_is_far_off_is_its_own(n):
    late = told(lambda k, i: 1.5e-3 if i == min(2, n) else 0.0, n)
    states = drive(monitor_of(n), START + 60, late)
    assert states[-1].alarms & Alarm.VALVE
    assert states[-1].suspects == (min(2, n),)
    # Told twice: that of cylinder 2 at the next time it is its turn, and a cycle later
    turn = next(k for k in range(START, START + n) if (k - 1) % n + 1 == min(2, n)) - START
    assert first(states, Alarm.VALVE) == turn + n
    if n > 2:
        assert all_alarms(states) == Alarm.VALVE
    back = drive(monitor_of(n), 20 * n, state=states[-1], first=START + 60)
    assert not back[-1].alarms & Alarm.VALVE


def test_one_valve_that_is_a_little_off_is_adapted_to():
    assert not all_alarms(drive(monitor_of(), 400, told(lambda k, i: 0.15e-3 if i == 2 else 0.0)))


def test_valves_that_scatter_are_not_the_sensors_fault():
    def odd(k, cylinder):
        """Scatter of 0.9 ms, either way; from event 140 on, all are 0.4 ms late as well."""
        return (0.9e-3 if (k // 4 + cylinder) % 2 else -0.9e-3) + (0.4e-3 if k >= 140 else 0.0)

    states = drive(monitor_of(), 400, told(odd))
    assert not all_alarms(states) & Alarm.DURATION
    spread = states[139].values[layout.SPREAD]
    assert math.sqrt(spread) > 0.25e-3


def test_a_wild_duration_is_soon_forgotten():
    """After a second, the monitor sees a bias as before."""
    for wild in (1e200, math.inf, -1e3):
        before = drive(monitor_of(), START - 50)
        state = drive(monitor_of(), 1, lambda k, w=wild: {"errors": ((3, w),)}, before[-1], 10)[-1]
        after = drive(monitor_of(), START + 40, told(0.4e-3), state, first=11)
        assert all_alarms(after) == Alarm.DURATION
        assert np.isfinite(after[-1].values[layout.SPREAD])


def test_a_sensor_that_tells_no_duration_is_found():
    states = drive(monitor_of(), START + 60, told(None))
    assert first(states, Alarm.DURATION) == 7  # the eighth in a row: two cycles
    assert all_alarms(states) == Alarm.DURATION
    back = drive(monitor_of(), 40, state=states[-1], first=START + 60)
    assert back[-1].alarms == 0
    assert all_alarms(back) == Alarm.DURATION


def test_a_valve_that_tells_no_duration_is_its_own():
    states = drive(monitor_of(), START + 60, told(lambda k, i: None if i == 3 else 0.0))
    assert all_alarms(states) == Alarm.VALVE
    assert states[-1].suspects == (3,)
    assert 8 <= first(states, Alarm.VALVE) <= 16  # three cycles are let pass


def test_while_a_valve_is_suspect_the_air_flow_is_not():
    """It explains why the estimates are off."""

    def off(k):
        return {"ratio": 0.2} if k >= START + 20 else {}

    silent = told(lambda k, i: None if i == 3 else 0.0)
    states = drive(monitor_of(), START + 80, lambda k: {**silent(k), **off(k)})
    assert all_alarms(states) == Alarm.VALVE
    assert all_alarms(drive(monitor_of(), START + 80, off)) == Alarm.MAF


def shut(cylinders, durations=0.0):
    """Some valves are kept shut from `START` on; None tells no duration of the others."""

    def what(k):
        cylinder = (k - 1) % 4 + 1
        if k < START or cylinder not in cylinders:
            return {"errors": ()} if k >= START and durations is None else {}
        last = record(k - 1, 4, 5e-5, np.zeros(EVENTS * PARTS), lift_mm=0.0)
        return {"last": last, "errors": ((cylinder, math.nan),), "flow": 1e-6}

    return what


@pytest.mark.parametrize("cylinders", [(2,), (1, 3), (1, 2, 3), (1, 2, 3, 4)])
def test_valves_that_are_kept_shut_are_no_fault(cylinders):
    states = drive(monitor_of(), START + 120, shut(cylinders))
    states += drive(monitor_of(), 60, state=states[-1], first=START + 120)
    assert not all_alarms(states)


@pytest.mark.parametrize("cylinders", [(2,), (1, 3)])
def test_beside_a_valve_that_is_kept_shut_the_duration_sensor_is_told_from_valves(cylinders):
    states = drive(monitor_of(), START + 120, shut(cylinders, None))
    assert all_alarms(states) == Alarm.DURATION
    assert first(states, Alarm.DURATION) <= 16


# -- one valve's charge ----------------------------------------------------------------------


@pytest.mark.parametrize("n", [3, 4, 6])
@pytest.mark.parametrize("apart", [-0.4, 0.4, -2.0])
def test_one_charge_apart_twice_is_a_valves(n, apart):
    def weak(k):
        return {"ratio": apart if (k - 2) % n == 1 and k >= START else 0.0}

    states = drive(monitor_of(n), START + 60, weak)
    turn = next(k for k in range(START, START + n) if (k - 2) % n == 1) - START
    assert first(states, Alarm.VALVE) == turn + n
    assert states[-1].suspects == (2,)
    assert all_alarms(states) == Alarm.VALVE
    # It stands until that cylinder is seen again, and three estimates clear it
    back = drive(monitor_of(n), 5 * n, state=states[-1], first=START + 60)
    stands = [bool(s.alarms) for s in back]
    turn = next(k for k in range(START + 60, START + 60 + n) if (k - 2) % n == 1) - START - 60
    assert all(stands[:turn])
    assert not any(stands[turn + 2 * n :])


def test_a_charge_apart_once_is_none():
    def once(k):
        return {"ratio": -0.6 if k >= START and k % 8 == 1 else 0.0}

    assert not all_alarms(drive(monitor_of(), START + 100, once))


def test_less_than_the_limit_is_adapted_to():
    states = drive(monitor_of(), 300, lambda k: {"ratio": -0.2 if k % 4 == 3 else 0.0})
    assert not all_alarms(states)


# -- clearing --------------------------------------------------------------------------------


@pytest.mark.parametrize("events", [3, 12, 30])
def test_an_alarm_ends_after_enough_events_without_a_finding(events):
    def nan(k):
        return {"map_": np.full(20, math.nan)} if START <= k < START + 10 else {}

    states = drive(monitor_of(recovery_events=events), START + 80, nan)
    ends = [k - START - 10 for k, s in enumerate(states) if s.alarms & Alarm.MAP][-1] + 1
    assert ends == 2 + events - 1  # most cylinders have to speak first


def test_a_relapse_starts_the_count_anew():
    def nan(k):
        again = START <= k < START + 10 or START + 20 <= k < START + 22
        return {"map_": NONE} if again else {}

    states = drive(monitor_of(), START + 80, nan)
    stands = [bool(s.alarms & Alarm.MAP) for s in states[START:]]
    assert stands[1:34] == [True] * 33  # without a gap, to 12 events after the second time
    assert not any(stands[40:])


# -- the object ------------------------------------------------------------------------------


def test_judging_leaves_the_state_as_it_was():
    monitor = monitor_of()
    state = drive(monitor, 70, from_start(innovation=5.0))[-1]
    kept = state.values.copy()
    twice = [monitor.judge(state, facts(70, ratio=0.5, maf=NONE)) for _ in range(2)]
    np.testing.assert_array_equal(state.values, kept)
    np.testing.assert_array_equal(twice[0].values, twice[1].values)
    assert twice[0].values is not state.values
    state.values.setflags(write=False)  # nor does it need to be written
    np.testing.assert_array_equal(
        monitor.judge(state, facts(70, ratio=0.5, maf=NONE)).values, twice[0].values
    )


def test_it_can_be_sent_to_another_process():
    monitor = FaultMonitor.of(Engine.paper(), recovery_events=7)
    state = drive(monitor, 50)[-1]
    copy, copied = pickle.loads(pickle.dumps((monitor, state)))
    assert copy == monitor
    assert copy.recovery_events == 7
    a, b = monitor.judge(state, facts(50)), copy.judge(copied, facts(50))
    np.testing.assert_array_equal(a.values, b.values)
    assert a[1:] == b[1:]


def test_it_is_made_of_an_engine():
    engine = Engine.paper()
    monitor = FaultMonitor.of(engine, valve_limit=0.3)
    assert monitor.n_cylinders == engine.n_cylinders
    assert monitor.throttle_area == pytest.approx(0.2102, rel=1e-3)  # Eq. 19 at 90 deg
    assert monitor.replace(valve_limit=0.25) == FaultMonitor.of(engine)


NAMES = [name for name in FaultMonitor.__dataclass_fields__ if not name.startswith("_")]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_impossible_numbers_are_refused(name, value):
    with pytest.raises(ParameterError, match=name):
        monitor_of().replace(**{name: value})


@pytest.mark.parametrize("name", ["n_cylinders", "same_readings", "recovery_events"])
def test_counts_are_whole(name):
    with pytest.raises(ParameterError, match=name):
        monitor_of().replace(**{name: 2.5})
