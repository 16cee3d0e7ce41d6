"""Chapter: section 6 of the paper, its Figures 11 to 14 drawn again from simulation."""

from __future__ import annotations

from uncertainty.section_six import figure_11, figure_12, figure_13, figure_14
from uncertainty.section_six_result import SectionSixFigure

from ..chapter import Context
from ..content import Block, Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text

_WORDS = ("confirmed", "not confirmed")
_ALT = {
    "Figure 11": "Air charge, pumping loss and specific loss against lift and against closing "
    "timing at 1500 rpm: the curves with and without runner all but coincide.",
    "Figure 12": "Air charge, pumping loss and specific loss against lift and against closing "
    "timing at 6000 rpm, with and without runner, and the timings that cannot be driven.",
    "Figure 13": "Cylinder pressure against volume for early, middle and late closing, one below "
    "the other, with and without runner.",
    "Figure 14": "Air charge, pumping loss and specific loss against speed with the simplified "
    "and the oscillating valve motion, and the change from one to the other in per cent.",
}


class SectionSixChapter:
    """Runner and valve oscillation: the paper's figures and statements, computed and judged."""

    id = "section-six"
    title = "Section 6 redrawn"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Draw Figures 11 to 14 for the context's engine and judge what the paper says of them."""
        slow, fast = figure_11(context.engine), figure_12(context.engine)
        loops, motions = figure_13(context.engine), figure_14(context.engine)
        figures: tuple[SectionSixFigure, ...] = (slow, fast, loops, motions)
        judged = [claim for figure in figures for claim in figure.claims if claim.holds is not None]
        numbers = {
            "held": Number(sum(bool(claim.holds) for claim in judged)),
            "judged": Number(len(judged)),
            "slow_charge": _per_cent(slow.claim("small-charge").value),
            "fast_charge": _per_cent(fast.claim("considerable").value),
            "late_specific_loss": _per_cent(fast.claim("late-specific-loss").value),
            "oscillation_charge": _per_cent(motions.claim("neglect-charge").value),
        }
        blocks: list[Block] = [
            Text(
                "Section 6 of the paper asks what a mean-value model loses by leaving out the "
                "resonance of the runners and the oscillation of the valves. Its four figures are "
                "computed here by the full plant. A closing timing is where the seating begins, "
                "as in section 3.1: the duration is the closing timing and the time that the valve "
                "takes to seat. The paper prints neither the lift nor the closing timing that "
                "Figures 11 to 13 hold constant; those assumed stand in the captions."
            ),
            Heading("Runner (section 6.1)"),
            *(_figure(context, figure) for figure in (slow, fast, loops)),
            Heading("Valve oscillation (section 6.2)"),
            _figure(context, motions),
            Heading("What the paper says, judged"),
            _claims(figures),
        ]
        return ChapterResult(
            finding=Text(
                "{held:.0f} of {judged:.0f} checks confirm what section 6 says: the runner "
                "changes the charge by up to {slow_charge:.1f} at 1500 rpm and up to "
                "{fast_charge:.0f} at 6000 rpm, the valve oscillation by up to "
                "{oscillation_charge:.1f}; for late closing at 6000 rpm the runner changes the "
                "specific pumping loss by up to {late_specific_loss:+.0f}, where the paper sees "
                "no adverse effect.",
                **numbers,
            ),
            blocks=blocks,
            numbers=numbers,
        )


def _per_cent(fraction: float) -> Number:
    return Number(100.0 * fraction, "%")


def _figure(context: Context, figure: SectionSixFigure) -> Figure:
    id = figure.name.lower().replace(" ", "_")
    words = figure.words.prefixed(f"{id}_")
    return Figure(
        id.replace("_", "-"),
        Text(
            f"{figure.name} of the paper. {words.template}",
            **{
                name: Number(value.value, "°" if value.unit == "deg" else value.unit)
                for name, value in words.values.items()
            },
        ),
        _ALT[figure.name],
        context.draw(figure.plot()),
    )


def _claims(figures: tuple[SectionSixFigure, ...]) -> Table:
    rows: list[list[Cell]] = [
        [
            figure.name,
            claim.text,
            claim.measured,
            None if claim.holds is None else 100.0 * claim.value,
            f"{claim.kind} {100.0 * claim.bound:g} %, {claim.basis}",
            claim.holds,
        ]
        for figure in figures
        for claim in figure.claims
    ]
    return Table(
        "statements",
        Text(
            "Statements of section 6 (the paper's words in quotation marks), each with the number "
            "that decides it. The paper prints no bounds; those used are given with their reason."
        ),
        [
            Column("figure"),
            Column("statement"),
            Column("compared"),
            Column("value", "%", "+.2f"),
            Column("bound"),
            Column("verdict", words=_WORDS),
        ],
        rows,
    )
