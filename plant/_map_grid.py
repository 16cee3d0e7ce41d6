"""Coordinates of the mean-value maps: the box in which their nodes lie, and the way there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ._checks import in_range, positive, whole
from .errors import ParameterError
from .kinematics import FloatArray
from .parameters import Engine
from .region import OperatingRegion

if TYPE_CHECKING:
    from .crank_angle import CrankAnglePlant

SPEED_RANGE_RPM = (750.0, 6000.0)  # section 5
LIFT_RANGE_MM = (0.5, 8.0)
LONGEST_DEG = 280.0
TOLERANCE = 5e-4
MOST_POINTS = 60_000
LEAST_POINTS = 512


@dataclass(frozen=True)
class BoxCoordinates:
    """Coordinates ``(-N_low/N, log(u_l), share)`` in which the region is a box.

    The phase that a runner goes through until the valve shuts is linear in the first one.
    """

    region: OperatingRegion

    @property
    def bounds(self) -> FloatArray:
        """Lowest and highest value of each coordinate, (3, 2)."""
        r = self.region
        return np.array(
            [
                [-1.0, -r.lowest_speed_rpm / r.highest_speed_rpm],
                np.log([r.lowest_lift_mm, r.highest_lift_mm]),
                [0.0, 1.0],
            ]
        )

    def of(self, lift: FloatArray, duration: FloatArray, speed: FloatArray) -> FloatArray:
        """Coordinates of feasible points, (3, ...); rounding at the shortest duration aside."""
        share = np.clip(self.region.share(lift, duration, speed).value, 0.0, 1.0)
        return np.stack((self.slowness(speed), np.log(lift), share))

    def slowness(self, speed: FloatArray) -> FloatArray:
        """Coordinate of speed, rising."""
        return -self.region.lowest_speed_rpm / speed

    def speed_and_lift(
        self, slowness: FloatArray, log_lift: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Speed in rpm and lift in mm at coordinates; those of the bounds are the region's."""
        r = self.region
        speed = np.clip(-r.lowest_speed_rpm / slowness, r.lowest_speed_rpm, r.highest_speed_rpm)
        lift = np.clip(np.exp(log_lift), r.lowest_lift_mm, r.highest_lift_mm)
        return speed, lift

    def jacobian(self, lift: FloatArray, duration: FloatArray, speed: FloatArray) -> FloatArray:
        """First derivatives (coordinate, variable, ...) by lift, duration and speed."""
        share = self.region.share(lift, duration, speed)
        result = np.zeros((3, 3, *np.shape(lift)))
        result[0, 2] = -self.slowness(speed) / speed
        result[1, 0] = 1.0 / lift
        result[2] = share.by_lift, share.by_duration, share.by_speed
        return result

    def curvature(self, lift: FloatArray, duration: FloatArray, speed: FloatArray) -> FloatArray:
        """Second derivatives (coordinate, variable, variable, ...)."""
        share = self.region.share(lift, duration, speed)
        result = np.zeros((3, 3, 3, *np.shape(lift)))
        result[0, 2, 2] = 2.0 * self.slowness(speed) / speed**2
        result[1, 0, 0] = -1.0 / lift**2
        # s = (d - a)/(L - a), where the shortest duration a is bilinear in lift and speed
        by_a = -(1.0 - share.value) * share.by_duration
        slope = np.stack((share.by_lift / by_a, np.zeros_like(lift), share.by_speed / by_a))
        result[2] = 2.0 * by_a * share.by_duration * slope[:, None] * slope[None, :]
        for k in (0, 2):
            mixed = share.by_duration**2 * slope[k]
            result[2, k, 1] += mixed
            result[2, 1, k] += mixed
        bilinear = by_a * slope[0] / speed
        result[2, 0, 2] += bilinear
        result[2, 2, 0] += bilinear
        return result


def map_region(
    engine: Engine,
    speed_range_rpm: tuple[float, float],
    lift_range_mm: tuple[float, float] | None,
    longest_deg: float,
) -> OperatingRegion:
    """Region of a map. Arguments as for a map's fit."""
    v = engine.valvetrain
    speeds = as_range("speed_range_rpm", speed_range_rpm, "rpm")
    lifts = (
        max(LIFT_RANGE_MM[0], v.lowest_lift_mm),
        min(LIFT_RANGE_MM[1], v.maximum_lift_mm),
    )
    if lift_range_mm is not None:
        lifts = as_range("lift_range_mm", lift_range_mm, "mm")
    return OperatingRegion(
        lowest_speed_rpm=speeds[0],
        highest_speed_rpm=speeds[1],
        lowest_lift_mm=lifts[0],
        highest_lift_mm=lifts[1],
        longest_deg=in_range("longest_deg", longest_deg, 0.0, 720.0, "deg", open_low=True),
        valvetrain=v,
    )


def as_range(name: str, value: tuple[float, float], unit: str) -> tuple[float, float]:
    """Return a range as two floats after checking that it is a pair of positive numbers.

    Raises
    ------
    ParameterError
        If it is not.
    """
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise ParameterError(
            f"{name} is {value!r}, but must be two numbers in {unit}: the lowest and the highest"
        )
    low, high = (positive(f"{name}[{k}]", end, unit) for k, end in enumerate(value))
    return low, high


def check_refinement(tolerance: float, most_points: int) -> tuple[float, int]:
    """Check what a refinement is asked for."""
    return (
        in_range("tolerance", tolerance, 0.0, 1.0, "1", open_low=True),
        whole("most_points", most_points, LEAST_POINTS, 1_000_000),
    )


def provenance(plant: CrankAnglePlant) -> dict[str, str | float | int]:
    """Where a map comes from: the full plant, its options and the version of the package."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        package = version("camless-ctrl")
    except PackageNotFoundError:  # run from a folder that was never installed
        package = "not installed"
    return {
        "plant_fingerprint": plant.fingerprint,
        "runner": str(plant.runner),
        "oscillation": str(plant.oscillation),
        "orifice": plant.orifice,
        "resolution": plant.resolution,
        "opening_deg": 0.0,
        "throttle_deg": plant.engine.throttle.wide_open_deg,
        "package": "camless-ctrl",
        "version": package,
    }
