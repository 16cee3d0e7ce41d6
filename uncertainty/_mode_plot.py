"""Picture of modes: gain and phase over the angle per event, a band for each mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError
from plant._plotting import COLOURS, styled
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ._lifted_data import LiftedData

STYLES = ("-", "--", "-.", ":")


def plot_modes(data: LiftedData, figure: Figure | None = None, *, label: str = "") -> Figure:
    """Draw gain and phase of the modes of lifted data; see `LiftedData.plot`."""
    import matplotlib.pyplot as plt

    n, before = data.n_cylinders, 0  # plants drawn before
    with styled():
        if figure is None:
            figure, _ = plt.subplots(2, 1, sharex=True, figsize=(6.8, 4.6))
        if len(figure.axes) != 2:
            raise ParameterError(
                f"the figure has {len(figure.axes)} axes, but must have 2, of gain and phase: "
                "give one that plot() returned"
            )
        gain, phase = figure.axes
        before = sum(str(line.get_label()).startswith("mode 0") for line in gain.lines)
        style, end = STYLES[before % len(STYLES)], 0.0
        for q in range(n // 2 + 1):
            angle, values = band(data, q)
            name = f"mode {q}" + (f", {label}" if label else "")
            colour = COLOURS[q % len(COLOURS)]
            gain.plot(np.degrees(angle), np.abs(values), style, c=colour, label=name)
            turned = np.degrees(np.unwrap(np.angle(values)))
            turned -= 360.0 * np.round((turned[0] - end) / 360.0)  # go on from the last band
            end = turned[-1]
            phase.plot(np.degrees(angle), turned, style, c=colour)
        if before == 0:
            mark_modes(gain, n)
            mark_modes(phase, n)
            gain.set_ylabel("gain (1)" if _relative(data) else "gain (own units)")
            phase.set_ylabel("phase (deg)")
            phase.set_xlabel("angle per event (deg)")
            gain.set_title(data.title)
        gain.set_ylim(bottom=0.0)
        gain.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def band(data: LiftedData, q: int) -> tuple[FloatArray, ComplexArray]:
    """Angles per event of a mode between 0 and pi (rad), and the response there."""
    theta, values = data.mode_band(q)
    angle = (theta + 2.0 * np.pi * q) / data.n_cylinders
    shown = (angle >= -1e-9) & (angle <= np.pi + 1e-9)
    return angle[shown], values[shown]


def mark_modes(ax: Axes, n: int) -> None:
    """Mark the angle of each mode's steady pattern."""
    for q in range(n // 2 + 1):
        ax.axvline(360.0 * q / n, color="0.55", lw=0.8, ls=(0, (1, 2)), zorder=0)
    ax.set_xlim(-2.0, 182.0)
    ax.set_xticks(np.arange(0.0, 181.0, 45.0))


def _relative(data: LiftedData) -> bool:
    return bool(getattr(data, "relative", True))
