"""Chapter: the controller's performance table, with its baselines."""

from __future__ import annotations

from camless_ctrl.assessment import assess_performance
from camless_ctrl.baselines import ADAPTIVE, FEEDFORWARD, baseline_controllers
from camless_ctrl.performance import PerformanceTable, measure_performance

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Number, Table, Text
from .feedforward import controller_design

SEEDS = 3  # of the report; `camless simulate --bars` runs twenty


class PerformanceChapter:
    """Every case with every law against the full plant."""

    id = "performance"
    title = "Performance on the full plant"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Run the cases."""
        design = controller_design(context)
        table = measure_performance(
            baseline_controllers(design), design, seeds=SEEDS, seed=context.seed
        )
        own, alone = table.of(ADAPTIVE), table.of(FEEDFORWARD)
        missed = [row for row in own if not row.met]
        numbers = {
            "figures": Number(len(own)),
            "met": Number(sum(row.met for row in own)),
            "met_alone": Number(sum(row.met for row in alone)),
            "seeds": Number(SEEDS),
        }
        words = "; ".join(f"{row.name} ({row.worst:.2f} % of {row.bar:g} %)" for row in missed)
        return ChapterResult(
            finding=Text(
                "In its worst of {seeds:.0f} seeds the adaptive controller keeps {met:.0f} of "
                "{figures:.0f} bars; the feedforward alone keeps {met_alone:.0f}.",
                **numbers,
            ),
            blocks=[
                Text(
                    "All laws share the feedforward and the estimator. The least-squares law "
                    "learns flow gains, duration offsets and a charge factor in common, the "
                    "gradient the first two; integral correction moves a charge factor per "
                    "cylinder. (camless simulate --bars adds the LTI law of the robust synthesis, "
                    "and runs twenty seeds.) Noise-averaged figures are means over "
                    "thirty cycles of one run; single events are told as they are, jitter of the "
                    "valve included, which no controller can foresee. Not met: {missed}.",
                    missed=words or "none",
                ),
                _table(table),
                Figure(
                    "performance",
                    Text(
                        "Each figure over its bar, from the median to the worst seed. To the left "
                        "of the line the bar is kept."
                    ),
                    "Figures of every case over their bars, for each law, on a log scale.",
                    context.draw(table.plot()),
                ),
            ],
            numbers=numbers,
            requirements=assess_performance(table, ADAPTIVE),
        )


def _table(table: PerformanceTable) -> Table:
    rows: list[list[Cell]] = [
        [
            name,
            bar,
            *(
                value
                for row in of_laws
                for value in ((row.median, row.worst) if row else (None, None))
            ),
        ]
        for name, bar, of_laws in table.by_name()
    ]
    return Table(
        "bars",
        Text("Median and worst seed of every figure."),
        [
            Column("case"),
            Column("bar", "%", "g"),
            *(
                Column(f"{law}, {which}", "%", ".2f")
                for law in table.laws
                for which in ("median", "worst")
            ),
        ],
        rows,
    )
