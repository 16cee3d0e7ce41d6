"""Structured singular value: robust stability, robust performance and the worst case.

The names below are loaded on first use, so that an import costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._lft import lft, lft_matrix
    from .analysis import mu_analysis, skewed_mu
    from .blocks import BlockStructure, ComplexBlock, Delta, FullBlock, RealBlock
    from .lower import LowerBound, mu_lower
    from .result import MuResult
    from .robust import nominal_performance, robust_performance, robust_stability
    from .upper import UpperBound, mu_upper
    from .worst_case import WorstCaseGain, worst_case_gain

_HOME = {
    "BlockStructure": "blocks",
    "ComplexBlock": "blocks",
    "Delta": "blocks",
    "FullBlock": "blocks",
    "LowerBound": "lower",
    "MuResult": "result",
    "RealBlock": "blocks",
    "UpperBound": "upper",
    "WorstCaseGain": "worst_case",
    "lft": "_lft",
    "lft_matrix": "_lft",
    "mu_analysis": "analysis",
    "mu_lower": "lower",
    "mu_upper": "upper",
    "nominal_performance": "robust",
    "robust_performance": "robust",
    "robust_stability": "robust",
    "skewed_mu": "analysis",
    "worst_case_gain": "worst_case",
}

__all__ = [
    "BlockStructure",
    "ComplexBlock",
    "Delta",
    "FullBlock",
    "LowerBound",
    "MuResult",
    "RealBlock",
    "UpperBound",
    "WorstCaseGain",
    "lft",
    "lft_matrix",
    "mu_analysis",
    "mu_lower",
    "mu_upper",
    "nominal_performance",
    "robust_performance",
    "robust_stability",
    "skewed_mu",
    "worst_case_gain",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
