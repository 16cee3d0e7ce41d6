"""Dynamics of the mean-value plant: event by event, lifted over a cycle, and in time.

Eq. 18 with what carries the charge to the sensors. One event takes ``120/(n N)`` s. Its
charge leaves the manifold, which fills through the throttle (Eq. 1, 15); what passes the
throttle flows by the MAF sensor in a given shape, through its delay and lag. The charge burns
``Delta T`` later.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from . import _event_step as step
from ._checks import broadcast, in_range, one_of, positive
from ._lifting import Matrices, lifted
from .air_path import FlowShape, event_time
from .errors import ConvergenceError, ParameterError
from .kinematics import FloatArray
from .parameters import _Replaceable
from .sensors import MafSensor, MapSensor
from .valve import ValveCommand

if TYPE_CHECKING:
    import casadi
    import control
    import xarray as xr

    from .mean_value import MeanValuePlant

_MOST_ITERATIONS = 60
_SETTLED = 1e-12  # relative change of a state


@dataclass(frozen=True)
class DynamicOperatingPoint:
    """Periodic operation of the mean-value plant, event by event of a cycle.

    Attributes
    ----------
    inputs : ndarray (n, 3)
        Lift in mm, duration in deg and speed in rpm of each event.
    states : ndarray (n, states)
        State at the start of each event.
    outputs : ndarray (n, 7)
        Outputs of each event, in the order of ``OUTPUTS``.
    """

    inputs: FloatArray
    states: FloatArray
    outputs: FloatArray

    def output(self, name: str) -> FloatArray:
        """Values of an output by its name, (n,)."""
        one_of("output", name, step.OUTPUTS)
        return self.outputs[:, step.OUTPUTS.index(name)]

    def __str__(self) -> str:
        """Return charges, flow and pressure of the cycle."""
        charge = ", ".join(f"{1e6 * m:.1f}" for m in self.output("air_charge"))
        return (
            f"{self.inputs[0, 2]:.0f} rpm: charges {charge} mg, flow "
            f"{1e3 * self.output('throttle_flow').mean():.2f} g/s, manifold "
            f"{1e-3 * self.output('manifold_pressure').mean():.2f} kPa"
        )


@dataclass(frozen=True)
class MeanValueDynamics(_Replaceable):
    """Mean-value plant with its dynamics; `MeanValuePlant.dynamics` makes one.

    Parameters
    ----------
    maps : MeanValuePlant
        Charge and loss. With boundary conditions fitted, the charge follows the manifold
        pressure, which couples the cylinders; without, it does not.
    gains : sequence of n float
        Charge of each cylinder over that of the maps, 1; empty for equal cylinders.
    maf, map : MafSensor, MapSensor
        Sensors; noise, limits and quantisation are left out here.
    flow_shape : FlowShape
        How the air of an event flows past the MAF sensor; evenly by default (the paper's
        uniform pulses).
    throttle_deg : float
        Throttle angle; wide open by default.
    power_delay_deg : float
        Crank angle from the intake TDC, at which a command takes effect, to the TDC at which
        its charge burns: 180 deg of intake and 180 deg of compression.

    Raises
    ------
    ParameterError
        For gains that are not positive or not one a cylinder, or a shut throttle.

    Notes
    -----
    The manifold takes one implicit step an event, with uniform flow. Wide open that follows an
    exact integration of the same charges within 0.04 % in pressure and 0.3 % in flow; at part
    throttle a transient's flow is off by up to 12 % in an event (40 deg, 6000 rpm). Pulsation is
    left out: at high load wide open the pressure is 0.1 to 0.3 kPa above the full plant's mean,
    at part throttle and 1500 rpm the charge is up to 4 % high. `simulate` returns a Dataset, so
    the reading of the pressure sensor is ``result["map"]``.
    """

    maps: MeanValuePlant
    gains: Sequence[float] = ()
    maf: MafSensor = field(default_factory=MafSensor)
    map: MapSensor = field(default_factory=MapSensor)
    flow_shape: FlowShape = field(default_factory=FlowShape.even)
    throttle_deg: float = 90.0
    power_delay_deg: float = 360.0

    def __post_init__(self) -> None:
        engine = self.maps.engine
        n = engine.n_cylinders
        for name, kind in (("maf", MafSensor), ("map", MapSensor), ("flow_shape", FlowShape)):
            if not isinstance(getattr(self, name), kind):
                raise ParameterError(
                    f"{name} is {getattr(self, name)!r}, but must be a {kind.__name__}"
                )
        if isinstance(self.gains, str) or not isinstance(self.gains, Iterable):
            raise ParameterError(
                f"gains is {self.gains!r}, but must be a sequence of numbers: one a cylinder, or "
                "none"
            )
        gains = tuple(self.gains)
        if not gains and len(set(engine.cylinder_flow_factors)) > 1:
            raise ParameterError(
                f"the engine's cylinder_flow_factors are {engine.cylinder_flow_factors}, but the "
                "maps are means over the cylinders: give gains, the charge of each cylinder over "
                "that mean (from a steady cycle of the full plant)"
            )
        gains = gains or (1.0,) * n
        if len(gains) != n:
            raise ParameterError(
                f"gains has {len(gains)} values, but the engine has {n} cylinders: give one a "
                "cylinder, or none"
            )
        object.__setattr__(
            self, "gains", tuple(positive(f"gains[{i}]", g, "1") for i, g in enumerate(gains))
        )
        throttle = self.maps.engine.throttle
        in_range(
            "throttle_deg",
            self.throttle_deg,
            throttle.closed_deg,
            throttle.wide_open_deg,
            "deg",
            open_low=True,
            remedy="Eq. 19 gives no opening at smaller angles",
        )
        positive("maf.time_constant", self.maf.time_constant, "s")
        if self.map.delay != 0.0:
            raise ParameterError(
                f"map.delay is {self.map.delay:g} s, but must be 0: the mean-value plant has no "
                "delay of the pressure sensor"
            )
        in_range("power_delay_deg", self.power_delay_deg, 0.0, 720.0, "deg")

    # -- figures -----------------------------------------------------------------------------

    @property
    def n_cylinders(self) -> int:
        """Number of cylinders."""
        return self.maps.engine.n_cylinders

    @property
    def throttle_area(self) -> float:
        """Effective area of the throttle, kg/s (Eq. 19)."""
        return self.maps.engine.throttle.area(self.throttle_deg)

    @property
    def power_delay_events(self) -> int:
        """``Delta T`` in whole events: that in which the charge's power stroke starts."""
        return int(self.power_delay_deg / self.maps.engine.event_angle_deg + 1e-9)

    def power_delay(self, speed_rpm: float) -> float:
        """``Delta T`` at a speed, s."""
        return self.power_delay_deg / (6.0 * positive("speed_rpm", speed_rpm, "rpm"))

    @cached_property
    def event(self) -> casadi.Function:
        """One event: ``(state, (lift, duration, speed), gain) -> (state, outputs, inside)``."""
        return step.event_step(self)

    @cached_property
    def _jacobian(self) -> casadi.Function:
        import casadi

        x = casadi.MX.sym("state", self.event.size1_in(0))
        v = casadi.MX.sym("input_and_gain", len(step.INPUTS) + 1)
        following, outputs, _ = self.event(x, v[:-1], v[-1])
        return casadi.Function(
            "event_matrices",
            [x, v],
            [
                casadi.jacobian(following, x),
                casadi.jacobian(following, v),
                casadi.jacobian(outputs, x),
                casadi.jacobian(outputs, v),
            ],
        )

    # -- operation ---------------------------------------------------------------------------

    def advance(
        self, state: ArrayLike, inputs: ArrayLike, gain: float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """Advance by one event.

        Parameters
        ----------
        state : array_like
            State at its start.
        inputs : array_like (3,)
            Lift in mm, duration in deg and speed in rpm.
        gain : float
            Charge of its cylinder over that of the maps.

        Returns
        -------
        state, outputs : ndarray
            State at the end of the event, and its outputs.

        Raises
        ------
        ParameterError, InfeasibleProfileError
            Where the maps do not hold.
        """
        state, inputs = np.asarray(state, dtype=float), np.asarray(inputs, dtype=float)
        if inputs.shape != (len(step.INPUTS),):
            raise ParameterError(
                f"the inputs have shape {inputs.shape}, but must be lift, duration and speed"
            )
        if not np.isfinite(state).all():
            raise ParameterError(
                "the state holds values that are not finite: take one from operating_point(...)"
            )
        positive("gain", gain, "1")
        if state.shape != (self.event.size1_in(0),):
            raise ParameterError(
                f"the state has shape {state.shape}, but must have ({self.event.size1_in(0)},): "
                "take one from operating_point(...)"
            )
        following, outputs, inside = self.event(state, np.asarray(inputs, dtype=float), gain)
        if not float(inside):
            self.maps.region.require(*inputs)
            self.refuse_pressure(float(state[0]))
        if not float(following[0]) > 0.0:
            self.refuse_emptied(float(inputs[2]), float(outputs[0]))
        return np.asarray(following).ravel(), np.asarray(outputs).ravel()

    def refuse_pressure(self, pressure: float) -> NoReturn:
        """Refuse a manifold pressure (Pa) at which the maps were found not to hold."""
        low, high = self.maps.boundary.ranges[0] if self.maps.boundary else (0.0, np.inf)
        raise ParameterError(
            f"the manifold pressure is {pressure:g} Pa, which is beyond the ambient pressures "
            f"that the maps cover, [{low:g}, {high:g}] Pa: open the throttle, or fit the "
            "boundary conditions over a wider range"
        )

    def refuse_emptied(self, speed_rpm: float, charge: float) -> NoReturn:
        """Refuse charges (kg) that would empty the manifold."""
        most = self.throttle_area * event_time(speed_rpm, self.n_cylinders)
        raise ParameterError(
            f"the throttle at {self.throttle_deg:g} deg passes at most {1e6 * most:.1f} mg an "
            f"event at {speed_rpm:g} rpm, but the commands ask for {1e6 * charge:.1f} mg, which "
            "would empty the manifold: open the throttle, or use maps with boundary conditions, "
            "whose charge falls with the manifold pressure"
        )

    def operating_point(
        self, commands: ValveCommand | Sequence[ValveCommand], speed_rpm: float
    ) -> DynamicOperatingPoint:
        """Find the periodic operation for commands at a speed.

        Parameters
        ----------
        commands : ValveCommand or sequence of n ValveCommand
            One command for all cylinders, or one for each; opening at TDC.

        Raises
        ------
        ParameterError, InfeasibleProfileError
            Where the maps do not hold.
        ConvergenceError
            If no periodic operation is found.
        """
        inputs = self._inputs(commands, speed_rpm)
        state = self._first_guess(inputs)
        # A small charge that passes the throttle is known to what the manifold's mass rounds to.
        mass = step.manifold_capacity(self) * self.maps.engine.ambient_pressure
        for _ in range(_MOST_ITERATIONS):
            point = self._cycle(state, inputs)
            end, _ = self.advance(point.states[-1], inputs[-1], self.gains[-1])
            change = np.eye(len(state))
            for k in range(self.n_cylinders):
                change = self._matrices(point, k)[0] @ change
            move = np.linalg.solve(np.eye(len(state)) - change, end - state)
            # The orifice is steep near ambient pressure: keep the pressure in its range.
            limit = 0.3 * state[0]
            share = min(1.0, limit / abs(move[0])) if move[0] else 1.0
            state = state + share * move
            if np.all(np.abs(move) <= _SETTLED * np.maximum(np.abs(state), mass)):
                return self._cycle(state, inputs)
        raise ConvergenceError(
            f"no periodic operation of the mean-value plant found at {speed_rpm:g} rpm after "
            f"{_MOST_ITERATIONS} iterations"
        )

    def simulate(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        first: DynamicOperatingPoint | None = None,
    ) -> xr.Dataset:
        """Simulate event by event.

        Parameters
        ----------
        lift_mm, duration_deg, speed_rpm : array_like (k,)
            Inputs of each event; they broadcast against each other. Event i is that of cylinder
            ``i mod n``.
        first : DynamicOperatingPoint, optional
            Operation before; that of the first event's inputs by default.

        Returns
        -------
        xarray.Dataset
            The outputs against ``event``, with ``time`` (s, at the event's start), ``cylinder``
            and the inputs as coordinates.
        """
        import xarray as xr

        given = np.broadcast_arrays(
            *map(np.atleast_1d, broadcast("the inputs", lift_mm, duration_deg, speed_rpm))
        )
        inputs = np.stack(given, axis=-1)
        if inputs.ndim != 2 or not len(inputs):
            raise ParameterError(
                f"the inputs have shape {inputs.shape[:-1]}, but must be one value an event"
            )
        if first is None:
            first = self.operating_point(
                ValveCommand(float(inputs[0, 0]), float(inputs[0, 1])), float(inputs[0, 2])
            )
        state, rows = first.states[0], []
        for k, u in enumerate(inputs):
            state, outputs = self.advance(state, u, self.gains[k % self.n_cylinders])
            rows.append(outputs)
        values = np.array(rows)
        lengths = 120.0 / (self.n_cylinders * inputs[:, 2])
        variables = {
            name: ("event", values[:, k], {"units": unit})
            for k, (name, unit) in enumerate(zip(step.OUTPUTS, step.OUTPUT_UNITS, strict=True))
        }
        coordinates = {
            name: ("event", inputs[:, k], {"units": unit})
            for k, (name, unit) in enumerate(zip(step.INPUTS, step.INPUT_UNITS, strict=True))
        }
        time = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
        return xr.Dataset(
            variables,
            {
                "event": np.arange(len(inputs)),
                "time": ("event", time, {"units": "s"}),
                "cylinder": ("event", np.arange(len(inputs)) % self.n_cylinders + 1),
                **coordinates,
            },
        )

    # -- python-control ----------------------------------------------------------------------

    def as_nonlinear_system(self, domain: str = "event") -> control.NonlinearIOSystem:
        """Return the plant as a nonlinear system of python-control.

        Parameters
        ----------
        domain : {"event", "time"}
            Discrete with one intake event a step (``dt = 1`` event; event i is that of cylinder
            ``i mod n``), or continuous in time with uniform flow, delays as Padé fractions and
            the mean of the gains.

        Returns
        -------
        control.NonlinearIOSystem
            Inputs ``lift_mm``, ``duration_deg``, ``speed_rpm``; outputs ``air_charge`` (kg),
            ``power_charge`` (kg, burning now), ``pumping_loss`` (J), ``throttle_flow`` (kg/s),
            ``manifold_pressure`` (Pa), ``maf`` (kg/s) and ``map`` (Pa), the sensors' readings;
            in the event domain flow and readings are averages over the event.
        """
        one_of("domain", domain, ("event", "time"))
        if domain == "time":
            from ._time_domain import time_system

            return time_system(self)
        import control

        gains = self.gains

        def call(t: float, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
            gain = gains[round(float(t)) % len(gains)]
            return self.advance(x, u, gain)

        def update(t: float, x: FloatArray, u: FloatArray, _: Mapping[str, Any]) -> FloatArray:
            return call(t, x, u)[0]

        def output(t: float, x: FloatArray, u: FloatArray, _: Mapping[str, Any]) -> FloatArray:
            return call(t, x, u)[1]

        return control.nlsys(
            update,
            output,
            inputs=list(step.INPUTS),
            outputs=list(step.OUTPUTS),
            states=step.state_names(self),
            dt=1.0,
            name="mean_value_plant",
        )

    def linearize(
        self, command: ValveCommand, speed_rpm: float, *, relative: bool = True
    ) -> control.StateSpace:
        """Linearise the event-based plant of equal cylinders, exactly.

        Parameters
        ----------
        command : ValveCommand
            Command of all cylinders.
        speed_rpm : float
            Speed.
        relative : bool
            Whether all signals are relative changes (from the value ``v`` to ``(1 + s) v``),
            which makes the matrices of order one; or changes in their own units.

        Returns
        -------
        control.StateSpace
            Per event, with the names of `as_nonlinear_system` and the event's length in s as
            sampling time.

        Raises
        ------
        ParameterError
            If the cylinders are unequal: their plant changes from event to event (`lifted`).
        """
        import control

        if len(set(self.gains)) > 1:
            raise ParameterError(
                f"the gains are {list(self.gains)}, but must be equal here: use lifted(...), "
                "which takes each cylinder as it is"
            )
        point = self.operating_point(command, speed_rpm)
        A, B, C, D = self._matrices(point, 0)
        B, D = B[:, :3], D[:, :3]
        if relative:
            sx, su, sy = (_scale(v[0]) for v in (point.states, point.inputs, point.outputs))
            A, B, C, D = _scaled((A, B, C, D), sx, su, sy)
        return control.ss(
            A,
            B,
            C,
            D,
            event_time(speed_rpm, self.n_cylinders),
            inputs=list(step.INPUTS),
            outputs=list(step.OUTPUTS),
            states=step.state_names(self),
            name="linear_mean_value_plant",
        )

    def lifted(
        self,
        commands: ValveCommand | Sequence[ValveCommand],
        speed_rpm: float,
        *,
        inputs: Sequence[str] = ("duration_deg",),
        outputs: Sequence[str] = ("air_charge",),
        relative: bool = True,
    ) -> control.StateSpace:
        """Return the linear plant lifted over a cycle: from n commands to n charges.

        Parameters
        ----------
        commands, speed_rpm
            As for `operating_point`; cylinders and commands may differ.
        inputs : sequence of {"lift_mm", "duration_deg", "speed_rpm", "gain"}
            Inputs of each event to keep; ``gain`` is the charge of the cylinder over the map's.
        outputs : sequence of str
            Outputs of each event to keep.
        relative : bool
            As for `linearize`.

        Returns
        -------
        control.StateSpace
            Inputs ``duration_deg[1]`` to ``duration_deg[n]`` and so on, event by event; sampling
            time one cycle, in s.
        """
        import control

        allowed = (*step.INPUTS, step.GAIN)
        kept_in = [allowed.index(one_of("input", name, allowed)) for name in inputs]
        kept_out = [step.OUTPUTS.index(one_of("output", name, step.OUTPUTS)) for name in outputs]
        if not kept_in or not kept_out:
            raise ParameterError("inputs and outputs must each name one signal or more")
        point = self.operating_point(commands, speed_rpm)
        n = self.n_cylinders
        events = []
        for k in range(n):
            matrices = self._matrices(point, k)
            if relative:
                # One scale of the states for the cycle, or they would not fit together.
                sx, sy = _scale(point.states[0]), _scale(point.outputs[k])
                su = _scale(np.append(point.inputs[k], self.gains[k]))
                matrices = _scaled(matrices, sx, su, sy)
            A, B, C, D = matrices
            events.append((A, B[:, kept_in], C[kept_out], D[np.ix_(kept_out, kept_in)]))
        return control.ss(
            *lifted(events),
            n * event_time(speed_rpm, n),
            inputs=[f"{name}[{k + 1}]" for k in range(n) for name in inputs],
            outputs=[f"{name}[{k + 1}]" for k in range(n) for name in outputs],
            states=step.state_names(self),
            name="lifted_mean_value_plant",
        )

    # -- internals ---------------------------------------------------------------------------

    def _inputs(
        self, commands: ValveCommand | Sequence[ValveCommand], speed_rpm: float
    ) -> FloatArray:
        n = self.n_cylinders
        each = list(commands) if isinstance(commands, Sequence) else [commands] * n
        if len(each) != n or not all(isinstance(c, ValveCommand) for c in each):
            raise ParameterError(
                f"commands is {commands!r}, but must be one ValveCommand or one for each of the "
                f"{n} cylinders"
            )
        for c in each:
            if c.opening_deg != 0.0:
                raise ParameterError(
                    f"opening_deg is {c.opening_deg:g} deg, but the maps hold for 0 deg only"
                )
            self.maps.region.require(c.lift_mm, c.duration_deg, speed_rpm)
        return np.array([[c.lift_mm, c.duration_deg, float(speed_rpm)] for c in each])

    def _first_guess(self, inputs: FloatArray) -> FloatArray:
        """Settled state for the mean charge, the manifold at the pressure that it asks for."""
        T = event_time(float(inputs[0, 2]), self.n_cylinders)
        event, ambient = self.event, self.maps.engine.ambient_pressure

        def settled(pressure: float) -> tuple[float, float]:
            """Mean charge at a pressure, and the pressure at which the throttle passes it."""
            state = np.zeros(event.size1_in(0))
            state[0] = pressure
            pairs = zip(inputs, self.gains, strict=True)
            charge = float(np.mean([float(event(state, u, gain)[1][0]) for u, gain in pairs]))
            flow = min(max(charge, 0.0) / (self.throttle_area * T), 1.0)
            return charge, ambient * 0.5 * (1.0 + np.sqrt(1.0 - flow**2))

        charge, pressure = settled(ambient)
        if not self.maps.boundary and charge >= self.throttle_area * T:
            self.refuse_emptied(float(inputs[0, 2]), charge)
        if self.maps.boundary:  # the charge falls with the pressure, and the maps end somewhere
            low, high = self.maps.boundary.ranges[0][0], ambient
            while high - low > 1e-3 * ambient:
                pressure = 0.5 * (low + high)
                charge, asked = settled(pressure)
                low, high = (pressure, high) if asked > pressure else (low, pressure)
        taps = step.maf_taps(self)
        wait = self.power_delay_events
        past = [*[charge] * taps, *[T] * taps, *[charge] * wait]
        return np.array([pressure, pressure, charge / T, *past])

    def _cycle(self, state: FloatArray, inputs: FloatArray) -> DynamicOperatingPoint:
        states, outputs = [], []
        for u, gain in zip(inputs, self.gains, strict=True):
            states.append(state)
            state, y = self.advance(state, u, gain)
            outputs.append(y)
        return DynamicOperatingPoint(inputs, np.array(states), np.array(outputs))

    def _matrices(self, point: DynamicOperatingPoint, k: int) -> Matrices:
        A, B, C, D = self._jacobian(point.states[k], np.append(point.inputs[k], self.gains[k]))
        return np.array(A), np.array(B), np.array(C), np.array(D)


def _scale(values: FloatArray) -> FloatArray:
    """Values to divide by; 1 where there is nothing to be relative to."""
    return np.where(values != 0.0, np.abs(values), 1.0)


def _scaled(matrices: Matrices, sx: FloatArray, su: FloatArray, sy: FloatArray) -> Matrices:
    A, B, C, D = matrices
    return A * sx / sx[:, None], B * su / sx[:, None], C * sx / sy[:, None], D * su / sy[:, None]
