"""Result of a mu analysis: both bounds over the frequency, and the worst perturbation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ._response import FloatArray
from .blocks import BlockStructure, Delta

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class MuResult:
    """Structured singular value of a system over the frequency.

    Attributes
    ----------
    structure : BlockStructure
        Structure of the perturbation.
    omega : ndarray (N,)
        Frequencies, rising, refined at the peaks; rad per time unit.
    upper, lower : ndarray (N,)
        Bounds of mu.
    peak_upper, peak_lower : float
        Largest values.
    frequency : float
        Where the upper bound peaks, rad per time unit.
    worst : Delta or None
        Smallest perturbation found that destabilises, of size ``1/peak_lower``.
    worst_frequency : float
        Frequency at which it does, rad per time unit; NaN if none was found.
    guaranteed : bool
        Whether it is proved that the upper bound is nowhere, between the frequencies included,
        above `ceiling`. So it is for state-space systems.
    tolerance : float
        Share by which `ceiling` is above `peak_upper`.
    gap : float
        Largest gap that was asked for.
    dt : float
        Sampling time; 0 for continuous time.
    held : tuple of str
        Blocks that are held at their assumed size (skewed mu); the margin is of the others.
    """

    structure: BlockStructure
    omega: FloatArray = field(repr=False)
    upper: FloatArray = field(repr=False)
    lower: FloatArray = field(repr=False)
    peak_upper: float
    peak_lower: float
    frequency: float
    worst: Delta | None
    worst_frequency: float
    guaranteed: bool
    tolerance: float
    gap: float
    dt: float
    held: tuple[str, ...] = ()

    @property
    def ceiling(self) -> float:
        """Bound of mu at all frequencies; infinite if there is no proof."""
        return self.peak_upper * (1.0 + self.tolerance) if self.guaranteed else math.inf

    @property
    def peak_gap(self) -> float:
        """Share of the peak of the upper bound that the lower bound leaves open."""
        return 1.0 - self.peak_lower / self.peak_upper if self.peak_upper > 0.0 else 0.0

    @property
    def robust(self) -> bool | None:
        """Whether all perturbations of size 1 are withstood; None if the bounds leave it open.

        Without a proof between the frequencies, the peak on them decides.
        """
        if self.peak_lower >= 1.0:
            return False
        top = self.ceiling if self.guaranteed else self.peak_upper
        return True if top < 1.0 else None

    @property
    def margin(self) -> float:
        """Size of perturbation that is withstood; infinite if nothing destabilises."""
        top = self.ceiling if self.guaranteed else self.peak_upper
        return 1.0 / top if top > 0.0 else math.inf

    def __str__(self) -> str:
        """Return bounds, margin, worst perturbation and gap in plain words."""
        where = f"at {self.frequency:.4g} rad per time unit"
        text = (f"With {', '.join(self.held)} at the assumed size, " if self.held else "") + (
            f"mu peaks between {self.peak_lower:.3f} and {self.peak_upper:.3f} ({where}): "
            f"perturbations up to {self.margin:.3g} times the assumed size are withstood"
        )
        text += (
            " (proved at all frequencies)."
            if self.guaranteed
            else " (on the given frequencies; nothing is proved between them)."
        )
        if self.worst is not None:
            text += (
                f" One of {self.worst.size:.3g} times the size destabilises at "
                f"{self.worst_frequency:.4g} rad per time unit: {self.worst}."
            )
        else:
            text += " None was found that destabilises."
        if self.peak_gap > self.gap:
            text += (
                f" The bounds are {100.0 * self.peak_gap:.0f} % apart, more than the "
                f"{100.0 * self.gap:.0f} % asked for."
            )
        return text

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw both bounds over the frequency and return the axes."""
        import numpy as np

        from plant._plotting import COLOURS, axes, styled

        with styled():
            ax = axes(ax)
            shown = self.omega > 0.0
            omega = self.omega[shown]
            ax.fill_between(
                omega,
                self.lower[shown],
                self.upper[shown],
                color=COLOURS[0],
                alpha=0.15,
                lw=0.0,
            )
            ax.plot(omega, self.upper[shown], "-", c=COLOURS[0], label="upper bound")
            ax.plot(omega, self.lower[shown], "--", c=COLOURS[1], label="lower bound")
            ax.axhline(1.0, color="0.3", lw=0.8, ls=":", label="limit for the assumed size")
            if self.worst is not None and self.worst_frequency > 0.0:
                ax.plot(
                    self.worst_frequency,
                    self.peak_lower,
                    "o",
                    mfc="none",
                    c=COLOURS[6],
                    label="worst perturbation",
                )
            ax.set_xscale("log")
            ax.set_ylim(0.0, 1.1 * max(float(np.max(self.upper)), 1.0))
            ax.set_xlabel("frequency (rad per time unit)")
            ax.set_ylabel("structured singular value (1)")
            ax.set_title("Structured singular value: bounds")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax
