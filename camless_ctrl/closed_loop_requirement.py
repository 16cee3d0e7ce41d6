"""Requirements on closed-loop runs: a metric, its bound, and the verdict on a result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from plant.errors import ParameterError

from ._metric import Metric, nearest
from .metrics import metric_from_dict
from .requirements import Requirement, RequirementResult, Sense

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult

_OWN_KEYS = ("name", "bound", "unit", "source", "sense")


@dataclass(frozen=True)
class ClosedLoopRequirement:
    """A bound on a metric of the result of a scenario.

    Parameters
    ----------
    name : str
        Short name, unique in its scenario.
    metric : Metric
        What is measured.
    bound : float
        The bound, in `unit`.
    unit : str
        Unit of bound and value; must be the metric's.
    source : str
        Who asks for it.
    sense : {"at most", "at least"}
        Which side of the bound is allowed.

    Raises
    ------
    ParameterError
        If name or source are empty, the bound is no number, or the unit is not the metric's.
    """

    name: str
    metric: Metric
    bound: float
    unit: str
    source: str
    sense: Sense = "at most"

    def __post_init__(self) -> None:
        if not isinstance(self.metric, Metric):
            raise ParameterError(
                f"metric is {self.metric!r}, but must be a metric, as SteadyError()"
            )
        for key in ("name", "source"):
            if not isinstance(getattr(self, key), str):
                raise ParameterError(f"{key} is {getattr(self, key)!r}, but must be a text")
        if self.unit != self.metric.unit:
            raise ParameterError(
                f"unit is {self.unit!r}, but metric {self.metric.kind!r} is in "
                f"{self.metric.unit!r}: state the bound in that unit"
            )
        _ = self.stated  # checks the rest

    @property
    def stated(self) -> Requirement:
        """Name, bound, unit, sense, source and description, as of any other requirement."""
        return Requirement(
            self.name, self.bound, self.unit, self.sense, self.source, self.metric.description
        )

    def evaluate(self, result: ScenarioResult) -> Verdict:
        """Hold the result of a scenario against the requirement.

        Raises
        ------
        ParameterError
            If the metric asks for a cylinder or a fault that the scenario does not have.
        """
        value, time, event, cylinder, note = self.metric.measure(result)
        return Verdict(self, value, time, event, note, cylinder=cylinder)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as a scenario file holds it: the metric's keys among the others."""
        return {
            "name": self.name,
            **self.metric.to_dict(),
            "bound": self.bound,
            "unit": self.unit,
            "source": self.source,
            "sense": self.sense,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Make a requirement of plain data.

        Parameters
        ----------
        data : mapping
            ``name``, ``kind``, ``bound``, ``source``; if wanted ``unit`` (the metric's by
            default) and ``sense`` ("at most" by default); and the parameters of the metric.

        Raises
        ------
        ParameterError
            If a key is missing or unknown, or a value impossible.
        """
        for key in ("name", "kind", "bound", "source"):
            if key not in data:
                given = ", ".join(str(k) for k in data) or "nothing"
                hint = nearest(key, (str(k) for k in data))
                raise ParameterError(
                    f"{key} is missing in a requirement that gives {given}{hint}: give it"
                )
        metric = metric_from_dict({k: v for k, v in data.items() if k not in _OWN_KEYS})
        return cls(
            data["name"],
            metric,
            data["bound"],
            data.get("unit", metric.unit),
            data["source"],
            data.get("sense", "at most"),
        )

    def __str__(self) -> str:
        """Return name, sense and bound."""
        return str(self.stated)


@dataclass(frozen=True, repr=False)
class Verdict:
    """What was found for a requirement; true if it is met.

    Attributes
    ----------
    requirement : ClosedLoopRequirement
        The requirement.
    value : float
        What was found, in its unit; NaN, which meets nothing, if the run has no data for it.
    time : float
        When it was worst, s since the start of the profile; NaN if that is no one time.
    event : int or None
        The event then: its place, from 0, in the arrays of the run.
    note : str
        Remark.
    plot : Path or None
        Picture that was saved of it.
    cylinder : int or None
        Cylinder of the event, from 1, if it is about one.
    """

    requirement: ClosedLoopRequirement
    value: float
    time: float = math.nan
    event: int | None = None
    note: str = ""
    plot: Path | None = field(default=None, compare=False)
    cylinder: int | None = None

    @property
    def result(self) -> RequirementResult:
        """The verdict as that of any other requirement."""
        return RequirementResult(self.requirement.stated, self.value, self.note)

    @property
    def met(self) -> bool:
        """Whether the value is on the allowed side of the bound, or on it."""
        return self.result.met

    @property
    def margin(self) -> float:
        """Distance to the bound, in its unit; negative if not met, NaN without a value."""
        return self.result.margin

    def to_dict(self) -> dict[str, Any]:
        """Return requirement, figures and verdict as plain data."""
        return {
            "requirement": self.requirement.to_dict(),
            "value": self.value,
            "unit": self.requirement.unit,
            "met": self.met,
            "margin": self.margin,
            "time": self.time,
            "event": self.event,
            "cylinder": self.cylinder,
            "note": self.note,
            "plot": None if self.plot is None else str(self.plot),
        }

    def __bool__(self) -> bool:
        """Whether it is met."""
        return self.met

    def __str__(self) -> str:
        """Return number, instant, bound and picture in one line."""
        which = self.requirement
        unit = "" if which.unit == "1" else f" {which.unit}"
        text = f"{which.name}: {_number(self.value, which.bound)}"
        text += "" if math.isnan(self.value) else unit
        if self.event is not None:
            text += f" at {self.time:.2f} s (event {self.event}"
            text += f", cylinder {self.cylinder})" if self.cylinder is not None else ")"
        if self.note:
            text += f" [{self.note}]"
        bound = f"{which.sense} {which.bound:g}{unit}"
        text += f", met ({bound})" if self.met else f", but must be {bound}"
        return f"{text}; picture: {self.plot}" if self.plot is not None else text

    __repr__ = __str__  # a failing assert shows it


def _number(value: float, bound: float) -> str:
    """A number in three digits, or as many as tell it from the bound."""
    if math.isnan(value):
        return "none"
    for digits in range(3, 17):
        if value == bound or float(f"{value:.{digits}g}") != bound:
            break
    return f"{value:.{digits}g}"
