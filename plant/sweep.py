"""Means over the cylinders of steady cycles, as plain arrays: what the maps are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ._progress import Progress
from .crank_angle import CrankAnglePlant
from .kinematics import FloatArray

__all__ = ["Progress", "SweepResult", "sweep"]


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
    shape = np.broadcast_shapes(*(np.shape(x) for x in (speed_rpm, lift_mm, duration_deg)))
    dataset = plant.steady_cycles(
        speed_rpm,
        lift_mm,
        duration_deg,
        per_cylinder=False,
        threads=threads,
        progress=progress,
    )
    return SweepResult(
        dataset["air_charge"].values.reshape(shape), dataset["pumping_loss"].values.reshape(shape)
    )
