"""Figures 11 to 14 of Part I as results: data, statements judged, caption, picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ._section_six_words import Caption, SectionSixClaim

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class SectionSixFigure(ABC):
    """A figure of section 6, drawn again from simulation.

    Attributes
    ----------
    name : str
        Name in Part I.
    dataset : xarray.Dataset
        What is drawn, in SI units but for lift (mm), angles (deg) and speed (rpm). Charge and
        loss are means over the cylinders, per event.
    claims : tuple of SectionSixClaim
        What section 6 says of the figure, each with the number and the bound that decide it.
    words : Caption
        The caption with its numbers apart.
    """

    name: str
    dataset: xr.Dataset
    claims: tuple[SectionSixClaim, ...]
    words: Caption

    def caption(self) -> str:
        """Return the finding in sentences with numbers."""
        return str(self.words)

    def change(self, variable: str) -> xr.DataArray:
        """Relative change of a variable from its first plant to its second one, 1."""
        return relative_change(self.dataset[variable])

    def claim(self, claim_id: str) -> SectionSixClaim:
        """Return a statement by its id.

        Raises
        ------
        ParameterError
            If there is none of that id.
        """
        from plant._checks import one_of

        wanted = one_of("claim_id", claim_id, (claim.id for claim in self.claims))
        return next(claim for claim in self.claims if claim.id == wanted)

    @abstractmethod
    def plot(self) -> Figure:
        """Draw the figure."""

    def __str__(self) -> str:
        """Return the name and the caption."""
        return f"{self.name}: {self.caption()}"


@dataclass(frozen=True, eq=False)
class RunnerComparison(SectionSixFigure):
    """Figures 11 and 12: charge and loss over lift and closing timing, without and with runner.

    The dataset holds ``charge_over_lift`` (kg), ``loss_over_lift`` (J) and
    ``specific_loss_over_lift`` (J/kg) over ``runner`` ("without", "with") and ``lift``, the
    same ``_over_closing`` over ``runner`` and ``closing``, and ``reached_over_lift`` and
    ``reached_over_closing``; where False, the lift cannot be driven and the values are NaN.
    """

    def plot(self) -> Figure:
        """Draw charge, loss and specific loss against lift (left) and closing timing (right)."""
        from ._section_six_plots import plot_runner_comparison

        return plot_runner_comparison(self)


@dataclass(frozen=True, eq=False)
class LoopComparison(SectionSixFigure):
    """Figure 13: P-V diagrams for early, middle and late closing, without and with runner.

    The dataset holds ``cylinder_pressure`` (Pa) over ``runner``, ``closing`` and
    ``crank_angle``, the ``volume`` (m3) of the first cylinder, ``charge``, ``loss`` and
    ``specific_loss`` over ``runner`` and ``closing`` at the ``delivered_lift``, and the same
    with ``_at_common_lift`` for the one lift that all the closing timings allow. The valve is
    ``shut`` (deg) when it has seated.
    """

    def plot(self) -> Figure:
        """Draw a P-V diagram for each closing timing, one below the other."""
        from ._section_six_plots import plot_loops

        return plot_loops(self)


@dataclass(frozen=True, eq=False)
class MotionComparison(SectionSixFigure):
    """Figure 14: charge and loss over speed, with the simplified and the oscillating valve.

    The dataset holds ``charge`` (kg), ``loss`` (J) and ``specific_loss`` (J/kg) over
    ``motion`` ("simplified", "oscillating") and ``speed``, and ``reached``; where False, the
    lift cannot be driven and the values are NaN.
    """

    def plot(self) -> Figure:
        """Draw charge, loss and specific loss against speed."""
        from ._section_six_plots import plot_motions

        return plot_motions(self)


def relative_change(values: xr.DataArray) -> xr.DataArray:
    """Relative change along the first dimension, from its first entry to its second, 1."""
    before, after = (values.isel({values.dims[0]: k}, drop=True) for k in (0, 1))
    change = after / before - 1.0
    change.attrs.update(units="1", long_name=f"relative change of the {values.name}")
    return change
