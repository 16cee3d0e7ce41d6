"""Sweeps of steady cycles for Figures 11 to 14: charge and loss of two plants, with units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from plant import CrankAnglePlant, Engine, ParameterError
from plant._checks import in_range
from plant.kinematics import FloatArray
from plant.region import shortest_deg

if TYPE_CHECKING:
    import xarray as xr

_QUANTITIES = (
    ("charge", "air charge per event", "kg"),
    ("loss", "pumping loss per event", "J"),
    ("specific_loss", "specific pumping loss", "J/kg"),
)


def sweep(
    plants: Sequence[CrankAnglePlant], speed: FloatArray, lift: FloatArray, duration: FloatArray
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Charge and loss (plants, points), NaN where `reached`, the third, is False."""
    reached = duration >= shortest_deg(lift, speed, plants[0].engine.valvetrain)
    if not reached.any():
        raise ParameterError(
            f"no point can be driven: the longest duration is {duration.max():g} deg, but "
            f"{lift.min():g} mm at {speed.min():g} rpm needs more: close later, or lower the lift"
        )
    values = np.full((2, len(plants), speed.size), np.nan)
    for k, plant in enumerate(plants):
        values[:, k, reached] = values_of(
            plant.steady_cycles(speed[reached], lift[reached], duration[reached])
        )
    return values[0], values[1], reached


def values_of(cycles: xr.Dataset) -> FloatArray:
    """Charge and loss, means over the cylinders, (2, points)."""
    return np.stack(
        [cycles[name].mean("cylinder").to_numpy() for name in ("air_charge", "pumping_loss")]
    )


def variables(
    dims: tuple[str, ...], charge: FloatArray, loss: FloatArray, suffix: str = ""
) -> dict[str, Any]:
    """Variables of a dataset for charge, loss and loss over charge (NaN without charge)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        specific = np.where(charge > 0.0, loss / charge, np.nan)
    return {
        name + suffix: (dims, values, {"units": unit, "long_name": long_name})
        for (name, long_name, unit), values in zip(
            _QUANTITIES, (charge, loss, specific), strict=True
        )
    }


def seating_deg(engine: Engine, speed_rpm: float | FloatArray) -> Any:
    """Crank angle that the seating takes."""
    return 6.0 * speed_rpm * engine.valvetrain.seating_duration


def checked_lift(engine: Engine, name: str, lift_mm: float) -> float:
    """Return a lift after checking that the actuator can drive it."""
    v = engine.valvetrain
    return in_range(name, lift_mm, v.lowest_lift_mm, v.maximum_lift_mm, "mm")


def grid(name: str, values: Sequence[float]) -> FloatArray:
    """Return a sequence as an array after checking that it rises and is finite."""
    found = np.array(values, dtype=float)
    rising = found.ndim == 1 and found.size > 0 and bool(np.all(np.diff(found) > 0.0))
    if not rising or not np.isfinite(found).all():
        raise ParameterError(f"{name} is {found.tolist()}, but must be rising finite values")
    return found
