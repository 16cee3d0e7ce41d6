"""Intake valve profiles: camless (Eq. 20, Appendix B) and conventional (section 4).

Lift is in mm, time in s since the intake valve opens (IVO). The printed exponents and
seating ramp of Eq. 20 are misprints; the form used here is continuous.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from ._checks import in_range, replace_fields
from .errors import InfeasibleProfileError, ParameterError
from .kinematics import FloatArray
from .parameters import Valvetrain

OnInfeasible = Literal["raise", "limit"]
EARLIEST_OPENING_DEG = -90.0  # deg ATDC
LATEST_OPENING_DEG = 180.0  # deg ATDC
LATEST_CLOSING_DEG = 360.0  # deg ATDC, the compression TDC


@dataclass(frozen=True, slots=True)
class ValveCommand:
    """Command of one intake event.

    Parameters
    ----------
    lift_mm : float
        Maximum lift ``u_l`` in mm, at least 0; 0 leaves the valve shut.
    duration_deg : float
        Duration ``u_d`` from IVO to IVC in crank degrees, seating included.
    opening_deg : float
        IVO ``u_t`` in degrees after intake TDC.

    Raises
    ------
    ParameterError
        If a value is not finite or out of range, or the valve would still be open at the
        compression TDC.
    """

    lift_mm: float
    duration_deg: float
    opening_deg: float = 0.0

    def __post_init__(self) -> None:
        in_range("lift_mm", self.lift_mm, 0.0, math.inf, "mm")
        in_range("duration_deg", self.duration_deg, 0.0, 360.0, "deg", open_low=True)
        in_range(
            "opening_deg",
            self.opening_deg,
            EARLIEST_OPENING_DEG,
            LATEST_OPENING_DEG,
            "deg after intake TDC",
            open_high=True,
        )
        if self.closing_deg > LATEST_CLOSING_DEG:
            raise ParameterError(
                f"the valve would close at {self.closing_deg:g} deg after intake TDC, but must be "
                f"shut by {LATEST_CLOSING_DEG:g} deg: shorten duration_deg ({self.duration_deg:g} "
                f"deg) or advance opening_deg ({self.opening_deg:g} deg)"
            )

    @classmethod
    def conventional(cls) -> Self:
        """Return the cam of section 4: 8.1 mm, from 8 deg BTDC to 46 deg ABDC."""
        return cls(lift_mm=8.1, duration_deg=234.0, opening_deg=-8.0)

    @property
    def closing_deg(self) -> float:
        """IVC in degrees after intake TDC."""
        return self.opening_deg + self.duration_deg

    def replace(self, **changes: float) -> Self:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)


class ProfileCorners(NamedTuple):
    """Times since IVO at which the camless profile changes form, s (Eq. 20)."""

    rise_end: float  # d_r
    turn: float  # where the approach to the maximum lift turns into its mirror image
    dwell_end: float  # d_r + s
    seating_start: float  # t_d - d_s
    closing: float  # t_d


def profile_corners(
    lift_mm: float,
    duration: float,
    opening_slope_mm_s: float,
    closing_slope_mm_s: float,
    seating_slope_mm_s: float,
    seating_duration: float,
    roundness: float,
) -> tuple[float, float, float, float, float]:
    """Corner times of Eq. 20 in s, in the order of `ProfileCorners`.

    The dwell ``s`` is divided in the ratio that makes both exponentials meet; for equal
    slopes that is the paper's ``s/2``. Where both have died out there, the mirror image
    starts later, at the last point where it is still zero to rounding: from a dwell of many
    time constants, its start would underflow.
    """
    ramp = (1.0 - roundness) * lift_mm
    rise = ramp / opening_slope_mm_s
    fall = (ramp - seating_slope_mm_s * seating_duration) / closing_slope_mm_s
    dwell = duration - rise - fall - seating_duration
    turn = rise + dwell * closing_slope_mm_s / (opening_slope_mm_s + closing_slope_mm_s)
    nothing = 36.0 * roundness * lift_mm / closing_slope_mm_s  # exp(-36) = 2e-16
    turn = max(turn, rise + dwell - nothing)
    return rise, turn, rise + dwell, duration - seating_duration, duration


def highest_lift_mm(duration: float, valvetrain: Valvetrain) -> float:
    """Highest lift in mm that a duration in s allows: the lift at which the dwell is zero.

    Below ``valvetrain.lowest_lift_mm`` no profile exists.
    """
    v = valvetrain
    seating = v.seating_duration * (1.0 - v.seating_slope_mm_s / v.closing_slope_mm_s)
    ramps = (1.0 - v.roundness) * (1.0 / v.opening_slope_mm_s + 1.0 / v.closing_slope_mm_s)
    return (duration - seating) / ramps


def shortest_duration(lift_mm: float, valvetrain: Valvetrain) -> float:
    """Shortest duration in s that reaches a lift in mm: the inverse of `highest_lift_mm`."""
    v = valvetrain
    seating = v.seating_duration * (1.0 - v.seating_slope_mm_s / v.closing_slope_mm_s)
    ramps = (1.0 - v.roundness) * (1.0 / v.opening_slope_mm_s + 1.0 / v.closing_slope_mm_s)
    return seating + ramps * lift_mm


def simplified_lift(
    time: ArrayLike, lift_mm: float, duration: float, valvetrain: Valvetrain
) -> FloatArray:
    """Simplified camless lift in mm at times since IVO in s (Eq. 20, continuous form)."""
    t = np.asarray(time, dtype=float)
    v = valvetrain
    corners = ProfileCorners(*profile_corners(lift_mm, duration, *corner_parameters(v)))
    ramp = (1.0 - v.roundness) * lift_mm
    soft = v.roundness * lift_mm  # L_s
    # The clamped arguments keep the branches that np.select does not use finite.
    since_rise = np.maximum(t - corners.rise_end, 0.0)
    to_dwell_end = np.maximum(corners.dwell_end - t, 0.0)
    return np.select(
        [
            (t < 0.0) | (t >= corners.closing),
            t < corners.rise_end,
            t < corners.turn,
            t < corners.dwell_end,
            t < corners.seating_start,
        ],
        [
            np.zeros_like(t),
            v.opening_slope_mm_s * t,
            lift_mm - soft * np.exp(-v.opening_slope_mm_s / soft * since_rise),
            lift_mm - soft * np.exp(-v.closing_slope_mm_s / soft * to_dwell_end),
            ramp - v.closing_slope_mm_s * (t - corners.dwell_end),
        ],
        default=v.seating_slope_mm_s * (corners.closing - t),
    )


def oscillation_lift(
    time: ArrayLike, lift_mm: float, rise_end: float, valvetrain: Valvetrain
) -> FloatArray:
    """Oscillation of the actuator in mm that adds to the simplified lift (Appendix B)."""
    since = np.maximum(np.asarray(time, dtype=float) - rise_end, 0.0)
    v = valvetrain
    return (
        v.oscillation_amplitude
        * lift_mm
        * np.exp(-v.oscillation_decay_rate * since)
        * np.sin(2.0 * np.pi / v.oscillation_period * since)
    )


def conventional_lift(since_opening_deg: ArrayLike, command: ValveCommand) -> FloatArray:
    """Lift of the cam of section 4 in mm at crank angles since IVO in deg."""
    angle = np.asarray(since_opening_deg, dtype=float)
    lift = command.lift_mm * np.sin(np.pi / command.duration_deg * angle) ** 2
    return np.where((angle >= 0.0) & (angle < command.duration_deg), lift, 0.0)


def corner_parameters(valvetrain: Valvetrain) -> tuple[float, float, float, float, float]:
    """Slopes, seating duration and roundness in the order that `profile_corners` takes."""
    v = valvetrain
    return (
        v.opening_slope_mm_s,
        v.closing_slope_mm_s,
        v.seating_slope_mm_s,
        v.seating_duration,
        v.roundness,
    )


def deliverable_lift_mm(
    command: ValveCommand,
    speed_rpm: float,
    valvetrain: Valvetrain,
    on_infeasible: OnInfeasible = "raise",
) -> float:
    """Lift in mm that the camless actuator delivers for a command at a speed.

    Raises
    ------
    ParameterError
        If the lift is outside the actuator's range.
    InfeasibleProfileError
        If the dwell of Eq. 20 would be below zero and `on_infeasible` is ``"raise"``, or if
        not even the lowest profile fits the duration.
    """
    lift, v = command.lift_mm, valvetrain
    if lift == 0.0:
        return 0.0
    in_range(
        "lift_mm",
        lift,
        v.lowest_lift_mm,
        v.maximum_lift_mm,
        "mm",
        remedy="0 keeps the valve shut, or change the Valvetrain's limits",
    )
    duration = command.duration_deg / (6.0 * speed_rpm)
    highest = highest_lift_mm(duration, v)
    if lift <= highest:
        return lift
    what = f"duration {command.duration_deg:g} deg at {speed_rpm:g} rpm"
    if highest < v.lowest_lift_mm:
        shortest = _rounded_up(6.0 * speed_rpm * shortest_duration(v.lowest_lift_mm, v))
        raise InfeasibleProfileError(
            f"{what} is too short for any valve motion: lengthen the duration to at least "
            f"{shortest:.1f} deg",
            highest_lift_mm=0.0,
        )
    if on_infeasible == "raise":
        needed = _rounded_up(6.0 * speed_rpm * shortest_duration(lift, v))
        raise InfeasibleProfileError(
            f"{what} cannot reach {lift:g} mm (at most {highest:.2f} mm): lower the lift, "
            f"lengthen the duration to at least {needed:.1f} deg, or pass on_infeasible='limit'",
            highest_lift_mm=highest,
        )
    return highest


def _rounded_up(duration_deg: float) -> float:
    """Round to a tenth of a degree upwards, so that the advice can be followed."""
    return math.ceil(10.0 * duration_deg) / 10.0
