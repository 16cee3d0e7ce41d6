"""What follows from alarms: mode, going back, reach; the monitors are played by hand."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.alarms import Alarm, Mode
from camless_ctrl.fault_monitor import MonitorState
from camless_ctrl.fault_reaction import FaultReaction
from plant.errors import ParameterError

NOTHING = Alarm(0)
SOURCES = (Alarm.MAF, Alarm.MAP, Alarm.DURATION)


def reaction(n=4, **options):
    """Reaction whose monitors say what they are given."""
    heard = SimpleNamespace(
        n_cylinders=n,
        start=lambda: said(),
        judge=lambda state, facts: facts,
    )
    return FaultReaction(heard, **options)


def said(alarms=NOTHING, suspects=(), calm=True):
    return MonitorState(np.zeros(1), int(alarms), tuple(suspects), calm)


def run(what, events, watch=None, learnt="now", first=0.0, step=0.02, brief=NOTHING, **options):
    """Watches after each event, and the last thing learnt."""
    watch = what.start("nothing") if watch is None else watch
    watches = []
    for k in range(events):
        watch, learnt = what.judge(
            watch, said(**options), int(brief), first + (k + 1) * step, learnt
        )
        watches.append(watch)
    return watches, learnt


def mode_of(alarms, n=4, suspects=(), brief=NOTHING, events=1):
    return run(reaction(n), events, alarms=alarms, suspects=suspects, brief=brief)[0][-1].mode


def test_without_an_alarm_all_is_normal():
    watch = run(reaction(), 5)[0][-1]
    assert (watch.mode, watch.alarms, watch.reach, watch.learns_from(1)) == (
        Mode.NORMAL,
        0,
        1.0,
        True,
    )


@pytest.mark.parametrize("alarm", list(Alarm))
def test_one_alarm_degrades(alarm):
    if alarm in Alarm.SPEED | Alarm.CLOCK:
        watch = run(reaction(), 1, brief=alarm)[0][-1]
    else:
        watch = run(reaction(), 300, alarms=alarm, suspects=(2,) if alarm is Alarm.VALVE else ())
        watch = watch[0][-1]
    assert watch.mode is Mode.DEGRADED
    assert watch.alarms == alarm
    assert watch.reach == 1.0
    assert watch.learns_from(1) == (alarm in Alarm.VALVE | Alarm.SPEED | Alarm.CLOCK)
    assert watch.learns_from(2) == (alarm in Alarm.SPEED | Alarm.CLOCK)  # 2 is the suspect


@pytest.mark.parametrize("pair", list(itertools.combinations(SOURCES, 2)))
def test_two_sources_that_are_not_believed_are_one_too_many(pair):
    assert mode_of(pair[0] | pair[1]) is Mode.SAFE


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("other", [Alarm.INNOVATION, Alarm.VALVE, Alarm.CLOCK])
def test_what_is_no_source_adds_nothing(source, other):
    assert mode_of(source | other, suspects=(1,) if other is Alarm.VALVE else ()) is Mode.DEGRADED


def test_a_speed_counts_as_a_source_after_some_events_in_a_row():
    watches, _ = run(reaction(speed_events=4), 6, alarms=Alarm.MAP, brief=Alarm.SPEED)
    assert [w.mode for w in watches] == [Mode.DEGRADED] * 3 + [Mode.SAFE] * 3
    right, _ = run(reaction(), 1, watches[-1], alarms=Alarm.MAP)
    assert right[0].mode is Mode.DEGRADED
    again, _ = run(reaction(), 1, right[0], alarms=Alarm.MAP, brief=Alarm.SPEED)
    assert again[0].mode is Mode.DEGRADED  # not in a row
    assert mode_of(Alarm(0), brief=Alarm.SPEED, events=50) is Mode.DEGRADED  # alone


@pytest.mark.parametrize(
    ("n", "suspects", "mode"),
    [
        (4, 1, Mode.DEGRADED), (4, 2, Mode.SAFE), (3, 1, Mode.DEGRADED), (3, 2, Mode.SAFE),
        (6, 2, Mode.DEGRADED), (6, 3, Mode.SAFE), (2, 1, Mode.SAFE), (1, 1, Mode.SAFE),
    ],
)  # fmt: skip
def test_half_of_the_valves_are_too_many(n, suspects, mode):
    assert mode_of(Alarm.VALVE, n, suspects=range(1, suspects + 1)) is mode


def test_states_are_trusted_at_intervals_and_the_oldest_are_forgotten():
    what = reaction(trust_time=0.5, kept=3)
    watch, times = what.start("nothing"), []
    for k in range(1, 200):
        watch, _ = what.judge(watch, said(), 0, 0.02 * k, k)
        times = [kept.time for kept in watch.trusted]
        assert len(times) <= 3
        assert all(b - a >= 0.5 for a, b in itertools.pairwise(times))
    # Events 25, 50, ... 175: of them the last three
    assert [kept.adaptation for kept in watch.trusted] == [125, 150, 175]
    assert times == pytest.approx([2.5, 3.0, 3.5])


@pytest.mark.parametrize("kept", [1, 2, 5])
def test_no_more_states_are_kept_than_told(kept):
    watch = run(reaction(kept=kept, trust_time=0.1), 500)[0][-1]
    assert len(watch.trusted) == kept
    assert watch.trusted[-1].time == pytest.approx(10.0, abs=0.1)


def test_nothing_is_trusted_that_is_not_calm_or_under_an_alarm():
    what = reaction()
    for doubt in ({"calm": False}, {"alarms": Alarm.MAF, "calm": False}):
        watch = run(what, 200, **doubt)[0][-1]
        assert [kept.adaptation for kept in watch.trusted] == ["nothing"]


def test_a_clock_that_was_set_back_does_not_stop_the_trust():
    what = reaction(trust_time=0.5)
    watches, _ = run(what, 100, learnt="before", first=1000.0)
    after, _ = run(what, 100, watches[-1], learnt="after", first=0.0)
    assert {kept.adaptation for kept in after[-1].trusted} == {"after"}


@pytest.mark.parametrize("alarm", [*SOURCES, Alarm.INNOVATION, Alarm.VALVE])
def test_what_was_learnt_goes_back_once_and_to_the_oldest(alarm):
    what = reaction()
    watch = what.start("nothing")
    for k in range(1, 101):
        watch, _ = what.judge(watch, said(), 0, 0.02 * k, k)
    assert [kept.adaptation for kept in watch.trusted] == [50, 75, 100]
    doubt = said(alarm, calm=False)
    watch, learnt = what.judge(watch, doubt, 0, 2.02, 101)
    assert learnt == 50
    trusted = watch.trusted
    for k in range(30):  # while it stands, and when another joins: as it is
        also = Alarm.VALVE if alarm is Alarm.VALVE else Alarm.MAF | Alarm.MAP
        more = doubt if k < 10 else said(alarm | also, calm=False)
        watch, learnt = what.judge(watch, more, 0, 2.04 + 0.02 * k, "kept")
        assert learnt == "kept"
    watch, learnt = what.judge(watch, said(calm=False), 0, 3.0, "kept")  # it clears
    assert learnt == "kept"
    assert watch.trusted == trusted
    assert watch.learns_from(1)


def test_a_sensor_that_fails_after_a_valve_takes_back_what_the_others_learnt_since():
    what = reaction()
    watch = run(what, 100, learnt="sound")[0][-1]
    valve = {"alarms": Alarm.VALVE, "suspects": (1,), "calm": False}
    watches, learnt = run(what, 5, watch, learnt="sound", first=2.0, **valve)
    assert learnt == "sound"
    both = {**valve, "alarms": Alarm.VALVE | Alarm.MAF}
    _, learnt = run(what, 1, watches[-1], learnt="since", first=2.1, **both)
    assert learnt == "sound"


@pytest.mark.parametrize("alarm", [Alarm.SPEED, Alarm.CLOCK])
def test_other_alarms_take_nothing_back(alarm):
    what = reaction()
    _, learnt = run(what, 1, run(what, 100)[0][-1], learnt="mine", brief=alarm, calm=False)
    assert learnt == "mine"


@pytest.mark.parametrize("events", [7, 40])
def test_the_reach_falls_and_returns_without_a_jump(events):
    what = reaction(reach_events=events, safe_share=0.5)
    down, _ = run(what, 60, alarms=Alarm.MAF | Alarm.MAP)
    up, _ = run(what, 60, down[-1], alarms=Alarm.MAP)  # one is back: degraded, and no longer held
    reach = np.array([1.0, *(w.reach for w in down), *(w.reach for w in up)])
    steps = np.diff(reach)
    assert np.abs(steps).max() <= 1.0 / events + 1e-12
    assert reach[60] == 0.5
    assert reach[-1] == 1.0
    # Half of the reach takes half of the events
    assert np.count_nonzero(steps < 0.0) == np.count_nonzero(steps > 0.0) == -(-events // 2)
    assert steps[0] == pytest.approx(-1.0 / events)
    assert steps[60] == pytest.approx(1.0 / events)


def test_a_reach_that_turns_on_its_way_does_not_jump():
    what = reaction()
    watch, reach = what.start("nothing"), [1.0]
    for k in range(60):
        bad = Alarm.MAF | Alarm.MAP if k % 10 < 6 else Alarm.MAF
        watch, _ = what.judge(watch, said(bad, calm=False), 0, 0.02 * k, None)
        reach.append(watch.reach)
    assert np.abs(np.diff(reach)) == pytest.approx(np.full(60, 1.0 / 40.0))


def test_the_estimator_begins_anew_after_enough_strange_events():
    what = reaction(lost_events=40)
    watches, _ = run(what, 400, alarms=Alarm.MAF | Alarm.INNOVATION)
    assert [k + 1 for k, w in enumerate(watches) if w.starts_anew] == [40, 80, 160, 320]
    apart, _ = run(what, 39, alarms=Alarm.MAF | Alarm.INNOVATION)
    apart += run(what, 1, apart[-1], alarms=Alarm.MAF)[0]
    apart += run(what, 39, apart[-1], alarms=Alarm.MAF | Alarm.INNOVATION)[0]
    assert not any(w.starts_anew for w in apart)  # not in a row


@pytest.mark.parametrize(
    ("alarms", "learns"),
    [
        (Alarm.INNOVATION, True),
        (Alarm.INNOVATION | Alarm.VALVE, True),
        (Alarm.INNOVATION | Alarm.MAF, False),
        (Alarm.MAP, False),
    ],
)
def test_strange_innovations_alone_are_learnt_from_in_the_end(alarms, learns):
    what = reaction(innovation_patience=2.0)
    told = [MonitorState(np.zeros(1), int(alarms), (), False, unnamed) for unnamed in (1.9, 2.1)]
    for state, believed in zip(told, (False, learns), strict=True):
        watch, _ = what.judge(what.start("nothing"), state, 0, 5.0, "now")
        assert watch.learns_from(1) is believed
        assert watch.mode is Mode.DEGRADED


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("safe_share", 0.0), ("safe_share", 1.5), ("reach_events", 0), ("trust_time", 0.0),
        ("kept", 0), ("kept", 1.5), ("speed_tolerance", -0.1), ("speed_events", 0),
        ("highest_acceleration_rpm_s", float("nan")), ("lost_events", 0),
        ("innovation_patience", 0.0),
    ],
)  # fmt: skip
def test_impossible_numbers_are_refused(name, value):
    with pytest.raises(ParameterError, match=name):
        reaction(**{name: value})


def test_names_of_alarms():
    assert Alarm(0).names == ()
    assert (Alarm.MAF | Alarm.INNOVATION).names == ("maf", "innovation")
