"""Part of a chapter: the laws that could be used in place of the controller's own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camless_ctrl.gain_synthesis import design_schedule
from camless_ctrl.law_comparison import LawComparison, compare_laws
from camless_ctrl.mu_optimal import mu_optimal_law
from camless_ctrl.robust_analysis import RobustAnalysis
from camless_ctrl.synthesis import SynthesisError
from camless_ctrl.uncertain_loop import adaptation_law

from ..chapter import Context
from ..content import Block, Cell, Column, Figure, Number, Table, Text


def other_laws(context: Context, found: RobustAnalysis, speed_rpm: float) -> list[Block]:
    """Designed gains, and the laws compared at a speed; or why there is none.

    Parameters
    ----------
    context : Context
        Of the report.
    found : RobustAnalysis
        The analysis; its measurements are what the laws are designed for.
    speed_rpm : float
        Speed of the comparison; the first one of the analysis if it is not one of them.
    """
    compared = [m for m in found.measurements if m.speed_rpm == speed_rpm]
    measurement = compared[0] if compared else found.measurements[0]
    own = found.schedule.at(measurement.speed_rpm)
    try:
        design = design_schedule(found.measurements, present=found.schedule, confirm=False)
    except SynthesisError as error:
        return [Text("No other law was found: {reason}", reason=str(error))]
    fastest = next(d for d in design.designs if d.speed_rpm == measurement.speed_rpm).gains
    systems = {
        "own law": adaptation_law(measurement, own),
        "designed gains": adaptation_law(measurement, fastest),
    }
    failed: list[Block] = []
    try:
        synthesised = mu_optimal_law(measurement, fastest, confirm=False)
    except SynthesisError as error:
        failed.append(Text("No law was found by synthesis: {reason}", reason=str(error)))
    else:
        systems[f"{synthesised.method} (LTI)"] = synthesised.system
    laws = compare_laws(measurement, systems, worst_case=False)
    return [
        Text(
            "The same measurement of the controller's estimator, with other laws in place of its "
            "own. Noise of the estimate grows with the gain: the controller's gains weigh it "
            "against what changes, and are far below what robustness allows."
        ),
        Figure(
            "designed-gains",
            Text(
                "Fastest gains with robust performance at each speed (designed), beside those of "
                "the controller's converged law (present). No mode vanishes from the measurement, "
                "so that the differences can be adapted at every speed."
                if not any(d.held for d in design.designs)
                else "Fastest gains with robust performance at each speed (designed), beside those "
                "of the controller's converged law (present). Where the measurement of a mode "
                "vanishes for an engine of the set, the designed law holds the differences."
            ),
            "Gains of mean and imbalance against speed, designed and present.",
            context.draw(design.plot()),
        ),
        _laws(laws),
        Figure(
            "laws",
            Text(
                "Sensitivity of the laws at {laws_speed:.0f}, in the middle of the set and at its "
                "worst.",
                laws_speed=Number(measurement.speed_rpm, "rpm"),
            ),
            "Size of the sensitivity function over the angle per event for each law.",
            context.draw(laws.plot()),
        ),
        *failed,
    ]


def _laws(laws: LawComparison) -> Table:
    rows: list[list[Cell]] = [
        [
            law.name,
            float(law.order),
            law.robust,
            law.mu_performance if np.isfinite(law.mu_performance) else None,
            law.peak,
            law.worst_peak if np.isfinite(law.worst_peak) else None,
            law.disk_margin,
            law.noise,
            _slowest(law.settling_cycles, law.held),
            _slowest(law.worst_settling_cycles, law.held),
        ]
        for law in laws.laws
    ]
    return Table(
        "laws-table",
        Text(
            "Laws at {table_speed:.0f}: the controller's own and the fastest robust integral "
            "corrections, and the faster of H-infinity synthesis and D-K iteration (order "
            "reduced). Mu and the worst case are exact "
            "on a fine grid of angles, not proved between them. Noise is the standard deviation "
            "of the correction for white noise of the estimate; settling is to 2 % of the slowest "
            "adapted mode, in the middle of the set and at the slowest corner.",
            table_speed=Number(laws.measurement.speed_rpm, "rpm"),
        ),
        [
            Column("law"),
            Column("order", "1", ".0f"),
            Column("mu below 1", words=("yes", "no")),
            Column("mu performance", "1", ".3f"),
            Column("|S| middle", "1", ".2f"),
            Column("|S| worst", "1", ".2f"),
            Column("disk margin", "1", ".2f"),
            Column("noise", "1", ".2f"),
            Column("settling", "cycles", ".1f"),
            Column("settling, slowest", "cycles", ".1f"),
        ],
        rows,
    )


def _slowest(cycles: Sequence[float], held: Sequence[bool]) -> float | None:
    """Slowest mode of those that are adapted; None if it never settles."""
    found = max(c for c, kept in zip(cycles, held, strict=True) if not kept)
    return found if np.isfinite(found) else None
