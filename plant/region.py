"""Feasible operating region of the camless actuator, and its map to a box.

A duration must leave the valve time to rise and to fall (Eq. 20), so the shortest duration
grows with lift and speed. The *share* of the way from that shortest duration to the longest
one makes a box of the region: every node of a map in it can be simulated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ._checks import broadcast, in_range, one_of, positive, whole
from .errors import InfeasibleProfileError, ParameterError
from .kinematics import FloatArray
from .parameters import Valvetrain
from .valve import LATEST_CLOSING_DEG, highest_lift_mm, shortest_duration

Outside = Literal["raise", "nan"]

_INSIDE = 1e-9  # relative clearance to the limit, against rounding
_ROUNDING = 1e-7  # share by which a point may miss the limit and still count as on it


class OperatingPoint(NamedTuple):
    """Speed, lift and duration of a steady cycle that opens at TDC."""

    speed_rpm: float
    lift_mm: float
    duration_deg: float

    def __str__(self) -> str:
        """Return the point with its units."""
        return f"{self.speed_rpm:.0f} rpm, {self.lift_mm:.2f} mm, {self.duration_deg:.1f} deg"


class Share(NamedTuple):
    """Share of the way from the shortest to the longest duration, and its derivatives."""

    value: FloatArray  # 1
    by_lift: FloatArray  # 1/mm, at constant duration and speed
    by_duration: FloatArray  # 1/deg
    by_speed: FloatArray  # 1/rpm, at constant lift and duration


@dataclass(frozen=True)
class OperatingRegion:
    """Speeds, lifts and durations that a camless actuator can drive (opening at TDC).

    Attributes
    ----------
    lowest_speed_rpm, highest_speed_rpm : float
        Range of speeds.
    lowest_lift_mm, highest_lift_mm : float
        Range of lifts; within that of the valvetrain.
    longest_deg : float
        Longest duration.
    valvetrain : Valvetrain
        The actuator, which sets the shortest duration.

    Raises
    ------
    ParameterError
        If a range is empty, exceeds the valvetrain's, or no duration is left for the highest
        lift at the highest speed.
    """

    lowest_speed_rpm: float
    highest_speed_rpm: float
    lowest_lift_mm: float
    highest_lift_mm: float
    longest_deg: float
    valvetrain: Valvetrain

    def __post_init__(self) -> None:
        v = self.valvetrain
        positive("lowest_speed_rpm", self.lowest_speed_rpm, "rpm")
        positive("highest_speed_rpm", self.highest_speed_rpm, "rpm")
        bounds = v.lowest_lift_mm, v.maximum_lift_mm
        in_range("lowest_lift_mm", self.lowest_lift_mm, *bounds, "mm")
        in_range("highest_lift_mm", self.highest_lift_mm, *bounds, "mm")
        for name in ("speed_rpm", "lift_mm"):
            low, high = getattr(self, f"lowest_{name}"), getattr(self, f"highest_{name}")
            if low >= high:
                raise ParameterError(
                    f"highest_{name} is {high:g}, but must be above lowest_{name} = {low:g}"
                )
        in_range("longest_deg", self.longest_deg, 0.0, LATEST_CLOSING_DEG, "deg", open_low=True)
        needed = float(self.shortest_deg(self.highest_lift_mm, self.highest_speed_rpm))
        if needed >= self.longest_deg:
            raise ParameterError(
                f"longest_deg is {self.longest_deg:g} deg, but {self.highest_lift_mm:g} mm at "
                f"{self.highest_speed_rpm:g} rpm needs at least {_up(needed):.1f} deg: lengthen "
                "it, or lower the highest lift or speed"
            )

    def shortest_deg(self, lift_mm: ArrayLike, speed_rpm: ArrayLike) -> FloatArray:
        """Shortest duration in deg that reaches a lift at a speed (Eq. 20, dwell zero)."""
        return shortest_deg(lift_mm, speed_rpm, self.valvetrain)

    def feasible(
        self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike
    ) -> np.ndarray:
        """Whether points lie in the region, bool, of their broadcast shape."""
        lift, duration, speed = broadcast("the operating points", lift_mm, duration_deg, speed_rpm)
        # A comparison with NaN is False: not a number is not feasible.
        return (
            (speed >= self.lowest_speed_rpm)
            & (speed <= self.highest_speed_rpm)
            & (lift >= self.lowest_lift_mm)
            & (lift <= self.highest_lift_mm)
            & (duration <= self.longest_deg)
            & (duration >= self.shortest_deg(lift, speed) * (1.0 - _ROUNDING))
        )

    def share(self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike) -> Share:
        """Share of the way from the shortest (0) to the longest duration (1)."""
        lift, duration, speed = broadcast("the operating points", lift_mm, duration_deg, speed_rpm)
        shortest = self.shortest_deg(lift, speed)
        span = self.longest_deg - shortest
        value = (duration - shortest) / span
        # Only the shortest duration depends on lift and speed.
        by_shortest = -(1.0 - value) / span
        _, rate = _shortest_time(self.valvetrain)
        return Share(
            value,
            by_shortest * 6.0 * speed * rate * (1.0 + _INSIDE),
            1.0 / span,
            by_shortest * shortest / speed,
        )

    def duration_deg(
        self, lift_mm: ArrayLike, share: ArrayLike, speed_rpm: ArrayLike
    ) -> FloatArray:
        """Duration in deg at a share of the way from the shortest to the longest one."""
        shortest = self.shortest_deg(lift_mm, speed_rpm)
        return shortest + (self.longest_deg - shortest) * np.asarray(share, dtype=float)

    def require(self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike) -> None:
        """Check that all points lie in the region.

        Raises
        ------
        ParameterError
            Naming the first value outside its range.
        InfeasibleProfileError
            Naming the highest lift and the shortest duration, for the infeasible corner.
        """
        lift, duration, speed = broadcast("the operating points", lift_mm, duration_deg, speed_rpm)
        outside = ~self.feasible(lift, duration, speed)
        if not outside.any():
            return
        index = tuple(int(i) for i in np.argwhere(outside)[0])
        at = f" (element {', '.join(map(str, index))})" if lift.size > 1 else ""
        u_l, d, s = float(lift[index]), float(duration[index]), float(speed[index])
        in_range(f"speed_rpm{at}", s, self.lowest_speed_rpm, self.highest_speed_rpm, "rpm")
        in_range(f"lift_mm{at}", u_l, self.lowest_lift_mm, self.highest_lift_mm, "mm")
        in_range(f"duration_deg{at}", d, 0.0, self.longest_deg, "deg", open_low=True)
        highest = highest_lift_mm(d / (6.0 * s), self.valvetrain)
        shortest = float(self.shortest_deg(u_l, s))
        what = f"duration {d:g} deg at {s:g} rpm{at}"
        if highest < self.lowest_lift_mm:
            least = float(self.shortest_deg(self.lowest_lift_mm, s))
            raise InfeasibleProfileError(
                f"{what} is too short for the lowest lift, {self.lowest_lift_mm:g} mm: lengthen "
                f"the duration to at least {_up(shortest):.1f} deg ({_up(least):.1f} deg for the "
                "lowest lift)",
                highest_lift_mm=max(highest, 0.0),
            )
        raise InfeasibleProfileError(
            f"{what} cannot reach {u_l:g} mm (at most {highest:.2f} mm): lower the lift or "
            f"lengthen the duration to at least {_up(shortest):.1f} deg",
            highest_lift_mm=highest,
        )

    def sample(self, count: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw random points, uniform in speed, lift and share.

        Returns
        -------
        lift_mm, duration_deg, speed_rpm : ndarray (count,)
        """
        whole("count", count, 1, 10_000_000)
        random = np.random.default_rng(seed)
        speed = random.uniform(self.lowest_speed_rpm, self.highest_speed_rpm, count)
        lift = random.uniform(self.lowest_lift_mm, self.highest_lift_mm, count)
        return lift, self.duration_deg(lift, random.uniform(0.0, 1.0, count), speed), speed


def shortest_deg(lift_mm: ArrayLike, speed_rpm: ArrayLike, valvetrain: Valvetrain) -> FloatArray:
    """Shortest duration in deg that reaches a lift at a speed (Eq. 20, dwell zero)."""
    rest, rate = _shortest_time(valvetrain)
    lift = np.asarray(lift_mm, dtype=float)
    return 6.0 * np.asarray(speed_rpm, dtype=float) * (rest + rate * lift) * (1.0 + _INSIDE)


def check_outside(outside: str) -> bool:
    """Return whether points outside a region are to give NaN, after checking the choice."""
    return one_of("outside", outside, ("raise", "nan")) == "nan"


def _shortest_time(valvetrain: Valvetrain) -> tuple[float, float]:
    """Shortest duration at zero lift, s, and its growth with lift, s/mm."""
    rest = shortest_duration(0.0, valvetrain)
    return rest, shortest_duration(1.0, valvetrain) - rest


def _up(value: float) -> float:
    """Round up to a tenth, so that following the advice suffices."""
    return math.ceil(10.0 * value) / 10.0
