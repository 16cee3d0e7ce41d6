"""When a sensor is read, and the samples that it gives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ._checks import in_range, positive
from .errors import ParameterError
from .kinematics import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Share of a sampling interval within which a sample counts as reached: rounding of crank
# angle and time may not hold a sample back until the next window.
_ROUNDING = 1e-9


class Sampling(Protocol):
    """When samples are taken: on a clock (`TimeSampling`) or on the crank (`CrankSampling`)."""

    @property
    def needs_crank_angle(self) -> bool:
        """Whether the instants depend on crank angle."""
        ...

    def first_index(self, time: float, crank_angle_deg: float) -> int:
        """Return the number of the first sample at or after a time (s) and crank angle."""
        ...

    def instants(self, first: int, time: FloatArray, crank_angle_deg: FloatArray) -> FloatArray:
        """Times in s of sample number `first` and those after it, up to the last point given."""
        ...


@dataclass(frozen=True, slots=True)
class TimeSampling:
    """Samples at even times: ``first + k period``."""

    period: float = 1e-3  # s
    first: float = 0.0  # s, time of sample 0

    def __post_init__(self) -> None:
        positive("period", self.period, "s")
        in_range("first", self.first, -1e9, 1e9, "s")

    @property
    def needs_crank_angle(self) -> bool:
        """False: the clock suffices."""
        return False

    def first_index(self, time: float, crank_angle_deg: float) -> int:
        """Return the number of the first sample at or after `time` (s)."""
        return math.ceil((time - self.first) / self.period - _ROUNDING)

    def instants(self, first: int, time: FloatArray, crank_angle_deg: FloatArray) -> FloatArray:
        """Times in s of sample number `first` and those after it, up to ``time[-1]``."""
        last = math.floor((time[-1] - self.first) / self.period + _ROUNDING)
        return self.first + self.period * np.arange(first, last + 1, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class CrankSampling:
    """Samples at even crank angles: ``first_deg + k step_deg``, at whatever speed.

    Angles count from the intake TDC of the first cylinder, as in `Trace`.
    """

    step_deg: float  # deg
    first_deg: float = 0.0  # deg, angle of sample 0

    def __post_init__(self) -> None:
        positive("step_deg", self.step_deg, "deg")
        in_range("first_deg", self.first_deg, -1e9, 1e9, "deg")

    @property
    def needs_crank_angle(self) -> bool:
        """True: the crank tells when."""
        return True

    def first_index(self, time: float, crank_angle_deg: float) -> int:
        """Return the number of the first sample at or after a crank angle."""
        return math.ceil((crank_angle_deg - self.first_deg) / self.step_deg - _ROUNDING)

    def instants(self, first: int, time: FloatArray, crank_angle_deg: FloatArray) -> FloatArray:
        """Times in s of sample number `first` and those after it, up to the last angle given."""
        last = math.floor((crank_angle_deg[-1] - self.first_deg) / self.step_deg + _ROUNDING)
        wanted = self.first_deg + self.step_deg * np.arange(first, last + 1, dtype=np.float64)
        return np.interp(wanted, crank_angle_deg, time)


@dataclass(frozen=True, slots=True)
class SensorSamples:
    """Samples that a sensor gave, `k` of them; there may be none.

    Attributes
    ----------
    quantity : str
        What is measured.
    unit : str
        Its unit.
    time : ndarray (k,)
        When each sample was taken, s on the clock of the sensor.
    crank_angle_deg : ndarray (k,)
        Crank angle at which it was taken, deg; NaN if the sensor was not told.
    value : ndarray (k,)
        The samples.
    saturated : ndarray (k,) of bool
        Whether the reading was outside the range of the sensor, and so limited to it.
    """

    quantity: str
    unit: str
    time: FloatArray
    crank_angle_deg: FloatArray
    value: FloatArray
    saturated: np.ndarray

    def __len__(self) -> int:
        return self.time.size

    @property
    def mean(self) -> float:
        """Mean of the samples.

        Raises
        ------
        ParameterError
            If there is no sample.
        """
        if not len(self):
            raise ParameterError(
                f"there is no sample of {self.quantity} to average: measure for longer, or "
                "sample more often"
            )
        return float(np.mean(self.value))

    def __str__(self) -> str:
        """Return number, span, mean and range of the samples in one line."""
        if not len(self):
            return f"{self.quantity}: no samples"
        text = (
            f"{self.quantity}: {len(self)} samples from {self.time[0]:.6g} to "
            f"{self.time[-1]:.6g} s, mean {self.mean:.5g} {self.unit} "
            f"({self.value.min():.5g} to {self.value.max():.5g})"
        )
        limited = int(np.count_nonzero(self.saturated))
        return text + (f", {limited} saturated" if limited else "")

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the samples against time; saturated ones are marked."""
        from ._plotting import axes, styled

        with styled():
            ax = axes(ax)
            ax.plot(self.time, self.value, ".-", lw=0.8, ms=4, label=self.quantity)
            if self.saturated.any():
                at = self.saturated
                ax.plot(self.time[at], self.value[at], "x", c="#D55E00", label="saturated")
                ax.legend()
            ax.set_xlabel("time (s)")
            ax.set_ylabel(f"{self.quantity} ({self.unit})")
        return ax
