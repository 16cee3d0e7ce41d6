"""Pictures of Figures 11 to 14 of Part I."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from plant._plotting import COLOURS, styled

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .section_six_result import LoopComparison, MotionComparison, RunnerComparison

# quantity, axis label, factor from SI
_PANELS = (
    ("charge", "air charge (mg per event)", 1e6),
    ("loss", "pumping loss (J per event)", 1.0),
    ("specific_loss", "specific loss (J/g)", 1e-3),
)
# What carries the effect is solid, what does not is dashed, drawn last to show where they meet.
_WITH: dict[str, Any] = {"color": COLOURS[0], "ls": "-", "lw": 2.0, "zorder": 2}
_WITHOUT: dict[str, Any] = {"color": COLOURS[1], "ls": "--", "lw": 1.5, "zorder": 3}
_SHADE = "0.9"


def plot_runner_comparison(result: RunnerComparison) -> Figure:
    """See `RunnerComparison.plot`."""
    import matplotlib.pyplot as plt

    data = result.dataset
    speed, lift, closing = (data.attrs[k] for k in ("speed_rpm", "lift_mm", "closing_deg"))
    with styled():
        figure, grid = plt.subplots(3, 2, figsize=(9.0, 8.4), sharex="col", sharey="row")
        for row, (quantity, label, factor) in zip(grid, _PANELS, strict=True):
            for ax, dim in zip(row, ("lift", "closing"), strict=True):
                _pair(ax, dim, data[f"{quantity}_over_{dim}"], factor)
            row[0].set_ylim(bottom=0.0)  # last: it ends the scaling of both
            row[0].set_ylabel(label)
        grid[-1][0].set_xlabel("intake valve lift (mm)")
        grid[-1][1].set_xlabel("closing timing IVC (deg after TDC)")
        grid[0][0].set_title(f"{speed:g} rpm, closing at {closing:g} deg")
        grid[0][1].set_title(f"{speed:g} rpm, lift {lift:g} mm")
        for column, dim in enumerate(("lift", "closing")):
            _margin(grid[-1][column], data[dim].to_numpy())
        handles = list(grid[0][0].get_legend_handles_labels()[0])
        if not bool(data["reached_over_closing"].all()):
            first, earliest = float(data["closing"][0]), data.attrs["earliest_closing_deg"]
            for ax in grid[:, 1]:
                shade = ax.axvspan(first, earliest, color=_SHADE, lw=0.0, zorder=0)
            shade.set_label(f"{lift:g} mm cannot be reached")
            handles.append(shade)
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def plot_loops(result: LoopComparison) -> Figure:
    """See `LoopComparison.plot`."""
    import matplotlib.pyplot as plt

    data = result.dataset
    exhaust = data.attrs["exhaust_pressure"]
    volume, angle = 1e6 * data["volume"].to_numpy(), data["crank_angle"].to_numpy()
    with styled():
        figure, column = plt.subplots(
            data["closing"].size, 1, figsize=(7.6, 9.4), sharex=True, sharey=True
        )
        for k, (ax, closing) in enumerate(zip(column, data["closing"].values, strict=True)):
            at = data.isel(closing=k)
            for runner, look in (("with", _WITH), ("without", _WITHOUT)):
                pressure = at["cylinder_pressure"].sel(runner=runner).to_numpy()
                # Once the valve is shut, compression goes on far above the loop.
                open_or_low = (angle <= float(at["shut"])) | (pressure <= 1.15 * exhaust)
                shown = np.where(open_or_low, pressure, np.nan)
                numbers = (
                    f"{1e6 * float(at['charge'].sel(runner=runner)):.1f} mg, "
                    f"{float(at['loss'].sel(runner=runner)):.2f} J"
                )
                ax.plot(volume, shown / 1e5, label=f"{runner} runner: {numbers}", **look)
                shut = int(np.argmin(np.abs(angle - float(at["shut"]))))
                ax.plot(volume[shut], pressure[shut] / 1e5, "o", ms=5, c=look["color"], zorder=4)
            ax.axhline(exhaust / 1e5, color="0.4", ls=":", lw=1.2, zorder=1)
            lift = float(at["delivered_lift"])
            limited = ", the highest it allows" if lift < data.attrs["lift_mm"] else ""
            ax.set_title(f"closing at {closing:g} deg, lift {lift:.2f} mm{limited}")
            ax.set_ylabel("cylinder pressure (bar)")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        column[0].annotate(
            "exhaust pressure",
            (volume.max(), exhaust / 1e5),
            xytext=(0, 3),
            textcoords="offset points",
            ha="right",
            fontsize=8.5,
            color="0.3",
        )
        column[-1].set_xlabel("cylinder volume (cm³)")
        figure.suptitle(f"{data.attrs['speed_rpm']:g} rpm", x=0.01, ha="left", fontsize=10.5)
    return figure


def plot_motions(result: MotionComparison) -> Figure:
    """See `MotionComparison.plot`."""
    import matplotlib.pyplot as plt

    data = result.dataset
    with styled():
        figure, column = plt.subplots(4, 1, figsize=(7.2, 9.6), sharex=True)
        for ax, (quantity, label, factor) in zip(column[:3], _PANELS, strict=True):
            _pair(ax, "speed", data[quantity], factor)
            ax.set_ylim(bottom=0.0)
            ax.set_ylabel(label)
        column[0].set_title(
            f"lift {data.attrs['lift_mm']:g} mm, closing at {data.attrs['closing_deg']:g} deg, "
            f"{data.attrs['runner']} runner"
        )
        column[-1].set_xlabel("engine speed (rpm)")
        _margin(column[-1], data["speed"].to_numpy())
        for quantity, colour, style in (("charge", COLOURS[2], "-"), ("loss", COLOURS[6], "-.")):
            column[3].plot(
                data["speed"],
                100.0 * result.change(quantity),
                color=colour,
                ls=style,
                lw=1.4,
                label=f"change of the {quantity}",
            )
        column[3].axhline(0.0, color="0.3", lw=0.8)
        column[3].set_ylabel("change (%)")
        handles = [h for ax in (column[0], column[3]) for h in ax.get_legend_handles_labels()[0]]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _pair(ax: Axes, dim: str, values: xr.DataArray, factor: float) -> None:
    """Draw both plants of a quantity; the second carries the effect."""
    kind = str(values.dims[0])
    names = [str(name) for name in values[kind].values]
    labels = [f"{name} runner" if kind == "runner" else f"{name} valve motion" for name in names]
    for k, look in ((1, _WITH), (0, _WITHOUT)):
        ax.plot(values[dim], factor * values.isel({kind: k}), label=labels[k], **look)


def _margin(ax: Axes, values: np.ndarray) -> None:
    """Let the axis end where the data do, also where they are missing."""
    span = 0.02 * float(values[-1] - values[0])
    if span > 0.0:
        ax.set_xlim(float(values[0]) - span, float(values[-1]) + span)
