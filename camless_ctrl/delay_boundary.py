"""MAF delay and lag at which the imbalance modes lose stability, over speed: two estimators.

The plain event average sees the flow of one cylinder late and smeared, so that the differences
between cylinders turn out of phase at a delay that falls with speed. The crank-resolved window
undoes the assumed lag and delay and moves that boundary out. Predicted by the poles of the
event loop, and found again on the full plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from plant import CrankAnglePlant, MafSensor
from plant._checks import in_range, one_of, positive
from plant.kinematics import FloatArray
from plant.sensors import MAF_DELAYS, MAF_TIME_CONSTANTS

from ._closed_loop_runs import LoopCase, at_speed, in_processes, step_response
from ._step_response import mode_growth
from .adaptation import GainSchedule
from .estimator import ChargeEstimator
from .event_loop import EventLoop
from .feedforward import Feedforward
from .linearise import LocalResponse, local_response
from .robustness import MAF_NOMINAL, demand_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Quantity = Literal["delay", "lag"]

SPEEDS_RPM = (750.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 3500.0, 4000.0, 4500.0, 5000.0, 6000.0)
# Gains that adapt the differences at every speed, which the default ones do not above 5000 rpm.
ADAPTING = GainSchedule(
    (750.0, 1500.0, 3000.0, 6000.0), (0.4, 0.4, 0.3, 0.2), (0.4, 0.4, 0.2, 0.08)
)
LONGEST = {"delay": 0.06, "lag": 0.2}  # s, up to which a limit is sought
_SHORTEST = {"delay": 0.0, "lag": 1e-4}  # s
_NAMES = {"delay": "MAF transport delay", "lag": "MAF time constant"}
_POINTS = 61
# From a predicted limit to the runs beside it: s, or (a lag acts slowly) a share of the limit.
_NEAR_DELAY, _NEAR_LAG = 0.3e-3, 0.2
_SIMULATED = (
    (1000.0, 1),
    (1500.0, 2),
    (3000.0, 2),
    (3000.0, 1),
    (6000.0, 2),
)  # speeds and modes of the runs

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class BoundaryRun:
    """Growth of one mode on the full plant near a predicted boundary."""

    estimator: str
    speed_rpm: float
    q: int
    value: float  # s, delay or lag
    predicted: float  # growth per cycle
    simulated: float  # growth per cycle

    @property
    def stable(self) -> bool:
        """Whether the mode decays on the full plant."""
        return self.simulated < 1.0

    @property
    def agrees(self) -> bool:
        """Whether prediction and run agree on that."""
        return self.stable == (self.predicted < 1.0)

    def __str__(self) -> str:
        """Return point, prediction and outcome."""
        return (
            f"{self.estimator}, {self.speed_rpm:g} rpm, q={self.q}, {1e3 * self.value:.2f} ms: "
            f"predicted {self.predicted:.4f} per cycle, full plant {self.simulated:.4f} "
            f"({'as predicted' if self.agrees else 'NOT as predicted'})"
        )


@dataclass(frozen=True)
class DelayBoundary:
    """Largest MAF delay (or lag) up to which each imbalance mode is stable.

    Attributes
    ----------
    quantity : str
        ``"delay"`` or ``"lag"``.
    other : float
        The other one of the two, s.
    speeds_rpm : ndarray (k,)
        Speeds.
    modes : tuple of int
        The modes.
    limits : dict of str to ndarray (modes, k)
        Predicted limit with each estimator, s: 0 where the mode is unstable from the start,
        infinite where it is stable up to `LONGEST`.
    runs : tuple of BoundaryRun
        Runs of the full plant beside the limits.
    """

    quantity: Quantity
    other: float
    speeds_rpm: FloatArray = field(repr=False)
    modes: tuple[int, ...]
    limits: dict[str, FloatArray] = field(repr=False)
    runs: tuple[BoundaryRun, ...] = field(repr=False)

    @property
    def agreeing(self) -> int:
        """Number of runs that came out as predicted."""
        return sum(run.agrees for run in self.runs)

    def __str__(self) -> str:
        """Return the limits over speed and the runs that disagree."""
        other = "lag" if self.quantity == "delay" else "delay"
        lines = [
            f"{_NAMES[self.quantity]} up to which the modes are stable ({other} "
            f"{1e3 * self.other:g} ms); {self.agreeing} of {len(self.runs)} runs of the full plant "
            "beside the limits as predicted"
        ]
        for name, limits in self.limits.items():
            for q, row in zip(self.modes, limits, strict=True):
                text = ", ".join(
                    f"{speed:g}: {_words(limit, self.quantity)}"
                    for speed, limit in zip(self.speeds_rpm, row, strict=True)
                )
                lines.append(f"  {name}, q={q} (rpm: ms): {text}")
        return "\n".join(lines + [f"  {run}" for run in self.runs if not run.agrees])

    def plot(self) -> Figure:
        """Draw the predicted limits over speed and the runs, an axes for each estimator."""
        import matplotlib.pyplot as plt

        from plant._plotting import COLOURS, styled

        assumed = MAF_DELAYS if self.quantity == "delay" else MAF_TIME_CONSTANTS
        with styled():
            figure, row = plt.subplots(
                1, len(self.limits), sharex=True, sharey=True, squeeze=False, figsize=(9.6, 3.8)
            )
            for ax, (name, limits) in zip(row[0], self.limits.items(), strict=True):
                for k, (q, limit) in enumerate(zip(self.modes, limits, strict=True)):
                    shown = np.where(np.isfinite(limit) & (limit > 0.0), 1e3 * limit, np.nan)
                    line, mark, colour = ("-", "--")[k % 2], "os"[k % 2], COLOURS[k]
                    ax.plot(self.speeds_rpm, shown, line, c=colour, label=f"q={q}, predicted")
                    for stable, fill, word in ((True, colour, "decays"), (False, "w", "grows")):
                        runs = [
                            run
                            for run in self.runs
                            if (run.estimator, run.q, run.stable) == (name, q, stable)
                        ]
                        ax.plot(
                            [run.speed_rpm for run in runs],
                            [1e3 * run.value for run in runs],
                            mark,
                            c=colour,
                            mfc=fill,
                            label=f"q={q}, full plant {word}",
                        )
                ax.set_yscale("log")
                ax.yaxis.set_major_formatter("{x:g}")
                ax.set_xlabel("engine speed (rpm)")
                ax.set_title(name)
            low, high = row[0, 0].get_ylim()  # of all
            for ax in row[0]:
                bottom = max(1e3 * assumed[0], low)
                ax.axhspan(bottom, 1e3 * assumed[1], color="0.93", zorder=0, label="assumed range")
                ax.set_ylim(low, high)
            row[0, 0].set_ylabel(f"{_NAMES[self.quantity]} (ms)")
            row[0, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return figure


def default_estimators() -> dict[str, ChargeEstimator]:
    """Return the event average and the crank-resolved window."""
    return {
        "event average": ChargeEstimator.event_average(),
        "crank-resolved window": ChargeEstimator(),
    }


def delay_boundary(
    feedforward: Feedforward,
    *,
    quantity: Quantity = "delay",
    gains: GainSchedule = ADAPTING,
    estimators: dict[str, ChargeEstimator] | None = None,
    plant: CrankAnglePlant | None = None,
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    simulated: Sequence[tuple[float, int]] = _SIMULATED,
    near: float | None = None,
    cycles: int = 40,
    demand: Callable[[float], float] = demand_at,
    processes: int = 2,
    progress: Progress | None = None,
) -> DelayBoundary:
    """Find where the imbalance modes lose stability, predicted and on the full plant.

    Parameters
    ----------
    feedforward : Feedforward
        Map that the controller believes.
    quantity : {"delay", "lag"}
        What is varied of the sensor; the other one stays nominal.
    gains : GainSchedule
        Gains; those for the differences must not be zero.
    estimators : dict of str to ChargeEstimator, optional
        Estimators by name; `default_estimators` if not given.
    plant : CrankAnglePlant, optional
        The plant, its cylinders equal; the paper's with runner and oscillation by default.
    speeds_rpm : sequence of float
        Speeds of the prediction.
    simulated : sequence of (float, int)
        Speeds and modes that are run on the full plant on both sides of each limit, with every
        estimator. Limits that are 0 or infinite have no two sides, and a side that would lie
        beyond the range is left out.
    near : float, optional
        Distance of the runs from the predicted limit, s; 0.3 ms of delay, or a fifth of the
        limit of a lag.
    cycles : int
        Length of a run.
    demand : callable
        From speed to charge in kg.
    processes : int
        Number of processes.
    progress : callable, optional
        Called with the number of runs done and the number in all.

    Raises
    ------
    ParameterError
        If the differences are held at a speed.
    """
    one_of("quantity", quantity, LONGEST)
    if near is not None:
        positive("near", near, "s")
    plant = CrankAnglePlant(runner=True, oscillation=True) if plant is None else plant
    estimators = default_estimators() if estimators is None else estimators
    modes = tuple(range(1, plant.engine.n_cylinders // 2 + 1))
    wanted = dict.fromkeys([*speeds_rpm, *(speed for speed, _ in simulated)])
    for speed in wanted:
        in_range(
            f"gain of the differences at {speed:g} rpm",
            gains.at(speed).imbalance,
            0.0,
            100.0,
            "1",
            open_low=True,
            remedy="differences that are held have no limit",
        )
    points = {speed: local_response(plant, feedforward, demand(speed), speed) for speed in wanted}
    found: dict[tuple[str, float], dict[int, float]] = {}
    for name, estimator in estimators.items():
        for speed, local in points.items():
            growth = _Growth(local, estimator, gains, quantity)
            found[name, speed] = {q: growth.limit(q) for q in modes}
    cases, told = [], []
    for name, estimator in estimators.items():
        for speed, q in simulated:
            limit = found[name, speed][q]
            aside = near if near is not None else _NEAR_DELAY
            if near is None and quantity == "lag":
                aside = _NEAR_LAG * limit
            for value in (limit - aside, limit + aside):
                if not (0.0 < limit < math.inf and value > _SHORTEST[quantity]):
                    continue
                sensor = _sensor(quantity, value)
                predicted = _Growth(points[speed], estimator, gains, quantity)(value)[q]
                told.append((name, speed, q, value, predicted))
                cases.append(
                    LoopCase(
                        plant,
                        MafSensor(time_constant=sensor[0], delay=sensor[1]).ideal(),
                        at_speed(feedforward, speed),
                        estimator,
                        gains.at(speed),
                        demand(speed),
                        speed,
                        cycles=cycles,
                    )
                )
    responses = in_processes(step_response, cases, processes, progress)
    return DelayBoundary(
        quantity=quantity,
        other=MAF_NOMINAL[0 if quantity == "delay" else 1],
        speeds_rpm=np.array(speeds_rpm, dtype=float),
        modes=modes,
        limits={
            name: np.array([[found[name, speed][q] for speed in speeds_rpm] for q in modes])
            for name in estimators
        },
        runs=tuple(
            BoundaryRun(*point, response.growth(point[2]))
            for point, response in zip(told, responses, strict=True)
        ),
    )


class _Growth:
    """Predicted growth per cycle of the modes against delay or lag."""

    def __init__(
        self,
        local: LocalResponse,
        estimator: ChargeEstimator,
        gains: GainSchedule,
        quantity: Quantity,
    ) -> None:
        self.local, self.estimator, self.quantity = local, estimator, quantity
        self.gains = gains.at(local.speed_rpm)
        self.known: dict[float, list[float]] = {}

    def __call__(self, value: float) -> list[float]:
        """Growth of each mode ``q = 0 ... n/2``."""
        if value not in self.known:
            local, n = self.local, self.local.n_cylinders
            time_constant, delay = _sensor(self.quantity, value)
            loop = EventLoop.at_speed(
                local.speed_rpm,
                self.estimator,
                self.gains,
                n_cylinders=n,
                sensitivity=local.sensitivity,
                shape=local.shape,
                time_constant=time_constant,
                delay=delay,
            )
            poles = loop.poles()
            self.known[value] = [mode_growth(poles, q, n) for q in range(n // 2 + 1)]
        return self.known[value]

    def limit(self, q: int) -> float:
        """First value at which a mode is unstable; infinite if there is none."""
        low = _SHORTEST[self.quantity]
        if self(low)[q] >= 1.0:
            return 0.0
        for high in np.linspace(low, LONGEST[self.quantity], _POINTS)[1:].tolist():
            if self(high)[q] >= 1.0:
                break
            low = high
        else:
            return math.inf
        while high - low > 1e-6:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self(middle)[q] < 1.0 else (low, middle)
        return float(high)


def _sensor(quantity: Quantity, value: float) -> tuple[float, float]:
    """Lag and delay, s."""
    lag, delay = MAF_NOMINAL
    return (value if quantity == "lag" else lag, value if quantity == "delay" else delay)


def _words(limit: float, quantity: Quantity) -> str:
    if limit == 0.0:
        return "never"
    if math.isinf(limit):
        return f"above {1e3 * LONGEST[quantity]:g}"
    return f"{1e3 * limit:.2f}"
