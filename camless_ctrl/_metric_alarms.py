"""Metrics of the alarms: how soon they come, and whether they come for nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant._checks import in_range, one_of, whole

from ._metric import Measured, Metric, check_window
from ._metric_events import Events, fault_of
from .alarms import Alarm

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult

_ANY = "any"
_NAMES = (_ANY, *(str(alarm.name).lower() for alarm in Alarm))


@dataclass(frozen=True)
class AlarmTime(Metric):
    """Events from the start of a fault until an alarm stands.

    Parameters
    ----------
    alarm : str
        Name of an `Alarm` in small letters, or ``"any"``.
    fault : int
        Number of the fault in the scenario, from 1.
    """

    kind: ClassVar[str] = "alarm-time"
    unit: ClassVar[str] = "events"
    description: ClassVar[str] = "events from the start of a fault until an alarm stands"

    alarm: str
    fault: int = 1

    def __post_init__(self) -> None:
        one_of("alarm", self.alarm, _NAMES)
        whole("fault", self.fault, 1, 1000)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the number of events, infinite if the alarm never stands, with its event."""
        events, fault = Events.of(result), fault_of(result, self.fault)
        start = events.first_from(fault.start)
        if start == events.size:
            return Measured(math.nan, note=f"the run ends before fault {self.fault} begins")
        standing = stands(result.run.alarms, self.alarm)
        at = np.flatnonzero(standing[start:])
        if at.size == 0:
            note = f"{self.alarm} alarm never stands after {fault}"
            return events.at(math.inf, start, note, alone=False)
        event = start + int(at[0])
        note = f"{self.alarm} alarm after {fault}"
        if start > 0 and standing[start - 1] and event == start:
            note = f"{self.alarm} alarm stood before {fault}"
        return events.at(float(at[0]), event, note, alone=False)


@dataclass(frozen=True)
class FalseAlarms(Metric):
    """Events at which an alarm stands while no fault acts.

    Parameters
    ----------
    margin_s : float
        Time after the end of each fault in which its alarms may still stand, s.
    from_s, until_s : float
        Stretch of time that counts, s; from the first event of the warm-up on by default.
    """

    kind: ClassVar[str] = "false-alarms"
    unit: ClassVar[str] = "events"
    description: ClassVar[str] = "events at which an alarm stands while no fault acts"

    margin_s: float = 1.0
    from_s: float = -math.inf
    until_s: float = math.inf

    def __post_init__(self) -> None:
        in_range("margin_s", self.margin_s, 0.0, 1e6, "s")
        check_window(self.from_s, self.until_s)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the number of events, with the first of them."""
        events = Events.of(result)
        inside = events.within(self.from_s, self.until_s)
        for fault in result.scenario.faults:
            inside &= ~events.within(fault.start, fault.end + self.margin_s)
        if not inside.any():
            return Measured(math.nan, note="no events without a fault in this time")
        bad = np.flatnonzero(inside & (result.run.alarms != 0))
        if bad.size == 0:
            return Measured(0.0, note=f"{np.count_nonzero(inside)} events without a fault")
        names = ", ".join(Alarm(int(result.run.alarms[bad[0]])).names)
        return events.at(float(bad.size), int(bad[0]), f"first: {names}", alone=False)


def stands(alarms: np.ndarray, name: str) -> np.ndarray:
    """Return at which events an alarm stands, (m,) of bool; ``"any"`` asks for one of all."""
    mask = sum(Alarm) if name == _ANY else Alarm[name.upper()]
    return np.asarray((alarms & int(mask)) != 0)
