"""Result of an order reduction: the chosen controller, and what each order gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ._realisation import FloatArray

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class ReductionRow:
    """One order: the better method, whether its loop is stable, and the measure of it.

    Attributes
    ----------
    order : int
        Number of states.
    method : str
        ``truncation``, ``singular perturbation`` or ``none`` for the full controller.
    stable : bool
        Whether the closed loop is stable.
    measure : float
        Measure of the closed loop; infinite if it is not stable.
    within : bool
        Whether the measure is within the tolerance.
    """

    order: int
    method: str
    stable: bool
    measure: float
    within: bool


@dataclass(frozen=True)
class ReductionResult:
    """Controller of the lowest order that is good enough, and what each order gives.

    Attributes
    ----------
    controller : control.StateSpace
        Reduced controller; its loop is stable.
    order : int
        Its number of states.
    measure, full_measure : float
        Measures of the loop with it and with the full controller.
    full_order, kept : int
        States of the full controller, and those on or outside the stability boundary.
    tolerance : float
        Relative rise of the measure that was allowed.
    table : tuple of ReductionRow
        Orders that were tried, rising.
    hankel_singular_values : ndarray
        Of the stable part, falling.
    name : str
        Name of the measure.
    """

    controller: control.StateSpace
    order: int
    measure: float
    full_measure: float
    full_order: int
    kept: int
    tolerance: float
    table: tuple[ReductionRow, ...]
    hankel_singular_values: FloatArray = field(repr=False)
    name: str = "measure"

    def __str__(self) -> str:
        """Return what was reached and the table."""
        lines = [
            f"order {self.order} instead of {self.full_order}: {self.name} {self.measure:.4g} "
            f"instead of {self.full_measure:.4g} (allowed +{100.0 * self.tolerance:.3g} %)"
        ]
        for row in self.table:
            value = f"{row.measure:.4g}" if row.stable else "unstable"
            mark = "within" if row.within else "-"
            lines.append(f"{row.order:4d}  {value:>10}  {mark:6}  {row.method}")
        return "\n".join(lines)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the measure against the order, with the bound and the chosen order."""
        from plant._plotting import COLOURS, axes, styled

        rows = [row for row in self.table if row.stable]
        bound = self.full_measure * (1.0 + self.tolerance)
        with styled():
            ax = axes(ax)
            ax.semilogy(
                [r.order for r in rows], [r.measure for r in rows], "o-", color=COLOURS[0],
                label="stable loops",
            )  # fmt: skip
            ax.axhline(bound, color=COLOURS[1], ls="--", label=f"bound {bound:.3g}")
            ax.plot(
                self.order, self.measure, "o", ms=13, mfc="none", color=COLOURS[6], ls="none",
                label=f"chosen: order {self.order}",
            )  # fmt: skip
            ax.set_xlabel("order of the controller")
            ax.set_ylabel(f"{self.name} (1)")
            ax.legend(loc="upper right")
        return ax
