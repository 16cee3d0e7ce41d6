"""Pictures of the result of a delta."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError
from plant._checks import one_of
from plant._plotting import axes, styled
from plant.kinematics import FloatArray

from ._delta_quantities import QUANTITIES, Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .delta_result import Bound, DeltaResult

# quantity, colour (Okabe and Ito), hatch and line style of the envelopes
_LOOKS: tuple[tuple[Quantity, str, str, str], ...] = (
    ("loss", "#D55E00", "//", "--"),
    ("charge", "#0072B2", "", "-"),
)
_COLOURS = 21  # of a map: Matplotlib draws a colour bar of many more as a bitmap
_TITLES: dict[Bound, str] = {
    "worst": "largest change of any case",
    "lowest": "lowest change of the cases",
    "highest": "highest change of the cases",
}


def envelope_plot(result: DeltaResult, ax: Axes | None) -> Axes:
    """Draw the envelopes of charge and loss over speed and return the axes."""
    envelope = result.over_speed()
    speed = envelope["speed"].to_numpy()
    with styled():
        ax = axes(ax)
        for quantity, colour, hatch, style in _LOOKS:
            low, high, rms = 100.0 * envelope[quantity].to_numpy()
            ax.fill_between(
                speed,
                low,
                high,
                facecolor=colour,
                edgecolor=colour,
                hatch=hatch,
                alpha=0.25,
                label=f"{QUANTITIES[quantity]}: lowest to highest",
            )
            ax.plot(speed, rms, style, c=colour, label=f"{QUANTITIES[quantity]}: rms")
        ax.axhline(0.0, color="0.3", lw=0.8)
        ax.set_xlabel("speed (rpm)")
        ax.set_ylabel("relative change (%)")
        ax.set_title(f"{_short(result.name)}: change over all cases, lifts and durations")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def map_plot(
    result: DeltaResult,
    quantity: Quantity,
    speed_rpm: float | None,
    bound: Bound,
    ax: Axes | None,
) -> Axes:
    """Draw the change over lift and duration at a speed and return the axes."""
    one_of("quantity", quantity, QUANTITIES)
    one_of("bound", bound, _TITLES)
    speed = result.worst(quantity).at.speed_rpm if speed_rpm is None else speed_rpm
    known = result.dataset["speed"].to_numpy()
    if speed not in known:
        raise ParameterError(
            f"speed_rpm is {speed!r}, but must be a speed of the grid, one of {known.tolist()} rpm"
        )
    low, high = (
        100.0 * f(quantity).sel(speed=speed).transpose("lift", "duration").to_numpy()
        for f in (result.lower, result.upper)
    )
    change: FloatArray = {
        "lowest": low,
        "highest": high,
        "worst": np.where(-low > high * (1.0 + 1e-9), low, high),
    }[bound]
    import matplotlib

    lifts, durations = (result.dataset[dim].to_numpy() for dim in ("lift", "duration"))
    known_changes = np.abs(change[np.isfinite(change)])
    most = max(float(known_changes.max()), 1e-9) if known_changes.size else 1.0
    with styled():
        ax = axes(ax, (7.2, 3.2))
        ax.grid(visible=False)
        ax.set_facecolor("0.88")
        image = ax.pcolormesh(
            _edges(durations),
            _edges(lifts),
            np.ma.masked_invalid(change),
            cmap=matplotlib.colormaps["PuOr_r"].resampled(_COLOURS),
            vmin=-most,
            vmax=most,
            edgecolors="white",
            linewidth=0.5,
            rasterized=False,
        )
        for i, j in np.argwhere(np.isfinite(change)):
            value = change[i, j]
            ax.text(
                durations[j],
                lifts[i],
                f"{value:+.{1 if most < 10.0 else 0}f}".replace("-", "\N{MINUS SIGN}"),
                ha="center",
                va="center",
                fontsize=7.5,
                color="white" if abs(value) > 0.6 * most else "black",
            )
        assert ax.figure is not None
        ax.figure.colorbar(image, ax=ax, label="relative change (%)")
        ax.set_xticks(durations)
        ax.set_yticks(lifts)
        ax.set_xlabel("duration (deg)")
        ax.set_ylabel("lift (mm)")
        ax.set_title(
            f"{_short(result.name)}, {QUANTITIES[quantity]} at {speed:.0f} rpm:\n{_TITLES[bound]} "
            "(grey: not feasible)"
        )
    return ax


def _short(name: str) -> str:
    return name if len(name) < 40 else f"{name.split(' + ')[0]} and others"


def _edges(values: FloatArray) -> FloatArray:
    """Edges of cells around values: the middles between them."""
    if values.size == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middles = 0.5 * (values[1:] + values[:-1])
    first, last = 2.0 * values[0] - middles[0], 2.0 * values[-1] - middles[-1]
    return np.concatenate(([first], middles, [last]))
