"""Poles, margins and small gain of an analysed loop at one speed, from its measured description.

The closed-form loop of event windows has its own verdict (`robustness.RobustnessResult`). This is
the same for any loop of a robust analysis, that of a designed controller above all: its estimator
has no closed form, and what it sees is taken from sampled full plants. Nothing here uses the
structure of the uncertainty: the small gain takes all of it as one complex number.

All of it is this project's own design.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._loop_figures import radii
from ._lti_members import spectral_radii
from .adaptation import AdaptationGains
from .event_loop import MODE_WIDTH
from .robust_analysis import RobustAnalysis, SpeedAnalysis
from .robustness import ModeVerdict
from .uncertain_loop import UncertainLoop

_POINTS = 1441  # angles per event, between those of the modes
_NEAR = 1e-5  # rad, from a steady pattern, where an integrator is infinite
_DELAYS = 3  # events, longest remainder tried


@dataclass(frozen=True)
class LoopVerdict:
    """What can be said of a loop at one speed without the structure of its uncertainty.

    Attributes
    ----------
    speed_rpm, demand : float
        Operating point: rpm, kg.
    gains : AdaptationGains
        Gains per cycle.
    stable, robustly_stable : bool
        Whether the nominal loop is stable, and the whole set is proved to be.
    modes : tuple of ModeVerdict
        The modes of the nominal loop; the small gain is that of the middle of the set.
    sensitivity_error : float
        Largest size of the uncertainty over the measurement at a steady pattern, 1.
    worst : tuple of float
        Largest pole radius per cycle over the corners of the real parameters with remainders of
        either sign and up to three events' delay, and the sensor's lag and delay there, s (NaN
        where the set has none).
    delay_limit, delay_limit_mode : float, int or None
        Delay of the air-flow sensor at which the nominal loop breaks, s, and the mode that does;
        NaN and None if the estimator learns the delay.
    """

    speed_rpm: float
    demand: float
    gains: AdaptationGains
    stable: bool
    robustly_stable: bool
    modes: tuple[ModeVerdict, ...]
    sensitivity_error: float
    worst: tuple[float, float, float]
    delay_limit: float
    delay_limit_mode: int | None = None

    @property
    def gain_margin(self) -> float:
        """Smallest gain margin of a mode, a ratio; NaN if unstable."""
        return _least(mode.margins.gain_margin for mode in self.modes)

    @property
    def disk_margin(self) -> float:
        """Smallest disk margin of a mode; NaN if unstable."""
        return _least(mode.margins.disk_margin for mode in self.modes)

    @property
    def sensitivity_peak(self) -> float:
        """Largest ``|S|`` of a mode; NaN if unstable."""
        return -_least(-mode.margins.sensitivity_peak for mode in self.modes)

    @property
    def small_gain(self) -> float:
        """Largest ``|w T|`` of any mode; NaN if unstable."""
        return -_least(-mode.small_gain for mode in self.modes)

    def __str__(self) -> str:
        """Return poles and margins in plain words."""
        point = f"{self.speed_rpm:g} rpm, {1e6 * self.demand:.0f} mg"
        if not self.stable:
            return f"{point}: unstable with the nominal plant; no margin"
        radius = max(mode.spectral_radius for mode in self.modes)
        return (
            f"{point}: stable; gains {self.gains.mean:.3f} (mean) and {self.gains.imbalance:.3f} "
            f"(imbalance) per cycle, radius {radius:.3f} ({self.worst[0]:.3f} at the worst corner "
            f"of the set); gain margin {self.gain_margin:.1f}, disk margin "
            f"{self.disk_margin:.2f}, peak |S| {self.sensitivity_peak:.2f}; all uncertainty as "
            f"one complex number: |wT| {self.small_gain:.2f}"
        )


def loop_verdicts(found: RobustAnalysis) -> list[LoopVerdict]:
    """Return the verdict on the loop at each speed of an analysis.

    Parameters
    ----------
    found : RobustAnalysis
        The analysis.
    """
    return [_verdict(s, found.schedule.at(s.speed_rpm)) for s in found.speeds]


def small_gain(loop: UncertainLoop) -> tuple[FloatArray, FloatArray]:
    """Return angles per event (a,), rad, and the small gain there: a bound of mu from above.

    With all uncertainty as one complex number of size ``w = sum |H_k| + |W|`` beside the middle
    ``E_c`` of the set, the loop is stable for all of it if ``w |C S| < 1``, which is ``|w T|`` of
    the relative size. It is at least the structured singular value.

    Parameters
    ----------
    loop : UncertainLoop
        The loop; meaningful only if it is stable.
    """
    n = loop.measurement.n_cylinders
    patterns = 2.0 * np.pi * np.arange(n // 2 + 1) / n
    near = np.concatenate((patterns - _NEAR, patterns + _NEAR))
    between = np.pi * (np.arange(_POINTS) + 0.5) / _POINTS
    angle = np.sort(np.concatenate((between, near[(near > 0.0) & (near < np.pi)])))
    z = np.exp(1j * angle)
    law = np.asarray(loop.law(z), dtype=complex)
    return angle, np.abs(law / (1.0 + loop.loop_response(z))) * _size(loop, z)


def worst_radius(loop: UncertainLoop) -> tuple[float, dict[str, float]]:
    """Return the largest pole radius per cycle at the corners of a set, and the parameters there.

    Parameters
    ----------
    loop : UncertainLoop
        The loop. The remainder is nothing, or plus or minus 1 with a delay of 0 to 3 events.
    """
    m = loop.measurement
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=len(m.directions))))
    kinds = np.zeros((1 + 2 * (_DELAYS + 1), _DELAYS + 1))
    kinds[1:] = np.concatenate((np.eye(_DELAYS + 1), -np.eye(_DELAYS + 1)))
    deltas = np.repeat(corners, len(kinds), axis=0)
    numerator = np.tile(kinds, (len(corners), 1))
    denominator = np.zeros_like(numerator)
    denominator[:, 0] = 1.0
    found = spectral_radii(loop, deltas, numerator, denominator)
    k = int(np.argmax(found))
    names = list(m.directions)
    return float(found[k]), m.values(dict(zip(names, deltas[k].tolist(), strict=True)))


def _verdict(s: SpeedAnalysis, gains: AdaptationGains) -> LoopVerdict:
    loop, m, margins = s.structured.loop, s.measurement, s.margins
    n, stable = m.n_cylinders, s.gang.stable
    poles = radii(np.linalg.eigvals(np.asarray(s.gang.loop.closed.A)), n)
    gained = np.full(n // 2 + 1, math.nan)
    if stable and s.structured.stable:
        angle, size = small_gain(loop)
        turn = angle * n / (2.0 * np.pi)
        gained = np.array([size[np.abs(turn - q) <= MODE_WIDTH].max() for q in range(n // 2 + 1)])
    modes = []
    for mode in margins.modes:
        held = mode.q > 0 and gains.imbalance == 0.0
        modes.append(
            ModeVerdict(mode.q, float(poles[mode.q]), mode.classical, float(gained[mode.q]), held)
        )
    patterns = np.exp(2j * np.pi * np.arange(n // 2 + 1) / n)
    radius, at = worst_radius(loop)
    return LoopVerdict(
        speed_rpm=s.speed_rpm,
        demand=m.demand,
        gains=gains,
        stable=stable,
        robustly_stable=s.structured.robustly_stable,
        modes=tuple(modes),
        sensitivity_error=float((_size(loop, patterns) / np.abs(m.centre(patterns))).max()),
        worst=(radius, at.get("MAF time constant", math.nan), at.get("MAF delay", math.nan)),
        delay_limit=margins.delay.sensor_delay,
    )


def _size(loop: UncertainLoop, z: ComplexArray) -> FloatArray:
    """Size of all uncertainty as one complex number."""
    m = loop.measurement
    real = sum((np.abs(direction(z)) for direction in m.directions.values()), np.zeros(z.size))
    return np.asarray(real + np.abs(np.asarray(m.weight.system()(z), dtype=complex)))


def _least(values: Iterable[float]) -> float:
    """Smallest of the values; NaN if one of them is."""
    return float(np.min(np.fromiter(values, dtype=float)))
