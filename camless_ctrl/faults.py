"""Faults of sensors, valves, speed signal and computation, to be met in a closed-loop run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from plant import ParameterError
from plant._checks import in_range, one_of, replace_fields, whole

from .fault_kinds import FAULT_KINDS, SAME_TIME, FaultKind

__all__ = ["FAULT_KINDS", "Fault", "FaultKind"]


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """One fault: what it is, when, how large, and of which cylinder.

    Attributes
    ----------
    kind : str
        A key of `FAULT_KINDS`, which tells what the size means.
    start, end : float
        Time since the first event of the run from which and until which it acts, s.
    size : float
        In the unit of the kind; the kind's default if it is NaN. It stays NaN for a kind that
        has no size, and for a sensor that is stuck at its last reading.
    cylinder : int, optional
        Cylinder (from 1) of a fault of one valve; None for all.

    Raises
    ------
    ParameterError
        If the kind is unknown, or another value is not one of those that the kind allows.
    """

    kind: str
    start: float
    end: float = math.inf
    size: float = math.nan
    cylinder: int | None = None

    def __post_init__(self) -> None:
        one_of("kind", self.kind, FAULT_KINDS)
        kind = self.of_kind
        start = in_range("start", self.start, 0.0, 1e9, "s")
        end = self.end
        if end != math.inf:
            end = in_range(
                "end",
                end,
                start,
                math.inf,
                "s",
                open_low=True,
                remedy="a fault ends after its start; leave end out for one that lasts",
            )
        size = self.size
        if not (isinstance(size, float) and math.isnan(size)):
            if not kind.sized:
                raise ParameterError(
                    f"size is {size!r}, but a fault {self.kind!r} has none: leave it out"
                )
            size = in_range("size", size, kind.low, kind.high, kind.unit)
        elif kind.sized:
            size = kind.default
        cylinder = self.cylinder
        if cylinder is not None:
            if not kind.by_cylinder:
                raise ParameterError(
                    f"cylinder is {cylinder!r}, but a fault {self.kind!r} is not one of a "
                    "cylinder: leave it out"
                )
            cylinder = whole("cylinder", cylinder, 1, 24)
        for name, value in (("start", start), ("end", end), ("size", size), ("cylinder", cylinder)):
            object.__setattr__(self, name, value)

    @property
    def of_kind(self) -> FaultKind:
        """What is known of its kind."""
        return FAULT_KINDS[self.kind]

    def active(self, time: float) -> bool:
        """Whether it acts at a time in s since the first event of the run."""
        return self.start <= time + SAME_TIME < self.end

    def hits(self, cylinder: int, time: float) -> bool:
        """Whether it acts on a cylinder (from 1) at a time in s."""
        return self.cylinder in (None, cylinder) and self.active(time)

    def replace(self, **changes: Any) -> Self:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def to_dict(self) -> dict[str, Any]:
        """Return the fault as plain data, what is not given left out."""
        data: dict[str, Any] = {"kind": self.kind, "start": self.start}
        if self.end != math.inf:
            data["end"] = self.end
        if not math.isnan(self.size):
            data["size"] = self.size
        if self.cylinder is not None:
            data["cylinder"] = self.cylinder
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the fault of `to_dict`.

        Raises
        ------
        ParameterError
            If a key is unknown or missing, or a value impossible.
        """
        for key in data:
            one_of("key of a fault", key, cls.__match_args__)
        missing = [key for key in ("kind", "start") if key not in data]
        if missing:
            raise ParameterError(f"the fault lacks {' and '.join(missing)}: give it a value")
        return cls(**data)

    def __eq__(self, other: object) -> bool:
        """Whether both say the same; two sizes that are not given are equal."""
        return isinstance(other, Fault) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        """Hash that goes with the equality."""
        return hash(tuple(self.to_dict().items()))

    def __str__(self) -> str:
        """Return kind, size, cylinder and times in one line."""
        text = self.kind
        if not math.isnan(self.size):
            unit = self.of_kind.unit
            text += f" {self.size:g}" + (f" {unit}" if unit != "1" else "")
        if self.cylinder is not None:
            text += f" of cylinder {self.cylinder}"
        until = "" if math.isinf(self.end) else f" to {self.end:g} s"
        return f"{text} from {self.start:g}{until or ' s'}"
