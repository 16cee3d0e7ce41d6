"""Plot of valve profiles at several speeds: Figures 2 and 3 of Part I."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ._checks import truth
from .errors import InfeasibleProfileError, ParameterError
from .kinematics import FloatArray
from .parameters import Valvetrain
from .valve import ValveCommand
from .valve_profile import ValveProfile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPEEDS_RPM = (750.0, 1500.0, 3000.0, 6000.0)
_MARGIN_DEG = 10.0
_REACHED = 0.995  # share of the commanded lift that counts as reached


def plot_valve_profiles(
    command: ValveCommand,
    speeds_rpm: Sequence[float] | FloatArray = SPEEDS_RPM,
    *,
    valvetrain: Valvetrain | None = None,
    conventional: bool = True,
    oscillation: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw valve lift against crank angle at several speeds (Figure 3); return the axes.

    The slopes of the actuator are fixed in time, so the profile is the flatter over crank angle
    the higher the speed. Where a duration leaves no time for the commanded lift, the lift is
    limited to the highest that it allows, and the legend says so; it also names the peak where
    the dwell is too short to approach the lift. A speed at which the valve cannot open at all
    has an entry in the legend, and no line.

    Parameters
    ----------
    command : ValveCommand
        Command of the camless valve.
    speeds_rpm : sequence of float
        Speeds; at least one.
    valvetrain : Valvetrain, optional
        The actuator; the paper's by default.
    conventional : bool
        Whether to add the cam of section 4, dotted.
    oscillation : bool
        Whether to add the profile of the oscillating actuator (Appendix B), dashed (Figure 2).
    ax : Axes, optional
        Where to draw; a new figure by default.

    Raises
    ------
    ParameterError
        If there is no speed or one is not positive, or the lift is out of the actuator's range.
    """
    from ._plotting import COLOURS, axes, styled

    truth("conventional", conventional)
    truth("oscillation", oscillation)
    speeds = np.atleast_1d(np.asarray(speeds_rpm, dtype=float))
    if speeds.ndim != 1 or not speeds.size:
        raise ParameterError(
            f"speeds_rpm has the shape {speeds.shape}, but must be a list of at least one speed "
            "in rpm"
        )
    cam = ValveCommand.conventional()
    shown = [command, cam] if conventional else [command]
    first = min(c.opening_deg for c in shown) - _MARGIN_DEG
    last = max(c.closing_deg for c in shown) + _MARGIN_DEG
    with styled():
        ax = axes(ax, (7.6, 3.8))
        for k, speed in enumerate(speeds):
            colour = COLOURS[k % len(COLOURS)]
            profile = _profile(command, float(speed), valvetrain)
            if profile is None:
                label = f"{speed:g} rpm: too fast to open in {command.duration_deg:g} deg"
                ax.plot([], [], color=colour, label=label)
                continue
            angle = _angles(profile, first, last)
            lift = profile.lift_mm(angle)
            ax.plot(angle, lift, color=colour, label=_label(profile, float(lift.max())))
            if oscillation:
                swing = ValveProfile.camless(
                    command,
                    float(speed),
                    valvetrain,
                    oscillation=True,
                    on_infeasible="limit",
                )
                ax.plot(angle, swing.lift_mm(angle), "--", color=colour, lw=1.2)
        if oscillation:
            ax.plot([], [], "--", color="0.35", lw=1.2, label="with the actuator's oscillation")
        if conventional:
            angle = np.linspace(first, last, 1001)
            lift = ValveProfile.conventional(cam, float(speeds[0])).lift_mm(angle)
            ax.plot(angle, lift, ":", color="black", label=f"cam, {cam.lift_mm:g} mm, any speed")
        ax.set_xlim(first, last)
        ax.set_ylim(bottom=0.0)
        ax.set_xlabel("crank angle after intake TDC (deg)")
        ax.set_ylabel("valve lift (mm)")
        ax.set_title(
            f"Intake valve: {command.lift_mm:g} mm for {command.duration_deg:g} deg from "
            f"{command.opening_deg:g} deg ATDC"
        )
        ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return ax


def _profile(
    command: ValveCommand, speed_rpm: float, valvetrain: Valvetrain | None
) -> ValveProfile | None:
    """Profile at a speed, limited if need be; None if the valve cannot open."""
    try:
        return ValveProfile.camless(command, speed_rpm, valvetrain, on_infeasible="limit")
    except InfeasibleProfileError:
        return None


def _angles(profile: ValveProfile, first: float, last: float) -> FloatArray:
    """Crank angles in deg that hold the profile's corners, so that these are drawn sharp."""
    angle = np.linspace(first, last, 1001)
    if profile.delivered_lift_mm == 0.0:
        return angle
    corners = np.array([0.0, *profile.corners])
    return np.union1d(angle, profile.command.opening_deg + 6.0 * profile.speed_rpm * corners)


def _label(profile: ValveProfile, peak_mm: float) -> str:
    """Speed, and what of the commanded lift is not delivered or not reached."""
    label, wanted = f"{profile.speed_rpm:g} rpm", profile.command.lift_mm
    if profile.limited:
        label += f": limited to {profile.delivered_lift_mm:.2f} of {wanted:g} mm"
    if peak_mm < _REACHED * wanted:
        label += f"{',' if profile.limited else ':'} peak {peak_mm:.2f} mm"
    return label
