"""Stable minimum-phase rational function whose magnitude fits given values.

The function is a product of sections of first and second order, and the fit is one of least
squares on the logarithm of the magnitude. Poles and zeros are in the left half plane by their
parametrisation, so that the function and its inverse are stable and proper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plant._checks import whole
from plant.errors import ParameterError

from ._realisation import ComplexArray, FloatArray, Realisation

_DAMPING = (0.1, 20.0)  # range of the damping of sections
_BEYOND = 10.0  # how far corners may lie beyond the ends of the grid, a factor


@dataclass(frozen=True)
class MinimumPhaseFit:
    """Fitted function ``gain * product of sections``.

    Attributes
    ----------
    gain : float
        Gain at infinite frequency.
    first : ndarray
        Corners ``(zero, pole)`` of first-order sections ``(s + zero)/(s + pole)``, rad/s,
        shape (sections, 2).
    second : ndarray
        ``(w_zero, damping_zero, w_pole, damping_pole)`` of second-order sections, shape
        (sections, 4).
    error : float
        Largest relative error of the magnitude over the grid, weighed as the fit was.
    """

    gain: float
    first: FloatArray
    second: FloatArray
    error: float

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.first) + 2 * len(self.second)

    @property
    def poles(self) -> ComplexArray:
        """Poles, all in the left half plane."""
        return self._roots(1)

    @property
    def zeros(self) -> ComplexArray:
        """Zeros, all in the left half plane."""
        return self._roots(0)

    def _roots(self, side: int) -> ComplexArray:
        parts = [-self.first[:, side].astype(complex)]
        for section in self.second:
            w, damping = section[2 * side : 2 * side + 2]
            parts.append(np.roots([1.0, 2.0 * damping * w, w * w]).astype(complex))
        return np.concatenate(parts)

    def inverse(self) -> MinimumPhaseFit:
        """Return ``1/function``, which is stable and of minimum phase too."""
        second = self.second[:, [2, 3, 0, 1]]
        return MinimumPhaseFit(1.0 / self.gain, self.first[:, ::-1], second, self.error)

    def __call__(self, frequency: ArrayLike) -> ComplexArray:
        """Response at frequencies in rad/s."""
        s = 1j * np.asarray(frequency, dtype=float)
        value = np.full(s.shape, self.gain, dtype=complex)
        for zero, pole in self.first:
            value *= (s + zero) / (s + pole)
        for wz, dz, wp, dp in self.second:
            value *= (s**2 + 2 * dz * wz * s + wz**2) / (s**2 + 2 * dp * wp * s + wp**2)
        return value

    def realisation(self) -> Realisation:
        """State space, the sections in series."""
        sections = []
        for zero, pole in self.first:
            sections.append(
                (np.array([[-pole]]), np.array([[pole]]), np.array([[(zero - pole) / pole]]))
            )
        for wz, dz, wp, dp in self.second:
            A = wp * np.array([[0.0, 1.0], [-1.0, -2.0 * dp]])
            C = np.array([[(wz * wz - wp * wp) / wp**2, 2.0 * (dz * wz - dp * wp) / wp]])
            sections.append((A, np.array([[0.0], [wp]]), C))
        A, B, C = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
        for a, b, c in sections:  # each feeds through with gain 1
            A = np.block([[A, np.zeros((len(A), len(a)))], [b @ C, a]])
            B, C = np.vstack([B, b]), np.hstack([C, c])
        return Realisation(A, B, self.gain * C, np.array([[self.gain]]))


def fit_minimum_phase(
    frequency: ArrayLike,
    magnitude: ArrayLike,
    order: int,
    *,
    weight: ArrayLike | None = None,
) -> MinimumPhaseFit:
    """Fit the magnitude of a stable minimum-phase function.

    Parameters
    ----------
    frequency : array_like
        Frequencies above zero, rising, rad/s.
    magnitude : array_like
        Magnitudes above zero.
    order : int
        Number of poles, and of zeros, from 0 to 8.
    weight : array_like, optional
        How much each point counts, at most 1.

    Raises
    ------
    ParameterError
        If the data are not positive and rising, or fewer than the unknowns.
    """
    order = whole("order", order, 0, 8)
    w, values = np.asarray(frequency, dtype=float), np.asarray(magnitude, dtype=float)
    counts = np.ones_like(w) if weight is None else np.asarray(weight, dtype=float)
    if w.ndim != 1 or not w.shape == values.shape == counts.shape:
        raise ParameterError(
            f"frequency, magnitude and weight have shapes {w.shape}, {values.shape} and "
            f"{counts.shape}, but must be of one length"
        )
    if len(w) < 2 * order + 1 or not np.all(np.isfinite(w) & (w > 0)) or np.any(np.diff(w) <= 0):
        raise ParameterError(
            f"a fit of order {order} needs at least {2 * order + 1} rising frequencies above "
            f"zero, got {len(w)}"
        )
    if not np.all(np.isfinite(values) & (values > 0.0)):
        raise ParameterError("magnitudes must be finite and above zero: the fit is logarithmic")
    target = np.log(values)
    corners = np.log([w[0] / _BEYOND, w[-1] * _BEYOND])
    best = _least_squares(w, target, counts, np.zeros(0), 0, corners)
    for k in range(2 - order % 2, order + 1, 2):  # sections join one by one
        trials = []
        for start in _starts(best, k, w, target, counts):
            trials.append(_least_squares(w, target, counts, start, k % 2, corners))
        best = min(trials, key=lambda theta: _cost(theta, k % 2, w, target, counts))
    level, first, second = _unpack(best, order % 2, w, target, counts)
    fit = MinimumPhaseFit(float(np.exp(level)), first, second, 0.0)
    error = np.abs(np.log(np.abs(fit(w))) - target) * counts
    return MinimumPhaseFit(fit.gain, first, second, float(np.expm1(error.max())))


def _starts(
    theta: FloatArray, order: int, w: FloatArray, target: FloatArray, counts: FloatArray
) -> list[FloatArray]:
    """The solution of fewer sections with one more that cancels, at several corners."""
    low, high = float(np.log(w[0])), float(np.log(w[-1]))
    starts = []
    for place in np.linspace(low, high, 7)[1:-1]:
        for split in (0.3, -0.3):
            if order == 1:
                starts.append(np.array([place + split, place - split]))
            else:
                new = [place + split, np.log(0.8), place - split, np.log(0.8)]
                starts.append(np.concatenate([theta, new]))
    return starts


def _sections(theta: FloatArray, n_first: int, w: FloatArray) -> FloatArray:
    """Logarithm of the magnitude of all sections."""
    value = np.zeros_like(w)
    if n_first:
        zero, pole = np.exp(theta[:2])
        value += 0.5 * np.log((w**2 + zero**2) / (w**2 + pole**2))
    for wz, dz, wp, dp in np.exp(theta[2 * n_first :].reshape(-1, 4)):
        for sign, corner, damping in ((0.5, wz, dz), (-0.5, wp, dp)):
            x = (w / corner) ** 2
            value += sign * (np.log((1 - x) ** 2 + 4 * damping**2 * x) + 4 * np.log(corner))
    return value


def _residual(
    theta: FloatArray, n_first: int, w: FloatArray, target: FloatArray, counts: FloatArray
) -> FloatArray:
    """Weighed error, with the level that suits best."""
    error = _sections(theta, n_first, w) - target
    return counts * (error - np.sum(counts**2 * error) / np.sum(counts**2))


def _jacobian(
    theta: FloatArray, n_first: int, w: FloatArray, target: FloatArray, counts: FloatArray
) -> FloatArray:
    """Derivatives of `_residual` by the logarithms of corners and dampings."""
    columns = []
    for sign, corner in zip((1.0, -1.0), np.exp(theta[: 2 * n_first]), strict=False):
        columns.append(sign * corner**2 / (w**2 + corner**2))
    for wz, dz, wp, dp in np.exp(theta[2 * n_first :].reshape(-1, 4)):
        for sign, corner, damping in ((0.5, wz, dz), (-0.5, wp, dp)):
            x = (w / corner) ** 2
            q = (1 - x) ** 2 + 4 * damping**2 * x
            columns.append(sign * (4.0 + 4.0 * x * (1.0 - x - 2.0 * damping**2) / q))
            columns.append(sign * 8.0 * damping**2 * x / q)
    J = np.column_stack(columns)
    mean = (counts**2 @ J) / np.sum(counts**2)
    return np.asarray(counts[:, None] * (J - mean), dtype=float)


def _cost(
    theta: FloatArray, n_first: int, w: FloatArray, target: FloatArray, counts: FloatArray
) -> float:
    return float(np.sum(_residual(theta, n_first, w, target, counts) ** 2))


def _least_squares(
    w: FloatArray,
    target: FloatArray,
    counts: FloatArray,
    start: FloatArray,
    n_first: int,
    corners: FloatArray,
) -> FloatArray:
    from scipy.optimize import least_squares

    if start.size == 0:
        return start
    n_second = (start.size - 2 * n_first) // 4
    damping = np.log(_DAMPING)
    low = np.tile([corners[0], damping[0]], 2 * n_second)
    high = np.tile([corners[1], damping[1]], 2 * n_second)
    low = np.concatenate([np.full(2 * n_first, corners[0]), low])
    high = np.concatenate([np.full(2 * n_first, corners[1]), high])
    found = least_squares(
        _residual,
        np.clip(start, low + 1e-9, high - 1e-9),
        _jacobian,
        bounds=(low, high),
        args=(n_first, w, target, counts),
        max_nfev=100,
    )
    return np.asarray(found.x, dtype=float)


def _unpack(
    theta: FloatArray, n_first: int, w: FloatArray, target: FloatArray, counts: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    error = target - _sections(theta, n_first, w)
    level = float(np.sum(counts**2 * error) / np.sum(counts**2))
    first = np.exp(theta[: 2 * n_first]).reshape(-1, 2)
    return level, first, np.exp(theta[2 * n_first :]).reshape(-1, 4)
