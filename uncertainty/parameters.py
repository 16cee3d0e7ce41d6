"""What is uncertain about an engine, its actuators and its sensors, and within which bounds.

A parameter acts on one or more *targets*: engine fields by their names in
`plant.engine_fields`, ``duration_offset`` (s; of every valve, or ``duration_offset[0]`` of the
first one), and the sensor fields ``maf.gain_error``, ``maf.time_constant``, ``maf.delay``,
``map.offset`` and ``map.time_constant``. A *relative* parameter multiplies what the nominal
engine has; any other replaces it (or, for an offset, is added).

No spread of this engine is published. The default bounds are assumptions, each with its
reason in ``source``; give others with `UncertaintySet.replace`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from plant import Engine, ParameterError
from plant._checks import in_range, one_of, whole
from plant.kinematics import FloatArray
from plant.parameters import _Replaceable
from plant.sensors import (
    MAF_DELAYS,
    MAF_GAIN_TOLERANCE,
    MAF_TIME_CONSTANTS,
    MAP_OFFSET_TOLERANCE,
    MafSensor,
)

DURATION_OFFSET = "duration_offset"
DURATION_OFFSET_TOLERANCE = 2e-4  # s, assumed: of the delivered duration, per valve
DURATION_JITTER = 5e-5  # s, assumed: 1 sigma of the delivered duration, event by event
FLOW_SPREAD = 0.03  # 1, assumed: flow coefficient of a cylinder against that of the engine
SENSOR_TARGETS = (
    "maf.gain_error",
    "maf.time_constant",
    "maf.delay",
    "map.offset",
    "map.time_constant",
)


@dataclass(frozen=True, slots=True)
class UncertainParameter(_Replaceable):
    """A number that lies somewhere between two bounds.

    Parameters
    ----------
    name : str
        Short name, unique in a set.
    low, high : float
        Bounds, in `unit`.
    nominal : float
        Value of the nominal plant, between the bounds.
    acts_on : tuple of str
        Targets, as named in the module.
    relative : bool
        Whether the value multiplies the nominal one of each target (its unit is then 1).
    unit : str
        Unit of the bounds.
    source : str
        Where the bounds come from.
    """

    name: str
    low: float
    high: float
    nominal: float
    acts_on: tuple[str, ...]
    relative: bool = True
    unit: str = "1"
    source: str = "assumed"

    def __post_init__(self) -> None:
        if not self.name or not self.acts_on:
            raise ParameterError(f"parameter {self.name!r} lacks a name or a target: give both")
        if isinstance(self.acts_on, str):
            raise ParameterError(
                f"acts_on of {self.name} is {self.acts_on!r}, but must be a tuple of targets: "
                f"({self.acts_on!r},)"
            )
        in_range(f"low of {self.name}", self.low, -1e12, 1e12, self.unit)
        in_range(
            f"high of {self.name}",
            self.high,
            self.low,
            1e12,
            self.unit,
            remedy="the upper bound may not lie below the lower one",
        )
        in_range(
            f"nominal of {self.name}",
            self.nominal,
            self.low,
            self.high,
            self.unit,
            remedy="the bounds must enclose the nominal value",
        )
        if self.relative and any(not _is_engine_field(target) for target in self.acts_on):
            raise ParameterError(
                f"{self.name} is relative, but acts on {', '.join(self.acts_on)}: offsets and "
                "sensor fields are given as values, relative=False"
            )

    def __str__(self) -> str:
        """Return name and bounds."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        factor = " of nominal" if self.relative else ""
        return f"{self.name} {self.low:g} to {self.high:g}{unit}{factor}"


@dataclass(frozen=True)
class UncertaintySet:
    """Uncertain parameters: a box in which the true plant lies.

    Parameters
    ----------
    parameters : tuple of UncertainParameter
        The parameters; their names differ.
    """

    parameters: tuple[UncertainParameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        names = self.names
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ParameterError(f"the set holds {', '.join(twice)} more than once: keep one each")
        given = [t for p in self.parameters if not p.relative for t in p.acts_on]
        clash = sorted({t for t in given if given.count(t) > 1 and not _is_offset(t)})
        if clash:
            raise ParameterError(
                f"more than one parameter gives a value to {', '.join(clash)}: keep one, or make "
                "the others relative"
            )

    # -- what is assumed of the paper's engine -------------------------------------------------

    @classmethod
    def runner(cls) -> Self:
        """Return the runner: frequency and damping (Eq. 7), ``k_r``, ``A_r`` and ``V_r``."""
        why = "assumed: spread of identified resonators; damping is hard to identify"
        return cls(
            (
                _factor(
                    "runner frequency",
                    0.95,
                    1.05,
                    "helmholtz.low_speed_frequency_hz",
                    "helmholtz.high_speed_frequency_hz",
                    source=why,
                ),
                _factor(
                    "runner damping",
                    0.5,
                    2.0,
                    "helmholtz.low_speed_damping",
                    "helmholtz.high_speed_damping",
                    source=why,
                ),
                _factor("runner constant", 0.9, 1.1, "runner_constant", source=why),
                _factor("runner area", 0.95, 1.05, "runner_area", source="assumed: casting"),
                _factor("runner volume", 0.95, 1.05, "runner_volume", source="assumed: casting"),
            )
        )

    @classmethod
    def oscillation(cls) -> Self:
        """Return the actuator's oscillation: amplitude, period and decay (Appendix B)."""
        why = "assumed: Part I calls them complicated functions of the hydraulics"
        return cls(
            (
                _factor(
                    "oscillation amplitude",
                    0.5,
                    1.5,
                    "valvetrain.oscillation_amplitude",
                    source=why,
                ),
                _factor(
                    "oscillation period", 0.8, 1.2, "valvetrain.oscillation_period", source=why
                ),
                _factor(
                    "oscillation decay", 0.85, 1.1, "valvetrain.oscillation_decay_ratio", source=why
                ),
            )
        )

    @classmethod
    def delivered_duration(cls) -> Self:
        """Return the offset of the delivered duration, common to all valves."""
        return cls((_offset(DURATION_OFFSET, DURATION_OFFSET),))

    @classmethod
    def engine(cls) -> Self:
        """Return flow, air, pressures, slopes and volumes of the engine."""
        return cls(
            (
                _factor(
                    "flow coefficient",
                    0.85,
                    1.05,
                    "flow_coefficient",
                    source="assumed: deposits on the low side, tolerance on the high one",
                ),
                _factor(
                    "temperature",
                    0.93,
                    1.1,
                    "temperature",
                    source="assumed: 270 to 319 K, which includes the printed 316 K",
                ),
                _factor("ambient pressure", 0.96, 1.03, "ambient_pressure", source="weather"),
                _factor(
                    "exhaust pressure",
                    0.95,
                    1.1,
                    "exhaust_pressure",
                    source="assumed: speed, load and the ageing of the exhaust line",
                ),
                _factor(
                    "opening slope",
                    0.9,
                    1.1,
                    "valvetrain.opening_slope_mm_s",
                    source="assumed: supply pressure and oil temperature",
                ),
                _factor(
                    "closing slope",
                    0.9,
                    1.1,
                    "valvetrain.closing_slope_mm_s",
                    source="assumed: supply pressure and oil temperature",
                ),
                _factor(
                    "manifold volume", 0.95, 1.05, "manifold_volume", source="assumed: casting"
                ),
                _factor(
                    "clearance volume", 0.97, 1.03, "clearance_volume", source="assumed: deposits"
                ),
            )
        )

    @classmethod
    def cylinders(cls, n_cylinders: int) -> Self:
        """Return what differs from cylinder to cylinder: flow factor and duration offset."""
        whole("n_cylinders", n_cylinders, 1, 24)
        each: list[UncertainParameter] = []
        for i in range(n_cylinders):
            each.append(
                _factor(
                    f"flow factor {i + 1}",
                    1.0 - FLOW_SPREAD,
                    1.0 + FLOW_SPREAD,
                    f"cylinder_flow_factors[{i}]",
                    source="assumed: spread of the ports",
                )
            )
        for i in range(n_cylinders):
            each.append(_offset(f"duration offset {i + 1}", f"{DURATION_OFFSET}[{i}]"))
        return cls(tuple(each))

    @classmethod
    def sensors(cls) -> Self:
        """Return gain error, lag and delay of the MAF sensor, and the offset of the MAP sensor."""
        nominal = MafSensor()
        return cls(
            (
                _value(
                    "MAF gain error", -MAF_GAIN_TOLERANCE, MAF_GAIN_TOLERANCE, 0.0, "maf.gain_error"
                ),
                _value(
                    "MAF time constant",
                    *MAF_TIME_CONSTANTS,
                    nominal.time_constant,
                    "maf.time_constant",
                    unit="s",
                ),
                _value("MAF delay", *MAF_DELAYS, nominal.delay, "maf.delay", unit="s"),
                _value(
                    "MAP offset",
                    -MAP_OFFSET_TOLERANCE,
                    MAP_OFFSET_TOLERANCE,
                    0.0,
                    "map.offset",
                    unit="Pa",
                ),
            )
        )

    @classmethod
    def plant(cls) -> Self:
        """Return all that is uncertain of a plant with equal cylinders."""
        whole = cls.engine() + cls.runner() + cls.oscillation() + cls.delivered_duration()
        return cls(whole.parameters)

    # -- the set itself ------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def low(self) -> FloatArray:
        """Lower bounds (d,)."""
        return np.array([p.low for p in self.parameters], dtype=float)

    @property
    def high(self) -> FloatArray:
        """Upper bounds (d,)."""
        return np.array([p.high for p in self.parameters], dtype=float)

    @property
    def nominal(self) -> FloatArray:
        """Nominal values (d,)."""
        return np.array([p.nominal for p in self.parameters], dtype=float)

    def __len__(self) -> int:
        """Return the number of parameters."""
        return len(self.parameters)

    def __iter__(self) -> Iterator[UncertainParameter]:
        """Return an iterator over the parameters."""
        return iter(self.parameters)

    def __getitem__(self, name: str) -> UncertainParameter:
        """Return a parameter by its name."""
        return self.parameters[self.names.index(one_of("uncertain parameter", name, self.names))]

    def __add__(self, other: UncertaintySet) -> UncertaintySet:
        """Return the set with the parameters of both."""
        if not isinstance(other, UncertaintySet):
            return NotImplemented
        return UncertaintySet(self.parameters + other.parameters)

    def only(self, names: Iterable[str]) -> UncertaintySet:
        """Return the set with the named parameters alone."""
        return UncertaintySet(tuple(self[name] for name in names))

    def replace(self, name: str, **changes: float) -> UncertaintySet:
        """Return the set with fields of one parameter changed, such as ``low`` and ``high``."""
        changed = self[name].replace(**changes)
        return UncertaintySet(tuple(changed if p.name == name else p for p in self.parameters))

    def check_engine(self, engine: Engine) -> None:
        """Check that every target exists, and that the engine can take every bound.

        Raises
        ------
        ParameterError
            If an engine field is unknown, or a bound impossible for it.
        """
        from ._engine_check import check_engine

        check_engine(self, engine)

    def __str__(self) -> str:
        """Return a line for each parameter."""
        return "\n".join(str(p) for p in self.parameters)


def _is_engine_field(target: str) -> bool:
    return target not in SENSOR_TARGETS and not _is_offset(target)


def _is_offset(target: str) -> bool:
    return target.startswith(DURATION_OFFSET)


def _factor(name: str, low: float, high: float, *acts_on: str, source: str) -> UncertainParameter:
    return UncertainParameter(name, low, high, 1.0, acts_on, source=source)


def _value(
    name: str, low: float, high: float, nominal: float, acts_on: str, *, unit: str = "1"
) -> UncertainParameter:
    return UncertainParameter(
        name, low, high, nominal, (acts_on,), False, unit, "assumed sensor tolerance"
    )


def _offset(name: str, target: str) -> UncertainParameter:
    return UncertainParameter(
        name.replace("_", " "),
        -DURATION_OFFSET_TOLERANCE,
        DURATION_OFFSET_TOLERANCE,
        0.0,
        (target,),
        False,
        "s",
        "assumed tolerance of the actuator",
    )
