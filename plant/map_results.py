"""Results of the mean-value plant: derivatives, inverse, errors against the full plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from .kinematics import FloatArray
from .region import OperatingPoint


@dataclass(frozen=True)
class MapGradient:
    """First derivatives of a map; units are the map's per that of the variable.

    Attributes
    ----------
    lift : ndarray
        By lift at constant duration and speed, kg/mm or J/mm.
    duration : ndarray
        By duration, kg/deg or J/deg.
    speed : ndarray
        By speed at constant lift and duration, kg/rpm or J/rpm.
    """

    lift: FloatArray
    duration: FloatArray
    speed: FloatArray


@dataclass(frozen=True)
class MapHessian:
    """Second derivatives of a map; units are the map's per those of the two variables.

    Attributes
    ----------
    lift_lift, duration_duration, speed_speed : ndarray
        Twice by the same variable.
    lift_duration, lift_speed, duration_speed : ndarray
        By two variables.
    """

    lift_lift: FloatArray
    duration_duration: FloatArray
    speed_speed: FloatArray
    lift_duration: FloatArray
    lift_speed: FloatArray
    duration_speed: FloatArray


@dataclass(frozen=True)
class ChargeInverse:
    """Durations that give wanted charges on the early-closing branch.

    Attributes
    ----------
    duration_deg : float or ndarray
        Shortest duration that gives the charge; NaN where it cannot be reached.
    reachable : bool or ndarray
        Whether the charge can be reached at this lift and speed.
    charge : float or ndarray
        Wanted charge, kg per event.
    lowest_charge, highest_charge : float or ndarray
        What can be reached at this lift and speed, kg per event.
    highest_at_deg : float or ndarray
        Duration of the highest charge.
    """

    duration_deg: FloatArray
    reachable: np.ndarray
    charge: FloatArray
    lowest_charge: FloatArray
    highest_charge: FloatArray
    highest_at_deg: FloatArray

    def __str__(self) -> str:
        """Return the duration, or how many charges are out of reach and the nearest in reach."""
        if np.size(self.charge) > 1:
            missed = int(np.size(self.reachable) - np.sum(self.reachable))
            return (
                f"durations for {np.size(self.charge)} charges, {missed} of them out of reach (NaN)"
            )
        charge, low, high = (
            1e6 * float(np.ravel(v)[0])
            for v in (self.charge, self.lowest_charge, self.highest_charge)
        )
        if np.all(self.reachable):
            return f"{charge:.2f} mg at {float(np.ravel(self.duration_deg)[0]):.2f} deg"
        return f"{charge:.2f} mg is out of reach: {low:.2f} to {high:.2f} mg can be had"


@dataclass(frozen=True)
class MapError:
    """Error of the maps against a full plant at random points.

    Relative to the largest charge and to the largest loss at the point's speed.

    Attributes
    ----------
    charge_rms, charge_max, loss_rms, loss_max : float
        Relative errors, 1.
    worst_charge, worst_loss : OperatingPoint
        Where the largest ones are.
    points, seed : int
        Number of points, and the seed that drew them.
    same_plant : bool
        Whether the full plant is the one that was fitted.
    """

    charge_rms: float
    charge_max: float
    loss_rms: float
    loss_max: float
    worst_charge: OperatingPoint
    worst_loss: OperatingPoint
    points: int
    seed: int
    same_plant: bool

    def __str__(self) -> str:
        """Return the errors in a sentence."""
        plant = "the full plant" if self.same_plant else "another full plant"
        return (
            f"Against {plant} at {self.points} random points (seed {self.seed}), relative to the "
            f"largest value at each speed: charge {100 * self.charge_rms:.3f} % rms and "
            f"{100 * self.charge_max:.2f} % at worst (at {self.worst_charge}); loss "
            f"{100 * self.loss_rms:.3f} % rms and {100 * self.loss_max:.2f} % at worst (at "
            f"{self.worst_loss})."
        )


@dataclass(frozen=True)
class BoundaryError:
    """Error of the maps at random boundary conditions and operating points.

    A fifth of the conditions are corners of the ranges.

    Relative to the largest charge and loss at the point's speed and the engine's own
    conditions, carried over with pressure and temperature.

    Attributes
    ----------
    charge_rms, charge_max, loss_rms, loss_max : float
        Relative errors, 1.
    worst_charge, worst_loss : str
        Where the largest ones are.
    points, seed : int
        Number of points, and the seed that drew them.
    """

    charge_rms: float
    charge_max: float
    loss_rms: float
    loss_max: float
    worst_charge: str
    worst_loss: str
    points: int
    seed: int

    @classmethod
    def none(cls) -> Self:
        """Return the error of what has not been measured."""
        nan = float("nan")
        return cls(nan, nan, nan, nan, "", "", 0, 0)

    def __str__(self) -> str:
        """Return the errors in a sentence."""
        return (
            f"At {self.points} random operating points and boundary conditions: charge "
            f"{100 * self.charge_rms:.2f} % rms and {100 * self.charge_max:.2f} % at worst (at "
            f"{self.worst_charge}); loss {100 * self.loss_rms:.2f} % rms and "
            f"{100 * self.loss_max:.2f} % at worst (at {self.worst_loss})."
        )
