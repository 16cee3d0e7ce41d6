"""Kinds of faults that a closed-loop run can be given: what fails, how, and by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

TARGETS = ("maf", "map", "duration", "valve", "speed", "computation")
SPIKE_EVENTS = 7  # one event in so many has a spike: each cylinder in turn
SAME_TIME = (
    1e-9  # s, a start or end nearer than this to an event is at it: rounding decides nothing
)


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One kind of fault.

    Attributes
    ----------
    name : str
        By which a fault asks for it.
    target : str
        What fails: ``"maf"``, ``"map"``, ``"duration"``, ``"valve"``, ``"speed"`` or
        ``"computation"``.
    unit : str
        Of its size; empty if it has none.
    low, high : float
        Smallest and largest size; NaN if it has none.
    default : float
        Size of a fault that gives none; NaN if it has none, or need not have one.
    by_cylinder : bool
        Whether it may be that of one cylinder.
    description : str
        What happens.
    """

    name: str
    target: str
    unit: str
    low: float
    high: float
    default: float
    by_cylinder: bool
    description: str

    @property
    def sized(self) -> bool:
        """Whether it has a size."""
        return not math.isnan(self.low)


def _sized(
    name: str,
    size: tuple[float, float, float],  # smallest, largest, default
    unit: str,
    description: str,
    *,
    by_cylinder: bool = False,
) -> FaultKind:
    target, _ = name.split("-")
    return FaultKind(name, target, unit, *size, by_cylinder, description)


def _plain(
    name: str, description: str, *, target: str = "", by_cylinder: bool = False
) -> FaultKind:
    nan, target = math.nan, target or name.split("-")[0]
    return FaultKind(name, target, "", nan, nan, nan, by_cylinder, description)


_KINDS = (
    _sized("maf-stuck", (-1.0, 1.0, math.nan), "kg/s",
           "every reading is the last one before the start, or the size if one is given"),
    _plain("maf-dropout", "no samples come"),
    _plain("maf-nan", "samples come at their times, but are not numbers"),
    _sized("maf-offset", (-0.1, 0.1, 8e-3), "kg/s", "is added to the readings"),
    _sized("maf-drift", (-1.0, 1.0, 2e-3), "kg/s per s",
           "rate of an offset that grows from zero at the start"),
    _sized("maf-noise", (1.0, 100.0, 2.0), "1",
           "standard deviation of the noise is this many times the sensor's own"),
    _sized("maf-slow", (1e-4, 10.0, 0.06), "s",
           "time constant of a further first-order lag before noise and converter"),
    _sized("map-offset", (-1e5, 1e5, 5e3), "Pa", "is added to the readings"),
    _sized("map-stuck", (0.0, 1e6, math.nan), "Pa",
           "every reading is the last one before the start, or the size if one is given"),
    _plain("map-nan", "samples come at their times, but are not numbers"),
    _plain("duration-missing", "no duration is told", by_cylinder=True),
    _sized("duration-bias", (-0.02, 0.02, 0.5e-3), "s", "is added to the durations told",
           by_cylinder=True),
    _plain("valve-stuck", "the valve stays shut whatever is commanded", by_cylinder=True),
    _sized("valve-lift", (0.0, 1.0, 0.4), "1",
           "delivered over commanded lift; too low a lift for any motion leaves the valve shut",
           by_cylinder=True),
    _sized("valve-late", (0.0, 0.01, 1.5e-3), "s", "the valve shuts later by this",
           by_cylinder=True),
    _sized("valve-jitter", (0.0, 5e-3, 0.5e-3), "s",
           "standard deviation of a random part that is added to the delivered durations",
           by_cylinder=True),
    _sized("speed-spike", (-20_000.0, 20_000.0, 2000.0), "rpm",
           f"is added to the speed told, at the first event and each {SPIKE_EVENTS}th after it"),
    _plain("missed-computation", "the controller is not called; the valve repeats its last command",
           target="computation"),
)  # fmt: skip

FAULT_KINDS: Mapping[str, FaultKind] = MappingProxyType({kind.name: kind for kind in _KINDS})
