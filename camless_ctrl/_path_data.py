"""The optimal path as labelled data, on disk and back."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from plant._files import replaced
from plant.errors import ParameterError

from ._path_certificates import CONSTRAINTS, UNITS, PathCertificates
from ._path_limits import ChargeLimits
from ._path_surface import DEGREE, LiftSurface
from .least_loss_motion import FeedforwardOptions

if TYPE_CHECKING:
    import xarray as xr

    from plant import MeanValuePlant

    from .optimal_path import OptimalPath

Path = TypeVar("Path", bound="OptimalPath")

FORMAT = "camless-ctrl optimal path 1"
_DIMS = ("speed", "position")


def to_dataset(path: OptimalPath) -> xr.Dataset:
    """See `OptimalPath.to_dataset`."""
    import xarray as xr

    c, surface = path.certificates, path.surface
    variables: dict[str, Any] = {
        "charge": (_DIMS, path.charge, _attrs("kg", "air charge per event")),
        "lift_mm": (_DIMS, path.lift_mm, _attrs("mm", "lift of the path")),
        "duration_deg": (_DIMS, path.duration_deg, _attrs("deg", "duration of the path")),
        "loss": (_DIMS, path.loss, _attrs("J", "pumping loss per event of the path")),
        "lowest_charge": ("speed", path.charge_limits.low, _attrs("kg", "charge at position 0")),
        "highest_charge": ("speed", path.charge_limits.high, _attrs("kg", "charge at position 1")),
        "lift_coefficient": (
            ("speed_coefficient", "position_coefficient"),
            surface.coefficients,
            _attrs("mm", "coefficients of the cubic B-splines of lift"),
        ),
        "speed_knot": (
            "speed_knots",
            surface.speed_knots,
            _attrs("1", "knots over the logarithm of speed in rpm"),
        ),
        "position_knot": (
            "position_knots",
            surface.position_knots,
            _attrs("1", "knots over position"),
        ),
    }
    for name, unit in UNITS.items():
        about = f"{name.removesuffix('_mm').removesuffix('_deg').replace('_', ' ')} of the node"
        variables[name] = (_DIMS, getattr(c, name), _attrs(unit, about))
    flags = c.active @ (1 << np.arange(len(CONSTRAINTS)))
    variables["active"] = (
        _DIMS,
        flags.astype(np.int32),
        {
            **_attrs("1", "inequalities that bind"),
            "flag_masks": (1 << np.arange(len(CONSTRAINTS))).astype(np.int32),
            "flag_meanings": " ".join(name.replace(" ", "_") for name in CONSTRAINTS),
        },
    )
    words, number = np.unique(c.status, return_inverse=True)
    variables["status"] = (
        _DIMS,
        number.reshape(c.status.shape).astype(np.int32),
        {
            **_attrs("1", "status that IPOPT returned"),
            "flag_values": np.arange(words.size, dtype=np.int32),
            "flag_meanings": " ".join(words.tolist()),
        },
    )
    data = xr.Dataset(
        variables,
        coords={
            "speed": ("speed", path.speeds_rpm, _attrs("rpm", "engine speed")),
            "position": ("position", path.positions, _attrs("1", "from lowest to highest charge")),
        },
        attrs={
            "format": FORMAT,
            "options": json.dumps(asdict(path.options), sort_keys=True),
            "maps": digest(path.maps),
            "plant_fingerprint": path.maps.provenance["plant_fingerprint"],
        },
    )
    return data.copy(deep=True)  # so that nobody changes the path through it


def save(path: OptimalPath, file: str | os.PathLike[str]) -> None:
    """See `OptimalPath.save`."""
    with replaced(file) as temporary:
        to_dataset(path).to_netcdf(temporary, engine="scipy")


def load(cls: type[Path], file: str | os.PathLike[str], maps: MeanValuePlant) -> Path:
    """See `OptimalPath.load`."""
    import xarray as xr

    with open(file, "rb"):
        pass  # a file that cannot be read is told as such, whatever it holds
    try:
        data = xr.load_dataset(file, engine="scipy")
        found = data.attrs["format"]
        if found != FORMAT:
            raise ParameterError(f"the format is {found!r}, not {FORMAT!r}")
        path = _path(cls, data, maps)
    except ParameterError as error:
        raise ParameterError(f"{file}: {error}") from error
    except (KeyError, TypeError, ValueError, OSError, IndexError) as error:
        raise ParameterError(
            f"{file} does not hold an optimal path ({type(error).__name__}): name a file that "
            "save(...) wrote"
        ) from error
    return path


def digest(maps: MeanValuePlant) -> str:
    """Fingerprint of maps: of their nodes and values."""
    total = hashlib.sha256()
    for values in (maps.speeds_rpm, maps.lifts_mm, maps.shares, maps.charge, maps.loss):
        total.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return total.hexdigest()[:16]


def _path(cls: type[Path], data: xr.Dataset, maps: MeanValuePlant) -> Path:
    theirs, ours = data.attrs["maps"], digest(maps)
    if theirs != ours:
        raise ParameterError(
            f"the path was fitted to the maps {theirs}, but the maps given are {ours}: load it "
            "with the maps that it belongs to, or fit it again"
        )

    def array(name: str, *shape: int) -> Any:
        values = data[name].values.astype(float)
        if values.shape != shape or not np.isfinite(values).all():
            raise ParameterError(
                f"{name} has shape {values.shape} and must have {shape}, all finite: the file is "
                "damaged, save the path again"
            )
        return values

    s, q = data.sizes["speed"], data.sizes["position"]
    speeds, positions = array("speed", s), array("position", q)
    flags = data["active"].values[..., None] & data["active"].attrs["flag_masks"]
    words = np.array(data["status"].attrs["flag_meanings"].split(" "))
    certificates = PathCertificates(
        **{name: array(name, s, q) for name in UNITS},
        active=flags.astype(bool),
        status=words[data["status"].values],
    )
    more = DEGREE + 1
    surface = LiftSurface(
        array("speed_knot", s + more),
        array("position_knot", q + more),
        array("lift_coefficient", s, q),
    )
    limits = ChargeLimits(speeds, array("lowest_charge", s), array("highest_charge", s))
    options = FeedforwardOptions(**json.loads(data.attrs["options"]))
    return cls(maps, options, surface, limits, speeds, positions, certificates)


def _attrs(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}
