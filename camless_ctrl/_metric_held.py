"""What the metrics of held demand have in common: which cycles are averaged."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from plant._checks import whole
from plant.kinematics import FloatArray

from ._metric import Measured, Metric, check_cylinders, check_window
from ._metric_events import Events


@dataclass(frozen=True)
class HeldDemandMetric(Metric):
    """A figure of charges that are averaged while the demand is held.

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

    def _stretches(self, events: Events) -> Iterator[tuple[int, FloatArray, np.ndarray]]:
        """First event, relative errors of the averaged cycles, and cylinders of each stretch."""
        for start, stop in events.held(self.from_s, self.until_s):
            rows, cylinders = events.cycles(start, stop)
            part = rows[self.after_cycles : self.after_cycles + self.average_cycles]
            yield start + self.after_cycles * events.n, part, cylinders

    def _nothing(self) -> Measured:
        """What is found where no demand is held for long enough."""
        return Measured(
            math.nan,
            note=f"no demand is held for more than {self.after_cycles} cycles in this time",
        )
