"""Chapter: the adaptive controller in closed loop with the full plant."""

from __future__ import annotations

from typing import TYPE_CHECKING

from camless_ctrl.assessment import AFTER_CYCLES, assess_load_step
from camless_ctrl.closed_loop_result import ClosedLoopResult, averaged
from camless_ctrl.controller_cases import JITTER, WEAK_CYLINDER
from camless_ctrl.load_step import run_load_step
from camless_ctrl.requirements import evaluate

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Number, Table, Text
from .feedforward import controller_design

if TYPE_CHECKING:
    from matplotlib.figure import Figure as DrawnFigure

SPEED_RPM = 1500.0
SEEDS = 8  # runs over which noise is averaged out
SETTLED = 0.01  # 1, error of the averaged charge that counts as settled


class ClosedLoopChapter:
    """A load step with one weak cylinder, with adaptation and by feedforward alone."""

    id = "closed-loop"
    title = "Closed loop with the full plant"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Run the load step with and without adaptation."""
        runs = load_steps(context, adapt=True)
        adaptive = averaged(runs)
        alone = averaged(load_steps(context, adapt=False))
        numbers = {
            "error": Number(100.0 * adaptive.worst_error(AFTER_CYCLES), "%"),
            "error_alone": Number(100.0 * alone.worst_error(AFTER_CYCLES), "%"),
            "single": Number(100.0 * max(run.worst_error(AFTER_CYCLES) for run in runs), "%"),
            "under": Number(
                sum(
                    evaluate("imbalance", 100.0 * run.worst_imbalance(AFTER_CYCLES)).met
                    for run in runs
                )
            ),
            "imbalance": Number(100.0 * adaptive.worst_imbalance(AFTER_CYCLES), "%"),
            "imbalance_alone": Number(100.0 * alone.worst_imbalance(AFTER_CYCLES), "%"),
            "limited": Number(int(adaptive.limited.sum())),
        }
        return ChapterResult(
            finding=Text(
                "With one weak cylinder at {speed:.0f} the adaptive controller holds every "
                "cylinder within {error:.2f} of the demand (mean of {seeds:.0f} seeds; one by one "
                "within {single:.2f}, the imbalance under its bound in {under:.0f} of them); the "
                "feedforward alone is off by up to {error_alone:.1f}.",
                speed=Number(SPEED_RPM, "rpm"),
                seeds=Number(len(runs)),
                **numbers,
            ),
            blocks=[
                Text(
                    "The controller is run once per intake event against the full plant, runner "
                    "and actuator oscillation on. It is told the samples of air flow and manifold "
                    "pressure (lag, transport delay, noise, quantisation), the measured valve "
                    "durations and the speed; it knows neither the true charges nor that the flow "
                    "of one cylinder is {weak:.0f} of nominal, and starts unadapted. The valves' "
                    "durations jitter by {jitter:.2f} (1 sigma). What it learns of each cylinder, "
                    "by recursive least squares, is a flow gain and an offset of the delivered "
                    "duration; the feedforward takes the motion of least pumping loss of which "
                    "the model, with these, promises the demand. Demands are {demands} per event "
                    "at {speed:.0f}. The run is repeated with {seeds:.0f} seeds of noise and "
                    "jitter: figures are of one run, errors of their mean unless said otherwise.",
                    jitter=Number(1e3 * JITTER, "ms"),
                    seeds=Number(SEEDS),
                    weak=Number(100.0 * min(WEAK_CYLINDER), "%"),
                    demands=", ".join(f"{1e6 * d:.0f} mg" for d in _demands(adaptive)),
                    speed=Number(SPEED_RPM, "rpm"),
                ),
                _figure(context, runs[0], load_steps(context, adapt=False)[0], numbers),
                _segments(adaptive, alone),
                Text(
                    "After a load step the charge of every cylinder, averaged over five cycles, is "
                    "within {tolerance:.0f} of the demand {settling}. {limited:.0f} demands were "
                    "outside what can be commanded.",
                    tolerance=Number(100.0 * SETTLED, "%"),
                    settling=_settling(adaptive),
                    limited=numbers["limited"],
                ),
                _cylinders(adaptive, alone),
            ],
            numbers=numbers,
            requirements=assess_load_step(runs),
        )


def load_steps(context: Context, *, adapt: bool) -> list[ClosedLoopResult]:
    """Return the load step at the report's seed and the following ones, run once."""

    def make() -> list[ClosedLoopResult]:
        design = controller_design(context)
        controller = design.controller if adapt else design.feedforward_alone()
        return [
            run_load_step(
                controller, engine=context.engine, speed_rpm=SPEED_RPM, seed=context.seed + k
            )
            for k in range(SEEDS)
        ]

    return context.shared(f"load steps, adapt={adapt}", make)


def _settling(result: ClosedLoopResult) -> str:
    cycles = [result.settling_cycles(SETTLED, k) for k in range(1, len(result.segments))]
    known = [count for count in cycles if count is not None]
    if len(known) < len(cycles):
        return "only after more cycles than the run has"
    return f"after {max(known)} cycles" if max(known, default=0) else "from the first cycle on"


def _demands(result: ClosedLoopResult) -> list[float]:
    n = result.n_cylinders
    return [float(result.demand[part.start * n]) for part in result.segments]


def _figure(
    context: Context,
    adaptive: ClosedLoopResult,
    alone: ClosedLoopResult,
    numbers: dict[str, Number],
) -> Figure:
    return Figure(
        "load-step",
        Text(
            "Load step with one weak cylinder at {speed:.0f}: true charge of each cylinder against "
            "demand, and the error of each. The imbalance between cylinders falls from "
            "{imbalance_alone:.1f} (feedforward alone) to {imbalance:.1f}.",
            speed=Number(SPEED_RPM, "rpm"),
            imbalance=numbers["imbalance"],
            imbalance_alone=numbers["imbalance_alone"],
        ),
        "Charge of each cylinder against demand over cycles with adaptation, and below it the "
        "relative error of each cylinder with adaptation and with feedforward alone.",
        context.draw(_draw(adaptive, alone)),
    )


def _draw(adaptive: ClosedLoopResult, alone: ClosedLoopResult) -> DrawnFigure:
    import matplotlib.pyplot as plt
    import numpy as np

    from plant._plotting import styled

    with styled():
        figure, (top, middle, bottom) = plt.subplots(
            3, 1, sharex=True, figsize=(8.6, 7.4), height_ratios=(3, 2, 2)
        )
        adaptive.plot(top)
        top.set_xlabel("")
        for ax, result, name in (
            (middle, adaptive, "error, adaptive (%)"),
            (bottom, alone, "error, feedforward (%)"),
        ):
            error = 100.0 * result.relative_error
            ax.axhline(0.0, c="k", ls="--", lw=1.0)
            for i, column in enumerate(error.T):
                ax.plot(np.arange(error.shape[0]) + i / error.shape[1], column, lw=1.0)
            ax.set_ylabel(name)
        span = 1.2 * max(float(np.nanmax(np.abs(alone.relative_error))) * 100.0, 1.0)
        middle.set_ylim(-span, span)
        bottom.set_ylim(-span, span)
        bottom.set_xlabel("engine cycle")
    return figure


def _segments(adaptive: ClosedLoopResult, alone: ClosedLoopResult) -> Table:
    rows: list[list[Cell]] = []
    for k, demand in enumerate(_demands(adaptive)):
        for name, result in (("adaptive", adaptive), ("feedforward alone", alone)):
            errors = result.cylinder_errors(AFTER_CYCLES, k)
            rows.append(
                [
                    1e6 * demand,
                    name,
                    100.0 * float(max(errors, key=abs)),
                    100.0 * result.imbalance(AFTER_CYCLES, k),
                    result.settling_cycles(SETTLED, k),
                ]
            )
    return Table(
        "segments",
        Text(
            "Each demand, from the tenth cycle on: worst averaged error of a cylinder, imbalance "
            "(largest less smallest over mean), and cycles until all errors, averaged over five "
            "cycles, stay within 1 % (a dash: not within the run)."
        ),
        [
            Column("demand", "mg", ".0f"),
            Column("controller"),
            Column("worst error", "%", "+.2f"),
            Column("imbalance", "%", ".2f"),
            Column("settled after", "cycles", ".0f"),
        ],
        rows,
    )


def _cylinders(adaptive: ClosedLoopResult, alone: ClosedLoopResult) -> Table:
    n = adaptive.n_cylinders
    last = adaptive.cylinder_errors(AFTER_CYCLES), alone.cylinder_errors(AFTER_CYCLES)
    return Table(
        "cylinders",
        Text(
            "The cylinders at the last demand: averaged errors, and what was learnt (mean of the "
            "seeds). With the valve wide open the charge hardly depends on the flow gain, which "
            "is therefore learnt slowly and need not be right for the charge to be."
        ),
        [
            Column("cylinder", "", ".0f"),
            Column("true flow factor", "1", ".2f"),
            Column("error, adaptive", "%", "+.2f"),
            Column("error, feedforward", "%", "+.2f"),
            Column("learnt flow gain", "1", ".3f"),
            Column("learnt offset", "ms", "+.3f"),
        ],
        [
            [
                i + 1,
                WEAK_CYLINDER[i % len(WEAK_CYLINDER)],
                100.0 * float(last[0][i]),
                100.0 * float(last[1][i]),
                float(adaptive.flow_gain[-n:][i]),
                1e3 * float(adaptive.duration_offset[-n:][i]),
            ]
            for i in range(n)
        ],
    )
