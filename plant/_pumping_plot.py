"""Picture of the comparison of pumping losses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._plotting import COLOURS, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pumping_comparison import PumpingComparison


def plot_comparison(comparison: PumpingComparison) -> Figure:
    """See `PumpingComparison.plot`."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    data = comparison.data
    charge = 1e6 * data["charge"].values
    with styled():
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.4, 4.2))
        handles = []
        for k, speed in enumerate(data["speed_rpm"].values.tolist()):
            colour = COLOURS[k % len(COLOURS)]
            at = data.sel(speed_rpm=speed)
            left.plot(charge, at["camless_loss"], c=colour)
            left.plot(charge, at["throttled_loss"], "--", c=colour)
            right.plot(charge, 100.0 * at["saving"], c=colour)
            handles.append(Line2D([], [], color=colour, label=f"{speed:g} rpm"))
        handles.append(Line2D([], [], color="0.3", label="camless, least loss"))
        handles.append(Line2D([], [], color="0.3", ls="--", label="throttled"))
        left.set_ylabel("pumping loss (J per event)")
        left.set_title("Pumping loss of both engines")
        left.set_ylim(bottom=0.0)
        right.set_ylabel("pumping loss saved (%)")
        right.set_title("Saved by the camless engine at equal charge")
        right.set_ylim(top=100.0)
        for ax in (left, right):
            ax.set_xlabel("air charge (mg per event)")
            ax.set_xlim(left=0.0)
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    return figure
