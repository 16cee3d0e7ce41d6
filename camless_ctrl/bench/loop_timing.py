"""The closed loop beside the clock: how much faster than the engine, and where the time goes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant import CrankAnglePlant, PlantRun
from plant.sensor_run import SensorSetRun
from plant.sensors import SensorSet

from ..closed_loop import ValveErrors, simulate
from ..controller import AirChargeController
from ..controller_cases import JITTER
from .controller_timing import DEMAND, SPEED_RPM, bench_controller
from .table import Table

CYLINDERS = 4
_EVENTS, _WARM = 400, 40  # events of a pass (8 s of engine), and of the run before the first
PARTS = ("plant", "sensors", "controller")


@dataclass(frozen=True)
class LoopTiming:
    """Time of a closed-loop run, from the first update of the controller to the result.

    Attributes
    ----------
    plant_us, sensors_us, controller_us, rest_us : float
        Time of an event in the full plant, in the sensors, in the controller, and in what is
        around them, us; all of one run.
    events : int
        Events that were timed.
    """

    plant_us: float
    sensors_us: float
    controller_us: float
    rest_us: float
    events: int

    @property
    def event_us(self) -> float:
        """Time of an event, us."""
        return self.plant_us + self.sensors_us + self.controller_us + self.rest_us

    @property
    def times_real(self) -> float:
        """Simulated time over wall time, 1."""
        event = 120.0 / (CYLINDERS * SPEED_RPM)  # s, of the engine
        return 1e6 * event / self.event_us

    @property
    def shares(self) -> dict[str, tuple[float, float]]:
        """Time (us an event) and share (1) of each part, by its name."""
        parts = {name: getattr(self, f"{name}_us") for name in (*PARTS, "rest")}
        return {name: (us, us / self.event_us) for name, us in parts.items()}

    def table(self) -> Table:
        """Return speed and parts for printing."""
        rows = [
            ("all of it", f"{self.event_us:.0f} us", "100 %", f"{self.times_real:.1f}"),
            *((name, f"{us:.0f} us", f"{100.0 * part:.0f} %", "")
              for name, (us, part) in self.shares.items()),
        ]  # fmt: skip
        title = (
            f"Closed loop of {CYLINDERS} cylinders at {SPEED_RPM:.0f} rpm, sensors on, one core: "
            f"{self.events} events of one run"
        )
        return Table(title, ("part", "an event", "share", "x real time"), tuple(rows))

    def as_dict(self) -> dict[str, Any]:
        """Return the times for JSON."""
        return {
            "times_real": self.times_real,
            "event_us": self.event_us,
            **{f"{name}_us": us for name, (us, _) in self.shares.items()},
            "events": self.events,
            "speed_rpm": SPEED_RPM,
            "n_cylinders": CYLINDERS,
        }

    def __str__(self) -> str:
        """Return speed and parts."""
        parts = ", ".join(f"{name} {us:.0f}" for name, (us, _) in self.shares.items())
        return f"{self.event_us:.0f} us an event: {parts} us ({self.events} events)"


def measure_loop(passes: int) -> LoopTiming:
    """Time the designed controller in closed loop with the full plant, sensors on.

    Parameters
    ----------
    passes : int
        Times that the run is made; the shortest counts, with its own parts.
    """
    controller = bench_controller()
    _pass(controller, _WARM)  # machine code is loaded
    return min((_pass(controller, _EVENTS) for _ in range(passes)), key=lambda t: t.event_us)


class _Watch:
    """Times what is called, part by part, from the first update of the controller on."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.first: float | None = None  # s, when that update began

    def over(self, owner: object, method: str, part: str) -> None:
        """Time a method of one object from now on."""
        call = getattr(owner, method)

        def timed(*given: Any, **named: Any) -> Any:
            begin = time.perf_counter()
            if self.first is None and part == "controller":
                self.first = begin
            found = call(*given, **named)
            if self.first is not None:
                self.seconds[part] += time.perf_counter() - begin
            return found

        object.__setattr__(owner, method, timed)  # of this object alone, frozen or not


def _pass(controller: AirChargeController, events: int) -> LoopTiming:
    """Time one run; what is timed is copied, and stays as it is elsewhere."""
    watch = _Watch()
    plant = CrankAnglePlant(runner=True, oscillation=True)
    start = plant.start

    def started(*given: Any, **named: Any) -> PlantRun:
        run = start(*given, **named)
        watch.over(run, "step_event", "plant")
        return run

    class Watched(SensorSet):
        def start(self, seed: int) -> SensorSetRun:
            run = SensorSet.start(self, seed)
            watch.over(run.maf, "observe", "sensors")
            watch.over(run.map, "observe", "sensors")
            watch.over(run.duration, "measure", "sensors")
            return run

    object.__setattr__(plant, "start", started)
    watched = controller.replace()
    watch.over(watched, "step", "controller")
    simulate(
        plant,
        watched,
        np.full(events, DEMAND),
        SPEED_RPM,
        sensors=Watched(),
        valves=ValveErrors(0.0, JITTER),
    )
    end = time.perf_counter()
    assert watch.first is not None  # the controller was asked
    rest = end - watch.first - sum(watch.seconds.values())
    parts = (1e6 * seconds / events for seconds in (*watch.seconds.values(), rest))
    plant_us, sensors_us, controller_us, rest_us = parts
    return LoopTiming(plant_us, sensors_us, controller_us, rest_us, events)
