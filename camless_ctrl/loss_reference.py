"""The full plant's least pumping loss about an operating point, by direct search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError
from plant.kinematics import FloatArray

from .least_loss_motion import FeedforwardOptions

_NEAR = np.linspace(0.97, 1.03, 5)  # charges searched, over the demand


@dataclass(frozen=True, eq=False)
class LossReference:
    """Least pumping loss of the full plant over charge, about one demand and speed.

    Attributes
    ----------
    demand, speed_rpm : float
        Operating point: kg, rpm.
    charge : ndarray (k,)
        Charges searched, kg.
    loss : ndarray (k,)
        Least loss at each, J.
    """

    demand: float
    speed_rpm: float
    charge: FloatArray
    loss: FloatArray

    def at(self, charge: ArrayLike) -> FloatArray:
        """Least loss in J at charges in kg, by a parabola through those searched.

        Raises
        ------
        ParameterError
            If a charge is more than 5 % off the demand.
        """
        x = np.asarray(charge, dtype=float) / self.demand - 1.0
        if np.any(np.abs(x) > 0.05):
            worst = float(np.max(np.abs(x)))
            raise ParameterError(
                f"a charge is {100.0 * worst:.1f} % off the demand of {1e6 * self.demand:.0f} mg, "
                "but the least loss is known within 5 %: let the loop settle first"
            )
        fit = np.polynomial.Polynomial.fit(self.charge / self.demand - 1.0, self.loss, 2)
        return np.asarray(fit(x))


def loss_references(
    plant: CrankAnglePlant,
    points: tuple[tuple[float, float], ...],
    options: FeedforwardOptions | None = None,
) -> tuple[LossReference, ...]:
    """Search the least loss of the full plant about operating points.

    Parameters
    ----------
    plant : CrankAnglePlant
        The full plant.
    points : tuple of (float, float)
        Demands in kg and speeds in rpm.
    options : FeedforwardOptions, optional
        Limits of the motions; the default ones if not given.
    """
    from ._path_search import least_loss, refined

    options = FeedforwardOptions() if options is None else options
    demand, speed = np.array(points, dtype=float).T
    charges = demand[:, None] * _NEAR
    longest = min(options.longest_duration_deg, 2.0 * plant.engine.event_angle_deg - 10.0)
    found = least_loss(
        refined(plant),
        charges.ravel(),
        np.repeat(speed, _NEAR.size),
        options,
        np.full(charges.size, longest),
    )
    losses = found.loss.reshape(charges.shape)
    return tuple(
        LossReference(float(m), float(n), charge, loss)
        for m, n, charge, loss in zip(demand, speed, charges, losses, strict=True)
    )
