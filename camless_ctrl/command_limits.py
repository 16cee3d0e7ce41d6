"""Limits of a valve command and of its change from one cycle to the next."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from plant import Valvetrain
from plant._checks import in_range, positive
from plant.errors import ParameterError
from plant.valve import shortest_duration


class LimitedCommand(NamedTuple):
    """A command within all limits."""

    lift_mm: float
    duration: float  # s
    share: float  # of the way from the command before to the one wanted that was gone, 1


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """Limits on lift and duration of one valve.

    Parameters
    ----------
    lift_mm : (float, float)
        Lowest and highest lift, mm.
    longest_duration_deg : float
        Longest duration, deg; a hard limit at every speed.
    lift_rate_mm : float
        Largest change of lift from one cycle to the next, mm.
    duration_rate : float
        Largest change of duration from one cycle to the next, s.
    valvetrain : Valvetrain
        Says which durations reach a lift.

    Notes
    -----
    Lifts and the durations (in time) that reach them form a convex set. So a command that is
    too far from the one before is replaced by one on the straight line between both: it can be
    driven, and keeps both rates. What the engine's speed changes about the longest duration
    comes before the rates.
    """

    lift_mm: tuple[float, float] = (0.5, 8.0)
    longest_duration_deg: float = 240.0
    lift_rate_mm: float = 6.0
    duration_rate: float = 20e-3
    valvetrain: Valvetrain = field(default_factory=Valvetrain)

    def __post_init__(self) -> None:
        low, high = self.lift_mm
        in_range("lift_mm[0]", low, 0.0, 100.0, "mm", open_low=True)
        in_range("lift_mm[1]", high, low, 100.0, "mm", open_low=True)
        in_range("longest_duration_deg", self.longest_duration_deg, 0.0, 360.0, "deg")
        positive("lift_rate_mm", self.lift_rate_mm, "mm per cycle")
        positive("duration_rate", self.duration_rate, "s per cycle")

    def shortest(self, lift_mm: float) -> float:
        """Shortest duration in s that reaches a lift."""
        return shortest_duration(lift_mm, self.valvetrain)

    def apply(
        self,
        lift_mm: float,
        duration_deg: float,
        speed_rpm: float,
        before: tuple[float, float] | None,
    ) -> LimitedCommand:
        """Return the command nearest to the one wanted, on the way from the one before.

        Parameters
        ----------
        lift_mm, duration_deg : float
            Command that is wanted.
        speed_rpm : float
            Engine speed, rpm.
        before : (float, float) or None
            Lift in mm and duration in s of the valve's command of the cycle before.

        Raises
        ------
        ParameterError
            If not even the lowest lift can be driven within the longest duration.
        """
        rate = 6.0 * speed_rpm
        low, high = self.lift_mm
        longest = self.longest_duration_deg / rate
        lift = min(max(lift_mm, low), high)
        duration = min(max(duration_deg / rate, self.shortest(lift)), longest)
        share = 1.0
        if before is not None:
            lift_change, change = lift - before[0], duration - before[1]
            if abs(lift_change) > self.lift_rate_mm:
                share = self.lift_rate_mm / abs(lift_change)
            if abs(change) * share > self.duration_rate:
                share = self.duration_rate / abs(change)
            if share < 1.0:
                lift, duration = before[0] + share * lift_change, before[1] + share * change
        if duration > longest:
            duration = longest
        if duration < self.shortest(lift):  # the longest duration does not reach this lift
            lift = self._highest(duration, speed_rpm)
        return LimitedCommand(lift, duration, share)

    def _highest(self, duration: float, speed_rpm: float) -> float:
        """Highest lift in mm within a duration in s."""
        base = self.shortest(0.0)
        lift = (duration - base) / (self.shortest(1.0) - base)
        if lift < self.lift_mm[0]:
            raise ParameterError(
                f"lift {self.lift_mm[0]:g} mm takes {1e3 * self.shortest(self.lift_mm[0]):.2f} ms, "
                f"but the longest duration of {self.longest_duration_deg:g} deg is "
                f"{1e3 * duration:.2f} ms at {speed_rpm:g} rpm: allow a longer duration or a "
                "lower lift"
            )
        return lift
