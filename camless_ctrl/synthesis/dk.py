"""D-K iteration: synthesis for robust performance with structured uncertainty.

Skogestad and Postlethwaite, *Multivariable Feedback Control*, 8.12. An H-infinity controller
(K step) alternates with scalings that make the closed loop look smallest (D step). Each step
is optimal by itself, the pair need not be: the best iterate is kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant._checks import in_range, whole
from plant.errors import ParameterError

from ._dk_steps import UNITY, MuOverFrequency, fitted_scalings, mu_over_frequency, scaled_plant
from ._realisation import (
    FloatArray,
    Realisation,
    close,
    is_stable,
    realisation_of,
    to_continuous,
    to_discrete,
)
from .checks import check_realisation
from .dk_result import DkIteration, DkResult
from .errors import SynthesisError
from .hinf import closed_loop_of, controller_of, solved, state_space
from .mu_bound import Blocks, MuBound, Structure, structure_of
from .scaling_fit import MinimumPhaseFit

if TYPE_CHECKING:
    import control

_LEAST_GAIN = 1e-3  # of the peak of mu, relative: less ends the iteration
_SMALL_GAIN = 1e-2  # less calls for scalings of the full order


def dk_synthesis(
    P: control.StateSpace | control.TransferFunction,
    structure: Blocks,
    n_meas: int,
    n_ctrl: int,
    *,
    iterations: int = 5,
    order: int | Sequence[int] = 4,
    frequency: ArrayLike | None = None,
    scalings: MuBound | None = None,
    timeout_s: float = 30.0,
    tolerance: float = 1e-3,
    progress: Callable[[int, int], None] | None = None,
) -> DkResult:
    """Search the controller with the least peak of the structured singular value.

    Parameters
    ----------
    P : control.StateSpace or control.TransferFunction
        Generalised plant, continuous or discrete. Inputs: those that the blocks drive, in
        order, then the `n_ctrl` controls; outputs: those that feed the blocks, in order, then
        the `n_meas` measurements.
    structure : sequence
        Full complex blocks, the last one for performance: `PerturbationBlock`, the size of a
        square block, or a pair of inputs and outputs of the block. Real parameters count as
        complex ones, repeated ones as full blocks.
    n_meas, n_ctrl : int
        Numbers of measurements and of controls.
    iterations : int
        Most iterations, from 1.
    order : int or sequence of int
        Highest order of the fitted scalings, for all blocks or for each but the last (whose
        scaling is 1); a lower one is taken where it fits as well, while the gain is large.
    frequency : array_like, optional
        Grid for mu, rad/s, above zero and below the Nyquist frequency; from the poles of the
        loop if left out.
    scalings : callable, optional
        Other source of the scalings, see `MuBound`.
    timeout_s : float
        Time limit of each K step, s.
    tolerance : float
        Relative distance of each K step to its least norm.
    progress : callable, optional
        Called with the iterations done and their largest number.

    Raises
    ------
    SynthesisError
        If the plant fails a condition, or the first K step fails.
    ParameterError
        If sizes do not fit, or an argument has no meaning.
    """
    import control

    start = time.perf_counter()
    n_meas, n_ctrl = whole("n_meas", n_meas, 1, 1000), whole("n_ctrl", n_ctrl, 1, 1000)
    iterations = whole("iterations", iterations, 1, 100)
    tolerance = in_range("tolerance", tolerance, 1e-8, 0.5, "1")
    plant = state_space(P)
    blocks = structure_of(structure)
    size = (sum(b.inputs for b in blocks) + n_meas, sum(b.outputs for b in blocks) + n_ctrl)
    if (plant.noutputs, plant.ninputs) != size:
        raise ParameterError(
            f"the plant is {plant.noutputs} x {plant.ninputs}, but the structure with n_meas and "
            f"n_ctrl asks for {size[0]} x {size[1]}: correct the blocks"
        )
    orders = _orders(order, len(blocks) - 1)
    discrete = bool(control.isdtime(plant, strict=True))
    original = realisation_of(plant)
    check = check_realisation(
        original, n_meas, n_ctrl, discrete, plant.input_labels, plant.output_labels
    )
    check.require()
    T = 1.0 if plant.dt in (True, None) else float(plant.dt)
    grid = None if frequency is None else _grid(frequency, np.pi / T if discrete else np.inf)
    if grid is not None and discrete:
        grid = np.tan(0.5 * T * grid)
    task = _Task(original, discrete, blocks, n_meas, n_ctrl, grid, scalings, tolerance, timeout_s)

    def in_rad_per_s(omega: FloatArray | float) -> FloatArray:
        return np.asarray(2.0 / T * np.arctan(omega) if discrete else omega, dtype=float)

    fits = (UNITY,) * len(blocks)
    history: list[DkIteration] = []
    best: _Iterate | None = None
    stopped = f"{iterations} iterations were asked for"
    fully = False  # whether scalings of the full order are fitted
    for number in range(1, iterations + 1):
        try:
            iterate = task.k_step(fits)
        except (SynthesisError, ParameterError) as error:
            if best is None:
                raise
            stopped = f"the K step of iteration {number} failed: {error}"
            break
        gain = np.inf if best is None else 1.0 - iterate.mu.peak / best.mu.peak
        if best is None or gain > 0.0:
            best = iterate
        used = tuple(fit.order for fit in fits)
        loss = float("nan")
        no_gain = gain < _LEAST_GAIN and (fully or used[:-1] == orders)
        if number < iterations and len(blocks) > 1 and not no_gain:
            fully = fully or gain < _SMALL_GAIN
            fits, loss = fitted_scalings(best.mu, blocks, (*orders, 0), fully)
        history.append(
            DkIteration(
                number,
                iterate.norm,
                iterate.mu.peak,
                float(in_rad_per_s(iterate.mu.peak_frequency)),
                iterate.controller.order,
                used,
                loss,
            )
        )
        if progress is not None:
            progress(number, iterations)
        if len(blocks) == 1:
            stopped = "a single block needs no scaling"
            break
        if no_gain:
            stopped = f"iteration {number} brought no gain"
            break
    if best is None:  # the loop runs at least once, and raises if its first step fails
        raise AssertionError("no iteration was made")
    return DkResult(
        controller_of(best.controller, plant, n_meas, n_ctrl),
        best.mu.peak,
        float(in_rad_per_s(best.mu.peak_frequency)),
        closed_loop_of(best.loop, plant, n_meas, n_ctrl),
        in_rad_per_s(best.mu.frequency),
        best.mu.bound.values,
        best.mu.bound.scalings,
        tuple(history),
        blocks,
        stopped,
        check,
        time.perf_counter() - start,
    )


@dataclass(frozen=True)
class _Iterate:
    """Controller of a K step, the unscaled loop with it, its mu, the norm of the scaled loop."""

    controller: Realisation
    loop: Realisation
    mu: MuOverFrequency
    norm: float


@dataclass(frozen=True)
class _Task:
    """What stays the same in all iterations."""

    plant: Realisation
    discrete: bool
    blocks: Structure
    n_meas: int
    n_ctrl: int
    grid: FloatArray | None
    scalings: MuBound | None
    tolerance: float
    timeout_s: float

    def k_step(self, fits: tuple[MinimumPhaseFit, ...]) -> _Iterate:
        """Controller for given scalings, and what it does without them."""
        sizes = (self.n_meas, self.n_ctrl)
        problem = to_continuous(self.plant) if self.discrete else self.plant
        scaled = scaled_plant(problem, fits, self.blocks)
        step = solved(scaled, *sizes, False, self.tolerance, self.timeout_s)
        controller = to_discrete(step.controller) if self.discrete else step.controller
        loop = close(self.plant, controller, *sizes)
        if not is_stable(loop.A, self.discrete):
            raise SynthesisError(
                "the controller does not stabilise the unscaled plant: the problem is "
                "ill-conditioned; scale the signals to about 1"
            )
        seen = to_continuous(loop) if self.discrete else loop
        mu = mu_over_frequency(seen, self.blocks, self.scalings, self.grid)
        return _Iterate(controller, loop, mu, step.norm)


def _orders(order: int | Sequence[int], blocks: int) -> tuple[int, ...]:
    """Highest order of each fitted scaling."""
    if isinstance(order, Sequence):
        if len(order) != blocks:
            raise ParameterError(
                f"order has {len(order)} entries, but must have {blocks}: one for each block but "
                "the last"
            )
        return tuple(whole("order", k, 0, 8) for k in order)
    return (whole("order", order, 0, 8),) * blocks


def _grid(frequency: ArrayLike, nyquist: float) -> FloatArray:
    grid = np.asarray(frequency, dtype=float)
    if grid.ndim != 1 or len(grid) < 20 or not np.all((grid > 0.0) & (grid < nyquist)):
        raise ParameterError(
            "frequency must hold at least 20 values above zero"
            + (f" and below the Nyquist frequency {nyquist:g} rad/s" if nyquist < np.inf else "")
        )
    if np.any(np.diff(grid) <= 0.0):
        raise ParameterError("frequency must rise: sort it and drop equal values")
    return grid
