"""Sensors of the air path: air flow (MAF), manifold pressure (MAP) and valve duration.

No figure of this engine's sensors is published: every default is an assumption, to be
overridden with ``.replace(...)``. A nominal sensor has neither gain error nor offset; the
tolerances assumed for them are constants of this module, and ``worst()`` applies them.

A flow or pressure sensor is a transport delay, a first-order lag, a gain and an offset; then,
at each sample, white noise and a limited, quantised output. The lag is solved exactly for a
signal that is linear between the points at which it is given. So the samples depend neither on
how the signal is cut into windows nor on how the windows lie against the sampling clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol, Self

import numpy as np

from ._checks import in_range, whole
from .errors import ParameterError
from .parameters import _Replaceable
from .sampling import Sampling, TimeSampling
from .sensor_run import DurationRun, Seed, SensorRun, SensorSetRun

MAF_GAIN_TOLERANCE = 0.03  # 1, assumed: the gain of a MAF sensor is within this of 1
MAF_TIME_CONSTANTS = (0.010, 0.020)  # s, assumed range around 15 ms
MAF_DELAYS = (0.0, 3e-3)  # s, assumed range around 1 ms
MAP_OFFSET_TOLERANCE = 1500.0  # Pa, assumed

Sign = Literal[1, -1]


class Sensor(Protocol):
    """A sensor of one of the plant's signals: its parameters, from which a run starts."""

    def start(self, seed: Seed) -> SensorRun:
        """Return the sensor at work, with its own random numbers."""
        ...


@dataclass(frozen=True, slots=True)
class AirSensor(_Replaceable):
    """What flow and pressure sensors have in common; units are those of the signal."""

    signal: ClassVar[str] = ""  # field of Trace
    quantity: ClassVar[str] = ""
    unit: ClassVar[str] = ""

    time_constant: float = 0.0  # s
    delay: float = 0.0  # s
    gain_error: float = 0.0  # 1, the gain is 1 + gain_error
    offset: float = 0.0  # unit
    noise: float = 0.0  # unit, 1 sigma, per sample
    relative_noise: float = 0.0  # 1, 1 sigma as a share of the reading, per sample
    lowest: float = -math.inf  # unit, output at code 0
    highest: float = math.inf  # unit, output at the highest code
    bits: int | None = 12  # 1, of the converter; None for no quantisation
    sampling: Sampling = field(default_factory=TimeSampling)

    def __post_init__(self) -> None:
        in_range("time_constant", self.time_constant, 0.0, math.inf, "s")
        in_range("delay", self.delay, 0.0, math.inf, "s")
        in_range("gain_error", self.gain_error, -1.0, math.inf, "1", open_low=True)
        for name in ("offset", "lowest", "highest"):
            in_range(name, getattr(self, name), -1e9, 1e9, self.unit)
        in_range("noise", self.noise, 0.0, math.inf, self.unit)
        in_range("relative_noise", self.relative_noise, 0.0, math.inf, "1")
        if self.highest <= self.lowest:
            raise ParameterError(
                f"highest is {self.highest:g} {self.unit}, but must be above lowest = "
                f"{self.lowest:g} {self.unit}"
            )
        if self.bits is not None:
            whole("bits", self.bits, 1, 32, remedy="None leaves quantisation out")
        if not all(hasattr(self.sampling, name) for name in ("first_index", "instants")):
            raise ParameterError(
                f"sampling is {self.sampling!r}, but must be a TimeSampling or a CrankSampling"
            )

    @property
    def step(self) -> float:
        """Distance between two output levels, in the unit of the signal; 0 if not quantised."""
        return 0.0 if self.bits is None else (self.highest - self.lowest) / (2**self.bits - 1)

    def ideal(self) -> Self:
        """Return the sensor with its lag, delay and sampling, but without any error."""
        return self.replace(gain_error=0.0, offset=0.0, noise=0.0, relative_noise=0.0, bits=None)

    def start(self, seed: Seed) -> SensorRun:
        """Return the sensor at work, settled at the first point that it is shown.

        Parameters
        ----------
        seed : int or numpy.random.SeedSequence
            Seed of the noise.
        """
        return SensorRun(self, seed)


@dataclass(frozen=True, slots=True)
class MafSensor(AirSensor):
    """Mass air flow into the manifold, kg/s; every value is assumed.

    The range suits the paper's engine, whose instantaneous flow lies between -0.05 and
    0.1 kg/s up to 6000 rpm; give a larger engine a larger one. Noise is independent from
    sample to sample, whatever the sampling interval.
    """

    signal: ClassVar[str] = "throttle_flow"
    quantity: ClassVar[str] = "air mass flow"
    unit: ClassVar[str] = "kg/s"

    time_constant: float = 0.015  # s
    delay: float = 1e-3  # s
    relative_noise: float = 0.01  # 1, 1 sigma as a share of the reading, per sample
    lowest: float = -0.05  # kg/s
    highest: float = 0.15  # kg/s

    @classmethod
    def worst(cls, sign: Sign = 1) -> Self:
        """Return the sensor at its assumed tolerances, the gain high (1) or low (-1).

        Lag and delay are the longest ones: they cost phase.
        """
        return cls(
            time_constant=MAF_TIME_CONSTANTS[1],
            delay=MAF_DELAYS[1],
            gain_error=_sign(sign) * MAF_GAIN_TOLERANCE,
        )


@dataclass(frozen=True, slots=True)
class MapSensor(AirSensor):
    """Absolute manifold pressure, Pa; every value is assumed."""

    signal: ClassVar[str] = "manifold_pressure"
    quantity: ClassVar[str] = "manifold pressure"
    unit: ClassVar[str] = "Pa"

    time_constant: float = 1e-3  # s
    noise: float = 100.0  # Pa, 1 sigma, per sample
    lowest: float = 0.0  # Pa
    highest: float = 120e3  # Pa

    @classmethod
    def worst(cls, sign: Sign = 1) -> Self:
        """Return the sensor at its assumed offset tolerance, high (1) or low (-1)."""
        return cls(offset=_sign(sign) * MAP_OFFSET_TOLERANCE)


@dataclass(frozen=True, slots=True)
class DurationSensor(_Replaceable):
    """Measurement of how long an intake valve was open; every value is assumed.

    The error is one of time, so that in crank angle it grows with speed: 0.05 ms are 0.45 deg
    at 1500 rpm and 1.8 deg at 6000 rpm.
    """

    noise: float = 5e-5  # s, 1 sigma, per event
    offset: float = 0.0  # s

    def __post_init__(self) -> None:
        in_range("noise", self.noise, 0.0, math.inf, "s")
        in_range("offset", self.offset, -1.0, 1.0, "s")

    def start(self, seed: Seed) -> DurationRun:
        """Return the sensor at work; `seed` is that of the noise."""
        return DurationRun(self, seed)


@dataclass(frozen=True, slots=True)
class SensorSet(_Replaceable):
    """The measurements that a conventional engine has, and the valve duration."""

    maf: Sensor = field(default_factory=MafSensor)
    map: Sensor = field(default_factory=MapSensor)
    duration: DurationSensor = field(default_factory=DurationSensor)

    def start(self, seed: int) -> SensorSetRun:
        """Return the sensors at work; their noises are independent streams of one `seed`."""
        maf, map_, duration = np.random.SeedSequence(seed).spawn(3)
        return SensorSetRun(
            self.maf.start(maf), self.map.start(map_), self.duration.start(duration)
        )


def _sign(sign: int) -> int:
    if sign not in (1, -1):
        raise ParameterError(f"sign is {sign!r}, but must be 1 or -1")
    return sign
