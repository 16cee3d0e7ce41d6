"""The mean-value maps as labelled data, on disk and back."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ._boundary_correction import BoundaryCorrection
from ._engine_fields import engine_fields, field_unit, get_field
from ._files import replaced
from ._surface import DEGREE
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .map_results import BoundaryError
from .parameters import Engine, HelmholtzRunner, Throttle, Valvetrain
from .region import OperatingRegion

if TYPE_CHECKING:
    import xarray as xr

    from .mean_value import MeanValuePlant

Maps = TypeVar("Maps", bound="MeanValuePlant")

FORMAT = "camless-ctrl mean-value maps 1"
_DIMS = ("speed", "lift", "share")
_COARSE = ("coarse_speed", "coarse_lift", "coarse_share")
_OPTIONS = ("runner", "oscillation", "orifice", "resolution")


def to_dataset(maps: MeanValuePlant) -> xr.Dataset:
    """See `MeanValuePlant.to_dataset`."""
    import xarray as xr

    duration = maps.region.duration_deg(
        maps.lifts_mm[None, :, None], maps.shares, maps.speeds_rpm[:, None, None]
    )
    variables: dict[str, Any] = {
        "air_charge": (_DIMS, maps.charge, _attrs("kg", "air charge per event")),
        "pumping_loss": (_DIMS, maps.loss, _attrs("J", "pumping loss per event")),
    }
    attrs: dict[str, Any] = {
        "format": FORMAT,
        **maps.provenance,
        "longest_duration_deg": maps.region.longest_deg,
        "engine": json.dumps(asdict(maps.engine), sort_keys=True),
    }
    b = maps.boundary
    if b is not None:
        power = (*_COARSE, "power")
        variables["charge_change"] = (power, b.charge, _attrs("1", "change of charge"))
        variables["loss_change"] = (power, b.loss, _attrs("1", "change of pumping loss"))
        for name, nodes in zip(_COARSE, b.nodes, strict=True):
            variables[f"{name}_node"] = (name, nodes, _attrs("1", "node of the changes"))
        attrs["boundary_ranges"] = json.dumps(b.ranges)
        attrs["boundary_error"] = json.dumps(asdict(b.error))
    return xr.Dataset(
        variables,
        coords={
            "speed": ("speed", maps.speeds_rpm, _attrs("rpm", "engine speed")),
            "lift": ("lift", maps.lifts_mm, _attrs("mm", "maximum valve lift")),
            "share": (
                "share",
                maps.shares,
                _attrs("1", "share from the shortest to the longest duration"),
            ),
            "duration": (_DIMS, duration, _attrs("deg", "duration")),
        },
        attrs=attrs,
    )


def save(maps: MeanValuePlant, path: str | os.PathLike[str]) -> None:
    """See `MeanValuePlant.save`."""
    with replaced(path) as temporary:
        to_dataset(maps).to_netcdf(temporary, engine="scipy")


def load(
    cls: type[Maps], path: str | os.PathLike[str], plant: CrankAnglePlant | Engine | None
) -> Maps:
    """See `MeanValuePlant.load`."""
    import xarray as xr

    with open(path, "rb"):
        pass  # a file that cannot be read is told as such, whatever it holds
    try:
        data = xr.load_dataset(path, engine="scipy")
        found = data.attrs["format"]
        if found != FORMAT:
            raise ParameterError(f"{path} has format {found!r}, not {FORMAT!r}")
        maps = _maps(cls, data)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, OSError, IndexError) as error:
        raise ParameterError(
            f"{path} does not hold mean-value maps ({type(error).__name__}): name a file that "
            "save(...) wrote"
        ) from error
    if plant is not None:
        differences = _differences(maps, plant)
        if differences:
            raise ParameterError(
                f"{path} holds maps of another plant: {'; '.join(differences)}. Fit maps to "
                "this plant, or load them with the plant that they belong to"
            )
    return maps


def _maps(cls: type[Maps], data: xr.Dataset) -> Maps:
    attrs = dict(data.attrs)
    engine = _engine(json.loads(attrs.pop("engine")))
    speeds, lifts, shares = (data[name].values.astype(float) for name in _DIMS)
    charge, loss = (data[name].values.astype(float) for name in ("air_charge", "pumping_loss"))
    shape = (len(speeds), len(lifts), len(shares))
    for name, values in (("air_charge", charge), ("pumping_loss", loss)):
        if values.shape != shape or not np.isfinite(values).all():
            raise ParameterError(
                f"{name} has shape {values.shape} and must have {shape}, all finite: the file is "
                "damaged, save the maps again"
            )
    for name, nodes in (("speed", speeds), ("lift", lifts), ("share", shares)):
        if len(nodes) <= DEGREE or not np.all(np.diff(nodes) > 0.0):
            raise ParameterError(
                f"{name} holds {nodes.tolist()}, but must be at least {DEGREE + 1} rising values: "
                "the file is damaged, save the maps again"
            )
    if (shares[0], shares[-1]) != (0.0, 1.0):
        raise ParameterError(
            f"share goes from {shares[0]:g} to {shares[-1]:g}, but must go from 0 to 1: the file "
            "is damaged, save the maps again"
        )
    missing = [name for name in ("plant_fingerprint", *_OPTIONS) if name not in attrs]
    if missing:
        raise ParameterError(
            f"the attributes {', '.join(missing)} are missing: the file is damaged, save the maps "
            "again"
        )
    region = OperatingRegion(
        lowest_speed_rpm=float(speeds[0]),
        highest_speed_rpm=float(speeds[-1]),
        lowest_lift_mm=float(lifts[0]),
        highest_lift_mm=float(lifts[-1]),
        longest_deg=float(attrs.pop("longest_duration_deg")),
        valvetrain=engine.valvetrain,
    )
    boundary = None
    if "boundary_ranges" in attrs:
        first, second, third = (data[f"{name}_node"].values.astype(float) for name in _COARSE)
        changes = [data[f"{name}_change"].values.astype(float) for name in ("charge", "loss")]
        if not all(np.isfinite(x).all() for x in (first, second, third, *changes)):
            raise ParameterError(
                "the changes with the boundary conditions are not all finite: the file is damaged, "
                "save the maps again"
            )
        boundary = BoundaryCorrection(
            engine,
            (first, second, third),
            changes[0],
            changes[1],
            tuple((low, high) for low, high in json.loads(attrs.pop("boundary_ranges"))),
            BoundaryError(**json.loads(attrs.pop("boundary_error"))),
        )
    attrs.pop("format")
    provenance = {k: v.item() if isinstance(v, np.generic) else v for k, v in attrs.items()}
    return cls(engine, region, speeds, lifts, shares, charge, loss, provenance, boundary)


def _engine(content: dict[str, Any]) -> Engine:
    parts = {"valvetrain": Valvetrain, "helmholtz": HelmholtzRunner, "throttle": Throttle}
    made = {name: part(**content.pop(name)) for name, part in parts.items()}
    factors = tuple(content.pop("cylinder_flow_factors"))
    return Engine(**content, **made, cylinder_flow_factors=factors)


def _differences(maps: MeanValuePlant, plant: CrankAnglePlant | Engine) -> list[str]:
    """What of a plant or engine differs from that of the maps."""
    engine = plant if isinstance(plant, Engine) else plant.engine
    if maps.engine.n_cylinders != engine.n_cylinders:
        return [f"n_cylinders is {maps.engine.n_cylinders} in the file, {engine.n_cylinders} here"]
    found = []
    for name in engine_fields(engine):
        theirs, ours = get_field(maps.engine, name), get_field(engine, name)
        if theirs != ours:
            unit = field_unit(name)
            unit = "" if unit == "1" else f" {unit}"
            form = "g" if f"{theirs:g}" != f"{ours:g}" else ".17g"
            found.append(f"{name} is {theirs:{form}}{unit} in the file, {ours:{form}}{unit} here")
    if isinstance(plant, CrankAnglePlant):
        for name in _OPTIONS:
            given = getattr(plant, name)
            stored = maps.provenance[name]
            if str(stored) != str(given):
                found.append(f"{name} is {stored} in the file, {given} here")
        if plant.profile != "camless":
            found.append(f"profile is camless in the file, {plant.profile} here")
    return found


def _attrs(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}
