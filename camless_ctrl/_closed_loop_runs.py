"""Closed-loop runs of one full plant around its own equilibrium, and growth of what disturbs it.

A run starts where the loop is at rest: each plant is trimmed to the charge at which its own
estimate meets the demand, and its sensor has settled. Then the valve of the first cylinder
closes a little later (and, in a second run, earlier) than commanded, from one event on. This
step in one cylinder holds all modes in equal parts. Half the difference of the two runs is the
response: what both have in common, such as the bias of a coarse sampling, drops out, and so do
curvatures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from plant import (
    CrankAnglePlant,
    Cycle,
    MafSensor,
    ParameterError,
    PlantRun,
    PlantState,
    SensorRun,
    SensorSamples,
    SensorState,
)
from plant._checks import whole
from plant.air_path import event_time
from plant.kinematics import FloatArray
from uncertainty.parameters import UncertaintySet
from uncertainty.perturbed import PerturbedPlants, duration_offsets
from uncertainty.sampling import Sample

from ._step_response import StepResponse
from .adaptation import AdaptationGains, GainSchedule, NormalisedGradient
from .closed_loop import SETTLING_LAGS
from .controller import AirChargeController, ControllerState, Measurement
from .estimator import ChargeEstimator
from .feedforward import Feedforward, FeedforwardCommand
from .synthesis.stoppable import run_stoppable
from .uncertain_measurement import UncertainMeasurement

_WIDE = (0.05, 10.0)  # bounds of the charge factor: none acts on a small deviation
_TRACE_STEP_DEG = 0.25  # deg; 1 deg misses the shape of what a small step adds: 10 % at 750 rpm
_LARGE = 10.0  # steps: a response beyond this is no longer small
_DRIFT = 0.02  # of the charge: an equilibrium that has moved by this is another one
_TRIMMED, _TRIALS = 1e-4, 30  # relative error of the charge that a trim leaves, its steps
_LONGEST_S = 3600.0  # s, after which another process is taken to hang

Progress = Callable[[int, int], None]
Item = TypeVar("Item")
Found = TypeVar("Found")


@dataclass(frozen=True)
class LoopCase:
    """A full plant, its sensor and the controller at one operating point.

    Attributes
    ----------
    plant : CrankAnglePlant
        The plant; its cylinders are equal.
    maf : MafSensor
        The air-flow sensor.
    feedforward : Feedforward
        Map that the controller believes.
    estimator : ChargeEstimator
        The estimator.
    gains : AdaptationGains
        Gains per cycle.
    demand, speed_rpm : float
        Operating point: kg, rpm.
    duration_offset : float
        Error of the delivered duration of all valves, s.
    cycles : int
        Length of the run after the step.
    amplitude : float
        Size of the step, relative to the charge by the map's slope.
    """

    plant: CrankAnglePlant
    maf: MafSensor
    feedforward: Feedforward = field(repr=False)
    estimator: ChargeEstimator
    gains: AdaptationGains
    demand: float
    speed_rpm: float
    duration_offset: float = 0.0
    cycles: int = 30
    amplitude: float = 0.02

    @property
    def controller(self) -> AirChargeController:
        """Controller with gains that hold at every speed, and without bounds that would act."""
        return AirChargeController(
            self.feedforward,
            self.estimator,
            NormalisedGradient(
                GainSchedule.constant(self.gains.mean, self.gains.imbalance), bounds=_WIDE
            ),
            n_cylinders=self.plant.engine.n_cylinders,
        )


def at_speed(feedforward: Feedforward, speed_rpm: float) -> Feedforward:
    """Return the feedforward with its table of one speed for a map: small to send elsewhere."""
    feedforward.command(1e-4, speed_rpm)  # makes the table
    branch = feedforward._branches[float(speed_rpm)]
    table = replace(feedforward, charge_map=_Table(branch.duration_deg, branch.charge))
    table._branches[float(speed_rpm)] = branch
    return table


@dataclass(frozen=True)
class _Table:
    """Charge map at one speed and its scheduled lift."""

    duration_deg: FloatArray
    charge: FloatArray

    def air_charge(
        self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike, /
    ) -> ArrayLike:
        return np.interp(np.asarray(duration_deg, float), self.duration_deg, self.charge)


def sampled_cases(
    measurement: UncertainMeasurement,
    feedforward: Feedforward,
    gains: GainSchedule,
    sample: Sample,
    plant: CrankAnglePlant,
    cycles: int,
) -> list[LoopCase]:
    """Return the closed loop of each plant of a sample at the operating point of a measurement."""
    speed = measurement.speed_rpm
    perturbed = PerturbedPlants(plant, sample)
    offsets = duration_offsets(sample.uncertain, sample.values, plant.engine.n_cylinders)
    plants = [perturbed.plant_at(i) for i in range(len(sample))]
    if offsets.shape[1] > 1 or any(len(set(p.engine.flow_coefficients)) > 1 for p in plants):
        raise ParameterError(
            "the cylinders of the sampled plants differ, but modes are told apart for equal ones "
            "alone: leave what acts on single cylinders out of the set"
        )
    small = at_speed(feedforward, speed)
    return [
        LoopCase(
            plants[i],
            perturbed.maf_at(i, MafSensor().ideal()),
            small,
            measurement.estimator,
            gains.at(speed),
            measurement.demand,
            speed,
            float(offsets[i, 0]),
            cycles,
        )
        for i in range(len(sample))
    ]


def widened(uncertain: UncertaintySet, values: Mapping[str, float]) -> UncertaintySet:
    """Return the set with bounds moved so far out that it holds the values."""
    for name, value in values.items():
        p = uncertain[name]
        uncertain = uncertain.replace(name, low=min(p.low, value), high=max(p.high, value))
    return uncertain


def step_response(case: LoopCase) -> StepResponse:
    """Run the loop of a plant from its equilibrium after a step in one cylinder.

    Raises
    ------
    ParameterError
        If the demand is out of the plant's reach, or its charge does not follow the duration.
    """
    n, speed = case.plant.engine.n_cylinders, case.speed_rpm
    whole("cycles", case.cycles, 4, 100_000)
    late = 6.0 * speed * case.duration_offset
    factor, forward, cycle = _equilibrium(case, late)
    run = case.plant.start(speed, cycle.commands, event_advance_deg=0.0, on_infeasible="limit")
    sensor = case.maf.start(0)
    trace = cycle.trace_at(_TRACE_STEP_DEG)
    samples = sensor.observe(trace)
    while sensor.state.clock < SETTLING_LAGS * case.maf.time_constant + case.maf.delay:
        samples = sensor.observe(trace)
    loop = _Loop(case, run, sensor, case.controller.initial_state(np.full(n, factor)), samples)
    latency = case.estimator.latency_events(event_time(speed, n))
    loop.advance(n * (1 + -(-latency // n)), late, 0.0)  # until estimates come in
    at_rest = loop.standing
    slope = case.feedforward.sensitivity(forward.charge, speed) / forward.charge  # 1/deg
    both = []
    for sign in (1.0, -1.0):
        loop.standing = at_rest
        both.append(loop.advance(n * case.cycles, late, sign * case.amplitude / slope))
    size = min(charges.size for charges in both)
    difference = (both[0][:size] - both[1][:size]) / (2.0 * case.demand)
    if abs(difference[0]) < 0.01 * case.amplitude:
        raise ParameterError(
            f"a valve that closes later changes the charge of {1e6 * case.demand:.0f} mg at "
            f"{speed:g} rpm by {difference[0] / case.amplitude:.3f} of what the map says: lower "
            "the demand"
        )
    values = difference / difference[0]
    middle = 0.5 * (both[0][:size] + both[1][:size]) / case.demand
    moved = np.abs(middle - np.resize(middle[:n], size))
    nonlinear = np.flatnonzero((np.abs(values) > _LARGE) | (moved > _DRIFT))
    end = int(nonlinear[0]) if nonlinear.size else size
    return StepResponse(n, case.gains.imbalance == 0.0, values[:end], end < n * (case.cycles - 1))


def _equilibrium(case: LoopCase, late_deg: float) -> tuple[float, FeedforwardCommand, Cycle]:
    """Charge factor, command and cycle at which the estimate of the plant is the demand."""
    target = case.demand / (1.0 + case.maf.gain_error)
    factor = 1.0
    for _ in range(_TRIALS):
        forward = case.feedforward.command(case.demand / factor, case.speed_rpm)
        command = forward.command.replace(duration_deg=forward.command.duration_deg + late_deg)
        cycle = case.plant.steady_cycle(case.speed_rpm, command, on_infeasible="limit")
        ratio = float(cycle.air_charge[0]) / target
        if abs(ratio - 1.0) < _TRIMMED and not forward.limited:
            return factor, forward, cycle
        factor *= ratio
    raise ParameterError(
        f"the plant takes in {1e6 * ratio * target:.0f} mg, not {1e6 * target:.0f} mg, at "
        f"{case.speed_rpm:g} rpm whatever is commanded: lower the demand"
    )


class _Standing(NamedTuple):
    """All that a loop remembers."""

    plant: PlantState
    sensor: SensorState
    controller: ControllerState
    samples: SensorSamples


class _Loop:
    """A loop at work, event by event; put it back with `standing`."""

    def __init__(
        self,
        case: LoopCase,
        run: PlantRun,
        sensor: SensorRun,
        state: ControllerState,
        samples: SensorSamples,
    ) -> None:
        self.case, self.controller, self.run, self.sensor = case, case.controller, run, sensor
        self.standing = _Standing(run.state, sensor.state, state, samples)

    def advance(self, events: int, late_deg: float, step_deg: float) -> FloatArray:
        """Charges of the next events, all valves late and the first cylinder's by more.

        It ends early if a demand is out of reach.
        """
        run, sensor, speed, demand = self.run, self.sensor, self.case.speed_rpm, self.case.demand
        run.state, sensor.state, state, samples = self.standing
        n, first = self.controller.n_cylinders, state.event_index
        charges = np.full(events, math.nan)
        for k in range(first, first + events):
            told = Measurement(sensor.state.clock, speed, samples.time, samples.value)
            step = self.controller.step(state, told, demand)
            if step.diagnostics.limited:
                break
            state, command = step.state, step.command
            late = late_deg + (step_deg if k % n == 0 else 0.0)
            event = run.step_event(
                command.replace(duration_deg=command.duration_deg + late),
                trace_step_deg=_TRACE_STEP_DEG,
            )
            assert event.trace is not None  # it was asked for
            samples = sensor.observe(event.trace)
            for done in event.completed:
                opened = k - (k - (done.cylinder - 1)) % n  # its last IVO
                if opened >= first:
                    charges[opened - first] = done.air_charge
        self.standing = _Standing(run.state, sensor.state, state, samples)
        known = np.flatnonzero(np.isnan(charges))
        return charges[: known[0]] if known.size else charges


def in_processes(
    function: Callable[[Item], Found],
    items: Sequence[Item],
    processes: int,
    progress: Progress | None = None,
) -> list[Found]:
    """Return the function of each item, computed here and in further processes.

    Parameters
    ----------
    function : callable
        Function of an importable module; items and results must be picklable.
    items : sequence
        The items.
    processes : int
        Number of processes, this one among them.
    progress : callable, optional
        Called with the number of items known to be done and the number in all.
    """
    whole("processes", processes, 1, 256)
    processes = min(processes, max(len(items), 1))
    total, done = len(items), 0
    found: dict[int, Found] = {}
    shares = [list(range(k, total, processes)) for k in range(processes)]

    def report(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, total)

    with ThreadPoolExecutor(max(processes - 1, 1)) as pool:
        others = [
            pool.submit(run_stoppable, _each, (function, [items[i] for i in share]), _LONGEST_S)
            for share in shares[1:]
        ]
        for i in shares[0]:
            found[i] = function(items[i])
            report(1)
        for share, other in zip(shares[1:], others, strict=True):
            found.update(zip(share, other.result(), strict=True))
            report(len(share))
    return [found[i] for i in range(total)]


def _each(function: Callable[[Item], Found], items: list[Item]) -> list[Found]:
    return [function(item) for item in items]
