"""Search for adaptation gains, with the closed form of mu on a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._rank_one import RankOneLoop, UncertainValues, mode_grid
from .adaptation import AdaptationGains
from .event_loop import MODE_WIDTH, _adaptation_matrices
from .pulse_bank import pulse_bank
from .uncertain_measurement import UncertainMeasurement

_LARGEST = 2.0  # gain per cycle up to which is sought
_LEAST = 0.01  # the smallest gain sought
_COARSE, _FINE = 21, 7  # gains a side: first grid, and each zoom
_ZOOMS = 9


@dataclass(frozen=True)
class GainSearch:
    """Search over the gains at one speed.

    Attributes
    ----------
    measurement : UncertainMeasurement
        The measurement.
    bound : float
        Bound on ``|S|``.
    mu_limit : float
        Largest mu that is allowed.
    angle, values
        Grid, rad per event, and the measurement on it.
    """

    measurement: UncertainMeasurement
    bound: float
    mu_limit: float
    angle: FloatArray = field(init=False)
    values: UncertainValues = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", mode_grid(self.measurement.n_cylinders))
        object.__setattr__(self, "values", UncertainValues.of(self.measurement, self.angle))

    def loops(self, mean: FloatArray | float, imbalance: FloatArray | float) -> RankOneLoop:
        """Loops of gains, all positive or with no imbalance gain at all."""
        mean, imbalance = np.asarray(mean)[..., None], np.asarray(imbalance)[..., None]
        n, z = self.measurement.n_cylinders, self.values.z
        shared = (mean - imbalance) / n
        if not np.any(imbalance):
            return RankOneLoop.of(self.values, shared * np.ones_like(z), 1.0 - 1.0 / z)
        wait = -self.measurement.latency % n
        every = sum(z**-i for i in range(n))
        denominator: ComplexArray = 1.0 - z**-n
        return RankOneLoop.of(self.values, imbalance * z**-wait + shared * every, denominator)

    def time_constants(self, mean: FloatArray, imbalance: FloatArray) -> FloatArray:
        """Time constants of the mean and of the slowest imbalance mode, cycles (2, gains)."""
        m = self.measurement
        n = m.n_cylinders
        bank = pulse_bank([m.centre], m.latency, input="y", outputs=["e"], name="centre")
        A, B, C = (np.asarray(part) for part in (bank.A, bank.B, bank.C))
        closed = []
        for gains in zip(mean.tolist(), imbalance.tolist(), strict=True):
            a, b, c, d = _adaptation_matrices(n, m.latency, AdaptationGains(*gains))
            closed.append(np.block([[A - B @ d @ C, -B @ c], [b @ C, a]]))
        poles = np.linalg.eigvals(np.stack(closed))
        turn = np.abs(np.angle(poles)) * n / (2.0 * np.pi)
        held = np.asarray(imbalance) == 0.0  # all poles are the mean's, at whatever angle
        radius = np.stack(
            [
                np.where(part, np.abs(poles), 0.0).max(axis=-1)
                for part in ((turn <= MODE_WIDTH) | held[:, None], turn >= 1.0 - MODE_WIDTH)
            ]
        )
        stable = np.all(np.abs(poles) < 1.0, axis=-1)
        with np.errstate(divide="ignore"):
            tau = -1.0 / (n * np.log(np.minimum(radius, 1.0)))
        return np.where(stable, tau, np.inf)

    def best(self, *, held: bool) -> AdaptationGains | None:
        """Fastest robust gains by a grid and zooms into it; None if none is robust."""
        span = np.array([_LARGEST, 0.0 if held else _LARGEST])
        low = np.array([_LEAST, 0.0 if held else _LEAST])
        centre, half, points = low + 0.5 * (span - low), 0.5 * (span - low), _COARSE
        best: FloatArray | None = None
        cost = math.inf
        for zoom in range(_ZOOMS):
            sides = [
                np.unique(np.clip(np.linspace(c - h, c + h, points), bottom, top))
                for c, h, bottom, top in zip(centre, half, low, span, strict=True)
            ]
            mean, imbalance = (side.ravel() for side in np.meshgrid(*sides, indexing="ij"))
            robust = self.loops(mean, imbalance).mu_performance(self.bound).max(axis=-1)
            good = robust <= self.mu_limit
            if good.any():
                tau = self.time_constants(mean[good], imbalance[good])
                total = tau[0] if held else tau.sum(axis=0)
                k = int(np.argmin(total))
                if total[k] < cost:
                    cost = float(total[k])
                    best = np.array([mean[good][k], imbalance[good][k]])
            if best is None:
                if zoom:  # a robust gain, if any, is smaller than the first steps
                    return None
                centre, half = low + half / _COARSE, half / _COARSE
                continue
            half = 2.0 * half / (points - 1) if zoom == 0 else 0.5 * half
            centre, points = best, _FINE
        if best is None or not math.isfinite(cost):
            return None
        return AdaptationGains(float(best[0]), float(best[1]))
