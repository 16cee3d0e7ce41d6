"""What a run asks of the engine: demand, speed, throttle and ambient over time or cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

import numpy as np

from plant import ParameterError
from plant._checks import in_range, one_of, whole
from plant.kinematics import FloatArray

from ._profile_signal import ROUNDING, Between, Signal
from ._scenario_tables import Table

if TYPE_CHECKING:
    from .conditions import Conditions

__all__ = ["Between", "Deactivation", "OperatingProfile", "ProfileEvents", "Signal"]

Axis = Literal["time", "cycles"]

MOST_EVENTS = 1_000_000  # of a run: beyond, a length is mistaken
QUANTITIES = {  # lowest and highest value and the unit of each
    "demand_mg": (0.0, 10_000.0, "mg"),
    "speed_rpm": (50.0, 20_000.0, "rpm"),
    "throttle_deg": (0.1, 90.0, "deg"),
    "ambient_pressure": (1e4, 1e6, "Pa"),
    "temperature": (150.0, 600.0, "K"),
    "exhaust_pressure": (1e4, 1e6, "Pa"),
    "flow_factor": (0.01, 10.0, "1"),
}
CONDITIONS = ("ambient_pressure", "temperature", "exhaust_pressure", "flow_factor")
_NEEDED = ("demand_mg", "speed_rpm")


class Deactivation(NamedTuple):
    """A cylinder whose valve stays shut from one position of the axis up to another."""

    cylinder: int  # from 1
    start: float  # s or cycles
    end: float  # s or cycles, excluded


class ProfileEvents(NamedTuple):
    """A profile at each of its `m` intake events."""

    time: FloatArray  # (m,) s, IVO of each event; 0 is the start, below it lies the warm-up
    demand: FloatArray  # (m,) kg, 0 where the valve stays shut
    speed_rpm: FloatArray  # (m,)
    throttle_deg: FloatArray | None  # (m,), None for wide open
    conditions: Conditions | None  # arrays (m,), None where the engine's own hold


@dataclass(frozen=True)
class OperatingProfile:
    """Quantities over time or engine cycles; numbers stand for what does not change.

    Attributes
    ----------
    demand_mg : Signal
        Demanded charge, mg per event; 0 keeps the valve shut.
    speed_rpm : Signal
        Engine speed.
    throttle_deg : Signal, optional
        Throttle angle; wide open if not given.
    ambient_pressure, exhaust_pressure : Signal, optional
        Pressures, Pa; the true engine's if not given.
    temperature : Signal, optional
        Temperature of the air, K; the true engine's if not given.
    flow_factor : Signal, optional
        What multiplies the true flow coefficient, 1: ageing.
    deactivated : tuple of Deactivation
        Cylinders that are shut off for some while.
    length : float
        Length of the run, s or cycles; up to the last point of the signals if 0.
    axis : {"time", "cycles"}
        What positions are: s, or engine cycles of two turns.

    Raises
    ------
    ParameterError
        If a value is out of range, or the length cannot be told.
    """

    demand_mg: Signal
    speed_rpm: Signal
    throttle_deg: Signal | None = None
    ambient_pressure: Signal | None = None
    temperature: Signal | None = None
    exhaust_pressure: Signal | None = None
    flow_factor: Signal | None = None
    deactivated: tuple[Deactivation, ...] = ()
    length: float = 0.0
    axis: Axis = "time"

    def __post_init__(self) -> None:
        one_of("axis", self.axis, ("time", "cycles"))
        given: list[Signal] = []
        for name, (low, high, unit) in QUANTITIES.items():
            signal = getattr(self, name)
            if signal is None and name not in _NEEDED:
                continue
            if not isinstance(signal, Signal):
                in_range(name, signal, low, high, unit)
                signal = Signal.constant(float(signal))
                object.__setattr__(self, name, signal)
            for value in (min(signal.values), max(signal.values)):
                in_range(name, value, low, high, unit)
            given.append(signal)
        unit = "s" if self.axis == "time" else "cycles"
        length = in_range("length", self.length, 0.0, 1e6, unit)
        if not length:
            length = max(signal.last for signal in given)
        if length <= 0.0:
            raise ParameterError(
                f"length is 0 {unit}, but no signal has a point after the start: give the length "
                f"of the run in {unit}"
            )
        object.__setattr__(self, "length", length)
        spans = []
        for cylinder, start, end in self.deactivated:
            whole("cylinder", cylinder, 1, 24)
            in_range("start", start, 0.0, 1e6, unit)
            in_range("end", end, start, 1e6, unit, open_low=True)
            spans.append(Deactivation(cylinder, float(start), float(end)))
        object.__setattr__(self, "deactivated", tuple(spans))

    def events(self, n_cylinders: int, *, warm_up_cycles: int = 0) -> ProfileEvents:
        """Return the quantities at each event.

        Parameters
        ----------
        n_cylinders : int
            Number of cylinders; one event each 720 deg over it.
        warm_up_cycles : int
            Engine cycles at what holds at the start, before it.

        Raises
        ------
        ParameterError
            If a cylinder that is shut off does not exist, or there are too many events.
        """
        whole("n_cylinders", n_cylinders, 1, 24)
        whole("warm_up_cycles", warm_up_cycles, 0, 100_000)
        for span in self.deactivated:
            whole("cylinder that is deactivated", span.cylinder, 1, n_cylinders)
        time, position = self._instants(n_cylinders)
        before = warm_up_cycles * n_cylinders
        first = 120.0 / (n_cylinders * float(self.speed_rpm.at(0.0)))
        time = np.concatenate((first * np.arange(-before, 0.0), time))
        position = np.concatenate((np.zeros(before), position))
        demand = self.demand_mg.at(position) * 1e-6
        cylinder = np.arange(position.size) % n_cylinders + 1
        for span in self.deactivated:
            off = (position >= span.start - ROUNDING) & (position < span.end - ROUNDING)
            demand[off & (cylinder == span.cylinder)] = 0.0
        throttle = None if self.throttle_deg is None else self.throttle_deg.at(position)
        return ProfileEvents(
            time, demand, self.speed_rpm.at(position), throttle, self._conditions(position)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; table files are written out as points."""
        data: dict[str, Any] = {"axis": self.axis, "length": self.length}
        for name in QUANTITIES:
            signal = getattr(self, name)
            if signal is not None:
                data[name] = signal.to_dict()
        if self.deactivated:
            data["deactivated"] = [span._asdict() for span in self.deactivated]
        return data

    @classmethod
    def from_dict(cls, data: Any, folder: Path | None = None) -> Self:
        """Return the profile of plain data, as `to_dict` gives and a scenario file holds it.

        Parameters
        ----------
        data : mapping
            Keys are the fields.
        folder : Path, optional
            Where table files lie; without, none may be named.

        Raises
        ------
        ScenarioError
            If a key is unknown or missing, or a value impossible.
        """
        table = data if isinstance(data, Table) else Table(data, ("profile",))
        table.only("axis", "length", "deactivated", *QUANTITIES)
        with table.at("axis"):
            axis = one_of("axis", table.data.get("axis", "time"), ("time", "cycles"))
        unit = "s" if axis == "time" else "cycles"
        signals: dict[str, Any] = {}
        for name, (_, _, of_name) in QUANTITIES.items():
            if name in _NEEDED:
                table.needed(name, f"a number in {of_name}, or a signal")
            if name in table:
                with table.at(name):
                    signals[name] = Signal.from_dict(
                        table.data[name], folder, unit=of_name, axis=unit
                    )
        length = table.number("length", 0.0, unit)
        with table.at():
            profile = cls(**signals, length=length, axis="time" if axis == "time" else "cycles")
        spans = []
        for item in table.tables("deactivated"):
            item.only("cylinder", "start", "end")
            item.needed("cylinder", "the number of the cylinder, from 1")
            spans.append(
                Deactivation(
                    item.whole("cylinder", 1, 1, 24),
                    item.number("start", 0.0, unit),
                    item.number("end", profile.length, unit),
                )
            )
        with table.at("deactivated"):
            return replace(profile, deactivated=tuple(spans))

    def _instants(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Time in s and position on the axis of each event."""
        if self.axis == "cycles":
            size = math.ceil(self.length * n - ROUNDING)
            _not_too_many(size)
            position = np.arange(size) / n
            gaps = 120.0 / (n * self.speed_rpm.at(position))
            return np.concatenate(([0.0], np.cumsum(gaps[:-1]))), position
        _not_too_many(int(self.length * n * min(self.speed_rpm.values) / 120.0))  # at the least
        times, at = [], 0.0
        while at < self.length - ROUNDING:
            times.append(at)
            _not_too_many(len(times))
            at += 120.0 / (n * float(self.speed_rpm.at(at)))
        return np.array(times), np.array(times)

    def _conditions(self, position: FloatArray) -> Conditions | None:
        """True boundary conditions at each event."""
        given = {name: getattr(self, name) for name in CONDITIONS}
        if all(signal is None for signal in given.values()):
            return None
        from .conditions import Conditions

        return Conditions(**{k: None if s is None else s.at(position) for k, s in given.items()})


def _not_too_many(events: int) -> None:
    if events > MOST_EVENTS:
        raise ParameterError(
            f"the profile has more than {MOST_EVENTS} events: shorten length, or lower the speed"
        )
