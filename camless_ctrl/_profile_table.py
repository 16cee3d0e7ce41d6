"""Columns of a table file: CSV with a row of names, perhaps one of units, then numbers."""

from __future__ import annotations

import csv
import difflib
import io
import math
from pathlib import Path
from typing import NamedTuple, NoReturn

from plant import ParameterError

TIME_COLUMNS = ("timestamps", "time_s", "time")  # names by which a time column is known
_SEPARATORS = (";", "\t", ",")
_SECONDS = ("", "s", "sec", "second", "seconds")


class Column(NamedTuple):
    """A column over the time column."""

    positions: tuple[float, ...]
    values: tuple[float, ...]


def read_column(path: Path, name: str, time: str | None = None) -> Column:
    """Read a column and its time column.

    Raises
    ------
    ParameterError
        If the file cannot be read, a column is missing, a value is no finite number, or times
        do not rise; the message names file, row, column, value and remedy.
    """
    rows = _rows(path)
    names = [cell.strip() for cell in rows[0][1]]
    _unambiguous(path, names)
    when = _time_column(path, names, time)
    what = _place(path, names, name)
    body = rows[1:]
    if body and _is_units(body[0][1], when):
        unit = body[0][1][when].strip().strip("[]")
        if unit.lower() not in _SECONDS:
            raise ParameterError(
                f"{path}, row {body[0][0]}, column {names[when]!r}: the unit is {unit!r}, but "
                "must be s: convert the times to seconds"
            )
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
        values.append(_number(path, row, names, what, cells))
    return Column(tuple(positions), tuple(values))


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Rows that are not empty, with the number of the line on which each ends."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(
            f"{path} cannot be read ({error}): give the name of a CSV file in UTF-8"
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


def _is_units(cells: list[str], when: int) -> bool:
    """Whether a row holds units: no cell is a number, the one of the time neither."""
    return len(cells) > when and not any(_is_number(cell) for cell in cells)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _number(path: Path, row: int, names: list[str], column: int, cells: list[str]) -> float:
    if len(cells) <= column:
        _refuse(path, row, names[column], "", "the row ends before it")
    cell = cells[column].strip()
    try:
        value = float(cell)
    except ValueError:
        comma = "write decimals with a point" if "," in cell else "write a number"
        _refuse(path, row, names[column], cell, f"no number: {comma}")
    if not math.isfinite(value):
        _refuse(path, row, names[column], cell, "not finite: leave the row out, or mend it")
    return value


def _refuse(path: Path, row: int, column: str, value: str, why: str) -> NoReturn:
    raise ParameterError(f"{path}, row {row}, column {column!r}: {value!r} is {why}")
