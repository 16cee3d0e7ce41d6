"""Results of the throttled mean-value plant: inverse, error against the full plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .kinematics import FloatArray


class ThrottlePoint(NamedTuple):
    """Speed and throttle angle of a steady cycle."""

    speed_rpm: float
    throttle_deg: float

    def __str__(self) -> str:
        """Return the point with its units."""
        return f"{self.speed_rpm:.0f} rpm, {self.throttle_deg:.1f} deg"


@dataclass(frozen=True)
class ThrottleInverse:
    """Throttle angles that give wanted charges, and what these cost.

    Attributes
    ----------
    throttle_deg : float or ndarray
        Throttle angle; NaN where the charge cannot be reached.
    manifold_pressure : float or ndarray
        Mean manifold pressure, Pa.
    pumping_loss : float or ndarray
        Pumping loss, J per event.
    reachable : bool or ndarray
        Whether the charge can be reached at this speed.
    charge : float or ndarray
        Wanted charge, kg per event.
    lowest_charge, highest_charge : float or ndarray
        What can be reached at this speed, kg per event.
    """

    throttle_deg: FloatArray
    manifold_pressure: FloatArray
    pumping_loss: FloatArray
    reachable: NDArray[np.bool_]
    charge: FloatArray
    lowest_charge: FloatArray
    highest_charge: FloatArray

    def __str__(self) -> str:
        """Return angle and loss, or how many charges are out of reach and what is in reach."""
        if np.size(self.charge) > 1:
            missed = int(np.size(self.reachable) - np.sum(self.reachable))
            return (
                f"throttle angles for {np.size(self.charge)} charges, {missed} of them out of "
                "reach (NaN)"
            )
        charge, low, high = (
            1e6 * _scalar(v) for v in (self.charge, self.lowest_charge, self.highest_charge)
        )
        if not np.all(self.reachable):
            return f"{charge:.2f} mg is out of reach: {low:.2f} to {high:.2f} mg can be had"
        return (
            f"{charge:.2f} mg at {_scalar(self.throttle_deg):.2f} deg and "
            f"{_scalar(self.manifold_pressure) / 1e3:.2f} kPa: loss "
            f"{_scalar(self.pumping_loss):.3f} J"
        )


@dataclass(frozen=True)
class ThrottledMapError:
    """Error of the throttled maps against a full plant at random points.

    Relative to the largest charge, loss and pressure at the point's speed.

    Attributes
    ----------
    charge_rms, charge_max, loss_rms, loss_max : float
        Relative errors at the full plant's mean pressure, 1.
    pressure_rms, pressure_max : float
        Relative error of the steady pressure that follows from the throttle angle, 1.
    worst_charge, worst_loss, worst_pressure : ThrottlePoint
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
    pressure_rms: float
    pressure_max: float
    worst_charge: ThrottlePoint
    worst_loss: ThrottlePoint
    worst_pressure: ThrottlePoint
    points: int
    seed: int
    same_plant: bool

    def __str__(self) -> str:
        """Return the errors in a sentence."""
        plant = "the full plant" if self.same_plant else "another full plant"
        parts = (
            f"{name} {100 * rms:.3f} % rms and {100 * worst:.2f} % at worst (at {where})"
            for name, rms, worst, where in (
                ("charge", self.charge_rms, self.charge_max, self.worst_charge),
                ("loss", self.loss_rms, self.loss_max, self.worst_loss),
                ("steady pressure", self.pressure_rms, self.pressure_max, self.worst_pressure),
            )
        )
        return (
            f"Against {plant} at {self.points} random points (seed {self.seed}), relative to the "
            f"largest value at each speed: {'; '.join(parts)}."
        )


def _scalar(value: FloatArray) -> float:
    return float(np.ravel(value)[0])
