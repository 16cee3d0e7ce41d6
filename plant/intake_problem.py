"""One cycle of the full plant as an initial value problem, for a solver of one's own.

The cycle is cut where the right-hand side has corners: IVO, IVC and the corners of the valve
motion. A solver goes from cut to cut; what happens at a cut, and the stretches in which no
cylinder breathes, are done here in closed form.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from . import _layout as layout
from . import right_hand_side as rhs
from ._compile import compiled
from ._implicit import fill_from_ambient
from .cycle import Cycle
from .errors import ParameterError
from .kinematics import FloatArray, radians_per_second
from .runner import forcing_amplitude, runner_gain
from .valve import corner_parameters, profile_corners

# Columns of the cylinders' state; the first four are those of a breathing cylinder.
AT_OPENING = 4  # mass at IVO, kg
CHARGE, LOSS = 5, 6  # of the last complete event, kg and J
STATE_COLUMNS = 7

Advance = Callable[[float, float, FloatArray, FloatArray], FloatArray]


class IntakeTables(NamedTuple):
    """The segments of a cycle as arrays, for compiled solvers; `S` segments, `n` cylinders."""

    start: FloatArray  # (S,), s
    end: FloatArray  # (S,), s
    n_breathing: np.ndarray  # (S,), number of breathing cylinders
    breathing: np.ndarray  # (S, n), which ones, from 0
    opening: np.ndarray  # (S, n), bool: whose valve opens at the start
    closing: np.ndarray  # (S, n), bool: whose valve shuts at the end
    parameters: FloatArray  # (S, P), of `right_hand_side`; a row may be longer than it needs
    top_time: FloatArray  # (S, n), intake TDC of each breathing cylinder's event, s


@compiled
def begin_segment(
    tables: IntakeTables, k: int, manifold: np.ndarray, cylinders: np.ndarray
) -> np.ndarray:
    """Open the valves that open at the start of a segment; return its initial state."""
    p = tables.parameters[k]
    n = tables.n_breathing[k]
    y = np.empty(rhs.FIRST_CYLINDER + rhs.STATE_STRIDE * n)
    y[rhs.MANIFOLD] = manifold[0]
    for i in range(n):
        j = tables.breathing[k, i]
        if tables.opening[k, j]:
            volume = _volume(p, tables.start[k] - tables.top_time[k, i])
            cylinders[j, : rhs.STATE_STRIDE] = 0.0
            cylinders[j, rhs.MASS] = p[rhs.EXHAUST_PRESSURE] * volume / p[rhs.GAS]
            cylinders[j, AT_OPENING] = cylinders[j, rhs.MASS]
        o = rhs.FIRST_CYLINDER + rhs.STATE_STRIDE * i
        y[o : o + rhs.STATE_STRIDE] = cylinders[j, : rhs.STATE_STRIDE]
    return y


@compiled
def end_segment(
    tables: IntakeTables, k: int, y: np.ndarray, manifold: np.ndarray, cylinders: np.ndarray
) -> None:
    """Store the state at the end of a segment and finish the events whose valves shut there."""
    p = tables.parameters[k]
    manifold[0] = y[rhs.MANIFOLD]
    for i in range(tables.n_breathing[k]):
        j = tables.breathing[k, i]
        o = rhs.FIRST_CYLINDER + rhs.STATE_STRIDE * i
        cylinders[j, : rhs.STATE_STRIDE] = y[o : o + rhs.STATE_STRIDE]
        if tables.closing[k, j]:
            since_top = tables.end[k] - tables.top_time[k, i]
            mass = cylinders[j, rhs.MASS]
            cylinders[j, CHARGE] = mass - cylinders[j, AT_OPENING]
            cylinders[j, LOSS] = cylinders[j, rhs.WORK] + loss_after_closing(p, mass, since_top)


@compiled
def fill_manifold(tables: IntakeTables, k: int, manifold: np.ndarray) -> None:
    """Advance a segment in which no cylinder breathes, exactly."""
    p = tables.parameters[k]
    full = p[rhs.CAPACITY] * p[rhs.AMBIENT_PRESSURE]
    time = tables.end[k] - tables.start[k]
    manifold[0] = full * fill_from_ambient(manifold[0] / full, p[rhs.THROTTLE_AREA] / full * time)


@compiled
def loss_after_closing(parameters: np.ndarray, mass: float, since_top: float) -> float:
    """Loss in J from IVC to the first instant after BDC with ``p_c >= p_exh`` (section 3.2).

    The shut cylinder keeps its mass, so the integral has a closed form; from IVC through BDC
    and back to the same volume it is zero. A mass too small to reach exhaust pressure is
    compressed to TDC.
    """
    p = parameters
    volume = _volume(p, since_top)
    past_bottom = p[rhs.OMEGA] * since_top >= math.pi - 1e-12
    bottom = 2.0 * p[rhs.HALF_STROKE_VOLUME] + p[rhs.CLEARANCE_VOLUME]
    at_exhaust = mass * p[rhs.GAS] / p[rhs.EXHAUST_PRESSURE]
    end = max(min(at_exhaust, volume if past_bottom else bottom), p[rhs.CLEARANCE_VOLUME])
    compression = mass * p[rhs.GAS] * math.log(end / volume)
    return p[rhs.EXHAUST_PRESSURE] * (end - volume) - compression


@compiled
def _volume(parameters: np.ndarray, since_top: float) -> float:
    turned = math.cos(parameters[rhs.OMEGA] * since_top)
    half = parameters[rhs.HALF_STROKE_VOLUME]
    return half * (1.0 - turned) + parameters[rhs.CLEARANCE_VOLUME]


@dataclass(frozen=True)
class IntakeSolution:
    """End of a cycle: charge and loss of each cylinder's event that ended in it.

    Attributes
    ----------
    air_charge : ndarray (n,)
        kg per event.
    pumping_loss : ndarray (n,)
        J per event.
    manifold : ndarray (1,)
        Mass in the manifold, kg.
    cylinders : ndarray (n, 7)
        State of the cylinders: mass, velocity, rate, work, mass at IVO, charge, loss.
    """

    air_charge: FloatArray
    pumping_loss: FloatArray
    manifold: FloatArray
    cylinders: FloatArray

    def __str__(self) -> str:
        """Return charge and loss of each cylinder."""
        return "\n".join(
            f"cylinder {j + 1}: charge {1e6 * m:.3f} mg, loss {e:.4f} J"
            for j, (m, e) in enumerate(zip(self.air_charge, self.pumping_loss, strict=True))
        )


@dataclass(frozen=True)
class IntakeProblem:
    """A cycle from its initial state, cut into segments; made by `from_cycle`.

    Attributes
    ----------
    tables : IntakeTables
        The segments.
    manifold : ndarray (1,)
        Mass in the manifold at the start, kg.
    cylinders : ndarray (n, 7)
        State of the cylinders at the start, as in `IntakeSolution`.

    Examples
    --------
    >>> import numpy as np
    >>> from plant import CrankAnglePlant, ValveCommand
    >>> from plant.right_hand_side import right_hand_side
    >>> from scipy.integrate import solve_ivp
    >>> def advance(start, end, y, parameters):
    ...     def f(t, y):
    ...         right_hand_side(t, y, parameters, rate := np.empty_like(y))
    ...         return rate
    ...
    ...     return solve_ivp(f, (start, end), y, method="LSODA", rtol=1e-6, atol=1e-9).y[:, -1]
    >>> cycle = CrankAnglePlant().steady_cycle(1500, ValveCommand(3.0, 189.0))
    >>> print(IntakeProblem.from_cycle(cycle).solve(advance))
    cylinder 1: charge 474.9...
    """

    tables: IntakeTables
    manifold: FloatArray
    cylinders: FloatArray

    @classmethod
    def from_cycle(cls, cycle: Cycle) -> Self:
        """Return the problem whose solution is a periodic cycle of the plant.

        It starts where the cycle starts, from the same state.

        Raises
        ------
        ParameterError
            If the plant has the exact orifice, which this right-hand side does not know.
        """
        plant = cycle.plant
        if plant.orifice != "simplified":
            raise ParameterError(
                f"orifice is {plant.orifice!r}, but this right-hand side has Eq. 13-14: use a "
                "plant with orifice='simplified'"
            )
        common = _common_parameters(cycle)
        events = _events(cycle)
        length = 120.0 / cycle.speed_rpm
        cuts = {0.0, length}
        for event in events:
            cuts.update(t for t in event.cuts if 0.0 < t < length)
        times = [0.0]
        for t in sorted(cuts)[1:]:
            if t - times[-1] > layout.SAME_TIME:
                times.append(t)
        times[-1] = length
        n, size = plant.engine.n_cylinders, len(times) - 1
        tables = IntakeTables(
            np.array(times[:-1]),
            np.array(times[1:]),
            np.zeros(size, np.int64),
            np.zeros((size, n), np.int64),
            np.zeros((size, n), np.bool_),
            np.zeros((size, n), np.bool_),
            np.zeros((size, rhs.FIRST_VALVE + rhs.VALVE_STRIDE * n)),
            np.zeros((size, n)),
        )
        for k in range(size):
            _fill_tables(tables, k, common, events)
        table = cycle.state.cylinders
        cylinders = np.zeros((n, STATE_COLUMNS))
        cylinders[:, rhs.MASS] = table[:, layout.MASS]
        cylinders[:, rhs.VELOCITY] = table[:, layout.VELOCITY]
        cylinders[:, rhs.RATE] = table[:, layout.ACCELERATION]
        cylinders[:, rhs.WORK] = table[:, layout.WORK]
        cylinders[:, AT_OPENING] = table[:, layout.MASS_AT_OPENING]
        if not plant.runner:
            cylinders[:, [rhs.VELOCITY, rhs.RATE]] = 0.0
        for event in events:
            if event.lift == 0.0:
                volume = _volume(common, event.opening - event.top)
                mass = common[rhs.EXHAUST_PRESSURE] * volume / common[rhs.GAS]
                since_top = event.opening - event.top
                cylinders[event.cylinder, LOSS] = loss_after_closing(common, mass, since_top)
        return cls(tables, cycle.state.manifold[:1].copy(), cylinders)

    @property
    def duration(self) -> float:
        """Length of the cycle, s."""
        return float(self.tables.end[-1])

    def solve(self, advance: Advance) -> IntakeSolution:
        """Integrate the cycle with a solver of one's own.

        Parameters
        ----------
        advance : callable
            ``advance(start, end, y, parameters)`` returns the state at `end` (times in s) of
            ``dy/dt = right_hand_side(t, y, parameters)``. It is called once for each segment
            in which a cylinder breathes.
        """
        tables = self.tables
        manifold, cylinders = self.manifold.copy(), self.cylinders.copy()
        for k in range(len(tables.start)):
            if tables.n_breathing[k] == 0:
                fill_manifold(tables, k, manifold)
                continue
            y = begin_segment(tables, k, manifold, cylinders)
            y = advance(tables.start[k], tables.end[k], y, tables.parameters[k])
            end_segment(tables, k, y, manifold, cylinders)
        return IntakeSolution(
            cylinders[:, CHARGE].copy(), cylinders[:, LOSS].copy(), manifold, cylinders
        )

    def restarted(self, solution: IntakeSolution) -> Self:
        """Return the problem of the following cycle."""
        return type(self)(self.tables, solution.manifold, solution.cylinders)


class _Event(NamedTuple):
    """An intake event of a cycle: its times from the start of the cycle, s."""

    cylinder: int
    top: float
    opening: float
    lift: float
    duration: float
    cuts: tuple[float, ...]
    forms: tuple[int, ...]  # of motion, after each cut but the last
    valve: FloatArray  # parameters of the valve


def _common_parameters(cycle: Cycle) -> FloatArray:
    plant, speed = cycle.plant, cycle.speed_rpm
    e, v = plant.engine, plant.engine.valvetrain
    p = np.zeros(rhs.FIRST_VALVE)
    p[rhs.GAS] = e.gas_constant * e.temperature
    p[rhs.CAPACITY] = e.manifold_volume / p[rhs.GAS]
    p[rhs.HALF_STROKE_VOLUME] = 0.5 * e.displaced_volume
    p[rhs.CLEARANCE_VOLUME] = e.clearance_volume
    p[rhs.AMBIENT_PRESSURE], p[rhs.EXHAUST_PRESSURE] = e.ambient_pressure, e.exhaust_pressure
    if plant.runner:
        p[rhs.RUNNER_GAIN] = runner_gain(e)
        p[rhs.RUNNER_FORCING] = forcing_amplitude(e, speed)
        p[rhs.NATURAL_FREQUENCY] = e.helmholtz.natural_frequency(speed)
        p[rhs.DAMPING] = e.helmholtz.damping_ratio(speed)
    p[rhs.OMEGA] = radians_per_second(speed)
    p[rhs.THROTTLE_AREA] = e.throttle.area(cycle.throttle_deg)
    p[rhs.OPENING_SLOPE], p[rhs.CLOSING_SLOPE] = v.opening_slope_mm_s, v.closing_slope_mm_s
    p[rhs.SEATING_SLOPE], p[rhs.ROUNDNESS] = v.seating_slope_mm_s, v.roundness
    if plant.oscillation:
        p[rhs.SWING] = v.oscillation_amplitude
        p[rhs.SWING_FREQUENCY] = 2.0 * math.pi / v.oscillation_period
        p[rhs.SWING_DECAY] = v.oscillation_decay_rate
    return p


def _events(cycle: Cycle) -> list[_Event]:
    """Return the events that touch a cycle: of each cylinder, its own and the one before."""
    plant = cycle.plant
    engine, rate = plant.engine, 6.0 * cycle.speed_rpm
    found = []
    for j, (lift, command) in enumerate(zip(cycle.delivered_lift_mm, cycle.commands, strict=True)):
        for before in (1, 0):
            top = (engine.event_angle_deg * j - 720.0 * before) + cycle.state.event_advance_deg
            opening = (top + command.opening_deg) / rate
            duration = command.duration_deg / rate
            if before and opening + duration <= layout.SAME_TIME:
                continue  # it ended before the cycle began
            valve = np.zeros(rhs.VALVE_STRIDE)
            valve[rhs.TOP_TIME], valve[rhs.OPENING_TIME] = top / rate, opening
            valve[rhs.FLOW_COEFFICIENT] = engine.flow_coefficients[j]
            valve[rhs.LIFT], valve[rhs.DURATION] = lift, duration
            cuts: tuple[float, ...]
            forms: tuple[int, ...]
            if lift == 0.0:
                cuts, forms = (opening,), ()
            elif plant.profile == "conventional":
                cuts, forms = (opening, opening + duration), (layout.CAM,)
            else:
                corners = profile_corners(lift, duration, *corner_parameters(engine.valvetrain))
                valve[rhs.RISE_END], valve[rhs.DWELL_END] = corners[0], corners[2]
                cuts = (opening, *(opening + corner for corner in corners))
                forms = tuple(range(layout.RISE, layout.CAM))
            found.append(_Event(j, top / rate, opening, lift, duration, cuts, forms, valve))
    return found


def _fill_tables(tables: IntakeTables, k: int, common: FloatArray, events: list[_Event]) -> None:
    """Write which cylinders breathe in a segment, in which form of motion."""
    start, end = tables.start[k], tables.end[k]
    middle = 0.5 * (start + end)
    tables.parameters[k, : rhs.FIRST_VALVE] = common
    for event in events:
        if not event.cuts[0] < middle < event.cuts[-1]:
            continue
        i, j = tables.n_breathing[k], event.cylinder
        valve = event.valve.copy()
        place = int(np.searchsorted(event.cuts, middle)) - 1
        valve[rhs.FORM] = event.forms[place]
        at = rhs.FIRST_VALVE + rhs.VALVE_STRIDE * i
        tables.parameters[k, at : at + rhs.VALVE_STRIDE] = valve
        tables.breathing[k, i], tables.top_time[k, i] = j, event.top
        tables.opening[k, j] = abs(event.cuts[0] - start) <= layout.SAME_TIME
        tables.closing[k, j] = abs(event.cuts[-1] - end) <= layout.SAME_TIME
        tables.n_breathing[k] = i + 1
    tables.parameters[k, rhs.COUNT] = tables.n_breathing[k]
