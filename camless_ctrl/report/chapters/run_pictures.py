"""Light pictures of closed-loop runs for the page: bins of cycles instead of single events."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from camless_ctrl.alarms import Mode
from plant._plotting import COLOURS, styled
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from camless_ctrl.scenario_result import ScenarioResult

BINS = 160  # most bins of a run, so that its picture stays small
_MODES = {Mode.DEGRADED: "#E69F00", Mode.SAFE: "#D55E00"}


def light_picture(result: ScenarioResult) -> Figure:
    """Draw charge of each cylinder, charge error, and speed if it changes, binned by cycles.

    The band reaches from the lowest to the highest error of single events in a bin; modes other
    than normal are shaded, faults are marked above.
    """
    import matplotlib.pyplot as plt

    run, n = result.run, result.run.n_cylinders
    shown = np.flatnonzero(run.time >= 0.0)
    each = n * max(-(-shown.size // (n * BINS)), 1)  # events of a bin, whole cycles
    time = run.time[shown[::each]]

    def binned(values: FloatArray) -> FloatArray:
        """Rows of bins; NaN where the last one is not full."""
        rows = np.full(time.size * each, math.nan)
        rows[: shown.size] = values[shown]
        return rows.reshape(-1, each)

    with styled():
        speeds = _mean(binned(run.speed_rpm))
        heights = (2.0, 2.0, 1.0) if np.ptp(run.speed_rpm[shown]) > 0.0 else (2.0, 2.0)
        figure, panels = plt.subplots(
            len(heights), 1, sharex=True, figsize=(8.5, sum(heights)), height_ratios=heights
        )
        charge, error = panels[:2]
        demand = binned(np.where(run.demand > 0.0, run.demand, math.nan))
        for i in range(1, n + 1):
            own = binned(np.where(run.cylinder == i, run.charge, math.nan))
            charge.plot(time, 1e6 * _mean(own), lw=1.1, label=f"cylinder {i}")
        charge.plot(time, 1e6 * _mean(demand), "k--", lw=0.9, label="demand")
        charge.set_ylabel("air charge (mg)")
        off = np.full(run.time.size, math.nan)
        np.divide(run.charge, run.demand, out=off, where=run.demand > 0.0)
        parts = 100.0 * (binned(off) - 1.0)
        low, high = np.fmin.reduce(parts, axis=1), np.fmax.reduce(parts, axis=1)
        error.fill_between(time, low, high, color=COLOURS[0], alpha=0.3, lw=0, label="events")
        error.plot(time, _mean(parts), c=COLOURS[0], label=f"mean of {each} events")
        error.set_ylabel("charge error (%)")
        for mode, colour in _MODES.items():
            there = (binned(run.mode) == mode).any(axis=1)
            if there.any():
                _shade(error, time, there, colour, f"{mode.name.lower()} mode")
        for fault in result.scenario.faults:
            end = min(fault.end, float(run.time[-1]))
            charge.axvspan(fault.start, end, color="0.85", lw=0, zorder=0, label=fault.kind)
        for ax in panels[2:]:
            ax.plot(time, speeds, c=COLOURS[0])
            ax.set_ylabel("speed (rpm)")
        panels[-1].set_xlabel("time (s)")
        for ax in (charge, error):
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _mean(parts: FloatArray) -> FloatArray:
    """Mean of what is known in each bin; NaN where nothing is."""
    known = np.isfinite(parts)
    count = known.sum(axis=1)
    total = np.where(known, parts, 0.0).sum(axis=1)
    return np.divide(total, count, out=np.full(count.shape, math.nan), where=count > 0)


def _shade(ax: Axes, time: FloatArray, there: FloatArray, colour: str, label: str) -> None:
    """Shade the stretches of time in which something holds."""
    step = float(time[1] - time[0]) if time.size > 1 else 1.0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], there, [False]))))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        end = time[stop] if stop < time.size else time[-1] + step
        ax.axvspan(time[start], end, color=colour, alpha=0.25, lw=0, zorder=0, label=label)
        label = "_"  # one entry of the legend
