"""The report as one HTML page and as one JSON document."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from ..assessment import as_dict
from ..jsonable import jsonable
from .chapter import Context, FinishedChapter
from .content import Figure, Table

if TYPE_CHECKING:
    from jinja2 import Environment

FORMAT = "camless-ctrl report 1"


def page(context: Context, chapters: Sequence[FinishedChapter], title: str) -> str:
    """Return the self-contained HTML page."""
    return (
        environment()
        .get_template("report.html.j2")
        .render(title=title, chapters=chapters, passed=passed(context, chapters))
    )


def document(context: Context, chapters: Sequence[FinishedChapter], title: str) -> dict[str, Any]:
    """Return every number of the report with its unit, ready for JSON."""
    return jsonable(
        {
            "format": FORMAT,
            "title": title,
            "passed": passed(context, chapters),
            "engine": context.engine,
            "plant_fingerprint": context.plant.fingerprint,
            "seed": context.seed,
            "command": context.command,
            "requirements": [as_dict(found) for found in context.requirements],
            "chapters": [_chapter(chapter) for chapter in chapters],
        }
    )


def passed(context: Context, chapters: Sequence[FinishedChapter]) -> bool:
    """Whether every chapter was computed and every requirement holds."""
    return all(not chapter.error for chapter in chapters) and all(
        found.met for found in context.requirements
    )


@cache
def environment() -> Environment:
    """The template environment; it escapes everything but the package's own SVG."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("camless_ctrl.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _chapter(chapter: FinishedChapter) -> dict[str, Any]:
    base: dict[str, Any] = {
        "id": chapter.id,
        "title": chapter.title,
        "seconds": chapter.seconds,
        "error": chapter.error,
    }
    result = chapter.result
    if result is None:
        return base
    return base | {
        "finding": str(result.finding),
        "numbers": {
            name: {"value": number.value, "unit": number.unit}
            for name, number in result.all_numbers.items()
        },
        "tables": [block.to_dict() for block in result.blocks if isinstance(block, Table)],
        "figures": [
            {"id": block.id, "caption": str(block.caption)}
            for block in result.blocks
            if isinstance(block, Figure)
        ],
        "requirements": [as_dict(found) for found in result.requirements],
    }
