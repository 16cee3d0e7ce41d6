"""Contour plots of the mean-value maps (Figures 9 and 10)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from ._plotting import axes, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .mean_value import MeanValuePlant

_QUANTITIES = {"charge": ("air charge", 1e6, "mg"), "loss": ("pumping loss", 1.0, "J")}
_SATURATION_DEG = 180.0


def contours(
    maps: MeanValuePlant, quantity: Literal["charge", "loss"], speed_rpm: float, ax: Axes | None
) -> Axes:
    """Draw a map over duration and lift, with its regions; return the axes."""
    name, factor, unit = _QUANTITIES[quantity]
    region = maps.region
    lift = np.linspace(region.lowest_lift_mm, region.highest_lift_mm, 121)
    region.require(lift, region.longest_deg, speed_rpm)
    shortest = region.shortest_deg(lift, speed_rpm)
    # Lines of constant share follow the limit of feasibility, so that it is drawn sharp.
    share = np.linspace(0.0, 1.0, 161)
    lifts = np.broadcast_to(lift[:, None], (len(lift), len(share)))
    duration = region.duration_deg(lifts, share, speed_rpm)
    evaluate = maps.air_charge if quantity == "charge" else maps.pumping_loss
    value = factor * evaluate(lifts, duration, speed_rpm)
    with styled():
        ax = axes(ax, (6.4, 4.2))
        ax.grid(False)
        filled = ax.contourf(duration, lifts, value, levels=16, cmap="viridis")
        lines = ax.contour(
            duration,
            lifts,
            value,
            levels=np.asarray(filled.levels)[::2],
            colors="white",
            linewidths=0.7,
        )
        ax.clabel(lines, fmt="%g", fontsize=8)
        ax.figure.colorbar(filled, ax=ax, label=f"{name} ({unit} per event)")
        ax.fill_betweenx(
            lift,
            0.0,
            shortest,
            facecolor="0.88",
            edgecolor="0.55",
            hatch="///",
            linewidth=0.0,
            label="infeasible: too short for the lift",
        )
        ax.plot(shortest, lift, color="0.25", lw=1.2)
        reversal = maps.flow_reversal(speed_rpm, lift)
        if np.isfinite(reversal).any():
            ax.plot(reversal, lift, "--", color="#D55E00", label="flow reversal: largest charge")
        if region.feasible(region.highest_lift_mm, _SATURATION_DEG, speed_rpm):
            saturation = float(maps.lift_saturation(speed_rpm, duration_deg=_SATURATION_DEG))
            ax.plot(
                _SATURATION_DEG,
                saturation,
                "o",
                color="#E69F00",
                mec="black",
                label=f"lift saturation at {_SATURATION_DEG:g} deg",
            )
        ax.set_xlim(0.0, region.longest_deg)
        ax.set_ylim(region.lowest_lift_mm, region.highest_lift_mm)
        ax.set_xlabel("duration (deg)")
        ax.set_ylabel("lift (mm)")
        ax.set_title(f"Mean-value {name} at {speed_rpm:g} rpm, opening at TDC, wide open")
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return ax
