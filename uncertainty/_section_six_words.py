"""What section 6 says and what simulation says to it: statements with bounds, and captions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from plant.kinematics import FloatArray

BoundKind = Literal["at most", "at least"]


@dataclass(frozen=True, slots=True)
class SectionSixClaim:
    """A statement of section 6, the number that decides it, and the bound.

    Attributes
    ----------
    id : str
        Short name.
    text : str
        The statement, in the paper's words where it stands in quotation marks.
    measured : str
        What `value` is.
    value : float
        The number, 1; NaN where nothing of it can be driven.
    bound : float
        What it is held against, 1. Part I gives none.
    kind : {"at most", "at least"}
        Which side of the bound confirms the statement.
    basis : str
        Why this bound.
    """

    id: str
    text: str
    measured: str
    value: float
    bound: float
    kind: BoundKind
    basis: str

    @property
    def holds(self) -> bool | None:
        """Whether the statement is confirmed; None where nothing can be compared."""
        if math.isnan(self.value):
            return None
        return self.value <= self.bound if self.kind == "at most" else self.value >= self.bound

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        return {True: "confirmed", False: "not confirmed", None: "not judged"}[self.holds]

    def __str__(self) -> str:
        """Return statement, number, bound and verdict."""
        return (
            f"{self.text}: {self.verdict} ({self.measured}: {100.0 * self.value:.2f} %, bound "
            f"{self.kind} {100.0 * self.bound:g} %, {self.basis})"
        )


@dataclass(frozen=True, slots=True)
class Value:
    """A number with its unit, printed together."""

    value: float
    unit: str

    def __format__(self, spec: str) -> str:
        """Return the number in the format `spec`, and the unit."""
        return f"{self.value:{spec}} {self.unit}"


@dataclass(frozen=True)
class Caption:
    """Sentences with places for numbers, and the numbers.

    Attributes
    ----------
    template : str
        Sentences with places such as ``{loss:.1f}``.
    values : mapping of str to Value
        What the places stand for.
    """

    template: str
    values: Mapping[str, Value]

    def prefixed(self, prefix: str) -> Caption:
        """Return the caption with `prefix` before every name, to stand beside others."""
        return Caption(
            re.sub(r"\{(\w+)", rf"{{{prefix}\1", self.template),
            {prefix + name: value for name, value in self.values.items()},
        )

    def __str__(self) -> str:
        """Return the sentences with the numbers in place."""
        return self.template.format(**self.values)


def verdicts(claims: tuple[SectionSixClaim, ...]) -> str:
    """Return which statements are confirmed and which are not, in sentences."""
    sentences = []
    for verdict in ("confirmed", "not confirmed", "not judged"):
        texts = [claim.text for claim in claims if claim.verdict == verdict]
        if texts:
            sentences.append(f"{verdict.capitalize()}: {'; '.join(texts)}.")
    return " ".join(sentences)


def per_cent(**fractions: float) -> dict[str, Value]:
    """Return fractions as values in per cent."""
    return {name: Value(100.0 * float(value), "%") for name, value in fractions.items()}


def extreme(of: Callable[[FloatArray], Any], values: FloatArray) -> float:
    """Return `of` of the finite values; NaN if there is none."""
    finite = values[np.isfinite(values)]
    return float(of(finite)) if finite.size else float("nan")
