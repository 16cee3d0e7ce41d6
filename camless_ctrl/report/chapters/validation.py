"""Chapter: the full plant against every published figure and claim."""

from __future__ import annotations

from camless_ctrl.assessment import assess_validation
from plant.validation import FIGURE_BAR, ValidationReport, validate

from ..chapter import Context
from ..content import (
    ChapterResult,
    Column,
    Figure,
    Heading,
    Number,
    Table,
    Text,
)

_WORDS = ("reproduced", "not reproduced")


class ValidationChapter:
    """Published figures and claims, each computed and judged."""

    id = "validation"
    title = "Validation against the published engine"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Run the validation on the context's engine."""
        report = context.shared("validation", lambda: validate(context.engine))
        can_be_met = [row for row in report.figures if not row.known_exception]
        worst = max(can_be_met, key=lambda row: abs(row.relative_error))
        claims_met = sum(claim.reproduced for claim in report.claims)
        numbers = {
            "rms": Number(100.0 * report.rms, "%"),
            "worst": Number(100.0 * abs(worst.relative_error), "%"),
            "figures_met": Number(sum(row.reproduced for row in report.figures)),
            "figures_all": Number(len(report.figures)),
            "claims_met": Number(claims_met),
            "claims_all": Number(len(report.claims)),
        }
        return ChapterResult(
            finding=Text(
                "{figures_met:.0f} of {figures_all:.0f} published figures are met within "
                "{bar:.0f} (rms {rms:.2f} over those that can be), and {claims_met:.0f} of "
                "{claims_all:.0f} published claims are reproduced; each of the others stands with "
                "its reason.",
                bar=Number(100.0 * FIGURE_BAR, "%"),
                **numbers,
            ),
            blocks=[
                Text(
                    "Every figure and every claim printed in Part I is computed here by "
                    "simulation. What is not reproduced is not left out: its row gives the reason."
                ),
                Heading("Published figures"),
                self._figure(context, report, numbers),
                _figures(report),
                Heading("Published claims"),
                _claims(report),
            ],
            numbers=numbers,
            requirements=assess_validation(report),
        )

    @staticmethod
    def _figure(context: Context, report: ValidationReport, numbers: dict[str, Number]) -> Figure:
        return Figure(
            "errors",
            Text(
                "Relative errors of the published figures. Those that can be met are met with "
                "{rms:.2f} rms and {worst:.1f} at worst; with the printed temperature all of them "
                "miss to the same side.",
                rms=numbers["rms"],
                worst=numbers["worst"],
            ),
            "Relative error of every published charge and loss as a dot, with the two-percent "
            "band, for the identified and for the printed temperature.",
            context.draw(report.plot()),
        )


def _figures(report: ValidationReport) -> Table:
    return Table(
        "figures",
        Text("Published figures of the model, and the experimental engine's where it is printed."),
        [
            Column("point"),
            Column("quantity"),
            Column("unit"),
            Column("published"),
            Column("computed"),
            Column("error", "%", "+.2f"),
            Column("measured engine"),
            Column("verdict", words=_WORDS),
            Column("remark"),
        ],
        [
            [
                row.id,
                row.quantity.replace("_", " "),
                row.unit,
                row.published,
                row.computed,
                100.0 * row.relative_error,
                row.measured,
                row.reproduced,
                row.note,
            ]
            for row in report.figures
        ],
    )


def _claims(report: ValidationReport) -> Table:
    return Table(
        "claims",
        Text("Published claims, and what simulation says to them."),
        [
            Column("claim"),
            Column("section"),
            Column("verdict", words=_WORDS),
            Column("finding"),
        ],
        [[claim.text, claim.section, claim.reproduced, claim.why] for claim in report.claims],
    )
