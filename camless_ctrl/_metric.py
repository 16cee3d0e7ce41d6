"""What all metrics share: the figure that is found, and parameters as plain data."""

from __future__ import annotations

import dataclasses
import difflib
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

from plant._checks import in_range, whole
from plant.errors import ParameterError

if TYPE_CHECKING:
    from .scenario_result import ScenarioResult


class Measured(NamedTuple):
    """A figure, and where it was worst.

    Attributes
    ----------
    value : float
        The figure, in the unit of its metric; NaN if the run has no data for it.
    time : float
        Time of the worst event, s; NaN if there is none.
    event : int or None
        Its number, from 0: the place in the arrays of the run.
    cylinder : int or None
        Its cylinder, from 1; None if all have a part in it.
    note : str
        Remark; says why a figure is missing.
    """

    value: float
    time: float = math.nan
    event: int | None = None
    cylinder: int | None = None
    note: str = ""


@dataclass(frozen=True)
class Metric(ABC):
    """A figure that is read off the result of a scenario.

    Times are in seconds since the start of the scenario's profile. Without a word on it, only
    what follows that start counts, not the warm-up before it.
    """

    kind: ClassVar[str]
    unit: ClassVar[str]
    description: ClassVar[str]

    @abstractmethod
    def measure(self, result: ScenarioResult) -> Measured:
        """Return the figure of a result, and where it was worst."""

    def to_dict(self) -> dict[str, Any]:
        """Return kind and parameters as plain data; parameters at their default are left out."""
        found: dict[str, Any] = {"kind": self.kind}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value != field.default:
                found[field.name] = list(value) if isinstance(value, tuple) else value
        return found

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Make the metric from its parameters.

        Raises
        ------
        ParameterError
            For an unknown or missing parameter, or a value out of its range.
        """
        fields = {field.name: field for field in dataclasses.fields(cls)}
        given = {key: value for key, value in data.items() if key != "kind"}
        for key in given:
            if key not in fields:
                raise ParameterError(
                    f"{key} is no parameter of metric {cls.kind!r}{nearest(key, fields)}; its "
                    f"parameters are {', '.join(fields)}"
                )
        for name, field in fields.items():
            if field.default is dataclasses.MISSING and name not in given:
                raise ParameterError(
                    f"metric {cls.kind!r} lacks {name!r}: give it; its parameters are "
                    f"{', '.join(fields)}"
                )
        return cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def nearest(key: object, known: Iterable[str]) -> str:
    """Return a question that names the known key nearest to an unknown one; empty if none is."""
    near = difflib.get_close_matches(str(key), tuple(known), n=1, cutoff=0.5)
    return f" (did you mean {near[0]!r}?)" if near else ""


def check_window(from_s: float, until_s: float) -> None:
    """Check the start and the end of a stretch of time, s; the end may be infinite.

    Raises
    ------
    ParameterError
        If one is no number, or the end is not behind the start.
    """
    if from_s != -math.inf:
        in_range("from_s", from_s, -1e6, 1e6, "s")
    if until_s != math.inf:
        low = max(from_s, -1e6)
        in_range("until_s", until_s, low, 1e6, "s", open_low=True)


def check_cylinders(without_cylinders: tuple[int, ...]) -> None:
    """Check the cylinders that are left out, from 1.

    Raises
    ------
    ParameterError
        If it is not a tuple of whole numbers.
    """
    if not isinstance(without_cylinders, tuple):
        raise ParameterError(
            f"without_cylinders is {without_cylinders!r}, but must hold cylinders, as (2,)"
        )
    for cylinder in without_cylinders:
        whole("without_cylinders", cylinder, 1, 24)
