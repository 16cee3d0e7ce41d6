"""Pictures of the optimal path."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from plant._plotting import COLOURS, axes, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .optimal_path import OptimalPath

Line = Literal["lift_mm", "duration_deg"]

_SPEEDS_RPM = (750.0, 1500.0, 2400.0, 3000.0, 4500.0, 6000.0)
_POINTS = 301
_LABELS = {
    "lift_mm": "lift (mm)",
    "duration_deg": "duration (deg)",
    "given_up": "given up (%)",
}
_TITLES = {
    "lift_mm": "Lift of least pumping loss",
    "duration_deg": "Duration of least pumping loss",
    "given_up": "Loss given up for continuity",
}
_LEVELS_PERCENT = (0.0, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)


def draw_lines(
    path: OptimalPath, what: Line, ax: Axes | None, speeds_rpm: ArrayLike | None
) -> Axes:
    """Lift or duration over charge, a line a speed."""
    if speeds_rpm is None:
        low, high = path.speeds_rpm[[0, -1]]
        speeds = np.array([n for n in _SPEEDS_RPM if low <= n <= high])
        speeds = speeds if speeds.size else path.speeds_rpm[[0, -1]]
    else:
        speeds = np.atleast_1d(np.asarray(speeds_rpm, dtype=float))
    point = path.at(np.linspace(0.0, 1.0, _POINTS), speeds[:, None])
    with styled():
        ax = axes(ax)
        for k, speed in enumerate(speeds.tolist()):
            ax.plot(
                1e6 * point.charge[k],
                getattr(point, what)[k],
                color=COLOURS[k % len(COLOURS)],
                label=f"{speed:g} rpm",
            )
        ax.set_xlabel("air charge (mg per event)")
        ax.set_ylabel(_LABELS[what])
        ax.set_title(_TITLES[what])
        ax.legend()
    return ax


def draw_contours(
    path: OptimalPath, what: Literal["lift_mm", "duration_deg", "given_up"], ax: Axes | None
) -> Axes:
    """Lift, duration, or what is given up, over speed and charge."""
    speed = np.broadcast_to(path.speeds_rpm[:, None], path.charge.shape)
    if what == "given_up":
        values, levels = 100.0 * np.maximum(path.certificates.given_up, 0.0), [*_LEVELS_PERCENT]
    else:
        values, levels = getattr(path, what), None
    with styled():
        ax = axes(ax)
        field = ax.contourf(speed, 1e6 * path.charge, values, levels=levels, extend="max")
        ax.figure.colorbar(field, ax=ax, label=_LABELS[what])
        ax.set_xlabel("engine speed (rpm)")
        ax.set_ylabel("air charge (mg per event)")
        ax.set_title(_TITLES[what])
    return ax
