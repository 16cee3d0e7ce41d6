"""What a closed loop does after a step in one cylinder: growth of each mode, and sensitivity.

The response holds all modes in equal parts. Its poles are found by the matrix pencil, each
mode's around its own angle. Where differences are held, the mean is corrected at every event, and
its poles may turn at any rate: all are its own but those that stay. The differences of the
response from cycle to cycle are those of the sensitivity,

    S(z) = sum_k (y_k - y_{k-n}) z^-k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import ParameterError
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from .event_loop import MODE_WIDTH

HELD_WITHIN = 0.01  # change per cycle of a held mode that counts as none, 1
_AT_HELD = 0.2  # distance of a pole of a held mode from 1, per cycle: its angle is not exact
_NOISE = 1e-2  # singular values below this share of the largest are the integration's noise
_LEFT, _FARTHER = 0.02, 20  # of a mode, with which a run goes on by its poles; times its length
_SMALL = 0.01  # of the largest value: poles that carry less are not told from noise


@dataclass(frozen=True)
class StepResponse:
    """Charges after the valve of the first cylinder has started to close late.

    Attributes
    ----------
    n_cylinders : int
        Number of cylinders.
    held : bool
        Whether differences between cylinders are not adapted.
    values : ndarray (m,)
        Deviation of each event's charge, over that of the first; it ends early where it has
        become too large for a linear response.
    ended_early : bool
        Whether it did.
    """

    n_cylinders: int
    held: bool
    values: FloatArray = field(repr=False)
    ended_early: bool = False

    @property
    def modes(self) -> range:
        """The modes ``q = 0 ... n/2``."""
        return range(self.n_cylinders // 2 + 1)

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles per event that the response shows."""
        return poles_of(self.values)

    @cached_property
    def adapted_poles(self) -> ComplexArray:
        """Those of them that are not of held differences."""
        return self.poles[~self._staying] if self.held else self.poles

    @property
    def _staying(self) -> NDArray[np.bool_]:
        """Which poles are those of held differences."""
        per_cycle = self.poles**self.n_cylinders
        return (np.abs(per_cycle - 1.0) < _AT_HELD) & (turns(self.poles, self.n_cylinders) > 0.5)

    def growth(self, q: int) -> float:
        """Largest growth per cycle of the poles of a mode; 0 if it has died in the noise."""
        if self.is_held(q):
            return mode_growth(self.poles[self._staying], q, self.n_cylinders)
        return float(adapted_growth(self.adapted_poles, self.held, self.n_cylinders)[q])

    def left(self, q: int) -> float:
        """Amplitude of a mode in the last cycle over that of the step.

        A held mode keeps an amplitude near, not at 1: the mean's correction ripples with it.
        """
        n = self.n_cylinders
        last = self.values[self.values.size // n * n - n :][:n]
        return abs(complex(last @ np.exp(-2j * np.pi * q * np.arange(n) / n)))

    def is_held(self, q: int) -> bool:
        """Whether a mode is not adapted."""
        return self.held and q > 0

    @property
    def stable(self) -> bool:
        """Whether every mode that is adapted decays, and every one that is held stays."""
        if self.ended_early:
            return False
        return all(
            abs(self.growth(q) - 1.0) < HELD_WITHIN
            if self.is_held(q)
            else self.growth(q) < 1.0 and self.left(q) < 1.0
            for q in self.modes
        )

    @property
    def worst_growth(self) -> tuple[float, int]:
        """Largest growth per cycle of an adapted mode, and the mode."""
        return max((self.growth(q), q) for q in self.modes if not self.is_held(q))

    @cached_property
    def _continued(self) -> FloatArray:
        """Values, gone on with by their poles if much is left at the end of a stable run."""
        y, poles = self.values, self.poles
        if not self.stable or all(self.is_held(q) or self.left(q) < _LEFT for q in self.modes):
            return y
        k = np.arange(y.size)
        decaying = poles[np.abs(poles) < 1.0]
        amplitudes = np.linalg.lstsq(decaying ** k[:, None], y.astype(complex), rcond=None)[0]
        further = np.arange(y.size, y.size * _FARTHER)
        return np.concatenate((y, (decaying ** further[:, None] @ amplitudes).real))

    def sensitivity(self, angle: ArrayLike) -> ComplexArray:
        """Sensitivity at angles per event in rad; of a stable loop.

        A response that has not died in the run is gone on with by its poles.
        """
        n, y = self.n_cylinders, self._continued
        pulse = y - np.concatenate((np.zeros(n), y[:-n]))
        turns = np.exp(-1j * np.outer(np.ravel(angle), np.arange(y.size)))
        return np.asarray((turns @ pulse).reshape(np.shape(angle)))

    @property
    def sensitivity_peak(self) -> float:
        """Largest ``|S|``; NaN if unstable."""
        if not self.stable:
            return math.nan
        return float(np.abs(self.sensitivity(np.linspace(0.0, np.pi, 721))).max())


def mode_growth(poles: ComplexArray, q: int, n_cylinders: int) -> float:
    """Largest growth per cycle of the poles (per event) around the angle of a mode."""
    of_mode = np.abs(poles[np.abs(turns(poles, n_cylinders) - q) <= MODE_WIDTH])
    return float(np.max(of_mode, initial=0.0)) ** n_cylinders


def adapted_growth(poles: ComplexArray, held: bool, n_cylinders: int) -> FloatArray:
    """Largest growth per cycle of each adapted mode: the mean alone, of all, if `held`."""
    if held:
        return np.array([float(np.max(np.abs(poles), initial=0.0)) ** n_cylinders])
    return np.array([mode_growth(poles, q, n_cylinders) for q in range(n_cylinders // 2 + 1)])


def turns(poles: ComplexArray, n_cylinders: int) -> FloatArray:
    """Turns per cycle of poles per event.

    At whole turns a pole is a mode's own; half-way it changes sign from cycle to cycle.
    """
    return np.asarray(np.abs(np.angle(poles)) * n_cylinders / (2.0 * np.pi))


def turns_of_fastest(poles: ComplexArray, n_cylinders: int) -> float:
    """Turns per cycle of the pole that grows fastest; NaN if there is none."""
    if not poles.size:
        return math.nan
    return float(turns(poles, n_cylinders)[np.argmax(np.abs(poles))])


def poles_of(values: FloatArray) -> ComplexArray:
    """Poles of a sum of powers ``sum a p^k`` with noise: the matrix pencil (Hua and Sarkar 1990).

    Poles whose share of the signal is small are left out.
    """
    values = np.asarray(values, dtype=float)
    if values.size < 8:
        raise ParameterError(
            f"the response has {values.size} values, but poles need 8 or more: run longer"
        )
    windows = np.lib.stride_tricks.sliding_window_view(values, values.size // 2 + 1)
    _, sizes, right = np.linalg.svd(windows, full_matrices=False)
    if sizes[0] == 0.0:
        return np.empty(0, dtype=complex)
    basis = right[: int(np.count_nonzero(sizes > _NOISE * sizes[0]))]
    poles = np.linalg.eigvals(basis[:, 1:] @ np.linalg.pinv(basis[:, :-1]))
    # Each power is 1 at the end at which it is largest: what it is there is its share.
    k = np.arange(values.size)
    columns = [pole ** (k - (k[-1] if abs(pole) > 1.0 else 0)) for pole in poles]
    shares = np.abs(np.linalg.lstsq(np.transpose(columns), values.astype(complex), rcond=None)[0])
    return np.asarray(poles[shares > _SMALL * np.abs(values).max()], dtype=complex)
