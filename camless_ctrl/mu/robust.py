"""Robust stability, nominal and robust performance of a partitioned plant.

The plant takes what the perturbation gives, then disturbances, and gives what the perturbation
takes, then errors. Performance is met if the gain from disturbances to errors is below 1, so
weights belong into the plant. It is robust if mu with one more full block, from the errors to
the disturbances, is below 1 (main loop theorem).
"""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from plant import ParameterError

from ._response import Response, as_response
from .analysis import mu_analysis
from .blocks import BlockStructure, FullBlock
from .result import MuResult

PERFORMANCE = "performance"  # name of the performance block


def robust_stability(
    M: Any, structure: BlockStructure, omega: ArrayLike | None = None, **options: Any
) -> MuResult:
    """Mu of the perturbation alone, whatever the disturbances.

    Parameters
    ----------
    M : control.StateSpace, control.TransferFunction, control.FRD or callable
        Partitioned plant, stable.
    structure : BlockStructure
        Structure of the perturbation; what is left of the signals is performance.
    omega : array_like, optional
        Frequencies, rad per time unit.
    **options
        Of `mu_analysis`.
    """
    response = _response(M, omega, options)
    inner = response.part(slice(structure.inputs), slice(structure.outputs))
    return mu_analysis(inner, structure, omega, **options)


def nominal_performance(
    M: Any, structure: BlockStructure, omega: ArrayLike | None = None, **options: Any
) -> MuResult:
    """Gain from disturbances to errors without perturbation; parameters as `robust_stability`."""
    response = _response(M, omega, options)
    block = performance_block(response, structure)
    outer = response.part(slice(structure.inputs, None), slice(structure.outputs, None))
    return mu_analysis(outer, BlockStructure([block]), omega, **options)


def robust_performance(
    M: Any, structure: BlockStructure, omega: ArrayLike | None = None, **options: Any
) -> MuResult:
    """Mu with the performance block; parameters as `robust_stability`."""
    response = _response(M, omega, options)
    block = performance_block(response, structure)
    return mu_analysis(response, structure.plus(block), omega, **options)


def performance_block(response: Response, structure: BlockStructure) -> FullBlock:
    """Return the full block from the errors to the disturbances."""
    errors = response.outputs - structure.inputs
    disturbances = response.inputs - structure.outputs
    if errors < 1 or disturbances < 1:
        raise ParameterError(
            f"the plant has {response.outputs} outputs and {response.inputs} inputs, of which the "
            f"perturbation takes {structure.inputs} and gives {structure.outputs}: no error or "
            "no disturbance is left"
        )
    return FullBlock(PERFORMANCE, errors, disturbances)


def _response(M: Any, omega: ArrayLike | None, options: dict[str, Any]) -> Response:
    return as_response(M, omega, stable=options.get("stable"), dt=options.get("dt"))
