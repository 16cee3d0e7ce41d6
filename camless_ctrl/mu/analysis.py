"""Structured singular value of a system over the frequency.

First the nominal system must be stable: without that mu says nothing. Then come an upper bound
on a grid, a lower bound by search, over the frequency too, and a refinement of the peaks. For
state-space systems it is proved at last that nothing between the frequencies is higher.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import in_range

from ._ascent import Problem
from ._core import Progress, run
from ._response import as_response
from .blocks import BlockStructure
from .lower import standard
from .result import MuResult


def mu_analysis(
    M: Any,
    structure: BlockStructure,
    omega: ArrayLike | None = None,
    *,
    tolerance: float = 0.005,
    gap: float = 0.05,
    stable: bool | None = None,
    dt: float | bool | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> MuResult:
    """Bounds of the structured singular value, and the perturbation that destabilises first.

    Parameters
    ----------
    M : control.StateSpace, control.TransferFunction, control.FRD or callable
        Stable system from what the perturbation gives to what it takes. A callable takes
        frequencies (N,), rad per time unit, and returns matrices (N, outputs, inputs).
    structure : BlockStructure
        Structure of the perturbation.
    omega : array_like, optional
        Frequencies, rad per time unit. A grid from the poles if it is left out; needed for a
        callable.
    tolerance : float
        Relative accuracy of the peak of the upper bound.
    gap : float
        Gap between the bounds at the peak from which the search for a worse perturbation is
        intensified.
    stable : bool, optional
        For frequency data and callables: whether the system is stable, which must be so.
    dt : float or bool, optional
        Sampling time of a callable.
    seed : int
        Seed of the starts of the search.
    progress : callable, optional
        Called with the frequencies done and their number.

    Raises
    ------
    ParameterError
        If the sizes do not fit, or the system is unstable or not known to be stable.
    """
    in_range("tolerance", tolerance, 1e-6, 0.5, "1")
    in_range("gap", gap, 0.0, 1.0, "1")
    response = as_response(M, omega, stable=stable, dt=dt)
    structure.check(response.outputs, response.inputs)
    return run(
        response,
        standard(structure),
        omega,
        tolerance=tolerance,
        gap=gap,
        seed=seed,
        progress=progress,
    )


def skewed_mu(
    M: Any,
    structure: BlockStructure,
    free: str | Iterable[str],
    omega: ArrayLike | None = None,
    *,
    tolerance: float = 0.01,
    gap: float = 0.05,
    stable: bool | None = None,
    dt: float | bool | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> MuResult:
    """Bounds of the skewed structured singular value: some blocks free, the others held at 1.

    ``1/nu`` is the size of the free blocks that is withstood while the others take every value
    of their assumed size. It is infinite if the held blocks destabilise alone.

    Parameters
    ----------
    M, structure, omega, tolerance, gap, stable, dt, seed, progress
        As in `mu_analysis`.
    free : str or iterable of str
        Names of the blocks whose size is sought; at least one, and one other is held.
    """
    in_range("tolerance", tolerance, 1e-6, 0.5, "1")
    in_range("gap", gap, 0.0, 1.0, "1")
    response = as_response(M, omega, stable=stable, dt=dt)
    structure.check(response.outputs, response.inputs)
    names = (free,) if isinstance(free, str) else tuple(free)
    chosen = np.zeros(len(structure), dtype=bool)
    chosen[[structure.index(name) for name in names]] = True
    if chosen.all() or not chosen.any():
        raise ParameterError(
            f"the free blocks are {', '.join(names) or 'none'} of {', '.join(structure.names)}, "
            "but one at least must be free and one held: use mu_analysis if all are free"
        )
    return run(
        response,
        Problem(structure, chosen),
        omega,
        tolerance=tolerance,
        gap=gap,
        seed=seed,
        progress=progress,
    )
