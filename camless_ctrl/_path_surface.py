"""Smooth surface of lift over speed and position that never leaves the lifts it is made of.

A tensor product of cubic B-splines (C2) whose coefficients are lifts at the Greville abscissae
(Schoenberg's variation-diminishing spline): a value is an average of its neighbouring
coefficients with positive weights, so it cannot overshoot.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from plant.kinematics import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import NdBSpline

DEGREE = 3


@dataclass(frozen=True, eq=False)
class LiftSurface:
    """Lift over the logarithm of speed and over position."""

    speed_knots: FloatArray  # 1, logarithm of speed in rpm
    position_knots: FloatArray  # 1
    coefficients: FloatArray  # (s, q) mm

    @classmethod
    def through(cls, speeds_rpm: FloatArray, positions: FloatArray, lift_mm: FloatArray) -> Self:
        """Return the surface of lifts (s, q) at nodes, which it smooths."""
        x = np.log(speeds_rpm)
        knots_x, knots_y = _knots(x), _knots(positions)
        # Linear between the nodes, read where a coefficient acts.
        c = _resampled(_greville(knots_x), x, lift_mm)
        c = _resampled(_greville(knots_y), positions, c.T).T
        return cls(knots_x, knots_y, np.ascontiguousarray(c))

    @cached_property
    def _spline(self) -> NdBSpline:
        from scipy.interpolate import NdBSpline

        return NdBSpline((self.speed_knots, self.position_knots), self.coefficients, DEGREE)

    def __call__(self, position: FloatArray, speed_rpm: FloatArray) -> FloatArray:
        """Lift in mm at positions and speeds of one shape, all inside the nodes."""
        x = np.clip(np.log(speed_rpm), self.speed_knots[0], self.speed_knots[-1])  # last digit
        lift = np.asarray(self._spline(np.stack((x, position), axis=-1)), dtype=float)
        # An average cannot leave its terms; its last digit can.
        return np.clip(lift, self.coefficients.min(), self.coefficients.max())


def _knots(nodes: FloatArray) -> FloatArray:
    inner = [nodes[k : k + DEGREE].mean() for k in range(1, nodes.size - DEGREE)]
    return np.concatenate((np.full(4, nodes[0]), inner, np.full(4, nodes[-1])))


def _greville(knots: FloatArray) -> FloatArray:
    return (knots[1:-3] + knots[2:-2] + knots[3:-1]) / DEGREE


def _resampled(at: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Values (n, ...) along the first axis, linear between the nodes."""
    k = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    weight = np.clip((at - nodes[k]) / (nodes[k + 1] - nodes[k]), 0.0, 1.0)[:, None]
    return (1.0 - weight) * values[k] + weight * values[k + 1]
