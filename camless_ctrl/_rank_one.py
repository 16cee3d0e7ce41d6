"""Structured singular value and worst sensitivity of a loop whose uncertainty has rank one.

All perturbations see the same signal, the true charge error, and add at one point, the
estimate. With ``K`` the law and its latency, ``S = 1/(1 + K E_c)`` and a perturbation of the
estimate by ``sum_k d_k H_k + W D`` the sensitivity becomes

    S_p = S/(1 - s),   s = sum_k d_k c_k + r D,   c_k = -S K H_k,   r = |S K W|.

The values of ``s`` fill a convex set: a zonotope of the real segments ``c_k`` and a disk. So mu is
the largest real number in it, which duality makes the least value of a convex function,

    mu = min over t of sum_k |Re c_k + t Im c_k| + r sqrt(1 + t^2),

and the worst ``|S|`` is ``|S|/(distance from 1 to the set)``. The error ``W_p y`` is one more
function of the same signal, and the disturbance adds at that signal: performance only widens
the disk to ``r + |W_p S|``. All is exact at the frequencies given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    import control

    from .uncertain_measurement import UncertainMeasurement


@dataclass(frozen=True)
class UncertainValues:
    """Values of an uncertain measurement at points per event.

    Attributes
    ----------
    z : ndarray (f,)
        Points.
    delay : ndarray (f,)
        Latency, ``z^-latency``.
    centre : ndarray (f,)
        ``E_c``.
    directions : ndarray (k, f)
        ``H_k``.
    weight : ndarray (f,)
        ``|W|``.
    """

    z: ComplexArray
    delay: ComplexArray
    centre: ComplexArray
    directions: ComplexArray
    weight: FloatArray

    @classmethod
    def of(cls, measurement: UncertainMeasurement, angle: FloatArray) -> UncertainValues:
        """Return the values at angles per event, rad in [0, pi]."""
        z = np.exp(1j * angle)
        return cls(
            z,
            z**-measurement.latency,
            measurement.centre(z),
            np.stack([direction(z) for direction in measurement.directions.values()]),
            measurement.weight.magnitude(angle / measurement.event_time),
        )


@dataclass(frozen=True)
class RankOneLoop:
    """Loop with uncertainty of rank one at given frequencies.

    Attributes
    ----------
    sensitivity : ndarray (..., f)
        ``S`` for the middle of the set.
    segments : ndarray (k, ..., f)
        ``c_k``.
    radius : ndarray (..., f)
        ``r``.
    """

    sensitivity: ComplexArray
    segments: ComplexArray
    radius: FloatArray

    @classmethod
    def of(
        cls, values: UncertainValues, numerator: ComplexArray, denominator: ComplexArray
    ) -> RankOneLoop:
        """Return the loop with the law ``numerator/denominator`` (..., f), poles included."""
        through = numerator * values.delay
        closed = denominator + through * values.centre
        shape = (-1,) + (1,) * (closed.ndim - 1) + (values.z.size,)
        return cls(
            denominator / closed,
            -values.directions.reshape(shape) * (through / closed),
            values.weight * np.abs(through / closed),
        )

    @classmethod
    def of_law(cls, values: UncertainValues, law: control.StateSpace) -> RankOneLoop:
        """Return the loop with a law per event."""
        response = np.asarray(law(values.z, warn_infinite=False), dtype=complex)
        finite = np.isfinite(response)
        return cls.of(values, np.where(finite, response, 1.0), finite.astype(complex))

    def mu_stability(self) -> FloatArray:
        """Mu of the perturbations (..., f)."""
        return largest_real(self.segments, self.radius)

    def mu_performance(self, sensitivity_bound: float) -> FloatArray:
        """Mu with the performance block of a bound on ``|S|`` (..., f)."""
        wider = self.radius + np.abs(self.sensitivity) / sensitivity_bound
        return largest_real(self.segments, wider)

    def worst_sensitivity(self) -> FloatArray:
        """Largest ``|S|`` over the set (..., f); infinite where it reaches instability."""
        distance = distance_from_one(self.segments) - self.radius
        size = np.abs(self.sensitivity)
        with np.errstate(divide="ignore"):
            return np.where(distance > 0.0, size / np.maximum(distance, 0.0), np.inf)


def largest_real(segments: ComplexArray, radius: FloatArray) -> FloatArray:
    """Largest real number in ``sum_k [-1, 1] c_k`` plus a disk.

    Parameters
    ----------
    segments : ndarray (k, ...)
        ``c_k``.
    radius : ndarray (...)
        Of the disk, at least 0.
    """
    re, im = segments.real, segments.imag
    flip = np.where(im < 0.0, -1.0, 1.0)  # the segments are symmetric: let all Im be >= 0
    re, im = flip * re, flip * im
    with np.errstate(divide="ignore", invalid="ignore"):
        corner = np.where(im > 0.0, -re / im, np.inf)  # where |Re + t Im| turns
    order = np.argsort(corner, axis=0)
    corner = np.take_along_axis(corner, order, axis=0)
    rise = np.take_along_axis(im, order, axis=0)
    # Slope of the sum of absolute values left of the first corner, between, and right of the last.
    total = rise.sum(axis=0)
    slope = np.concatenate((-total[None], -total + 2.0 * np.cumsum(rise, axis=0)))
    with np.errstate(divide="ignore", invalid="ignore"):
        level = -slope / np.sqrt(radius**2 - slope**2)  # where the disk balances the slope
    level = np.where(np.abs(slope) < radius, level, 0.0)
    candidates = np.concatenate((np.where(np.isfinite(corner), corner, 0.0), level))
    values = radius * np.sqrt(1.0 + candidates**2)
    for a, b in zip(re, im, strict=True):
        values = values + np.abs(a + candidates * b)
    return np.asarray(values.min(axis=0))


def distance_from_one(segments: ComplexArray) -> FloatArray:
    """Distance from 1 to the zonotope ``sum_k [-1, 1] c_k``; 0 inside.

    The nearest point is on one of its edges, two parallel to each segment.
    """
    best = np.full(segments.shape[1:], np.inf)
    nearest = np.zeros(segments.shape[1:], dtype=complex)
    for k, along in enumerate(segments):
        others = np.delete(segments, k, axis=0)
        side = np.sign((np.conj(along) * others).imag)
        middle = (side * others).sum(axis=0)
        length = np.abs(along) ** 2
        for sign in (1.0, -1.0):
            offset = 1.0 - sign * middle
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.where(length > 0.0, (np.conj(along) * offset).real / length, 0.0)
            # Parallel segments have no side: they lengthen the edge.
            reach = 1.0 + np.where(
                length > 0.0,
                np.where(side == 0.0, np.abs(others), 0.0).sum(axis=0)
                / np.sqrt(np.where(length > 0.0, length, 1.0)),
                0.0,
            )
            point = sign * middle + np.clip(share, -reach, reach) * along
            distance = np.abs(1.0 - point)
            nearer = distance < best
            best, nearest = np.where(nearer, distance, best), np.where(nearer, point, nearest)
    # Outside, the direction to the nearest point separates 1 from the set.
    direction = 1.0 - nearest
    support = np.abs((np.conj(direction) * segments).real).sum(axis=0)
    return np.where(direction.real > support * (1.0 - 1e-12), best, 0.0)


def mode_grid(n_cylinders: int, points: int = 24) -> FloatArray:
    """Angles per event from 0 to pi: even steps, and finer ones towards the n-th roots of 1."""
    even = np.arange(1, points + 1) / points
    step = np.concatenate(([0.0], np.geomspace(1e-3, even[0], 8)[:-1], even)) * np.pi / n_cylinders
    roots = 2.0 * np.pi * np.arange(n_cylinders // 2 + 1) / n_cylinders
    angle = np.concatenate([root + side * step for root in roots for side in (-1.0, 1.0)])
    inside = angle[(angle > 0.0) & (angle < np.pi)]
    return np.unique(np.concatenate((inside, [0.0, np.pi])).round(14))
