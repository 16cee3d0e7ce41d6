"""Largest gain from disturbances to errors over all perturbations of the assumed size."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError

from ._ascent import Problem
from ._core import Progress, run
from ._lft import lft, lft_matrix
from ._response import FloatArray, as_response
from .blocks import BlockStructure, ComplexArray, Delta
from .result import MuResult
from .robust import performance_block, robust_stability

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class WorstCaseGain:
    """Worst gain of a partitioned plant over ``|Delta| <= 1``.

    Attributes
    ----------
    omega : ndarray (N,)
        Frequencies, rad per time unit.
    upper, lower : ndarray (N,)
        Bounds of the worst gain at each frequency; infinite where not even stability is proved.
    nominal : ndarray (N,)
        Gain without perturbation.
    peak_upper, peak_lower : float
        Largest values; both infinite if a perturbation of the assumed size destabilises.
    worst : Delta or None
        The worst perturbation found, of size at most 1.
    frequency : float
        Frequency at which it gives `peak_lower`, rad per time unit.
    disturbance, error : ndarray
        Unit directions: the worst disturbance at that frequency and the error that it causes.
    guaranteed : bool
        Whether `ceiling` is proved at all frequencies.
    tolerance : float
        Share by which `ceiling` is above `peak_upper`.
    stability : MuResult
        Robust stability.
    system : control.StateSpace or None
        The plant, if it is a state-space system.
    """

    omega: FloatArray = field(repr=False)
    upper: FloatArray = field(repr=False)
    lower: FloatArray = field(repr=False)
    nominal: FloatArray = field(repr=False)
    peak_upper: float
    peak_lower: float
    worst: Delta | None
    frequency: float
    disturbance: ComplexArray
    error: ComplexArray
    guaranteed: bool
    tolerance: float
    stability: MuResult
    system: control.StateSpace | None = field(repr=False)

    @property
    def ceiling(self) -> float:
        """Bound of the gain at all frequencies; infinite if there is no proof."""
        return self.peak_upper * (1.0 + self.tolerance) if self.guaranteed else math.inf

    def worst_system(self) -> control.StateSpace:
        """Return the plant with the worst perturbation put in, from disturbances to errors.

        Complex values are realised as stable all-pass systems of the same size.
        """
        if self.system is None or self.worst is None:
            raise ParameterError(
                "the worst system needs a state-space plant and a worst perturbation: give the "
                "plant as control.StateSpace"
            )
        if self.worst.real:
            return lft(self.system, self.worst)
        return lft(self.system, self.worst.realise(self.frequency, self.system.dt))

    def step_response(self, timepts: ArrayLike | None = None) -> control.TimeResponseData:
        """Return the step response of the worst system (`control.step_response`)."""
        import control

        times = None if timepts is None else np.asarray(timepts, dtype=float)
        return control.step_response(self.worst_system(), times)

    def __str__(self) -> str:
        """Return nominal and worst gain and what causes it in plain words."""
        nominal = float(np.max(self.nominal))
        if math.isinf(self.peak_lower):
            return (
                f"The gain has no bound (nominal {nominal:.3g}): the perturbation "
                f"{self.worst} destabilises."
            )
        if math.isinf(self.peak_upper):
            return (
                f"The gain grows from {nominal:.3g} to at least {self.peak_lower:.3g}; no bound "
                "was proved, since stability is not."
            )
        proved = "proved at all frequencies" if self.guaranteed else "on the given frequencies"
        return (
            f"The gain grows from {nominal:.3g} to between {self.peak_lower:.3g} and "
            f"{self.peak_upper:.3g} ({proved}) at {self.frequency:.4g} rad per time unit, with "
            f"{self.worst}."
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw nominal and worst gain over the frequency and return the axes."""
        from plant._plotting import COLOURS, axes, styled

        with styled():
            ax = axes(ax)
            shown = self.omega > 0.0
            omega = self.omega[shown]
            for values, style, colour, label in (
                (self.upper, "-", COLOURS[0], "worst gain, upper bound"),
                (self.lower, "--", COLOURS[1], "worst gain, lower bound"),
                (self.nominal, ":", COLOURS[6], "nominal gain"),
            ):
                finite = np.where(np.isfinite(values), values, np.nan)
                ax.plot(omega, finite[shown], style, c=colour, label=label)
            ax.set_xscale("log")
            ax.set_xlabel("frequency (rad per time unit)")
            ax.set_ylabel("gain from disturbances to errors (1)")
            ax.set_title("Worst-case gain")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax


def worst_case_gain(
    M: Any,
    structure: BlockStructure,
    omega: ArrayLike | None = None,
    *,
    tolerance: float = 0.01,
    gap: float = 0.05,
    stable: bool | None = None,
    dt: float | bool | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> WorstCaseGain:
    """Largest gain of a partitioned plant over all perturbations of the assumed size.

    The upper bound is the skewed structured singular value with the performance block free; the
    lower one is the gain with the worst perturbation found.

    Parameters
    ----------
    M : control.StateSpace, control.TransferFunction, control.FRD or callable
        Stable plant: perturbation first, then disturbances in and errors out.
    structure : BlockStructure
        Structure of the perturbation alone.
    omega, tolerance, gap, stable, dt, seed, progress
        As in `mu_analysis`.
    """
    import control

    response = as_response(M, omega, stable=stable, dt=dt)
    block = performance_block(response, structure)
    system = control.ss(M) if isinstance(M, control.TransferFunction) else M
    system = system if isinstance(system, control.StateSpace) else None
    stability = robust_stability(
        response, structure, omega, tolerance=tolerance, gap=gap, seed=seed
    )
    rows, columns = slice(structure.inputs, None), slice(structure.outputs, None)
    if stability.peak_lower >= 1.0:
        gains = _gains(response.at(stability.omega)[:, rows, columns])
        endless = np.full(len(gains), math.inf)
        return WorstCaseGain(
            stability.omega,
            np.where(stability.upper < 1.0, np.nan, endless),
            np.where(stability.lower < 1.0, np.nan, endless),
            gains,
            math.inf,
            math.inf,
            stability.worst,
            stability.worst_frequency,
            np.zeros(0, dtype=complex),
            np.zeros(0, dtype=complex),
            False,
            tolerance,
            stability,
            system,
        )
    free = np.append(np.zeros(len(structure), dtype=bool), True)
    result = run(
        response,
        Problem(structure.plus(block), free),
        omega,
        tolerance=tolerance,
        gap=gap,
        seed=seed,
        progress=progress,
    )
    nominal = _gains(response.at(result.omega)[:, rows, columns])
    worst = None if result.worst is None else result.worst.subset(structure)
    frequency, disturbance, error = result.worst_frequency, np.zeros(0), np.zeros(0)
    if worst is not None:
        closed = lft_matrix(response.at(np.array([frequency]))[0], worst.matrix())
        left, _, right = np.linalg.svd(closed)
        disturbance, error = right[0].conj(), left[:, 0]
    return WorstCaseGain(
        result.omega,
        result.upper,
        result.lower,
        nominal,
        result.peak_upper,
        result.peak_lower,
        worst,
        frequency,
        disturbance.astype(complex),
        error.astype(complex),
        result.guaranteed,
        tolerance,
        stability,
        system,
    )


def _gains(M: ComplexArray) -> FloatArray:
    """Largest singular values (N,)."""
    return np.asarray(np.linalg.norm(M, 2, axis=(1, 2)))
