"""The controller in closed loop with the full plant, event by event, faults included."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant._checks import in_range, whole
from plant.sensors import SensorSet
from plant.sweep import Progress

from ._delivery import delivered
from ._event_signals import EventSignals, TraceRecorder
from ._fault_effects import SOUND, FaultEffects
from ._sensing import SETTLING_LAGS, Sensing
from .closed_loop_result import ClosedLoopResult
from .conditions import Conditions, TrueEngine
from .controller import AirChargeController, ControllerState
from .faults import Fault

__all__ = ["LATCH_DEG", "SETTLING_LAGS", "TRACE_STEP_DEG", "Conditions", "ValveErrors", "simulate"]

TRACE_STEP_DEG = 0.5  # deg, of the signals that the sensors are shown
LATCH_DEG = 5.0  # deg before IVO, at which a command is latched
_SHUT = ValveCommand(0.0, 100.0)  # the duration says nothing
_TOLD_EVERY = 50  # events, of progress


class ValveErrors(NamedTuple):
    """What the actuators do otherwise than commanded."""

    duration_offset: tuple[float, ...] | float = 0.0  # s, of each valve or of all
    duration_jitter: float = 0.0  # s, 1 sigma


def simulate(
    plant: CrankAnglePlant,
    controller: AirChargeController,
    demand: ArrayLike,
    speed_rpm: ArrayLike,
    *,
    sensors: SensorSet | None = None,
    valves: ValveErrors | None = None,
    faults: Sequence[Fault] = (),
    conditions: Conditions | None = None,
    throttle_deg: ArrayLike | None = None,
    state: ControllerState | None = None,
    active: ArrayLike = True,
    seed: int = 0,
    name: str = "closed loop",
    trace_step_deg: float = TRACE_STEP_DEG,
    record_deg: float | None = None,
    progress: Progress | None = None,
) -> ClosedLoopResult:
    """Run the controller against the full plant.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant.
    controller : AirChargeController
        The controller.
    demand : array_like (m,)
        Demanded charge of each event, kg; 0 keeps the valve shut.
    speed_rpm : float or array_like (m,)
        Engine speed of each event.
    sensors : SensorSet, optional
        The sensors; the default ones if not given.
    valves : ValveErrors, optional
        Errors of the delivered durations; none by default.
    faults : sequence of Fault, optional
        What fails, and when; nothing by default. Their random numbers are their own: noise and
        jitter of the run are the same with and without them.
    conditions : Conditions, optional
        Boundary conditions and ageing of the true engine; those of the plant by default.
    throttle_deg : float or array_like (m,), optional
        Throttle angle of each event; wide open by default.
    state : ControllerState, optional
        State to start from, before its first event; nothing learnt by default.
    active : bool or array_like (m,) of bool
        Whether what was learnt is to be used, see `AirChargeController.step`.
    seed : int
        Seed of noise and jitter.
    name : str
        What to call the result.
    trace_step_deg : float
        Step of the signals that the sensors are shown, deg.
    record_deg : float, optional
        Keep the crank-level signals at about this step, deg, but not a finer one than
        `trace_step_deg`; none are kept by default. With four cylinders a point takes 192 bytes.
    progress : callable, optional
        Called with the number of events done and the number in all, now and then.

    Returns
    -------
    ClosedLoopResult
        The run starts from the periodic cycle of the first command, the sensors settled.

    Raises
    ------
    ParameterError
        If controller and engine differ in their number of cylinders, arrays in length, a fault
        is one of a cylinder that is not there, or makes a valve stay open beyond compression TDC.

    Notes
    -----
    A valve to which errors or faults leave too little time or lift for any motion stays shut; so
    does one whose command was made for another speed, or repeated, if it allows none.
    """
    n = plant.engine.n_cylinders
    if controller.n_cylinders != n:
        raise ParameterError(
            f"the controller is for {controller.n_cylinders} cylinders, but the engine has {n}"
        )
    whole("seed", seed, 0, 2**63 - 1)
    valves = ValveErrors() if valves is None else valves
    demands = np.atleast_1d(np.asarray(demand, dtype=float))
    m = demands.size
    if demands.ndim != 1 or not m:
        raise ParameterError(
            f"demand has shape {demands.shape}, but must hold one charge in kg for each event"
        )
    speeds = _each("speed_rpm", np.asarray(speed_rpm, dtype=float), m)
    wide_open = plant.engine.throttle.wide_open_deg
    throttles = _each(
        "throttle_deg", np.asarray(wide_open if throttle_deg is None else throttle_deg, float), m
    )
    use = _each("active", np.asarray(active, dtype=bool), m)
    in_range("duration_jitter", valves.duration_jitter, 0.0, 0.01, "s")
    offsets = _each("duration_offset", np.asarray(valves.duration_offset, dtype=float), n)
    sensor_seed, jitter_seed = np.random.SeedSequence(seed).generate_state(2)
    random = np.random.default_rng(jitter_seed)
    late = offsets[np.arange(m) % n] + valves.duration_jitter * random.standard_normal(m)
    effects = FaultEffects(faults, n, seed)
    engines = TrueEngine(plant, conditions, m)

    state = controller.initial_state() if state is None else state
    if state.event_index:
        raise ParameterError(
            f"the state has seen {state.event_index} events, but a run starts before the first: "
            "export it and import it again"
        )
    speed, throttle, true = float(speeds[0]), float(throttles[0]), engines.at(0)
    commands = [_first_command(controller, state, demands[:n], speed, i) for i in range(n)]
    first = [
        delivered(true, c, speed, float(offset), SOUND).command
        for c, offset in zip(commands, offsets, strict=True)
    ]
    run = true.start(speed, first, throttle, event_advance_deg=LATCH_DEG, on_infeasible="limit")
    sensing = Sensing(SensorSet() if sensors is None else sensors, int(sensor_seed), effects)
    cycle = true.steady_cycle(speed, first, throttle, on_infeasible="limit")
    sensing.settle(cycle.trace_at(trace_step_deg))
    zero = sensing.clock + LATCH_DEG / (6.0 * speed)
    sensing.begin(zero)

    signals = EventSignals(m, n)
    out = signals.arrays
    recorder = (
        None
        if record_deg is None
        else TraceRecorder(
            in_range("record_deg", record_deg, 0.001, plant.engine.event_angle_deg, "deg")
        )
    )
    for k in range(m):
        cylinder, speed, true = k % n + 1, float(speeds[k]), engines.at(k)
        if true is not run.plant:
            run = run.continue_with(true)
        start = sensing.clock
        opening = start + LATCH_DEG / (6.0 * speed)
        told_speed = effects.told_speed(opening - zero, speed)
        missed = effects.missed(opening - zero)
        if missed:
            command = commands[cylinder - 1]
            signals.missed(k)
        else:
            told = sensing.measurement(k, opening, told_speed)
            step = controller.step(state, told, float(demands[k]), active=bool(use[k]))
            state, command = step.state, step.command
            commands[cylinder - 1] = command
            signals.computed(k, step.diagnostics)
        motion = delivered(
            true,
            command,
            speed,
            float(late[k]),
            effects.valve(cylinder, opening - zero),
            known_speed=told_speed == speed and not missed,
        )
        event = run.step_event(
            motion.command,
            speed_rpm=speed,
            throttle_deg=float(throttles[k]),
            trace_step_deg=trace_step_deg,
        )
        assert event.trace is not None  # it was asked for
        sensing.observe(event.trace)
        sensing.shuts(k, cylinder, opening, motion.duration_deg, speed, motion.opens)
        out["time"][k], out["told_speed_rpm"][k] = opening - zero, told_speed
        out["lift_mm"][k], out["duration_deg"][k] = command.lift_mm, command.duration_deg
        out["delivered_lift_mm"][k] = event.delivered_lift_mm
        out["delivered_duration_deg"][k] = motion.command.duration_deg if motion.opens else 0.0
        signals.completed(k, event)
        if recorder is not None:
            recorder.add(event.trace, start)
        if progress is not None and ((k + 1) % _TOLD_EVERY == 0 or k + 1 == m):
            progress(k + 1, m)
    return ClosedLoopResult(
        name=name,
        n_cylinders=n,
        seed=seed,
        cylinder=np.arange(m) % n + 1,
        speed_rpm=speeds.copy(),
        demand=demands,
        throttle_deg=throttles.copy(),
        **out,
        final_state=state,
        faults=effects.all,
        trace=None if recorder is None else recorder.trace(),
    )


def _each(name: str, values: np.ndarray, size: int) -> np.ndarray:
    """One value for each, or an error."""
    if values.ndim and values.shape != (size,):
        raise ParameterError(
            f"{name} has shape {values.shape}, but there are {size} of them: give one, or {size}"
        )
    return np.broadcast_to(values, (size,))


def _first_command(
    controller: AirChargeController,
    state: ControllerState,
    demands: np.ndarray,
    speed_rpm: float,
    i: int,
) -> ValveCommand:
    """Command of a cylinder before the run, for the first demand above zero of the first cycle."""
    wanted = demands[demands > 0.0]
    if not wanted.size or (i < demands.size and demands[i] == 0.0):
        return _SHUT
    known = state.adaptation.of(i + 1)
    point = controller.model.inverse(float(wanted[0]), speed_rpm, known, state.density)
    return ValveCommand(point.lift_mm, point.duration_deg)
