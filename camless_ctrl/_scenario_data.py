"""Engine, sensors and actuators of a scenario, from plain data and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from plant import Engine, HelmholtzRunner, ParameterError, Throttle, Valvetrain
from plant._checks import in_range, positive
from plant.sampling import CrankSampling, TimeSampling
from plant.sensors import AirSensor, DurationSensor, MafSensor, MapSensor, SensorSet

from ._scenario_tables import ScenarioError, Table
from .closed_loop import ValveErrors

FLOW_FACTOR = "flow_factor"  # of the true engine: multiplies the nominal flow coefficient

_PARTS = {"valvetrain": Valvetrain, "helmholtz": HelmholtzRunner, "throttle": Throttle}
_FACTORS = "cylinder_flow_factors"
_ENGINE = tuple(field.name for field in dataclasses.fields(Engine))
_NO_BITS = 0  # stands for a converter that does not quantise: there is no None in TOML

_Air = TypeVar("_Air", bound=AirSensor)


def engine_of(table: Table) -> Engine:
    """Nominal engine: the paper's, with the fields that are given."""
    table.only(*_ENGINE)
    return _changed(Engine.paper(), table)


def true_engine_of(nominal: Engine, table: Table) -> Engine:
    """True engine: the nominal one, with the fields that are given."""
    table.only(*(name for name in _ENGINE if name != "n_cylinders"), FLOW_FACTOR)
    engine = _changed(nominal, table)
    if FLOW_FACTOR not in table:
        return engine
    with table.at(FLOW_FACTOR):
        factor = positive(FLOW_FACTOR, table.data[FLOW_FACTOR], "1")
        if "flow_coefficient" in table:
            raise ParameterError(
                f"{FLOW_FACTOR} is {factor:g} while flow_coefficient is given: give one of them"
            )
        return engine.replace(flow_coefficient=factor * nominal.flow_coefficient)


def engine_data(engine: Engine) -> dict[str, Any]:
    """All fields of an engine as plain data, whatever the defaults may become."""
    data = dataclasses.asdict(engine)
    factors = data.pop(_FACTORS)
    return data | ({_FACTORS: list(factors)} if factors else {})


def sensors_of(table: Table) -> SensorSet:
    """The default sensors, with the fields that are given."""
    table.only("maf", "map", "duration")
    duration = table.table("duration")
    duration.only(*(field.name for field in dataclasses.fields(DurationSensor)))
    with duration.at():
        measured = DurationSensor().replace(**duration.data)
    return SensorSet(
        _air(MafSensor(), table.table("maf")), _air(MapSensor(), table.table("map")), measured
    )


def sensors_data(sensors: SensorSet) -> dict[str, Any]:
    """All fields of the sensors as plain data.

    Raises
    ------
    ParameterError
        If a sensor is one of a kind of its own, which has no form as data.
    """
    return {
        "maf": _air_data("maf", sensors.maf, MafSensor),
        "map": _air_data("map", sensors.map, MapSensor),
        "duration": dataclasses.asdict(sensors.duration),
    }


def valves_of(table: Table) -> ValveErrors:
    """Actuator errors; none by default."""
    table.only(*ValveErrors._fields)
    offset = table.data.get("duration_offset", 0.0)
    if isinstance(offset, list | tuple):
        found: Any = tuple(
            _seconds(table, f"duration_offset[{i}]", value) for i, value in enumerate(offset)
        )
    else:
        found = _seconds(table, "duration_offset", offset)
    with table.at("duration_jitter"):
        jitter = in_range("duration_jitter", table.data.get("duration_jitter", 0.0), 0.0, 0.01, "s")
    return ValveErrors(found, jitter)


def valves_data(valves: ValveErrors) -> dict[str, Any]:
    """Actuator errors as plain data."""
    offset = valves.duration_offset
    return {
        "duration_offset": list(offset) if isinstance(offset, tuple) else offset,
        "duration_jitter": valves.duration_jitter,
    }


def plain(value: Any) -> Any:
    """Plain data of mappings and sequences: dictionaries and lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain(dataclasses.asdict(value))
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def _changed(base: Engine, table: Table) -> Engine:
    """Return an engine with the fields of a table."""
    changes: dict[str, Any] = {}
    for key in table.data:
        if key in _PARTS:
            part = table.table(key)
            part.only(*(field.name for field in dataclasses.fields(_PARTS[key])))
            with part.at():
                changes[key] = getattr(base, key).replace(**part.data)
        elif key == _FACTORS:
            changes[key] = tuple(table.items(key))
        elif key != FLOW_FACTOR:
            changes[key] = table.data[key]
    with table.at():
        return base.replace(**changes)


def _air(base: _Air, table: Table) -> _Air:
    """Return a flow or pressure sensor with the fields of a table."""
    table.only(*(field.name for field in dataclasses.fields(base)))
    changes = dict(table.data)
    if "sampling" in table:
        changes["sampling"] = _sampling(table.table("sampling"))
    if type(changes.get("bits")) is int and changes["bits"] == _NO_BITS:
        changes["bits"] = None
    with table.at():
        return base.replace(**changes)


def _sampling(table: Table) -> TimeSampling | CrankSampling:
    if "step_deg" in table and "period" in table:
        raise ScenarioError(
            "step_deg is given, and period too, but only one of them may be: a sensor samples at "
            "equal times or at equal crank angles",
            table.place,
            "step_deg",
        )
    kind = CrankSampling if "step_deg" in table else TimeSampling
    if kind is TimeSampling and "period" not in table:
        raise ScenarioError(
            "has neither period (s, with first) nor step_deg (deg, with first_deg): give one",
            table.place,
        )
    table.only(*(field.name for field in dataclasses.fields(kind)))
    with table.at():
        return kind(**table.data)


def _air_data(name: str, sensor: Any, kind: type[AirSensor]) -> dict[str, Any]:
    if type(sensor) is not kind:
        raise ParameterError(
            f"the {name} sensor is a {type(sensor).__name__}, but only a {kind.__name__} can be "
            "written as data: use one, or run without saving"
        )
    data = dataclasses.asdict(sensor)
    return data | {"bits": _NO_BITS if data["bits"] is None else data["bits"]}


def _seconds(table: Table, name: str, value: Any) -> float:
    with table.at("duration_offset"):
        return in_range(name, value, -0.02, 0.02, "s")
