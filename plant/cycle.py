"""Results of the crank-angle plant: a periodic cycle, and one event of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .kinematics import FloatArray
from .state import PlantState
from .trace import Trace
from .valve import ValveCommand

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .crank_angle import CrankAnglePlant


@dataclass(frozen=True)
class Cycle:
    """Periodic solution of the plant at one operating point.

    Attributes
    ----------
    plant : CrankAnglePlant
        The plant.
    speed_rpm, throttle_deg : float
        Operating point.
    commands : tuple of ValveCommand
        One command per cylinder, as given.
    delivered_lift_mm : ndarray (n,)
        Maximum lift of each valve; below the command where `limited`.
    air_charge : ndarray (n,)
        Net air taken in per event, kg (section 3.1).
    pumping_loss : ndarray (n,)
        Work of the loop below exhaust pressure per event, J (section 3.2).
    throttle_mass : float
        Air through the throttle per cycle, kg.
    cycles : float
        Cycles simulated until the solution was periodic; equal cylinders repeat one event
        apart, and need parts of a cycle.
    residual : float
        Largest change of what the last event of equal cylinders, or the last cycle of others,
        hands on; see the tolerance of `CrankAnglePlant.steady_cycle`.
    state : PlantState
        State at the start of the cycle.
    """

    plant: CrankAnglePlant
    speed_rpm: float
    throttle_deg: float
    commands: tuple[ValveCommand, ...]
    delivered_lift_mm: FloatArray
    air_charge: FloatArray
    pumping_loss: FloatArray
    throttle_mass: float
    cycles: float
    residual: float
    state: PlantState = field(repr=False)

    @property
    def limited(self) -> np.ndarray:
        """Whether each valve's lift was limited by its duration, bool (n,)."""
        wanted = np.array([command.lift_mm for command in self.commands])
        return self.delivered_lift_mm < wanted

    @property
    def specific_pumping_loss(self) -> FloatArray:
        """Pumping loss over air charge, J/kg; NaN without charge."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.air_charge > 0.0, self.pumping_loss / self.air_charge, np.nan)

    @cached_property
    def trace(self) -> Trace:
        """Crank-resolved signals of the cycle, every degree (or the nearest even division)."""
        return self.trace_at(1.0)

    def trace_at(self, step_deg: float) -> Trace:
        """Crank-resolved signals of the cycle at about every `step_deg` degrees."""
        return self.plant._trace_cycle(self, step_deg)

    def plot(self, cylinder: int = 1) -> Figure:
        """Draw lift, pressures, flows and the pumping loop of one cylinder (from 1)."""
        from matplotlib.gridspec import GridSpec

        from ._plotting import styled

        figure = self.trace.plot(cylinder)
        with styled():
            figure.set_size_inches(10.5, 6.6)
            rows = figure.axes
            grid = GridSpec(3, 2, figure=figure)
            for k, ax in enumerate(rows):
                ax.set_subplotspec(grid[k, 0])
            loop = figure.add_subplot(grid[:, 1])
            self.trace.plot_pv(cylinder, loop)
            loop.axhline(self.plant.engine.exhaust_pressure / 1e5, ls=":", c="0.4")
            loop.set_title(
                f"charge {1e6 * self.air_charge[cylinder - 1]:.1f} mg, "
                f"loss {self.pumping_loss[cylinder - 1]:.2f} J"
            )
        return figure

    def __str__(self) -> str:
        """Return a table of charge and loss, one line a cylinder."""
        lines = [
            f"{self.plant.profile} cycle at {self.speed_rpm:g} rpm, throttle "
            f"{self.throttle_deg:g} deg (periodic to {self.residual:.0e} in {self.cycles:.3g} "
            "cycles)"
        ]
        for j, command in enumerate(self.commands):
            lift = f"lift {self.delivered_lift_mm[j]:.2f} mm"
            if self.limited[j]:
                lift += f" (limited from {command.lift_mm:g})"
            lines.append(
                f"  cylinder {j + 1}: {lift}, {command.opening_deg:g} to "
                f"{command.closing_deg:g} deg: charge {1e6 * self.air_charge[j]:.2f} mg, loss "
                f"{self.pumping_loss[j]:.3f} J"
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class CompletedEvent:
    """Result of one intake event, known at its IVC."""

    cylinder: int  # from 1
    air_charge: float  # kg
    pumping_loss: float  # J


@dataclass(frozen=True)
class EventResult:
    """What happened in one event window of a run.

    Attributes
    ----------
    event_index : int
        Number of the event since the start.
    cylinder : int
        Cylinder (from 1) whose valve was commanded in this window.
    duration : float
        Length of the window, s.
    delivered_lift_mm : float
        Lift of the commanded valve.
    limited : bool
        Whether that lift is below the command.
    completed : tuple of CompletedEvent
        Events whose valve closed in this window; one that overlaps with later windows is
        reported there.
    throttle_mass : float
        Air that passed the throttle, kg.
    manifold_pressure : float
        At the end of the window, Pa.
    trace : Trace or None
        Crank-resolved signals of the window, if asked for.
    """

    event_index: int
    cylinder: int
    duration: float
    delivered_lift_mm: float
    limited: bool
    completed: tuple[CompletedEvent, ...]
    throttle_mass: float
    manifold_pressure: float
    trace: Trace | None = field(repr=False)
