"""One update of the air-charge controller: how long it takes in Python, and its parts."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from plant import CrankAnglePlant, Engine, MeanValuePlant

from .._event_facts import of_index, with_durations
from ..charge_model import ChargeModel
from ..closed_loop import ValveErrors, simulate
from ..controller import AirChargeController, ControllerState, ControlStep
from ..controller_cases import JITTER
from ..controller_design import design_controller
from ..event_data import ChargeEvidence, Measurement
from ..optimal_path import OptimalPath

SPEED_RPM, DEMAND = 1500.0, 3e-4
_RANGE_RPM = (1300.0, 1700.0)  # the size of the tables does not matter to the time
_EVENTS, _FIRST = 240, 40


@dataclass(frozen=True)
class ControllerTiming:
    """Median times, us, over the events of a run; the least of several passes.

    Attributes
    ----------
    step_us : float
        One whole update.
    estimator_us, model_us, law_us : float
        Its estimator (samples taken in), its charge model (adapted inverse), its law.
    events : int
        Events of a pass.
    """

    step_us: float
    estimator_us: float
    model_us: float
    law_us: float
    events: int

    def __str__(self) -> str:
        """Return all times."""
        return (
            f"controller update {self.step_us:.1f} us, of that estimator {self.estimator_us:.1f}, "
            f"model {self.model_us:.1f}, law {self.law_us:.1f} us ({self.events} events)"
        )


def measure_controller(passes: int) -> ControllerTiming:
    """Time the designed controller on the events of a closed-loop run.

    Parameters
    ----------
    passes : int
        Times that the run is gone through; the least median counts.
    """
    controller = bench_controller()
    events = _recorded(controller)
    law = controller.adaptation

    def evidence(state: ControllerState, measurement: Measurement) -> ChargeEvidence:
        found = controller.estimator.update(state.estimator, measurement).final
        pending = with_durations(state.pending, measurement.durations)
        said = (
            None
            if found is None
            else controller._evidence(of_index(pending, found.event_index), found)
        )
        assert said is not None  # the sensors are sound, and the beginning is left out
        return said

    known = {id(state): evidence(state, measurement) for state, measurement in events}
    parts: dict[str, Callable[[ControllerState, Measurement], Any]] = {
        "step": lambda state, measurement: controller.step(state, measurement, DEMAND),
        "estimator": lambda state, measurement: controller.estimator.update(
            state.estimator, measurement
        ),
        "model": lambda state, _: controller.model.inverse(
            DEMAND, SPEED_RPM, state.adaptation.of(1), state.density
        ),
        "law": lambda state, _: law.update(state.adaptation, known[id(state)]),
    }
    least = dict.fromkeys(parts, float("inf"))
    for _ in range(passes):
        for name, part in parts.items():
            least[name] = min(least[name], _median_us(part, events))
    return ControllerTiming(
        least["step"], least["estimator"], least["model"], least["law"], len(events)
    )


@cache
def bench_controller() -> AirChargeController:
    """Return the controller that is timed, known around one speed."""
    plant = CrankAnglePlant(Engine.paper(), runner=True, oscillation=True)
    maps = MeanValuePlant.fit(plant, speed_range_rpm=_RANGE_RPM, tolerance=0.02, most_points=2000)
    path = OptimalPath.fit(maps, speeds_rpm=np.linspace(*_RANGE_RPM, 5), nodes=17)
    return design_controller(
        path=path, model=ChargeModel.fit(path, plant, speeds=15, positions=41)
    ).controller


def _recorded(controller: AirChargeController) -> list[tuple[ControllerState, Measurement]]:
    """States and measurements of a run, its beginning left out."""
    events: list[tuple[ControllerState, Measurement]] = []

    class Recording(AirChargeController):
        def step(
            self,
            state: ControllerState,
            measurement: Measurement,
            demand: float,
            *,
            active: bool = True,
        ) -> ControlStep:
            events.append((state, measurement))
            return super().step(state, measurement, demand, active=active)

    simulate(
        CrankAnglePlant(runner=True, oscillation=True),
        Recording(**{name: getattr(controller, name) for name in controller.__dataclass_fields__}),
        np.full(_EVENTS, DEMAND),
        SPEED_RPM,
        valves=ValveErrors(0.0, JITTER),
    )
    return events[_FIRST:]


def _median_us(
    part: Callable[[ControllerState, Measurement], Any],
    events: list[tuple[ControllerState, Measurement]],
) -> float:
    times = []
    for state, measurement in events:
        begin = time.perf_counter()
        part(state, measurement)
        times.append(time.perf_counter() - begin)
    return 1e6 * statistics.median(times)
