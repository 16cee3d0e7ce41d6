"""Cost of maps: points per second, threads, number of points, number of cylinders."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plant import CrankAnglePlant, Engine, OperatingRegion
from plant.batch import _usable_cores

from .kernel_timing import KernelTimer, least_time_us
from .points import NOMINAL_COMMANDS, BenchPoint

THREADS = (1, 2)
LEAST_POINTS = 10
LONGEST_BATCH = 30.0  # s; a batch that would take longer is left out, unless asked for
TIMED_BATCH = 1.0  # s, a batch for the efficiency spans about this on one thread
CYLINDERS = tuple(range(1, 13))
CYLINDER_SPEED_RPM = 1500.0

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ThreadScaling:
    """Map points per second on one thread and on two.

    Attributes
    ----------
    points : int
        Points of the map, spread over the feasible region.
    points_per_second : tuple of float
        On one thread and on two.
    cores : int
        Cores that this process may use.
    """

    points: int
    points_per_second: tuple[float, ...]
    cores: int

    @property
    def efficiency(self) -> float:
        """Gain of two threads over one, per thread."""
        return self.points_per_second[1] / (THREADS[1] * self.points_per_second[0])

    def __str__(self) -> str:
        """Return both rates and the efficiency."""
        one, two = self.points_per_second
        return (
            f"{one:.0f} map points a second on 1 thread, {two:.0f} on 2 (efficiency "
            f"{self.efficiency:.2f}, {self.cores} cores, {self.points} points)"
        )


@dataclass(frozen=True)
class PointScaling:
    """Time of maps of growing size, on all threads.

    Attributes
    ----------
    points : tuple of int
        Sizes.
    seconds : tuple of float
        Times, s.
    left_out : tuple of int
        Sizes that would have taken too long.
    """

    points: tuple[int, ...]
    seconds: tuple[float, ...]
    left_out: tuple[int, ...]

    @property
    def exponent(self) -> float:
        """Slope of log time over log size from 1000 points on (fewer if it ends before).

        1 is linear; NaN with fewer than two sizes.
        """
        large = [k for k, size in enumerate(self.points) if size >= 1000]
        if len(large) < 2:
            large = list(range(len(self.points)))
        if len(large) < 2:
            return math.nan
        x, y = np.log([self.points[k] for k in large]), np.log([self.seconds[k] for k in large])
        return float(np.polyfit(x, y, 1)[0])

    def __str__(self) -> str:
        """Return the largest map and the exponent."""
        return (
            f"{self.points[-1]} points in {self.seconds[-1]:.2f} s; time grows with points to the "
            f"power {self.exponent:.2f}"
        )


@dataclass(frozen=True)
class CylinderScaling:
    """Time of a cycle against the number of cylinders, us."""

    cylinders: tuple[int, ...]
    us_per_cycle: tuple[float, ...]

    def __str__(self) -> str:
        """Return the ends."""
        n, us = self.cylinders, self.us_per_cycle
        return (
            f"{n[0]} cylinders {us[0]:.1f} us a cycle, {n[-1]} cylinders {us[-1]:.1f} us "
            f"({us[-1] / n[-1]:.1f} us each)"
        )


def solve_map(plant: CrankAnglePlant, points: int, threads: int | None) -> float:
    """Solve random points of the feasible map; returns the time in s."""
    region = OperatingRegion(750.0, 6000.0, 0.5, 8.0, 280.0, plant.engine.valvetrain)
    lift, duration, speed = region.sample(points, seed=5)
    started = time.perf_counter()
    plant.steady_cycles(speed, lift, duration, threads=threads)
    return time.perf_counter() - started


def measure_threads(repeats: int) -> ThreadScaling:
    """Time the same map on one thread and on two, in turn; the best of each counts."""
    plant = CrankAnglePlant()
    size = 64
    solve_map(plant, size, 1)  # compiles
    per_point = solve_map(plant, size, 1) / size
    size = max(size, round(TIMED_BATCH / per_point))
    rounds = [[solve_map(plant, size, threads) for threads in THREADS] for _ in range(repeats)]
    least = [min(times) for times in zip(*rounds, strict=True)]
    return ThreadScaling(size, tuple(size / t for t in least), _usable_cores())


def measure_points(most: int | None, progress: Progress | None = None) -> PointScaling:
    """Time maps of 10 points, 100 and so on.

    Parameters
    ----------
    most : int or None
        The largest size; None goes up to a million as long as each takes less than half a
        minute.
    progress : callable, optional
        Called with what is done, how far, and of how much.
    """
    plant = CrankAnglePlant()
    last = 1_000_000 if most is None else most
    sizes = [LEAST_POINTS * 10**k for k in range(6) if LEAST_POINTS * 10**k <= last]
    if last not in sizes:
        sizes.append(last)
    solve_map(plant, LEAST_POINTS, None)  # compiles
    done: list[int] = []
    seconds: list[float] = []
    for k, size in enumerate(sizes):
        if most is None and done and seconds[-1] / done[-1] * size > LONGEST_BATCH:
            break
        if progress is not None:
            progress(f"map of {size} points", k, len(sizes))
        done.append(size)
        seconds.append(solve_map(plant, size, None))
    return PointScaling(tuple(done), tuple(seconds), tuple(sizes[len(done) :]))


def measure_cylinders(repeats: int) -> CylinderScaling:
    """Time a cycle of engines with one cylinder to twelve: Part I's figure 4."""
    times = []
    for n in CYLINDERS:
        point = BenchPoint(CYLINDER_SPEED_RPM, NOMINAL_COMMANDS[1], engine=Engine(n_cylinders=n))
        times.append(least_time_us(KernelTimer(point.cycle()).time, repeats))
    return CylinderScaling(CYLINDERS, tuple(times))
