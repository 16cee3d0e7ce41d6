"""A controller's design in one file: maps, optimal motions and charge model as plain numbers.

The file is a netCDF file (classic format) with the variables of the three tables side by side,
their names preceded by that of the table, and a last line with the SHA-256 of all before it,
which readers of netCDF pass over. The line is checked before anything is read. Private to
`model_store`.
"""

from __future__ import annotations

import hashlib
import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from plant import MeanValuePlant, ParameterError
from plant._files import replaced
from plant._map_data import _maps

from ._model_data import _model
from ._path_data import _path
from .charge_model import ChargeModel
from .optimal_path import OptimalPath

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "camless-ctrl controller design 1"
_PARTS = ("maps", "path", "model")
_MARK = b"\nsha256 "


class Tables(NamedTuple):
    """All of a design that takes long to make."""

    maps: MeanValuePlant
    path: OptimalPath
    model: ChargeModel


def write(tables: Tables, path: str | os.PathLike[str], key: str) -> None:
    """Write tables to a file that appears whole or not at all.

    Parameters
    ----------
    tables : Tables
        What to write.
    path : path-like
        The file.
    key : str
        What the tables were made from; see `read`.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    import xarray as xr

    variables: dict[str, Any] = {}
    attributes: dict[str, Any] = {"format": FORMAT, "key": key}
    parts = (tables.maps.to_dataset(), tables.path.to_dataset(), tables.model.to_dataset())
    for part, data in zip(_PARTS, parts, strict=True):
        for name, variable in data.variables.items():
            dims = tuple(f"{part}_{dim}" for dim in variable.dims)
            variables[f"{part}_{name}"] = (dims, variable.values, variable.attrs)
        attributes |= {f"{part}_{name}": value for name, value in data.attrs.items()}
    with replaced(path) as temporary:
        xr.Dataset(variables, attrs=attributes).to_netcdf(temporary, engine="scipy")
        last = _last_line(temporary.read_bytes())
        with temporary.open("ab") as file:
            file.write(last)


def read(path: str | os.PathLike[str], key: str | None = None) -> Tables:
    """Read tables that `write` wrote.

    Parameters
    ----------
    path : path-like
        The file.
    key : str, optional
        What the tables must have been made from; anything by default.

    Raises
    ------
    ParameterError
        If the file holds no design, a damaged one, or one made from something else.
    OSError
        If it cannot be read.
    """
    import xarray as xr

    content = _checked(path)
    try:
        # The numbers as they are: no times, masks or scales are in them.
        data = xr.load_dataset(io.BytesIO(content), engine="scipy", decode_cf=False)
        if data.attrs["format"] != FORMAT:
            raise ParameterError(f"the format is {data.attrs['format']!r}, not {FORMAT!r}")
        if key is not None and data.attrs["key"] != key:
            raise ParameterError(f"the tables were made from {data.attrs['key']!r}, not {key!r}")
        parts = {part: _part(data, part) for part in _PARTS}
        maps = _maps(MeanValuePlant, parts["maps"])
        return Tables(
            maps,
            _path(OptimalPath, parts["path"], maps),
            _model(ChargeModel, parts["model"]),
        )
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, OSError, IndexError) as error:
        raise ParameterError(
            f"{path} does not hold a controller's design ({type(error).__name__}): name a file "
            "that save_design(...) wrote"
        ) from error


def _last_line(content: bytes) -> bytes:
    return _MARK + hashlib.sha256(content).hexdigest().encode() + b"\n"


def _checked(path: str | os.PathLike[str]) -> bytes:
    """Content of a file without its last line, which must agree with it."""
    whole = Path(path).read_bytes()
    size = len(_last_line(b""))
    content, last = whole[:-size], whole[-size:]
    if not last.startswith(_MARK):
        raise ParameterError(
            f"{path} does not end as a controller's design does: it was cut short or is another "
            "file; name a file that save_design(...) wrote"
        )
    if last != _last_line(content):
        raise ParameterError(
            f"{path} is damaged, its content does not agree with its checksum: save the design "
            "again"
        )
    return content


def _part(data: xr.Dataset, part: str) -> xr.Dataset:
    """One of the tables."""
    import xarray as xr

    def short(name: object) -> str:
        return str(name).removeprefix(f"{part}_")

    def own(name: object) -> bool:
        return str(name).startswith(f"{part}_")

    variables: dict[str, Any] = {}
    for name, variable in data.variables.items():
        if own(name):
            dims = tuple(short(dim) for dim in variable.dims)
            variables[short(name)] = (dims, variable.values, variable.attrs)
    attributes = {short(name): value for name, value in data.attrs.items() if own(name)}
    return xr.Dataset(variables, attrs=attributes)
