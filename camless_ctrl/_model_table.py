"""What the charge model's table holds, and the spline through it. Private to `charge_model`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from plant.kinematics import FloatArray

from .event_data import EVENTS, PARTS

_PARTS_OF_TABLE = {  # columns, in the kernel's order
    "charge": slice(0, 1),
    "lift_mm": slice(1, 2),
    "duration": slice(2, 3),
    "loss": slice(3, 4),
    "flow_response": slice(4, 8),
    "lift_response": slice(8, 10),
    "throttle_response": slice(10, 12),
    "duration_slope": slice(12, 13),
    "shares": slice(13, 13 + EVENTS * PARTS),
    "share_slopes": slice(13 + EVENTS * PARTS, 13 + 2 * EVENTS * PARTS),
}
COLUMNS = 13 + 2 * EVENTS * PARTS
LOWEST_DENSITY, HIGHEST_DENSITY = 0.55, 1.25  # relative densities that are fitted, 1
LOWEST_GAIN, HIGHEST_GAIN = 0.6, 1.8  # relative flow coefficients that are fitted, 1
MOST_DROP_MM = 1.0  # lift that may be taken off the path's, mm


class PathPointLike(Protocol):
    """Commands of a path at some points."""

    @property
    def lift_mm(self) -> FloatArray:
        """Lift, mm."""
        ...

    @property
    def duration_deg(self) -> FloatArray:
        """Duration, deg."""
        ...


class MotionPath(Protocol):
    """Valve motions from the least to the largest charge at every speed."""

    @property
    def speeds_rpm(self) -> FloatArray:
        """Speeds that the path is known for, rising."""
        ...

    @property
    def positions(self) -> FloatArray:
        """Positions along the path, from the least to the largest charge, rising."""
        ...

    def at(self, position: ArrayLike, speed_rpm: ArrayLike, /) -> PathPointLike:
        """Motions at positions and speeds that broadcast against each other."""
        ...


@dataclass(frozen=True)
class ModelTable:
    """Quantities at the nodes.

    Attributes
    ----------
    charge, lift_mm, duration, loss, duration_slope : ndarray (s, q)
        Charge in kg, lift in mm, duration in s, pumping loss in J; ``d ln m/d duration``, 1/s.
    flow_response : ndarray (s, q, 4)
        Of ln m by powers 1 to 4 of the ln of the flow gain, 1.
    lift_response : ndarray (s, q, 2)
        Of ln m by powers 1 and 2 of the lift taken off in mm.
    throttle_response : ndarray (s, q, 2)
        Of ln m by powers 1 and 2 of the ln of the gain of the throttle's flow coefficient, 1.
    shares, share_slopes : ndarray (s, q, EVENTS * PARTS)
        Shares of the inflow, and how they change with the ln of the flow gain, 1.
    flow_residual, narrow_residual : float
        Largest residual of ln m of the flow response, over all gains and within 20 %.
    cycles : int
        Steady cycles that were simulated.
    """

    charge: FloatArray
    lift_mm: FloatArray
    duration: FloatArray
    loss: FloatArray
    duration_slope: FloatArray
    flow_response: FloatArray
    lift_response: FloatArray
    throttle_response: FloatArray
    shares: FloatArray
    share_slopes: FloatArray
    flow_residual: float
    narrow_residual: float
    cycles: int

    def columns(self) -> FloatArray:
        """Return all quantities in the order of the kernel, (s, q, columns)."""
        single = (self.charge, self.lift_mm, self.duration, self.loss)
        return np.concatenate(
            [
                *(x[..., None] for x in single),
                self.flow_response,
                self.lift_response,
                self.throttle_response,
                self.duration_slope[..., None],
                self.shares,
                self.share_slopes,
            ],
            axis=-1,
        )


def named_columns(columns: FloatArray) -> dict[str, FloatArray]:
    """Split the last axis of a table by quantity."""
    found = {name: columns[..., part] for name, part in _PARTS_OF_TABLE.items()}
    return {k: v[..., 0] if v.shape[-1] == 1 else v for k, v in found.items()}


def spline_coefficients(values: FloatArray) -> FloatArray:
    """Coefficients of the uniform bicubic B-spline through values (s, q, k).

    Returns an array ``(s + 2, q + 2, k)``. At the ends the spline has no knot at the node next
    to them, so that a cubic is met exactly.
    """
    for axis in (0, 1):
        n = values.shape[axis]
        system = np.zeros((n + 2, n + 2))
        rows = np.arange(1, n + 1)
        for shift, weight in ((-1, 1.0), (0, 4.0), (1, 1.0)):
            system[rows, rows + shift] = weight / 6.0
        system[0, :5] = system[-1, -5:] = (1.0, -4.0, 6.0, -4.0, 1.0)
        inside = np.moveaxis(values, axis, 0)
        wanted = np.zeros((n + 2, *inside.shape[1:]))
        wanted[1:-1] = inside
        solved = np.linalg.solve(system, wanted.reshape(n + 2, -1)).reshape(wanted.shape)
        values = np.moveaxis(solved, 0, axis)
    return np.ascontiguousarray(values)
