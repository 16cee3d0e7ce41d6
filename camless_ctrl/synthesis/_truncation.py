"""Balanced truncations of the stable part of a system, as a stoppable process computes them.

Truncation (SLICOT AB09MD) keeps the gain at infinite frequency, its variant singular
perturbation (AB09ND) the steady gain. Zhou, Doyle and Glover, *Robust and Optimal Control*, 7.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from ._realisation import FloatArray, Realisation


@dataclass(frozen=True)
class Reductions:
    """Modes kept, Hankel singular values of the rest, and the systems by order and method."""

    kept: int
    hankel: FloatArray
    systems: tuple[tuple[int, str, Realisation], ...]

    def of_order(self, order: int) -> list[tuple[str, Realisation]]:
        """Methods and systems of one order; empty if the minimal order is lower."""
        return [(method, system) for n, method, system in self.systems if n == order]


def reductions_of(K: Realisation, discrete: bool, alpha: float) -> Reductions:
    """All reductions of a system; modes beyond `alpha` are kept.

    Parameters
    ----------
    K : Realisation
        System.
    discrete : bool
        Whether it is discrete.
    alpha : float
        Real part, or modulus, from which on modes are kept.
    """
    if K.order == 0:
        return Reductions(0, np.zeros(0), ())
    import slycot

    n, (p, m) = K.order, K.D.shape
    dico = "D" if discrete else "C"
    # AB09MD with the balancing-free method ("N") overruns its workspace in slycot 0.7.1.
    _, _, _, _, stable, hankel = slycot.ab09md(
        dico, "B", "S", n, m, p, K.A, K.B, K.C, alpha=alpha, tol=0.0
    )
    kept = n - int(stable)
    systems = []
    for order in range(kept, n):
        for method in ("truncation", "singular perturbation"):
            reduced = _reduced(K, order, dico, alpha, method)
            if reduced is not None and reduced.order == order:
                systems.append((order, method, reduced))
    return Reductions(kept, np.array(hankel[: int(stable)], dtype=float), tuple(systems))


def _reduced(
    K: Realisation, order: int, dico: str, alpha: float, method: str
) -> Realisation | None:
    """Reduced system; None where the method fails."""
    import slycot
    from slycot.exceptions import SlycotArithmeticError, SlycotResultWarning

    n, (p, m) = K.order, K.D.shape
    with warnings.catch_warnings():
        # An order beyond the minimal one is lowered; the caller compares the orders.
        warnings.simplefilter("ignore", SlycotResultWarning)
        try:
            if method == "truncation":
                nr, A, B, C, _, _ = slycot.ab09md(
                    dico, "B", "S", n, m, p, K.A, K.B, K.C, alpha=alpha, nr=order
                )
                D = K.D
            else:
                nr, A, B, C, D, _, _ = slycot.ab09nd(
                    dico, "N", "S", n, m, p, K.A, K.B, K.C, K.D, alpha=alpha, nr=order
                )
        except SlycotArithmeticError:
            return None
    k = int(nr)
    return Realisation(
        np.array(A[:k, :k]), np.array(B[:k]), np.array(C[:, :k]), np.array(D, dtype=float)
    )
