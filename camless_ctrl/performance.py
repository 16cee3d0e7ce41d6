"""Performance of controllers on the full plant: every case, every law, many seeds."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import CrankAnglePlant, Engine, ParameterError
from plant._checks import whole

from ._closed_loop_runs import in_processes
from .closed_loop import simulate
from .closed_loop_result import ClosedLoopResult
from .controller import AirChargeController
from .controller_cases import LOSS, PerformanceCase, loss_points, performance_cases
from .controller_design import ControllerDesign
from .loss_reference import LossReference, loss_references

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEEDS = 20
SHOWN = 0.01  # least share of a bar that the picture tells apart
_GROUP = 5  # seeds that are run in one piece

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class PerformanceRow:
    """One figure of one law, over seeds.

    Attributes
    ----------
    case, figure, law : str
        What was run, what was read off it, and the controller's law.
    values : tuple of float
        Figure of each seed, %; NaN where a run had no such figure.
    bar : float
        Bound, %.
    single : bool
        Whether it is of single events under jitter, see `Bar`.
    """

    case: str
    figure: str
    law: str
    values: tuple[float, ...] = field(repr=False)
    bar: float
    single: bool = False

    @property
    def name(self) -> str:
        """Case and figure."""
        return f"{self.case}: {self.figure}"

    @property
    def median(self) -> float:
        """Median over the seeds, %."""
        return statistics.median(self.values)

    @property
    def worst(self) -> float:
        """Largest over the seeds, %; NaN if any is."""
        return float(np.max(self.values))

    @property
    def met(self) -> bool:
        """Whether the worst seed keeps the bar."""
        return bool(self.worst <= self.bar)

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain data."""
        return {
            "name": self.name,
            "law": self.law,
            "median": self.median,
            "worst": self.worst,
            "bar": self.bar,
            "met": self.met,
            "unit": "%",
            "seeds": len(self.values),
        }


@dataclass(frozen=True)
class PerformanceTable:
    """All figures of all laws.

    Attributes
    ----------
    rows : tuple of PerformanceRow
        One for each case, figure and law.
    """

    rows: tuple[PerformanceRow, ...]

    @property
    def laws(self) -> tuple[str, ...]:
        """Laws, in order."""
        return tuple(dict.fromkeys(row.law for row in self.rows))

    def of(self, law: str) -> tuple[PerformanceRow, ...]:
        """Rows of a law."""
        return tuple(row for row in self.rows if row.law == law)

    def by_name(self) -> list[tuple[str, float, list[PerformanceRow | None]]]:
        """Each figure with its bar and the row of each law; None where a law was not run."""
        found: dict[str, dict[str, PerformanceRow]] = {}
        for row in self.rows:
            found.setdefault(row.name, {})[row.law] = row
        return [
            (name, next(iter(rows.values())).bar, [rows.get(law) for law in self.laws])
            for name, rows in found.items()
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return ``{"cases": [...]}`` as plain data."""
        return {"cases": [row.to_dict() for row in self.rows]}

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the worst and the median of every figure over its bar, law by law.

        What is below `SHOWN` of its bar, or below zero, is drawn at `SHOWN`.
        """
        import textwrap

        from plant._plotting import COLOURS, axes, styled

        names = list(dict.fromkeys(row.name for row in self.rows))
        with styled():
            ax = axes(ax, (9.0, 0.5 * len(names) + 1.6))
            for j, law in enumerate(self.laws):
                rows = {row.name: row for row in self.of(law)}
                shift = 0.15 * (j - 0.5 * (len(self.laws) - 1))
                known = [(i + shift, rows[name]) for i, name in enumerate(names) if name in rows]
                for y, row in known:
                    span = [max(v / row.bar, SHOWN) for v in (row.median, row.worst)]
                    ax.plot(span, [y, y], c=COLOURS[j], lw=1.6)
                ax.plot(
                    [max(row.worst / row.bar, SHOWN) for _, row in known],
                    [y for y, _ in known],
                    "o",
                    ms=4,
                    c=COLOURS[j],
                    label=law,
                )
            ax.axvline(1.0, c="0.3", ls="--", lw=1.0)
            ax.set_xscale("log")
            ax.set_xlim(left=0.8 * SHOWN)
            labels = [textwrap.fill(name, 42) for name in names]
            ax.set_yticks(range(len(names)), labels, fontsize=7)
            ax.invert_yaxis()
            ax.set_xlabel("figure over its bar: median to worst seed (dot)")
            ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
        return ax

    def __str__(self) -> str:
        """Return a line for each row."""
        width = max(len(row.name) for row in self.rows)
        law = max(len(name) for name in self.laws)
        return "\n".join(
            f"{row.name:{width}}  {row.law:{law}}  median {row.median:6.2f} %  worst "
            f"{row.worst:6.2f} %  bar {row.bar:g} %  {'met' if row.met else 'NOT MET'}"
            for row in self.rows
        )


@dataclass(frozen=True)
class _Piece:
    """Some seeds of one case with one controller: what another process is sent."""

    engine: Engine
    references: tuple[LossReference, ...]
    case: int
    controller: AirChargeController
    seeds: tuple[int, ...]

    def unpacked(self) -> PerformanceCase:
        """Return the case: its figures are functions, which cannot be sent."""
        return performance_cases(self.engine, self.references)[self.case]


def measure_performance(
    controllers: Mapping[str, AirChargeController],
    design: ControllerDesign,
    *,
    cases: Sequence[str] | None = None,
    seeds: int = SEEDS,
    seed: int = 0,
    processes: int = 2,
    progress: Progress | None = None,
) -> PerformanceTable:
    """Run every case with every controller and many seeds.

    Parameters
    ----------
    controllers : mapping of str to AirChargeController
        Controllers by the name of their law.
    design : ControllerDesign
        Tells the nominal engine of the cases, and the limits of the motions that the least
        pumping loss is sought in.
    cases : sequence of str, optional
        Names of the cases to run; all by default.
    seeds, seed : int
        Number of seeds, and the first of them.
    processes : int
        Processes to run in.
    progress : callable, optional
        Called with the number of pieces done and the number in all.

    Raises
    ------
    ParameterError
        For an unknown case, no controller, or a bad number of seeds.
    """
    whole("seeds", seeds, 1, 100_000)
    base = design.engine
    references: tuple[LossReference, ...] = ()
    if cases is None or any(name.startswith(LOSS) for name in cases):  # some seconds
        plant = CrankAnglePlant(base, runner=True, oscillation=True)
        references = loss_references(plant, loss_points(base), design.path.options)
    known = performance_cases(base, references)
    names = [case.name for case in known]
    wanted = names if cases is None else list(cases)
    unknown = [name for name in wanted if name not in names]
    if unknown or not wanted or not controllers:
        raise ParameterError(
            f"cases are {wanted} of {len(controllers)} controllers: give one or more of {names}, "
            "and one or more controllers"
        )
    groups = [
        tuple(range(seed + k, seed + min(k + _GROUP, seeds))) for k in range(0, seeds, _GROUP)
    ]
    plan = [
        (law, names.index(name), group)
        for name in wanted
        for law in controllers
        for group in groups
    ]
    pieces = [_Piece(base, references, case, controllers[law], group) for law, case, group in plan]
    found = in_processes(_figures, pieces, processes, progress)
    rows = []
    for name in wanted:
        case = known[names.index(name)]
        for k, bar in enumerate(case.bars):
            for law in controllers:
                values = [
                    run[k]
                    for (of, at, _), runs in zip(plan, found, strict=True)
                    if of == law and names[at] == name
                    for run in runs
                ]
                rows.append(
                    PerformanceRow(
                        name,
                        bar.name,
                        law,
                        tuple(100.0 * v for v in values),
                        bar.bound,
                        bar.single,
                    )
                )
    return PerformanceTable(tuple(rows))


def run_case(
    controller: AirChargeController, name: str, *, engine: Engine | None = None, seed: int = 0
) -> ClosedLoopResult:
    """Run one case by its name, once; those of the pumping loss are `measure_performance`'s."""
    known = {case.name: case for case in performance_cases(engine)}
    if name not in known:
        raise ParameterError(f"case is {name!r}, but must be one of {list(known)}")
    return _run(known[name], controller, seed)


def _figures(piece: _Piece) -> list[tuple[float, ...]]:
    """Figures of each seed."""
    case = piece.unpacked()
    runs = [_run(case, piece.controller, seed) for seed in piece.seeds]
    return [tuple(bar.figure(run) for bar in case.bars) for run in runs]


def _run(case: PerformanceCase, controller: AirChargeController, seed: int) -> ClosedLoopResult:
    return simulate(
        case.plant,
        controller,
        case.demand,
        case.speed_rpm,
        valves=case.valves,
        seed=seed,
        name=case.name,
    )
