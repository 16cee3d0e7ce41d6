"""Metrics of the way to a new demand: how long it takes, and how far beyond it goes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant._checks import in_range, positive, whole

from ._metric import Measured, Metric, check_cylinders, check_window
from ._metric_events import DemandChange, Events, mean_of_known

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult


@dataclass(frozen=True)
class Settling(Metric):
    """Cycles until every cylinder stays within a tolerance.

    Parameters
    ----------
    tolerance_percent : float
        Charge error that is allowed, %.
    average_cycles : int
        Cycles over which each error is averaged.
    from_s : float or None
        Time from which cycles are counted, s; None counts from the last change of demand (from
        its end, if it is a ramp), or from the start if there is none.
    until_s : float
        Time at which the errors must no longer be kept, s.
    without_cylinders : tuple of int
        Cylinders (from 1) that are left out.
    """

    kind: ClassVar[str] = "settling"
    unit: ClassVar[str] = "cycles"
    description: ClassVar[str] = "cycles until every cylinder's averaged error stays small"

    tolerance_percent: float = 1.0
    average_cycles: int = 5
    from_s: float | None = None
    until_s: float = math.inf
    without_cylinders: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        positive("tolerance_percent", self.tolerance_percent, "%")
        whole("average_cycles", self.average_cycles, 1, 100_000)
        check_window(0.0 if self.from_s is None else self.from_s, self.until_s)
        check_cylinders(self.without_cylinders)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the cycles, infinite if it does not settle, with the last event outside."""
        events = Events.of(result, self.without_cylinders)
        start, stop = self._start(events), events.first_from(self.until_s)
        rows, _ = events.cycles(start, stop)
        if rows.shape[0] < self.average_cycles or not np.isfinite(rows).any():
            note = f"fewer than {self.average_cycles} cycles with a charge to average"
            return Measured(math.nan, note=note)
        windows = np.lib.stride_tricks.sliding_window_view(rows, self.average_cycles, axis=0)
        error = 100.0 * np.abs(mean_of_known(windows, axis=-1))
        bad = np.nan_to_num(error) > self.tolerance_percent
        outside = np.flatnonzero(bad.any(axis=1))
        if outside.size == 0:
            return events.at(0.0, start, "settled from the start", alone=False)
        last = int(outside[-1])
        column = int(np.nanargmax(error[last]))
        event = start + (last + self.average_cycles // 2) * events.n + column
        note = f"last outside with {error[last, column]:.3g} %"
        settled = last + 1.0
        if last + 1 == error.shape[0]:
            settled, note = math.inf, f"does not settle: {error[last, column]:.3g} % at the end"
        return events.at(settled, event, note)

    def _start(self, events: Events) -> int:
        if self.from_s is not None:
            return events.first_from(self.from_s)
        changes = events.changes(0.0, self.until_s)
        return changes[-1].last if changes else events.first_from(0.0)


@dataclass(frozen=True)
class Overshoot(Metric):
    """How far the charge goes beyond a new demand, in percent of the change of demand.

    Parameters
    ----------
    average_cycles : int
        Cycles of a cylinder over which its charge is averaged; 1 takes single events.
    least_change_percent : float
        Change of demand, in % of the new one, below which a change does not count.
    from_s, until_s : float
        Stretch of time in which a change must begin to count, s.
    without_cylinders : tuple of int
        Cylinders (from 1) that are left out.
    """

    kind: ClassVar[str] = "overshoot"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "charge beyond the new demand, of the change of demand"

    average_cycles: int = 1
    least_change_percent: float = 5.0
    from_s: float = 0.0
    until_s: float = math.inf
    without_cylinders: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        whole("average_cycles", self.average_cycles, 1, 100_000)
        in_range("least_change_percent", self.least_change_percent, 0.0, 1e6, "%")
        check_window(self.from_s, self.until_s)
        check_cylinders(self.without_cylinders)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the largest overshoot in %, 0 if there is none, with its event."""
        events = Events.of(result, self.without_cylinders)
        found = Measured(math.nan, note="no change of demand that counts in this time")
        for change in events.changes(self.from_s, self.until_s):
            size = abs(change.after - change.before)
            if 100.0 * size < self.least_change_percent * change.after:
                continue
            beyond, event = self._beyond(events, change)
            value = 100.0 * max(beyond, 0.0) * change.after / size
            if math.isfinite(value) and not value <= found.value:
                step = f"{1e6 * change.before:.0f} to {1e6 * change.after:.0f} mg"
                found = events.at(value, event, f"step {step}")
        return found

    def _beyond(self, events: Events, change: DemandChange) -> tuple[float, int]:
        """Error in the direction of a change, 1, and the event; NaN without a charge."""
        side = math.copysign(1.0, change.after - change.before)
        rows, _ = events.cycles(change.last, change.stop)
        if rows.shape[0] < self.average_cycles:
            return math.nan, change.last
        windows = np.lib.stride_tricks.sliding_window_view(rows, self.average_cycles, axis=0)
        error = side * mean_of_known(windows, axis=-1)
        if not np.isfinite(error).any():
            return math.nan, change.last
        row, column = divmod(int(np.nanargmax(error)), events.n)
        event = change.last + (row + self.average_cycles // 2) * events.n + column
        return float(error[row, column]), event
