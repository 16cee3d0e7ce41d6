"""The charge model as labelled data, on disk and back, and its picture.

Private to `charge_model`.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError, Valvetrain
from plant._files import replaced
from plant._plotting import axes, styled

from ._model_table import named_columns

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from .charge_model import ChargeModel

Model = TypeVar("Model", bound="ChargeModel")

FORMAT = "camless-ctrl charge model 2"
_QUANTITIES = {
    "charge": ("kg", "nominal air charge per event", None),
    "lift_mm": ("mm", "valve lift", None),
    "duration": ("s", "duration as delivered", None),
    "loss": ("J", "pumping loss per event", None),
    "flow_response": ("1", "response of ln charge to powers of ln flow gain", "flow_power"),
    "lift_response": ("mm-1, mm-2", "response of ln charge to lift taken off", "lift_power"),
    "throttle_response": (
        "1",
        "response of ln charge to powers of the ln of the throttle's gain",
        "throttle_power",
    ),
    "duration_slope": ("s-1", "slope of ln charge over duration at fixed lift", None),
    "shares": ("1", "shares of the inflow in parts of an event angle from IVO", "part"),
    "share_slopes": ("1", "slope of the shares over ln flow gain", "part"),
}
_NUMBERS = (
    "lowest_lift_mm",
    "longest_deg",
    "n_cylinders",
    "node_error",
    "flow_error",
    "wide_flow_error",
    "cycles",
)
_DAMAGED = "the file is damaged, save the model again"


def to_dataset(model: ChargeModel) -> xr.Dataset:
    """See `ChargeModel.to_dataset`."""
    import xarray as xr

    found = named_columns(model.table)
    variables: dict[str, Any] = {}
    for name, (units, long_name, third) in _QUANTITIES.items():
        dims = ("speed", "position") if third is None else ("speed", "position", third)
        variables[name] = (dims, found[name].copy(), {"units": units, "long_name": long_name})
    return xr.Dataset(
        variables,
        coords={
            "speed": (
                "speed",
                model.speeds_rpm.copy(),
                {"units": "rpm", "long_name": "engine speed"},
            ),
            "position": (
                "position",
                model.positions.copy(),
                {"units": "1", "long_name": "position on the path of optimal motions"},
            ),
        },
        attrs={
            "format": FORMAT,
            "plant_fingerprint": model.plant_fingerprint,
            "valvetrain": json.dumps(asdict(model.valvetrain), sort_keys=True),
            **{name: getattr(model, name) for name in _NUMBERS},
        },
    )


def save(model: ChargeModel, path: str | os.PathLike[str]) -> None:
    """See `ChargeModel.save`."""
    with replaced(path) as temporary:
        to_dataset(model).to_netcdf(temporary, engine="scipy")


def load(cls: type[Model], path: str | os.PathLike[str], plant: CrankAnglePlant | None) -> Model:
    """See `ChargeModel.load`."""
    import xarray as xr

    with open(path, "rb"):
        pass  # a file that cannot be read is told as such, whatever it holds
    try:
        data = xr.load_dataset(path, engine="scipy")
        if data.attrs["format"] != FORMAT:
            raise ParameterError(f"the format is {data.attrs['format']!r}, not {FORMAT!r}")
        model = _model(cls, data)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, OSError, IndexError) as error:
        raise ParameterError(
            f"{path} does not hold a charge model ({type(error).__name__}): name a file that "
            "save(...) wrote"
        ) from error
    if plant is not None and plant.fingerprint != model.plant_fingerprint:
        raise ParameterError(
            f"{path} holds the model of plant {model.plant_fingerprint}, but this plant is "
            f"{plant.fingerprint}: fit a model to this plant, or load it with the plant that it "
            "belongs to"
        )
    return model


def _model(cls: type[Model], data: xr.Dataset) -> Model:
    speeds, positions = (data[name].values.astype(float) for name in ("speed", "position"))
    parts = []
    for name, (_, _, third) in _QUANTITIES.items():
        values = data[name].values.astype(float)
        if values.ndim != (2 if third is None else 3):
            raise ParameterError(f"{name} has {values.ndim} dimensions: {_DAMAGED}")
        parts.append(values[..., None] if third is None else values)
    numbers: dict[str, Any] = {name: float(data.attrs[name]) for name in _NUMBERS}
    for name in ("n_cylinders", "cycles"):
        numbers[name] = int(numbers[name])
    return cls(
        speeds_rpm=speeds,
        positions=positions,
        table=np.concatenate(parts, axis=-1),
        valvetrain=Valvetrain(**json.loads(data.attrs["valvetrain"])),
        plant_fingerprint=str(data.attrs["plant_fingerprint"]),
        **numbers,
    )


def plot(model: ChargeModel, ax: Axes | None, speeds_rpm: ArrayLike | None) -> Axes:
    """See `ChargeModel.plot`."""
    low, high = float(model.speeds_rpm[0]), float(model.speeds_rpm[-1])
    speeds = np.geomspace(low, high, 4) if speeds_rpm is None else np.ravel(speeds_rpm)
    position = np.linspace(model.positions[0], model.positions[-1], 200)
    with styled():
        ax = axes(ax)
        second = ax.twinx()
        for k, speed in enumerate(speeds):
            found = model.at(position, np.clip(speed, low, high))
            charge = 1e6 * found["charge"]
            ax.plot(charge, found["flow_response"][:, 0], f"C{k}", label=f"{speed:.0f} rpm")
            per_ms = 0.1 * found["duration_slope"]  # % per ms
            second.plot(charge, per_ms, f"C{k}", linestyle="--")
        ax.set_xlabel("air charge (mg)")
        ax.set_ylabel("d ln charge / d ln flow gain (1), solid")
        second.set_ylabel("charge over duration (%/ms), dashed")
        second.grid(False)
        ax.legend()
    return ax
