"""A requirement as it is stated, and what was found for it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from plant._checks import in_range, one_of
from plant.errors import ParameterError

__all__ = ["PAPER", "PROJECT", "Requirement", "RequirementResult", "Sense"]

Sense = Literal["at most", "at least"]


@dataclass(frozen=True, slots=True)
class Requirement:
    """A bound on one figure.

    Parameters
    ----------
    name : str
        Short name, unique.
    bound : float
        The bound, in `unit`.
    unit : str
        Unit of bound and value.
    sense : {"at most", "at least"}
        Which side of the bound is allowed.
    source : str
        Who asks for it.
    description : str
        What is measured, and how.
    """

    name: str
    bound: float
    unit: str
    sense: Sense
    source: str
    description: str

    def __post_init__(self) -> None:
        if not self.name or not self.description or not self.source:
            raise ParameterError(
                f"requirement {self.name!r} lacks a name, source or description: give all three"
            )
        in_range("bound", self.bound, -1e12, 1e12, self.unit)
        one_of("sense", self.sense, ("at most", "at least"))

    def __str__(self) -> str:
        """Return name, sense and bound."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {self.sense} {self.bound:g}{unit}"


@dataclass(frozen=True, slots=True)
class RequirementResult:
    """A requirement and the figure that was found; NaN is never enough.

    Attributes
    ----------
    requirement : Requirement
        The requirement.
    value : float
        What was found, in its unit.
    note : str
        Remark for the table.
    """

    requirement: Requirement
    value: float
    note: str = ""

    @property
    def margin(self) -> float:
        """Distance to the bound, in its unit; negative if not met."""
        sign = 1.0 if self.requirement.sense == "at least" else -1.0
        return sign * (self.value - self.requirement.bound)

    @property
    def met(self) -> bool:
        """Whether the value is on the allowed side of the bound, or on it."""
        return bool(self.margin >= 0.0)

    def __str__(self) -> str:
        """Return requirement, value and verdict in one line."""
        unit = "" if self.requirement.unit == "1" else f" {self.requirement.unit}"
        value = "none" if math.isnan(self.value) else f"{self.value:.4g}{unit}"
        text = f"{self.requirement}: {value}, {'met' if self.met else 'NOT MET'}"
        return f"{text} ({self.note})" if self.note else text


PAPER = "Part I, published figures"  # sources
PROJECT = "project"
