"""Result of a D-K iteration: the best controller, and how every iteration went."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ._realisation import FloatArray
from .checks import SynthesisCheck
from .mu_bound import Structure

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class DkIteration:
    """One K step and the D step that follows it.

    Attributes
    ----------
    number : int
        From 1.
    gamma : float
        H-infinity norm of the scaled closed loop, verified.
    peak_mu : float
        Largest upper bound of mu over frequency.
    peak_frequency : float
        Where it is, rad/s.
    controller_order : int
        Number of states of the controller.
    scaling_orders : tuple of int
        Orders of the scalings that the K step used, a block each.
    fit_loss : float
        Peak with the scalings fitted for the next K step, over `peak_mu`, less 1; NaN if no
        fit followed.
    """

    number: int
    gamma: float
    peak_mu: float
    peak_frequency: float
    controller_order: int
    scaling_orders: tuple[int, ...]
    fit_loss: float

    def __str__(self) -> str:
        """Return the iteration in one line."""
        return (
            f"iteration {self.number}: gamma {self.gamma:.4g}, peak mu {self.peak_mu:.4g} at "
            f"{self.peak_frequency:.3g} rad/s, controller of order {self.controller_order}, "
            f"scalings of order {', '.join(str(k) for k in self.scaling_orders)}"
        )


@dataclass(frozen=True)
class DkResult:
    """Best controller of a D-K iteration.

    Attributes
    ----------
    controller : control.StateSpace
        From measurements to controls; ``u = K y``, no sign change.
    peak_mu : float
        Largest upper bound of mu with it, on the grid with its peaks refined.
    peak_frequency : float
        Where it is, rad/s.
    closed_loop : control.StateSpace
        From disturbances to errors, perturbation channels included; stable.
    frequency, mu : ndarray
        Upper bound of mu over frequency, rad/s.
    scalings : ndarray
        Scalings that prove it, shape (frequencies, blocks).
    history : tuple of DkIteration
        Every iteration, in order.
    structure : tuple of PerturbationBlock
        Blocks.
    stopped : str
        Why the iteration ended.
    check : SynthesisCheck
        Conditions that the plant was tested for.
    seconds : float
        Time taken, s.
    """

    controller: control.StateSpace
    peak_mu: float
    peak_frequency: float
    closed_loop: control.StateSpace
    frequency: FloatArray = field(repr=False)
    mu: FloatArray = field(repr=False)
    scalings: FloatArray = field(repr=False)
    history: tuple[DkIteration, ...]
    structure: Structure
    stopped: str
    check: SynthesisCheck = field(repr=False)
    seconds: float

    @property
    def best(self) -> DkIteration:
        """Iteration whose controller is the result."""
        return min(self.history, key=lambda step: step.peak_mu)

    @property
    def robust(self) -> bool:
        """Whether the peak of mu is below 1: performance holds for every allowed perturbation."""
        return self.peak_mu < 1.0

    def __str__(self) -> str:
        """Return what was reached, what it means, and the iterations."""
        share = 100.0 / self.peak_mu
        meaning = (
            f"stability and performance hold for perturbations up to {share:.0f} % of the "
            "modelled size"
        )
        if not self.robust:
            meaning += f", with errors up to {self.peak_mu:.3g} times the bound"
        lines = [
            f"peak mu {self.peak_mu:.4g} at {self.peak_frequency:.3g} rad/s after "
            f"{len(self.history)} iterations: {meaning}",
            f"controller of order {self.controller.nstates} from iteration {self.best.number}; "
            f"ended because {self.stopped}",
        ]
        return "\n".join(lines + [f"- {step}" for step in self.history])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw gamma and the peak of mu of each iteration."""
        from plant._plotting import COLOURS, axes, styled

        numbers = [step.number for step in self.history]
        gammas = [step.gamma for step in self.history]
        peaks = [step.peak_mu for step in self.history]
        with styled():
            ax = axes(ax)
            ax.plot(
                numbers, gammas, "s--", color=COLOURS[1], ms=10, mfc="none",
                label="gamma of the K step",
            )  # fmt: skip
            ax.plot(numbers, peaks, "o-", color=COLOURS[0], label="peak mu")
            ax.plot(
                self.best.number, self.best.peak_mu, "o", ms=13, mfc="none", color=COLOURS[6],
                label="chosen", ls="none",
            )  # fmt: skip
            ax.axhline(1.0, color=COLOURS[6], lw=0.9, ls=":")
            top, low = max(*gammas, *peaks, 1.0), min(*gammas, *peaks, 1.0)
            ax.set_ylim(low - 0.1 * (top - low + 0.1), top + 0.45 * (top - low + 0.1))
            ax.set_xlim(0.5, len(numbers) + 0.5)
            ax.set_xticks(numbers)
            ax.set_xlabel("iteration")
            ax.set_ylabel("gamma, peak mu (1)")
            ax.legend(loc="upper right", ncols=3)
        return ax

    def plot_mu(self, ax: Axes | None = None) -> Axes:
        """Draw the upper bound of mu of the chosen controller against frequency."""
        from plant._plotting import COLOURS, axes, styled

        with styled():
            ax = axes(ax)
            ax.semilogx(self.frequency, self.mu, color=COLOURS[0], label="upper bound of mu")
            ax.plot(
                self.peak_frequency, self.peak_mu, "o", color=COLOURS[1],
                label=f"peak {self.peak_mu:.3g}", ls="none",
            )  # fmt: skip
            ax.axhline(1.0, color=COLOURS[6], lw=0.9, ls=":")
            ax.set_ylim(0.0, 1.35 * max(1.0, float(np.max(self.mu))))
            ax.set_xlabel("frequency (rad/s)")
            ax.set_ylabel("upper bound of mu (1)")
            ax.legend(loc="upper left", ncols=2)
        return ax
