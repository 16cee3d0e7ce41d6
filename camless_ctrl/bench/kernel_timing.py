"""Time and error of the plant's kernel at operating points."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from plant import CrankAnglePlant, Cycle, ValveCommand
from plant._layout import STEPS
from plant.kinematics import FloatArray

from .points import BenchPoint
from .reference import Reference

SPEED_EDGES_RPM = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)
SHORTEST_TIMING = 1e-3  # s, a timing spans at least this


@dataclass(frozen=True)
class KernelFigures:
    """What the kernel does at one point.

    Attributes
    ----------
    point : BenchPoint
        The point.
    us_per_cycle : float
        Time of a cycle, us.
    steps_per_cycle : float
        Steps that the kernel takes or tries in a cycle.
    charge_error, loss_error : float
        Errors of the kernel's own periodic cycle against the reference; NaN if not compared.
    """

    point: BenchPoint
    us_per_cycle: float
    steps_per_cycle: float
    charge_error: float = float("nan")
    loss_error: float = float("nan")

    def __str__(self) -> str:
        """Return point, time and errors."""
        return (
            f"{self.point}: {self.us_per_cycle:.1f} us, charge {100 * self.charge_error:.4f} %, "
            f"loss {100 * self.loss_error:.4f} %"
        )


@dataclass(frozen=True)
class KernelSurvey:
    """Figures of the kernel at many points of the map."""

    figures: tuple[KernelFigures, ...]

    @property
    def worst_charge(self) -> KernelFigures:
        """The point of the largest charge error."""
        return max(self.figures, key=lambda found: found.charge_error)

    @property
    def worst_loss(self) -> KernelFigures:
        """The point of the largest loss error."""
        return max(self.figures, key=lambda found: found.loss_error)

    @property
    def slowest(self) -> KernelFigures:
        """The point of the longest time."""
        return max(self.figures, key=lambda found: found.us_per_cycle)

    @property
    def median_us(self) -> float:
        """Median time of a cycle, us."""
        return float(np.median([found.us_per_cycle for found in self.figures]))

    def by_speed(self) -> list[tuple[float, float, int, float, float]]:
        """Lowest and highest speed in rpm, number of points, median and worst time in us."""
        rows = []
        for low, high in pairwise(SPEED_EDGES_RPM):
            last = high == SPEED_EDGES_RPM[-1]
            times = [
                f.us_per_cycle
                for f in self.figures
                if low <= f.point.speed_rpm < high or (last and f.point.speed_rpm == high)
            ]
            if times:
                rows.append((low, high, len(times), float(np.median(times)), max(times)))
        return rows

    def __str__(self) -> str:
        """Return the worst points."""
        return (
            f"{len(self.figures)} points: charge error at most "
            f"{100 * self.worst_charge.charge_error:.4f} % ({self.worst_charge.point}), loss error "
            f"at most {100 * self.worst_loss.loss_error:.4f} % ({self.worst_loss.point}); median "
            f"{self.median_us:.1f} us a cycle, at most {self.slowest.us_per_cycle:.1f} us "
            f"({self.slowest.point})"
        )


class KernelTimer:
    """Runs of the kernel from the periodic state of a cycle, traces off.

    Parameters
    ----------
    cycle : Cycle
        The cycle.
    """

    def __init__(self, cycle: Cycle) -> None:
        plant, state = cycle.plant, cycle.state
        self._plant, self._state = plant, state
        area = plant.engine.throttle.area(cycle.throttle_deg)
        self._window = plant._window(cycle.speed_rpm, area, 0)
        self._commands: FloatArray = np.array(
            [
                (lift, c.duration_deg, c.opening_deg + state.event_advance_deg)
                for lift, c in zip(cycle.delivered_lift_mm, cycle.commands, strict=True)
            ]
        )
        self.time(1)  # compiles, and warms the caches
        self._enough = max(1, round(SHORTEST_TIMING / self.time(2)))

    def time(self, count: int | None = None) -> float:
        """Time of a cycle in s, of so many in one call from Python: as many as a clock can time."""
        count = self._enough if count is None else count
        return self._run(count)[0] / count

    def steps(self) -> float:
        """Steps that the kernel takes or tries in a cycle."""
        return self._run(10)[1] / 10.0

    def _run(self, count: int) -> tuple[float, float]:
        plant, state = self._plant, self._state
        cylinders, manifold = state.cylinders.copy(), state.manifold.copy()
        no_trace = np.empty((plant._trace_rows, 0))
        started = time.perf_counter()
        plant._advance_cycles(
            self._window,
            self._commands,
            state.event_advance_deg,
            cylinders,
            manifold,
            no_trace,
            count,
        )
        spent = time.perf_counter() - started
        return spent, float(manifold[STEPS] - state.manifold[STEPS])


def time_call(repeats: int) -> float:
    """What a call from Python takes, us: a cycle in which all valves stay shut, less the cycle."""
    timer = KernelTimer(CrankAnglePlant().steady_cycle(1500.0, ValveCommand(0.0, 90.0)))
    called = least_time_us(lambda: timer.time(1), 100 * repeats)
    return called - least_time_us(timer.time, repeats)


def least_time_us(timer: Callable[[], float], repeats: int) -> float:
    """Least of several timings, us: what disturbs a timing only ever adds to it."""
    return 1e6 * min(timer() for _ in range(repeats))


def time_kernel(points: Sequence[BenchPoint], repeats: int) -> tuple[KernelFigures, ...]:
    """Time the kernel at points, without errors."""
    return tuple(_timed(KernelTimer(point.cycle()), point, repeats) for point in points)


def survey_kernel(
    references: Sequence[Reference],
    repeats: int,
    progress: Callable[[int, int], None] | None = None,
) -> KernelSurvey:
    """Time the kernel at the references' points, and compare its periodic cycles with them."""
    figures = []
    for k, reference in enumerate(references):
        if progress is not None:
            progress(k, len(references))
        cycle = reference.point.cycle()
        errors = reference.errors(cycle.air_charge, cycle.pumping_loss)
        figures.append(_timed(KernelTimer(cycle), reference.point, repeats, *errors))
    return KernelSurvey(tuple(figures))


def _timed(timer: KernelTimer, point: BenchPoint, repeats: int, *errors: float) -> KernelFigures:
    return KernelFigures(point, least_time_us(timer.time, repeats), timer.steps(), *errors)
