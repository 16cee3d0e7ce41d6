"""Gains of the adaptation per cycle, and their schedule over speed.

A part of each charge error that all cylinders share, the mean, has a gain of its own beside that of
the differences between cylinders, the imbalance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from plant._checks import in_range
from plant.errors import ParameterError


@dataclass(frozen=True, slots=True)
class AdaptationGains:
    """Gains per cycle: share of an error that one cycle removes.

    Parameters
    ----------
    mean : float
        Of the error common to all cylinders.
    imbalance : float
        Of the differences between cylinders; 0 holds them.
    """

    mean: float
    imbalance: float

    def __post_init__(self) -> None:
        in_range("mean", self.mean, 0.0, 100.0, "1")
        in_range("imbalance", self.imbalance, 0.0, 100.0, "1")

    def scaled(self, factor: float) -> AdaptationGains:
        """Return both gains times a factor."""
        return AdaptationGains(factor * self.mean, factor * self.imbalance)


@dataclass(frozen=True, slots=True)
class GainSchedule:
    """Adaptation gains over speed, linear between the nodes and held outside.

    The defaults fall with speed, those of the imbalance fastest: the lag amplifies the noise of
    an estimate by about ``tau/T``. From 3600 rpm up they are zero: from about 3700 rpm the
    measurement of the alternating mode vanishes for some engine of the assumed set (a MAF delay
    of 3 ms, above all), so that no gain is robust, and the differences between cylinders are held
    as they were learnt at lower speed.

    Parameters
    ----------
    speed_rpm : tuple of float
        Nodes, rising, rpm.
    mean, imbalance : tuple of float
        Gains per cycle at the nodes.
    """

    speed_rpm: tuple[float, ...] = (750.0, 1500.0, 3000.0, 3500.0, 3600.0, 6000.0)  # rpm
    mean: tuple[float, ...] = (0.4, 0.4, 0.3, 0.28, 0.28, 0.2)  # 1
    imbalance: tuple[float, ...] = (0.4, 0.4, 0.2, 0.16, 0.0, 0.0)  # 1

    def __post_init__(self) -> None:
        nodes = len(self.speed_rpm)
        if nodes < 1 or len(self.mean) != nodes or len(self.imbalance) != nodes:
            raise ParameterError(
                f"the schedule has {nodes} speeds, {len(self.mean)} mean and "
                f"{len(self.imbalance)} imbalance gains: give one of each per node, at least one"
            )
        if any(b <= a for a, b in pairwise(self.speed_rpm)):
            raise ParameterError(f"speed_rpm is {self.speed_rpm}, but must rise: sort the nodes")
        for mean, imbalance in zip(self.mean, self.imbalance, strict=True):
            AdaptationGains(mean, imbalance)

    @classmethod
    def constant(cls, mean: float, imbalance: float) -> GainSchedule:
        """Return gains that hold at every speed."""
        return cls((1000.0,), (mean,), (imbalance,))

    def at(self, speed_rpm: float) -> AdaptationGains:
        """Gains at a speed in rpm."""
        return AdaptationGains(
            float(np.interp(speed_rpm, self.speed_rpm, self.mean)),
            float(np.interp(speed_rpm, self.speed_rpm, self.imbalance)),
        )

    def scaled(self, factor: float) -> GainSchedule:
        """Return the schedule with all gains times a factor."""
        return GainSchedule(
            self.speed_rpm,
            tuple(factor * gain for gain in self.mean),
            tuple(factor * gain for gain in self.imbalance),
        )
