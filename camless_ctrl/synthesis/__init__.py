"""Controller synthesis for python-control systems, safe to use.

A plant is checked before any solver sees it, solvers run where they can be stopped, and what
they return is verified. The names below are loaded on first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .checks import CheckItem, SynthesisCheck, check_synthesis
    from .dk import dk_synthesis
    from .dk_result import DkIteration, DkResult
    from .errors import SynthesisError
    from .hinf import SynthesisResult, hinf_synthesis
    from .mixed import mixed_sensitivity
    from .mu_bound import MuBound, PerturbationBlock, ScaledBound, scaled_bound
    from .reduction import ClosedLoopCheck, reduce_controller
    from .reduction_result import ReductionResult, ReductionRow
    from .scaling_fit import MinimumPhaseFit, fit_minimum_phase
    from .stoppable import run_stoppable

_HOME = {
    "CheckItem": "checks",
    "ClosedLoopCheck": "reduction",
    "DkIteration": "dk_result",
    "DkResult": "dk_result",
    "MinimumPhaseFit": "scaling_fit",
    "MuBound": "mu_bound",
    "PerturbationBlock": "mu_bound",
    "ReductionResult": "reduction_result",
    "ReductionRow": "reduction_result",
    "ScaledBound": "mu_bound",
    "SynthesisCheck": "checks",
    "SynthesisError": "errors",
    "SynthesisResult": "hinf",
    "check_synthesis": "checks",
    "dk_synthesis": "dk",
    "fit_minimum_phase": "scaling_fit",
    "hinf_synthesis": "hinf",
    "mixed_sensitivity": "mixed",
    "reduce_controller": "reduction",
    "run_stoppable": "stoppable",
    "scaled_bound": "mu_bound",
}

__all__ = [
    "CheckItem",
    "ClosedLoopCheck",
    "DkIteration",
    "DkResult",
    "MinimumPhaseFit",
    "MuBound",
    "PerturbationBlock",
    "ReductionResult",
    "ReductionRow",
    "ScaledBound",
    "SynthesisCheck",
    "SynthesisError",
    "SynthesisResult",
    "check_synthesis",
    "dk_synthesis",
    "fit_minimum_phase",
    "hinf_synthesis",
    "mixed_sensitivity",
    "reduce_controller",
    "run_stoppable",
    "scaled_bound",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
