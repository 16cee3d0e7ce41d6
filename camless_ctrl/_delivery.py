"""What a valve delivers of a command: errors of the actuator, faults, the least motion."""

from __future__ import annotations

from typing import NamedTuple

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant.valve import LATEST_CLOSING_DEG, highest_lift_mm

from ._fault_effects import ValveFault

LEAST_DURATION_DEG = 0.1  # deg, of what is delivered
SHUT = 0.0  # mm, lift of a valve that stays shut


class Delivery(NamedTuple):
    """Motion of a valve, as the plant is to drive it."""

    command: ValveCommand
    duration_deg: float  # that is measured; it may be below what a motion can have
    opens: bool


def delivered(
    plant: CrankAnglePlant,
    command: ValveCommand,
    speed_rpm: float,
    late: float,
    fault: ValveFault,
    *,
    known_speed: bool = True,
) -> Delivery:
    """Return what is delivered of a command.

    Parameters
    ----------
    plant : CrankAnglePlant
        The true engine.
    command : ValveCommand
        What is commanded.
    speed_rpm : float
        True speed.
    late : float
        Error of the delivered duration without faults, s.
    fault : ValveFault
        What faults add.
    known_speed : bool
        Whether the command was made for this speed. If so, and nothing is added, a command that
        allows no motion is the plant's to refuse: the controller is wrong.

    Raises
    ------
    ParameterError
        If the valve would still be open at the compression TDC.
    """
    lift = command.lift_mm
    if lift == SHUT or fault.lift_factor == 0.0:
        return Delivery(command.replace(lift_mm=SHUT), 0.0, opens=False)
    late += fault.late
    duration_deg = command.duration_deg + 6.0 * speed_rpm * late
    if command.opening_deg + duration_deg > LATEST_CLOSING_DEG:
        raise ParameterError(
            f"the valve shuts {1e3 * late:.3g} ms late, {command.opening_deg + duration_deg:.4g} "
            f"deg after intake TDC at {speed_rpm:g} rpm, but must be shut by "
            f"{LATEST_CLOSING_DEG:g} deg: lower the size of the fault, or the valves' errors"
        )
    if fault.lift_factor != 1.0:
        lift *= fault.lift_factor
    as_meant = known_speed and late == 0.0 and lift == command.lift_mm
    if not as_meant and not _moves(plant, lift, duration_deg, speed_rpm):
        return Delivery(command.replace(lift_mm=SHUT), 0.0, opens=False)
    motion = ValveCommand(lift, max(duration_deg, LEAST_DURATION_DEG), command.opening_deg)
    return Delivery(motion, duration_deg, opens=True)


def _moves(plant: CrankAnglePlant, lift_mm: float, duration_deg: float, speed_rpm: float) -> bool:
    """Whether there is a valve motion of a lift and duration, the lift perhaps limited."""
    if plant.profile == "conventional":
        return duration_deg > 0.0
    valvetrain = plant.engine.valvetrain
    highest = highest_lift_mm(duration_deg / (6.0 * speed_rpm), valvetrain)
    return min(lift_mm, highest) >= valvetrain.lowest_lift_mm
