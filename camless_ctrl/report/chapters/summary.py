"""Chapter: the verdict and the finding of every chapter."""

from __future__ import annotations

from camless_ctrl.assessment import sentence

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Link, Number, Table, Text


class SummaryChapter:
    """Verdict, what failed, and one sentence from each chapter."""

    id = "summary"
    title = "Summary"
    concludes = True

    def compute(self, context: Context) -> ChapterResult:
        """Gather the others' findings."""
        stated = context.requirements
        broken = [found for found in stated if not found.met]
        failed = [chapter for chapter in context.finished if chapter.error]
        counts = {
            "held": Number(len(stated) - len(broken)),
            "stated": Number(len(stated)),
        }
        if broken or failed:
            names = [sentence(found) for found in broken]
            names += [f"chapter “{chapter.title}” could not be computed" for chapter in failed]
            verdict = Text(
                "Verdict: not all requirements hold, {held:.0f} of {stated:.0f} do. To look at: "
                "{names}.",
                names="; ".join(names),
                **counts,
            )
        else:
            verdict = Text("Verdict: all {stated:.0f} requirements hold.", **counts)
        rows: list[list[Cell]] = [
            [
                Link(chapter.title, chapter.id),
                chapter.error if chapter.result is None else str(chapter.result.finding),
            ]
            for chapter in context.finished
        ]
        return ChapterResult(
            finding=verdict,
            blocks=[
                Text(
                    "The air charge of each cylinder is governed by its intake valve alone: no "
                    "throttle, lift and duration free from event to event. This report shows how "
                    "far a control design for it holds, from the plant it rests on to the closed "
                    "loop."
                ),
                verdict,
                Table(
                    "findings",
                    Text("The finding of each chapter."),
                    [Column("chapter"), Column("finding")],
                    rows,
                ),
            ],
        )
