"""The events of a run as metrics look at them: errors, changes of the demand, fault windows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plant.errors import ParameterError
from plant.kinematics import FloatArray

from ._metric import Measured

if TYPE_CHECKING:
    from .faults import Fault
    from .scenario_result import ScenarioResult

_SAME_TIME = 1e-9  # s, by which the time of an event may miss an edge that it is on


class DemandChange(NamedTuple):
    """A step or a ramp of the demand; changes at most a cycle apart belong together.

    Attributes
    ----------
    first, last : int
        Events with the first and the last new value; equal for a step.
    stop : int
        First event of the next change, or the number of events.
    before, after : float
        Demand before and after, kg.
    """

    first: int
    last: int
    stop: int
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class Events:
    """The events of a run.

    Attributes
    ----------
    n : int
        Number of cylinders.
    time, demand, charge : ndarray (m,)
        s, kg, kg.
    cylinder : ndarray (m,) of int
        From 1.
    error : ndarray (m,)
        Charge over demand less 1; NaN for events that did not end in the run, whose valve was to
        stay shut, or whose cylinder is left out.
    """

    n: int
    time: FloatArray = field(repr=False)
    demand: FloatArray = field(repr=False)
    charge: FloatArray = field(repr=False)
    cylinder: np.ndarray = field(repr=False)
    error: FloatArray = field(repr=False)

    @classmethod
    def of(cls, result: ScenarioResult, without_cylinders: tuple[int, ...] = ()) -> Events:
        """Return the events of a result; the charges of some cylinders may be left out.

        Raises
        ------
        ParameterError
            If a cylinder that is to be left out is none of the engine.
        """
        run = result.run
        for cylinder in without_cylinders:
            if not 1 <= cylinder <= run.n_cylinders:
                raise ParameterError(
                    f"without_cylinders names cylinder {cylinder}, but the engine has "
                    f"{run.n_cylinders}: name one from 1 to {run.n_cylinders}"
                )
        asked = (run.demand != 0.0) & ~np.isin(run.cylinder, without_cylinders)
        error = np.full(run.demand.size, math.nan)
        np.divide(run.charge, run.demand, out=error, where=asked)
        return cls(run.n_cylinders, run.time, run.demand, run.charge, run.cylinder, error - 1.0)

    @property
    def size(self) -> int:
        """Number of events."""
        return int(self.time.size)

    def first_from(self, seconds: float) -> int:
        """Return the first event at or after a time; the number of events if there is none."""
        return int(np.searchsorted(self.time, seconds - _SAME_TIME))

    def within(self, from_s: float, until_s: float) -> np.ndarray:
        """Return which events are at or after one time and before another, (m,) of bool."""
        inside = self.time >= from_s - _SAME_TIME
        return inside & (self.time < until_s - _SAME_TIME)

    def changes(self, from_s: float = 0.0, until_s: float = math.inf) -> list[DemandChange]:
        """Return the changes of the demand that begin in a stretch of time.

        A demand of 0 shuts a valve, and is no change of what is asked of the engine: the demand
        of the events around it holds.
        """
        found = self._all_changes()
        inside = self.within(from_s, until_s)
        return [change for change in found if inside[change.first]]

    def _all_changes(self) -> list[DemandChange]:
        asked = np.flatnonzero(self.demand)
        if asked.size == 0:
            return []
        # Each event takes the demand of the last one with any, the first events that of the first.
        latest = np.searchsorted(asked, np.arange(self.size), side="right") - 1
        demand = self.demand[asked[np.maximum(latest, 0)]]
        at = np.flatnonzero(np.diff(demand)) + 1
        if at.size == 0:
            return []
        groups = np.split(at, np.flatnonzero(np.diff(at) > self.n) + 1)
        stops = [*(int(group[0]) for group in groups[1:]), self.size]
        return [
            DemandChange(
                int(group[0]),
                int(group[-1]),
                stop,
                float(demand[group[0] - 1]),
                float(demand[group[-1]]),
            )
            for group, stop in zip(groups, stops, strict=True)
        ]

    def held(self, from_s: float, until_s: float) -> list[tuple[int, int]]:
        """Return the stretches of held demand in a stretch of time: first event and end.

        The first begins at `from_s`, whether or not the demand changes there.
        """
        begin, end = self.first_from(from_s), self.first_from(until_s)
        stretches, start = [], begin
        for change in self._all_changes():
            if change.first >= end:
                break
            if change.first > begin:
                stretches.append((start, change.first))
            if change.last > begin:
                start = max(start, change.last)
        if start < end:
            stretches.append((start, end))
        return [(a, b) for a, b in stretches if a < b]

    def cycles(self, first: int, stop: int) -> tuple[FloatArray, np.ndarray]:
        """Return the errors of whole cycles, and the cylinder of each column.

        Parameters
        ----------
        first, stop : int
            First event, and the event at which the stretch ends.

        Returns
        -------
        ndarray (cycles, n), ndarray (n,) of int
            Errors, 1; cylinders, from 1.
        """
        whole = (stop - first) // self.n * self.n
        rows = self.error[first : first + whole].reshape(-1, self.n)
        return rows, self.cylinder[first : first + self.n]

    def at(self, value: float, event: int, note: str = "", *, alone: bool = True) -> Measured:
        """Return a figure with the place of an event; `alone`: with its cylinder."""
        cylinder = int(self.cylinder[event]) if alone else None
        return Measured(value, float(self.time[event]), event, cylinder, note)


def mean_of_known(values: FloatArray, axis: int = 0) -> FloatArray:
    """Mean over an axis of what is not NaN; NaN where nothing is."""
    known = np.isfinite(values)
    count = np.count_nonzero(known, axis=axis)
    total = np.sum(np.where(known, values, 0.0), axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), math.nan)


def fault_of(result: ScenarioResult, number: int) -> Fault:
    """Return a fault of the scenario by its number, from 1.

    Raises
    ------
    ParameterError
        If there is none of that number.
    """
    faults = result.scenario.faults
    if not 1 <= number <= len(faults):
        raise ParameterError(
            f"fault is {number}, but the scenario has {len(faults)}: give a number from 1 to "
            f"{len(faults)}"
            if faults
            else f"fault is {number}, but the scenario has none: leave the requirement out, or "
            "add a fault"
        )
    return faults[number - 1]
