"""Steady cycles at many operating points, on several threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ._checks import whole
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .valve import ValveCommand

Progress = Callable[[int, int], None]  # called with the points done and the points in all

_CHUNK = 64  # points a task: long enough to hide its cost, short enough to share the work


@dataclass(frozen=True)
class SweepResult:
    """Charge and loss at the points of a sweep, in the order and shape of its points.

    Attributes
    ----------
    air_charge : ndarray
        Mean over the cylinders, kg per event.
    pumping_loss : ndarray
        Mean over the cylinders, J per event.
    """

    air_charge: FloatArray
    pumping_loss: FloatArray

    def __str__(self) -> str:
        """Return the size of the sweep and the range of its results."""
        m, e = 1e6 * self.air_charge, self.pumping_loss
        return (
            f"{m.size} steady cycles: charge {m.min():.1f} to {m.max():.1f} mg, loss "
            f"{e.min():.2f} to {e.max():.2f} J"
        )


def sweep(
    plant: CrankAnglePlant,
    speed_rpm: ArrayLike,
    lift_mm: ArrayLike,
    duration_deg: ArrayLike,
    *,
    threads: int = 2,
    progress: Progress | None = None,
) -> SweepResult:
    """Simulate the steady cycle at each point: opening at TDC, wide open, equal commands.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant.
    speed_rpm, lift_mm, duration_deg : array_like
        Operating points; they broadcast against each other.
    threads : int
        Number of threads; the compiled kernel runs in parallel.
    progress : callable, optional
        Called in the calling thread with the number of points done and the number in all.

    Raises
    ------
    ParameterError, InfeasibleProfileError, ConvergenceError, SimulationError
        As for `CrankAnglePlant.steady_cycle`; the sweep then stops.
    """
    whole("threads", threads, 1, 256)
    speed, lift, duration = np.broadcast_arrays(
        np.asarray(speed_rpm, dtype=float),
        np.asarray(lift_mm, dtype=float),
        np.asarray(duration_deg, dtype=float),
    )
    points = np.column_stack([speed.ravel(), lift.ravel(), duration.ravel()])
    if not len(points):
        raise ParameterError("the sweep has no operating point: give at least one")
    values = np.empty((len(points), 2))
    done = 0
    executor = ThreadPoolExecutor(threads)
    try:
        tasks = {
            executor.submit(_simulate, plant, points[first : first + _CHUNK]): first
            for first in range(0, len(points), _CHUNK)
        }
        for task in as_completed(tasks):
            chunk = task.result()
            values[tasks[task] : tasks[task] + len(chunk)] = chunk
            done += len(chunk)
            if progress is not None:
                progress(done, len(points))
    finally:
        executor.shutdown(cancel_futures=True)
    return SweepResult(values[:, 0].reshape(speed.shape), values[:, 1].reshape(speed.shape))


def _simulate(plant: CrankAnglePlant, points: FloatArray) -> FloatArray:
    values = np.empty((len(points), 2))
    for k, (speed, lift, duration) in enumerate(points):
        cycle = plant.steady_cycle(speed, ValveCommand(lift_mm=lift, duration_deg=duration))
        values[k] = cycle.air_charge.mean(), cycle.pumping_loss.mean()
    return values
