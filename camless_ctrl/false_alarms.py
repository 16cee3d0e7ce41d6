"""Fault-free operation of sampled engines and sensors: how many alarms are raised for nothing.

Every run has its own engine (flow of each cylinder, density, altitude), sensors and valves within
the assumed tolerances, and a random operation: demands that step or ramp, speeds that ramp. Engines
are as they come from the line or have aged; they do not change while they run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plant import CrankAnglePlant, Engine
from plant._checks import whole
from plant.kinematics import FloatArray
from plant.sensors import (
    MAF_DELAYS,
    MAF_GAIN_TOLERANCE,
    MAF_TIME_CONSTANTS,
    MAP_OFFSET_TOLERANCE,
    MafSensor,
    MapSensor,
    SensorSet,
)

from ._processes import in_processes
from .alarms import Alarm
from .closed_loop import ValveErrors, simulate
from .controller_cases import EXHAUST_OVER_AMBIENT, JITTER
from .controller_design import ControllerDesign

CYCLES = 10_000  # that are to raise no alarm
RUN_CYCLES = 250  # of one run, from a cold start

_FLOW, _CYLINDER = (0.9, 1.1), (0.88, 1.08)  # 1, true over nominal flow coefficient
_TEMPERATURE = (270.0, 320.0)  # K
_AMBIENT = (0.75, 1.03)  # over the nominal ambient pressure
_LATE = 0.2e-3  # s, of each valve, either way
_HELD = (40, 240)  # events until the operation changes
_RATE_RPM_S, _DEMAND_RATE = (200.0, 3000.0), 2.0  # rpm/s; shares of the range per s
_SHARES = (0.05, 0.95)  # of the range of charges

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FalseAlarmCount:
    """Alarms of fault-free operation.

    Attributes
    ----------
    cycles, events, runs : int
        Engine cycles and events in all, and of how many runs.
    alarms : int
        Events with an alarm.
    by_name : mapping of str to int
        Events of each alarm.
    seeds : tuple of int
        Runs that had any.
    """

    cycles: int
    events: int
    runs: int
    alarms: int
    by_name: dict[str, int]
    seeds: tuple[int, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "cycles": self.cycles,
            "events": self.events,
            "runs": self.runs,
            "alarm_events": self.alarms,
            "by_name": self.by_name,
            "seeds": list(self.seeds),
        }

    def __str__(self) -> str:
        """Return what was found in one line."""
        names = ", ".join(f"{name} {count}" for name, count in self.by_name.items())
        said = f"{self.alarms} events with an alarm ({names})" if self.alarms else "no alarm"
        return f"{self.cycles} fault-free cycles in {self.runs} runs: {said}"


@dataclass(frozen=True)
class Operation:
    """One run: engine, sensors, valves, and what is asked of it.

    Attributes
    ----------
    engine : Engine
        The true engine.
    sensors : SensorSet
        The true sensors.
    valves : ValveErrors
        The true valves.
    demand : ndarray (m,)
        Demanded charge of each event, kg.
    speed_rpm : ndarray (m,)
        Speed of each event.
    """

    engine: Engine
    sensors: SensorSet
    valves: ValveErrors
    demand: FloatArray = field(repr=False)
    speed_rpm: FloatArray = field(repr=False)


@dataclass(frozen=True)
class _Case:
    design: ControllerDesign
    cycles: int
    seed: int


def random_operation(design: ControllerDesign, cycles: int, seed: int) -> Operation:
    """Return a random engine within its tolerances, and a random operation of it.

    Parameters
    ----------
    design : ControllerDesign
        Tells the nominal engine, its speeds and charges.
    cycles : int
        Engine cycles.
    seed : int
        Seed of all that is random.
    """
    whole("cycles", cycles, 1, 10_000_000)
    whole("seed", seed, 0, 2**63 - 1)
    g, base = np.random.default_rng(seed), design.engine
    n = base.n_cylinders
    ambient = g.uniform(*_AMBIENT) * base.ambient_pressure
    engine = base.replace(
        cylinder_flow_factors=tuple(g.uniform(*_CYLINDER, n)),
        flow_coefficient=base.flow_coefficient * g.uniform(*_FLOW),
        temperature=base.temperature / 290.0 * g.uniform(*_TEMPERATURE),
        ambient_pressure=ambient,
        exhaust_pressure=ambient + EXHAUST_OVER_AMBIENT,
    )
    sensors = SensorSet(
        maf=MafSensor(
            gain_error=g.uniform(-MAF_GAIN_TOLERANCE, MAF_GAIN_TOLERANCE),
            time_constant=g.uniform(*MAF_TIME_CONSTANTS),
            delay=g.uniform(*MAF_DELAYS),
        ),
        map=MapSensor(offset=g.uniform(-MAP_OFFSET_TOLERANCE, MAP_OFFSET_TOLERANCE)),
    )
    valves = ValveErrors(tuple(g.uniform(-_LATE, _LATE, n)), JITTER)
    # Less air than that is asked for, so that the engine can give it
    density = min(ambient / base.ambient_pressure * base.temperature / engine.temperature, 1.0)
    speeds = (float(design.model.speeds_rpm[0]), float(design.model.speeds_rpm[-1]))
    shares, speed_rpm = _drive(g, speeds, cycles * n, n)
    knots = np.linspace(*speeds, 60)
    limits = np.array([design.model.limits(float(speed)) for speed in knots])
    low, high = (np.interp(speed_rpm, knots, limits[:, k]) for k in (0, 1))
    return Operation(engine, sensors, valves, density * (low + shares * (high - low)), speed_rpm)


def _drive(
    g: np.random.Generator, speeds: tuple[float, float], events: int, n: int
) -> tuple[FloatArray, FloatArray]:
    """Shares of the range of charges, and speeds in rpm, event by event."""
    share, speed = np.empty(events), np.empty(events)
    at, x = g.uniform(*speeds), g.uniform(*_SHARES)
    goal, aim, rate, steps, left = at, x, _RATE_RPM_S[0], True, 0
    for k in range(events):
        if left <= 0:
            left = int(g.integers(*_HELD))
            goal = g.uniform(*speeds) if g.random() < 0.6 else goal
            aim = g.uniform(*_SHARES) if g.random() < 0.7 else aim
            rate, steps = g.uniform(*_RATE_RPM_S), g.random() < 0.5
        left -= 1
        dt = 120.0 / (n * at)
        at += float(np.clip(goal - at, -rate * dt, rate * dt))
        x = aim if steps else x + float(np.clip(aim - x, -_DEMAND_RATE * dt, _DEMAND_RATE * dt))
        share[k], speed[k] = x, at
    return share, speed


def check_false_alarms(
    design: ControllerDesign,
    *,
    cycles: int = CYCLES,
    seed: int = 0,
    processes: int = 2,
    progress: Progress | None = None,
) -> FalseAlarmCount:
    """Run sampled engines without faults, and count the alarms.

    Parameters
    ----------
    design : ControllerDesign
        The controller.
    cycles : int
        Engine cycles in all, at least.
    seed : int
        Seed of the first run; the others have the following ones.
    processes : int
        Processes to run in.
    progress : callable, optional
        Called with the number of runs done and the number in all.
    """
    whole("cycles", cycles, 1, 10_000_000)
    each = min(cycles, RUN_CYCLES)
    runs = -(-cycles // each)
    cases = [_Case(design, each, seed + k) for k in range(runs)]
    found = in_processes(_alarms, cases, processes, progress)
    names: Counter[str] = Counter()
    for counts in found:
        names.update(counts)
    total = names.pop("any", 0)
    return FalseAlarmCount(
        runs * each,
        runs * each * design.engine.n_cylinders,
        runs,
        total,
        dict(names),
        tuple(case.seed for case, counts in zip(cases, found, strict=True) if counts),
    )


def _alarms(case: _Case) -> dict[str, int]:
    """Events of a run with each alarm, and with any."""
    operation = random_operation(case.design, case.cycles, case.seed)
    run = simulate(
        CrankAnglePlant(operation.engine, runner=True, oscillation=True),
        case.design.controller,
        operation.demand,
        operation.speed_rpm,
        sensors=operation.sensors,
        valves=operation.valves,
        seed=case.seed,
    )
    counts = {
        name: count
        for alarm in Alarm
        for name in alarm.names
        if (count := int(np.count_nonzero(run.alarms & int(alarm))))
    }
    if counts:
        counts["any"] = int(np.count_nonzero(run.alarms))
    return counts
