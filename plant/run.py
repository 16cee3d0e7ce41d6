"""A run of the crank-angle plant, event by event."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import _entries as kernel
from . import _layout as layout
from ._handover import handed_on
from ._kernel_interface import check_status
from .cycle import CompletedEvent, EventResult
from .errors import ParameterError
from .kinematics import FloatArray
from .state import PlantState
from .trace import Trace
from .valve import OnInfeasible, ValveCommand

if TYPE_CHECKING:
    from .crank_angle import CrankAnglePlant


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
    def state(self) -> PlantState:
        """Where the run stands; another state of the same plant may be set.

        Raises
        ------
        ParameterError
            If a state that is set belongs to another plant.
        """
        return self._state

    @state.setter
    def state(self, state: PlantState) -> None:
        self.plant.check_state(state)
        self._state = state

    @property
    def next_cylinder(self) -> int:
        """Cylinder (from 1) that opens in the next event window."""
        return self.state.event_index % self.plant.engine.n_cylinders + 1

    def continue_with(self, plant: CrankAnglePlant) -> PlantRun:
        """Return a run that goes on from here with a changed engine; this one stays as it is.

        Ambient and exhaust pressure, temperature and the flow coefficients may differ. The
        manifold keeps its pressure, its mass following the temperature; cylinders keep their
        masses, so that the air of an open one is at the new temperature at once.

        Parameters
        ----------
        plant : CrankAnglePlant
            Plant with the same geometry, valvetrain, throttle and options.

        Raises
        ------
        ParameterError
            If the plant differs in anything else.
        """
        state = handed_on(self.state, self.plant, plant)
        return PlantRun(plant, state, self.speed_rpm, self.throttle_deg, self.on_infeasible)

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
        places = np.arange(n, dtype=np.float64)
        angles: FloatArray = (opening - places) % n * event_angle - advance
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
        check_status(status, speed)
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
