"""Metric of the pumping loss, against the least one that the full plant can have."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant import CrankAnglePlant, Engine
from plant._checks import whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray

from ._metric import Measured, Metric, check_window
from ._metric_events import Events, mean_of_known

if TYPE_CHECKING:
    from .loss_reference import LossReference
    from .scenario_result import ScenarioResult

_CONDITIONS = ("ambient_pressure", "temperature", "exhaust_pressure", "flow_factor")
_STEADY = 1e-9  # relative change of what counts as constant


@dataclass(frozen=True)
class LossExcess(Metric):
    """Averaged pumping loss over the least one of the full plant at the same charge, less 1.

    Measured on the last stretch of held demand; speed and boundary conditions must be constant
    there. The least loss of each cylinder is found by a direct search on the true plant with all
    cylinders like it, throttle wide open, within the default limits of the motions. The search
    takes some seconds, and is remembered.

    Parameters
    ----------
    after_cycles : int
        Cycles after the start of the stretch that are left out.
    average_cycles : int
        Cycles over which noise is averaged out.
    from_s, until_s : float
        Stretch of time that counts, s.
    """

    kind: ClassVar[str] = "loss-excess"
    unit: ClassVar[str] = "%"
    description: ClassVar[str] = "averaged pumping loss over the least one at the same charge"

    after_cycles: int = 20
    average_cycles: int = 30
    from_s: float = 0.0
    until_s: float = math.inf

    def __post_init__(self) -> None:
        whole("after_cycles", self.after_cycles, 0, 1_000_000)
        whole("average_cycles", self.average_cycles, 1, 1_000_000)
        check_window(self.from_s, self.until_s)

    def measure(self, result: ScenarioResult) -> Measured:
        """Return the excess in %, with the first averaged event of the cylinder that has most."""
        events, run = Events.of(result), result.run
        stretches = events.held(self.from_s, self.until_s)
        start, stop = stretches[-1] if stretches else (0, 0)
        first, n = start + self.after_cycles * events.n, events.n
        cycles = min((stop - first) // n, self.average_cycles)
        if cycles < 1:
            note = f"the last demand is not held for more than {self.after_cycles} cycles"
            return Measured(math.nan, note=note)
        part = slice(first, first + cycles * n)
        speed, demand = run.speed_rpm[part], events.demand[part]
        asked = float(demand.max())
        if asked == 0.0 or np.ptp(speed) > _STEADY * speed[0]:
            note = "no valve opens" if asked == 0.0 else "the speed is not constant"
            return Measured(math.nan, note=f"{note} while losses are averaged")
        try:
            engine = _engine(result, part)
        except _NotConstantError as error:
            return Measured(math.nan, note=f"{error} is not constant while losses are averaged")
        counts = np.isfinite(events.error[part])
        charge = mean_of_known(np.where(counts, run.charge[part], math.nan).reshape(-1, n))
        loss = mean_of_known(np.where(counts, run.pumping_loss[part], math.nan).reshape(-1, n))
        cylinders = events.cylinder[first : first + n]
        least = np.full(n, math.nan)
        for column in np.flatnonzero(np.isfinite(charge)).tolist():
            like = _all_like(engine, int(cylinders[column]))
            reference = _reference(like, asked, float(speed[0]))
            try:
                least[column] = float(reference.at(charge[column]))
            except ParameterError as error:
                return Measured(math.nan, note=f"cylinder {cylinders[column]}: {error}")
        known = np.isfinite(least) & np.isfinite(loss)
        if not known.any():
            return Measured(math.nan, note="no charges while losses are averaged")
        value = 100.0 * (float(np.mean(loss[known]) / np.mean(least[known])) - 1.0)
        excess = loss / least - 1.0
        most = int(np.nanargmax(excess))
        note = (
            f"cylinder {cylinders[most]} has most, {100.0 * excess[most]:+.3g} %, "
            f"mean of {cycles} cycles"
        )
        return events.at(value, first + most, note)


class _NotConstantError(Exception):
    """A boundary condition changes; says which."""


def _engine(result: ScenarioResult, part: slice) -> Engine:
    """True engine under the boundary conditions of some events, which must be constant."""
    scenario = result.scenario
    engine = scenario.true_engine
    given = scenario.profile.events(
        engine.n_cylinders, warm_up_cycles=scenario.controller.warm_up_cycles
    ).conditions
    if given is None:
        return engine
    changes: dict[str, float] = {}
    for name in _CONDITIONS:
        values = getattr(given, name)
        if values is None:
            continue
        there: FloatArray = np.broadcast_to(values, result.run.time.shape)[part]
        if np.ptp(there) > _STEADY * abs(float(there[0])):
            raise _NotConstantError(name)
        changes[name] = float(there[0])
    factor = changes.pop("flow_factor", 1.0)
    return engine.replace(flow_coefficient=factor * engine.flow_coefficient, **changes)


def _all_like(engine: Engine, cylinder: int) -> Engine:
    """Engine whose cylinders are all like one of an engine's."""
    return engine.replace(
        flow_coefficient=engine.flow_coefficients[cylinder - 1], cylinder_flow_factors=()
    )


@functools.lru_cache(maxsize=256)
def _reference(engine: Engine, demand: float, speed_rpm: float) -> LossReference:
    from .loss_reference import loss_references

    plant = CrankAnglePlant(engine, runner=True, oscillation=True)
    return loss_references(plant, ((demand, speed_rpm),))[0]
