"""Inputs of a batch of steady cycles: named dimensions, broadcast without being copied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from ._checks import one_of
from ._engine_fields import engine_fields, field_unit, replace_engine_fields
from .errors import ParameterError
from .kinematics import FloatArray
from .parameters import Engine

CYLINDER = "cylinder"  # dimension of commands that differ from cylinder to cylinder
_COMMAND = ("lift_mm", "duration_deg", "opening_deg")
_NAMES = {
    "speed_rpm": ("engine speed", "rpm"),
    "lift_mm": ("commanded valve lift", "mm"),
    "duration_deg": ("commanded duration", "deg"),
    "opening_deg": ("opening after intake TDC", "deg"),
    "throttle_deg": ("throttle angle", "deg"),
}


@dataclass(frozen=True)
class BatchInputs:
    """Operating points and engine parameters of a batch.

    Attributes
    ----------
    engine : Engine
        Engine whose parameters hold where none is given.
    variables : dict of str to xarray.Variable
        Operating points, by name.
    parameters : dict of str to xarray.Variable
        Engine parameters, by their names in `engine_fields`.
    sizes : dict of str to int
        Dimensions of the result, in their order.
    labels : dict of str to xarray.Variable
        Coordinates that the inputs brought.
    """

    engine: Engine
    variables: dict[str, xr.Variable]
    parameters: dict[str, xr.Variable]
    sizes: dict[str, int]
    labels: dict[str, xr.Variable]

    @classmethod
    def gather(
        cls,
        engine: Engine,
        points: Mapping[str, Any],
        parameters: Mapping[str, Any],
        dims: Sequence[str] | None,
    ) -> BatchInputs:
        """Check the inputs and find the dimensions that they span together.

        Raises
        ------
        ParameterError
            For inputs that are not numbers or do not fit together, an unknown engine parameter,
            and a parameter out of its bounds.
        """
        known = engine_fields(engine)
        for name in parameters:
            one_of("engine parameter", name, known)
        given = {**points, **parameters}
        plain = {k: _numbers(k, v) for k, v in given.items() if not isinstance(v, xr.DataArray)}
        names = _plain_dims(max((v.ndim for v in plain.values()), default=0), dims)
        labelled = {k: v for k, v in given.items() if isinstance(v, xr.DataArray)}
        labels = _labels(labelled)
        variables: dict[str, xr.Variable] = {}
        for name, value in given.items():
            if name in plain:
                array = plain[name]
                own = names[len(names) - array.ndim :]
                keep = [i for i, size in enumerate(array.shape) if size != 1]
                one = array.reshape([array.shape[i] for i in keep])
                variables[name] = xr.Variable([own[i] for i in keep], one)
            else:
                variables[name] = xr.Variable(value.dims, _numbers(name, value.values))
        sizes = dict.fromkeys(names, 1)
        for name, variable in variables.items():
            for dim, size in zip(variable.dims, variable.shape, strict=True):
                if sizes.setdefault(str(dim), size) == 1:
                    sizes[str(dim)] = size
                if size != sizes[str(dim)]:
                    raise ParameterError(
                        f"{name} has {size} values along {dim}, but another input has "
                        f"{sizes[str(dim)]}: give inputs that broadcast against each other"
                    )
        labelled_cylinders = labels.pop(CYLINDER, None)
        if labelled_cylinders is not None and not np.array_equal(
            labelled_cylinders.values, np.arange(1, engine.n_cylinders + 1)
        ):
            raise ParameterError(
                f"the coordinate {CYLINDER} is {labelled_cylinders.values.tolist()}, but must be "
                f"1 to {engine.n_cylinders}: the order of opening"
            )
        _check_cylinders(sizes.pop(CYLINDER, None), variables, engine.n_cylinders)
        inputs = cls(
            engine,
            {k: variables[k] for k in points},
            {k: variables[k] for k in parameters},
            sizes,
            labels,
        )
        if inputs.count == 0:
            raise ParameterError("the inputs hold no operating point: give at least one")
        inputs._check_dims()
        inputs._check_parameters()
        return inputs

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the result, without that of the cylinders."""
        return tuple(self.sizes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Their sizes."""
        return tuple(self.sizes.values())

    @property
    def count(self) -> int:
        """Number of points."""
        return int(np.prod(self.shape, dtype=np.int64))

    @property
    def unequal(self) -> bool:
        """Whether the cylinders have a command each."""
        return any(CYLINDER in self.variables[name].dims for name in _COMMAND)

    # -- values of a range of points, in the result's order ---------------------------------

    def values(self, name: str, first: int, last: int) -> FloatArray:
        """Values of an input at a range of points."""
        (array,) = self._arrays[name]
        return np.asarray(array.flat[first:last])

    def commands(self, first: int, last: int) -> FloatArray:
        """Lift, duration and opening at a range of points: (points, 3), or 3 for a cylinder."""
        cylinders = self.engine.n_cylinders if self.unequal else 1
        table = np.empty((last - first, 3 * cylinders))
        for k, name in enumerate(_COMMAND):
            arrays = self._arrays[name]
            for j in range(cylinders):
                table[:, 3 * j + k] = arrays[j % len(arrays)].flat[first:last]
        return table

    def parameter_columns(self, first: int, last: int) -> Iterator[tuple[int, FloatArray]]:
        """Column of a row of engine numbers, and its values, for each parameter."""
        known = engine_fields(self.engine)
        for name in self.parameters:
            yield known.index(name), self.values(name, first, last)

    @cached_property
    def _arrays(self) -> dict[str, list[FloatArray]]:
        """Views of the inputs in the shape of the result, one for each cylinder that differs."""
        views = {}
        for name, variable in {**self.variables, **self.parameters}.items():
            each = [variable]
            if CYLINDER in variable.dims:
                each = [variable.isel({CYLINDER: j}) for j in range(variable.sizes[CYLINDER])]
            views[name] = [self._spread(v) for v in each]
        return views

    def _spread(self, variable: xr.Variable) -> FloatArray:
        array = variable.transpose(*(dim for dim in self.dims if dim in variable.dims)).values
        own = tuple(slice(None) if dim in variable.dims else np.newaxis for dim in self.dims)
        return np.broadcast_to(array[own], self.shape)

    # -- one point ---------------------------------------------------------------------------

    def point(self, point: int) -> dict[str, float]:
        """Speed and throttle angle of a point."""
        return {
            k: float(self.values(k, point, point + 1)[0]) for k in ("speed_rpm", "throttle_deg")
        }

    def engine_at(self, point: int) -> Engine:
        """Engine of a point."""
        changes = {k: float(self.values(k, point, point + 1)[0]) for k in self.parameters}
        return replace_engine_fields(self.engine, changes) if changes else self.engine

    def place(self, point: int) -> str:
        """Words for a point: its index and its values."""
        index = np.unravel_index(point, self.shape)
        place = ", ".join(f"{dim}={int(i)}" for dim, i in zip(self.dims, index, strict=True))
        values = []
        for name, arrays in self._arrays.items():
            each = "/".join(f"{float(array.flat[point]):g}" for array in arrays)
            values.append(f"{name} {each}")
        return f"point ({place}) with {', '.join(values)}"

    # -- coordinates and checks -----------------------------------------------------------

    def coordinates(self) -> dict[str, xr.Variable]:
        """Coordinates of the result: the inputs, along their own dimensions, and their labels."""
        coordinates = dict(self.labels)
        for name, variable in {**self.variables, **self.parameters}.items():
            long_name, units = _NAMES.get(name, (f"engine parameter {name}", field_unit(name)))
            coordinates[name] = xr.Variable(
                variable.dims, variable.values, {"long_name": long_name, "units": units}
            )
        return coordinates

    def _check_dims(self) -> None:
        for name, variable in {**self.variables, **self.parameters}.items():
            if name in self.sizes and variable.dims != (name,):
                raise ParameterError(
                    f"{name} varies along {variable.dims}, but a dimension has its name: name the "
                    "dimension otherwise, or let that input vary along it alone"
                )
            label = self.labels.get(name)
            if label is not None and not np.array_equal(label.values, variable.values):
                raise ParameterError(
                    f"the inputs' coordinate {name} differs from the argument {name}: rename it"
                )

    def _check_parameters(self) -> None:
        """Check each parameter's bounds, intervals all, at its ends."""
        for name in self.parameters:
            own = np.asarray(self.parameters[name].values)
            bad = ~np.isfinite(own)
            ends = [np.argmax(bad)] if bad.any() else [np.argmin(own), np.argmax(own)]
            for end in ends:
                index = np.unravel_index(int(end), own.shape)
                at = dict(zip(self.parameters[name].dims, index, strict=True))
                point = np.ravel_multi_index([at.get(d, 0) for d in self.dims], self.shape)
                try:
                    self.engine_at(int(point))
                except ParameterError as error:
                    raise ParameterError(f"{self.place(int(point))}: {error}") from None


def _numbers(name: str, value: Any) -> FloatArray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ParameterError(f"{name} holds {array.dtype} ({value!r:.60}), but must hold numbers")
    return array.astype(float, copy=False)


def _plain_dims(ndim: int, dims: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the dimensions of inputs that are plain arrays."""
    if dims is None:
        return tuple(f"dim_{k}" for k in range(ndim))
    names = tuple(dims)
    if isinstance(dims, str) or len(set(names)) != len(names) or len(names) != ndim:
        raise ParameterError(
            f"dims is {dims!r}, but must be {ndim} different names, as many as the plain arrays "
            "have dimensions"
        )
    return names


def _labels(inputs: Mapping[str, xr.DataArray]) -> dict[str, xr.Variable]:
    """Coordinates of the labelled inputs, which must agree."""
    labels: dict[str, xr.Variable] = {}
    for name, array in inputs.items():
        for label, coordinate in array.coords.items():
            variable = coordinate.variable
            known = labels.setdefault(str(label), variable)
            if known.dims != variable.dims or not np.array_equal(known.values, variable.values):
                raise ParameterError(
                    f"{name} has another coordinate {label} than the inputs before: select the "
                    "same values, or rename the dimension"
                )
    return labels


def _check_cylinders(size: int | None, variables: Mapping[str, xr.Variable], n: int) -> None:
    if size is None:
        return
    for name, variable in variables.items():
        if CYLINDER in variable.dims and name not in _COMMAND:
            raise ParameterError(
                f"{name} varies along {CYLINDER}, but only {', '.join(_COMMAND)} may: a cylinder's "
                "flow coefficient is varied by cylinder_flow_factors[0] and so on"
            )
    if size != n:
        raise ParameterError(
            f"the commands are for {size} cylinders, but the engine has {n}: give one for each"
        )
