"""Chapter: every kind of fault against the full plant, and fault-free operation."""

from __future__ import annotations

import math
from collections.abc import Iterable

from camless_ctrl.assessment import assess_false_alarms, assess_faults, of_sensors
from camless_ctrl.false_alarms import check_false_alarms
from camless_ctrl.fault_check import (
    ACTING,
    AFTER,
    SETTLED,
    WITHIN,
    FaultRow,
    FaultTable,
    check_faults,
)

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text
from .feedforward import controller_design

SPEED_RPM = 1500.0
CHARGE_KG = 3e-4


class FaultsChapter:
    """Faults: found or harmless, when, and at what cost in charge; false alarms."""

    id = "faults"
    title = "Faults and what the controller does about them"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Run every kind of fault, and operation without any."""
        design = controller_design(context)
        table = check_faults(design, points=((CHARGE_KG, SPEED_RPM),), seed=context.seed)
        free = check_false_alarms(design, seed=context.seed)
        sensors = of_sensors(table.rows)
        detected = [row for row in table.rows if row.detected]
        harmless = [row for row in table.rows if row.verdict == "harmless"]
        numbers = {
            "kinds": Number(len(table.rows)),
            "detected": Number(len(detected)),
            "harmless": Number(len(harmless)),
            "missed": Number(len(table.missed)),
            "sensor_error": Number(100.0 * max(row.during for row in sensors), "%"),
            "cycles": Number(free.cycles),
            "alarms": Number(free.alarms),
        }
        return ChapterResult(
            finding=Text(
                "Of {kinds:.0f} kinds of faults {detected:.0f} raise an alarm; harmless without "
                "one: {harmless:.0f}, missed: {missed:.0f}. With one sensor at fault no charge is "
                "more than {sensor_error:.1f} off. Events with an alarm in {cycles:.0f} "
                "fault-free cycles: {alarms:.0f}.",
                **numbers,
            ),
            blocks=[
                Text(
                    "Monitors hold sensors, valves and clock against each other and against what "
                    "the charge model promises. One source that is not believed is done without, "
                    "nothing is learnt meanwhile, and what may have been learnt from the fault is "
                    "taken back (degraded). Of a valve alone its own cylinder is not learnt from. "
                    "With two sources that are not believed, or half of "
                    "the valves suspect, the demand is limited as well (safe). Sizes of the "
                    "faults, thresholds of the monitors and what counts as harmless are this "
                    "project's own: none is published."
                ),
                Text(
                    "Each run: {demand:.0f} at {speed:.0f}, one weak cylinder, assumed sensors and "
                    "valves; one fault, of its default size, acts for {acting:.0f} cycles or, if "
                    "it grows slowly, longer; {after:.0f} cycles follow. Errors are those of "
                    "single events, so the jitter of the valves is in them (before the fault it is "
                    "up to {before:.1f}). Harmless: the mean charge of every cylinder is within "
                    "{within:.0f} from {settled:.0f} cycles after the start of the fault on.",
                    demand=Number(1e6 * CHARGE_KG, "mg"),
                    speed=Number(SPEED_RPM, "rpm"),
                    acting=Number(ACTING),
                    after=Number(AFTER),
                    before=Number(100.0 * max(row.before for row in table.rows), "%"),
                    within=Number(100.0 * WITHIN, "%"),
                    settled=Number(SETTLED),
                ),
                Text("{said}", said=_costs(table)),
                _table(table),
                Figure(
                    "errors",
                    Text("Largest charge error of an event before, during and after each fault."),
                    "For each kind of fault three marks on a log scale of the charge error; a ring "
                    "marks faults without an alarm.",
                    context.draw(table.plot()),
                ),
                Heading("Operation without faults"),
                Text(
                    "{runs:.0f} runs from a cold start: engines whose flow, density and altitude, "
                    "and sensors and valves whose errors, are sampled within the assumed "
                    "tolerances; demands step or ramp, speeds ramp. {found}.",
                    runs=Number(free.runs),
                    found=str(free),
                ),
            ],
            numbers=numbers,
            requirements=[*assess_faults(table), *assess_false_alarms(free)],
        )


def _costs(table: FaultTable) -> str:
    """Say what is harmless, what is missed, and what faults of valves cost."""
    said = []
    harmless = [row for row in table.rows if row.verdict == "harmless"]
    if harmless:
        said.append(f"Without an alarm, but harmless at this speed: {_listed(harmless)}.")
        if any(row.fault.of_kind.target == "valve" for row in harmless):
            said.append(
                "A valve that gives another charge than it should is adapted to, as a weak "
                "cylinder is; at higher speeds, where the charge depends more on the flow, the "
                "same fault may cost more."
            )
    if table.missed:
        said.append(f"Missed, neither found nor harmless: {_listed(table.missed)}.")
    valves = [row for row in table.rows if row.fault.of_kind.target == "valve"]
    costly = sorted((row for row in valves if row.during > WITHIN), key=lambda row: -row.during)
    if costly:
        words = ", ".join(f"{row.fault.kind} {100.0 * row.during:.3g} %" for row in costly)
        said.append(
            "A fault of a valve costs charge whatever the controller does: a valve that is stuck "
            "takes in nothing, and the alarm does not bring it back. Largest errors of an event: "
            f"{words}."
        )
    return " ".join(said)


def _listed(rows: Iterable[FaultRow]) -> str:
    return ", ".join(
        f"{row.fault.kind} (up to {100.0 * row.during:.3g} % in an event, "
        f"{100.0 * row.adapted:.2g} % in the mean once settled)"
        for row in rows
    )


def _table(table: FaultTable) -> Table:
    rows: list[list[Cell]] = [
        [
            row.fault.kind,
            _size(row),
            row.verdict,
            row.alarm or None,
            _number(row.detection_events),
            row.mode.name.lower(),
            *(100.0 * value for value in (row.before, row.during, row.after)),
            _number(100.0 * row.adapted),
            _number(100.0 * row.recovered),
            _number(row.normal_events),
        ]
        for row in table.rows
    ]
    return Table(
        "faults",
        Text(
            "Each fault: the first alarm and when it came, the most cautious mode, and the largest "
            "charge error of an event before, during and after it. Settled: largest mean error of "
            "a cylinder, from {settled:.0f} cycles after the start and in the last {settled:.0f}.",
            settled=Number(SETTLED),
        ),
        [
            Column("fault"),
            Column("size"),
            Column("verdict"),
            Column("first alarm"),
            Column("detection", "events", ".0f"),
            Column("mode"),
            Column("before", "%", ".1f"),
            Column("during", "%", ".1f"),
            Column("after", "%", ".1f"),
            Column("settled, during", "%", ".2f"),
            Column("settled, after", "%", ".2f"),
            Column("to normal", "events", ".0f"),
        ],
        rows,
    )


def _size(row: FaultRow) -> str | None:
    size, kind = row.fault.size, row.fault.of_kind
    if math.isnan(size):
        return None
    return f"{size:g} {kind.unit}" if kind.unit != "1" else f"{size:g}"


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
