"""Adaptation gains that settle fastest among those that are proved robust.

Constraint: mu for robust performance at most `MU_LIMIT`, with ``|S|`` at most 2 anywhere in the
set; it includes robust stability. Objective: the least sum of the time constants of the mean and
of the slowest imbalance mode, per cycle, in the middle of the set. Where the measurement of an
imbalance mode vanishes somewhere in the set, no gain is robust, and the differences are held.

The search uses the closed form of mu on a grid (`camless_ctrl._rank_one`); the result is then
confirmed by `mu.robust_performance`, which proves it between the frequencies as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError
from plant._checks import in_range, positive
from plant.kinematics import FloatArray

from ._gain_search import GainSearch
from ._loop_figures import SETTLED
from ._rank_one import UncertainValues, largest_real, mode_grid
from ._schedule_design import ScheduleDesign
from .adaptation import AdaptationGains, GainSchedule
from .estimator import ChargeEstimator
from .estimator_response import LatentEstimator
from .synthesis.errors import SynthesisError
from .uncertain_loop import SENSITIVITY_BOUND, UncertainLoop
from .uncertain_measurement import UncertainMeasurement

if TYPE_CHECKING:
    from .margins import StabilityMargins
    from .mu import MuResult

MU_LIMIT = 0.99  # the proof between the frequencies needs 0.5 % of it
CANDIDATES = tuple(
    ChargeEstimator(delay=delay, taper=taper) for delay in (1e-3, 1.5e-3) for taper in (1e-3, 2e-3)
)  # estimators worth comparing: the lag is the sensor's, the delay nominal or mid-range
_STEP = 1.05  # more gain, by which the limit of a design is found

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class GainDesign:
    """Fastest robust gains at one speed.

    Attributes
    ----------
    measurement : UncertainMeasurement
        What they were designed for.
    gains : AdaptationGains
        Gains per cycle; imbalance 0 where the differences are held.
    sensitivity_bound : float
        Bound on ``|S|`` that holds in the whole set.
    mu_stability, mu_performance : float
        Largest mu on the grid.
    worst_sensitivity : float
        Largest ``|S|`` in the set, on the grid.
    mode : int
        Mode in whose band mu for performance is largest.
    time_constants : (float, float)
        Of the mean and of the slowest imbalance mode in the middle of the set, cycles; infinite
        if held.
    bandwidth_hz : float
        Lowest frequency at which ``|S|`` of the mean reaches ``1/sqrt(2)``, Hz.
    margins : StabilityMargins
        Of the loop in the middle of the set, all modes together.
    limit : str
        What 5 % more gain would break: ``robust performance``, or ``settling`` if it only
        settles more slowly.
    vanishing : tuple of int
        Imbalance modes of which the measurement vanishes somewhere in the set.
    confirmation : MuResult or None
        Proof of robust performance, if it was asked for.
    """

    measurement: UncertainMeasurement = field(repr=False)
    gains: AdaptationGains
    sensitivity_bound: float
    mu_stability: float
    mu_performance: float
    worst_sensitivity: float
    mode: int
    time_constants: tuple[float, float]
    bandwidth_hz: float
    margins: StabilityMargins = field(repr=False)
    limit: str
    vanishing: tuple[int, ...]
    confirmation: MuResult | None = field(repr=False)

    @property
    def speed_rpm(self) -> float:
        """Speed."""
        return self.measurement.speed_rpm

    @property
    def held(self) -> bool:
        """Whether the differences between cylinders are held."""
        return self.gains.imbalance == 0.0

    @property
    def settling_cycles(self) -> tuple[float, float]:
        """Cycles to 2 % by the slowest pole: of the mean, and of the slowest imbalance mode."""
        mean, imbalance = (-math.log(SETTLED) * tau for tau in self.time_constants)
        return mean, imbalance

    def __str__(self) -> str:
        """Return gains, settling, what limits them and the proof."""
        mean, imbalance = self.settling_cycles
        differences = (
            "differences held" + (f" ({self._vanishing} in the set)" if self.vanishing else "")
            if self.held
            else f"imbalance {self.gains.imbalance:.3f} (settles in {imbalance:.1f} cycles)"
        )
        proof = "not confirmed" if self.confirmation is None else "proved"
        return (
            f"{self.speed_rpm:g} rpm: gains per cycle mean {self.gains.mean:.3f} (settles in "
            f"{mean:.1f} cycles, {self.bandwidth_hz:.2f} Hz), {differences}; limited by "
            f"{self.limit}, mu {self.mu_performance:.3f} in mode q={self.mode} ({proof}), "
            f"|S| at most {self.worst_sensitivity:.2f}, disk margin {self.margins.disk_margin:.2f}"
        )

    @property
    def loop(self) -> UncertainLoop:
        """The loop with the gains."""
        return UncertainLoop.adaptive(self.measurement, self.gains, self.sensitivity_bound)

    @property
    def _vanishing(self) -> str:
        modes = " and ".join(f"q={q}" for q in self.vanishing)
        return f"modes {modes} vanish" if len(self.vanishing) > 1 else f"mode {modes} vanishes"


def design_gains(
    measurement: UncertainMeasurement,
    *,
    sensitivity_bound: float = SENSITIVITY_BOUND,
    mu_limit: float = MU_LIMIT,
    confirm: bool = True,
) -> GainDesign:
    """Return the gains that settle fastest of those with robust performance.

    Parameters
    ----------
    measurement : UncertainMeasurement
        Measurement at one speed.
    sensitivity_bound : float
        Bound on ``|S|`` over the whole set.
    mu_limit : float
        Largest mu for robust performance that is allowed on the grid.
    confirm : bool
        Whether to prove the result with `mu.robust_performance` (some seconds).

    Raises
    ------
    SynthesisError
        If no gain is robust, or the proof fails.
    """
    bound = positive("sensitivity_bound", sensitivity_bound, "1")
    in_range("mu_limit", mu_limit, 0.0, 1.0, "1", open_low=True)
    search = GainSearch(measurement, bound, mu_limit)
    vanishing = vanishing_modes(measurement)
    found = None if vanishing else search.best(held=False)
    found = search.best(held=True) if found is None else found
    if found is None:
        raise SynthesisError(
            f"no gain keeps |S| below {bound:g} in the whole set at {measurement.speed_rpm:g} rpm: "
            "allow a larger sensitivity_bound, or narrow the uncertain parameters"
        )
    loop = UncertainLoop.adaptive(measurement, found, bound)
    confirmation = confirmed(loop) if confirm else None
    one = search.loops(found.mean, found.imbalance)
    performance = one.mu_performance(bound)
    more = found.scaled(_STEP)
    broken = float(search.loops(more.mean, more.imbalance).mu_performance(bound).max()) > mu_limit
    peak = float(search.angle[int(np.argmax(performance))])
    tau = search.time_constants(np.array([found.mean]), np.array([found.imbalance]))
    return GainDesign(
        measurement,
        found,
        bound,
        float(one.mu_stability().max()),
        float(performance.max()),
        float(one.worst_sensitivity().max()),
        round(peak * measurement.n_cylinders / (2.0 * np.pi)),
        (float(tau[0, 0]), math.inf if found.imbalance == 0.0 else float(tau[1, 0])),
        bandwidth(search.angle, np.abs(one.sensitivity)) / measurement.event_time,
        loop_margins(loop),
        "robust performance" if broken else "settling",
        vanishing,
        confirmation,
    )


def vanishing_modes(measurement: UncertainMeasurement) -> tuple[int, ...]:
    """Imbalance modes of which the measurement vanishes for some perturbation in the set.

    An integrator at such a mode is unstable there, however small its gain.
    """
    n = measurement.n_cylinders
    angle = 2.0 * np.pi * np.arange(1, n // 2 + 1) / n
    values = UncertainValues.of(measurement, angle)
    mu = largest_real(values.directions / values.centre, values.weight / np.abs(values.centre))
    return tuple(q + 1 for q in range(angle.size) if mu[q] >= 1.0)


def bandwidth(angle: FloatArray, sensitivity: FloatArray) -> float:
    """Lowest frequency at which ``|S|`` reaches ``1/sqrt(2)``, times the event time, Hz s.

    NaN if it is above already at the lowest angle.
    """
    limit = math.sqrt(0.5)
    above = np.flatnonzero(sensitivity >= limit)
    if not above.size or above[0] == 0:
        return math.nan
    k = int(above[0])
    at = np.interp(limit, sensitivity[k - 1 : k + 1], angle[k - 1 : k + 1])
    return float(at) / (2.0 * math.pi)


def loop_margins(loop: UncertainLoop) -> StabilityMargins:
    """Margins of the loop in the middle of the set, over the whole circle of an event."""
    from .margins import margins_of_response

    T = loop.measurement.event_time
    grid = mode_grid(loop.measurement.n_cylinders, 120) / T
    return margins_of_response(
        lambda omega: loop.loop_response(np.exp(1j * np.asarray(omega) * T)), grid, loop.stable
    )


def design_schedule(
    measurements: Sequence[UncertainMeasurement],
    *,
    present: GainSchedule | None = None,
    sensitivity_bound: float = SENSITIVITY_BOUND,
    mu_limit: float = MU_LIMIT,
    confirm: bool = True,
    progress: Progress | None = None,
) -> ScheduleDesign:
    """Return the fastest robust gains over speed.

    Parameters
    ----------
    measurements : sequence of UncertainMeasurement
        One a speed. With several estimators, at the same speeds each, the one is taken that
        holds the differences at the fewest speeds and then settles fastest.
    present : GainSchedule, optional
        Schedule to compare with; the default one if not given.
    sensitivity_bound, mu_limit, confirm
        As in `design_gains`.
    progress : callable, optional
        Called with the designs and proofs done and their number.

    Raises
    ------
    SynthesisError
        If no gain is robust at some speed, or a proof fails.
    ParameterError
        If the estimators were not measured at the same speeds, each once.
    """
    present = GainSchedule() if present is None else present
    groups = _by_estimator(measurements)
    speeds = len(next(iter(groups.values())))
    total, done = speeds * (len(groups) + int(confirm)), 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    found: dict[LatentEstimator, list[GainDesign]] = {}
    for estimator, group in groups.items():
        found[estimator] = []
        for measurement in group:
            found[estimator].append(
                design_gains(
                    measurement,
                    sensitivity_bound=sensitivity_bound,
                    mu_limit=mu_limit,
                    confirm=False,
                )
            )
            step()
    held = {e: sum(design.held for design in designs) for e, designs in found.items()}
    slowness = {
        e: sum(t for d in designs for t in d.time_constants if math.isfinite(t))
        if held[e] == min(held.values())
        else math.inf
        for e, designs in found.items()
    }
    best = found[min(slowness, key=lambda e: slowness[e])]
    if confirm:
        for k, design in enumerate(best):
            best[k] = replace(design, confirmation=confirmed(design.loop))
            step()
    mu = []
    for design in best:
        search = GainSearch(design.measurement, sensitivity_bound, mu_limit)
        gains = present.at(design.speed_rpm)
        one = search.loops(gains.mean, gains.imbalance)
        stable = UncertainLoop.adaptive(design.measurement, gains).stable
        mu.append(float(one.mu_performance(sensitivity_bound).max()) if stable else math.inf)
    return ScheduleDesign(tuple(best), present, tuple(mu), tuple(slowness.items()))


def _by_estimator(
    measurements: Sequence[UncertainMeasurement],
) -> dict[LatentEstimator, list[UncertainMeasurement]]:
    """Measurements by estimator, each sorted by speed.

    Raises
    ------
    ParameterError
        If there is none, or the estimators were not measured at the same speeds, each once.
    """
    found: dict[LatentEstimator, list[UncertainMeasurement]] = {}
    for measurement in sorted(measurements, key=lambda m: m.speed_rpm):
        found.setdefault(measurement.estimator, []).append(measurement)
    speeds = {tuple(m.speed_rpm for m in group) for group in found.values()}
    if len(speeds) != 1 or any(len(set(s)) != len(s) for s in speeds):
        raise ParameterError(
            f"the measurements have the speeds {sorted(speeds)} rpm, but there must be one a "
            "speed, at the same speeds for each estimator"
        )
    return found


def confirmed(loop: UncertainLoop) -> MuResult:
    """Proof of robust performance."""
    from .mu import robust_performance

    found = robust_performance(loop.system, loop.structure)
    if not found.guaranteed or found.robust is not True:
        raise SynthesisError(
            f"robust performance of the gains found is not proved at "
            f"{loop.measurement.speed_rpm:g} rpm: {found} Take a smaller mu_limit"
        )
    return found
