"""Adaptation of one charge factor per cylinder; the law is this project's own.

The factor ``f_i`` tells how much of the charge that the map promises cylinder i takes in. The
normalised gradient of the squared prediction error ``(m_hat - f_i m_map)^2`` moves it by
``gain (m_hat/m_map - f_i)``, which is an integral correction of the relative charge error.
A part of each error that all cylinders share may be given a gain of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from plant._checks import in_range, replace_fields
from plant.errors import ParameterError
from plant.kinematics import FloatArray


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


class AdaptationStep(NamedTuple):
    """Outcome of one update."""

    factors: FloatArray  # (n,)
    error: float  # prediction error used, after the dead zone
    projected: bool  # whether a factor was held at its bound


class AdaptationLaw(Protocol):
    """What a controller asks of an adaptation law."""

    def update(
        self, factors: FloatArray, cylinder: int, ratio: float, used: float, speed_rpm: float
    ) -> AdaptationStep:
        """Return the factors after one estimate; see `NormalisedGradient.update`."""
        ...


@dataclass(frozen=True, slots=True)
class NormalisedGradient:
    """Normalised gradient with projection and dead zone.

    Parameters
    ----------
    gains : GainSchedule
        Gains per cycle over speed.
    bounds : (float, float)
        Interval onto which the factors are projected, 1.
    dead_zone : float
        Prediction error below which nothing moves; above, the error counts from there on.
    """

    gains: GainSchedule = GainSchedule()
    bounds: tuple[float, float] = (0.6, 1.4)
    dead_zone: float = 0.0

    def __post_init__(self) -> None:
        low = in_range("bounds[0]", self.bounds[0], 0.0, 1.0, "1", open_low=True)
        in_range("bounds[1]", self.bounds[1], max(low, 1.0), 10.0, "1")
        in_range("dead_zone", self.dead_zone, 0.0, 1.0, "1")

    def replace(self, **changes: object) -> NormalisedGradient:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def update(
        self, factors: FloatArray, cylinder: int, ratio: float, used: float, speed_rpm: float
    ) -> AdaptationStep:
        """Return the factors after the estimate of one event.

        Parameters
        ----------
        factors : ndarray (n,)
            Factors so far; not changed.
        cylinder : int
            Cylinder (from 1) of the event.
        ratio : float
            Estimated charge over that of the map at the commanded valve motion.
        used : float
            Factor with which that command was made.
        speed_rpm : float
            Speed for which the gains are taken.
        """
        n = factors.size
        gains = self.gains.at(speed_rpm)
        error = ratio - used
        error = float(np.sign(error)) * max(abs(error) - self.dead_zone, 0.0)
        moved = factors + (gains.mean - gains.imbalance) / n * error
        moved[cylinder - 1] += gains.imbalance * error
        inside = np.clip(moved, *self.bounds)
        return AdaptationStep(inside, error, bool(np.any(inside != moved)))
