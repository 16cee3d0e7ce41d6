"""Metrics of the charge error: averaged when settled, largest anywhere, first after a change."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant._checks import in_range, one_of, whole

from ._metric import Measured, Metric, check_cylinders, check_window
from ._metric_events import Events, fault_of, mean_of_known
from ._metric_held import HeldDemandMetric

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult

_WINDOWS = ("all", "before", "during", "after")


@dataclass(frozen=True)
class SteadyError(HeldDemandMetric):
    """Largest averaged charge error of a cylinder while the demand is held.

    Its parameters are those of `HeldDemandMetric`.
    """

    kind: ClassVar[str] = "steady-error"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "largest averaged charge error of a cylinder at held demand"

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the largest error in %, with the event that has most part in it."""
        events = Events.of(result, self.without_cylinders)
        found = self._nothing()
        for first, part, cylinders in self._stretches(events):
            if not np.isfinite(part).any():
                continue
            mean = mean_of_known(part)
            column = int(np.nanargmax(np.abs(mean)))
            value = 100.0 * abs(float(mean[column]))
            if not value <= found.value:
                side = math.copysign(1.0, mean[column])
                event = first + int(np.nanargmax(side * part[:, column])) * events.n + column
                note = f"{100.0 * mean[column]:+.3g} %, mean of {part.shape[0]} cycles"
                found = Measured(
                    value, float(events.time[event]), event, int(cylinders[column]), note
                )
        return found


@dataclass(frozen=True)
class WorstError(Metric):
    """Largest charge error of single events, or of means of some that follow each other.

    Parameters
    ----------
    mean_events : int
        Events of a mean; 1 takes single ones.
    from_s, until_s : float
        Stretch of time that counts, s.
    window : {"all", "before", "during", "after"}
        Which part of it, with respect to a fault.
    fault : int
        Number of that fault in the scenario, from 1.
    settle_s : float
        Time after the start (window "during") or the end (window "after") of the fault that is
        left out, s.
    without_cylinders : tuple of int
        Cylinders (from 1) that are left out.
    """

    kind: ClassVar[str] = "worst-error"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "largest charge error of single events or of means of some"

    mean_events: int = 1
    from_s: float = 0.0
    until_s: float = math.inf
    window: str = "all"
    fault: int = 1
    settle_s: float = 0.0
    without_cylinders: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        whole("mean_events", self.mean_events, 1, 1_000_000)
        check_window(self.from_s, self.until_s)
        one_of("window", self.window, _WINDOWS)
        whole("fault", self.fault, 1, 1000)
        in_range("settle_s", self.settle_s, 0.0, 1e6, "s")
        check_cylinders(self.without_cylinders)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the largest error in %, with its event (of a mean, that in its middle)."""
        events = Events.of(result, self.without_cylinders)
        inside = events.within(self.from_s, self.until_s) & self._of_fault(result, events)
        known = np.flatnonzero(inside & np.isfinite(events.error))
        groups = known[: known.size // self.mean_events * self.mean_events]
        if groups.size == 0:
            many = f"fewer than {self.mean_events}" if self.mean_events > 1 else "no"
            return Measured(math.nan, note=f"{many} events with a charge in this time")
        groups = groups.reshape(-1, self.mean_events)
        mean = events.error[groups].mean(axis=1)
        worst = int(np.argmax(np.abs(mean)))
        note = f"{100.0 * mean[worst]:+.3g} %"
        if self.mean_events > 1:
            note += f", mean of {self.mean_events} events"
        event = int(groups[worst, self.mean_events // 2])
        value = 100.0 * abs(float(mean[worst]))
        return events.at(value, event, note, alone=self.mean_events == 1)

    def _of_fault(self, result: ScenarioResult, events: Events) -> np.ndarray:
        if self.window == "all":
            return np.ones(events.size, dtype=bool)
        fault = fault_of(result, self.fault)
        if self.window == "before":
            return events.within(-math.inf, fault.start)
        if self.window == "during":
            return events.within(fault.start + self.settle_s, fault.end)
        return events.within(fault.end + self.settle_s, math.inf)


@dataclass(frozen=True)
class FirstEventsError(Metric):
    """Largest charge error of a cylinder's first event after a change of demand.

    In a ramp, every event counts until each cylinder has had one at the last demand.

    Parameters
    ----------
    from_s, until_s : float
        Stretch of time in which a change must begin to count, s.
    without_cylinders : tuple of int
        Cylinders (from 1) that are left out.
    """

    kind: ClassVar[str] = "first-events"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "largest error of a cylinder's first event after a demand change"

    from_s: float = 0.0
    until_s: float = math.inf
    without_cylinders: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        check_window(self.from_s, self.until_s)
        check_cylinders(self.without_cylinders)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the largest error in %, with its event."""
        events = Events.of(result, self.without_cylinders)
        first = np.zeros(events.size, dtype=bool)
        for change in events.changes(self.from_s, self.until_s):
            first[change.first : change.last + events.n] = True
        known = np.flatnonzero(first & np.isfinite(events.error))
        if known.size == 0:
            return Measured(math.nan, note="no event follows a change of demand in this time")
        error = events.error[known]
        worst = int(np.argmax(np.abs(error)))
        note = f"{100.0 * error[worst]:+.3g} %"
        return events.at(100.0 * abs(float(error[worst])), int(known[worst]), note)
