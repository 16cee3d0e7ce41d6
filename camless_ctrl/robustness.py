"""Verdict on the air-charge loop per speed: poles, margins, uncertainty, and what breaks first.

Everything is gated on the closed-loop poles. Uncertainty of the loop gain is multiplicative;
per mode the loop withstands it if ``|w T| < 1`` (small gain), and since the modes are
orthogonal this also covers errors that differ from cylinder to cylinder and couple them. Lag
and delay of the MAF sensor are swept as parameters: they turn phase, which a bound on gain
would overstate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from plant import CrankAnglePlant, Engine
from plant._checks import in_range
from plant.kinematics import FloatArray
from plant.sensors import MAF_DELAYS, MAF_TIME_CONSTANTS

from .adaptation import AdaptationGains, GainSchedule
from .estimator import ChargeEstimator
from .event_loop import MODE_WIDTH, EventLoop, ModeLoop
from .feedforward import ChargeMap, Feedforward
from .linearise import LocalResponse, local_response
from .margins import StabilityMargins, margins_of_response

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPEEDS_RPM = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)
# Demands of medium load that the scheduled lift reaches without overlap of events, mg.
DEMAND_SPEEDS_RPM, DEMANDS_MG = (750.0, 3000.0, 4500.0, 6000.0), (250.0, 250.0, 190.0, 130.0)
LONGEST_DELAY = 0.02  # s, up to which a limit is sought
MAF_NOMINAL = (0.015, 0.001)  # s, lag and delay
_THETA = 2.0 * np.pi * np.linspace(-MODE_WIDTH, MODE_WIDTH, 1201)  # rad per cycle

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class ModeVerdict:
    """One circulant mode of the nominal loop."""

    q: int
    spectral_radius: float  # per cycle
    margins: StabilityMargins
    small_gain: float  # max |w T|
    held: bool  # not adapted, so that there is nothing to destabilise

    @property
    def name(self) -> str:
        """What the mode is."""
        if self.q == 0:
            return "mean"
        return f"imbalance q={self.q}" + (" (held)" if self.held else "")


@dataclass(frozen=True)
class RobustnessResult:
    """Robustness of the loop at one speed.

    Attributes
    ----------
    speed_rpm, demand : float
        Operating point: rpm, kg.
    gains : AdaptationGains
        Gains per cycle.
    estimator : ChargeEstimator
        Estimator.
    local : LocalResponse
        Full plant around the point.
    stable : bool
        Whether the nominal loop is stable.
    modes : tuple of ModeVerdict
        The modes of the nominal loop.
    sensitivity_error : float
        Bound ``w`` on the relative error of the loop gain, 1.
    time_constants, delays : ndarray (a,), (b,)
        MAF lags and delays swept, s.
    radius : ndarray (a, b)
        Spectral radius per cycle at each of them, the gain anywhere within its bound.
    delay_limit, delay_limit_mode : float, int
        Delay at which the loop with nominal lag first is unstable, s (infinite if above
        `LONGEST_DELAY`), and the mode that breaks.
    """

    speed_rpm: float
    demand: float
    gains: AdaptationGains
    estimator: ChargeEstimator
    local: LocalResponse = field(repr=False)
    stable: bool
    modes: tuple[ModeVerdict, ...]
    sensitivity_error: float
    time_constants: FloatArray = field(repr=False)
    delays: FloatArray = field(repr=False)
    radius: FloatArray = field(repr=False)
    delay_limit: float
    delay_limit_mode: int

    @property
    def small_gain(self) -> float:
        """Largest ``|w T|`` of any mode; NaN if unstable."""
        return max((mode.small_gain for mode in self.modes), default=math.nan)

    @property
    def withstands_gain_error(self) -> bool:
        """Whether the nominal loop withstands every gain error within the bound."""
        return self.stable and self.small_gain < 1.0

    @property
    def withstands_sensor(self) -> bool:
        """Whether the loop is stable at every lag, delay and gain swept."""
        return bool(np.all(self.radius < 1.0))

    @property
    def robustly_stable(self) -> bool:
        """Whether it withstands both."""
        return self.withstands_gain_error and self.withstands_sensor

    @property
    def worst(self) -> tuple[float, float, float]:
        """Largest spectral radius swept, with its lag and delay (s)."""
        a, b = np.unravel_index(int(np.argmax(self.radius)), self.radius.shape)
        return (
            float(self.radius[a, b]),
            float(self.time_constants[a]),
            float(self.delays[b]),
        )

    @property
    def gain_margin(self) -> float:
        """Smallest gain margin of a mode, a ratio; NaN if unstable."""
        return min(mode.margins.gain_margin for mode in self.modes)

    @property
    def disk_margin(self) -> float:
        """Smallest disk margin of a mode; NaN if unstable."""
        return min(mode.margins.disk_margin for mode in self.modes)

    @property
    def sensitivity_peak(self) -> float:
        """Largest ``|S|`` of a mode; NaN if unstable."""
        return max(mode.margins.sensitivity_peak for mode in self.modes)

    def loop(self, **sensor: float) -> EventLoop:
        """Return the loop, with a `time_constant`, `delay` (s) or `sensitivity` of choice."""
        values = {"time_constant": MAF_NOMINAL[0], "delay": MAF_NOMINAL[1], **sensor}
        return EventLoop.at_speed(
            self.speed_rpm,
            self.estimator,
            self.gains,
            n_cylinders=self.local.n_cylinders,
            shape=self.local.shape,
            **{"sensitivity": self.local.sensitivity, **values},
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the spectral radius of each mode against MAF delay, at the lags swept."""
        from plant._plotting import COLOURS, axes, styled

        delays = np.linspace(0.0, 1.6 * float(self.delays[-1]), 33)
        with styled():
            ax = axes(ax)
            for tau, line in zip(
                (self.time_constants[0], MAF_NOMINAL[0], self.time_constants[-1]),
                (":", "-", "--"),
                strict=True,
            ):
                radii = np.array(
                    [[mode.spectral_radius for mode in self._modes(tau, d, 1.0)] for d in delays]
                )
                for mode, radius in zip(self.modes, radii.T, strict=True):
                    label = mode.name if line == "-" else None
                    ax.plot(1e3 * delays, radius, line, c=COLOURS[mode.q % 7], label=label, lw=1.4)
            ax.axhline(1.0, c="0.3", lw=0.9)
            ax.axvspan(
                1e3 * self.delays[0], 1e3 * self.delays[-1], color="0.92", zorder=0, label="assumed"
            )
            ax.set_xlabel("MAF transport delay (ms)")
            ax.set_ylabel("spectral radius per cycle (1)")
            lags = [
                1e3 * self.time_constants[0],
                1e3 * MAF_NOMINAL[0],
                1e3 * self.time_constants[-1],
            ]
            ax.set_title(
                f"{self.speed_rpm:g} rpm; lag {lags[0]:g} (dotted), {lags[1]:g}, {lags[2]:g} ms "
                "(dashed)"
            )
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return the verdict in plain words."""
        point = f"{self.speed_rpm:g} rpm, {1e6 * self.demand:.0f} mg"
        if not self.stable:
            broken = [mode.name for mode in self.modes if not mode.spectral_radius < 1.0]
            return (
                f"{point}: unstable with the nominal sensor in mode {', '.join(broken)}; no margin"
            )
        radius, tau, delay = self.worst
        sensor = (
            f"stable at every lag and delay (radius {radius:.3f} at worst)"
            if self.withstands_sensor
            else f"NOT stable at every lag and delay: radius {radius:.3f} at lag "
            f"{1e3 * tau:.0f} ms, delay {1e3 * delay:.1f} ms"
        )
        limit = (
            f"no break up to a delay of {1e3 * LONGEST_DELAY:g} ms"
            if math.isinf(self.delay_limit)
            else f"breaks first in mode q={self.delay_limit_mode} at a delay of "
            f"{1e3 * self.delay_limit:.1f} ms"
        )
        return (
            f"{point}: stable; gain margin {self.gain_margin:.1f}, disk margin "
            f"{self.disk_margin:.2f}, peak |S| {self.sensitivity_peak:.2f}; gain error "
            f"{100.0 * self.sensitivity_error:.0f} %: |wT| {self.small_gain:.2f} "
            f"({'withstood' if self.withstands_gain_error else 'NOT withstood'}); {sensor}; {limit}"
        )

    def _modes(self, time_constant: float, delay: float, gain: float) -> tuple[ModeLoop, ...]:
        loop = self.loop(
            time_constant=time_constant,
            delay=delay,
            sensitivity=gain * self.local.sensitivity,
        )
        return loop.modes()


def demand_at(speed_rpm: float) -> float:
    """Demand in kg at which a speed is analysed unless told otherwise."""
    return 1e-6 * float(np.interp(speed_rpm, DEMAND_SPEEDS_RPM, DEMANDS_MG))


def sensitivity_error(
    feedforward: Feedforward, demand: float, speed_rpm: float, engine: Engine, nominal: float
) -> float:
    """Bound on the relative error of the loop gain over plants that differ from the nominal.

    Differentiates full plants with and without runner and oscillation, and with all flow
    coefficients 15 % low and 5 % high.

    Parameters
    ----------
    feedforward : Feedforward
        The map.
    demand, speed_rpm : float
        Operating point: kg, rpm.
    engine : Engine
        The engine.
    nominal : float
        Sensitivity of the nominal plant over the map's.
    """
    variants = [
        (engine.replace(flow_coefficient=scale * engine.flow_coefficient), runner, oscillation)
        for scale, runner, oscillation in (
            (1.0, False, False),
            (1.0, True, False),
            (1.0, False, True),
            (0.85, True, True),
            (1.05, True, True),
        )
    ]
    ratios = [
        local_response(
            CrankAnglePlant(e, runner=r, oscillation=o), feedforward, demand, speed_rpm
        ).sensitivity
        / nominal
        for e, r, o in variants
    ]
    return max(abs(ratio - 1.0) for ratio in ratios)


def analyse(
    charge_map: ChargeMap,
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    *,
    engine: Engine | None = None,
    estimator: ChargeEstimator | None = None,
    gains: GainSchedule | None = None,
    demand: Callable[[float], float] = demand_at,
    gain_error: Mapping[float, float] | None = None,
    progress: Progress | None = None,
) -> list[RobustnessResult]:
    """Analyse the loop at several speeds.

    Parameters
    ----------
    charge_map : ChargeMap
        Map that the controller believes, such as a `plant.MeanValuePlant`.
    speeds_rpm : sequence of float
        Speeds.
    engine : Engine, optional
        The engine; the paper's by default.
    estimator : ChargeEstimator, optional
        The estimator; the default one if not given.
    gains : GainSchedule, optional
        The gains; the default schedule if not given.
    demand : callable
        Charge in kg against speed in rpm.
    gain_error : mapping of float to float, optional
        Bound on the relative error of the loop gain at each speed; by default that of
        `sensitivity_error`, measured on full plants.
    progress : callable, optional
        Called with the number of speeds done and the number in all.
    """
    engine = Engine.paper() if engine is None else engine
    estimator = ChargeEstimator() if estimator is None else estimator
    schedule = GainSchedule() if gains is None else gains
    feedforward = Feedforward(charge_map, valvetrain=engine.valvetrain)
    nominal = CrankAnglePlant(engine, runner=True, oscillation=True)
    results = []
    for k, speed in enumerate(speeds_rpm):
        charge = demand(speed)
        local = local_response(nominal, feedforward, charge, speed)
        bound = (
            sensitivity_error(feedforward, charge, speed, engine, local.sensitivity)
            if gain_error is None
            else gain_error[speed]
        )
        results.append(analyse_point(local, charge, estimator, schedule.at(speed), bound))
        if progress is not None:
            progress(k + 1, len(speeds_rpm))
    return results


def analyse_point(
    local: LocalResponse,
    demand: float,
    estimator: ChargeEstimator,
    gains: AdaptationGains,
    gain_error: float,
    *,
    points: tuple[int, int] = (5, 13),
) -> RobustnessResult:
    """Analyse the loop around one operating point of the full plant.

    Parameters
    ----------
    local : LocalResponse
        Full plant around the point.
    demand : float
        Charge, kg.
    estimator, gains
        The controller.
    gain_error : float
        Bound on the relative error of the loop gain, 1.
    points : (int, int)
        Lags and delays in the sweep of the assumed ranges.
    """
    in_range("gain_error", gain_error, 0.0, 10.0, "1")
    lags, delays = np.linspace(*MAF_TIME_CONSTANTS, points[0]), np.linspace(*MAF_DELAYS, points[1])
    result = RobustnessResult(
        speed_rpm=local.speed_rpm,
        demand=demand,
        gains=gains,
        estimator=estimator,
        local=local,
        stable=False,
        modes=(),
        sensitivity_error=gain_error,
        time_constants=lags,
        delays=delays,
        radius=np.empty((0, 0)),
        delay_limit=math.nan,
        delay_limit_mode=0,
    )
    nominal = result.loop()
    modes = nominal.modes()
    stable = all(mode.stable for mode in modes)
    radius = np.array(
        [
            [
                max(
                    mode.spectral_radius
                    for gain in (1.0 - gain_error, 1.0, 1.0 + gain_error)
                    for mode in result._modes(tau, delay, gain)
                )
                for delay in delays
            ]
            for tau in lags
        ]
    )
    limit, q = _delay_limit(result)
    return replace(
        result,
        stable=stable,
        modes=tuple(_verdict(mode, stable, gain_error) for mode in modes),
        radius=radius,
        delay_limit=limit,
        delay_limit_mode=q,
    )


def _verdict(mode: ModeLoop, stable: bool, gain_error: float) -> ModeVerdict:
    found = margins_of_response(mode, _THETA, stable)
    held = mode.q > 0 and mode.loop.gains.imbalance == 0.0
    small_gain = gain_error * found.complementary_peak
    return ModeVerdict(mode.q, mode.spectral_radius, found, small_gain, held)


def _delay_limit(result: RobustnessResult) -> tuple[float, int]:
    """Smallest delay at which the loop with nominal lag is unstable, s, and the mode."""

    def broken(delay: float) -> ModeLoop | None:
        modes = result._modes(MAF_NOMINAL[0], delay, 1.0)
        worst = max(modes, key=lambda mode: mode.spectral_radius)
        return None if worst.spectral_radius < 1.0 else worst

    grid = np.linspace(0.0, LONGEST_DELAY, 81)
    for low, high in itertools.pairwise(grid):
        mode = broken(high)
        if mode is None:
            continue
        for _ in range(20):
            middle = 0.5 * (low + high)
            at_middle = broken(middle)
            if at_middle is None:
                low = middle
            else:
                high, mode = middle, at_middle
        return float(high), mode.q
    return math.inf, 0
