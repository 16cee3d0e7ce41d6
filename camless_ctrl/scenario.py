"""A closed-loop scenario as data: engine, profile, sensors, faults, controller, requirements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

from plant import CrankAnglePlant, Engine, ParameterError
from plant._checks import in_range, one_of, replace_fields, truth, whole
from plant.sensors import SensorSet

from ._scenario_checks import check_equal, check_parts
from ._scenario_data import (
    engine_data,
    engine_of,
    plain,
    sensors_data,
    sensors_of,
    true_engine_of,
    valves_data,
    valves_of,
)
from ._scenario_tables import ScenarioError, Table, check_finite
from .closed_loop import ValveErrors
from .closed_loop_requirement import ClosedLoopRequirement
from .faults import Fault
from .operating_profile import OperatingProfile

__all__ = ["ControllerChoice", "Scenario", "ScenarioError"]

Law = Literal["least-squares", "gradient", "integral", "feedforward"]

LAWS: tuple[Law, ...] = ("least-squares", "gradient", "integral", "feedforward")
_KEYS = (
    "name",
    "description",
    "seed",
    "engine",
    "true",
    "profile",
    "sensors",
    "valves",
    "faults",
    "controller",
    "requirements",
)


@dataclass(frozen=True)
class ControllerChoice:
    """Which controller is run.

    Attributes
    ----------
    law : {"least-squares", "gradient", "integral", "feedforward"}
        Adaptation law; ``"feedforward"`` learns nothing and sees no density.
    warm_up_cycles : int
        Engine cycles at what holds at the start, before the profile begins: what is to be learnt
        is learnt then.
    speed_range_rpm : (float, float), optional
        Lowest and highest speed of the controller's maps; all speeds if not given.
    knows_sensors : bool
        Whether the estimator is made for lag, delay, noise and range of the scenario's sensors,
        as of a data sheet; for those of the default sensors if not. It never knows gain error
        and offset.
    """

    law: Law = "least-squares"
    warm_up_cycles: int = 0
    speed_range_rpm: tuple[float, float] | None = None
    knows_sensors: bool = True

    def __post_init__(self) -> None:
        one_of("law", self.law, LAWS)
        whole("warm_up_cycles", self.warm_up_cycles, 0, 100_000)
        truth("knows_sensors", self.knows_sensors)
        if self.speed_range_rpm is None:
            return
        if not isinstance(self.speed_range_rpm, tuple) or len(self.speed_range_rpm) != 2:
            raise ParameterError(
                f"speed_range_rpm is {self.speed_range_rpm!r}, but must be the lowest and the "
                "highest speed in rpm"
            )
        low, high = self.speed_range_rpm
        in_range("speed_range_rpm[0]", low, 0.0, 20_000.0, "rpm", open_low=True)
        in_range("speed_range_rpm[1]", high, low, 20_000.0, "rpm", open_low=True)
        object.__setattr__(self, "speed_range_rpm", (float(low), float(high)))

    def to_dict(self) -> dict[str, Any]:
        """Return the choice as plain data."""
        data: dict[str, Any] = {
            "law": self.law,
            "warm_up_cycles": self.warm_up_cycles,
            "knows_sensors": self.knows_sensors,
        }
        if self.speed_range_rpm is not None:
            data["speed_range_rpm"] = list(self.speed_range_rpm)
        return data

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Return the choice of plain data.

        Raises
        ------
        ScenarioError
            If a key is unknown or a value impossible.
        """
        table = data if isinstance(data, Table) else Table(data, ("controller",))
        table.only("law", "warm_up_cycles", "speed_range_rpm", "knows_sensors")
        given = dict(table.data)
        if "speed_range_rpm" in given:
            given["speed_range_rpm"] = tuple(table.items("speed_range_rpm"))
        with table.at():
            return cls(**given)


@dataclass(frozen=True)
class Scenario:
    """All that a closed-loop run is made of, and what is asked of it.

    Attributes
    ----------
    name, description : str
        What it is called, and what it shows.
    profile : OperatingProfile
        What is asked of the engine. Times of faults and requirements count from its start.
    engine : Engine
        The engine as the controller's design knows it; its cylinders are equal.
    true : mapping
        In which fields the true engine differs from it, as plain data; ``flow_factor``
        multiplies the flow coefficient.
    sensors : SensorSet
        The sensors.
    valves : ValveErrors
        Errors of the actuators.
    faults : tuple of Fault
        What fails, and when.
    controller : ControllerChoice
        The controller.
    requirements : tuple of ClosedLoopRequirement
        What the result must meet.
    seed : int
        Seed of noise and jitter.

    Raises
    ------
    ParameterError
        If two parts contradict each other: a fault, requirement or deactivation of a cylinder
        that does not exist, a fault that starts after the end, or a requirement on a fault that
        does not exist.
    """

    name: str
    description: str
    profile: OperatingProfile = field(repr=False)
    engine: Engine = field(default_factory=Engine.paper, repr=False)
    true: Mapping[str, Any] = field(default_factory=dict)
    sensors: SensorSet = field(default_factory=SensorSet, repr=False)
    valves: ValveErrors = field(default_factory=ValveErrors)
    faults: tuple[Fault, ...] = ()
    controller: ControllerChoice = field(default_factory=ControllerChoice)
    requirements: tuple[ClosedLoopRequirement, ...] = field(default=(), repr=False)
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise ParameterError(f"name is {self.name!r}, but must be a text that is not empty")
        whole("seed", self.seed, 0, 2**63 - 1)
        check_parts(self)
        object.__setattr__(self, "true", plain(self.true))
        true_engine_of(self.engine, Table(self.true, ("true",)))

    @property
    def true_engine(self) -> Engine:
        """The engine that is run."""
        return true_engine_of(self.engine, Table(self.true, ("true",)))

    @property
    def plant(self) -> CrankAnglePlant:
        """The full plant that is run, runner and actuator oscillation on."""
        return CrankAnglePlant(self.true_engine, runner=True, oscillation=True)

    @property
    def assumed_sensors(self) -> SensorSet:
        """The sensors that the controller is made for."""
        return self.sensors if self.controller.knows_sensors else SensorSet()

    def replace(self, **changes: Any) -> Self:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, in the structure of a scenario file.

        Fields of engine and sensors are written out, table files as points: the data alone give
        the same scenario again.
        """
        return {
            "name": self.name,
            "description": self.description,
            "seed": self.seed,
            "engine": engine_data(self.engine),
            "true": plain(self.true),
            "profile": self.profile.to_dict(),
            "sensors": sensors_data(self.sensors),
            "valves": valves_data(self.valves),
            "controller": self.controller.to_dict(),
            "faults": [fault.to_dict() for fault in self.faults],
            "requirements": [requirement.to_dict() for requirement in self.requirements],
        }

    @classmethod
    def from_dict(cls, data: Any, folder: Path | None = None) -> Self:
        """Return the scenario of plain data.

        Parameters
        ----------
        data : mapping
            As of `to_dict`, or of a scenario file.
        folder : Path, optional
            Where table files of the profile lie; without, none may be named.

        Raises
        ------
        ScenarioError
            If a key is unknown or missing, or a value impossible; the message names table, key,
            value and what is allowed.
        """
        table = data if isinstance(data, Table) else Table(data)
        check_finite(table.data, table.place)
        table.only(*_KEYS)
        name = table.text("name")
        table.needed("profile", "the table [profile], with demand_mg and speed_rpm")
        engine = engine_of(table.table("engine"))
        with table.around():
            check_equal(engine)
        true_engine_of(engine, table.table("true"))
        faults = []
        for item in table.tables("faults"):
            with item.at():
                faults.append(Fault.from_dict(item.data))
        requirements = []
        for item in table.tables("requirements"):
            with item.at():
                requirements.append(ClosedLoopRequirement.from_dict(item.data))
        profile = OperatingProfile.from_dict(table.table("profile"), folder)
        given: dict[str, Any] = {
            "description": table.text("description", ""),
            "sensors": sensors_of(table.table("sensors")),
            "valves": valves_of(table.table("valves")),
            "controller": ControllerChoice.from_dict(table.table("controller")),
            "seed": table.whole("seed", 0, 0, 2**63 - 1),
        }
        with table.around():  # the parts are right; what is wrong now is how they fit
            return cls(
                name=name,
                profile=profile,
                engine=engine,
                true=table.data.get("true", {}),
                faults=tuple(faults),
                requirements=tuple(requirements),
                **given,
            )
