"""The crank-angle plant: intake process of an engine, crank angle by crank angle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from . import _batch_kernel as batch_kernel
from . import _entries as kernel
from . import _layout as layout
from ._checks import in_range, one_of, positive, truth
from ._engine_numbers import Options, engine_row
from ._kernel_interface import check_status
from ._periodic import BEFORE, CYLINDER_ROWS, NOT_PERIODIC, TABLES
from .cycle import Cycle
from .errors import ConvergenceError, ParameterError, SimulationError
from .kinematics import FloatArray
from .parameters import Engine
from .run import PlantRun
from .state import PlantState, fingerprint
from .trace import Trace
from .valve import OnInfeasible, ValveCommand
from .valve_profile import ValveProfile

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

    from ._progress import Progress
    from .batch import OnError

Profile = Literal["camless", "conventional"]
Orifice = Literal["simplified", "exact"]

MOST_CYCLES = 1000


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
        self.runner = truth("runner", runner)
        self.oscillation = truth("oscillation", oscillation)
        one_of("profile", profile, get_args(Profile))
        one_of("orifice", orifice, get_args(Orifice))
        self.profile, self.orifice = profile, orifice
        self.resolution = in_range("resolution", resolution, 0.1, 1000.0, "1")
        if self.oscillation and self.profile == "conventional":
            raise ParameterError(
                "oscillation is True, but a conventional cam does not oscillate: use "
                "profile='camless'"
            )
        self._options = Options(
            self.engine.n_cylinders,
            self.runner,
            self.oscillation,
            self.profile == "conventional",
            self.orifice == "exact",
            self.resolution,
        )
        self._row = engine_row(self.engine)[np.newaxis]
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
        one_of("on_infeasible", on_infeasible, ("raise", "limit"))
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
            The cycle is periodic when what it hands on to the next repeats: the manifold mass
            to this share of itself, the masses of open cylinders to this share of a displaced
            volume of ambient air, and their work to this share of its volume work. Equal
            cylinders are compared event by event, others cycle by cycle. The choice of steps
            jumps between neighbouring states, so changes that have stopped shrinking pass
            below 1e-6 at resolution 1 (and as its inverse cube at others), or, should they
            alternate for ever, below 5e-5; ``residual`` tells it.

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

    def steady_cycles(
        self,
        speed_rpm: ArrayLike | xr.DataArray,
        lift_mm: ArrayLike | xr.DataArray,
        duration_deg: ArrayLike | xr.DataArray,
        opening_deg: ArrayLike | xr.DataArray = 0.0,
        throttle_deg: ArrayLike | xr.DataArray = 90.0,
        *,
        parameters: Mapping[str, ArrayLike | xr.DataArray] | None = None,
        dims: Sequence[str] | None = None,
        per_cylinder: bool = True,
        on_infeasible: OnInfeasible = "raise",
        on_error: OnError = "raise",
        tolerance: float = 1e-10,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Simulate the periodic cycles of many operating points and engines, in parallel.

        Parameters
        ----------
        speed_rpm, lift_mm, duration_deg, opening_deg, throttle_deg : array_like or DataArray
            Operating points. Plain arrays broadcast as in NumPy, DataArrays by the names of
            their dimensions. Lift, duration and opening may have a dimension ``cylinder``, with
            a command for each; otherwise one command holds for all.
        parameters : mapping of str to array_like or DataArray, optional
            Engine parameters that vary, by their names in `engine_fields`, for example
            ``{"temperature": [290.0, 316.0], "valvetrain.opening_slope_mm_s": 3000.0}``; they
            broadcast with the operating points.
        dims : sequence of str, optional
            Names of the dimensions of the plain arrays, as many as they have after
            broadcasting; ``dim_0``, ``dim_1`` and so on by default. A one-dimensional input
            whose name a dimension bears becomes its index.
        per_cylinder : bool
            Whether charge and loss have a dimension ``cylinder``; if not, they are means.
        on_infeasible : {"raise", "limit"}
            As for `steady_cycle`.
        on_error : {"raise", "nan"}
            What to do where `steady_cycle` would raise: raise that error with the point's
            place (all points are checked before the first is simulated), or give NaN and tell
            the reason in a variable ``status``. Engine parameters out of their bounds always
            raise.
        tolerance : float
            As for `steady_cycle`.
        threads : int, optional
            Number of threads; as many as this process has cores by default. The results do
            not depend on it.
        progress : callable, optional
            Called in the calling thread with the number of points done and the number in all.

        Returns
        -------
        xarray.Dataset
            ``air_charge`` in kg and ``pumping_loss`` in J per event, ``delivered_lift_mm``,
            ``residual`` and ``cycles`` as in `Cycle`, with the inputs as coordinates. It takes
            ``8 (2 n + 3)`` bytes a point, and the computation little more.

        Raises
        ------
        ParameterError, InfeasibleProfileError, ConvergenceError, SimulationError
            As for `steady_cycle`, with the place of the first point that is concerned.
        """
        from .batch import steady_cycles  # xarray takes its time to import

        return steady_cycles(
            self,
            speed_rpm,
            lift_mm,
            duration_deg,
            opening_deg,
            throttle_deg,
            parameters=parameters,
            dims=dims,
            per_cylinder=per_cylinder,
            on_infeasible=on_infeasible,
            on_error=on_error,
            tolerance=tolerance,
            threads=threads,
            progress=progress,
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
        one_of("on_infeasible", on_infeasible, ("raise", "limit"))
        self.check_state(state)
        speed, throttle_deg, _ = self._operating_point(speed_rpm, throttle_deg)
        return PlantRun(self, state, speed, throttle_deg, on_infeasible)

    def check_state(self, state: PlantState) -> None:
        """Check that a state belongs to this plant.

        Raises
        ------
        ParameterError
            If it does not.
        """
        if not isinstance(state, PlantState):
            raise ParameterError(f"state is {state!r}, but must be a PlantState")
        if state.plant != self.fingerprint:
            raise ParameterError(
                f"the state belongs to plant {state.plant}, but this plant is "
                f"{self.fingerprint}: use the engine and options that it was made with"
            )
        n = self.engine.n_cylinders
        if len(state.cylinders) != n:
            raise ParameterError(
                f"the state holds {len(state.cylinders)} cylinders, but this plant has {n}: it is "
                "damaged, save the state again"
            )

    def with_engine(self, engine: Engine) -> CrankAnglePlant:
        """Return this plant with another engine, its options kept."""
        return self._with(engine, self.resolution)

    def with_resolution(self, resolution: float) -> CrankAnglePlant:
        """Return this plant with another fineness of the integration."""
        return self._with(self.engine, resolution)

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
        speed, throttle_deg, _ = self._operating_point(speed_rpm, throttle_deg)
        one_of("on_infeasible", on_infeasible, ("raise", "limit"))
        tolerance = positive("tolerance", tolerance, "1")
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
        one = commands[:1] if isinstance(command, ValveCommand) else commands
        values, cylinders, manifold = self._solve(
            self._row,
            np.array([[speed, throttle_deg, advance]]),
            np.array([[x for c in one for x in (c.lift_mm, c.duration_deg, c.opening_deg)]]),
            on_infeasible,
            tolerance,
        )
        status, windows, residual, throttle_mass = values[0, : batch_kernel.DELIVERED].tolist()
        if status == batch_kernel.REFUSED or status == batch_kernel.INFEASIBLE:
            for c in one:  # the same checks, which say what they refuse
                self.valve_profile(c, speed, on_infeasible)
                self._until_opening(c, advance)
            raise SimulationError("the kernel refuses an operating point that passes the checks")
        if status == NOT_PERIODIC:
            raise ConvergenceError(
                f"no periodic cycle after {MOST_CYCLES} cycles at {speed:g} rpm, throttle "
                f"{throttle_deg:g} deg: the last change was {residual:.1e}, but must be at "
                f"most {tolerance:.1e}: raise the tolerance"
            )
        check_status(int(status), speed)
        lifts, charge, loss = values[0, batch_kernel.DELIVERED :].reshape(3, -1)
        return Cycle(
            plant=self,
            speed_rpm=speed,
            throttle_deg=throttle_deg,
            commands=commands,
            delivered_lift_mm=lifts,
            air_charge=charge,
            pumping_loss=loss,
            throttle_mass=throttle_mass,
            cycles=windows / self.engine.n_cylinders,
            residual=residual,
            state=PlantState(0, advance, 0.0, cylinders, manifold, self.fingerprint),
        )

    def _solve(
        self,
        rows: FloatArray,
        points: FloatArray,
        commands: FloatArray,
        on_infeasible: OnInfeasible,
        tolerance: float,
        most_cycles: int | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Solve operating points; see `_batch_kernel.solve_points`.

        Returns its results and the state at the start of the last point's cycle.
        """
        n = self.engine.n_cylinders
        values = np.zeros((len(points), batch_kernel.DELIVERED + 3 * n))
        tables = np.empty((TABLES, n, layout.CYLINDER_COLUMNS))
        manifolds = np.empty((TABLES, layout.MANIFOLD_ENTRIES))
        kernel.solve_points(
            self._options,
            int(on_infeasible == "limit"),
            MOST_CYCLES if most_cycles is None else most_cycles,
            tolerance,
            rows,
            points,
            commands,
            values,
            np.empty((CYLINDER_ROWS, n)),
            tables,
            manifolds,
        )
        return values, tables[BEFORE], manifolds[BEFORE]

    def _with(self, engine: Engine, resolution: float) -> CrankAnglePlant:
        return CrankAnglePlant(
            engine,
            runner=self.runner,
            oscillation=self.oscillation,
            profile=self.profile,
            orifice=self.orifice,
            resolution=resolution,
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
        self._advance_cycles(window, table, advance, cylinders, manifold, raw)
        step = self.engine.event_angle_deg / samples
        return Trace.from_kernel(raw, -advance, step, cycle.speed_rpm, self.engine)

    def _operating_point(self, speed_rpm: float, throttle_deg: float) -> tuple[float, float, float]:
        """Check speed and throttle; return them with the throttle's effective area."""
        speed = in_range(
            "speed_rpm", speed_rpm, 0.0, batch_kernel.HIGHEST_SPEED_RPM, "rpm", open_low=True
        )
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
        if not isinstance(command, ValveCommand | Sequence):
            raise ParameterError(
                f"command is {command!r}, but must be a ValveCommand, or a sequence of {n}"
            )
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
                f"[{0.0 - advance_deg:g}, {last:g}) deg, the event window of "
                f"{self.engine.n_cylinders} cylinders that starts {advance_deg:g} deg before TDC: "
                "change opening_deg, or give start(...) another event_advance_deg"
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

    @cached_property
    def _kernel_engine(self) -> layout.KernelEngine:
        return kernel.kernel_engine_of(self._row[0], self._options)

    @property
    def _trace_rows(self) -> int:
        return layout.TRACE_FIRST + layout.TRACE_STRIDE * self.engine.n_cylinders

    def _samples_per_event(self, step_deg: float) -> int:
        event = self.engine.event_angle_deg
        step = in_range("trace step", step_deg, 0.001, event, "deg")
        return max(round(event / step), 1)

    def _advance_cycles(
        self,
        window: layout.Window,
        table: FloatArray,
        advance_deg: float,
        cylinders: FloatArray,
        manifold: FloatArray,
        trace: FloatArray,
        cycles: int = 1,
    ) -> None:
        status = kernel.advance_cycles(
            self._kernel_engine,
            window,
            table,
            self._flow_coefficients,
            advance_deg,
            cylinders,
            manifold,
            trace,
            cycles,
        )
        check_status(status, window.degree_rate / 6.0)
