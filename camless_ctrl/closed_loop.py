"""The controller in closed loop with the full plant, event by event."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError, Trace, ValveCommand
from plant._checks import in_range, whole
from plant.kinematics import FloatArray
from plant.sensors import AirSensor, SensorSet

from .closed_loop_result import ClosedLoopResult
from .controller import AirChargeController, ControllerState
from .event_data import Measurement

TRACE_STEP_DEG = 0.5  # deg, of the signals that the sensors are shown
LATCH_DEG = 5.0  # deg before IVO, at which a command is latched
SETTLING_LAGS = 12.0  # time constants that the sensors are given before the first event


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
    state: ControllerState | None = None,
    active: ArrayLike = True,
    seed: int = 0,
    name: str = "closed loop",
    trace_step_deg: float = TRACE_STEP_DEG,
) -> ClosedLoopResult:
    """Run the controller against the full plant.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant.
    controller : AirChargeController
        The controller.
    demand : array_like (m,)
        Demanded charge of each event, kg.
    speed_rpm : float or array_like (m,)
        Engine speed of each event.
    sensors : SensorSet, optional
        The sensors; the default ones if not given.
    valves : ValveErrors, optional
        Errors of the delivered durations; none by default.
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

    Returns
    -------
    ClosedLoopResult
        The run starts from the periodic cycle of the first command, the sensors settled.

    Raises
    ------
    ParameterError
        If controller and engine differ in their number of cylinders, or arrays in length.
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
    use = _each("active", np.asarray(active, dtype=bool), m)
    in_range("duration_jitter", valves.duration_jitter, 0.0, 0.01, "s")
    offsets = _each("duration_offset", np.asarray(valves.duration_offset, dtype=float), n)
    sensor_seed, jitter_seed = np.random.SeedSequence(seed).generate_state(2)
    random = np.random.default_rng(jitter_seed)
    late = offsets[np.arange(m) % n] + valves.duration_jitter * random.standard_normal(m)

    state = controller.initial_state() if state is None else state
    if state.event_index:
        raise ParameterError(
            f"the state has seen {state.event_index} events, but a run starts before the first: "
            "export it and import it again"
        )
    first = [_first_command(controller, state, float(demands[0]), float(speeds[0]), i, offsets)
             for i in range(n)]  # fmt: skip
    run = plant.start(float(speeds[0]), first, event_advance_deg=LATCH_DEG, on_infeasible="limit")
    loop = _Sensing(sensors or SensorSet(), int(sensor_seed))
    loop.settle(plant.steady_cycle(float(speeds[0]), first, on_infeasible="limit").trace_at(
        trace_step_deg))  # fmt: skip

    names = [
        "time",
        "charge",
        "estimate",
        "estimate_sigma",
        "pumping_loss",
        "lift_mm",
        "duration_deg",
        "flow_gain",
        "duration_offset",
        "charge_factor",
    ]
    out = {key: np.full(m, math.nan) for key in names}
    flags = {key: np.zeros(m, dtype=bool) for key in ("limited", "adapted")}
    for k in range(m):
        speed = float(speeds[k])
        opening = loop.clock + LATCH_DEG / (6.0 * speed)
        step = controller.step(
            state, loop.measurement(opening, speed), float(demands[k]), active=bool(use[k])
        )
        state, command, found = step.state, step.command, step.diagnostics
        delivered = command.duration_deg + 6.0 * speed * float(late[k])
        event = run.step_event(
            command.replace(duration_deg=max(delivered, 0.1)),
            speed_rpm=speed,
            trace_step_deg=trace_step_deg,
        )
        assert event.trace is not None  # it was asked for
        loop.observe(event.trace)
        loop.shuts(k, opening, delivered, speed)
        out["time"][k] = opening
        out["lift_mm"][k], out["duration_deg"][k] = command.lift_mm, command.duration_deg
        out["flow_gain"][k], out["duration_offset"][k], out["charge_factor"][k] = found.parameters
        flags["limited"][k], flags["adapted"][k] = found.limited, found.adapted
        for done in event.completed:
            opened = k - (k - (done.cylinder - 1)) % n  # its last IVO
            if opened >= 0:
                out["charge"][opened] = done.air_charge
                out["pumping_loss"][opened] = done.pumping_loss
        if found.estimate is not None:
            of = found.estimate.event_index
            out["estimate"][of] = found.estimate.charge
            out["estimate_sigma"][of] = math.sqrt(found.estimate.variance)
    time = out.pop("time")
    return ClosedLoopResult(
        name=name,
        n_cylinders=n,
        seed=seed,
        time=time - time[0],
        cylinder=np.arange(m) % n + 1,
        speed_rpm=speeds.copy(),
        demand=demands,
        **out,
        **flags,
        final_state=state,
    )


class _Sensing:
    """Sensors at work, and what they have not yet told the controller."""

    def __init__(self, sensors: SensorSet, seed: int) -> None:
        self._run = sensors.start(seed)
        slow = [s for s in (sensors.maf, sensors.map) if isinstance(s, AirSensor)]
        self._settling = SETTLING_LAGS * max((s.time_constant + s.delay for s in slow), default=0.0)
        self._open: deque[tuple[float, int, float]] = deque()  # time of closing, event, duration

    @property
    def clock(self) -> float:
        """Time up to which the sensors have seen the plant, s."""
        return self._run.maf.state.clock

    def settle(self, cycle: Trace) -> None:
        """Show the sensors a periodic cycle until they have settled."""
        self.observe(cycle)
        while self.clock < self._settling:
            self.observe(cycle)

    def observe(self, trace: Trace) -> None:
        """Show the sensors what follows."""
        self._samples = self._run.observe(trace)

    def shuts(self, event: int, opening: float, duration_deg: float, speed_rpm: float) -> None:
        """Note the duration of an event, to be told when its valve has shut."""
        measured = float(self._run.duration.measure(max(duration_deg, 0.0), speed_rpm).duration)
        self._open.append((opening + duration_deg / (6.0 * speed_rpm), event, measured))

    def measurement(self, opening: float, speed_rpm: float) -> Measurement:
        """Return what the controller is told before an IVO."""
        shut = []
        while self._open and self._open[0][0] <= self.clock:
            _, event, measured = self._open.popleft()
            shut.append((event, measured))
        maf, map_ = self._samples.maf, self._samples.map
        return Measurement(
            opening, speed_rpm, maf.time, maf.value, map_.time, map_.value, tuple(shut)
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
    demand: float,
    speed_rpm: float,
    i: int,
    offsets: FloatArray,
) -> ValveCommand:
    """Command of a cylinder before the run, as its valve delivers it."""
    known = state.adaptation.of(i + 1)
    point = controller.model.inverse(demand, speed_rpm, known, state.density)
    late = 6.0 * speed_rpm * float(offsets[i])
    return ValveCommand(point.lift_mm, point.duration_deg + late)
