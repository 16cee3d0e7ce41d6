"""A quantity over time or engine cycles, as points that are joined or held."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import in_range, one_of
from plant.kinematics import FloatArray

from ._profile_table import read_column
from ._table_units import UNITS

Between = Literal["linear", "hold"]

ROUNDING = 1e-9  # by which a position may miss a jump that it is on
_LARGEST = 1e9  # of positions and values: beyond, a unit is mistaken
_FORMS = {
    "points": ("points", "between"),
    "ramp": ("ramp", "start", "end"),
    "steps": ("steps", "every", "at"),
    "file": ("file", "column", "time", "between"),
}


@dataclass(frozen=True)
class Signal:
    """A quantity over an axis; before the first and after the last point it is held.

    Attributes
    ----------
    positions : tuple of float
        Where the points lie, rising: s, or engine cycles.
    values : tuple of float
        Value at each point, in the unit of the quantity.
    between : {"linear", "hold"}
        Whether points are joined by lines, or each is held up to the next.

    Raises
    ------
    ParameterError
        If there is no point, a number is not finite, or positions do not rise.
    """

    positions: tuple[float, ...]
    values: tuple[float, ...]
    between: Between = "linear"

    def __post_init__(self) -> None:
        one_of("between", self.between, ("linear", "hold"))
        positions, values = tuple(self.positions), tuple(self.values)
        if not positions or len(positions) != len(values):
            raise ParameterError(
                f"a signal has {len(positions)} positions and {len(values)} values: give one "
                "value for each position, and at least one"
            )
        for i, (x, y) in enumerate(zip(positions, values, strict=True)):
            in_range(f"position of point {i + 1}", x, -_LARGEST, _LARGEST, "1")
            in_range(f"value of point {i + 1}", y, -_LARGEST, _LARGEST, "1")
            if i and x <= positions[i - 1]:
                raise ParameterError(
                    f"point {i + 1} lies at {x:g}, but must come after point {i} at "
                    f"{positions[i - 1]:g}: sort the points, and leave out those that repeat"
                )
        object.__setattr__(self, "positions", tuple(float(x) for x in positions))
        object.__setattr__(self, "values", tuple(float(y) for y in values))

    @classmethod
    def constant(cls, value: float) -> Self:
        """Return a quantity that does not change."""
        return cls((0.0,), (value,))

    @classmethod
    def points(cls, points: Iterable[Sequence[float]], between: Between = "linear") -> Self:
        """Return a quantity from pairs of position and value."""
        pairs = list(points)
        for i, pair in enumerate(pairs):
            if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
                raise ParameterError(
                    f"point {i + 1} is {pair!r}, but must be a pair: position and value"
                )
        return cls(tuple(x for x, _ in pairs), tuple(y for _, y in pairs), between)

    @classmethod
    def ramp(cls, first: float, last: float, *, start: float = 0.0, end: float) -> Self:
        """Return a quantity that goes from one value to another between two positions."""
        return cls((start, end), (first, last))

    @classmethod
    def steps(
        cls, values: Sequence[float], *, every: float | None = None, at: Sequence[float] = ()
    ) -> Self:
        """Return a quantity that jumps.

        Parameters
        ----------
        values : sequence of float
            Value from the start, and after each step.
        every : float, optional
            Distance of the steps; the first comes after one distance.
        at : sequence of float
            Positions of the steps instead, one fewer than values.
        """
        if (every is None) == (not at):
            raise ParameterError(
                f"steps have every = {every} and at = {list(at)}: give one of them, the distance "
                "of the steps or the position of each"
            )
        if every is not None:
            in_range("every", every, 0.0, _LARGEST, "1", open_low=True)
            at = [every * (i + 1) for i in range(len(values) - 1)]
        if len(at) != len(values) - 1:
            raise ParameterError(
                f"there are {len(values)} values and {len(at)} steps: give one step fewer than "
                "values"
            )
        first = min(0.0, *(x - 1.0 for x in at)) if at else 0.0
        return cls((first, *at), tuple(values), "hold")

    @classmethod
    def column(
        cls,
        path: str | Path,
        name: str,
        *,
        time: str | None = None,
        between: Between = "linear",
        unit: str | None = None,
        axis: str = "s",
    ) -> Self:
        """Return a column of a table file.

        Parameters
        ----------
        path : str or Path
            A CSV file: a row of names, perhaps one of units, then numbers, separated by
            comma, semicolon or tab.
        name : str
            Column of the quantity.
        time : str, optional
            Column of the position; ``timestamps``, ``time_s`` or ``time`` by default.
        between : {"linear", "hold"}
            What comes between the rows.
        unit : {"mg", "rpm", "deg", "Pa", "K", "1"}, optional
            Unit of the quantity: what the file has in another one is converted, or refused. Any
            unit is taken as it is if not given.
        axis : {"s", "cycles"}
            Unit of the position.

        Raises
        ------
        ParameterError
            If the file cannot be read, or the column cannot be used; the message names file,
            row, column and value.
        """
        if unit is not None:
            one_of("unit", unit, UNITS)
        one_of("axis", axis, ("s", "cycles"))
        table = read_column(Path(path), name, time, unit=unit, axis=axis)
        return cls(table.positions, table.values, between)

    @property
    def is_constant(self) -> bool:
        """Whether it has one value."""
        return len(set(self.values)) == 1

    @property
    def last(self) -> float:
        """Position of the last point."""
        return self.positions[-1]

    def at(self, position: ArrayLike) -> FloatArray:
        """Values at positions."""
        x = np.asarray(position, dtype=float)
        values = np.array(self.values)
        if self.between == "linear":
            return np.asarray(np.interp(x, self.positions, values))
        before = np.searchsorted(self.positions, x + ROUNDING, side="right") - 1
        return np.asarray(values[np.maximum(before, 0)])

    def to_dict(self) -> Any:
        """Return a number, or the points as plain data."""
        if len(self.values) == 1:
            return self.values[0]
        pairs = [[x, y] for x, y in zip(self.positions, self.values, strict=True)]
        return {"points": pairs, "between": self.between}

    @classmethod
    def from_dict(
        cls,
        data: Any,
        folder: Path | None = None,
        *,
        unit: str | None = None,
        axis: str = "s",
    ) -> Self:
        """Return the signal of a number or a table of one of its forms.

        Parameters
        ----------
        data : float or mapping
            A number, or a mapping with the key ``points``, ``ramp``, ``steps`` or ``file``.
        folder : Path, optional
            Where table files lie; without, none may be named.
        unit, axis : str, optional
            Unit of quantity and position, which those of a table file must fit: see `column`.

        Raises
        ------
        ParameterError
            If it is none of them, or a table file is outside the folder or wrong.
        """
        if not isinstance(data, Mapping):
            if isinstance(data, bool) or not isinstance(data, Real):
                raise ParameterError(
                    f"the signal is {data!r}, but must be a number, or a table with one of "
                    f"{', '.join(_FORMS)}, as {{ points = [[0.0, 1.0], [2.0, 3.0]] }}"
                )
            return cls.constant(in_range("value", data, -_LARGEST, _LARGEST, "1"))
        forms = [form for form in _FORMS if form in data]
        if len(forms) != 1:
            raise ParameterError(
                f"the signal has the keys {', '.join(map(str, data)) or 'none'}, but must have "
                f"exactly one of {', '.join(_FORMS)}, or be a number"
            )
        form = forms[0]
        for key in data:
            one_of("key", key, _FORMS[form])
        rest = {key: value for key, value in data.items() if key != form}
        given = data[form]
        if form == "file":
            texts = _with_text(rest, ("column",))
            return cls.column(inside(given, folder), **texts, unit=unit, axis=axis)
        numbers = _listed(form, given)
        if form == "points":
            return cls.points(numbers, **rest)
        if form == "ramp":
            if len(numbers) != 2 or "end" not in rest:
                raise ParameterError(
                    f"ramp is {given!r} with the keys {', '.join(rest) or 'none'}, but must be "
                    "two values, with end (and start, 0 by default)"
                )
            return cls.ramp(*numbers, **rest)
        if "at" in rest:
            rest["at"] = _listed("at", rest["at"])
        return cls.steps(numbers, **rest)


def inside(name: Any, folder: Path | None) -> Path:
    """Path of a table file, which must not lie outside its folder."""
    if not isinstance(name, str):
        raise ParameterError(f"file is {name!r}, but must be the name of a table file")
    if folder is None:
        raise ParameterError(
            f"file is {name!r}, but there is no folder that it could lie in: load the scenario "
            "from its file, or give points"
        )
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise ParameterError(
            f"file is {name!r}, but must lie in the scenario's folder {folder} or below: copy it "
            "there"
        )
    return path


def _listed(name: str, value: Any) -> list[Any]:
    if not isinstance(value, list | tuple):
        raise ParameterError(f"{name} is {value!r}, but must be a list")
    return list(value)


def _with_text(rest: dict[str, Any], needed: tuple[str, ...]) -> dict[str, Any]:
    """Names of columns, checked."""
    for key in needed:
        if key not in rest:
            raise ParameterError(f"{key} is missing: name the column of the table file")
    for key in ("column", "time"):
        if key in rest and not isinstance(rest[key], str):
            raise ParameterError(f"{key} is {rest[key]!r}, but must be the name of a column")
    return {("name" if key == "column" else key): value for key, value in rest.items()}
