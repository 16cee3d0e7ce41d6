"""State-space algebra of synthesis in plain matrices: partition, closing, bilinear transform.

A process that solves a problem imports this, but not the control library: its start would
take longer than the solution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.errors import ParameterError

if TYPE_CHECKING:
    import control

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class Realisation(NamedTuple):
    """Matrices of a system with n states, m inputs and p outputs."""

    A: FloatArray  # (n, n)
    B: FloatArray  # (n, m)
    C: FloatArray  # (p, n)
    D: FloatArray  # (p, m)

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    def response(self, points: ComplexArray) -> ComplexArray:
        """Transfer matrix at points of the s or z plane, shape (points, p, m)."""
        pencil = points[:, None, None] * np.eye(self.order) - self.A
        return np.asarray(self.D + self.C @ np.linalg.solve(pencil, self.B[None]), dtype=complex)


class Parts(NamedTuple):
    """Partition of a generalised plant: w, u in; z, y out."""

    A: FloatArray
    B1: FloatArray
    B2: FloatArray
    C1: FloatArray
    C2: FloatArray
    D11: FloatArray
    D12: FloatArray
    D21: FloatArray
    D22: FloatArray


def realisation_of(system: control.lti.LTI) -> Realisation:
    """Matrices of a state-space system."""
    return Realisation(*(np.array(M, float) for M in (system.A, system.B, system.C, system.D)))


def partition(P: Realisation, n_meas: int, n_ctrl: int) -> Parts:
    """Split off the last `n_meas` outputs and the last `n_ctrl` inputs."""
    p, m = P.D.shape[0] - n_meas, P.D.shape[1] - n_ctrl
    return Parts(
        P.A,
        P.B[:, :m],
        P.B[:, m:],
        P.C[:p],
        P.C[p:],
        P.D[:p, :m],
        P.D[:p, m:],
        P.D[p:, :m],
        P.D[p:, m:],
    )


def close(P: Realisation, K: Realisation, n_meas: int, n_ctrl: int) -> Realisation:
    """Lower linear fractional transformation: ``u = K y`` closed around `P`.

    Raises
    ------
    ParameterError
        If ``I - D22 D_K`` is singular: the loop is not well posed.
    """
    g = partition(P, n_meas, n_ctrl)
    gap = np.eye(n_meas) - g.D22 @ K.D
    if n_meas and np.linalg.cond(gap) > 1e13:
        raise ParameterError(
            "the direct feedthroughs of plant and controller form a singular algebraic loop: "
            "give one of them a delay or a lag"
        )
    E = np.linalg.inv(gap)  # y = E (C2 x + D22 C_K x_K + D21 w)
    F = np.eye(n_ctrl) + K.D @ E @ g.D22  # u = F C_K x_K + D_K E (C2 x + D21 w)
    A = np.block(
        [
            [g.A + g.B2 @ K.D @ E @ g.C2, g.B2 @ F @ K.C],
            [K.B @ E @ g.C2, K.A + K.B @ E @ g.D22 @ K.C],
        ]
    )
    B = np.vstack([g.B1 + g.B2 @ K.D @ E @ g.D21, K.B @ E @ g.D21])
    C = np.hstack([g.C1 + g.D12 @ K.D @ E @ g.C2, g.D12 @ F @ K.C])
    return Realisation(A, B, C, g.D11 + g.D12 @ K.D @ E @ g.D21)


def to_continuous(G: Realisation) -> Realisation:
    """System in ``s = (z - 1)/(z + 1)``: the unit disk becomes the left half plane.

    The H-infinity norm stays exactly the same. Multiply s by 2/T for the Tustin transform.

    Raises
    ------
    ParameterError
        If the system has a pole at ``z = -1``.
    """
    M = G.A + np.eye(G.order)
    if G.order and np.linalg.cond(M) > 1e13:
        raise ParameterError(
            "the discrete system has a pole at z = -1, where the bilinear transform is not "
            "defined: move the pole a little off, to -1 + 1e-6 say"
        )
    inverse = np.linalg.inv(M)
    root = np.sqrt(2.0)
    return Realisation(
        inverse @ (G.A - np.eye(G.order)),
        root * inverse @ G.B,
        root * G.C @ inverse,
        G.D - G.C @ inverse @ G.B,
    )


def to_discrete(G: Realisation) -> Realisation:
    """Return the system in ``z = (1 + s)/(1 - s)``: the inverse of `to_continuous`.

    Raises
    ------
    ParameterError
        If the system has a pole at ``s = 1``.
    """
    M = np.eye(G.order) - G.A
    if G.order and np.linalg.cond(M) > 1e13:
        raise ParameterError(
            "the transformed system has a pole at s = 1, which has no finite place in the "
            "z plane: change a weight a little"
        )
    inverse = np.linalg.inv(M)
    root = np.sqrt(2.0)
    return Realisation(
        inverse @ (np.eye(G.order) + G.A),
        root * inverse @ G.B,
        root * G.C @ inverse,
        G.D + G.C @ inverse @ G.B,
    )


def is_stable(A: FloatArray, discrete: bool) -> bool:
    """Whether all eigenvalues lie strictly inside the stability region."""
    poles = np.linalg.eigvals(A)
    return bool(np.all(np.abs(poles) < 1.0) if discrete else np.all(poles.real < 0.0))


def hinf_norm(G: Realisation, discrete: bool, tolerance: float = 1e-8) -> float:
    """H-infinity norm by the bisection of Bruinsma and Steinbuch (SLICOT AB13DD).

    Infinite for an unstable system.
    """
    if not is_stable(G.A, discrete):
        return float("inf")
    p, m = G.D.shape
    if G.order == 0:
        return float(np.linalg.norm(G.D, 2)) if min(p, m) else 0.0
    import slycot

    peak, _ = slycot.ab13dd(
        "D" if discrete else "C", "I", "S", "D", G.order, m, p, G.A, np.eye(G.order), G.B, G.C, G.D,
        tolerance,
    )  # fmt: skip
    return float(peak)


def grid_peak(G: Realisation, discrete: bool, points: int = 400) -> float:
    """Largest gain on a frequency grid around the poles: a lower bound of the norm."""
    return float(np.linalg.norm(G.response(axis_points(G, discrete, points)), 2, (1, 2)).max())


def axis_points(G: Realisation, discrete: bool, points: int) -> ComplexArray:
    """Points of the imaginary axis or of the unit circle, dense where the poles are."""
    poles = np.linalg.eigvals(G.A)
    if discrete:
        return np.exp(1j * np.concatenate(([0.0], np.geomspace(1e-4, np.pi, points - 1))))
    size = np.abs(poles)
    size = size[size > 1e-12]
    low, high = (size.min(), size.max()) if size.size else (1.0, 1.0)
    spread = np.geomspace(1e-2 * low, 1e2 * high, points)
    resonant = np.abs(poles.imag[np.abs(poles.imag) > 1e-12])
    return 1j * np.unique(np.concatenate((spread, resonant)))
