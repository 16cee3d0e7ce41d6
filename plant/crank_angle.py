"""The crank-angle plant: intake process of an engine, crank angle by crank angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from . import _kernel as kernel
from . import _layout as layout
from ._checks import in_range, one_of, positive
from .cycle import CompletedEvent, Cycle, EventResult
from .errors import ConvergenceError, ParameterError, SimulationError
from .kinematics import FloatArray
from .orifice import REFERENCE_PRESSURE, REFERENCE_TEMPERATURE
from .parameters import Engine
from .runner import forcing_amplitude, runner_gain
from .state import PlantState, fingerprint
from .trace import Trace
from .valve import OnInfeasible, ValveCommand, ValveProfile

Profile = Literal["camless", "conventional"]
Orifice = Literal["simplified", "exact"]

HIGHEST_SPEED_RPM = 20000.0
MOST_CYCLES = 1000
PATIENCE = 20  # cycles without a smaller change after which an alternation is accepted
ALTERNATING = 1e-6  # largest change of an alternation, relative


class CrankAnglePlant:
    """Full plant: manifold, runners and cylinders between throttle and intake valves.

    Parameters
    ----------
    engine : Engine, optional
        The engine; the paper's by default.
    runner : bool
        Whether the runners resonate (Eq. 5-8); without, the port sees manifold pressure.
    oscillation : bool
        Whether the camless actuator oscillates (Appendix B).
    profile : {"camless", "conventional"}
        Valve motion: Eq. 20, or the cam of section 4, turned by the crank.
    orifice : {"simplified", "exact"}
        Flow through throttle and valves: Eq. 13-14, or Eq. 10-11 as a check on it.
    resolution : float
        Fineness of the integration: the steps, chosen by an error estimate, shrink as its
        inverse. 1 keeps charge within 0.02 % and loss within 0.1 % of the converged solution
        (relative to 50 mg and 0.5 J where they are smaller).

    Notes
    -----
    A camless valve moves in time: its duration is converted from degrees with the speed at
    IVO and latched there. A cam follows the crank.
    """

    def __init__(
        self,
        engine: Engine | None = None,
        *,
        runner: bool = True,
        oscillation: bool = False,
        profile: Profile = "camless",
        orifice: Orifice = "simplified",
        resolution: float = 1.0,
    ) -> None:
        self.engine = Engine.paper() if engine is None else engine
        if not isinstance(self.engine, Engine):
            raise ParameterError(f"engine is {engine!r}, but must be an Engine")
        self.runner = bool(runner)
        self.oscillation = bool(oscillation)
        self.profile = one_of("profile", profile, ("camless", "conventional"))
        self.orifice = one_of("orifice", orifice, ("simplified", "exact"))
        self.resolution = in_range("resolution", resolution, 0.1, 1000.0, "1")
        if self.oscillation and self.profile == "conventional":
            raise ParameterError(
                "oscillation is True, but a conventional cam does not oscillate: use "
                "profile='camless'"
            )
        self._kernel_engine = _kernel_engine(
            self.engine, self.runner, self.oscillation, self.profile, self.orifice
        )
        self._flow_coefficients = np.array(self.engine.flow_coefficients)
        self.fingerprint = fingerprint(
            self.engine,
            runner=self.runner,
            oscillation=self.oscillation,
            profile=self.profile,
            orifice=self.orifice,
            resolution=self.resolution,
        )

    def __repr__(self) -> str:
        """Return the plant's options."""
        return (
            f"CrankAnglePlant({self.engine.n_cylinders} cylinders, profile={self.profile!r}, "
            f"runner={self.runner}, oscillation={self.oscillation}, orifice={self.orifice!r}, "
            f"resolution={self.resolution:g})"
        )

    def valve_profile(
        self, command: ValveCommand, speed_rpm: float, on_infeasible: OnInfeasible = "raise"
    ) -> ValveProfile:
        """Return the valve motion that this plant drives for a command at a speed."""
        if self.profile == "conventional":
            return ValveProfile.conventional(command, speed_rpm)
        return ValveProfile.camless(
            command,
            speed_rpm,
            self.engine.valvetrain,
            oscillation=self.oscillation,
            on_infeasible=on_infeasible,
        )

    def steady_cycle(
        self,
        speed_rpm: float,
        command: ValveCommand | Sequence[ValveCommand],
        throttle_deg: float = 90.0,
        *,
        on_infeasible: OnInfeasible = "raise",
        tolerance: float = 1e-10,
    ) -> Cycle:
        """Simulate cycles until they repeat, and return the periodic one.

        Parameters
        ----------
        speed_rpm : float
            Engine speed.
        command : ValveCommand or sequence of ValveCommand
            One command for all cylinders, or one for each.
        throttle_deg : float
            Throttle angle; 90 is wide open.
        on_infeasible : {"raise", "limit"}
            What to do where the duration does not allow the lift; a limited lift is told in
            the result.
        tolerance : float
            The cycle is periodic when no charge changes from one cycle to the next by more
            than this share of a displaced volume of ambient air, nor the manifold mass by
            more than this share of itself. Now and then the choice of steps alternates
            between two neighbours for ever; changes that have stopped shrinking pass below
            1e-6, and ``residual`` tells it.

        Raises
        ------
        ParameterError, InfeasibleProfileError
            For an operating point that the model does not cover.
        ConvergenceError
            If the cycles do not settle.
        SimulationError
            If the runner pressure would fall below zero.
        """
        return self._periodic(
            speed_rpm, command, throttle_deg, on_infeasible, tolerance, event_advance_deg=None
        )

    def start(
        self,
        speed_rpm: float,
        command: ValveCommand | Sequence[ValveCommand],
        throttle_deg: float = 90.0,
        *,
        event_advance_deg: float | None = None,
        on_infeasible: OnInfeasible = "raise",
    ) -> PlantRun:
        """Start a run from the periodic cycle of an operating point.

        Parameters
        ----------
        speed_rpm, command, throttle_deg, on_infeasible
            As for `steady_cycle`.
        event_advance_deg : float, optional
            Crank angle by which an event window starts before its cylinder's TDC. No valve
            may open earlier. The least that the commands need by default.

        Returns
        -------
        PlantRun
            To be advanced by `PlantRun.step_event`; the first cylinder opens first.
        """
        cycle = self._periodic(
            speed_rpm, command, throttle_deg, on_infeasible, 1e-10, event_advance_deg
        )
        return PlantRun(self, cycle.state, cycle.speed_rpm, cycle.throttle_deg, on_infeasible)

    def resume(
        self,
        state: PlantState,
        speed_rpm: float,
        throttle_deg: float = 90.0,
        *,
        on_infeasible: OnInfeasible = "raise",
    ) -> PlantRun:
        """Go on from a saved state.

        Raises
        ------
        ParameterError
            If the state belongs to another plant.
        """
        if state.plant != self.fingerprint:
            raise ParameterError(
                f"the state belongs to plant {state.plant}, but this plant is "
                f"{self.fingerprint}: use the engine and options that it was made with"
            )
        speed, throttle_deg, _ = self._operating_point(speed_rpm, throttle_deg)
        return PlantRun(self, state, speed, throttle_deg, on_infeasible)

    # -- internals ---------------------------------------------------------------------------

    def _periodic(
        self,
        speed_rpm: float,
        command: ValveCommand | Sequence[ValveCommand],
        throttle_deg: float,
        on_infeasible: OnInfeasible,
        tolerance: float,
        event_advance_deg: float | None,
    ) -> Cycle:
        speed, throttle_deg, area = self._operating_point(speed_rpm, throttle_deg)
        positive("tolerance", tolerance, "1")
        commands = self._commands(command)
        least = max(0.0, *(-c.opening_deg for c in commands))
        advance = least
        if event_advance_deg is not None:
            advance = in_range(
                "event_advance_deg",
                event_advance_deg,
                least,
                self.engine.event_angle_deg,
                "deg",
                open_high=True,
                remedy="no valve may open before its window, and a window is one event long",
            )
        lifts = np.array(
            [self.valve_profile(c, speed, on_infeasible).delivered_lift_mm for c in commands]
        )
        table = np.array(
            [
                (lift, c.duration_deg, self._until_opening(c, advance))
                for lift, c in zip(lifts, commands, strict=True)
            ]
        )
        window = self._window(speed, area, 0)
        cylinders, manifold = self._at_rest()
        no_trace = np.empty((self._trace_rows, 0))
        scale = (
            self.engine.ambient_pressure
            * self.engine.displaced_volume
            / (self.engine.gas_constant * self.engine.temperature)
        )
        residual, cycles = math.inf, 0
        least_residual, least_at = math.inf, 0
        while residual > tolerance:
            if cycles - least_at > PATIENCE and residual <= ALTERNATING:
                break
            if cycles == MOST_CYCLES:
                raise ConvergenceError(
                    f"no periodic cycle after {MOST_CYCLES} cycles at {speed:g} rpm, throttle "
                    f"{throttle_deg:g} deg: the last change was {residual:.1e}, but must be at "
                    f"most {tolerance:.1e}: raise the tolerance"
                )
            cycles += 1
            before = cylinders.copy(), manifold.copy()
            self._advance_cycle(window, table, advance, cylinders, manifold, no_trace)
            charge_change = cylinders[:, layout.CHARGE] - before[0][:, layout.CHARGE]
            mass_ratio = manifold[layout.MANIFOLD_MASS] / before[1][layout.MANIFOLD_MASS]
            residual = max(float(np.max(np.abs(charge_change))) / scale, abs(mass_ratio - 1.0))
            if residual < 0.7 * least_residual:
                least_residual, least_at = residual, cycles
        return Cycle(
            plant=self,
            speed_rpm=speed,
            throttle_deg=throttle_deg,
            commands=commands,
            delivered_lift_mm=lifts,
            air_charge=cylinders[:, layout.CHARGE].copy(),
            pumping_loss=cylinders[:, layout.LOSS].copy(),
            throttle_mass=float(manifold[layout.INFLOW] - before[1][layout.INFLOW]),
            cycles=cycles,
            residual=residual,
            state=PlantState(0, advance, 0.0, before[0], before[1], self.fingerprint),
        )

    def _trace_cycle(self, cycle: Cycle, step_deg: float) -> Trace:
        """Simulate the periodic cycle once more, with signals."""
        samples = self._samples_per_event(step_deg)
        n, advance = self.engine.n_cylinders, cycle.state.event_advance_deg
        table = np.array(
            [
                (lift, c.duration_deg, self._until_opening(c, advance))
                for lift, c in zip(cycle.delivered_lift_mm, cycle.commands, strict=True)
            ]
        )
        raw = np.full((self._trace_rows, n * samples), np.nan)
        area = self.engine.throttle.area(cycle.throttle_deg)
        window = self._window(cycle.speed_rpm, area, samples)
        cylinders, manifold = cycle.state.cylinders.copy(), cycle.state.manifold.copy()
        self._advance_cycle(window, table, advance, cylinders, manifold, raw)
        step = self.engine.event_angle_deg / samples
        return Trace.from_kernel(raw, -advance, step, cycle.speed_rpm, self.engine)

    def _operating_point(self, speed_rpm: float, throttle_deg: float) -> tuple[float, float, float]:
        """Check speed and throttle; return them with the throttle's effective area."""
        speed = in_range("speed_rpm", speed_rpm, 0.0, HIGHEST_SPEED_RPM, "rpm", open_low=True)
        throttle = self.engine.throttle
        angle = in_range(
            "throttle_deg",
            throttle_deg,
            throttle.closed_deg,
            throttle.wide_open_deg,
            "deg",
            open_low=True,
            remedy="Eq. 19 gives no flow below, and wide open is the end",
        )
        return speed, angle, throttle.area(angle)

    def _commands(self, command: ValveCommand | Sequence[ValveCommand]) -> tuple[ValveCommand, ...]:
        n = self.engine.n_cylinders
        commands = (command,) * n if isinstance(command, ValveCommand) else tuple(command)
        for c in commands:
            if not isinstance(c, ValveCommand):
                raise ParameterError(f"command holds {c!r}, but must hold ValveCommand only")
        if len(commands) != n:
            raise ParameterError(
                f"{len(commands)} valve commands for {n} cylinders: give one command for all, or "
                "one for each"
            )
        return commands

    def _until_opening(self, command: ValveCommand, advance_deg: float) -> float:
        """Crank angle from the start of the event window to IVO, checked."""
        last = self.engine.event_angle_deg - advance_deg
        if not -advance_deg <= command.opening_deg < last:
            raise ParameterError(
                f"opening_deg is {command.opening_deg:g} deg, but must be in "
                f"[{-advance_deg:g}, {last:g}) deg, the event window of {self.engine.n_cylinders} "
                f"cylinders that starts {advance_deg:g} deg before TDC: change opening_deg or "
                "event_advance_deg"
            )
        return command.opening_deg + advance_deg

    def _window(self, speed_rpm: float, throttle_area: float, samples: int) -> layout.Window:
        helmholtz = self.engine.helmholtz
        return kernel.make_window(
            self._kernel_engine,
            self.engine.event_angle_deg,
            speed_rpm,
            throttle_area,
            helmholtz.natural_frequency(speed_rpm),
            helmholtz.damping_ratio(speed_rpm),
            self.resolution,
            samples,
        )

    def _at_rest(self) -> tuple[FloatArray, FloatArray]:
        """State tables with all valves shut and the manifold at ambient pressure."""
        cylinders = np.zeros((self.engine.n_cylinders, layout.CYLINDER_COLUMNS))
        manifold = np.zeros(layout.MANIFOLD_ENTRIES)
        manifold[layout.MANIFOLD_MASS] = self._kernel_engine.capacity * self.engine.ambient_pressure
        return cylinders, manifold

    @property
    def _trace_rows(self) -> int:
        return layout.TRACE_FIRST + layout.TRACE_STRIDE * self.engine.n_cylinders

    def _samples_per_event(self, step_deg: float) -> int:
        event = self.engine.event_angle_deg
        step = in_range("trace step", step_deg, 0.001, event, "deg")
        return max(round(event / step), 1)

    def _advance_cycle(
        self,
        window: layout.Window,
        table: FloatArray,
        advance_deg: float,
        cylinders: FloatArray,
        manifold: FloatArray,
        trace: FloatArray,
    ) -> None:
        status = kernel.advance_cycle(
            self._kernel_engine,
            window,
            table,
            self._flow_coefficients,
            advance_deg,
            cylinders,
            manifold,
            trace,
        )
        _check_status(status, window.degree_rate / 6.0)


class PlantRun:
    """A run of the plant, advanced event by event; made by `CrankAnglePlant.start`.

    Attributes
    ----------
    plant : CrankAnglePlant
        The plant.
    state : PlantState
        State at the start of the next event window; assign a saved one to go back to it.
    speed_rpm, throttle_deg : float
        Values of the last event, which hold until others are given.
    """

    def __init__(
        self,
        plant: CrankAnglePlant,
        state: PlantState,
        speed_rpm: float,
        throttle_deg: float,
        on_infeasible: OnInfeasible,
    ) -> None:
        self.plant = plant
        self.state = state
        self.speed_rpm = speed_rpm
        self.throttle_deg = throttle_deg
        self.on_infeasible = on_infeasible

    @property
    def next_cylinder(self) -> int:
        """Cylinder (from 1) that opens in the next event window."""
        return self.state.event_index % self.plant.engine.n_cylinders + 1

    def step_event(
        self,
        command: ValveCommand,
        *,
        speed_rpm: float | None = None,
        throttle_deg: float | None = None,
        trace_step_deg: float | None = None,
    ) -> EventResult:
        """Advance by one event window; `command` is latched at the IVO in it.

        Parameters
        ----------
        command : ValveCommand
            Command for `next_cylinder`.
        speed_rpm, throttle_deg : float, optional
            Values over this window; those of the window before by default.
        trace_step_deg : float, optional
            Record signals at about this resolution.

        Raises
        ------
        ParameterError, InfeasibleProfileError, SimulationError
            As for `CrankAnglePlant.steady_cycle`; the run then stands where it stood.
        """
        plant, state = self.plant, self.state
        speed, throttle, area = plant._operating_point(
            self.speed_rpm if speed_rpm is None else speed_rpm,
            self.throttle_deg if throttle_deg is None else throttle_deg,
        )
        if not isinstance(command, ValveCommand):
            raise ParameterError(f"command is {command!r}, but must be a ValveCommand")
        n = plant.engine.n_cylinders
        advance = state.event_advance_deg
        opening = state.event_index % n
        event = layout.Event(
            opening,
            plant._until_opening(command, advance),
            plant.valve_profile(command, speed, self.on_infeasible).delivered_lift_mm,
            float(command.duration_deg),
        )
        samples = 0 if trace_step_deg is None else plant._samples_per_event(trace_step_deg)
        window = plant._window(speed, area, samples)
        raw = np.full((plant._trace_rows, samples), np.nan)
        event_angle = plant.engine.event_angle_deg
        angles = (opening - np.arange(n)) % n * event_angle - advance
        cylinders, manifold = state.cylinders.copy(), state.manifold.copy()
        status = kernel.advance_window(
            plant._kernel_engine,
            window,
            event,
            plant._flow_coefficients,
            angles,
            cylinders,
            manifold,
            raw,
            0,
        )
        _check_status(status, speed)
        self.speed_rpm, self.throttle_deg = speed, throttle
        self.state = PlantState(
            state.event_index + 1,
            advance,
            state.time + window.length,
            cylinders,
            manifold,
            state.plant,
        )
        trace = None
        if samples:
            first = state.event_index * event_angle - advance
            trace = Trace.from_kernel(raw, first, event_angle / samples, speed, plant.engine)
        done = cylinders[:, layout.COMPLETED] > state.cylinders[:, layout.COMPLETED]
        return EventResult(
            event_index=state.event_index,
            cylinder=opening + 1,
            duration=window.length,
            delivered_lift_mm=event.lift,
            limited=event.lift < command.lift_mm,
            completed=tuple(
                CompletedEvent(
                    int(j) + 1,
                    float(cylinders[j, layout.CHARGE]),
                    float(cylinders[j, layout.LOSS]),
                )
                for j in np.flatnonzero(done)
            ),
            throttle_mass=float(manifold[layout.INFLOW] - state.manifold[layout.INFLOW]),
            manifold_pressure=float(manifold[layout.MANIFOLD_MASS] / plant._kernel_engine.capacity),
            trace=trace,
        )


def _check_status(status: int, speed_rpm: float) -> None:
    if status == layout.RUNNER_COLLAPSED:
        raise SimulationError(
            f"the runner pressure of Eq. 5 fell below zero at {speed_rpm:g} rpm: the runner's "
            "acceleration term is too strong for this model (check runner_area, m2; the printed "
            "1.43e-4 does this) or switch it off with runner=False"
        )
    if status == layout.NO_STAGE_SOLUTION:
        raise SimulationError(
            f"the manifold pressure of an implicit step did not settle at {speed_rpm:g} rpm: "
            "raise the plant's resolution"
        )


def _kernel_engine(
    engine: Engine, runner: bool, oscillation: bool, profile: str, orifice: str
) -> layout.KernelEngine:
    """Gather what the kernel needs of an engine."""
    gas = engine.gas_constant * engine.temperature
    v = engine.valvetrain
    return layout.KernelEngine(
        n_cylinders=int(engine.n_cylinders),
        capacity=float(engine.manifold_volume / gas),
        gas=float(gas),
        half_stroke_volume=0.5 * engine.displaced_volume,
        clearance_volume=float(engine.clearance_volume),
        ambient_pressure=float(engine.ambient_pressure),
        exhaust_pressure=float(engine.exhaust_pressure),
        runner_gain=float(runner_gain(engine)) if runner else 0.0,
        # per crank speed in rad/s: 30/pi rpm
        runner_forcing=float(forcing_amplitude(engine, 30.0 / math.pi)),
        opening_slope=float(v.opening_slope_mm_s),
        closing_slope=float(v.closing_slope_mm_s),
        seating_slope=float(v.seating_slope_mm_s),
        seating_duration=float(v.seating_duration),
        roundness=float(v.roundness),
        oscillation_amplitude=float(v.oscillation_amplitude) if oscillation else 0.0,
        oscillation_frequency=2.0 * math.pi / v.oscillation_period,
        oscillation_decay=float(v.oscillation_decay_rate),
        cam=profile == "conventional",
        exact_orifice=orifice == "exact",
        exact_scale=math.sqrt(REFERENCE_TEMPERATURE / engine.temperature) / REFERENCE_PRESSURE,
    )
