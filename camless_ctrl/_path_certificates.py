"""Certificates of the optimal path: proven optimum of every node, and the price of smoothness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from plant.kinematics import FloatArray

from .least_loss_motion import OPTIMALITY, OptimalMotion

CONSTRAINTS = (
    "lowest lift",
    "highest lift",
    "shortest duration",
    "longest map duration",
    "longest duration",
    "authority",
    "dwell",
)
UNITS = {
    "optimal_lift_mm": "mm",
    "optimal_duration_deg": "deg",
    "optimal_cost": "J",
    "marginal_cost": "J/kg",
    "gradient": "1",
    "violation": "1",
    "complementarity": "1",
    "given_up": "1",
}


@dataclass(frozen=True, eq=False)
class PathCertificates:
    """Optimum of each node (s, q), alone, with its first-order proof."""

    optimal_lift_mm: FloatArray  # (s, q) mm
    optimal_duration_deg: FloatArray  # (s, q) deg
    optimal_cost: FloatArray  # (s, q) J per event, loss and penalties
    marginal_cost: FloatArray  # (s, q) J/kg, multiplier of the charge
    gradient: FloatArray  # (s, q) 1, of the Lagrangian, scaled
    violation: FloatArray  # (s, q) 1, of the constraints, scaled
    complementarity: FloatArray  # (s, q) 1
    given_up: FloatArray  # (s, q) 1, cost of the path over that of the optimum, less 1
    active: np.ndarray  # (s, q, 7) bool, the constraints of CONSTRAINTS that bind
    status: np.ndarray  # (s, q) str, as IPOPT words it

    @classmethod
    def of(cls, motions: list[list[OptimalMotion]], cost: FloatArray) -> Self:
        """Gather the optima of the nodes, and what the path's cost (s, q) in J is above them."""

        def gathered(what: str) -> FloatArray:
            return np.array([[getattr(m, what) for m in row] for row in motions], dtype=float)

        def proof(what: str) -> FloatArray:
            values = [[getattr(m.certificate, what) for m in row] for row in motions]
            return np.array(values, dtype=float)

        optimal = gathered("cost")
        return cls(
            gathered("lift_mm"),
            gathered("duration_deg"),
            optimal,
            gathered("marginal_cost"),
            proof("gradient"),
            proof("violation"),
            proof("complementarity"),
            (cost - optimal) / np.abs(optimal),
            np.array(
                [[[n in m.certificate.active for n in CONSTRAINTS] for m in r] for r in motions]
            ),
            np.array([[m.certificate.status for m in row] for row in motions]),
        )

    @property
    def optimal(self) -> np.ndarray:
        """Whether each node's optimum is proven, bool (s, q)."""
        worst = np.maximum(np.maximum(self.gradient, self.violation), self.complementarity)
        return worst <= OPTIMALITY

    def active_names(self, i: int, j: int) -> tuple[str, ...]:
        """Names of the inequalities that bind at a node."""
        return tuple(n for n, on in zip(CONSTRAINTS, self.active[i, j], strict=True) if on)

    def __str__(self) -> str:
        """Return how many are proven, what binds and what is given up."""
        proven = self.optimal
        bind = [
            f"{name} {int(self.active[..., k].sum())}"
            for k, name in enumerate(CONSTRAINTS)
            if self.active[..., k].any()
        ]
        above = int((self.given_up > 5e-3).sum())
        return (
            f"{int(proven.sum())} of {proven.size} nodes proven optimal (gradient at most "
            f"{self.gradient.max():.1e}, violation {self.violation.max():.1e}); active: "
            f"{', '.join(bind) or 'none'}; given up for continuity: median "
            f"{100.0 * float(np.median(self.given_up)):z.3f} %, more than 0.5 % at {above} nodes, "
            f"{100.0 * self.given_up.max():z.2f} % at most"
        )
