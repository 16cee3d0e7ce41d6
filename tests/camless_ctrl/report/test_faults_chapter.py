import math

import matplotlib
import pytest

from camless_ctrl.alarms import Mode
from camless_ctrl.false_alarms import FalseAlarmCount
from camless_ctrl.fault_check import FaultRow, FaultTable
from camless_ctrl.faults import Fault
from camless_ctrl.report.chapter import Context
from camless_ctrl.report.chapters import faults as chapter
from camless_ctrl.report.content import Figure, Table, Text

matplotlib.use("agg")

NAN = math.nan
ROWS = (
    # alarm, events, mode; before, during, after; settled during and after; to normal
    FaultRow(Fault("maf-drift", 2.0, 6.0), 1500.0, "maf", 44.0, Mode.DEGRADED,
             0.024, 0.125, 0.023, 0.0086, 0.0013, 30.0),
    FaultRow(Fault("valve-lift", 2.0, 3.2, cylinder=2), 1500.0, "", NAN, Mode.NORMAL,
             0.024, 0.095, 0.098, 0.0061, 0.0015, 0.0),
    FaultRow(Fault("valve-stuck", 2.0, 3.2, cylinder=2), 1500.0, "valve", 8.0, Mode.DEGRADED,
             0.024, 1.0, 0.022, 1.0, 0.0014, 12.0),
    FaultRow(Fault("missed-computation", 2.0, 2.01), 1500.0, "clock", 1.0, Mode.DEGRADED,
             0.024, 0.003, 0.016, NAN, 0.0011, 5.0),
)  # fmt: skip
MISSED = FaultRow(Fault("map-offset", 2.0, 3.2), 1500.0, "", NAN, Mode.NORMAL,
                  0.024, 0.06, 0.05, 0.031, 0.0015, 0.0)  # fmt: skip


@pytest.fixture
def told(monkeypatch):
    """Chapter of given rows and of given events with an alarm."""

    def compute(rows, alarms=0):
        by_name = {"maf": alarms} if alarms else {}
        free = FalseAlarmCount(10_000, 40_000, 40, alarms, by_name, (7,) if alarms else ())
        monkeypatch.setattr(chapter, "check_faults", lambda design, **how: FaultTable(rows))
        monkeypatch.setattr(chapter, "check_false_alarms", lambda design, **how: free)
        context = Context()
        context.shared("controller", lambda: None)
        return chapter.FaultsChapter().compute(context)

    return compute


def words(content):
    return " ".join(str(block) for block in content.blocks if isinstance(block, Text))


def test_it_says_what_is_harmless_and_what_a_valve_costs(told):
    content = told(ROWS)
    assert str(content.finding).startswith(
        "Of 4 kinds of faults 3 raise an alarm; harmless without one: 1, missed: 0. With one "
        "sensor at fault no charge is more than 12.5\N{NO-BREAK SPACE}% off."
    )
    text = words(content)
    assert "harmless at this speed: valve-lift (up to 9.5 % in an event, 0.61 % in the" in text
    assert "Largest errors of an event: valve-stuck 100 %, valve-lift 9.5 %." in text
    assert "this project's own: none is published" in text
    assert "Missed" not in text
    assert "10000 fault-free cycles in 40 runs: no alarm." in text
    assert all(found.met for found in content.requirements)


def test_it_says_what_is_missed_and_what_is_alarmed_for_nothing(told):
    content = told((*ROWS, MISSED), alarms=3)
    text = words(content)
    assert "Missed, neither found nor harmless: map-offset (up to 6 % in an event, 3.1 %" in text
    assert "3 events with an alarm (maf 3)" in text
    unmet = {found.requirement.name for found in content.requirements if not found.met}
    assert unmet == {"faults-missed", "false-alarms"}


def test_the_table_has_a_row_for_each_fault_and_dashes_for_what_is_not_known(told):
    (table,) = [block for block in told(ROWS).blocks if isinstance(block, Table)]
    shown = [
        [table.shown(column, cell) for column, cell in zip(table.columns, row, strict=True)]
        for row in table.rows
    ]
    assert shown[0] == ["maf-drift", "0.002 kg/s per s", "detected", "maf", "44", "degraded",
                        "2.4", "12.5", "2.3", "0.86", "0.13", "30"]  # fmt: skip
    assert shown[1][:6] == ["valve-lift", "0.4", "harmless", "–", "–", "normal"]
    assert shown[3][1] == "–"  # it has no size
    assert shown[3][9] == "–"  # one event: nothing settles


def test_the_figure_holds_no_bitmap(told):
    (figure,) = [block for block in told(ROWS).blocks if isinstance(block, Figure)]
    assert "<image" not in figure.svg
    assert figure.alt
