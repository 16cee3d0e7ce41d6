"""Frequency response of a system, of frequency data or of a function, in one form."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import ParameterError

from .blocks import ComplexArray

if TYPE_CHECKING:
    import control

FloatArray: TypeAlias = NDArray[np.float64]


class StateMatrices(NamedTuple):
    """Matrices of a state-space system."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


@dataclass(frozen=True)
class Response:
    """Frequency response.

    Attributes
    ----------
    at : callable
        From frequencies (N,), rad per time unit, to matrices (N, outputs, inputs).
    outputs, inputs : int
        Sizes.
    dt : float
        Sampling time; 0 for continuous time.
    matrices : StateMatrices or None
        Of a state-space system.
    omega : ndarray or None
        The only frequencies, of frequency data.
    """

    at: Callable[[FloatArray], ComplexArray]
    outputs: int
    inputs: int
    dt: float
    matrices: StateMatrices | None = None
    omega: FloatArray | None = None

    @property
    def poles(self) -> ComplexArray:
        """Poles of a state-space system."""
        if self.matrices is None or self.matrices.A.size == 0:
            return np.zeros(0, dtype=complex)
        return np.linalg.eigvals(self.matrices.A).astype(complex)

    @property
    def nyquist(self) -> float:
        """Highest frequency, rad per time unit; infinite in continuous time."""
        return math.pi / self.dt if self.dt > 0.0 else math.inf

    def part(self, rows: slice, columns: slice) -> Response:
        """Return the response from some inputs to some outputs."""
        m = self.matrices
        cut = (
            None
            if m is None
            else StateMatrices(m.A, m.B[:, columns], m.C[rows], m.D[rows, columns])
        )
        return replace(
            self,
            at=lambda omega: self.at(omega)[:, rows, columns],
            outputs=len(range(*rows.indices(self.outputs))),
            inputs=len(range(*columns.indices(self.inputs))),
            matrices=cut,
        )

    def rows_times(self, factors: FloatArray) -> Response:
        """Return the response with its outputs multiplied by factors."""
        m = self.matrices
        column = factors[:, None]
        scaled = None if m is None else StateMatrices(m.A, m.B, column * m.C, column * m.D)
        return replace(self, at=lambda omega: column * self.at(omega), matrices=scaled)


def as_response(
    M: Any, omega: ArrayLike | None, *, stable: bool | None, dt: float | bool | None
) -> Response:
    """Return the response of a stable system; raise if it is not stable, or this is unknown.

    Parameters
    ----------
    M : control.StateSpace, control.TransferFunction, control.FRD or callable
        A callable takes frequencies (N,) and returns matrices (N, outputs, inputs).
    omega : array_like or None
        Frequencies; needed for a callable.
    stable : bool or None
        Whether frequency data or a callable belong to a stable system.
    dt : float, bool or None
        Sampling time of a callable; 0 for continuous time.
    """
    import control

    if isinstance(M, Response):
        return M
    if isinstance(M, control.TransferFunction):
        M = control.ss(M)
    if isinstance(M, control.StateSpace):
        response = _of_system(M)
        _check_stable(response)
        return response
    if stable is not True:
        raise ParameterError(
            "the nominal system is not known to be stable, which no frequency response can tell "
            "by itself: check it and give stable=True"
            if stable is None
            else "the nominal system is unstable: mu says nothing of its robustness"
        )
    if isinstance(M, control.FrequencyResponseData):
        step = 1.0 if M.dt is True else float(M.dt or 0.0)
        return _of_data(M, omega, step)
    if not callable(M):
        raise ParameterError(
            f"{type(M).__name__} is no system: give a StateSpace, a TransferFunction, an FRD or a "
            "function of the frequency"
        )
    if omega is None:
        raise ParameterError("a function of the frequency needs omega: give the frequencies")
    first = np.asarray(M(np.asarray(omega, dtype=float)[:1]), dtype=complex)
    if first.ndim != 3 or len(first) != 1:
        raise ParameterError(
            f"the function gives an array of shape {first.shape} for one frequency, but must "
            "give (1, outputs, inputs)"
        )
    return Response(
        lambda w: np.asarray(M(w), dtype=complex),
        first.shape[1],
        first.shape[2],
        1.0 if dt is True else float(dt or 0.0),
    )


def _of_system(system: control.StateSpace) -> Response:
    A, B, C, D = (np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))
    dt = 1.0 if system.dt is True else float(system.dt or 0.0)
    eye = np.eye(len(A))

    def at(omega: FloatArray) -> ComplexArray:
        w = np.asarray(omega, dtype=float)
        s = np.exp(1j * w * dt) if dt > 0.0 else 1j * w
        if len(A) == 0:
            return np.repeat(D[None].astype(complex), len(w), axis=0)
        right = np.broadcast_to(B, (len(w), *B.shape))
        return np.asarray(C @ np.linalg.solve(s[:, None, None] * eye - A, right) + D)

    return Response(at, D.shape[0], D.shape[1], dt, StateMatrices(A, B, C, D))


def _of_data(data: control.FRD, omega: ArrayLike | None, dt: float) -> Response:
    own = np.asarray(data.omega, dtype=float)
    values = np.moveaxis(np.asarray(data.frdata, dtype=complex), -1, 0)
    order = np.argsort(own)
    own, values = own[order], values[order]
    if omega is not None and not np.array_equal(np.sort(np.asarray(omega, float)), own):
        raise ParameterError(
            "omega differs from the frequencies of the data, between which nothing is known: "
            "leave it out"
        )

    def at(w: FloatArray) -> ComplexArray:
        index = np.searchsorted(own, w)
        return np.asarray(values[np.minimum(index, len(own) - 1)])

    return Response(at, values.shape[1], values.shape[2], dt, None, own)


def _check_stable(response: Response) -> None:
    poles = response.poles
    if poles.size == 0:
        return
    if response.dt > 0.0:
        k = int(np.argmax(np.abs(poles)))
        unstable, bound = abs(poles[k]) >= 1.0 - 1e-12, "inside the unit circle"
    else:
        k = int(np.argmax(poles.real))
        unstable, bound = poles[k].real >= -1e-12 * max(1.0, abs(poles[k])), "left of the axis"
    if unstable:
        raise ParameterError(
            f"the nominal system is not stable, pole at {poles[k]:.6g}, but its poles must be "
            f"{bound}: mu says nothing of its robustness (shift a weight's integrator a little)"
        )
