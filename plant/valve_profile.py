"""Valve motion of one event as an object that plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from ._checks import one_of, positive
from .errors import ParameterError
from .kinematics import FloatArray
from .parameters import Valvetrain
from .valve import (
    OnInfeasible,
    ProfileCorners,
    ValveCommand,
    conventional_lift,
    corner_parameters,
    deliverable_lift_mm,
    oscillation_lift,
    profile_corners,
    simplified_lift,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class ValveProfile:
    """Valve motion of one event at one speed.

    Use `camless` or `conventional` to make one.

    Attributes
    ----------
    command : ValveCommand
        The command as given.
    speed_rpm : float
        Engine speed at IVO.
    delivered_lift_mm : float
        Maximum lift that the profile aims at; below the commanded lift if `limited`.
    oscillation : bool
        Whether the actuator oscillates (Appendix B).
    valvetrain : Valvetrain or None
        The camless actuator; None for a cam.
    """

    command: ValveCommand
    speed_rpm: float
    delivered_lift_mm: float
    oscillation: bool
    valvetrain: Valvetrain | None

    @classmethod
    def camless(
        cls,
        command: ValveCommand,
        speed_rpm: float,
        valvetrain: Valvetrain | None = None,
        *,
        oscillation: bool = False,
        on_infeasible: OnInfeasible = "raise",
    ) -> Self:
        """Return the camless profile of Eq. 20, with the oscillation of Appendix B on demand.

        Raises
        ------
        ParameterError, InfeasibleProfileError
            See `deliverable_lift_mm`.
        """
        positive("speed_rpm", speed_rpm, "rpm")
        one_of("on_infeasible", on_infeasible, ("raise", "limit"))
        valvetrain = valvetrain or Valvetrain()
        lift = deliverable_lift_mm(command, speed_rpm, valvetrain, on_infeasible)
        return cls(command, float(speed_rpm), lift, oscillation, valvetrain)

    @classmethod
    def conventional(cls, command: ValveCommand, speed_rpm: float) -> Self:
        """Return the cam-driven profile of section 4."""
        positive("speed_rpm", speed_rpm, "rpm")
        return cls(command, float(speed_rpm), command.lift_mm, False, None)

    @property
    def limited(self) -> bool:
        """Whether the duration does not allow the commanded lift."""
        return self.delivered_lift_mm < self.command.lift_mm

    @property
    def duration(self) -> float:
        """Time from IVO to IVC in s."""
        return self.command.duration_deg / (6.0 * self.speed_rpm)

    @property
    def corners(self) -> ProfileCorners:
        """Corner times of the camless profile in s since IVO.

        Raises
        ------
        ParameterError
            For a cam, which has no corners, and for a valve that stays shut.
        """
        if self.valvetrain is None or self.delivered_lift_mm == 0.0:
            raise ParameterError("a cam or a shut valve has no corners: use a camless profile")
        return ProfileCorners(
            *profile_corners(
                self.delivered_lift_mm, self.duration, *corner_parameters(self.valvetrain)
            )
        )

    def lift_mm(self, angle_deg: ArrayLike) -> FloatArray:
        """Lift in mm at crank angles in degrees after intake TDC."""
        since_deg = np.asarray(angle_deg, dtype=float) - self.command.opening_deg
        if self.valvetrain is None:
            return conventional_lift(since_deg, self.command)
        if self.delivered_lift_mm == 0.0:
            return np.zeros_like(since_deg)
        time = since_deg / (6.0 * self.speed_rpm)
        lift = simplified_lift(time, self.delivered_lift_mm, self.duration, self.valvetrain)
        if not self.oscillation:
            return lift
        swing = oscillation_lift(
            time, self.delivered_lift_mm, self.corners.rise_end, self.valvetrain
        )
        is_open = (time >= 0.0) & (time < self.duration)
        return np.where(is_open, np.maximum(lift + swing, 0.0), 0.0)

    def plot(self, ax: Axes | None = None, *, label: str | None = None) -> Axes:
        """Draw lift against crank angle and return the axes."""
        from ._plotting import axes, styled

        margin = 10.0
        angle = np.linspace(
            self.command.opening_deg - margin, self.command.closing_deg + margin, 1001
        )
        with styled():
            ax = axes(ax)
            ax.plot(angle, self.lift_mm(angle), label=label)
            ax.set_xlabel("crank angle after intake TDC (deg)")
            ax.set_ylabel("valve lift (mm)")
        return ax
