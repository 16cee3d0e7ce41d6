"""Metric of the inequality of the cylinders' charges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant._checks import whole

from ._metric import Measured, Metric, check_cylinders, check_window
from ._metric_events import Events, mean_of_known

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult


@dataclass(frozen=True)
class Imbalance(Metric):
    """Largest ``(max - min)/mean`` of the cylinders' averaged charges at held demand.

    Every stretch of held demand counts that is longer than `after_cycles`; charges are averaged
    over the cycles that follow, at most to the end of the stretch.

    Parameters
    ----------
    after_cycles : int
        Cycles after the start of each stretch that are left out.
    average_cycles : int
        Cycles over which noise is averaged out.
    from_s, until_s : float
        Stretch of time that counts, s.
    without_cylinders : tuple of int
        Cylinders (from 1) that are left out.
    """

    kind: ClassVar[str] = "imbalance"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "largest (max - min)/mean of the cylinders' averaged charges"

    after_cycles: int = 10
    average_cycles: int = 30
    from_s: float = 0.0
    until_s: float = math.inf
    without_cylinders: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        whole("after_cycles", self.after_cycles, 0, 1_000_000)
        whole("average_cycles", self.average_cycles, 1, 1_000_000)
        check_window(self.from_s, self.until_s)
        check_cylinders(self.without_cylinders)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the imbalance in %, with the first averaged event of the farthest cylinder."""
        events = Events.of(result, self.without_cylinders)
        found = Measured(
            math.nan,
            note=f"no demand is held for more than {self.after_cycles} cycles in this time",
        )
        for start, stop in events.held(self.from_s, self.until_s):
            rows, cylinders = events.cycles(start, stop)
            part = rows[self.after_cycles : self.after_cycles + self.average_cycles]
            known = np.isfinite(part).any(axis=0)
            if np.count_nonzero(known) < 2:
                continue
            charge = 1.0 + mean_of_known(part)
            mean = float(charge[known].mean())
            value = 100.0 * float(np.ptp(charge[known])) / mean
            if not value <= found.value:
                column = int(np.nanargmax(np.abs(charge - mean)))
                event = start + self.after_cycles * events.n + column
                note = (
                    f"cylinder {cylinders[column]} is {100.0 * (charge[column] / mean - 1.0):+.3g} "
                    f"% off the mean, over {part.shape[0]} cycles"
                )
                found = events.at(value, event, note)
        return found
