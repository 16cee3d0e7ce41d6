"""Argument checks that say the value, the bound, the unit and the remedy."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable
from numbers import Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .errors import ParameterError
from .kinematics import FloatArray

T = TypeVar("T")


def in_range(
    name: str,
    value: Any,
    low: float,
    high: float,
    unit: str,
    *,
    open_low: bool = False,
    open_high: bool = False,
    remedy: str = "",
) -> float:
    """Return `value` as a float after checking that it is a finite number in the interval.

    Raises
    ------
    ParameterError
        If it is not a number, not finite or outside ``[low, high]`` (an open end excludes
        its bound).
    """
    # A float is what most calls hand in; the general question costs a microsecond.
    if type(value) is not float and (isinstance(value, bool) or not isinstance(value, Real)):
        raise ParameterError(
            f"{name} is {value!r}, but must be a number{' in ' + unit if unit != '1' else ''}"
        )
    number = float(value)
    below = number <= low if open_low else number < low
    above = number >= high if open_high else number > high
    if not math.isfinite(number) or below or above:
        bound = _interval(low, high, unit, open_low=open_low, open_high=open_high)
        advice = f": {remedy}" if remedy else ""
        raise ParameterError(f"{name} is {number:g}{_of(unit)}, but must be {bound}{advice}")
    return number


def positive(name: str, value: Any, unit: str, *, remedy: str = "") -> float:
    """Return `value` as a float after checking that it is finite and above zero."""
    return in_range(name, value, 0.0, math.inf, unit, open_low=True, remedy=remedy)


def whole(name: str, value: Any, low: int, high: int, *, remedy: str = "") -> int:
    """Return `value` as an int after checking that it is a whole number in ``[low, high]``."""
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise ParameterError(f"{name} must be a whole number, got {value!r}")
    number = int(value.__index__())
    if not low <= number <= high:
        advice = f": {remedy}" if remedy else ""
        raise ParameterError(f"{name} is {number}, but must be from {low} to {high}{advice}")
    return number


def truth(name: str, value: Any) -> bool:
    """Return `value` after checking that it is True or False."""
    if value is True or value is False or type(value).__name__ == "bool":  # numpy.bool too
        return bool(value)
    raise ParameterError(f"{name} is {value!r}, but must be True or False")


def one_of(name: str, value: Any, allowed: Iterable[str]) -> str:
    """Return `value` after checking that it is one of `allowed`; suggest the nearest one."""
    choices = tuple(allowed)
    if value not in choices:
        raise ParameterError(
            f"{name} is {value!r}, but must be one of {', '.join(choices)}"
            + _suggestion(value, choices)
        )
    return str(value)


def broadcast(what: str, *values: ArrayLike) -> tuple[FloatArray, ...]:
    """Return values as arrays of numbers of one shape.

    Raises
    ------
    ParameterError
        If one is no number, or the shapes do not fit each other.
    """
    try:
        arrays = [np.asarray(value, dtype=float) for value in values]
        return tuple(np.broadcast_arrays(*arrays))
    except (TypeError, ValueError) as error:
        raise ParameterError(
            f"{what} are not numbers of shapes that fit each other ({error}): give numbers, or "
            "arrays that broadcast"
        ) from error


def replace_fields(instance: T, changes: dict[str, Any]) -> T:
    """`dataclasses.replace` that names an unknown field and the nearest known one."""
    known = tuple(f.name for f in dataclasses.fields(instance))  # type: ignore[arg-type]
    for name in changes:
        if name not in known:
            raise ParameterError(
                f"{type(instance).__name__} has no field {name!r}"
                + _suggestion(name, known)
                + f"; its fields are {', '.join(known)}"
            )
    return dataclasses.replace(instance, **changes)  # type: ignore[type-var]


def _suggestion(value: Any, choices: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(str(value), choices, n=1, cutoff=0.5)
    return f" (did you mean {near[0]!r}?)" if near else ""


def _of(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def _interval(low: float, high: float, unit: str, *, open_low: bool, open_high: bool) -> str:
    if math.isinf(low):
        return "finite"
    if math.isinf(high):
        return f"finite and {'above' if open_low else 'at least'} {low:g}{_of(unit)}"
    left, right = "(" if open_low else "[", ")" if open_high else "]"
    return f"in {left}{low:g}, {high:g}{right}{_of(unit)}"
