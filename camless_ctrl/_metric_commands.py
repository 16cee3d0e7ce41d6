"""Metric of the commands: how many leave the limits of the valves or of their rates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant._checks import in_range, positive
from plant.kinematics import FloatArray

from ._metric import Measured, Metric, check_window

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult

_ROUNDING = 1e-9  # relative, of numbers that may lie on their bound


@dataclass(frozen=True)
class CommandViolations(Metric):
    """Events whose command leaves the limits, or changes too fast from a cylinder's last one.

    Read off the commands alone, not what the controller says about them. A lift of 0 shuts the
    valve: neither the limits nor the rates hold for it, nor the rates for the command after it.
    A command that is no number is a violation.

    Parameters
    ----------
    lowest_lift_mm, highest_lift_mm : float
        Allowed lifts, mm.
    longest_duration_deg : float
        Longest allowed duration, deg.
    lift_rate_mm : float
        Largest change of lift from one cycle to the next, mm.
    duration_rate_ms : float
        Largest change of duration from one cycle to the next, ms.
    from_s, until_s : float
        Stretch of time that counts, s; from the first event of the warm-up on by default.
    """

    kind: ClassVar[str] = "command-limits"
    unit: ClassVar[str] = "events"
    description: ClassVar[str] = "events whose command leaves its limits or changes too fast"

    lowest_lift_mm: float = 0.5  # as those of CommandLimits
    highest_lift_mm: float = 8.0
    longest_duration_deg: float = 240.0
    lift_rate_mm: float = 6.0
    duration_rate_ms: float = 20.0
    from_s: float = -math.inf
    until_s: float = math.inf

    def __post_init__(self) -> None:
        low = in_range("lowest_lift_mm", self.lowest_lift_mm, 0.0, 100.0, "mm")
        in_range("highest_lift_mm", self.highest_lift_mm, low, 100.0, "mm")
        in_range("longest_duration_deg", self.longest_duration_deg, 0.0, 720.0, "deg")
        positive("lift_rate_mm", self.lift_rate_mm, "mm per cycle")
        positive("duration_rate_ms", self.duration_rate_ms, "ms per cycle")
        check_window(self.from_s, self.until_s)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the number of events, with the one that is farthest beyond a limit."""
        run = result.run
        lift, duration_deg = run.lift_mm, run.duration_deg
        duration_ms = 1e3 * duration_deg / (6.0 * run.speed_rpm)
        shut = lift == 0.0
        share = {  # of what is allowed, 1
            "lift": _over(lift, self.highest_lift_mm),
            "low lift": _over(2.0 * self.lowest_lift_mm - lift, self.lowest_lift_mm),
            "duration": _over(duration_deg, self.longest_duration_deg),
            "negative duration": np.where(duration_deg < 0.0, math.inf, 0.0),
            "change of lift": self._rate(lift, shut, run.n_cylinders, self.lift_rate_mm),
            "change of duration": self._rate(
                duration_ms, shut, run.n_cylinders, self.duration_rate_ms
            ),
        }
        # What is no number compares as beyond every limit.
        table = np.nan_to_num(np.array(list(share.values())), nan=math.inf, posinf=math.inf)
        table = np.where(shut, 0.0, table)
        inside = (run.time >= self.from_s) & (run.time < self.until_s)
        if not inside.any():
            return Measured(math.nan, note="no events in this time")
        worst = np.where(inside, table.max(axis=0), 0.0)
        bad = worst > 1.0 + _ROUNDING
        count = float(np.count_nonzero(bad))
        if not count:
            return Measured(count, note=f"{np.count_nonzero(inside)} events within the limits")
        event = int(np.argmax(worst))
        name = list(share)[int(np.argmax(table[:, event]))]
        note = f"{name}: {lift[event]:.4g} mm for {duration_deg[event]:.4g} deg"
        cylinder = int(run.cylinder[event])
        if name.startswith("change") and event >= run.n_cylinders:
            k = event - run.n_cylinders
            note += f" after {lift[k]:.4g} mm for {duration_deg[k]:.4g} deg"
        return Measured(count, float(run.time[event]), event, cylinder, note)

    @staticmethod
    def _rate(values: FloatArray, shut: np.ndarray, n: int, most: float) -> FloatArray:
        """Change from the last command of the same cylinder over the largest allowed one, 1."""
        found = np.zeros(values.size)
        counts = ~(shut[n:] | shut[:-n]) & np.isfinite(values[:-n])
        found[n:] = np.where(counts, np.abs(values[n:] - values[:-n]) / most, 0.0)
        return found


def _over(values: FloatArray, most: float) -> FloatArray:
    """Values over the largest allowed one; infinite beyond it if that is 0."""
    if most == 0.0:
        return np.where(values > 0.0, math.inf, 0.0)
    return np.asarray(values / most)
