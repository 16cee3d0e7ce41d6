"""Chapter: how wrong the mean-value plant is over frequency, with weights and a guarantee."""

from __future__ import annotations

import numpy as np

from camless_ctrl.assessment import assess_uncertainty
from plant import CrankAnglePlant
from uncertainty.attribution import attribute
from uncertainty.attribution_result import SobolResult
from uncertainty.local_attribution import tornado
from uncertainty.quantification import quantify
from uncertainty.quantification_result import Quantification

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text
from .maps import mean_value_plant

_SHOWN = 3  # parameters of a quantity in the table of indices
_TORNADO_POINT = 1  # of the operating points


def quantification(context: Context) -> Quantification:
    """Return the weights of the context's engine, fitted and checked once."""
    return context.shared(
        "quantification",
        lambda: quantify(
            CrankAnglePlant(context.engine, oscillation=True),
            mean_value_plant(context),
            seed=context.seed,
        ),
    )


class UncertaintyChapter:
    """Weights, coverage and attribution of the uncertainty of the mean-value plant."""

    id = "uncertainty"
    title = "Uncertainty for robust control"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Quantify the uncertainty and attribute it."""
        found = quantification(context)
        plant = CrankAnglePlant(context.engine, oscillation=True)
        sobol = attribute(plant, seed=context.seed)
        check = found.coverage
        charge = [c for c in found.channels if c.channel.output == "air_charge"]
        readings = [c for c in found.channels if c.channel.output == "maf"]
        numbers = {
            "weights": Number(len(found.channels)),
            "plants": Number(found.design + found.calibration + found.fresh),
            "design": Number(found.design),
            "calibration": Number(found.calibration),
            "fresh": Number(check.fresh_samples),
            "inside": Number(check.fresh_inside),
            "share": Number(100.0 * check.bound.share, "%"),
            "confidence": Number(100.0 * check.bound.confidence, "%"),
            "charge_peak": Number(100.0 * max(c.peak for c in charge), "%"),
            "maf_peak": Number(100.0 * max(c.peak for c in readings), "%"),
            "own": Number(100.0 * max(c.reduction_error for c in found.channels), "%"),
            "scale": Number(found.scale),
        }
        return ChapterResult(
            finding=Text(
                "Weights of up to {charge_peak:.0f} on the charge and {maf_peak:.0f} on its "
                "measurement cover at least {share:.0f} of the assumed set with "
                "{confidence:.0f} confidence; {inside:.0f} of {fresh:.0f} fresh full plants lie "
                "within them. Of the uncertainty, the reduction itself is at most {own:.1f}.",
                **numbers,
            ),
            blocks=[
                Text(
                    "A change of one valve's duration is followed through full plants, event by "
                    "event, at {points:.0f} operating points: what it does to the charge of each "
                    "event, and to what the air-flow sensor shows of it. Equal cylinders split "
                    "into circulant modes: the mean (q = 0) and the imbalances (q = 1 once per "
                    "cycle, q = 2 alternating). A residual is the distance of a plant from the "
                    "mean-value plant, in units of the mean-value plant's change of charge. What "
                    "the sensor should show of that change is computed with the flow shape of the "
                    "nominal full plant; an even flow over the event would be further off. "
                    "{parameters:.0f} parameters vary at once, each uniformly between bounds that "
                    "are assumed.",
                    points=Number(len(found.points)),
                    parameters=Number(len(found.uncertain)),
                ),
                Text(
                    "{design:.0f} plants (low-discrepancy points, and each parameter at both "
                    "bounds) shape the weights; {calibration:.0f} independent ones set one factor "
                    "on all of them, {scale:.2f}, such that the claim holds; {fresh:.0f} more, "
                    "never seen by either, check it.",
                    **numbers,
                ),
                _weights(context, found),
                _table(found),
                Heading("Guarantee"),
                _coverage(context, found),
                Heading("Attribution"),
                _sobol_figure(context, sobol),
                _sobol_table(sobol),
                _tornado(context, plant),
            ],
            numbers=numbers,
            requirements=assess_uncertainty(found),
        )


def _weights(context: Context, found: Quantification) -> Figure:
    readings = [c for c in found.channels if c.channel.output == "maf"]
    worst = max(readings, key=lambda c: c.peak)
    return Figure(
        "uncertainty-weights",
        Text(
            "The measurement of the charge: the residual of the nominal full plant (dotted) is "
            "small beside that of the sample (dashed), which the weight (line) bounds. Largest "
            "is {peak:.0f} of the charge, in mode q = {peak_mode:.0f} at {peak_speed:.0f}.",
            peak=Number(100.0 * worst.peak, "%"),
            peak_mode=Number(worst.channel.mode),
            peak_speed=Number(worst.channel.point.speed_rpm, "rpm"),
        ),
        "Residuals and weights against cycle phase, a row an operating point, a column a mode.",
        context.draw(found.plot("maf")),
    )


def _table(found: Quantification) -> Table:
    rows: list[list[Cell]] = [
        [
            c.channel.name,
            float(c.weight.order),
            100.0 * c.peak,
            c.check.min_ratio,
            c.check.max_ratio,
            100.0 * c.reduction_error,
            100.0 * found.scale * c.recentred_radius,
        ]
        for c in found.channels
    ]
    return Table(
        "uncertainty-weights-table",
        Text(
            "Weights: order, largest magnitude, and least and largest ratio to the residual of the "
            "design sample on a grid eight times finer than that of the fit; the share of it that "
            "the reduction itself is; and what would be left about the best centre at each "
            "frequency, with the same factor, if the nominal plant were re-centred there."
        ),
        [
            Column("channel"),
            Column("order", "1", ".0f"),
            Column("largest weight", "%", ".1f"),
            Column("least ratio", "1", ".3f"),
            Column("largest ratio", "1", ".2f"),
            Column("reduction", "%", ".2f"),
            Column("re-centred", "%", ".1f"),
        ],
        rows,
    )


def _coverage(context: Context, found: Quantification) -> Figure:
    check = found.coverage
    return Figure(
        "uncertainty-coverage",
        Text(
            "The score of a plant is its largest residual over the weight, over all channels and "
            "phases, before the factor. {inside:.0f} of {fresh:.0f} fresh plants are within the "
            "bound, {observed:.1f}; {claim:.0f} are claimed, and the exact interval is "
            "{low:.1f} to {high:.1f}. The share is one of the assumed box, under a uniform "
            "density: it says nothing about an engine outside of it.",
            inside=Number(check.fresh_inside),
            fresh=Number(check.fresh_samples),
            observed=Number(100.0 * check.observed, "%"),
            claim=Number(100.0 * check.bound.share, "%"),
            low=Number(100.0 * check.low, "%"),
            high=Number(100.0 * check.high, "%"),
        ),
        "Share of calibration and fresh plants within a score, with the bound and the claim.",
        context.draw(check.plot()),
    )


def _sobol_figure(context: Context, sobol: SobolResult) -> Figure:
    first = sobol.largest("charge", _TORNADO_POINT, 1)[0]
    gain = sobol.largest("loop_gain", _TORNADO_POINT, 1)[0]
    point = sobol.points[_TORNADO_POINT]
    return Figure(
        "uncertainty-sobol",
        Text(
            "Sobol' indices of the charge. At {speed:.0f} its spread is {spread:.1f} (1 sigma), of "
            "which {first} explains {index:.0f}; of the loop gain's {gain_spread:.1f}, {gain} "
            "explains {gain_index:.0f}. Each interval has {index_confidence:.0f} confidence.",
            speed=Number(point.speed_rpm, "rpm"),
            spread=Number(100.0 * sobol.relative_std("charge", _TORNADO_POINT), "%"),
            first=first.parameter,
            index=Number(100.0 * first.total, "%"),
            gain_spread=Number(100.0 * sobol.relative_std("loop_gain", _TORNADO_POINT), "%"),
            gain=gain.parameter,
            gain_index=Number(100.0 * gain.total, "%"),
            index_confidence=Number(100.0 * sobol.confidence, "%"),
        ),
        "First-order and total Sobol' indices of the charge with intervals, a panel an operating "
        "point.",
        context.draw(sobol.plot("charge")),
    )


def _sobol_table(sobol: SobolResult) -> Table:
    rows: list[list[Cell]] = []
    for quantity in sobol.quantities:
        for k, point in enumerate(sobol.points):
            spread = float(sobol.dataset["std"].sel(quantity=quantity).isel(point=k))
            if quantity != "imbalance":
                spread = sobol.relative_std(quantity, k)
            named = "; ".join(str(index) for index in sobol.largest(quantity, k, _SHOWN))
            rows.append([quantity.replace("_", " "), point.speed_rpm, 100.0 * spread, named])
    return Table(
        "uncertainty-attribution",
        Text(
            "What explains the spread (1 sigma; of the mean, but for the imbalance) at the "
            "operating points: the largest total Sobol' indices with their intervals. Widest "
            "half-interval: {width:.2f}. Imbalance indices are those of a group: the parameters "
            "of one kind in all cylinders.",
            width=Number(sobol.half_width("total")),
        ),
        [
            Column("quantity"),
            Column("speed", "rpm", ".0f"),
            Column("spread", "%", ".1f"),
            Column("explained by"),
        ],
        rows,
    )


def _tornado(context: Context, plant: CrankAnglePlant) -> Figure:
    swings = tornado(plant)
    bars = swings.bars("charge", _TORNADO_POINT)
    point = swings.points[_TORNADO_POINT]
    total = float(np.sqrt(sum(bar.swing**2 for bar in bars)))
    return Figure(
        "uncertainty-tornado",
        Text(
            "Change of the charge at {speed:.0f} with one parameter at a bound: {first} moves it "
            "by {swing:.1f} from bound to bound, all parameters by {total:.1f} as the root of the "
            "sum of squares.",
            speed=Number(point.speed_rpm, "rpm"),
            first=bars[0].parameter,
            swing=Number(100.0 * bars[0].swing, "%"),
            total=Number(100.0 * total, "%"),
        ),
        "Bars of the change of charge at the lower and upper bound of each parameter, largest "
        "first.",
        context.draw(swings.plot("charge", _TORNADO_POINT)),
    )
