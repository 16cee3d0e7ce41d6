"""Stable, minimum-phase factor of a squared magnitude, and its realisation.

A root s_0 of a polynomial in `s` = (w/a)^2 gives the roots +-a sqrt(-s_0) of the factor; the one
in the left half plane is taken. In discrete time w = tan(omega dt/2), and the bilinear map
z = (1 + p)/(1 - p) carries the left half plane into the unit circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plant import ConvergenceError
from plant.kinematics import FloatArray

from ._weight_program import SquaredMagnitude

if TYPE_CHECKING:
    import control

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class FrequencyAxis:
    """Map of frequencies onto the axis of the program.

    Attributes
    ----------
    dt : float
        Sampling time, s; 0 in continuous time.
    middle : float
        The frequency `a`: rad/s, or in discrete time the tangent of half the angle.
    """

    dt: float
    middle: float

    @classmethod
    def of(cls, omega: FloatArray, dt: float) -> FrequencyAxis:
        """Return the axis with the geometric middle of the grid (rad/s) at its middle."""
        axis = cls(dt, 1.0)
        u, v = axis.shares(omega)
        inner = (u > 1e-12) & (v > 1e-12) if dt else u > 0.0
        if not inner.any():
            return axis
        w = np.sqrt(u[inner] / v[inner])
        return cls(dt, float(np.sqrt(w.min() * w.max())))

    def shares(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return u = s/(1 + s) and v = 1/(1 + s) at frequencies in rad/s."""
        if self.dt:
            # omega dt may exceed pi by rounding only
            half = np.minimum(0.5 * self.dt * omega, 0.5 * np.pi)
            u, v = np.sin(half) ** 2, (self.middle * np.cos(half)) ** 2
        else:
            u, v = omega**2, np.full_like(omega, self.middle**2)
        return u / (u + v), v / (u + v)

    def points(self, omega: FloatArray) -> ComplexArray:
        """Return e^(j omega dt), or j omega in continuous time."""
        x = np.asarray(1j * omega, dtype=np.complex128)
        return np.exp(self.dt * x) if self.dt else x


def factor(
    magnitude: SquaredMagnitude, axis: FrequencyAxis
) -> tuple[ComplexArray, ComplexArray, float]:
    """Return zeros, poles (complex, shape (order,)) and gain of the factor.

    Raises
    ------
    ConvergenceError
        If a root comes out on the boundary of the stable region.
    """
    p, q = magnitude.numerator, magnitude.denominator
    zeros, poles = (axis.middle * _left_roots(c) for c in (p, q))
    gain = float(np.sqrt(p[-1] / q[-1]))  # at s = infinity, where all factors are 1
    if axis.dt:
        gain *= float((np.prod(1.0 - zeros) / np.prod(1.0 - poles)).real)
        zeros, poles = ((1.0 + c) / (1.0 - c) for c in (zeros, poles))
    for name, roots in (("zero", zeros), ("pole", poles)):
        outside = np.abs(roots) >= 1.0 if axis.dt else roots.real >= 0.0
        if outside.any():
            raise ConvergenceError(
                f"the weight has a {name} at {roots[outside][0]:.6g}, on the boundary of the "
                "stable region: lower its order or raise the floor"
            )
    return zeros, poles, gain


def response(
    points: ComplexArray, zeros: ComplexArray, poles: ComplexArray, gain: float
) -> ComplexArray:
    """Return gain prod(x - zero)/prod(x - pole) at complex points x of any shape."""
    value = np.full(np.shape(points), gain, dtype=complex)
    for zero, pole in zip(zeros, poles, strict=True):
        value *= (points - zero) / (points - pole)
    return value


def realisation(
    zeros: ComplexArray, poles: ComplexArray, gain: float, dt: float, name: str
) -> control.StateSpace:
    """Return the weight as a chain of real sections of first and second order."""
    import control

    a, b, c = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
    for some_zeros, some_poles in zip(_groups(zeros), _groups(poles), strict=True):
        a_2, b_2, c_2 = _section(some_zeros, some_poles)
        # The next section's input is this output: y = c x + u, each with direct term 1.
        a = np.block([[a, np.zeros((a.shape[0], a_2.shape[0]))], [b_2 @ c, a_2]])
        b, c = np.vstack((b, b_2)), np.hstack((c, c_2))
    options = {"name": name} if name else {}
    return control.ss(a, b, gain * c, [[gain]], dt, **options)


def _left_roots(coefficients: FloatArray) -> ComplexArray:
    squares = np.roots(coefficients[::-1])
    return -np.sqrt(-squares.astype(complex))


def _groups(roots: ComplexArray) -> list[ComplexArray]:
    """Return pairs of roots, conjugate or real, and a single real one for an odd count."""
    double = [np.array([r, r.conjugate()]) for r in roots if r.imag > 0.0]
    real = sorted(roots[roots.imag == 0.0], key=abs)
    single = [np.array([real.pop()])] if len(real) % 2 else []
    double += [np.array(pair) for pair in zip(real[::2], real[1::2], strict=True)]
    return sorted(double, key=lambda pair: float(np.abs(pair).prod())) + single


def _section(zeros: ComplexArray, poles: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B, C of prod(x - zero)/prod(x - pole); the direct term is 1.

    The roots stand in A themselves, not the coefficients of their polynomial: poles near 1, of
    fast sampling, keep their precision.
    """
    shift = (poles - zeros).sum().real
    if poles.size == 1:
        return poles.real[:, None], np.ones((1, 1)), np.array([[shift]])
    first, second = poles
    if first.imag:
        re, im = first.real, first.imag
        rest = (np.prod(re - zeros).real - im**2) / im
        a = np.array([[re, im], [-im, re]])
        return a, np.array([[0.0], [1.0]]), np.array([[rest, shift]])
    # 1 + shift/(x - first) + rest/((x - first)(x - second)); unit balances the states
    rest, unit = np.prod(second - zeros).real, float(abs(first)) or 1.0
    a = np.array([[first.real, 0.0], [unit, second.real]])
    return a, np.array([[1.0], [0.0]]), np.array([[shift, rest / unit]])
