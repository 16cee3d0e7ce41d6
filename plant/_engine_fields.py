"""Numbers of an engine by name, so that they can be fitted or varied one at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ._checks import one_of
from .parameters import _POSITIVE_FIELDS, Engine

_PARTS = ("valvetrain", "helmholtz", "throttle")
_FACTORS = "cylinder_flow_factors"
_ENDINGS = {"_mm_s": "mm/s", "_mm": "mm", "_hz": "Hz", "_rpm": "rpm", "_deg": "deg"}
_UNITS = {
    **_POSITIVE_FIELDS,
    "valvetrain.seating_duration": "s",
    "valvetrain.oscillation_period": "s",
    "throttle.scale": "kg/s",
    "throttle.linear": "1/deg",
    "throttle.quadratic": "1/deg2",
}


def engine_fields(engine: Engine) -> tuple[str, ...]:
    """Names of all real numbers of an engine.

    Those of its parts carry the part's name: ``valvetrain.opening_slope_mm_s``. The flow
    factor of a cylinder is named by its place, ``cylinder_flow_factors[0]`` for the first.
    """
    names = list(_POSITIVE_FIELDS)
    for part in _PARTS:
        names += [f"{part}.{field.name}" for field in dataclasses.fields(getattr(engine, part))]
    return (*names, *(f"{_FACTORS}[{i}]" for i in range(engine.n_cylinders)))


def field_unit(name: str) -> str:
    """Unit of an engine field."""
    for ending, unit in _ENDINGS.items():
        if name.endswith(ending):
            return unit
    return _UNITS.get(name, "1")


def get_field(engine: Engine, name: str) -> float:
    """Value of an engine field.

    Raises
    ------
    ParameterError
        If there is no such field; the message suggests the nearest name.
    """
    one_of("engine field", name, engine_fields(engine))
    if name.startswith(_FACTORS):
        return _factors(engine)[_place(name)]
    value: Any = engine
    for step in name.split("."):
        value = getattr(value, step)
    return float(value)


def replace_engine_fields(engine: Engine, values: Mapping[str, float]) -> Engine:
    """Return the engine with the named fields changed, all at once.

    Raises
    ------
    ParameterError
        If a field is unknown or a value impossible.
    """
    known = engine_fields(engine)
    changes: dict[str, Any] = {}
    parts: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        one_of("engine field", name, known)
        part, dot, rest = name.partition(".")
        if dot:
            parts.setdefault(part, {})[rest] = float(value)
        elif name.startswith(_FACTORS):
            factors = changes.setdefault(_FACTORS, list(_factors(engine)))
            factors[_place(name)] = float(value)
        else:
            changes[name] = float(value)
    for part, rest_changes in parts.items():
        changes[part] = getattr(engine, part).replace(**rest_changes)
    if _FACTORS in changes:
        changes[_FACTORS] = tuple(changes[_FACTORS])
    return engine.replace(**changes)


def _factors(engine: Engine) -> tuple[float, ...]:
    return engine.cylinder_flow_factors or (1.0,) * engine.n_cylinders


def _place(name: str) -> int:
    return int(name[len(_FACTORS) + 1 : -1])
