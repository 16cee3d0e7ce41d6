"""Closed-loop runs of one full plant around its own equilibrium, and growth of what disturbs it.

A run starts where the loop is at rest: each plant is trimmed to the charge at which its own
estimate meets the demand, and its sensors have settled. Then the first cylinder takes in a
little more (and, in a second run, less) than the controller believes, from one event on: its
valve closes late, or what has been learnt of it is wrong. This step in one cylinder holds all
modes in equal parts. Half the difference of the two runs is the response: what both have in
common, such as the bias of a coarse sampling, drops out, and so do curvatures.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from plant import ParameterError, PlantRun, PlantState, SensorRun, SensorSamples, SensorState
from plant._checks import whole
from plant.kinematics import FloatArray

from ._loop_cases import Case, LoopCase, at_speed, sampled_cases, widened
from ._processes import in_processes
from ._step_response import StepResponse
from .closed_loop import SETTLING_LAGS
from .controller import AirChargeController, ControllerState
from .event_data import Measurement

__all__ = ["LoopCase", "at_speed", "in_processes", "sampled_cases", "step_response", "widened"]

_TRACE_STEP_DEG = 0.25  # deg; 1 deg misses the shape of what a small step adds: 10 % at 750 rpm
_LARGE = 10.0  # steps: a response beyond this is no longer small
_DRIFT = 0.02  # of the charge: an equilibrium that has moved by this is another one


def step_response(case: Case) -> StepResponse:
    """Run the loop of a plant from its equilibrium after a step in one cylinder's charge.

    Raises
    ------
    ParameterError
        If the demand is out of the plant's reach, or its charge does not follow the duration.
    """
    n, speed = case.plant.engine.n_cylinders, case.speed_rpm
    whole("cycles", case.cycles, 4, 100_000)
    late = 6.0 * speed * case.duration_offset
    rest = case.at_rest()
    run = case.plant.start(speed, rest.cycle.commands, event_advance_deg=0.0, on_infeasible="limit")
    sensors = case.maf.start(0), case.map.start(0)
    trace = rest.cycle.trace_at(_TRACE_STEP_DEG)
    settled = max(SETTLING_LAGS * s.time_constant + s.delay for s in (case.maf, case.map))
    samples = [sensor.observe(trace) for sensor in sensors]
    while sensors[0].state.clock < settled:
        samples = [sensor.observe(trace) for sensor in sensors]
    controller = case.controller
    state = controller.initial_state(rest.known, density=rest.density)
    loop = _Loop(case, controller, run, sensors, state, samples)
    loop.advance(case.settling_events, late, 0.0)
    at_rest = loop.standing
    both = []
    for sign in (1.0, -1.0):
        step = case.disturbed(at_rest.controller, rest, sign)
        loop.standing = at_rest._replace(controller=step.controller)
        both.append(loop.advance(n * case.cycles, late, step.late_deg))
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
    return StepResponse(n, case.held, values[:end], end < n * (case.cycles - 1))


class _Standing(NamedTuple):
    """All that a loop remembers."""

    plant: PlantState
    sensors: list[SensorState]
    controller: ControllerState
    samples: list[SensorSamples]


class _Loop:
    """A loop at work, event by event; put it back with `standing`."""

    def __init__(
        self,
        case: Case,
        controller: AirChargeController,
        run: PlantRun,
        sensors: tuple[SensorRun, ...],
        state: ControllerState,
        samples: list[SensorSamples],
    ) -> None:
        self.case, self.controller, self.run, self.sensors = case, controller, run, sensors
        self.standing = _Standing(run.state, [s.state for s in sensors], state, samples)

    def advance(self, events: int, late_deg: float, step_deg: float) -> FloatArray:
        """Charges of the next events, all valves late and the first cylinder's by more.

        It ends early if a demand is out of reach.
        """
        run, sensors, speed, demand = self.run, self.sensors, self.case.speed_rpm, self.case.demand
        run.state, states, state, samples = self.standing
        for sensor, kept in zip(sensors, states, strict=True):
            sensor.state = kept
        n, first = self.controller.n_cylinders, state.event_index
        charges = np.full(events, math.nan)
        for k in range(first, first + events):
            maf, map_ = samples
            clock = sensors[0].state.clock
            told = Measurement(clock, speed, maf.time, maf.value, map_.time, map_.value)
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
            samples = [sensor.observe(event.trace) for sensor in sensors]
            for done in event.completed:
                opened = k - (k - (done.cylinder - 1)) % n  # its last IVO
                if opened >= first:
                    charges[opened - first] = done.air_charge
        self.standing = _Standing(run.state, [s.state for s in sensors], state, samples)
        known = np.flatnonzero(np.isnan(charges))
        return charges[: known[0]] if known.size else charges
