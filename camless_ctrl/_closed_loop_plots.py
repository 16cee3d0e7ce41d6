"""Pictures of a closed-loop result over cycles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .closed_loop_result import ClosedLoopResult


def plot_charge(result: ClosedLoopResult, ax: Axes | None) -> Axes:
    """Draw the charge of each cylinder against demand."""
    from plant._plotting import axes, styled

    n = result.n_cylinders
    cycle = np.arange(result.charge.size) / n
    with styled():
        ax = axes(ax, (8.0, 3.8))
        ax.step(cycle, 1e6 * result.demand, "k--", where="post", lw=1.2, label="demand")
        for i in range(1, n + 1):
            of = result.cylinder == i
            ax.plot(cycle[of], 1e6 * result.charge[of], ".-", ms=3, lw=0.9, label=f"cylinder {i}")
        ax.set_xlabel("engine cycle")
        ax.set_ylabel("air charge (mg per event)")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def plot_error(result: ClosedLoopResult, ax: Axes | None, limit: float) -> Axes:
    """Draw the relative charge error of each cylinder, up to +-`limit`."""
    from plant._plotting import axes, styled

    with styled():
        ax = axes(ax, (8.0, 3.2))
        ax.axhspan(-1.0, 1.0, color="0.92", zorder=0, label="within 1 %")
        for i, error in enumerate(result.relative_error.T):
            ax.plot(100.0 * error, ".-", ms=3, lw=0.9, label=f"cylinder {i + 1}")
        ax.set_ylim(-100.0 * limit, 100.0 * limit)
        ax.set_xlabel("engine cycle")
        ax.set_ylabel("charge error (%)")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax
