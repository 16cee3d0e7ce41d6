"""Columns of a table file: CSV with a row of names, perhaps one of units, then numbers."""

from __future__ import annotations

import csv
import difflib
import io
import math
from pathlib import Path
from typing import NamedTuple, NoReturn

from plant import ParameterError

from ._table_units import UNITS, Conversion, conversion

TIME_COLUMNS = ("timestamps", "time_s", "time")  # names by which a time column is known
_SEPARATORS = (";", "\t", ",")


class Column(NamedTuple):
    """A column over the time column."""

    positions: tuple[float, ...]
    values: tuple[float, ...]


def read_column(
    path: Path,
    name: str,
    time: str | None = None,
    *,
    unit: str | None = None,
    axis: str = "s",
) -> Column:
    """Read a column and its time column.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        The column.
    time : str, optional
        Its time column; that of `TIME_COLUMNS` which is there by default.
    unit : str, optional
        Unit that the values are wanted in, a key of `UNITS`: a row of units must tell one that
        can be converted to it. Without, it may tell any, and nothing is converted.
    axis : {"s", "cycles"}
        Unit of the time column.

    Raises
    ------
    ParameterError
        If the file cannot be read, a row has more or fewer cells than there are names, a column
        is missing, a unit does not fit, a value is no finite number, or times do not rise; the
        message names file, row, column, value and remedy.
    """
    rows = _rows(path)
    names = [cell.strip() for cell in rows[0][1]]
    _unambiguous(path, names)
    when = _time_column(path, names, time)
    what = _place(path, names, name)
    body = rows[1:]
    for row, cells in body:
        _complete(path, row, names, cells)
    change = Conversion()
    if body and _is_units(body[0][1]):
        _converted(path, body[0], names, when, axis)
        if unit is not None:
            change = _converted(path, body[0], names, what, unit)
        body = body[1:]
    if not body:
        raise ParameterError(f"{path} has no row of numbers: give at least one below the names")
    positions: list[float] = []
    values: list[float] = []
    for row, cells in body:
        at = _number(path, row, names, when, cells)
        if positions and at <= positions[-1]:
            raise ParameterError(
                f"{path}, row {row}, column {names[when]!r}: the time is {at:g}, but must be "
                f"above {positions[-1]:g} of the row before: sort the rows, and leave out those "
                "that repeat"
            )
        positions.append(at)
        values.append(change.factor * _number(path, row, names, what, cells) + change.offset)
    return Column(tuple(positions), tuple(values))


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Rows that are not empty, with the number of the line on which each ends."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = (error.strerror or error) if isinstance(error, OSError) else error
        raise ParameterError(
            f"{path} cannot be read ({why}): give the name of a CSV file in UTF-8"
        ) from error
    first = next((line for line in text.splitlines() if line.strip()), "")
    separator = max(_SEPARATORS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise ParameterError(
            f"{path}, row {reader.line_num} is no CSV ({error}): export the table again"
        ) from error
    if not rows:
        raise ParameterError(f"{path} is empty: its first row must hold the names of its columns")
    return rows


def _unambiguous(path: Path, names: list[str]) -> None:
    twice = sorted({name for name in names if name and names.count(name) > 1})
    if twice:
        raise ParameterError(f"{path} has several columns {twice[0]!r}: give each its own name")


def _time_column(path: Path, names: list[str], time: str | None) -> int:
    if time is not None:
        return _place(path, names, time)
    for name in TIME_COLUMNS:
        if name in names:
            return names.index(name)
    raise ParameterError(
        f"{path} has no column {', '.join(TIME_COLUMNS)} (its columns are {', '.join(names)}): "
        "name the column of the time with time"
    )


def _place(path: Path, names: list[str], name: str) -> int:
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ParameterError(
            f"{path} has no column {name!r}: {hint}Its columns are {', '.join(names)}"
        )
    return names.index(name)


def _complete(path: Path, row: int, names: list[str], cells: list[str]) -> None:
    """Refuse a row that does not have a cell for each name."""
    found, expected = len(cells), len(names)
    if found == expected:
        return
    if found < expected:
        why = f"it ends before {names[found]!r}: give every column a value"
    else:
        why = (
            f"{cells[expected]!r} has no name: write decimals with a point, put texts with a "
            "separator in quotes, or name the column"
        )
    raise ParameterError(
        f"{path}, row {row} has {found} cell{'s' if found > 1 else ''}, but the row of names has "
        f"{expected}; {why}"
    )


def _is_units(cells: list[str]) -> bool:
    """Whether a row holds units: texts, but that the unit of a pure number is 1."""
    given = [cell.strip().strip("[]") for cell in cells]
    texts = [cell for cell in given if cell != "1"]
    return any(texts) and not any(_is_number(cell) for cell in texts)


def _converted(
    path: Path, units: tuple[int, list[str]], names: list[str], column: int, wanted: str
) -> Conversion:
    """How a column becomes one of the unit that is wanted."""
    row, cells = units
    told = cells[column].strip().strip("[]").strip()
    found = conversion(told, wanted)
    if found is None:
        raise ParameterError(
            f"{path}, row {row}, column {names[column]!r}: the unit is {told!r}, but must be one "
            f"of {', '.join(UNITS[wanted])}: convert the values, or leave the unit out if they "
            f"are in {wanted}"
        )
    return found


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _number(path: Path, row: int, names: list[str], column: int, cells: list[str]) -> float:
    cell = cells[column].strip()
    try:
        value = float(cell)
    except ValueError:
        comma = "write decimals with a point" if "," in cell else "write a number"
        if not cell:
            _refuse(path, row, names[column], cell, "empty: write a number, or leave the row out")
        _refuse(path, row, names[column], cell, f"no number: {comma}")
    if not math.isfinite(value):
        _refuse(path, row, names[column], cell, "not finite: leave the row out, or mend it")
    return value


def _refuse(path: Path, row: int, column: str, value: str, why: str) -> NoReturn:
    raise ParameterError(f"{path}, row {row}, column {column!r}: {value!r} is {why}")
