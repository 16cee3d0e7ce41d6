"""The robustness report: one self-contained page and one JSON file, chapter by chapter."""

from .build import Report, build_report
from .chapter import Chapter, Context, FinishedChapter
from .content import (
    ChapterResult,
    Column,
    Figure,
    Heading,
    Link,
    Number,
    Table,
    Text,
)

__all__ = [
    "Chapter",
    "ChapterResult",
    "Column",
    "Context",
    "Figure",
    "FinishedChapter",
    "Heading",
    "Link",
    "Number",
    "Report",
    "Table",
    "Text",
    "build_report",
]
