"""Charge, loss and throttle flow of the throttled engine between their nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .kinematics import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline, RectBivariateSpline

EDGE = 1e-3  # share by which a pressure may miss the range: its ends are interpolated in speed
_BISECTIONS = 50
_SCAN = 200


@dataclass(frozen=True, eq=False)
class PressureMaps:
    """Cubic splines (C2) in ``1/speed`` and the share of the way through the pressures.

    Attributes
    ----------
    speeds_rpm : ndarray (n,)
        Nodes of speed.
    shares : ndarray (k,)
        Nodes of the share of the way from the lowest to the highest pressure at a speed.
    pressure : ndarray (n, k)
        Pressure at the nodes, Pa.
    values : dict of str to ndarray (n, k)
        Quantities at the nodes.
    """

    speeds_rpm: FloatArray
    shares: FloatArray
    pressure: FloatArray
    values: dict[str, FloatArray]

    def ends(self, speed_rpm: FloatArray) -> FloatArray:
        """Lowest and highest pressure in Pa at speeds, (..., 2)."""
        return np.asarray(self._ends(self._slowness(speed_rpm)))

    def share(self, pressure: FloatArray, speed_rpm: FloatArray) -> FloatArray:
        """Share of the way from the lowest to the highest pressure at a speed."""
        low, high = np.moveaxis(self.ends(speed_rpm), -1, 0)
        return (pressure - low) / (high - low)

    def pressure_at(self, share: FloatArray, speed_rpm: FloatArray) -> FloatArray:
        """Pressure in Pa at a share of the way from the lowest to the highest one."""
        low, high = np.moveaxis(self.ends(speed_rpm), -1, 0)
        return low + (high - low) * share

    def held(self, name: str, share: FloatArray, speed_rpm: FloatArray) -> FloatArray:
        """Quantity at a share; beyond the ends that at the end."""
        inside = np.minimum(np.maximum(share, 0.0), 1.0)
        return np.asarray(self._spline(name).ev(self._slowness(speed_rpm), inside))

    def extended(self, name: str, share: FloatArray, speed_rpm: FloatArray) -> FloatArray:
        """Quantity at a share; beyond the ends along the tangent there."""
        inside = np.minimum(np.maximum(share, 0.0), 1.0)
        value = self.held(name, inside, speed_rpm)
        beyond = share - inside
        if not np.any(beyond):
            return value
        slope = self._spline(name).ev(self._slowness(speed_rpm), inside, dy=1)
        return np.asarray(value + slope * beyond)

    def first_rise(self, name: str, level: FloatArray, speed_rpm: FloatArray) -> Rise:
        """First share at which a quantity rises through levels (p,) at speeds (p,)."""
        grid = np.linspace(0.0, 1.0, _SCAN + 1)
        along = self.held(name, np.broadcast_to(grid, (level.size, grid.size)), speed_rpm[:, None])
        lowest, highest = along.min(axis=1), along.max(axis=1)
        rises = (along[:, :-1] <= level[:, None]) & (along[:, 1:] >= level[:, None])
        first = np.argmax(rises, axis=1)
        low, high = grid[first], grid[first + 1]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            below = self.held(name, middle, speed_rpm) < level
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        share = np.where(rises.any(axis=1), 0.5 * (low + high), np.nan)
        return Rise(share, lowest, highest)

    # -- internals ---------------------------------------------------------------------------

    def _slowness(self, speed_rpm: FloatArray) -> FloatArray:
        """Coordinate of speed, rising: ``-N_low/N``, 1."""
        return -self.speeds_rpm[0] / np.asarray(speed_rpm, dtype=float)

    @cached_property
    def _ends(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self._slowness(self.speeds_rpm), self.pressure[:, [0, -1]])

    @cached_property
    def _splines(self) -> dict[str, RectBivariateSpline]:
        from scipy.interpolate import RectBivariateSpline

        x = self._slowness(self.speeds_rpm)
        return {name: RectBivariateSpline(x, self.shares, v) for name, v in self.values.items()}

    def _spline(self, name: str) -> RectBivariateSpline:
        return self._splines[name]


@dataclass(frozen=True)
class Rise:
    """Where a quantity first rises through a level, and what it reaches."""

    share: FloatArray  # NaN where it does not
    lowest: FloatArray
    highest: FloatArray

    @property
    def found(self) -> NDArray[np.bool_]:
        """Whether it does."""
        return np.isfinite(self.share)
