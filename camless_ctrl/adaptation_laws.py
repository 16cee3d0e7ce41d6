"""What all adaptation laws share: their state, their step, the projection set, the screening.

A law learns the parameters of each cylinder (`CylinderParameters`) from what each event says of
its cylinder (`ChargeEvidence`). The laws are this project's own design: those of Part II are not
public. A law is a pure function of state and evidence, so that a run can be replayed.

Assumption on the evidence: with ``d`` the offset that was used and ``w`` the share of jitter in
the spread of a measured duration, the charge is predicted at the duration

    commanded + d + w (measured - commanded - d),

the least-variance estimate of what the valve did. So jitter is out of the charge error as far
as it can be, and what is left in it is uncorrelated with the error of the measured duration.
Without a measurement the charge is predicted at ``commanded + d``.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from plant._checks import in_range, replace_fields, whole
from plant.errors import ParameterError

from .adaptation import GainSchedule
from .cylinder_parameters import FIELDS, CylinderParameters, ParameterSet
from .event_data import ChargeEvidence

# Evidence beyond these is no evidence of an engine: the estimate or the record is broken.
MOST_LOG_RATIO = 1.0  # of the charge error, 1
MOST_VARIANCE = 1.0  # of the charge error, 1
MOST_DURATION_ERROR = 2e-3  # s
MOST_FLOW_SLOPE = 10.0  # 1
MOST_DURATION_SLOPE = 1e4  # 1/s
MOST_SPEED_RPM = 20_000.0
MOST_USED = 10.0  # of a gain or factor that was used; one over it at least


@dataclass(frozen=True, slots=True)
class ParameterBounds:
    """Set onto which the parameters of every cylinder are projected.

    Parameters
    ----------
    flow_gain, charge_factor : (float, float)
        Bounds around 1.
    duration_offset : (float, float)
        Bounds around 0, s.
    """

    flow_gain: tuple[float, float] = (0.5, 1.6)  # 1
    duration_offset: tuple[float, float] = (-0.5e-3, 0.5e-3)  # s
    charge_factor: tuple[float, float] = (0.6, 1.4)  # 1
    # As the laws need them: of the logarithms of gain and factor, and of the offset.
    log_flow_gain: tuple[float, float] = field(init=False, repr=False, compare=False)
    log_charge_factor: tuple[float, float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("flow_gain", "charge_factor"):
            low, high = getattr(self, name)
            in_range(f"{name}[0]", low, 1.0 / MOST_USED, 1.0, "1", open_low=True)
            in_range(f"{name}[1]", high, 1.0, MOST_USED, "1", open_high=True)
            object.__setattr__(self, f"log_{name}", _log_bounds(float(low), float(high)))
        low, high = self.duration_offset
        in_range("duration_offset[0]", low, -MOST_DURATION_ERROR, 0.0, "s")
        in_range("duration_offset[1]", high, 0.0, MOST_DURATION_ERROR, "s")

    def replace(self, **changes: object) -> ParameterBounds:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def contain(self, parameters: ParameterSet) -> bool:
        """Whether all parameters lie within the bounds."""
        return all(
            bool(np.all((low <= values) & (values <= high)))
            for (low, high), values in (
                (getattr(self, name), getattr(parameters, name)) for name in FIELDS
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class AdaptationState:
    """What a law has learnt; immutable.

    Attributes
    ----------
    log_flow_gain, log_charge_factor : tuple of float
        Logarithms of gain and factor of each cylinder, 1.
    duration_offset : tuple of float
        Offset of each cylinder, s.
    memory : object
        What else the law remembers, immutable; None for a law without memory.
    """

    log_flow_gain: tuple[float, ...]
    duration_offset: tuple[float, ...]
    log_charge_factor: tuple[float, ...]
    memory: Any = field(default=None, repr=False)

    @property
    def n_cylinders(self) -> int:
        """Number of cylinders."""
        return len(self.log_flow_gain)

    def of(self, cylinder: int) -> CylinderParameters:
        """Parameters of a cylinder (from 1)."""
        i = cylinder - 1
        return CylinderParameters(
            math.exp(self.log_flow_gain[i]),
            self.duration_offset[i],
            math.exp(self.log_charge_factor[i]),
        )

    @property
    def parameters(self) -> ParameterSet:
        """Parameters of all cylinders."""
        return ParameterSet(
            np.array([math.exp(value) for value in self.log_flow_gain]),
            np.array(self.duration_offset),
            np.array([math.exp(value) for value in self.log_charge_factor]),
        )


class AdaptationStep(NamedTuple):
    """Outcome of one update."""

    state: AdaptationState
    error: float  # charge error used, after dead zone or innovation; NaN without evidence of it
    projected: bool = False  # whether a parameter was held at its bound
    moved: bool = False  # whether a parameter changed
    determined: bool = False  # whether the evidence determines what the law adapts
    reset: bool = False  # whether a persistent error has renewed the law's doubt


class AdaptationLaw(Protocol):
    """What a controller asks of an adaptation law."""

    @property
    def bounds(self) -> ParameterBounds:
        """Set onto which the law projects."""
        ...

    def start(self, n_cylinders: int, parameters: ParameterSet | None = None) -> AdaptationState:
        """Return the state before any evidence, from given or nominal parameters."""
        ...

    def update(self, state: AdaptationState, evidence: ChargeEvidence) -> AdaptationStep:
        """Return the state after one event; never raises, whatever the numbers are."""
        ...

    def to_dict(self, state: AdaptationState) -> dict[str, Any]:
        """Return a state as plain lists and numbers, for JSON."""
        ...

    def from_dict(self, data: Mapping[str, Any]) -> AdaptationState:
        """Return the state of `to_dict`."""
        ...


def initial_state(
    bounds: ParameterBounds, n_cylinders: int, parameters: ParameterSet | None
) -> AdaptationState:
    """Return a state without memory from given or nominal parameters.

    Raises
    ------
    ParameterError
        If the parameters are of another number of cylinders or outside the bounds.
    """
    n = whole("n_cylinders", n_cylinders, 1, 24)
    given = ParameterSet.nominal(n) if parameters is None else parameters
    if given.n_cylinders != n:
        raise ParameterError(
            f"the parameters are of {given.n_cylinders} cylinders, but the engine has {n}: start "
            "from ParameterSet.nominal"
        )
    if not bounds.contain(given):
        outside = next(
            name
            for name in FIELDS
            if np.any(getattr(given, name) < getattr(bounds, name)[0])
            or np.any(getattr(given, name) > getattr(bounds, name)[1])
        )
        raise ParameterError(
            f"{outside} is {getattr(given, outside).tolist()}, but must be in "
            f"{getattr(bounds, outside)}: widen the ParameterBounds, or start from nominal"
        )
    return AdaptationState(
        tuple(map(clipper(*bounds.log_flow_gain), np.log(given.flow_gain).tolist())),
        tuple(given.duration_offset.tolist()),
        tuple(map(clipper(*bounds.log_charge_factor), np.log(given.charge_factor).tolist())),
    )


def screened(evidence: ChargeEvidence, n_cylinders: int) -> tuple[float, float]:
    """Charge error and duration error (s) that can be used; NaN for what cannot.

    Values that are not finite are not used, nor are those beyond the limits of this module.
    """
    cylinder, charge, variance, duration, flow, slope, used, speed = evidence
    gain, offset, factor = used
    # A comparison with NaN is false, so that each check refuses it too.
    if not (
        1 <= cylinder <= n_cylinders
        and 0.0 < speed <= MOST_SPEED_RPM
        and 0.1 <= gain <= MOST_USED
        and 0.1 <= factor <= MOST_USED
        and -MOST_DURATION_ERROR <= offset <= MOST_DURATION_ERROR
    ):
        return math.nan, math.nan
    if not (
        -MOST_LOG_RATIO <= charge <= MOST_LOG_RATIO
        and 0.0 < variance <= MOST_VARIANCE
        and -MOST_FLOW_SLOPE <= flow <= MOST_FLOW_SLOPE
        and -MOST_DURATION_SLOPE <= slope <= MOST_DURATION_SLOPE
    ):
        charge = math.nan
    if not -MOST_DURATION_ERROR <= duration <= MOST_DURATION_ERROR:
        duration = math.nan
    return float(charge), float(duration)


def beyond(error: float, dead_zone: float) -> float:
    """What of an error lies beyond the dead zone."""
    if error > dead_zone:
        return error - dead_zone
    return error + dead_zone if error < -dead_zone else 0.0


def clipper(low: float, high: float) -> Callable[[float], float]:
    """Return the function that projects a number onto an interval."""

    def clip(value: float) -> float:
        return low if value < low else high if value > high else value

    return clip


def moved_and_clipped(
    values: tuple[float, ...],
    i: int,
    own: float,
    shared: float,
    limits: tuple[float, float],
) -> tuple[tuple[float, ...], bool]:
    """Return values of which all move by `shared` and number `i` by `own` more, projected.

    The second result tells whether a bound has held one.
    """
    low, high = limits
    moved = [value + shared for value in values]
    moved[i] += own
    if min(moved) < low or max(moved) > high:
        return tuple([low if v < low else high if v > high else v for v in moved]), True
    return tuple(moved), False


class ScheduledGains:
    """Gains of a `GainSchedule` as plain numbers: what `GainSchedule.at` gives, faster."""

    __slots__ = ("_imbalance", "_mean", "_speed")

    def __init__(self, schedule: GainSchedule) -> None:
        self._speed = schedule.speed_rpm
        self._mean = schedule.mean
        self._imbalance = schedule.imbalance

    def __call__(self, speed_rpm: float) -> tuple[float, float]:
        """Gains per cycle of mean and imbalance at a speed."""
        k = bisect_right(self._speed, speed_rpm)
        if k == 0 or k == len(self._speed):
            at = 0 if k == 0 else -1
            return self._mean[at], self._imbalance[at]
        low, high = self._speed[k - 1], self._speed[k]
        t = (speed_rpm - low) / (high - low)
        m, i = self._mean, self._imbalance
        return m[k - 1] + t * (m[k] - m[k - 1]), i[k - 1] + t * (i[k] - i[k - 1])


def state_to_dict(law: str, state: AdaptationState, **memory: Any) -> dict[str, Any]:
    """Return a state as plain lists and numbers, marked with the name of its law."""
    return {
        "law": law,
        "log_flow_gain": list(state.log_flow_gain),
        "duration_offset": list(state.duration_offset),
        "log_charge_factor": list(state.log_charge_factor),
        **memory,
    }


def state_from_dict(
    law: str, bounds: ParameterBounds, data: Mapping[str, Any], *memory: str
) -> AdaptationState:
    """Return the state of `state_to_dict`, without its memory, whose names must be there.

    Raises
    ------
    ParameterError
        If the data are of another law, incomplete, not finite or outside the bounds.
    """
    names = ("log_flow_gain", "duration_offset", "log_charge_factor")
    missing = [name for name in ("law", *names, *memory) if name not in data]
    if missing:
        raise ParameterError(f"the state lacks {', '.join(missing)}: export it with to_dict")
    if data["law"] != law:
        raise ParameterError(
            f"the state is one of {data['law']!r}, but this law is {law!r}: start it with the "
            "parameters of that state"
        )
    values = [tuple(float(value) for value in data[name]) for name in names]
    n = whole("the number of cylinders", len(values[0]), 1, 24)
    limits = (bounds.log_flow_gain, bounds.duration_offset, bounds.log_charge_factor)
    for name, numbers, (low, high) in zip(names, values, limits, strict=True):
        if len(numbers) != n or not all(low <= value <= high for value in numbers):
            raise ParameterError(
                f"{name} is {list(numbers)}, but must be {n} numbers in [{low:g}, {high:g}]: "
                "export the state with a law of the same bounds"
            )
    return AdaptationState(values[0], values[1], values[2])


def _log_bounds(low: float, high: float) -> tuple[float, float]:
    """Logarithms whose exponentials lie within the bounds, rounding included."""
    a, b = math.log(low), math.log(high)
    while math.exp(a) < low:
        a = math.nextafter(a, math.inf)
    while math.exp(b) > high:
        b = math.nextafter(b, -math.inf)
    return a, b
