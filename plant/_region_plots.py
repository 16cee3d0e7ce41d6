"""Plot of the regions of section 5 against speed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ._plotting import COLOURS, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .map_regions import MapRegions

_FEW = 8  # speeds, fewer of which are drawn as points too


def plot_regions(regions: MapRegions) -> Figure:
    """See `MapRegions.plot`."""
    import matplotlib.pyplot as plt

    speed = regions.speeds_rpm
    margin = 0.03 * speed[-1]
    with styled(), plt.rc_context({"lines.marker": "." if speed.size < _FEW else "None"}):
        figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(8.4, 6.8))
        _plot_saturation(regions, top)
        _plot_durations(regions, bottom)
        bottom.set_xlim(speed[0] - margin, speed[-1] + margin)
        bottom.set_xlabel("speed (rpm)")
        for ax in (top, bottom):
            ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


def _plot_saturation(regions: MapRegions, ax: Axes) -> None:
    """Draw lift saturation against speed, and the lifts that Part I names."""
    speed, highest = regions.speeds_rpm, regions.region.highest_lift_mm
    for k, duration in enumerate(regions.durations_deg):
        colour = COLOURS[k % len(COLOURS)]
        ax.plot(speed, regions.saturation_mm[k], color=colour, label=f"at {duration:g} deg")
        # Where the duration leaves time for every lift, there is no limit to show.
        limit = regions.highest_lift_mm[k]
        limit = np.where(limit < highest, limit, np.nan)
        if np.isfinite(limit).any():
            label = f"highest lift in {duration:g} deg"
            ax.plot(speed, limit, ":", color=colour, label=label)
    label = "at the largest charge"
    ax.plot(speed, regions.saturation_at_peak_mm, "--", color="0.35", label=label)
    printed = regions.printed_mm
    if printed:
        ax.plot(
            list(printed),
            list(printed.values()),
            "D",
            color=COLOURS[4],
            mec="black",
            zorder=3,
            label="Part I",
        )
    ax.set_ylim(0.0, 1.05 * highest)
    ax.set_ylabel("saturation lift (mm)")
    ax.set_title(
        f"Lift saturation: {100 * regions.share:g} % of the charge at {highest:g} mm of lift"
    )


def _plot_durations(regions: MapRegions, ax: Axes) -> None:
    """Draw flow reversal and the shortest duration of each lift against speed."""
    speed, longest = regions.speeds_rpm, regions.region.longest_deg
    for k, lift in enumerate(regions.lifts_mm):
        reversal = regions.reversal_deg[k]
        where = "" if np.isfinite(reversal).all() else f" (where below {longest:g} deg)"
        label = f"reversal at {lift:g} mm{where}"
        ax.plot(speed, reversal, color=COLOURS[k % len(COLOURS)], label=label)
    for k, lift in enumerate(regions.lifts_mm):
        label = f"shortest at {lift:g} mm"
        ax.plot(speed, regions.shortest_deg[k], "--", color=COLOURS[k % len(COLOURS)], label=label)
    ax.axhline(longest, color="0.25", lw=0.8, marker="", label="longest of the map")
    ax.set_ylim(0.0, 1.05 * longest)
    ax.set_ylabel("duration (deg)")
    ax.set_title("Flow reversal, and shortest duration that the actuator can drive")
