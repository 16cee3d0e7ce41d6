"""Metric of the inequality of the cylinders' charges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ._metric import Measured
from ._metric_events import Events, mean_of_known
from ._metric_held import HeldDemandMetric

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult


@dataclass(frozen=True)
class Imbalance(HeldDemandMetric):
    """Largest ``(max - min)/mean`` of the cylinders' averaged charges at held demand.

    Its parameters are those of `HeldDemandMetric`.
    """

    kind: ClassVar[str] = "imbalance"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "largest (max - min)/mean of the cylinders' averaged charges"

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the imbalance in %, with the first averaged event of the farthest cylinder."""
        events = Events.of(result, self.without_cylinders)
        found = self._nothing()
        for first, part, cylinders in self._stretches(events):
            known = np.isfinite(part).any(axis=0)
            if np.count_nonzero(known) < 2:
                continue
            charge = 1.0 + mean_of_known(part)
            mean = float(charge[known].mean())
            value = 100.0 * float(np.ptp(charge[known])) / mean
            if not value <= found.value:
                column = int(np.nanargmax(np.abs(charge - mean)))
                event = first + column
                note = (
                    f"cylinder {cylinders[column]} is {100.0 * (charge[column] / mean - 1.0):+.3g} "
                    f"% off the mean, over {part.shape[0]} cycles"
                )
                found = events.at(value, event, note)
        return found
