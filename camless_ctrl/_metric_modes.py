"""Metrics of the controller's modes: how much is not normal, the return, and its bump."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant._checks import whole

from ._metric import Measured, Metric, check_cylinders, check_window
from ._metric_events import Events, fault_of
from .alarms import Mode

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult


@dataclass(frozen=True)
class ModeShare(Metric):
    """Share of the events at which the controller is not in its normal mode.

    Parameters
    ----------
    from_s, until_s : float
        Stretch of time that counts, s.
    """

    kind: ClassVar[str] = "mode-share"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "share of the events that are not in the normal mode"

    from_s: float = 0.0
    until_s: float = math.inf

    def __post_init__(self) -> None:
        check_window(self.from_s, self.until_s)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the share in %, with the first event that is not in the normal mode."""
        events, mode = Events.of(result), result.run.mode
        inside = events.within(self.from_s, self.until_s)
        if not inside.any():
            return Measured(math.nan, note="no events in this time")
        other = np.flatnonzero(inside & (mode != Mode.NORMAL))
        if other.size == 0:
            return Measured(0.0, note="always in the normal mode")
        share = 100.0 * other.size / np.count_nonzero(inside)
        note = f"first: {Mode(int(mode[other[0]])).name.lower()}"
        return events.at(share, int(other[0]), note, alone=False)


@dataclass(frozen=True)
class ModeTime(Metric):
    """Events from the end of a fault until the controller is in its normal mode for good.

    Parameters
    ----------
    fault : int
        Number of the fault in the scenario, from 1.
    until_s : float
        Time at which it need no longer be, s: say, of the next fault.
    """

    kind: ClassVar[str] = "mode-time"
    unit: ClassVar[str] = "events"
    description: ClassVar[str] = "events from the end of a fault until the mode stays normal"

    fault: int = 1
    until_s: float = math.inf

    def __post_init__(self) -> None:
        whole("fault", self.fault, 1, 1000)
        check_window(-math.inf, self.until_s)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the number of events, infinite if it does not return, with the first normal."""
        events, fault = Events.of(result), fault_of(result, self.fault)
        start, stop = events.first_from(fault.end), events.first_from(self.until_s)
        if start >= stop:
            return Measured(math.nan, note=f"no events after the end of {fault}")
        other = np.flatnonzero(result.run.mode[start:stop] != Mode.NORMAL)
        event = start + int(other[-1]) + 1 if other.size else start
        if event == stop:
            note = f"{Mode(int(result.run.mode[stop - 1])).name.lower()} at the end"
            return events.at(math.inf, stop - 1, note, alone=False)
        return events.at(float(event - start), event, f"normal after {fault}", alone=False)


@dataclass(frozen=True)
class RecoveryBump(Metric):
    """Largest change of a cylinder's charge when the controller returns to its normal mode.

    Charges are taken relative to their demands, so that a change of demand is no bump, and each
    is compared with that of the cylinder's event before.

    Parameters
    ----------
    around_cycles : int
        Cycles before and after each return that are looked at.
    from_s, until_s : float
        Stretch of time in which returns count, s.
    without_cylinders : tuple of int
        Cylinders (from 1) that are left out.
    """

    kind: ClassVar[str] = "recovery-bump"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "largest change of charge that the return to normal mode makes"

    around_cycles: int = 5
    from_s: float = 0.0
    until_s: float = math.inf
    without_cylinders: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        whole("around_cycles", self.around_cycles, 1, 10_000)
        check_window(self.from_s, self.until_s)
        check_cylinders(self.without_cylinders)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the largest change in % of the demand, with the event after it."""
        events = Events.of(result, self.without_cylinders)
        normal = result.run.mode == Mode.NORMAL
        back = np.zeros(events.size, dtype=bool)
        back[1:] = normal[1:] & ~normal[:-1]
        returns = np.flatnonzero(back & events.within(self.from_s, self.until_s))
        if returns.size == 0:
            return Measured(math.nan, note="the mode never returns to normal in this time")
        n, width = events.n, self.around_cycles * events.n
        change = np.full(events.size, math.nan)
        change[n:] = events.error[n:] - events.error[:-n]
        near = np.zeros(events.size, dtype=bool)
        for k in returns:
            near[max(k - width, 0) : k + width + 1] = True
        known = np.flatnonzero(near & np.isfinite(change))
        if known.size == 0:
            return Measured(math.nan, note="no charges around the return to the normal mode")
        event = int(known[np.argmax(np.abs(change[known]))])
        value = 100.0 * float(change[event])
        nearest = returns[np.argmin(np.abs(returns - event))]
        note = f"{value:+.3g} %, return at {events.time[nearest]:.3g} s"
        return events.at(abs(value), event, note)
