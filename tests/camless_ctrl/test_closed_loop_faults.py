"""What faults do in a run, seen by a controller that listens and commands by the clock alone."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.closed_loop import ValveErrors, simulate
from camless_ctrl.controller import ControlStep, Diagnostics
from camless_ctrl.cylinder_parameters import CylinderParameters, ParameterSet
from camless_ctrl.faults import FAULT_KINDS, Fault
from plant import CrankAnglePlant, Engine, ValveCommand
from plant.errors import InfeasibleProfileError, ParameterError
from plant.sampling import TimeSampling
from plant.sensors import MafSensor, MapSensor, SensorSet

N, SPEED = 4, 1500.0
EVENT = 0.02  # s
LIFT, DURATION = 4.0, 120.0
PLANT = CrankAnglePlant(oscillation=True)


class Listener:
    """Controller that keeps what it is told; its lift names the event, its charge is no matter."""

    n_cylinders = N

    def __init__(self, lift_step_mm=0.0, duration_deg=DURATION):
        self.told, self.lift_step, self.duration_deg = [], lift_step_mm, duration_deg
        self.model = SimpleNamespace(
            inverse=lambda *_: SimpleNamespace(lift_mm=LIFT, duration_deg=duration_deg)
        )

    def initial_state(self):
        return SimpleNamespace(event_index=0, adaptation=ParameterSet.nominal(N), density=1.0)

    def step(self, state, measurement, demand, *, active):
        self.told.append(measurement)
        lift = LIFT + self.lift_step * measurement.event_index
        found = Diagnostics(
            None, CylinderParameters(), demand, False, False, False, False, False, 1.0
        )
        return ControlStep(state, lift, self.duration_deg, found)


def listen(*faults, events=60, lift_step_mm=0.0, duration_deg=DURATION, speed_rpm=SPEED, **options):
    """Result of a run, and what the controller was told in it."""
    listener = Listener(lift_step_mm, duration_deg)
    result = simulate(
        PLANT, listener, np.full(events, 2e-4), speed_rpm, faults=faults, seed=5, **options
    )
    return result, listener.told


def samples(told, sensor):
    """All samples since the first event: time since then and readings."""
    names = {"maf": ("sample_time", "sample_flow"), "map": ("pressure_time", "pressure")}[sensor]
    time, value = (np.concatenate([getattr(m, name) for m in told]) for name in names)
    return time - told[0].time, value


def durations(told):
    return {event: duration for m in told for event, duration in m.durations}


@pytest.fixture(scope="module")
def usual():
    return listen()


# -- air-flow and pressure sensors -----------------------------------------------------------


@pytest.mark.parametrize(("kind", "size"), [("maf-offset", 8e-3), ("map-offset", 5e3)])
def test_an_offset_is_added_while_it_acts(usual, kind, size):
    sensor = kind[:3]
    _, told = listen(Fault(kind, 0.3, 0.7))
    time, value = samples(told, sensor)
    same_time, before = samples(usual[1], sensor)
    np.testing.assert_array_equal(time, same_time)
    acts = (time >= 0.3) & (time < 0.7)
    assert 350 < acts.sum() < 450
    np.testing.assert_allclose(value - before, np.where(acts, size, 0.0), atol=1e-9 * size)


def test_a_drift_grows_from_zero(usual):
    _, told = listen(Fault("maf-drift", 0.3, 0.9, 0.01))
    time, value = samples(told, "maf")
    grown = np.where((time >= 0.3) & (time < 0.9), 0.01 * (time - 0.3), 0.0)
    np.testing.assert_allclose(value - samples(usual[1], "maf")[1], grown, atol=1e-12)


@pytest.mark.parametrize("sensor", ["maf", "map"])
def test_a_stuck_sensor_holds_its_last_reading(usual, sensor):
    _, told = listen(Fault(f"{sensor}-stuck", 0.3, 0.7))
    time, value = samples(told, sensor)
    _, true = samples(usual[1], sensor)
    acts = (time >= 0.3) & (time < 0.7)
    assert set(value[acts]) == {true[time < 0.3][-1]}
    np.testing.assert_array_equal(value[~acts], true[~acts])


def test_a_sensor_stuck_from_the_first_event_holds_one_from_before(usual):
    _, told = listen(Fault("maf-stuck", 0.0), events=8)
    time, value = samples(told, "maf")
    before = samples(usual[1], "maf")[1][: (time < 0.0).sum()]
    assert set(value[time >= 0.0]) == {before[-1]}


def test_a_sensor_may_be_stuck_at_a_reading():
    _, told = listen(Fault("map-stuck", 0.1, size=5e4), events=20)
    time, value = samples(told, "map")
    assert set(value[time >= 0.1]) == {5e4}


@pytest.mark.parametrize("sensor", ["maf", "map"])
def test_samples_that_are_no_numbers_keep_their_times(usual, sensor):
    _, told = listen(Fault(f"{sensor}-nan", 0.3, 0.7))
    time, value = samples(told, sensor)
    true_time, true = samples(usual[1], sensor)
    np.testing.assert_array_equal(time, true_time)
    acts = (time >= 0.3) & (time < 0.7)
    assert np.isnan(value[acts]).all()
    np.testing.assert_array_equal(value[~acts], true[~acts])


def test_samples_that_drop_out_do_not_come(usual):
    _, told = listen(Fault("maf-dropout", 0.3, 0.7))
    time, value = samples(told, "maf")
    true_time, true = samples(usual[1], "maf")
    left = (true_time < 0.3) | (true_time >= 0.7)
    np.testing.assert_array_equal(time, true_time[left])
    np.testing.assert_array_equal(value, true[left])
    np.testing.assert_array_equal(samples(told, "map"), samples(usual[1], "map"))


@pytest.mark.parametrize("factor", [1.0, 2.0, 3.0])
def test_noise_is_a_multiple_of_the_sensors_own(factor):
    maf = MafSensor(bits=None)
    _, told = listen(Fault("maf-noise", 1.0, size=factor), events=300, sensors=SensorSet(maf=maf))
    _, true = listen(events=300, sensors=SensorSet(maf=maf.ideal()))
    (time, value), (_, clean) = samples(told, "maf"), samples(true, "maf")
    share = (value - clean) / clean / 0.01  # the sensor's own noise is 1 % of the reading
    assert np.std(share[time < 1.0]) == pytest.approx(1.0, abs=0.08)
    assert np.std(share[time >= 1.0]) == pytest.approx(factor, rel=0.05)
    assert np.mean(share[time >= 1.0]) == pytest.approx(0.0, abs=0.05 * factor)


def test_a_slow_sensor_lags_by_its_time_constant():
    # an ideal sensor at 40 samples an event: at the frequency of the events, 50 Hz, a lag of
    # 60 ms passes 1/sqrt(1 + (2 pi 3)^2), and it does not move the mean
    ideal = MafSensor(sampling=TimeSampling(0.5e-3)).ideal()
    sensors = SensorSet(maf=ideal)
    lines = []
    for faults in ((), (Fault("maf-slow", 0.2),)):
        _, told = listen(*faults, events=120, sensors=sensors)
        time, value = samples(told, "maf")
        last = value[time < 2.3][-1600:]  # 40 events, the lag settled
        wave = np.exp(-2j * np.pi * np.arange(last.size) / 40)
        lines.append((np.mean(last), np.abs(np.mean(last * wave))))
    (mean, line), (slow_mean, slow_line) = lines
    assert slow_mean == pytest.approx(mean, rel=1e-4)
    assert slow_line / line == pytest.approx(1.0 / math.hypot(1.0, 6.0 * math.pi), rel=0.02)


def test_a_slow_sensor_recovers_when_the_fault_ends():
    sensors = SensorSet(maf=MafSensor().ideal())
    (_, told), (_, usual) = (
        listen(*faults, sensors=sensors) for faults in ((Fault("maf-slow", 0.2, 0.6),), ())
    )
    time, value = samples(told, "maf")
    off = np.abs(value - samples(usual, "maf")[1])
    assert off[time < 0.2].max() == 0.0
    assert off[(time > 0.3) & (time < 0.6)].max() > 1e-3
    # the sensor's own lag of 15 ms forgets it
    assert off[time > 0.6 + 20 * 0.015].max() < 1e-9


def test_faults_act_in_the_order_of_the_signal_chain(usual):
    # stuck comes after the offset, whatever the order in which they are given
    pair = Fault("maf-stuck", 0.4), Fault("maf-offset", 0.2)
    for faults in (pair, pair[::-1]):
        time, value = samples(listen(*faults)[1], "maf")
        last = samples(usual[1], "maf")[1][time < 0.4][-1]
        assert value[-1] == pytest.approx(last + 8e-3)


# -- durations ---------------------------------------------------------------------------------


def test_durations_that_are_missing_are_those_of_the_cylinder(usual):
    _, told = listen(Fault("duration-missing", 0.3, 0.7, cylinder=2))
    known, all_known = durations(told), durations(usual[1])
    closes = {event: EVENT * event + DURATION / (6.0 * SPEED) for event in all_known}
    missing = {e for e in all_known if e % N == 1 and 0.3 <= closes[e] < 0.7}
    assert len(missing) == 5
    assert known == {e: d for e, d in all_known.items() if e not in missing}


def test_a_bias_is_added_to_durations(usual):
    _, told = listen(Fault("duration-bias", 0.3, cylinder=3))
    known, true = durations(told), durations(usual[1])
    assert known.keys() == true.keys()
    for event, duration in known.items():
        bias = 0.5e-3 if event % N == 2 and event > 14 else 0.0
        assert duration - true[event] == pytest.approx(bias, abs=1e-15)


# -- valves ------------------------------------------------------------------------------------


def test_a_stuck_valve_takes_in_nothing_and_tells_no_duration():
    result, told = listen(Fault("valve-stuck", 0.3, 0.7, cylinder=2))
    stuck = (result.cylinder == 2) & (result.time > 0.29) & (result.time < 0.69)
    assert stuck.sum() == 5
    assert set(result.charge[stuck]) == {0.0}
    assert set(result.delivered_lift_mm[stuck]) == {0.0}
    assert set(result.delivered_duration_deg[stuck]) == {0.0}
    assert set(result.lift_mm) == {LIFT}  # what was commanded
    assert not set(np.flatnonzero(stuck)) & set(durations(told))
    others = ~stuck[:-N]
    assert (result.charge[:-N][others] > 1e-4).all()


def test_a_lower_lift_is_delivered_and_takes_in_the_charge_of_it():
    result, _ = listen(Fault("valve-lift", 0.3), events=120)
    steady = PLANT.steady_cycle(SPEED, ValveCommand(0.4 * LIFT, DURATION)).air_charge
    assert result.delivered_lift_mm[20:] == pytest.approx(0.4 * LIFT)
    assert result.charge[-8:-4] == pytest.approx(steady, rel=1e-5)


def test_a_lift_too_low_for_any_motion_leaves_the_valve_shut():
    lowest = PLANT.engine.valvetrain.lowest_lift_mm
    for factor, opens in ((1.01 * lowest / LIFT, True), (0.99 * lowest / LIFT, False)):
        result, _ = listen(Fault("valve-lift", 0.1, size=factor), events=16)
        assert (result.delivered_lift_mm[-1] > 0.0) == opens
        assert (result.charge[8] > 0.0) == opens


def test_a_late_valve_shuts_later_and_the_sensor_sees_it(usual):
    result, told = listen(Fault("valve-late", 0.3, size=1e-3), events=120)
    late = result.delivered_duration_deg - result.duration_deg
    assert late[result.time < 0.29] == pytest.approx(0.0, abs=1e-12)
    assert late[result.time > 0.31] == pytest.approx(6.0 * SPEED * 1e-3)
    steady = PLANT.steady_cycle(SPEED, ValveCommand(LIFT, DURATION + 9.0)).air_charge
    assert result.charge[-8:-4] == pytest.approx(steady, rel=1e-5)
    known, true = durations(told), durations(usual[1])
    for event in range(5, 55):
        longer = 1e-3 if event >= 15 else 0.0
        assert known[event] - true[event] == pytest.approx(longer, abs=1e-12)


def test_jitter_is_that_of_the_cylinder():
    result, _ = listen(Fault("valve-jitter", 0.3, cylinder=1), events=600)
    late = (result.delivered_duration_deg - result.duration_deg) / (6.0 * SPEED)
    hit = (result.cylinder == 1) & (result.time > 0.31)
    assert np.std(late[hit]) == pytest.approx(0.5e-3, rel=0.15)
    assert np.mean(late[hit]) == pytest.approx(0.0, abs=4 * 0.5e-3 / math.sqrt(hit.sum()))
    assert late[~hit] == pytest.approx(0.0, abs=1e-15)


def test_too_short_a_duration_leaves_the_valve_shut():
    # 0.5 mm need 1.14 ms; errors that leave 0.5 ms leave no motion
    short = (DURATION - 4.5) / (6.0 * SPEED)
    result, told = listen(events=8, valves=ValveErrors((0.0, -short, 0.0, 0.0)))
    assert result.delivered_lift_mm.tolist() == [LIFT, 0.0, LIFT, LIFT] * 2
    assert result.charge[1] == 0.0
    assert all(event % N != 1 for event in durations(told))


def test_a_valve_open_at_compression_is_an_error():
    with pytest.raises(ParameterError, match="must be shut by 360 deg"):
        listen(Fault("valve-late", 0.1, size=0.01), speed_rpm=4500.0, events=40)


# -- speed and computation ---------------------------------------------------------------------


def test_speed_spikes_are_told_but_not_run():
    result, told = listen(Fault("speed-spike", 0.3, 0.7))
    spikes = np.flatnonzero(result.told_speed_rpm != SPEED)
    assert spikes.tolist() == [15, 22, 29]  # each seventh event from 0.3 s to 0.7 s
    assert set(result.told_speed_rpm[spikes]) == {SPEED + 2000.0}
    assert [m.speed_rpm for m in told] == result.told_speed_rpm.tolist()
    assert np.diff(result.time) == pytest.approx(EVENT)
    assert set(result.speed_rpm) == {SPEED}


def test_a_missed_computation_repeats_the_command_and_hands_all_over_later(usual):
    result, told = listen(Fault("missed-computation", 0.3, 0.36), lift_step_mm=0.01)
    called = [m.event_index for m in told]
    assert called == [k for k in range(60) if k not in (15, 16, 17)]
    lifts = LIFT + 0.01 * np.arange(60)
    lifts[15:18] = lifts[11:14]  # the cylinder's command of a cycle before
    np.testing.assert_allclose(result.lift_mm, lifts, rtol=1e-15)
    assert result.delivered_lift_mm == pytest.approx(lifts)
    np.testing.assert_array_equal(samples(told, "maf")[0], samples(usual[1], "maf")[0])
    after = told[15]
    assert after.event_index == 18
    assert after.sample_time.size == pytest.approx(80, abs=2)  # of four events
    assert {event for event, _ in after.durations} >= {15, 16}
    assert durations(told).keys() == durations(usual[1]).keys()


def test_before_its_first_computation_a_valve_repeats_the_first_command():
    result, told = listen(Fault("missed-computation", 0.0, 0.1), lift_step_mm=0.1, events=10)
    assert [m.event_index for m in told] == [5, 6, 7, 8, 9]
    assert set(result.lift_mm[:5]) == {LIFT}
    assert result.lift_mm[5:] == pytest.approx(LIFT + 0.1 * np.arange(5, 10))


def test_a_repeated_command_may_allow_no_motion_at_another_speed():
    # 20 deg are 2.2 ms at 1500 rpm and 0.8 ms at 4000 rpm, and the least motion takes 1.06 ms
    speeds = np.repeat((1500.0, 4000.0), 8)
    result, _ = listen(
        Fault("missed-computation", 0.159), events=16, speed_rpm=speeds, duration_deg=20.0
    )
    assert (result.delivered_lift_mm[:8] > 0.0).all()
    assert set(result.delivered_lift_mm[8:]) == {0.0}
    # a controller that knows the speed and still commands it is wrong, and the plant says so
    with pytest.raises(InfeasibleProfileError, match="too short for any valve motion"):
        listen(events=16, speed_rpm=speeds, duration_deg=20.0)


# -- all ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_a_fault_that_has_not_begun_changes_no_bit(usual, kind):
    result, told = listen(Fault(kind, 0.5), valves=ValveErrors(1e-4, 5e-5), events=40)
    same, same_told = listen(valves=ValveErrors(1e-4, 5e-5), events=40)
    before = result.time < 0.49
    for name in ("charge", "pumping_loss", "delivered_duration_deg", "told_speed_rpm"):
        # the last cycle before the start may still be open when it begins
        first = before & (np.arange(40) < 20)
        np.testing.assert_array_equal(getattr(result, name)[first], getattr(same, name)[first])
    for m, other in zip(told[:24], same_told[:24], strict=True):
        assert m.durations == other.durations
        np.testing.assert_array_equal(m.sample_flow, other.sample_flow)
        np.testing.assert_array_equal(m.pressure, other.pressure)


def test_faults_are_kept_with_the_result_and_do_not_depend_on_each_other():
    jitter = Fault("valve-jitter", 0.2, cylinder=1)
    both, _ = listen(jitter, Fault("valve-late", 0.2, cylinder=3))
    alone, _ = listen(jitter)
    assert both.faults == (jitter, Fault("valve-late", 0.2, cylinder=3))
    one = alone.cylinder == 1
    np.testing.assert_array_equal(
        both.delivered_duration_deg[one], alone.delivered_duration_deg[one]
    )


def test_wrong_faults_are_refused():
    with pytest.raises(ParameterError, match="cylinder 5, but the engine has 4"):
        listen(Fault("valve-stuck", 0.0, cylinder=5), events=4)
    with pytest.raises(ParameterError, match="must hold Fault only"):
        listen("maf-nan", events=4)


def test_a_sensor_of_another_make_has_no_noise_to_multiply():
    class Foreign:
        def start(self, seed):
            return MapSensor().start(seed)

    with pytest.raises(ParameterError, match="needs the noise of the sensor"):
        listen(Fault("maf-noise", 0.0), events=4, sensors=SensorSet(maf=Foreign()))


def test_three_cylinders():
    engine = Engine.paper().replace(n_cylinders=3)
    listener = Listener()
    listener.n_cylinders = 3
    result = simulate(
        CrankAnglePlant(engine), listener, np.full(30, 2e-4), SPEED,
        faults=[Fault("valve-stuck", 0.2, cylinder=3)],
    )  # fmt: skip
    shut = result.delivered_lift_mm == 0.0
    np.testing.assert_array_equal(shut, (result.cylinder == 3) & (result.time > 0.199))


def test_all_faults_to_come_change_no_bit_of_a_real_run(narrow_design):
    demand = np.repeat((1.7e-4, 3.5e-4), 60)
    runs = [
        simulate(
            PLANT, narrow_design.controller, demand, SPEED, seed=9,
            valves=ValveErrors(0.0, 5e-5), faults=faults,
        )
        for faults in ((), tuple(Fault(kind, 100.0) for kind in FAULT_KINDS))
    ]  # fmt: skip
    for name in ("charge", "estimate", "estimate_sigma", "lift_mm", "duration_deg", "flow_gain"):
        np.testing.assert_array_equal(getattr(runs[1], name), getattr(runs[0], name))


def test_a_real_controller_goes_on_after_missed_computations(narrow_design):
    result = simulate(
        PLANT, narrow_design.controller, np.full(160, 2.5e-4), SPEED, seed=9,
        faults=[Fault("missed-computation", 1.6, 1.7)],
    )  # fmt: skip
    missed = slice(80, 85)
    # the four commands before, then the first of them again
    np.testing.assert_array_equal(result.lift_mm[missed], result.lift_mm[[76, 77, 78, 79, 76]])
    assert not result.adapted[missed].any()
    error = result.charge[:-N] / result.demand[:-N] - 1.0
    assert np.abs(error[60:]).max() < 0.03
    estimated = result.estimate[100:150] / result.charge[100:150] - 1.0
    assert np.isfinite(estimated).all()  # of the right events again
    assert np.abs(np.mean(estimated)) < 0.01
