"""Order reduction of a controller, judged by the loop that it closes.

Every order is tried by balanced truncation and by singular perturbation of the stable part;
modes on or outside the stability boundary are kept as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant._checks import in_range, whole
from plant.errors import ParameterError

from ._realisation import Realisation, close, hinf_norm, is_stable, realisation_of
from ._truncation import reductions_of
from .errors import SynthesisError
from .hinf import closed_loop_of, state_space
from .reduction_result import ReductionResult, ReductionRow
from .stoppable import run_stoppable

if TYPE_CHECKING:
    import control

_BOUNDARY = 1e-8  # modes this near the stability boundary are kept (relative, continuous)


@dataclass(frozen=True)
class ClosedLoopCheck:
    """What a controller is judged by: the stability of its loop, and a measure of it.

    Parameters
    ----------
    stable : callable
        Whether the loop with a controller is stable.
    measure : callable
        Measure of the loop with a stabilising controller; smaller is better.
    name : str
        Name of the measure for words and figures.
    """

    stable: Callable[[control.StateSpace], bool]
    measure: Callable[[control.StateSpace], float]
    name: str = "measure"

    @classmethod
    def of_plant(
        cls,
        P: control.StateSpace | control.TransferFunction,
        n_meas: int,
        n_ctrl: int,
        measure: Callable[[control.StateSpace], float] | None = None,
        name: str = "closed-loop H-infinity norm",
    ) -> ClosedLoopCheck:
        """Return the check of a generalised plant.

        Parameters
        ----------
        P : control.StateSpace or control.TransferFunction
            Generalised plant.
        n_meas, n_ctrl : int
            Numbers of measurements and of controls.
        measure : callable, optional
            Measure of the closed loop, a system from disturbances to errors (its peak of mu,
            say); the H-infinity norm if left out.
        name : str
            Name of the measure.
        """
        import control

        n_meas, n_ctrl = whole("n_meas", n_meas, 1, 1000), whole("n_ctrl", n_ctrl, 1, 1000)
        plant = state_space(P)
        discrete = bool(control.isdtime(plant, strict=True))
        matrices = realisation_of(plant)

        def loop(K: control.StateSpace) -> Realisation:
            if K.nstates and K.dt != plant.dt:
                raise ParameterError(
                    f"the controller has the sampling time {K.dt}, but the plant has {plant.dt}"
                )
            return close(matrices, realisation_of(K), n_meas, n_ctrl)

        def value(K: control.StateSpace) -> float:
            if measure is None:
                return hinf_norm(loop(K), discrete)
            return float(measure(closed_loop_of(loop(K), plant, n_meas, n_ctrl)))

        return cls(lambda K: is_stable(loop(K).A, discrete), value, name)


def reduce_controller(
    K: control.StateSpace | control.TransferFunction,
    closed_loop_check: ClosedLoopCheck,
    tolerance: float = 0.05,
    *,
    timeout_s: float = 30.0,
) -> ReductionResult:
    """Reduce a controller to the lowest order whose loop is nearly as good.

    Every order from the number of kept modes up is tried with both methods. A controller
    whose loop is not stable is never returned.

    Parameters
    ----------
    K : control.StateSpace or control.TransferFunction
        Controller, continuous or discrete.
    closed_loop_check : ClosedLoopCheck
        Judge of its loop.
    tolerance : float
        Relative rise of the measure that is allowed, 1.
    timeout_s : float
        Time limit of the truncations, s.

    Raises
    ------
    SynthesisError
        If the full controller's loop is not stable, or its measure is not finite.
    """
    import control

    tolerance = in_range("tolerance", tolerance, 0.0, 1e6, "1")
    full = state_space(K, "the controller")
    if not closed_loop_check.stable(full):
        raise SynthesisError("the loop with the full controller is not stable: nothing to keep")
    reference = float(closed_loop_check.measure(full))
    if not math.isfinite(reference):
        raise SynthesisError(
            f"the {closed_loop_check.name} of the full controller is {reference}, not finite"
        )
    bound = reference + tolerance * abs(reference)
    matrices = realisation_of(full)
    discrete = bool(control.isdtime(full, strict=True))
    scale = float(np.abs(np.linalg.eigvals(matrices.A)).max(initial=0.0))
    alpha = 1.0 - _BOUNDARY if discrete else -_BOUNDARY * scale
    reductions = run_stoppable(reductions_of, (matrices, discrete, alpha), timeout_s)
    table: list[ReductionRow] = []
    candidates: dict[int, control.StateSpace] = {}
    for order in range(reductions.kept, full.nstates):
        trials = []
        for method, reduced in reductions.of_order(order):
            trial = _system(reduced, full)
            stable = closed_loop_check.stable(trial)
            value = float(closed_loop_check.measure(trial)) if stable else math.inf
            stable = stable and math.isfinite(value)
            value = value if stable else math.inf
            trials.append((ReductionRow(order, method, stable, value, value <= bound), trial))
        if trials:
            row, candidates[order] = min(trials, key=lambda pair: pair[0].measure)
            table.append(row)
    table.append(ReductionRow(full.nstates, "none", True, reference, True))
    candidates[full.nstates] = full
    chosen = next(row for row in table if row.within)
    return ReductionResult(
        candidates[chosen.order],
        chosen.order,
        chosen.measure,
        reference,
        full.nstates,
        reductions.kept,
        tolerance,
        tuple(table),
        reductions.hankel,
        closed_loop_check.name,
    )


def _system(reduced: Realisation, full: control.StateSpace) -> control.StateSpace:
    """Reduced controller with the names and the sampling time of the full one."""
    import control

    return control.ss(
        *reduced, full.dt, inputs=full.input_labels, outputs=full.output_labels, name=full.name
    )
