"""Upper linear fractional transformation: a system with its uncertainty put in.

The system takes what the perturbation gives as its first inputs and gives what the perturbation
takes as its first outputs; the rest, disturbances in and errors out, remains.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError

from .blocks import ComplexArray, Delta

if TYPE_CHECKING:
    import control


def lft(M: control.StateSpace, delta: Delta | control.StateSpace | ArrayLike) -> control.StateSpace:
    """Return the system with the upper loop closed by a perturbation.

    Parameters
    ----------
    M : control.StateSpace
        System; the names of its remaining inputs and outputs are kept.
    delta : Delta, control.StateSpace or array_like
        A perturbation of real values, or a system, such as `Delta.realise` returns.

    Raises
    ------
    ParameterError
        If sizes or sampling times do not fit, values are complex, or the loop is not well posed.
    """
    import control

    if isinstance(delta, Delta):
        if not delta.real:
            raise ParameterError(
                "the perturbation is complex, which no system in time can be: close the loop with "
                "delta.realise(omega, dt)"
            )
        delta = delta.matrix().real
    if not isinstance(delta, control.StateSpace):
        delta = control.ss([], [], [], np.atleast_2d(np.asarray(delta, dtype=float)), M.dt)
    a, b = delta.noutputs, delta.ninputs
    if a > M.ninputs or b > M.noutputs:
        raise ParameterError(
            f"the perturbation gives {a} signals and takes {b}, but the system has only "
            f"{M.ninputs} inputs and {M.noutputs} outputs"
        )
    times = {float(x) for x in (M.dt, delta.dt) if x is not None}
    if delta.nstates and len(times) > 1:
        raise ParameterError(
            f"the sampling times {M.dt} of the system and {delta.dt} of the perturbation differ: "
            "realise it with that of the system"
        )
    B1, B2 = M.B[:, :a], M.B[:, a:]
    C1, C2 = M.C[:b], M.C[b:]
    D11, D12, D21, D22 = M.D[:b, :a], M.D[:b, a:], M.D[b:, :a], M.D[b:, a:]
    loop = np.eye(a) - delta.D @ D11
    if np.linalg.cond(loop) > 1e12:
        raise ParameterError(
            "the loop of system and perturbation is not well posed: I - Delta D11 is singular"
        )
    # w = R (Dd (C1 x + D12 u) + Cd xd), z = C1 x + D11 w + D12 u
    R = np.linalg.inv(loop)
    wx, wd, wu = R @ delta.D @ C1, R @ delta.C, R @ delta.D @ D12
    zx, zd, zu = C1 + D11 @ wx, D11 @ wd, D12 + D11 @ wu
    A = np.block([[M.A + B1 @ wx, B1 @ wd], [delta.B @ zx, delta.A + delta.B @ zd]])
    B = np.vstack((B2 + B1 @ wu, delta.B @ zu))
    C = np.hstack((C2 + D21 @ wx, D21 @ wd))
    return control.ss(
        A,
        B,
        C,
        D22 + D21 @ wu,
        M.dt,
        inputs=M.input_labels[a:],
        outputs=M.output_labels[b:],
        name=f"{M.name}_perturbed",
    )


def lft_matrix(M: ArrayLike, delta: ArrayLike) -> ComplexArray:
    """Return the upper transformation of a matrix: ``M22 + M21 Delta (I - M11 Delta)^-1 M12``."""
    m, d = np.asarray(M, dtype=complex), np.asarray(delta, dtype=complex)
    a, b = d.shape
    inner = np.linalg.solve(np.eye(b) - m[:b, :a] @ d, m[:b, a:])
    return np.asarray(m[b:, a:] + m[b:, :a] @ d @ inner)
