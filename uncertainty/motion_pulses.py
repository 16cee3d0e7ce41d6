"""What one changed valve motion does to each plant of a sample, each around a motion of its own.

The command of a controller changes along a path on which lift and duration both move, and each
plant is driven where its own controller has settled. So motion and change are given for each
plant; as in `pulse_sampling`, equal cylinders do the same one event apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from plant import ConvergenceError, CrankAnglePlant, ParameterError, ValveCommand
from plant._checks import in_range, whole
from plant.kinematics import FloatArray

from ._event_pulse import PeriodicOperation, Pulse
from .pulse_sampling import FINER, SAMPLES


@dataclass(frozen=True)
class ChangedMotion:
    """A valve motion, and the two that it is changed to, all as delivered."""

    rest: ValveCommand
    raised: ValveCommand
    lowered: ValveCommand


@dataclass(frozen=True)
class FollowedPlant:
    """A plant in periodic operation, and what one changed motion does to it.

    Attributes
    ----------
    charge : float
        Charge of each event in periodic operation, kg.
    flow, pressure : ndarray (samples,)
        Throttle flow (kg/s) and manifold pressure (Pa) over an event, from IVO on.
    pulse : Pulse
        Half the difference that a raised and a lowered motion of one event make.
    """

    charge: float
    flow: FloatArray = field(repr=False)
    pressure: FloatArray = field(repr=False)
    pulse: Pulse = field(repr=False)


def follow_motion(
    plant: CrankAnglePlant,
    motion: ChangedMotion,
    speed_rpm: float,
    *,
    throttle_deg: float = 90.0,
    most_cycles: int = 100,
    tolerance: float = 1e-5,
) -> FollowedPlant:
    """Change one motion of a plant, and follow what comes of it.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant; its cylinders are equal. A lift that the duration does not allow is limited.
    motion : ChangedMotion
        Motion of all cylinders, and its change in one event.
    speed_rpm, throttle_deg : float
        Operating point.
    most_cycles, tolerance
        As for `full_plant_response`.

    Raises
    ------
    ParameterError
        If the cylinders differ.
    ConvergenceError
        If the plant does not come to rest again.
    """
    whole("most_cycles", most_cycles, 1, 10_000)
    in_range("tolerance", tolerance, 1e-10, 0.1, "1")
    if len(set(plant.engine.flow_coefficients)) > 1:
        raise ParameterError(
            "the cylinders differ in flow coefficient, but must be equal: use "
            "full_plant_response(...) for each plant"
        )

    def followed(of: CrankAnglePlant) -> FollowedPlant:
        operation = PeriodicOperation(
            of, motion.rest, speed_rpm, throttle_deg, samples=SAMPLES, on_infeasible="limit"
        )
        flow, pressure = operation.steady_signals(1)
        pulse = operation.pulse(
            0,
            motion.raised,
            motion.lowered,
            most_events=most_cycles * operation.n,
            tolerance=tolerance,
        )
        return FollowedPlant(float(operation.cycle.air_charge[0]), flow[0], pressure[0], pulse)

    try:
        return followed(plant)
    except ConvergenceError:  # the choice of steps holds the two runs apart
        return followed(plant.with_resolution(FINER * plant.resolution))
