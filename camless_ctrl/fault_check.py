"""Every kind of fault against the full plant: found or harmless, when, and at what cost in charge.

A run is warmed up, one fault acts for `ACTING` cycles, and some cycles follow; the engine has one
weak cylinder, sensors and valves are the assumed ones. Charge errors are those of single events,
so the jitter of the valves is in them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import CrankAnglePlant
from plant._checks import positive, whole

from ._processes import in_processes
from .alarms import Alarm, Mode
from .closed_loop import ValveErrors, simulate
from .closed_loop_result import ClosedLoopResult
from .controller_cases import JITTER, WEAK_CYLINDER, each_of
from .controller_design import ControllerDesign
from .faults import FAULT_KINDS, Fault

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WARM, ACTING, AFTER = 100, 60, 60  # cycles before, of, and after a fault
SETTLED = 20  # cycles after which the controller is to have adapted to what it has not found
WITHIN = 0.02  # charge error of a cylinder's mean that is harmless, 1
CYLINDER = 2  # of a fault of one valve
_OF_A_VALVE = ("valve-stuck", "valve-lift", "valve-late")
_SLOW = {"maf-drift": 8.0}  # s, faults that take longer to matter

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FaultRow:
    """What one fault did.

    Attributes
    ----------
    fault : Fault
        The fault.
    speed_rpm : float
        Speed.
    alarm : str
        The first alarm; empty if there was none.
    detection_events : float
        Events from its start to that alarm; NaN if there was none.
    mode : Mode
        The most cautious mode that followed.
    before, during, after : float
        Largest charge error of an event before it, while it acted and after it, 1.
    adapted : float
        Largest mean charge error of a cylinder from `SETTLED` cycles on, while it acted, 1.
    recovered : float
        The same of the last `SETTLED` cycles of the run, 1.
    normal_events : float
        Events from its end until the mode was NORMAL for good; NaN if it was not.
    """

    fault: Fault
    speed_rpm: float
    alarm: str
    detection_events: float
    mode: Mode
    before: float
    during: float
    after: float
    adapted: float
    recovered: float
    normal_events: float

    @property
    def detected(self) -> bool:
        """Whether an alarm was raised."""
        return math.isfinite(self.detection_events)

    @property
    def harmless(self) -> bool:
        """Whether the charges of all cylinders stayed, or soon came back, within `WITHIN`."""
        return bool(self.adapted <= WITHIN)

    @property
    def verdict(self) -> str:
        """Found, harmless, or missed."""
        if self.detected:
            return "detected"
        return "harmless" if self.harmless else "MISSED"

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain data."""
        return {
            "fault": self.fault.kind,
            "size": self.fault.size,
            "unit": self.fault.of_kind.unit,
            "speed_rpm": self.speed_rpm,
            "verdict": self.verdict,
            "alarm": self.alarm,
            "detection_events": self.detection_events,
            "mode": self.mode.name,
            "worst_before": self.before,
            "worst_during": self.during,
            "worst_after": self.after,
            "settled_during": self.adapted,
            "settled_after": self.recovered,
            "normal_events": self.normal_events,
        }


@dataclass(frozen=True)
class FaultTable:
    """Every fault at every speed.

    Attributes
    ----------
    rows : tuple of FaultRow
        One for each fault and speed.
    """

    rows: tuple[FaultRow, ...]

    @property
    def missed(self) -> tuple[FaultRow, ...]:
        """Rows that were neither found nor harmless."""
        return tuple(row for row in self.rows if row.verdict == "MISSED")

    def records(self) -> list[dict[str, Any]]:
        """Return the rows as plain data."""
        return [row.to_dict() for row in self.rows]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the largest charge error before, during and after each fault."""
        from plant._plotting import COLOURS, axes, styled

        with styled():
            ax = axes(ax, (8.0, 0.3 * len(self.rows) + 1.4))
            places = np.arange(len(self.rows))
            kinds = (("before", "o", 2), ("during", "s", 1), ("after", "^", 0))
            for name, marker, colour in kinds:
                values = [100.0 * getattr(row, name) for row in self.rows]
                ax.plot(values, places, marker, ms=5, c=COLOURS[colour], label=name)
            for place, row in enumerate(self.rows):
                ax.axhline(place, c="0.9", lw=0.6, zorder=0)
                if not row.detected:
                    ax.plot(100.0 * row.during, place, "o", ms=11, mfc="none", c="0.4")
            ax.set_xscale("log")
            several = len({row.speed_rpm for row in self.rows}) > 1
            names = [
                f"{row.fault.kind}{f', {row.speed_rpm:g} rpm' if several else ''}"
                for row in self.rows
            ]
            ax.set_yticks(places, names)
            ax.invert_yaxis()
            ax.set_xlabel("largest charge error of an event (%); ring: no alarm")
            ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
        return ax

    def __str__(self) -> str:
        """Return a line for each row."""
        lines = []
        for row in self.rows:
            found = (
                f"{row.alarm} after {row.detection_events:.0f} events, {row.mode.name.lower()}"
                if row.detected
                else "no alarm"
            )
            lines.append(
                f"{row.fault.kind:19} {row.speed_rpm:5.0f} rpm  {row.verdict:8} {found:36} charge "
                f"error before {100 * row.before:5.1f}, during {100 * row.during:5.1f} (settled "
                f"{100 * row.adapted:.2f}), after {100 * row.after:5.1f} (settled "
                f"{100 * row.recovered:.2f}) %"
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class _Case:
    """One run, as it is sent to another process."""

    design: ControllerDesign = field(repr=False)
    kind: str
    demand: float  # kg
    speed_rpm: float
    seed: int


def check_faults(
    design: ControllerDesign,
    *,
    points: Sequence[tuple[float, float]] = ((3e-4, 1500.0),),
    kinds: Sequence[str] = tuple(FAULT_KINDS),
    seed: int = 0,
    processes: int = 2,
    progress: Progress | None = None,
) -> FaultTable:
    """Run every kind of fault, of its default size, against the full plant.

    Parameters
    ----------
    design : ControllerDesign
        The controller, and the engine it was made for.
    points : sequence of (float, float)
        Demands in kg and speeds in rpm.
    kinds : sequence of str
        Kinds of faults; all by default.
    seed : int
        Seed of noise and jitter.
    processes : int
        Processes to run in.
    progress : callable, optional
        Called with the number of runs done and the number in all.

    Raises
    ------
    ParameterError
        For an unknown kind, or an operating point that cannot be.
    """
    whole("seed", seed, 0, 2**63 - 1)
    for demand, speed in points:
        positive("demand", demand, "kg")
        positive("speed_rpm", speed, "rpm")
    cases = [_Case(design, kind, *point, seed) for point in points for kind in kinds]
    return FaultTable(tuple(in_processes(_row, cases, processes, progress)))


def _row(case: _Case) -> FaultRow:
    n = case.design.engine.n_cylinders
    event = 120.0 / (n * case.speed_rpm)  # s
    acting = max(ACTING * n, math.ceil(_SLOW.get(case.kind, 0.0) / event))
    first = WARM * n
    last = first + (1 if case.kind == "missed-computation" else acting)
    fault = Fault(
        case.kind,
        first * event,
        (last - 0.5) * event,
        cylinder=CYLINDER if case.kind in _OF_A_VALVE else None,
    )
    engine = case.design.engine.replace(cylinder_flow_factors=each_of(WEAK_CYLINDER, n))
    run = simulate(
        CrankAnglePlant(engine, runner=True, oscillation=True),
        case.design.controller,
        np.full(last + AFTER * n, case.demand),
        case.speed_rpm,
        valves=ValveErrors(0.0, JITTER),
        faults=(fault,),
        seed=case.seed,
        name=case.kind,
    )
    return _judged(run, fault, first, last)


def _judged(run: ClosedLoopResult, fault: Fault, first: int, last: int) -> FaultRow:
    n = run.n_cylinders
    error = run.charge / run.demand - 1.0
    alarms, mode = run.alarms, run.mode
    # A fault of one event is noticed at the next; what stood before is not its.
    new = alarms[first : last + n] & ~alarms[first - 1]
    raised = np.flatnonzero(new)
    alarm, events = "", math.nan
    if raised.size:
        events = float(raised[0])
        alarm = " ".join(Alarm(int(new[raised[0]])).names)
    late = np.flatnonzero(mode[last:] != Mode.NORMAL)
    normal = 0.0 if not late.size else float(late[-1] + 1)
    if normal >= mode.size - last:
        normal = math.nan
    settled = min(first + SETTLED * n, max(first, last - n))
    return FaultRow(
        fault,
        float(run.speed_rpm[0]),
        alarm,
        events,
        Mode(int(mode[first:].max())),
        _largest(error[(WARM // 2) * n : first]),
        _largest(error[first:last]),
        _largest(error[last:]),
        _mean(error[settled:last], n),
        _mean(error[-SETTLED * n :], n),
        normal,
    )


def _largest(error: np.ndarray) -> float:
    return float(np.nanmax(np.abs(error)))


def _mean(error: np.ndarray, n: int) -> float:
    """Largest mean of a cylinder."""
    cycles = error[: error.size // n * n].reshape(-1, n)
    if not cycles.size:
        return math.nan
    return float(np.max(np.abs(np.nanmean(cycles, axis=0))))
