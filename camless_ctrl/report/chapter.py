"""What a chapter of the report is, and what chapters share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

from plant import CrankAnglePlant, Engine

from ..requirements import RequirementResult
from .content import ChapterResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as DrawnFigure

T = TypeVar("T")


@runtime_checkable
class Chapter(Protocol):
    """One chapter: computes its content from what the context offers.

    Attributes
    ----------
    id : str
        Anchor and name in the JSON file.
    title : str
        Heading.
    concludes : bool
        Whether the chapter draws on the others' results, and so is computed after them.
    """

    @property
    def id(self) -> str:
        """Anchor and name in the JSON file."""
        ...

    @property
    def title(self) -> str:
        """Heading."""
        ...

    @property
    def concludes(self) -> bool:
        """Whether the chapter draws on the others' results."""
        ...

    def compute(self, context: Context) -> ChapterResult:
        """Compute the chapter."""
        ...


@dataclass(frozen=True)
class FinishedChapter:
    """A chapter as it stands in the report.

    Attributes
    ----------
    id, title : str
        Of the chapter.
    result : ChapterResult or None
        None if it failed.
    seconds : float
        Time it took.
    error : str
        Why it failed; empty if it did not.
    """

    id: str
    title: str
    result: ChapterResult | None
    seconds: float
    error: str = ""


@dataclass
class Context:
    """What the chapters of one report share.

    Attributes
    ----------
    engine : Engine
        The engine reported on.
    seed : int
        Seed of all random work.
    command : str
        Command that makes this report again.
    finished : list of FinishedChapter
        Chapters computed so far.
    """

    engine: Engine = field(default_factory=Engine.paper)
    seed: int = 0
    command: str = ""
    finished: list[FinishedChapter] = field(default_factory=list)
    _shared: dict[str, Any] = field(default_factory=dict, repr=False)

    def shared(self, name: str, make: Callable[[], T]) -> T:
        """Return what `make` returns, computed once under `name` for all chapters."""
        if name not in self._shared:
            self._shared[name] = make()
        return self._shared[name]

    @property
    def plant(self) -> CrankAnglePlant:
        """The full plant, with runners."""
        return self.shared("plant", lambda: CrankAnglePlant(self.engine))

    @property
    def requirements(self) -> list[RequirementResult]:
        """Requirements assessed by the chapters computed so far."""
        return [
            found
            for chapter in self.finished
            if chapter.result is not None
            for found in chapter.result.requirements
        ]

    def draw(self, drawn: DrawnFigure | Axes) -> str:
        """Return a Matplotlib figure (or that of an axes) as SVG for the page, and close it."""
        from .figures import svg

        number = self._shared["figures"] = self._shared.get("figures", 0) + 1
        return svg(drawn, f"f{number}")


def display_order(
    chapters: Sequence[Chapter], finished: Sequence[FinishedChapter]
) -> list[FinishedChapter]:
    """Return finished chapters in the order of `chapters`."""
    place = {chapter.id: k for k, chapter in enumerate(chapters)}
    return sorted(finished, key=lambda done: place[done.id])
