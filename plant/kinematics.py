"""Crank kinematics, Eq. 3 and 4 of Part I.

Crank angle is in degrees after the cylinder's own intake top dead centre.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def degrees_per_second(speed_rpm: ArrayLike) -> FloatArray:
    """Crank speed ``6 N`` in deg/s (Eq. 4)."""
    return 6.0 * np.asarray(speed_rpm, dtype=float)


def radians_per_second(speed_rpm: ArrayLike) -> FloatArray:
    """Crank speed ``2 pi N/60`` in rad/s (Eq. 4)."""
    return np.pi / 30.0 * np.asarray(speed_rpm, dtype=float)


def cylinder_angle(crank_angle_deg: ArrayLike, cylinder: int, n_cylinders: int) -> FloatArray:
    """Crank angle after the intake TDC of cylinder `cylinder` (from 0), deg in [0, 720)."""
    offset = 720.0 / n_cylinders * cylinder
    return np.mod(np.asarray(crank_angle_deg, dtype=float) - offset, 720.0)


def cylinder_volume(
    angle_deg: ArrayLike, displaced_volume: float, clearance_volume: float
) -> FloatArray:
    """Cylinder volume in m3 (Eq. 3)."""
    angle = np.deg2rad(np.asarray(angle_deg, dtype=float))
    return 0.5 * displaced_volume * (1.0 - np.cos(angle)) + clearance_volume


def piston_velocity(angle_deg: ArrayLike, speed_rpm: ArrayLike, stroke: float) -> FloatArray:
    """Piston velocity ``(2 pi N/120) S sin(theta)`` in m/s, positive downwards (Eq. 7)."""
    angle = np.deg2rad(np.asarray(angle_deg, dtype=float))
    return 0.5 * radians_per_second(speed_rpm) * stroke * np.sin(angle)
