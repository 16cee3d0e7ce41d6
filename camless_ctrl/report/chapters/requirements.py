"""Chapter: every requirement with its bound, its value and its verdict."""

from __future__ import annotations

import math

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Link, Number, Table, Text, printed


class RequirementsChapter:
    """The requirements of all chapters in one table."""

    id = "requirements"
    title = "Requirements"
    concludes = True

    def compute(self, context: Context) -> ChapterResult:
        """Gather the outcomes of the other chapters."""
        rows: list[list[Cell]] = [
            [
                found.requirement.name,
                found.requirement.description + (f"; found {found.note}" if found.note else ""),
                f"{found.requirement.sense} {printed(found.requirement.bound, 'g')}",
                None if math.isnan(found.value) else found.value,
                None if math.isnan(found.margin) else found.margin,
                found.requirement.unit,
                found.met,
                Link(chapter.title, chapter.id),
                found.requirement.source,
            ]
            for chapter in context.finished
            if chapter.result is not None
            for found in chapter.result.requirements
        ]
        met = sum(found.met for found in context.requirements)
        return ChapterResult(
            finding=Text(
                "{held:.0f} of {stated:.0f} requirements hold.",
                held=Number(met),
                stated=Number(len(rows)),
            ),
            blocks=[
                Text(
                    "Each requirement is stated once, with its bound and its source; the chapter "
                    "that it leads to holds the evidence."
                ),
                Table(
                    "all",
                    Text("All requirements."),
                    [
                        Column("requirement"),
                        Column("what is measured"),
                        Column("bound"),
                        Column("value"),
                        Column("margin", spec="+.3g"),
                        Column("unit"),
                        Column("verdict", words=("met", "not met")),
                        Column("evidence"),
                        Column("source"),
                    ],
                    rows,
                ),
            ],
        )
