"""The controller under faults, against the full plant and against whatever numbers may come."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camless_ctrl.alarms import Alarm, Mode
from camless_ctrl.closed_loop import Conditions, ValveErrors, simulate
from camless_ctrl.cylinder_parameters import CylinderParameters
from camless_ctrl.event_data import Measurement
from camless_ctrl.faults import FAULT_KINDS, Fault
from plant import CrankAnglePlant
from plant.errors import ParameterError

N, SPEED, EVENT, DEMAND = 4, 1500.0, 0.02, 3e-4  # 1, rpm, s, kg
FLOW_FACTORS = (1.03, 0.85, 0.96, 1.05)  # of the true cylinders over the nominal one
JITTER = 0.05e-3  # s, 1 sigma
WARM, ACTING, AFTER = 240, 160, 160  # events before, of and after a fault
END = WARM + ACTING
SETTLED = 80  # events in which the controller settles after something happened
CYLINDER = 2  # of a fault of one valve

MAF, MAP, DURATION, VALVE = Alarm.MAF, Alarm.MAP, Alarm.DURATION, Alarm.VALVE
EXPECTED = {  # alarms of which one has to be there, and the events within which it is to be
    "maf-stuck": (MAF, 40),
    "maf-dropout": (MAF, 40),
    "maf-nan": (MAF, 40),
    "maf-offset": (MAF | Alarm.INNOVATION, 40),
    "maf-drift": (MAF | Alarm.INNOVATION, 60),  # it takes 0.75 s to 10 % of the flow
    "maf-slow": (MAF | Alarm.INNOVATION, 40),
    "map-offset": (MAP, 40),
    "map-stuck": (MAP, 40),
    "map-nan": (MAP, 40),
    "duration-missing": (DURATION, 40),
    "duration-bias": (DURATION, 40),
    "valve-stuck": (VALVE, 40),
    "valve-late": (VALVE, 40),
    "valve-jitter": (DURATION | VALVE, 40),
    "speed-spike": (Alarm.SPEED, 40),
    "missed-computation": (Alarm.CLOCK, 40),
}
HARMLESS = ("maf-noise", "valve-lift")  # they may stay unknown
SENSOR = [kind for kind in FAULT_KINDS if FAULT_KINDS[kind].target in ("maf", "map", "duration")]


@pytest.fixture(scope="module")
def plant(narrow_design):
    engine = narrow_design.engine.replace(cylinder_flow_factors=FLOW_FACTORS)
    return CrankAnglePlant(engine, runner=True, oscillation=True)


@pytest.fixture(scope="module")
def run(narrow_design, plant):
    """Run of a demand under faults; the engine's cylinders differ, its valves scatter."""

    def run(*faults, demand=DEMAND, events=END + AFTER, jitter=JITTER, **options):
        options.setdefault("controller", narrow_design.controller)
        controller = options.pop("controller")
        demands = np.full(events, demand) if np.isscalar(demand) else demand
        return simulate(
            plant,
            controller,
            demands,
            SPEED,
            valves=ValveErrors(0.0, jitter),
            faults=faults,
            seed=2,
            **options,
        )

    return run


@pytest.fixture(scope="module")
def faulty(run):
    """Run with one fault of its default size from event WARM to END."""

    @functools.cache
    def faulty(kind):
        length = 1 if kind == "missed-computation" else ACTING
        cylinder = CYLINDER if kind in ("valve-stuck", "valve-lift", "valve-late") else None
        # Half an event before an IVO, so that no IVO is at its edge
        start, end = (WARM - 0.5) * EVENT, (WARM + length - 0.5) * EVENT
        return run(Fault(kind, start, end, cylinder=cylinder))

    return faulty


def errors(result):
    return result.charge / result.demand - 1.0


def worst_mean(error):
    """Largest mean of a cylinder; as many events of each."""
    assert error.size % N == 0
    return np.abs(np.nanmean(error.reshape(-1, N), axis=0)).max()


def slope_of(design, demand=DEMAND):
    """Change of ln charge with the duration, 1/s, of the nominal engine."""
    return design.model.inverse(demand, SPEED).duration_slope


# -- single faults ---------------------------------------------------------------------------


def test_every_kind_is_expected_to_do_something():
    assert set(EXPECTED) | set(HARMLESS) == set(FAULT_KINDS)


@pytest.mark.parametrize("kind", list(EXPECTED))
def test_a_fault_is_named_in_time(faulty, kind):
    wanted, within = EXPECTED[kind]
    alarms = faulty(kind).alarms
    assert not alarms[:WARM].any()
    raised = np.flatnonzero(alarms[WARM:] & int(wanted))
    assert raised.size
    assert raised[0] <= within
    if FAULT_KINDS[kind].target in ("maf", "map", "duration"):
        # No other source is accused meanwhile
        sources = int(MAF | MAP | DURATION | VALVE) & ~int(wanted)
        if "drift" not in kind:
            assert not (alarms & sources).any()
        assert faulty(kind).mode.max() == Mode.DEGRADED


@pytest.mark.parametrize("kind", HARMLESS)
def test_what_may_stay_unknown_is_harmless(faulty, kind):
    result = faulty(kind)
    assert worst_mean(errors(result)[WARM + SETTLED : END]) < 0.02
    assert worst_mean(errors(result)[-SETTLED:]) < 0.01


@pytest.mark.parametrize("kind", SENSOR)
def test_a_sensor_that_fails_costs_little_charge(faulty, kind):
    error = errors(faulty(kind))
    # A drift is followed until it contradicts the rest: limit 10 %, and what jitter adds
    assert np.abs(error[WARM:END]).max() < (0.15 if kind == "maf-drift" else 0.10)
    assert worst_mean(error[WARM + SETTLED : END]) < 0.02


@pytest.mark.parametrize("kind", list(FAULT_KINDS))
def test_after_a_fault_all_is_as_before(faulty, kind):
    result = faulty(kind)
    assert worst_mean(errors(result)[-SETTLED:]) < 0.01
    assert result.mode[-1] == Mode.NORMAL
    assert result.alarms[-1] == 0


@pytest.mark.parametrize("kind", SENSOR)
def test_the_return_to_normal_makes_no_bump(narrow_design, faulty, kind):
    """Two charges of a cylinder differ by what the jitter of two valve events makes of them.

    ``ln m`` moves by slope times jitter: the difference of two has sqrt(2) times its sigma. Of
    some hundred of them none is beyond 4.5 sigma but once in a thousand runs.
    """
    result = faulty(kind)
    ends = [k for k in range(WARM, result.mode.size) if result.mode[k - 1] and not result.mode[k]]
    bound = 4.5 * math.sqrt(2.0) * slope_of(narrow_design) * JITTER
    assert 0.03 < bound < 0.05
    step = np.abs(np.log(result.charge[N:] / result.charge[:-N]))  # at [k]: events k and k + N
    if kind != "maf-noise":  # which may stay unknown
        assert ends
    for k in ends:
        assert step[k - N : k + 2 * N].max() < bound


@pytest.mark.parametrize("kind", ["maf-nan", "map-nan", "duration-missing"])
def test_without_jitter_the_return_moves_the_charge_little(run, kind):
    """What is left is what the controller does: noise of the sensors, and a bump if there is one.

    The same run without the fault says how much the noise alone makes of it.
    """
    fault = Fault(kind, (WARM - 0.5) * EVENT, (END - 0.5) * EVENT)
    result, usual = run(fault, jitter=0.0), run(jitter=0.0)
    back = int(np.flatnonzero(result.mode)[-1]) + 1
    assert END < back < END + SETTLED
    around = slice(back - 2 * N, back + 2 * N)
    step = np.abs(np.log(result.charge[N:] / result.charge[:-N]))[around].max()
    noise = np.abs(np.log(usual.charge[N:] / usual.charge[:-N]))[WARM:].max()
    assert step < max(2.0 * noise, 2e-3)


def test_speed_spikes_are_told_once_and_change_no_charge(faulty):
    result = faulty("speed-spike")
    spiked = result.told_speed_rpm != result.speed_rpm
    np.testing.assert_array_equal((result.alarms & int(Alarm.SPEED)) != 0, spiked)
    assert 10 < spiked.sum() < ACTING
    assert np.abs(errors(result)[WARM:END]).max() < 0.05


def test_a_missed_computation_is_told_once(faulty):
    clock = np.flatnonzero(faulty("missed-computation").alarms & int(Alarm.CLOCK))
    assert clock.tolist() == [WARM + 1]  # at the next call


@pytest.mark.parametrize("size", [1e-3, 2e-3, -3e-3])
def test_a_large_bias_of_durations_is_still_one_fault(run, size):
    result = run(Fault("duration-bias", WARM * EVENT, END * EVENT, size))
    assert result.mode.max() == Mode.DEGRADED
    raised = np.flatnonzero(result.alarms[WARM:] & int(DURATION))
    assert raised[0] <= 40
    assert np.abs(errors(result)[WARM:END]).max() < 0.10


def test_a_pressure_sensor_that_starts_stuck_is_believed_when_it_moves(run):
    result = run(Fault("map-stuck", 0.0, 25.5 * EVENT, 8e4), events=240)
    stands = np.flatnonzero(result.alarms & int(MAP))
    assert stands[0] <= 5
    assert stands[-1] < 60
    assert result.alarms[-1] == 0
    assert worst_mean(errors(result)[-SETTLED:]) < 0.01


def test_the_ambient_pressure_may_change_while_it_is_not_measured(run):
    """Down a pass without a pressure sensor, 4 kPa in 13 s, and the sensor comes back."""
    time = EVENT * np.arange(1100)
    ambient = np.interp(time, [5.0, 18.0], [1e5, 0.96e5])
    fault = Fault("map-nan", 6.0, 17.0)
    result = run(fault, events=time.size, conditions=Conditions(ambient_pressure=ambient))
    stands = np.flatnonzero(result.alarms & int(MAP))
    assert 6.0 < time[stands[0]] < 6.2
    assert 17.0 < time[stands[-1]] < 18.0
    assert result.alarms[-1] == 0
    assert result.mode.max() == Mode.DEGRADED
    assert worst_mean(errors(result)[-SETTLED:]) < 0.01


# -- several faults --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def blind(run):
    """Neither air flow nor pressure is measured, at a demand near the largest one."""
    times = (WARM - 0.5) * EVENT, (END - 0.5) * EVENT
    return run(Fault("maf-nan", *times), Fault("map-nan", *times), demand=4.3e-4)


def test_two_sensors_that_fail_are_safe_mode_and_less_charge(narrow_design, blind):
    reaction = narrow_design.controller.faults
    assert (blind.mode[:WARM] == Mode.NORMAL).all()
    safe = np.flatnonzero(blind.mode == Mode.SAFE)
    assert WARM < safe[0] <= WARM + 40
    # The share falls by 1/reach_events an event, and then holds
    held = slice(int(safe[0]) + math.ceil(0.5 * reaction.reach_events), END)
    assert blind.limited[held].all()
    for k in range(held.start, held.stop):
        used = CylinderParameters(
            blind.flow_gain[k], blind.duration_offset[k], blind.charge_factor[k]
        )
        most = narrow_design.model.limits(SPEED, used)[1]
        # 4 sigma of the jitter, and 1 % of what was learnt
        near = 4.0 * slope_of(narrow_design, 2.4e-4) * JITTER + 0.01
        assert blind.charge[k] == pytest.approx(reaction.safe_share * most, rel=near)
    assert worst_mean(errors(blind)[-SETTLED:]) < 0.01
    assert blind.mode[-1] == Mode.NORMAL
    assert not blind.limited[-SETTLED:].any()


def test_the_limit_comes_and_goes_as_a_ramp(narrow_design, blind):
    reaction = narrow_design.controller.faults
    most = narrow_design.model.limits(SPEED)[1]
    highest = most * 1.1  # with the parameters of any of these cylinders
    # A cycle is four events; jitter moves each of two charges
    jitter = 4.5 * math.sqrt(2.0) * slope_of(narrow_design, 2.4e-4) * JITTER
    step = np.abs(blind.charge[N:] - blind.charge[:-N])[WARM - N :]
    assert step.max() < N / reaction.reach_events * highest + jitter * 2.4e-4
    # and is a ramp, not a drop to the end value
    fell = np.flatnonzero(blind.charge[WARM:END] < 1.1 * reaction.safe_share * most)[0]
    assert fell > 0.3 * reaction.reach_events


def test_safe_commands_do_not_depend_on_what_sensors_say(run):
    """Once safe, wild readings of both sensors change no command."""
    start, end = (WARM - 0.5) * EVENT, (END - 0.5) * EVENT
    runs = [
        run(
            Fault("maf-stuck", start, end, maf),
            Fault("map-stuck", start, end, map_),
            events=END,
        )
        for maf, map_ in ((0.014, 8e4), (0.5, 2e4))
    ]
    settled = slice(WARM + SETTLED, END)
    assert (runs[0].mode[settled] == Mode.SAFE).all()
    assert (runs[1].mode[settled] == Mode.SAFE).all()
    a, b = (result.duration_deg[settled] for result in runs)
    np.testing.assert_allclose(a, b, rtol=0.02)
    for result in runs:
        # but for the density, which still closes on the pressure that is believed
        assert np.ptp(result.duration_deg[settled].reshape(-1, N), axis=0).max() < 1e-4


# -- cylinders that are kept shut ------------------------------------------------------------


def test_a_cylinder_is_shut_and_comes_back(run):
    demand = np.full(480, DEMAND)
    off = np.arange(WARM + CYLINDER - 1, WARM + 120, N)
    demand[off] = 0.0
    result = run(demand=demand, jitter=0.0)
    assert (result.lift_mm[off] == 0.0).all()
    assert (result.delivered_lift_mm[off] == 0.0).all()
    assert (result.charge[off] == 0.0).all()
    assert not result.alarms.any()
    assert (result.mode == Mode.NORMAL).all()
    on = np.setdiff1d(np.arange(demand.size), off)
    error = result.charge[on] / DEMAND - 1.0
    assert abs(result.charge[off[-1] + N] / DEMAND - 1.0) < 0.02  # the first one after it
    assert np.abs(error[on >= WARM]).max() < 0.02


def test_all_cylinders_are_shut_and_come_back(run):
    demand = np.full(400, DEMAND)
    demand[WARM : WARM + 80] = 0.0
    result = run(demand=demand, jitter=0.0)
    assert not result.alarms.any()
    assert (result.charge[WARM : WARM + 80] == 0.0).all()
    back = result.charge[WARM + 80 : WARM + 80 + N] / DEMAND - 1.0
    assert np.abs(back).max() < 0.02


def test_missing_durations_beside_a_shut_cylinder_are_one_fault(run):
    demand = np.full(END + AFTER, DEMAND)
    demand[80 + CYLINDER - 1 : END + 80 : N] = 0.0
    fault = Fault("duration-missing", (WARM - 0.5) * EVENT, (END - 0.5) * EVENT)
    result = run(fault, demand=demand)
    found = result.alarms[WARM:]
    assert set(np.unique(found)) == {0, int(DURATION)}
    assert np.flatnonzero(found)[0] <= 40
    assert result.mode.max() == Mode.DEGRADED


# -- without monitors ------------------------------------------------------------------------


def test_while_nothing_is_wrong_the_monitors_change_no_command(narrow_design, run):
    trusting = narrow_design.controller.replace(faults=None)
    with_, without = run(events=300), run(events=300, controller=trusting)
    assert not with_.alarms.any()
    for name in ("lift_mm", "duration_deg", "charge", "flow_gain", "duration_offset"):
        np.testing.assert_array_equal(getattr(with_, name), getattr(without, name))
    assert without.final_state.watch is None


def test_without_monitors_a_wrong_sensor_is_believed(narrow_design, run, faulty):
    """So that it is the monitors that make the difference."""
    trusting = narrow_design.controller.replace(faults=None)
    times = (WARM - 0.5) * EVENT, (END - 0.5) * EVENT
    result = run(Fault("maf-offset", *times), controller=trusting)
    assert not result.mode.any()
    worst = [worst_mean(errors(r)[WARM + SETTLED : END]) for r in (result, faulty("maf-offset"))]
    assert worst[0] > 0.1 > 5.0 * worst[1]


def test_monitors_of_another_engine_are_refused(narrow_design):
    controller = narrow_design.controller
    monitor = controller.faults.monitor.replace(n_cylinders=3)
    with pytest.raises(ParameterError, match="3 cylinders"):
        controller.replace(faults=type(controller.faults)(monitor))


def test_an_estimator_that_is_lost_begins_anew(narrow_design, run):
    controller = narrow_design.controller
    state = run(events=60).final_state
    lost = state._replace(watch=state.watch._replace(starts_anew=True))
    fresh = state._replace(estimator=controller.estimator.start())
    k = state.event_index
    time = state.time + EVENT - 1e-3 * np.arange(20.0, 0.0, -1.0)
    told = Measurement(
        state.time + EVENT, SPEED, time, np.full(20, 0.015), time, np.full(20, 9.9e4), (), k
    )
    lost, fresh, usual = (controller.step(s, told, DEMAND) for s in (lost, fresh, state))
    assert lost.command == fresh.command
    # Only who remembers the events before has a window that ends now, be it refused or not
    ended = [
        s.diagnostics.estimate is not None or s.diagnostics.rejected for s in (lost, fresh, usual)
    ]
    assert ended == [False, False, True]


# -- whatever numbers samples hold -----------------------------------------------------------

WILD = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, 1e308, -1e308, 5e-324, math.nan, math.inf, -math.inf]),
)
SANE_FLOW, SANE_PRESSURE = st.floats(0.0, 0.1), st.floats(2e4, 1.2e5)
TOLD = st.fixed_dictionaries(
    {
        "after": st.one_of(st.just(EVENT), WILD),
        "speed": st.one_of(st.just(SPEED), WILD),
        "flow": st.lists(st.one_of(SANE_FLOW, WILD), max_size=6),
        "pressure": st.lists(st.one_of(SANE_PRESSURE, WILD), max_size=6),
        "times": st.one_of(st.none(), st.lists(WILD, min_size=6, max_size=6)),
        "duration": st.one_of(st.none(), st.just(0.0135), WILD),
        "jump": st.one_of(st.just(0), st.integers(-9, 9), st.integers(-(10**9), 10**9)),
        "demand": st.one_of(st.just(0.0), st.floats(1e-6, 1e-3), st.floats(0.0, 1e308)),
        "active": st.booleans(),
    }
)


@pytest.fixture(scope="module")
def started(run):
    return run(events=40).final_state


@settings(max_examples=150, deadline=None)
@given(st.booleans(), st.lists(TOLD, min_size=1, max_size=30))
def test_whatever_is_told_nothing_is_raised_and_commands_keep_limits(
    narrow_design, started, warm, told
):
    controller = narrow_design.controller
    state = started if warm else controller.initial_state()
    limits = controller.limits
    low, high = controller.speed_range_rpm
    for event in told:
        m, j = len(event["flow"]), len(event["pressure"])
        known = state.time if math.isfinite(state.time) else 0.0
        time = known + event["after"]
        times = np.array(event["times"] or time - 1e-3 * np.arange(6.0, 0.0, -1.0))
        durations = (
            () if event["duration"] is None else ((state.event_index - 1, event["duration"]),)
        )
        step = controller.step(
            state,
            Measurement(
                time,
                event["speed"],
                times[:m],
                np.array(event["flow"], dtype=float),
                times[:j],
                np.array(event["pressure"], dtype=float),
                durations,
                state.event_index + event["jump"],
            ),
            event["demand"],
            active=event["active"],
        )
        state = step.state
        assert low <= state.speed_rpm <= high
        assert math.isfinite(state.time)
        assert 0.55 <= state.density <= 1.25
        assert 0.0 <= state.watch.reach <= 1.0
        assert controller.adaptation.bounds.contain(state.adaptation.parameters)
        if event["demand"] == 0.0:
            assert step.lift_mm == 0.0
            assert step.duration_deg > 0.0
            continue
        duration = step.duration_deg / (6.0 * state.speed_rpm)
        assert limits.lift_mm[0] <= step.lift_mm <= limits.lift_mm[1]
        assert step.duration_deg <= limits.longest_duration_deg * (1.0 + 1e-12)
        assert duration >= limits.shortest(step.lift_mm) * (1.0 - 1e-12)
