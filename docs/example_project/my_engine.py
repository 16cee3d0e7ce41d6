"""The engine that is under test, and a figure of our own that its controller is judged by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from camless_ctrl import Measured, Metric
from plant import Engine

if TYPE_CHECKING:
    from camless_ctrl import ScenarioResult

# Three cylinders, a larger manifold and ports that flow 8 % better than those of the paper.
ENGINE = Engine.paper().replace(n_cylinders=3, manifold_volume=1.2e-3, flow_coefficient=0.0189)

# Maps for these speeds alone are made in seconds, and coarser than those for all speeds.
SPEED_RANGE_RPM = (1400.0, 1600.0)


@dataclass(frozen=True)
class DurationChange(Metric):
    """Largest change of a valve's commanded duration from one of its events to the next."""

    kind: ClassVar[str] = "duration-change"
    unit: ClassVar[str] = "deg"
    description: ClassVar[str] = "largest change of a valve's duration from event to event"

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the change in deg, and the event that it led to."""
        run = result.run
        n = run.n_cylinders  # as many events later it is the same valve's turn
        change = np.abs(run.duration_deg[n:] - run.duration_deg[:-n])
        change[run.time[n:] < 0.0] = 0.0  # the warm-up does not count
        worst = int(np.argmax(change))
        event = n + worst
        time, cylinder = float(run.time[event]), int(run.cylinder[event])
        return Measured(float(change[worst]), time, event, cylinder)
