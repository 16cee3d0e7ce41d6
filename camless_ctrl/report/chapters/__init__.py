"""The chapters of the report, one file each, in the order of the page."""

from __future__ import annotations

from ..chapter import Chapter
from .closed_loop import ClosedLoopChapter
from .deltas import DeltasChapter
from .engine import EngineChapter
from .estimation import EstimationChapter
from .faults import FaultsChapter
from .feedforward import FeedforwardChapter
from .intake import IntakeChapter
from .maps import MapsChapter
from .performance import PerformanceChapter
from .reproducibility import ReproducibilityChapter
from .requirements import RequirementsChapter
from .robustness import RobustnessChapter
from .scenarios import ScenariosChapter
from .section_six import SectionSixChapter
from .structured import StructuredRobustnessChapter
from .summary import SummaryChapter
from .throttled import ThrottledChapter
from .uncertainty import UncertaintyChapter
from .validation import ValidationChapter


def default_chapters() -> tuple[Chapter, ...]:
    """Return the chapters of the whole report."""
    return (
        SummaryChapter(),
        EngineChapter(),
        ValidationChapter(),
        IntakeChapter(),
        MapsChapter(),
        ThrottledChapter(),
        DeltasChapter(),
        SectionSixChapter(),
        UncertaintyChapter(),
        RobustnessChapter(),
        StructuredRobustnessChapter(),
        FeedforwardChapter(),
        EstimationChapter(),
        ClosedLoopChapter(),
        PerformanceChapter(),
        FaultsChapter(),
        ScenariosChapter(),
        RequirementsChapter(),
        ReproducibilityChapter(),
    )
