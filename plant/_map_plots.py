"""Plots of the mean-value maps at one speed: Figures 9 and 10 of Part I, with their regions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from ._checks import one_of
from ._map_regions import SATURATION_SHARE, lift_saturation
from ._plotting import COLOURS, axes, styled
from .errors import ParameterError
from .kinematics import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .mean_value import MeanValuePlant

Quantity = Literal["charge", "loss", "specific"]
Kind = Literal["contour", "surface"]

_NAMES = {
    "charge": ("air charge", "mg per event"),
    "loss": ("pumping loss", "J per event"),
    "specific": ("specific pumping loss", "J/g"),
}
_ROUNDING = 1e-6
CLEAR_SHARE = 0.05  # of the largest charge, below which a loss per charge says nothing
_REVERSAL, _SATURATION, _LIMIT = COLOURS[1], COLOURS[6], "0.25"


class _Line(NamedTuple):
    """A line over duration and lift, and how it is drawn."""

    duration: FloatArray  # deg
    lift: FloatArray  # mm
    style: str
    look: dict[str, Any]


class _Cut(NamedTuple):
    """A map at one speed, on lines of constant lift from the first duration to the longest."""

    lift: FloatArray  # (n,), mm
    shortest: FloatArray  # (n,), deg
    first: FloatArray  # (n,), deg; later than the shortest where the quantity says nothing
    lifts: FloatArray  # (n, k), mm
    durations: FloatArray  # (n, k), deg
    values: FloatArray  # (n, k), NaN where the quantity says nothing


def draw(
    maps: MeanValuePlant,
    quantity: Quantity,
    speed_rpm: float,
    ax: Axes | None = None,
    kind: Kind = "contour",
) -> Axes:
    """Draw a map over duration and lift as contours or as a surface; return the axes."""
    one_of("kind", kind, ("contour", "surface"))
    return (contours if kind == "contour" else surface)(maps, quantity, speed_rpm, ax)


def contours(
    maps: MeanValuePlant, quantity: Quantity, speed_rpm: float, ax: Axes | None = None
) -> Axes:
    """Draw contours of a map over duration and lift, with its regions; return the axes.

    Lift saturation is drawn from the first duration at which the highest lift can be driven
    and takes in 5 % of the largest charge.

    Parameters
    ----------
    maps : MeanValuePlant
        The maps.
    quantity : {"charge", "loss", "specific"}
        Air charge in mg, pumping loss in J, or the loss per charge in J/g; the last only where
        the charge is above 5 % of the largest.
    speed_rpm : float
        Speed.
    ax : Axes, optional
        Where to draw; a new figure by default.

    Raises
    ------
    ParameterError
        For an unknown quantity and a speed out of the map's range.
    """
    cut = _cut(maps, quantity, speed_rpm, (121, 161))
    name, unit = _NAMES[quantity]
    with styled():
        ax = axes(ax, (7.2, 4.6))
        ax.grid(False)
        filled = ax.contourf(
            cut.durations, cut.lifts, np.ma.masked_invalid(cut.values), **_levels(quantity, cut)
        )
        levels = np.asarray(filled.levels)[::2]
        lines = ax.contour(
            cut.durations,
            cut.lifts,
            np.ma.masked_invalid(cut.values),
            levels=levels,
            colors="white",
            linewidths=0.7,
        )
        ax.clabel(lines, fmt="%g", fontsize=8)
        bar = ax.figure.colorbar(filled, ax=ax, label=f"{name} ({unit})", ticks=levels)
        bar.ax.set_yticks(levels, [f"{level:g}" for level in levels], minor=False)
        bar.ax.minorticks_off()
        _hatched(ax, cut.lift, np.zeros_like(cut.lift), cut.shortest, "///", _infeasible())
        if quantity == "specific":
            _hatched(ax, cut.lift, cut.shortest, cut.first, "...", _unclear())
        ax.plot(cut.shortest, cut.lift, color=_LIMIT, lw=1.2)
        for line in _region_lines(maps, speed_rpm, cut.lift):
            ax.plot(line.duration, line.lift, line.style, **line.look)
        ax.set_xlim(0.0, maps.region.longest_deg)
        ax.set_ylim(cut.lift[0], cut.lift[-1])
        ax.set_xlabel("duration (deg)")
        ax.set_ylabel("lift (mm)")
        ax.set_title(_title(quantity, speed_rpm))
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return ax


def surface(
    maps: MeanValuePlant, quantity: Quantity, speed_rpm: float, ax: Axes | None = None
) -> Axes:
    """Draw a map over duration and lift as a surface (Figures 9 and 10); return the axes.

    The corner of durations that are too short for the lift is left out, and marked as such on
    the floor. Arguments as for `contours`, but that `ax` must be three-dimensional, as the new
    axes are.

    Raises
    ------
    ParameterError
        As for `contours`, and for flat axes.
    """
    import matplotlib.pyplot as plt
    from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]

    cut = _cut(maps, quantity, speed_rpm, (41, 49))
    name, unit = _NAMES[quantity]
    with styled():
        if ax is None:
            ax = plt.figure(figsize=(6.6, 5.4)).add_subplot(projection="3d")
        if not isinstance(ax, Axes3D):
            raise ParameterError(
                "ax is flat, but a surface needs axes made with projection='3d': pass such "
                "axes, or none"
            )
        # Sorted by depth, the lines on the surface would vanish in it.
        ax.computed_zorder = False
        floor = min(0.0, float(np.nanmin(cut.values)))
        _floor(ax, cut.lift, np.zeros_like(cut.lift), cut.shortest, floor, "0.75", _infeasible())
        if quantity == "specific":
            _floor(ax, cut.lift, cut.shortest, cut.first, floor, "0.9", _unclear())
        ax.plot_surface(
            cut.durations,
            cut.lifts,
            cut.values,
            cmap="viridis",
            rcount=cut.values.shape[0],
            ccount=cut.values.shape[1],
            linewidth=0.25,
            edgecolor=(1.0, 1.0, 1.0, 0.5),
            zorder=2,
        )
        ax.plot(cut.durations[:, 0], cut.lift, cut.values[:, 0], color=_LIMIT, lw=1.2, zorder=3)
        for line in _region_lines(maps, speed_rpm, cut.lift):
            height = _values(maps, quantity, speed_rpm, line.lift, line.duration)
            ax.plot(line.duration, line.lift, height, line.style, zorder=4, **line.look)
        ax.set_xlim(0.0, maps.region.longest_deg)
        ax.set_ylim(0.0, cut.lift[-1])
        ax.set_zlim(floor, float(np.nanmax(cut.values)))
        ax.set_xlabel("duration (deg)")
        ax.set_ylabel("lift (mm)")
        ax.set_zlabel(f"{name} ({unit})")
        ax.set_title(_title(quantity, speed_rpm), y=0.98)
        # Seen from where the map is low, so that it does not stand before itself.
        ax.view_init(elev=28.0, azim=-125.0 if quantity == "charge" else 125.0)
        ax.set_box_aspect((1.1, 1.0, 0.8), zoom=0.95)
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=2)
    return ax


def _cut(
    maps: MeanValuePlant, quantity: Quantity, speed_rpm: float, points: tuple[int, int]
) -> _Cut:
    """Evaluate a map at one speed on a grid of `points` lifts and durations."""
    one_of("quantity", quantity, _NAMES)
    region = maps.region
    lift = np.linspace(region.lowest_lift_mm, region.highest_lift_mm, points[0])
    region.require(lift, region.longest_deg, speed_rpm)
    first = shortest = region.shortest_deg(lift, speed_rpm)
    if quantity == "specific":
        least = CLEAR_SHARE * float(maps.largest_charge(speed_rpm))
        start = maps.duration_for_charge(least, lift, speed_rpm)
        otherwise = np.where(start.lowest_charge > least, shortest, region.longest_deg)
        first = np.where(start.reachable, start.duration_deg, otherwise)
    # Lines that start at the limit draw it sharp, without the steps of a grid.
    share = np.linspace(0.0, 1.0, points[1])
    durations = first[:, None] + (region.longest_deg - first[:, None]) * share
    lifts = np.broadcast_to(lift[:, None], durations.shape)
    values = _values(maps, quantity, speed_rpm, lifts, durations)
    return _Cut(lift, shortest, first, lifts, durations, values)


def _values(
    maps: MeanValuePlant,
    quantity: Quantity,
    speed_rpm: float,
    lift: FloatArray,
    duration: FloatArray,
) -> FloatArray:
    """Values in the unit of the plot; NaN outside the map and where they say nothing."""
    if quantity == "loss":
        return maps.pumping_loss(lift, duration, speed_rpm, outside="nan")
    charge = maps.air_charge(lift, duration, speed_rpm, outside="nan")
    if quantity == "charge":
        return 1e6 * charge
    least = CLEAR_SHARE * float(maps.largest_charge(speed_rpm))
    clear = charge >= least * (1.0 - _ROUNDING)
    loss = maps.pumping_loss(lift, duration, speed_rpm, outside="nan")
    return np.where(clear, 1e-3 * loss / np.where(clear, charge, 1.0), np.nan)


def _levels(quantity: Quantity, cut: _Cut) -> dict[str, Any]:
    """Levels and colours: even steps, or even ratios for the specific loss's wide range."""
    if quantity != "specific":
        return {"levels": 16, "cmap": "viridis"}
    from matplotlib.colors import LogNorm

    low, high = np.nanmin(cut.values), np.nanmax(cut.values)
    steps = np.arange(np.floor(20.0 * np.log10(low)), np.ceil(20.0 * np.log10(high)) + 1.0)
    levels = np.array([float(f"{level:.2g}") for level in 10.0 ** (steps / 20.0)])
    return {"levels": levels, "cmap": "viridis", "norm": LogNorm(levels[0], levels[-1])}


def _hatched(
    ax: Axes, lift: FloatArray, low: FloatArray, high: FloatArray, hatch: str, label: str
) -> None:
    ax.fill_betweenx(
        lift,
        low,
        high,
        facecolor="0.88",
        edgecolor="0.55",
        hatch=hatch,
        linewidth=0.0,
        label=label,
    )


def _floor(
    ax: Any,
    lift: FloatArray,
    low: FloatArray,
    high: FloatArray,
    height: float,
    colour: str,
    label: str,
) -> None:
    """Shade durations from `low` to `high` on the floor of a surface plot."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    outline = np.column_stack(
        [
            np.concatenate([low, high[::-1]]),
            np.concatenate([lift, lift[::-1]]),
            np.full(2 * lift.size, height),
        ]
    )
    ax.add_collection3d(Poly3DCollection([outline], color=colour, lw=0.0, label=label, zorder=1))


def _region_lines(maps: MeanValuePlant, speed_rpm: float, lift: FloatArray) -> list[_Line]:
    """Lines of flow reversal and of lift saturation, those that there are at the speed."""
    from matplotlib.patheffects import withStroke

    # A pale rim keeps the lines apart from every colour of the map.
    rim = {"path_effects": [withStroke(linewidth=3.2, foreground="white")]}
    region = maps.region
    reversal = maps.flow_reversal(speed_rpm, lift)
    longest = region.longest_deg
    duration = np.linspace(
        float(region.shortest_deg(region.highest_lift_mm, speed_rpm)), longest, 241
    )
    saturation = lift_saturation(maps, speed_rpm, duration)
    full = maps.air_charge(region.highest_lift_mm, duration, speed_rpm)
    clear = full >= CLEAR_SHARE * float(maps.largest_charge(speed_rpm))
    # At the lowest lift the line would only follow the edge: every lift is saturated there.
    saturation = np.where(clear & (saturation > region.lowest_lift_mm), saturation, np.nan)
    share, highest = f"{100 * SATURATION_SHARE:g} %", f"{region.highest_lift_mm:g} mm"
    lines = [
        _Line(
            reversal,
            lift,
            "--",
            {"color": _REVERSAL, "label": "flow reversal: largest charge", **rim},
        ),
        _Line(
            duration,
            saturation,
            "-",
            {
                "color": _SATURATION,
                "label": f"lift saturation: {share} of charge at {highest}",
                **rim,
            },
        ),
    ]
    return [line for line in lines if np.isfinite(line.duration + line.lift).any()]


def _infeasible() -> str:
    return "infeasible: too short for the lift"


def _unclear() -> str:
    return f"left out: charge below {100 * CLEAR_SHARE:g} % of largest"


def _title(quantity: Quantity, speed_rpm: float) -> str:
    name = _NAMES[quantity][0]
    return f"{name[0].upper()}{name[1:]} at {speed_rpm:g} rpm, opening at TDC, wide open"
