"""Feedforward: the valve command that the charge map promises the demanded charge for.

The lift follows a schedule over speed; the duration is the map's inverse on the early-closing
branch. Overlapping intake events are avoided by a longest duration. The inverse is read from
a table of the map at each speed, made when the speed is first seen.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError, ValveCommand, Valvetrain
from plant._checks import in_range, positive
from plant.kinematics import FloatArray
from plant.valve import shortest_duration

from .cylinder_parameters import CylinderParameters
from .event_data import EVENTS, PARTS, ModelPoint

_NOMINAL = CylinderParameters()
_EVEN = np.concatenate((np.full(PARTS, 1.0 / PARTS), np.zeros((EVENTS - 1) * PARTS)))
_EVEN.setflags(write=False)
_POINTS = 256  # of the table of a branch


class ChargeMap(Protocol):
    """What the feedforward asks of a plant for design, such as `plant.MeanValuePlant`."""

    def air_charge(
        self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike, /
    ) -> ArrayLike:
        """Charge in kg per event, at arrays that broadcast against each other."""
        ...


@dataclass(frozen=True, slots=True)
class LiftSchedule:
    """Valve lift over speed, linear between the nodes and held outside.

    The defaults follow the lift at which charge saturates (section 5 of Part I).
    """

    speed_rpm: tuple[float, ...] = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)  # rpm
    lift_mm: tuple[float, ...] = (2.0, 3.0, 5.0, 6.5, 7.0)  # mm

    def __post_init__(self) -> None:
        if not self.speed_rpm or len(self.speed_rpm) != len(self.lift_mm):
            raise ParameterError(
                f"the schedule has {len(self.speed_rpm)} speeds and {len(self.lift_mm)} lifts: "
                "give one lift per speed, at least one"
            )
        for lift in self.lift_mm:
            positive("lift_mm", lift, "mm")

    def at(self, speed_rpm: float) -> float:
        """Lift in mm at a speed in rpm."""
        return float(np.interp(speed_rpm, self.speed_rpm, self.lift_mm))


class FeedforwardCommand(NamedTuple):
    """A command and what the map makes of it."""

    command: ValveCommand
    charge: float  # kg, that the map promises
    limited: bool  # whether it differs from the charge asked for


class _Branch(NamedTuple):
    """Early-closing branch at one speed: charge rises with duration."""

    duration_deg: FloatArray
    charge: FloatArray


@dataclass(frozen=True, slots=True)
class Feedforward:
    """Map inverse at a scheduled lift.

    Parameters
    ----------
    charge_map : ChargeMap
        The map.
    lift : LiftSchedule
        Lift over speed.
    valvetrain : Valvetrain
        Valvetrain, which sets the shortest duration.
    longest_duration_deg : float
        Longest duration, deg. The charge may not pass its peak below it, and events that
        last longer than ``720/n`` overlap.
    lift_limits_mm : (float, float)
        Limits of the actuator, mm.
    """

    charge_map: ChargeMap
    lift: LiftSchedule = field(default_factory=LiftSchedule)
    valvetrain: Valvetrain = field(default_factory=Valvetrain)
    longest_duration_deg: float = 180.0
    lift_limits_mm: tuple[float, float] = (0.5, 8.0)
    _branches: dict[float, _Branch] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        in_range("longest_duration_deg", self.longest_duration_deg, 0.0, 360.0, "deg")
        for lift in self.lift.lift_mm:
            in_range("lift_mm", lift, *self.lift_limits_mm, "mm", remedy="the actuator's limits")

    def duration_limits_deg(self, speed_rpm: float) -> tuple[float, float]:
        """Shortest and longest duration in deg at a speed."""
        shortest = shortest_duration(self.lift.at(speed_rpm), self.valvetrain) * 6.0 * speed_rpm
        shortest *= 1.0 + 1e-6  # rounding may not make the profile infeasible
        if shortest >= self.longest_duration_deg:
            raise ParameterError(
                f"lift {self.lift.at(speed_rpm):g} mm at {speed_rpm:g} rpm takes {shortest:.1f} "
                f"deg, but the longest duration is {self.longest_duration_deg:g} deg: lower the "
                "lift schedule"
            )
        return shortest, self.longest_duration_deg

    def command(self, charge: float, speed_rpm: float) -> FeedforwardCommand:
        """Return the command for a charge in kg; of the nearest one in reach, if it must be."""
        branch = self._branch(float(speed_rpm))
        lift = self.lift.at(speed_rpm)
        reached = min(max(charge, float(branch.charge[0])), float(branch.charge[-1]))
        duration = float(np.interp(reached, branch.charge, branch.duration_deg))
        return FeedforwardCommand(ValveCommand(lift, duration), reached, reached != charge)

    def inverse(
        self,
        demand: float,
        speed_rpm: float,
        parameters: CylinderParameters = _NOMINAL,
        density: float = 1.0,
    ) -> ModelPoint:
        """Return the command for a charge in kg with a cylinder's parameters.

        This simple model takes the charge as proportional to charge factor, flow gain and
        density, and its inflow as even over the event.
        """
        factor = parameters.charge_factor * parameters.flow_gain * density
        found = self.command(demand / factor, speed_rpm)
        rate = 6.0 * speed_rpm
        return ModelPoint(
            found.command.lift_mm,
            found.command.duration_deg - rate * parameters.duration_offset,
            factor * found.charge,
            found.limited,
            1.0,
            rate * self.sensitivity(found.charge, speed_rpm) / found.charge,
            _EVEN,
        )

    def limits(
        self,
        speed_rpm: float,
        parameters: CylinderParameters = _NOMINAL,
        density: float = 1.0,
    ) -> tuple[float, float]:
        """Lowest and highest charge in kg that can be commanded with a cylinder's parameters."""
        factor = parameters.charge_factor * parameters.flow_gain * density
        charge = self._branch(float(speed_rpm)).charge
        return factor * float(charge[0]), factor * float(charge[-1])

    def charge_at(self, duration_deg: float, speed_rpm: float) -> float:
        """Charge that the map promises at a duration, kg; held beyond the branch."""
        branch = self._branch(float(speed_rpm))
        return float(np.interp(duration_deg, branch.duration_deg, branch.charge))

    def sensitivity(self, charge: float, speed_rpm: float) -> float:
        """Slope of the map's charge over duration where it gives a charge (kg), kg/deg."""
        branch = self._branch(float(speed_rpm))
        slope = np.gradient(branch.charge, branch.duration_deg)
        return float(np.interp(charge, branch.charge, slope))

    def _branch(self, speed_rpm: float) -> _Branch:
        known = self._branches.get(speed_rpm)
        if known is not None:
            return known
        duration = np.linspace(*self.duration_limits_deg(speed_rpm), _POINTS)
        values = self.charge_map.air_charge(self.lift.at(speed_rpm), duration, speed_rpm)
        charge = np.asarray(values, dtype=float)
        # Where the runner makes the charge rise in waves, the first rise to a charge counts.
        highest = np.maximum.accumulate(charge)
        rising = np.concatenate(([True], highest[1:] > highest[:-1]))
        branch = _Branch(duration[rising], highest[rising])
        self._branches[speed_rpm] = branch
        return branch
