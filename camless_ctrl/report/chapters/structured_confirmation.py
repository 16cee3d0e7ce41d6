"""Part of a chapter: what sampled plants and the break of the full plant say of the verdicts."""

from __future__ import annotations

import numpy as np

from camless_ctrl.robust_analysis import RobustAnalysis

from ..chapter import Context
from ..content import Block, Cell, Column, Figure, Number, Table, Text


def sound(found: RobustAnalysis, numbers: dict[str, Number]) -> Text:
    """Return what the samples say of the verdicts; `numbers` are the chapter's."""
    return Text(
        "Sound: {members:.0f} linear members of the sets, half of them at corners, and "
        "{plants:.0f} full plants drawn from the whole set run in closed loop from their own "
        "equilibrium. {member_violations:.0f} and {plant_violations:.0f} are unstable or amplify "
        "an error more than was proved at their speed.",
        **{
            name: numbers[name]
            for name in ("members", "plants", "member_violations", "plant_violations")
        },
    )


def sound_figure(context: Context, found: RobustAnalysis) -> Figure:
    """Return growth on the sampled plants against the prediction."""
    if found.plants is None:
        raise ValueError("the analysis was not confirmed")
    growth = max(s.worst_growth for s in found.plants.runs)
    return Figure(
        "structured-sound",
        Text(
            "Growth per cycle of a small disturbance on the sampled full plants against the radius "
            "that the description predicts for their parameters; the slowest decays with "
            "{growth:.2f} per cycle.",
            growth=Number(growth),
        ),
        "Growth on the full plant against predicted spectral radius, one mark a plant.",
        context.draw(found.plants.plot()),
    )


def tight(found: RobustAnalysis) -> list[Block]:
    """Return the gains at which the loop breaks; nothing if that was not asked for."""
    if not any(s.gain_break or s.untested for s in found.speeds):
        return []
    rows: list[list[Cell]] = []
    for s in found.speeds:
        b = s.gain_break
        rows.append(
            [s.speed_rpm, None, None, None, None, None, None]
            if b is None
            else [
                s.speed_rpm,
                b.predicted,
                b.simulated if np.isfinite(b.simulated) else None,
                b.ratio if np.isfinite(b.ratio) else None,
                b.predicted_turns,
                b.simulated_turns,
                bool(b.tight),
            ]
        )
    return [
        Table(
            "structured-tight",
            Text(
                "Tight: all gains are raised until the loop breaks, in the description and on the "
                "nominal full plant, both with the estimator at work. The loop hardly depends on "
                "the sensor, which is learnt, so that it breaks by its gain. Turns per cycle tell "
                "the mode that breaks."
            ),
            [
                Column("speed", "rpm", ".0f"),
                Column("predicted", "x gains", ".2f"),
                Column("full plant", "x gains", ".2f"),
                Column("ratio", "1", ".3f"),
                Column("turns, predicted", "per cycle", ".2f"),
                Column("turns, full plant", "per cycle", ".2f"),
                Column("within 10 %", words=("yes", "no")),
            ],
            rows,
        )
    ]
