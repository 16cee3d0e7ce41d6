"""Stability margins, gated on the closed-loop poles and right at the Nyquist frequency.

Two traps of the library are closed here. ``control.stability_margins`` misses a phase
crossing at the Nyquist frequency of a discrete loop and returns an infinite gain margin;
``control.disk_margins`` returns a fine margin for an unstable loop. Here an unstable loop has
no margin at all, crossings are sought on the whole unit circle, ends included, and peaks are
refined between the points of the grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from plant.errors import ParameterError
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    import control

Response = Callable[[FloatArray], NDArray[np.complex128]]


@dataclass(frozen=True, slots=True)
class StabilityMargins:
    """Margins of a loop under negative feedback; NaN throughout if it is unstable.

    Attributes
    ----------
    stable : bool
        Whether all closed-loop poles are inside the stability region.
    gain_margin : float
        Smallest factor above 1 on the loop gain at which a pole reaches the boundary; a
        ratio, infinite if there is none.
    gain_reduction_margin : float
        Largest factor below 1 at which that happens; 0 if there is none.
    phase_margin_deg : float
        Smallest phase turn, of either sign, that does it, deg; infinite if there is none.
    sensitivity_peak, complementary_peak : float
        Peaks of ``|S|`` and ``|T|``.
    disk_margin : float
        Balanced disk margin ``alpha = 1/max |S - 1/2|`` (Seiler, Packard and Gahinet, 2020).
    frequency : float
        Where ``|S - 1/2|`` peaks, rad per time unit of the loop.
    """

    stable: bool
    gain_margin: float = math.nan
    gain_reduction_margin: float = math.nan
    phase_margin_deg: float = math.nan
    sensitivity_peak: float = math.nan
    complementary_peak: float = math.nan
    disk_margin: float = math.nan
    frequency: float = math.nan

    @property
    def disk_gain_margin(self) -> float:
        """Gain factor, up and down, that the disk allows; a ratio."""
        if self.disk_margin >= 2.0:
            return math.inf
        return (2.0 + self.disk_margin) / (2.0 - self.disk_margin)

    @property
    def disk_phase_margin_deg(self) -> float:
        """Phase turn that the disk allows, deg."""
        return 2.0 * math.degrees(math.atan(0.5 * self.disk_margin))

    def __str__(self) -> str:
        """Return the margins in one line."""
        if not self.stable:
            return "unstable: no margin"
        return (
            f"stable; gain margin {self.gain_margin:.2f}, phase margin "
            f"{self.phase_margin_deg:.0f} deg, disk margin {self.disk_margin:.2f} "
            f"(gain x/÷ {self.disk_gain_margin:.2f}, phase "
            f"+-{self.disk_phase_margin_deg:.0f} deg), peak |S| {self.sensitivity_peak:.2f}"
        )


def stability_margins(loop: control.StateSpace | control.TransferFunction) -> StabilityMargins:
    """Margins of a single-input single-output loop, continuous or discrete.

    Parameters
    ----------
    loop : control.StateSpace or control.TransferFunction
        Loop gain under negative feedback.

    Raises
    ------
    ParameterError
        If the loop has more than one input or output.
    """
    import control

    if not loop.issiso():
        raise ParameterError(
            f"the loop has {loop.ninputs} inputs and {loop.noutputs} outputs, but must have one "
            "each: open the others, or take its modes"
        )
    closed = control.feedback(loop, 1)
    poles = control.poles(closed)
    discrete = bool(control.isdtime(loop, strict=True))
    if discrete:
        dt = 1.0 if loop.dt is True else float(loop.dt)
        stable = bool(np.all(np.abs(poles) < 1.0))
        fine = np.geomspace(1e-5, 0.1, 400)  # beside an integrator
        grid = np.concatenate(([0.0], fine, np.linspace(0.1, np.pi, 2500)[1:])) / dt
        grid[-1] = np.pi / dt

        def response(omega: FloatArray) -> NDArray[np.complex128]:
            return np.asarray(loop(np.exp(1j * omega * dt), warn_infinite=False), dtype=complex)
    else:
        stable = bool(np.all(poles.real < 0.0))
        corners = np.abs(np.concatenate((control.poles(loop), control.zeros(loop), poles)))
        corners = corners[(corners > 1e-9) & np.isfinite(corners)]
        low, high = (corners.min(), corners.max()) if corners.size else (1.0, 1.0)
        grid = np.concatenate(([0.0], np.geomspace(1e-3 * low, 1e3 * high, 6000)))

        def response(omega: FloatArray) -> NDArray[np.complex128]:
            return np.asarray(loop(1j * omega, warn_infinite=False), dtype=complex)

    return margins_of_response(response, grid, stable)


def margins_of_response(response: Response, grid: FloatArray, stable: bool) -> StabilityMargins:
    """Margins of a loop known by its frequency response.

    Parameters
    ----------
    response : callable
        Loop gain at an array of frequencies; may be infinite at an integrator.
    grid : ndarray
        Frequencies, rising, fine enough to separate crossings and peaks; its ends count.
    stable : bool
        Whether the closed loop is stable: this no response can tell by itself.
    """
    if not stable:
        return StabilityMargins(False)

    def inverse(omega: FloatArray) -> NDArray[np.complex128]:
        with np.errstate(divide="ignore", invalid="ignore"):
            loop = response(omega)
            return np.where(np.isfinite(loop), 1.0 / loop, 0.0)

    # 1 + k L = 0 where 1/L = -k: poles of L on the boundary are harmless zeros of 1/L.
    values = inverse(grid)
    crossings = [
        inverse(np.array([omega]))[0]
        for omega in _roots(lambda w: inverse(np.array([w]))[0].imag, grid, values.imag)
    ]
    crossings += list(values[values != 0.0])  # where 1/L is real at a grid point, ends included
    # A sign change at a pole of 1/L is no crossing: there the imaginary part is not small.
    gains = [-v.real for v in crossings if v.real < 0.0 and abs(v.imag) <= 1e-7 * abs(v)]
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(values))
        phases = [
            180.0 - abs(math.degrees(np.angle(1.0 / inverse(np.array([omega]))[0])))
            for omega in _roots(
                lambda w: math.log(max(abs(inverse(np.array([w]))[0]), 1e-300)), grid, size
            )
        ]
    s_peak, _ = _peak(lambda w: np.abs(inverse(w) / (1.0 + inverse(w))), grid)
    t_peak, _ = _peak(lambda w: np.abs(1.0 / (1.0 + inverse(w))), grid)
    half, where = _peak(lambda w: np.abs(inverse(w) / (1.0 + inverse(w)) - 0.5), grid)
    return StabilityMargins(
        True,
        gain_margin=min((g for g in gains if g > 1.0), default=math.inf),
        gain_reduction_margin=max((g for g in gains if g < 1.0), default=0.0),
        phase_margin_deg=min(phases, default=math.inf),
        sensitivity_peak=s_peak,
        complementary_peak=t_peak,
        disk_margin=1.0 / half,
        frequency=where,
    )


def _roots(function: Callable[[float], float], grid: FloatArray, values: FloatArray) -> list[float]:
    """Roots between neighbouring grid points of different sign."""
    change = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    return [float(brentq(function, grid[k], grid[k + 1], xtol=1e-14)) for k in change]


def _peak(function: Callable[[FloatArray], FloatArray], grid: FloatArray) -> tuple[float, float]:
    """Largest value, refined between grid points, and where it is."""
    values = function(grid)
    k = int(np.argmax(values))
    best, where = float(values[k]), float(grid[k])
    low, high = grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)]
    found = minimize_scalar(
        lambda w: -float(function(np.array([w]))[0]), bounds=(low, high), method="bounded"
    )
    return (-float(found.fun), float(found.x)) if -found.fun > best else (best, where)
