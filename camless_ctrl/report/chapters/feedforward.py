"""Chapter: the motion of least pumping loss, checked by direct search on the full plant."""

from __future__ import annotations

import numpy as np

from camless_ctrl.assessment import assess_feedforward
from camless_ctrl.controller_design import ControllerDesign, design_controller
from camless_ctrl.feedforward_check import check_feedforward, saving
from plant import CrankAnglePlant, PumpingComparison, ThrottledMeanValuePlant

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Number, Table, Text

POINTS = 50
SPEEDS_RPM = (750.0, 1500.0, 3000.0, 6000.0)
_SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)  # of the charges that both engines give


def controller_design(context: Context) -> ControllerDesign:
    """Return the controller of the context's engine, made once."""
    return context.shared("controller", lambda: design_controller(context.engine))


def throttled_plant(context: Context) -> ThrottledMeanValuePlant:
    """Return the throttled engine's mean-value plant, fitted once."""
    return context.shared(
        "throttled",
        lambda: ThrottledMeanValuePlant.fit(
            CrankAnglePlant(context.engine, profile="conventional")
        ),
    )


class FeedforwardChapter:
    """Path of optimal motions, its certificates, its check and its saving."""

    id = "feedforward"
    title = "Feedforward: the motion of least pumping loss"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Find the path, check it on the full plant, and compare it with the throttled engine."""
        design = controller_design(context)
        path, options = design.path, design.path.options
        full = CrankAnglePlant(context.engine, runner=True, oscillation=True)
        check = check_feedforward(path, full, points=POINTS, seed=context.seed)
        gained = saving(path, full, throttled_plant(context), speeds_rpm=SPEEDS_RPM)
        share = 100.0 * gained.data["saving"].to_numpy()
        numbers = {
            "worst": Number(100.0 * check.worst, "%"),
            "median": Number(100.0 * check.median, "%"),
            "points": Number(check.excess.size),
            "least_saving": Number(float(np.nanmin(share)), "%"),
            "most_saving": Number(float(np.nanmax(share)), "%"),
        }
        return ChapterResult(
            finding=Text(
                "At {points:.0f} random demands and speeds the path's pumping loss on the full "
                "plant is at most {worst:.2f} above the best that a direct search finds at the "
                "same charge (median {median:.2f}); against the throttled engine it saves "
                "{least_saving:.0f} to {most_saving:.0f}.",
                **numbers,
            ),
            blocks=[
                Text(
                    "For every demand and speed the feedforward takes the lift and duration of "
                    "least pumping loss on the maps of the full plant, runner and actuator "
                    "oscillation on: lift {low:.2g} to {high:.2g}, profiles that the valve can "
                    "drive, durations up to {longest:.0f}, on the branch on which the charge "
                    "rises with the duration. Each node is solved to a local optimum by an "
                    "interior-point method, which certifies it; among local optima, those are "
                    "joined that keep the path free of jumps. The law of the second part of the "
                    "paper is not public: this is the project's own.",
                    low=Number(options.lowest_lift_mm, "mm"),
                    high=Number(options.highest_lift_mm, "mm"),
                    longest=Number(options.longest_duration_deg, "°"),
                ),
                Text("{path}.", path=str(path)),
                Text(
                    "Where two optima change places at light load, a path without jumps must "
                    "cross the ridge between them: {over:.0f} of {nodes:.0f} nodes give up more "
                    "than 1 % of loss, {most:.1f} at most. Points in that strip can miss the bar "
                    "of the check below.",
                    over=Number(int((path.certificates.given_up > 0.01).sum())),
                    nodes=Number(path.certificates.given_up.size),
                    most=Number(100.0 * float(path.certificates.given_up.max()), "%"),
                ),
                Figure(
                    "optimal-lift",
                    Text(
                        "Lift of least pumping loss. The valve is opened as far as it can over "
                        "most of the range; less where short events leave no time for it."
                    ),
                    "Lift against charge at several speeds.",
                    context.draw(path.plot_lift(speeds_rpm=SPEEDS_RPM)),
                ),
                Figure(
                    "optimal-duration",
                    Text("Duration that gives the charge at that lift; the valve closes early."),
                    "Duration against charge at several speeds.",
                    context.draw(path.plot_duration(speeds_rpm=SPEEDS_RPM)),
                ),
                Figure(
                    "feedforward-check",
                    Text(
                        "Loss on the full plant above the best of a direct search at the same "
                        "charge: {worst:.2f} at most.",
                        worst=numbers["worst"],
                    ),
                    "Points over speed and charge, coloured by the loss above the best found.",
                    context.draw(check.plot()),
                ),
                _saving(gained),
            ],
            numbers=numbers,
            requirements=assess_feedforward(check),
        )


def _saving(gained: PumpingComparison) -> Table:
    """Saving at shares of the charges that both engines give, speed by speed."""
    data = gained.data
    charge = data["charge"].to_numpy()
    rows: list[list[Cell]] = []
    for speed in data["speed_rpm"].to_numpy():
        at = data.sel(speed_rpm=speed)
        known = np.flatnonzero(np.isfinite(at["saving"].to_numpy()))
        for share in _SHARES:
            k = known[round(share * (known.size - 1))]
            rows.append(
                [
                    float(speed),
                    1e6 * float(charge[k]),
                    float(at["lift_mm"][k]),
                    float(at["duration_deg"][k]),
                    float(at["throttle_deg"][k]),
                    float(at["camless_loss"][k]),
                    float(at["throttled_loss"][k]),
                    100.0 * float(at["saving"][k]),
                ]
            )
    return Table(
        "saving",
        Text("Pumping loss per event of the path on the full plant and of the throttled engine."),
        [
            Column("speed", "rpm", ".0f"),
            Column("charge", "mg", ".0f"),
            Column("lift", "mm", ".2f"),
            Column("duration", "°", ".0f"),
            Column("throttle", "°", ".1f"),
            Column("loss, path", "J", ".2f"),
            Column("loss, throttled", "J", ".2f"),
            Column("saving", "%", ".0f"),
        ],
        rows,
    )
