"""The table of all faults: verdicts by hand, and a short run of it."""

import json
import math

import numpy as np
import pytest

from camless_ctrl import fault_check
from camless_ctrl.alarms import Alarm, Mode
from camless_ctrl.closed_loop_result import ClosedLoopResult
from camless_ctrl.fault_check import FaultRow, FaultTable, check_faults
from camless_ctrl.faults import Fault
from plant.errors import ParameterError

N, EVENT = 4, 0.02
WARM, SETTLED = fault_check.WARM * N, fault_check.SETTLED * N


def row(detection=math.nan, adapted=0.01, kind="maf-nan", alarm=""):
    return FaultRow(
        Fault(kind, 1.0, 2.0), 1500.0, alarm, detection, Mode.NORMAL,
        0.01, 0.05, 0.02, adapted, 0.005, 0.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("detection", "adapted", "verdict"),
    [
        (3.0, 0.5, "detected"),
        (0.0, 0.0, "detected"),
        (math.nan, 0.02, "harmless"),
        (math.nan, 0.0201, "MISSED"),
        (math.nan, math.nan, "MISSED"),  # nothing is known of it
    ],
)
def test_a_fault_is_found_or_harmless_or_missed(detection, adapted, verdict):
    found = row(detection, adapted)
    assert found.verdict == verdict
    assert found.detected == (verdict == "detected")


def test_the_table_tells_what_was_missed():
    rows = (row(1.0, 0.5, alarm="maf"), row(adapted=0.3, kind="valve-lift"), row())
    table = FaultTable(rows)
    assert table.missed == (rows[1],)
    lines = str(table).splitlines()
    assert [("detected" in x, "MISSED" in x, "harmless" in x) for x in lines] == [
        (True, False, False), (False, True, False), (False, False, True),
    ]  # fmt: skip
    assert "maf after 1 events" in lines[0]
    told = json.loads(json.dumps(table.records()))
    assert [r["verdict"] for r in told] == ["detected", "MISSED", "harmless"]
    assert told[1]["settled_during"] == 0.3


def test_the_picture_names_every_fault():
    plt = pytest.importorskip("matplotlib.pyplot")
    ax = FaultTable((row(), row(2.0, kind="valve-lift", alarm="valve"))).plot()
    assert [x.get_text() for x in ax.get_yticklabels()] == ["maf-nan", "valve-lift"]
    assert ax.get_xscale() == "log"
    plt.close(ax.figure)


# -- what is read off a run ------------------------------------------------------------------

ACTING, AFTER = 100, 200  # events


def result(errors, alarms=(), modes=()):
    """Run with given charge errors; alarms and modes are (first, last, value) of events."""
    m = WARM + ACTING + AFTER
    demand, zero = np.full(m, 3e-4), np.zeros(m)
    charge = demand * (1.0 + errors(np.arange(m)))
    said = {"alarms": np.zeros(m, dtype=int), "mode": np.zeros(m, dtype=int)}
    for name, parts in (("alarms", alarms), ("mode", modes)):
        for first, last, value in parts:
            said[name][first:last] = int(value)
    return ClosedLoopResult(
        name="by hand", n_cylinders=N, seed=0, time=EVENT * np.arange(m),
        cylinder=np.arange(m) % N + 1, speed_rpm=np.full(m, 1500.0), demand=demand, charge=charge,
        estimate=charge, estimate_sigma=zero, pumping_loss=zero, lift_mm=zero, duration_deg=zero,
        flow_gain=zero, duration_offset=zero, charge_factor=zero, limited=zero.astype(bool),
        adapted=zero.astype(bool), **said,
    )  # fmt: skip


def judged(run):
    fault = Fault("maf-nan", WARM * EVENT, (WARM + ACTING) * EVENT)
    return fault_check._judged(run, fault, WARM, WARM + ACTING)


def test_errors_of_each_span_are_the_largest_of_their_events():
    def errors(k):
        error = np.zeros(k.size)
        error[10] = 0.9  # before the controller has learnt: of no account
        error[WARM - 1], error[WARM], error[WARM + ACTING - 1] = 0.03, -0.2, 0.09
        error[WARM + ACTING], error[-1] = -0.07, 0.01
        return error

    found = judged(result(errors))
    assert found.before == pytest.approx(0.03)
    assert found.during == pytest.approx(0.2)
    assert found.after == pytest.approx(0.07)
    # Means of a cylinder: one of 5 events is off by 0.09, or one of 20 by 0.01
    assert found.adapted == pytest.approx(0.09 / ((ACTING - SETTLED) / N))
    assert found.recovered == pytest.approx(0.01 / fault_check.SETTLED)
    assert not found.detected
    assert found.verdict == "harmless"  # the mean is within 2 %
    assert (found.mode, found.normal_events) == (Mode.NORMAL, 0.0)


def test_errors_of_cylinders_do_not_cancel():
    found = judged(result(lambda k: np.where(k % N == 1, 0.06, np.where(k % N == 2, -0.06, 0.0))))
    assert found.adapted == pytest.approx(0.06)
    assert found.verdict == "MISSED"


def test_charges_that_are_not_known_are_left_out():
    def errors(k):
        return np.where(k == k.size - 1, math.nan, 0.01)

    found = judged(result(errors))
    assert found.after == pytest.approx(0.01)
    assert found.recovered == pytest.approx(0.01)


def test_the_first_alarm_counts_and_the_most_cautious_mode():
    end = WARM + ACTING
    found = judged(
        result(
            np.zeros_like,
            [
                (WARM + 7, WARM + 9, Alarm.INNOVATION),
                (WARM + 9, end + 5, Alarm.MAF | Alarm.INNOVATION),
            ],
            [(WARM + 7, end + 30, Mode.DEGRADED), (WARM + 40, WARM + 50, Mode.SAFE)],
        )
    )
    assert (found.alarm, found.detection_events) == ("innovation", 7.0)
    assert found.mode is Mode.SAFE
    assert found.normal_events == 30.0
    assert found.verdict == "detected"


def test_a_mode_that_never_ends_is_told():
    end = WARM + ACTING + AFTER
    found = judged(result(np.zeros_like, [(WARM, end, 1)], [(WARM, end, Mode.DEGRADED)]))
    assert math.isnan(found.normal_events)


# -- runs ------------------------------------------------------------------------------------


def test_some_faults_against_the_plant(narrow_design):
    told = []
    table = check_faults(
        narrow_design,
        kinds=("map-nan", "valve-lift", "missed-computation"),
        processes=1,
        progress=lambda done, total: told.append((done, total)),
    )
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert [r.fault.kind for r in table.rows] == ["map-nan", "valve-lift", "missed-computation"]
    assert not table.missed
    nan, lift, missed = table.rows
    assert (nan.alarm, nan.mode) == ("map", Mode.DEGRADED)
    assert nan.detection_events <= 5
    assert (missed.alarm, missed.detection_events) == ("clock", 1.0)
    assert (lift.fault.cylinder, nan.fault.cylinder) == (fault_check.CYLINDER, None)
    for found in table.rows:
        # 100 cycles of warming up, at 80 ms each
        assert found.fault.start == pytest.approx(8.0)
        assert found.before < 0.05
        assert found.recovered < 0.01
        assert math.isfinite(found.normal_events)


@pytest.mark.parametrize(
    "options",
    [
        {"kinds": ("maf-broken",)},
        {"points": ((-1e-4, 1500.0),)},
        {"points": ((3e-4, 0.0),)},
        {"seed": -1},
        {"processes": 0},
    ],
)
def test_impossible_checks_are_refused(narrow_design, options):
    with pytest.raises(ParameterError):
        check_faults(narrow_design, **{"processes": 1, "kinds": ("map-nan",), **options})
