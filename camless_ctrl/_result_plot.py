"""Picture of the result of a scenario: charge, error, speed, modes and alarms over time."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from plant.kinematics import FloatArray

from ._metric_alarms import stands
from .alarms import Alarm, Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .closed_loop_requirement import Verdict
    from .scenario_result import ScenarioResult

_LEAST_LIMIT, _MOST_LIMIT = 1.0, 15.0  # %, half the height of the axis of errors
_FAULT, _FAULT_ALPHA = "#56B4E9", 0.25
_MARKERS = "osD^vP"
_MODES = {Mode.DEGRADED: "#E69F00", Mode.SAFE: "#D55E00"}
_TEXT = 42  # characters of a line in a legend
_SHOWN_VERDICTS = 4


def draw(result: ScenarioResult, verdicts: Sequence[Verdict]) -> Figure:
    """See `ScenarioResult.plot`."""
    import matplotlib.pyplot as plt

    from plant._plotting import styled

    run = result.run
    shown = run.time >= 0.0 if (run.time >= 0.0).any() else run.time >= -math.inf
    failed = [verdict for verdict in verdicts if not verdict.met]
    with styled():
        figure, panels = plt.subplots(
            4, 1, sharex=True, figsize=(10.0, 9.0), height_ratios=(3.0, 2.4, 1.4, 1.5)
        )
        charge, error, speed, strip = panels
        _charge(charge, result, shown)
        _error(error, result, shown)
        _speed(speed, result, shown)
        _strip(strip, result, shown)
        for ax in panels:
            _shade(ax, result)
            _flag(ax, failed, named=ax is charge)
        start, end = float(run.time[shown][0]), float(run.time[shown][-1])
        margin = 0.01 * (end - start) or 0.01
        strip.set_xlim(start - margin, end + margin)
        strip.set_xlabel("time since the start of the profile (s)")
        for ax in panels:
            if ax.get_legend_handles_labels()[0]:
                ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        charge.set_title(_title(result, verdicts, failed), pad=20.0 if failed else 6.0)
    return figure


def _title(result: ScenarioResult, verdicts: Sequence[Verdict], failed: Sequence[Verdict]) -> str:
    """What is shown, and each requirement that is not met by its number."""
    lines = [f"{result.scenario.name}, seed {result.seed}"]
    if verdicts:
        met = len(verdicts) - len(failed)
        lines[0] += f": {met} of {len(verdicts)} requirements met"
    for k, verdict in enumerate(failed[:_SHOWN_VERDICTS], 1):
        lines += textwrap.wrap(f"{k}  {_escaped(str(verdict))}", 110, subsequent_indent="    ")
    if len(failed) > _SHOWN_VERDICTS:
        lines.append(f"and {len(failed) - _SHOWN_VERDICTS} more that are not met")
    return "\n".join(lines)


def _charge(ax: Axes, result: ScenarioResult, shown: np.ndarray) -> None:
    run = result.run
    asked = shown & (run.demand != 0.0)
    ax.step(run.time[asked], 1e6 * run.demand[asked], "k--", where="post", lw=1.2, label="demand")
    for i in range(1, run.n_cylinders + 1):
        of = shown & (run.cylinder == i)
        ax.plot(
            run.time[of],
            1e6 * run.charge[of],
            marker=_MARKERS[(i - 1) % len(_MARKERS)],
            ms=2.5,
            lw=0.7,
            label=f"cylinder {i}",
        )
    ax.set_ylabel("air charge\n(mg per event)")


def _error(ax: Axes, result: ScenarioResult, shown: np.ndarray) -> None:
    run = result.run
    error = np.full(run.time.size, math.nan)
    np.divide(run.charge, run.demand, out=error, where=run.demand != 0.0)
    error = 100.0 * (error - 1.0)
    known = shown & np.isfinite(error)
    largest = float(np.max(np.abs(error[known]))) if known.any() else _LEAST_LIMIT
    limit = min(max(1.1 * largest, _LEAST_LIMIT), _MOST_LIMIT)
    ax.axhspan(-1.0, 1.0, color="0.92", zorder=0, label="within 1 %")
    for i in range(1, run.n_cylinders + 1):
        of = shown & (run.cylinder == i)  # NaN, of a shut valve, breaks the line
        marker = _MARKERS[(i - 1) % len(_MARKERS)]
        ax.plot(run.time[of], error[of], marker=marker, ms=2.5, lw=0.7)
    beyond = known & (np.abs(error) > limit)
    if beyond.any():  # drawn on the edge, and counted
        edge = np.copysign(0.96 * limit, error[beyond])
        label = f"{np.count_nonzero(beyond)} events beyond ±{limit:g} %,\nto {largest:.3g} %"
        ax.plot(run.time[beyond], edge, "kx", ms=5, lw=0.0, label=label)
    ax.set_ylim(-limit, limit)
    ax.set_ylabel("charge error (%)")


def _speed(ax: Axes, result: ScenarioResult, shown: np.ndarray) -> None:
    run = result.run
    time, true, told = run.time[shown], run.speed_rpm[shown], run.told_speed_rpm[shown]
    ax.plot(time, true, c="#0072B2", label="speed")
    if not np.array_equal(true, told, equal_nan=True):
        ax.plot(time, told, "--", c="#D55E00", lw=1.1, label="as the controller is told")
    ax.set_ylabel("speed (rpm)")
    ax.ticklabel_format(axis="y", useOffset=False)


def _strip(ax: Axes, result: ScenarioResult, shown: np.ndarray) -> None:
    """Draw a row for the mode and one for each alarm that stands at some time."""
    from matplotlib.patches import Patch

    run = result.run
    rows = ["mode"]
    handles = []
    for mode, colour in _MODES.items():
        active = shown & (run.mode == mode)
        ax.broken_barh(_bars(run.time, active), (-0.35, 0.7), color=colour, zorder=2)
        if active.any():
            handles.append(Patch(color=colour, label=f"{mode.name.lower()} mode"))
    for alarm in Alarm:
        name = str(alarm.name).lower()
        active = shown & stands(run.alarms, name)
        if active.any():
            place = (len(rows) - 0.35, 0.7)
            ax.broken_barh(_bars(run.time, active), place, color="#0072B2", zorder=2)
            rows.append(f"{name} alarm")
    if len(rows) > 1:
        handles.append(Patch(color="#0072B2", label="alarm stands"))
    for i, fault in enumerate(result.scenario.faults, 1):
        text = textwrap.fill(f"fault {i}: {_escaped(str(fault))}", _TEXT)
        handles.append(Patch(color=_FAULT, alpha=_FAULT_ALPHA, label=text))
    ax.set_yticks(range(len(rows)), rows)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    if handles:
        ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    else:
        ax.text(0.5, 0.5, "normal mode, no alarm", transform=ax.transAxes, ha="center", va="center")


def _bars(time: FloatArray, active: np.ndarray) -> list[tuple[float, float]]:
    """Start and length of each stretch in which something is active, s."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], active, [False]))))
    last = time[-1] + (time[-1] - time[-2] if time.size > 1 else 0.0)
    ends = np.append(time, last)
    return [
        (float(time[a]), float(ends[b] - time[a]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]


def _shade(ax: Axes, result: ScenarioResult) -> None:
    end = float(result.run.time[-1])
    for fault in result.scenario.faults:
        ax.axvspan(
            fault.start, min(fault.end, end), color=_FAULT, alpha=_FAULT_ALPHA, lw=0.0, zorder=0
        )


def _flag(ax: Axes, failed: Sequence[Verdict], *, named: bool) -> None:
    """Mark the instants of requirements that are not met, by the numbers of the title."""
    for k, verdict in enumerate(failed[:_SHOWN_VERDICTS], 1):
        if not math.isfinite(verdict.time):
            continue
        ax.axvline(verdict.time, c="0.25", ls=":", lw=1.1)
        if named:
            ax.annotate(
                str(k),
                (verdict.time, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0.0, 2.0),
                textcoords="offset points",
                ha="center",
                va="bottom",
                fontsize=8,
                bbox={"boxstyle": "circle,pad=0.15", "fc": "white", "ec": "0.25"},
            )


def _escaped(text: str) -> str:
    """Text in which no dollar starts mathematics."""
    return text.replace("$", r"\$")
