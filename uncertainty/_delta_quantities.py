"""Quantities that a delta changes, and the labelled data of their changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from plant.kinematics import FloatArray

if TYPE_CHECKING:
    import xarray as xr

Quantity = Literal[
    "charge",
    "charge_by_duration",
    "charge_by_lift",
    "loss",
    "loss_by_duration",
    "loss_by_lift",
]

QUANTITIES: dict[Quantity, str] = {
    "charge": "air charge",
    "charge_by_duration": "sensitivity of the charge to duration",
    "charge_by_lift": "sensitivity of the charge to lift",
    "loss": "pumping loss",
    "loss_by_duration": "sensitivity of the loss to duration",
    "loss_by_lift": "sensitivity of the loss to lift",
}
UNITS: dict[Quantity, str] = {
    "charge": "kg",
    "charge_by_duration": "kg/deg",
    "charge_by_lift": "kg/mm",
    "loss": "J",
    "loss_by_duration": "J/deg",
    "loss_by_lift": "J/mm",
}
# Relative changes are taken of the nominal value, or of these where it is smaller in magnitude.
# A sensitivity's floor is that of its quantity over 50 deg, or over 5 mm.
FLOORS: dict[Quantity, float] = {
    "charge": 50e-6,  # kg per event
    "charge_by_duration": 1e-6,  # kg per event and deg
    "charge_by_lift": 10e-6,  # kg per event and mm
    "loss": 0.5,  # J per event
    "loss_by_duration": 0.01,  # J per event and deg
    "loss_by_lift": 0.1,  # J per event and mm
}

# Steps of the central differences, to both sides. They balance curvature against the error of
# the integration: at 400 random points the slopes by duration are within 1.3 %, and those by
# lift within 2.4 %, of slopes over half the step of a plant of eightfold resolution (0.3 % rms;
# with oscillation 10 % and 1.1 % rms for the loss by lift), relative as above.
DURATION_STEP_DEG = 0.5
LIFT_STEP_MM = 0.05

AXES = ("speed", "lift", "duration")  # of the grid


def delta_dataset(
    cases: list[str],
    grid: tuple[FloatArray, ...],
    feasible: np.ndarray,
    nominal: FloatArray,
    changes: FloatArray,
    attrs: Mapping[str, Any],
) -> xr.Dataset:
    """Return the dataset of a result.

    Parameters
    ----------
    cases : list of str
        Names of the cases.
    grid : tuple of ndarray
        Speeds, lifts and durations.
    feasible : ndarray (speed, lift, duration)
        Mask of the nominal plant.
    nominal : ndarray (quantity, speed, lift, duration)
        Nominal values.
    changes : ndarray (quantity, case, speed, lift, duration)
        Relative changes.
    attrs : mapping
        Further attributes.
    """
    import xarray as xr

    variables: dict[str, Any] = {"feasible": (AXES, feasible)}
    for k, (quantity, name) in enumerate(QUANTITIES.items()):
        floor = f"{FLOORS[quantity]:g} {UNITS[quantity]}"
        variables[quantity] = (
            ("case", *AXES),
            changes[k],
            {
                "units": "1",
                "long_name": f"relative change of the {name}",
                "reference": f"nominal value, or {floor} where its magnitude is smaller",
            },
        )
        variables[f"nominal_{quantity}"] = (
            AXES,
            nominal[k],
            {"units": UNITS[quantity], "long_name": f"nominal {name}, mean over the cylinders"},
        )
    coordinates: dict[str, Any] = {
        dim: (dim, axis, {"units": unit})
        for dim, axis, unit in zip(AXES, grid, ("rpm", "mm", "deg"), strict=True)
    }
    return xr.Dataset(
        variables,
        coords={"case": np.array(cases), **coordinates},
        attrs={
            "infeasible": "NaN where the duration is too short for the lift at the speed",
            "duration_step_deg": DURATION_STEP_DEG,
            "lift_step_mm": LIFT_STEP_MM,
            **attrs,
        },
    )


def references(nominal: FloatArray) -> FloatArray:
    """What changes are relative to: nominal values (quantity, ...), or the floors."""
    floors = np.array(list(FLOORS.values())).reshape(-1, *(1,) * (nominal.ndim - 1))
    return np.maximum(np.abs(nominal), floors)
