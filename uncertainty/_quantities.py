"""What is asked of perturbed plants: charge, pumping loss, loop gain and imbalance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant._checks import positive
from plant.kinematics import FloatArray
from plant.region import OperatingPoint

from ._delta_quantities import DURATION_STEP_DEG
from ._delta_quantities import FLOORS as DELTA_FLOORS
from .perturbed import PerturbedPlants

DEFAULT_POINTS = (
    OperatingPoint(750.0, 2.0, 100.0),
    OperatingPoint(1500.0, 3.0, 120.0),
    OperatingPoint(3000.0, 4.0, 150.0),
    OperatingPoint(6000.0, 5.0, 220.0),
)
WORDS = {
    "charge": "air charge",
    "loss": "pumping loss",
    "loop_gain": "loop gain",
    "imbalance": "imbalance",
}
# Relative changes are taken of the nominal value, or of these where it is smaller.
FLOORS = {
    "charge": DELTA_FLOORS["charge"],
    "loss": DELTA_FLOORS["loss"],
    "loop_gain": DELTA_FLOORS["charge_by_duration"],
}
UNITS = {"charge": "kg", "loss": "J", "loop_gain": "kg/deg", "imbalance": "1"}
DEFINITIONS = {
    "charge": "mean over the cylinders, kg per event",
    "loss": "mean over the cylinders, J per event",
    "loop_gain": "change of the charge by the commanded duration, central difference over half a "
    "degree to both sides: what the gain of the charge loop is proportional to",
    "imbalance": "(highest - lowest)/mean of the cylinders' charges",
}
SHARED = ("charge", "loss", "loop_gain")  # quantities that equal cylinders have
CYCLES_PER_POINT = 3  # steady cycles that `shared_quantities` takes for each point and plant


def full_plant(plant: CrankAnglePlant | None) -> CrankAnglePlant:
    """Return `plant`; by default the paper's with its runner and its actuator's oscillation."""
    return CrankAnglePlant(runner=True, oscillation=True) if plant is None else plant


def checked_points(points: Sequence[OperatingPoint]) -> tuple[OperatingPoint, ...]:
    """Return operating points after checking them.

    Raises
    ------
    ParameterError
        If there is none, one is no operating point, or one stands twice.
    """
    checked: list[OperatingPoint] = []
    for i, point in enumerate(points):
        if np.shape(point) != (3,):
            raise ParameterError(
                f"point {i} is {point!r}, but must be speed_rpm, lift_mm and duration_deg"
            )
        at = OperatingPoint(*(float(x) for x in point))
        positive(f"speed_rpm of point {i}", at.speed_rpm, "rpm")
        positive(f"lift_mm of point {i}", at.lift_mm, "mm")
        positive(f"duration_deg of point {i}", at.duration_deg, "deg")
        if at in checked:
            raise ParameterError(f"point {i} is {at}, as point {checked.index(at)}: give it once")
        checked.append(at)
    if not checked:
        raise ParameterError("there is no operating point: give one or more")
    return tuple(checked)


def check_drivable(plant: CrankAnglePlant, points: Sequence[OperatingPoint]) -> None:
    """Check that the nominal valve can be driven at points, and half a degree shorter.

    Raises
    ------
    InfeasibleProfileError
        If it cannot; else results would be those of a lift that nobody asked for.
    """
    for speed, lift, duration in points:
        plant.valve_profile(ValveCommand(lift, duration - DURATION_STEP_DEG), speed)


def shared_quantities(
    plants: PerturbedPlants,
    points: Sequence[OperatingPoint],
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, FloatArray]:
    """Charge, loss and loop gain of plants, means over the cylinders, each (samples, points)."""
    speed, lift, duration = np.array(points, dtype=float).T
    steps = DURATION_STEP_DEG * np.array([-1.0, 0.0, 1.0])
    result = plants.steady_cycles(
        np.repeat(speed, 3),
        np.repeat(lift, 3),
        (duration[:, None] + steps).ravel(),
        per_cylinder=False,
        progress=progress,
    )
    shape = (len(plants), len(points), 3)
    charge, loss = (
        result[name].to_numpy().reshape(shape) for name in ("air_charge", "pumping_loss")
    )
    return {
        "charge": charge[..., 1],
        "loss": loss[..., 1],
        "loop_gain": (charge[..., 2] - charge[..., 0]) / (2.0 * DURATION_STEP_DEG),
    }


def imbalance(
    plants: PerturbedPlants,
    points: Sequence[OperatingPoint],
    progress: Callable[[int, int], None] | None = None,
) -> FloatArray:
    """``(highest - lowest)/mean`` of the cylinders' charges (samples, points)."""
    result = plants.steady_cycles(*np.array(points, dtype=float).T, progress=progress)
    charge = result["air_charge"].transpose("sample", "point", "cylinder").to_numpy()
    return np.asarray(np.ptp(charge, axis=-1) / charge.mean(axis=-1), dtype=float)
