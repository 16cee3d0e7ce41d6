"""Building the report: chapters in order, then one page and one JSON file."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from plant.errors import ConvergenceError, ParameterError, SimulationError

from ..assessment import sentence
from ..jsonable import to_json
from ..output import reserved_folder
from ..requirements import RequirementResult
from .chapter import Chapter, Context, FinishedChapter, display_order
from .render import document, page, passed

TITLE = "Air-charge control of a camless engine: robustness report"

# What a chapter may run into on an engine that it does not fit. Anything else is a defect.
CHAPTER_ERRORS = (ParameterError, ConvergenceError, SimulationError)

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Report:
    """A built report.

    Attributes
    ----------
    folder : Path
        Where ``index.html`` and ``report.json`` are.
    passed : bool
        Whether every chapter was computed and every requirement holds.
    requirements : tuple of RequirementResult
        All requirements.
    chapters : tuple of FinishedChapter
        In the order of the page.
    document : dict
        The content of ``report.json``.
    """

    folder: Path
    passed: bool
    requirements: tuple[RequirementResult, ...]
    chapters: tuple[FinishedChapter, ...]
    document: dict[str, Any] = field(repr=False)

    @property
    def page(self) -> Path:
        """The HTML page."""
        return self.folder / "index.html"

    @property
    def seconds(self) -> float:
        """Time that the chapters took."""
        return sum(chapter.seconds for chapter in self.chapters)

    def __str__(self) -> str:
        """Return verdict, failures and place."""
        held = sum(found.met for found in self.requirements)
        lines = [
            f"{held} of {len(self.requirements)} requirements hold ({self.seconds:.0f} s)",
            *(f"  not met: {sentence(found)}" for found in self.requirements if not found.met),
            *(f"  failed: chapter {c.title}: {c.error}" for c in self.chapters if c.error),
            f"{self.page}",
        ]
        return "\n".join(lines)


def build_report(
    out: Path,
    *,
    context: Context | None = None,
    chapters: Sequence[Chapter] | None = None,
    title: str = TITLE,
    progress: Progress | None = None,
) -> Report:
    """Compute the chapters and write ``index.html`` and ``report.json`` to a folder.

    A chapter that the engine does not allow is reported as failed and the others are kept.
    Nothing is written unless the whole report is.

    Parameters
    ----------
    out : Path
        The folder; made if need be.
    context : Context, optional
        Engine, seed and command; the paper's engine by default.
    chapters : sequence of Chapter, optional
        The default chapters, unless given.
    title : str
        Title of the page.
    progress : callable, optional
        Told the title of the chapter that begins, its number from 0, and how many there are;
        at the end with an empty title.

    Raises
    ------
    OutputError
        If the folder cannot be written, before any work.
    """
    if chapters is None:
        from .chapters import default_chapters

        chapters = default_chapters()
    ids = [chapter.id for chapter in chapters]
    if len(set(ids)) != len(ids):
        raise ParameterError(f"chapter ids must differ, got {', '.join(ids)}")
    context = context or Context()
    with reserved_folder(Path(out)) as staging:
        queue = sorted(chapters, key=lambda chapter: chapter.concludes)  # stable
        for number, chapter in enumerate(queue):
            if progress is not None:
                progress(chapter.title, number, len(queue))
            context.finished.append(_compute(chapter, context))
        if progress is not None:
            progress("", len(queue), len(queue))
        finished = display_order(chapters, context.finished)
        content = document(context, finished, title)
        (staging / "index.html").write_text(page(context, finished, title), encoding="utf-8")
        (staging / "report.json").write_text(to_json(content), encoding="utf-8")
    return Report(
        folder=Path(out),
        passed=passed(context, finished),
        requirements=tuple(context.requirements),
        chapters=tuple(finished),
        document=content,
    )


def _compute(chapter: Chapter, context: Context) -> FinishedChapter:
    started = time.perf_counter()
    try:
        result, error = chapter.compute(context), ""
    except CHAPTER_ERRORS as failure:
        result, error = None, f"{type(failure).__name__}: {failure}"
    return FinishedChapter(chapter.id, chapter.title, result, time.perf_counter() - started, error)
