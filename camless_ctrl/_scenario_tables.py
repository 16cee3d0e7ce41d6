"""Tables of plain data, read with errors that tell table, key, value and what is allowed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from plant import ParameterError
from plant._checks import in_range, one_of, whole

Place = tuple[str | int, ...]

_ENDS = ("end", "until_s")  # keys that may be left out for what has no end


class ScenarioError(ParameterError):
    """A scenario's data are wrong.

    Attributes
    ----------
    place : tuple of str and int
        Way to the key, or to the table: names of keys, and numbers of items from 0.
    table : tuple of str and int
        Way to the table.
    key : str or None
        The key, if it is one that is wrong.
    problem : str
        What is wrong with it.
    """

    def __init__(self, problem: str, table: Place, key: str | None = None) -> None:
        self.place: Place = table if key is None else (*table, key)
        self.table, self.key = table, key
        self.problem = problem
        label = " ".join(part for part in (_label(table), key) if part)
        super().__init__(f"{label}: {problem}" if label else problem)


class Table:
    """A table at its place, whose keys are asked for one by one.

    Parameters
    ----------
    data : mapping
        Its keys and values.
    place : tuple of str and int
        Way to it.

    Raises
    ------
    ScenarioError
        If it is no mapping.
    """

    def __init__(self, data: Any, place: Place = ()) -> None:
        if not isinstance(data, Mapping):
            raise ScenarioError(f"value {data!r} must be a table of keys and values", place)
        self.data, self.place = data, place

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def only(self, *allowed: str) -> None:
        """Refuse keys that are not known; the nearest known one is named."""
        for key in self.data:
            with self.at(str(key)):
                one_of("the key", key, allowed)

    @contextmanager
    def at(self, key: str | None = None) -> Iterator[None]:
        """Give errors of values their place: a key, or the one that the message tells."""
        try:
            yield
        except ScenarioError:
            raise
        except ParameterError as error:
            found = _meant(str(error), self.data) if key is None else key
            raise ScenarioError(str(error), self.place, found) from error

    @contextmanager
    def around(self) -> Iterator[None]:
        """Put errors whose places count from this table in their place."""
        try:
            yield
        except ScenarioError as error:
            place = (*self.place, *error.table)
            raise ScenarioError(error.problem, place, error.key) from error

    def needed(self, key: str, what: str) -> Any:
        """Value of a key that must be there."""
        if key not in self.data:
            raise ScenarioError(f"{key} is missing: give {what}", self.place, key)
        return self.data[key]

    def text(self, key: str, default: str | None = None) -> str:
        """Text; it must be there, and not empty, if there is no default."""
        value = self.needed(key, "a text") if default is None else self.data.get(key, default)
        if not isinstance(value, str):
            raise ScenarioError(f"{key} is {value!r}, but must be a text", self.place, key)
        if default is None and not value.strip():
            raise ScenarioError(
                f"{key} is {value!r}, but must be a text that is not empty", self.place, key
            )
        return value

    def whole(self, key: str, default: int, low: int, high: int) -> int:
        """Whole number in a range."""
        with self.at(key):
            return whole(key, self.data.get(key, default), low, high)

    def number(self, key: str, default: float, unit: str) -> float:
        """A finite number."""
        with self.at(key):
            return in_range(key, self.data.get(key, default), -math.inf, math.inf, unit)

    def items(self, key: str) -> list[Any]:
        """List; empty if it is not there."""
        value = self.data.get(key, [])
        if not isinstance(value, list | tuple):
            raise ScenarioError(f"value {value!r} must be a list", self.place, key)
        return list(value)

    def table(self, key: str) -> Table:
        """Table within; empty if it is not there."""
        return Table(self.data.get(key, {}), (*self.place, key))

    def tables(self, key: str) -> list[Table]:
        """Tables of a list; none if it is not there."""
        return [Table(item, (*self.place, key, i)) for i, item in enumerate(self.items(key))]


def check_finite(data: Any, place: Place = ()) -> None:
    """Refuse numbers that are not finite, wherever they are.

    Raises
    ------
    ScenarioError
        If there is one.
    """
    if isinstance(data, Mapping):
        for key, value in data.items():
            check_finite(value, (*place, str(key)))
    elif isinstance(data, list | tuple):
        for i, value in enumerate(data):
            check_finite(value, (*place, i))
    elif isinstance(data, float) and not math.isfinite(data):
        names = [i for i, step in enumerate(place) if isinstance(step, str)]
        if not names:
            raise ScenarioError(f"{data} is there, but must be a finite number", place)
        last = names[-1]
        key = str(place[last])
        of = "" if last == len(place) - 1 else f" (item {_items(place[last + 1 :])})"
        remedy = ": leave it out if there is no end" if data > 0.0 and key in _ENDS else ""
        problem = f"{key}{of} is {data}, but must be a finite number{remedy}"
        raise ScenarioError(problem, place[:last], key)


def _meant(message: str, data: Mapping[str, Any]) -> str | None:
    """Key that a message begins with, or puts in quotes."""
    first = re.split(r"[ \[]", message, maxsplit=1)[0]
    quoted: list[str] = re.findall(r"'([^']*)'", message)
    return next((word for word in (first, *quoted) if word in data), None)


def _items(places: Place) -> str:
    return ", ".join(str(int(i) + 1) for i in places)


def _label(table: Place) -> str:
    """How a table is told: ``[sensors.maf]``, or ``[[faults]] 2`` for the second of a list."""
    names = [str(step) for step in table if isinstance(step, str)]
    numbers = [step + 1 for step in table if isinstance(step, int)]
    if not names:
        return ""
    if table and isinstance(table[-1], int):
        return f"[[{'.'.join(names)}]] {numbers[-1]}"
    return f"[{'.'.join(names)}]"
