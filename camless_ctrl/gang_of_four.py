"""Sensitivity functions of the nominal loop: the gang of four, per circulant mode and lifted.

With a law C and a measurement P per event (`NominalLoop`),

    S = 1/(1 + C P)    from a disturbance of the charge to the charge,
    T = C P S          from it to the correction,
    CS                 from noise of the estimate to the correction,
    PS                 from a disturbance of the charge to the estimate.

All four are stable maps only if the closed loop is (Astrom and Murray, *Feedback Systems*,
section 12.1). Lifted over a cycle each is an n x n matrix, whose singular values at ``zeta``
are the sizes of the function at the n roots of ``zeta``: one a mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import one_of
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from .nominal_loop import NominalLoop

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

Function = Literal["S", "T", "CS", "PS"]
FUNCTIONS: tuple[Function, ...] = get_args(Function)
# Output and input of the closed loop.
_SIGNALS: dict[str, tuple[str, str]] = {
    "S": ("charge", "disturbance"),
    "T": ("correction", "disturbance"),
    "CS": ("correction", "noise"),
    "PS": ("estimate", "disturbance"),
}
_TITLES: dict[str, str] = {
    "S": "S: disturbance to charge",
    "T": "T: disturbance to correction",
    "CS": "CS: noise to correction",
    "PS": "PS: disturbance to estimate",
}
_LOOKS = ("-", "--", ":", "-.")


class Peak(NamedTuple):
    """Largest size of a function, and where it is."""

    value: float  # 1; infinite for an unstable loop
    frequency: float  # rad/s; NaN for an unstable loop
    mode: int


@dataclass(frozen=True)
class ModeFunctions:
    """The four functions over the band of one mode.

    Attributes
    ----------
    q : int
        Mode: 0 the mean, q an imbalance q times a cycle.
    omega : ndarray (f,)
        Frequencies on the event circle, rad/s.
    responses : dict of str to ndarray (f,)
        ``S, T, CS, PS``.
    peaks : dict of str to Peak
        The peak of each, refined between the frequencies.
    """

    q: int
    omega: FloatArray = field(repr=False)
    responses: dict[str, ComplexArray] = field(repr=False)
    peaks: dict[str, Peak]


@dataclass(frozen=True)
class GangOfFour:
    """The gang of four of a loop.

    Attributes
    ----------
    loop : NominalLoop
        The loop.
    stable : bool
        Whether it is stable; if not, every peak is infinite.
    modes : tuple of ModeFunctions
        Mode by mode.
    """

    loop: NominalLoop = field(repr=False)
    stable: bool
    modes: tuple[ModeFunctions, ...]

    def peak(self, function: Function, q: int | None = None) -> Peak:
        """Return the peak of a function, in mode `q` or, by default, the largest of all.

        The largest of all is the H-infinity norm of the lifted function.
        """
        one_of("function", function, FUNCTIONS)
        if q is None:
            return max((mode.peaks[function] for mode in self.modes), key=lambda peak: peak.value)
        for mode in self.modes:
            if mode.q == q:
                return mode.peaks[function]
        raise ParameterError(
            f"mode is {q!r}, but must be one of {', '.join(str(m.q) for m in self.modes)}"
        )

    def lifted(self, function: Function) -> control.StateSpace:
        """Return a function lifted over a cycle: n x n, sampling time one cycle."""
        return self.loop.lifted(*_SIGNALS[one_of("function", function, FUNCTIONS)])

    def singular_values(self, function: Function, theta: ArrayLike) -> FloatArray:
        """Singular values of the lifted function, largest first.

        Parameters
        ----------
        function : {"S", "T", "CS", "PS"}
            Which.
        theta : array_like (f,)
            Cycle phases, rad.

        Returns
        -------
        ndarray (f, n)
        """
        zeta = np.exp(1j * np.atleast_1d(np.asarray(theta, dtype=float)))
        n = self.loop.n_cylinders
        found = np.asarray(self.lifted(function)(zeta, squeeze=False), dtype=complex)
        return np.linalg.svd(np.moveaxis(found.reshape(n, n, -1), -1, 0), compute_uv=False)

    def plot(self) -> Figure:
        """Draw the sizes of the four over the angle per event, a line for each mode."""
        import matplotlib.pyplot as plt

        from plant._plotting import COLOURS, styled

        n = self.loop.n_cylinders
        with styled():
            figure, panels = plt.subplots(2, 2, figsize=(8.4, 5.8), sharex=True)
            for function, ax in zip(FUNCTIONS, panels.ravel(), strict=True):
                for mode in self.modes:
                    ax.plot(
                        np.degrees(mode.omega * self.loop.event_time),
                        np.abs(mode.responses[function]),
                        ls=_LOOKS[mode.q % len(_LOOKS)],
                        c=COLOURS[mode.q % len(COLOURS)],
                        label=self.loop.mode_name(mode.q),
                    )
                    peak = mode.peaks[function]
                    if math.isfinite(peak.value):
                        angle = math.degrees(peak.frequency * self.loop.event_time)
                        ax.plot(angle, peak.value, "o", ms=4, c=COLOURS[mode.q % len(COLOURS)])
                ax.set_xlim(0.0, 180.0)
                ax.set_xticks(np.degrees(2.0 * np.pi * np.arange(n // 2 + 1) / n))
                ax.set_ylim(bottom=0.0)
                ax.set_title(_TITLES[function])
                ax.set_ylabel(f"|{function}| (1)")
            for ax in panels[1]:
                ax.set_xlabel("angle per event (deg)")
            handles, labels = panels[0, 0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=len(self.modes))
            if not self.stable:
                figure.suptitle("UNSTABLE loop: what is drawn are no gains")
        return figure

    def __str__(self) -> str:
        """Return the peaks in plain words."""
        if not self.stable:
            radius = float(np.max(np.abs(self.loop.poles))) ** self.loop.n_cylinders
            return f"The loop is unstable (pole radius {radius:.3g} a cycle): no peak is finite."
        lines = []
        for mode in self.modes:
            peaks = ", ".join(
                f"|{name}| {peak.value:.2f} at "
                f"{math.degrees(peak.frequency * self.loop.event_time):.0f} deg"
                for name, peak in mode.peaks.items()
            )
            lines.append(f"Peaks of the {self.loop.mode_name(mode.q)} mode: {peaks} per event.")
        return "\n".join(lines)


def gang_of_four(loop: NominalLoop) -> GangOfFour:
    """Return the four sensitivity functions of a loop with their peaks.

    Parameters
    ----------
    loop : NominalLoop
        The loop.
    """
    from .margins import _peak

    closed, T, stable = loop.closed, loop.event_time, loop.stable

    def response(function: str, omega: FloatArray) -> ComplexArray:
        output, input = _SIGNALS[function]
        i, j = closed.output_labels.index(output), closed.input_labels.index(input)
        found = np.asarray(closed(np.exp(1j * omega * T), squeeze=False), dtype=complex)
        return np.asarray(found[i, j])

    modes = []
    for q in loop.modes:
        omega = loop.band(q)
        peaks = {}
        for name in FUNCTIONS:
            value, where = math.inf, math.nan
            if stable:

                def size(w: FloatArray, name: str = name) -> FloatArray:
                    return np.abs(response(name, w))

                value, where = _peak(size, omega)
            peaks[str(name)] = Peak(value, where, q)
        modes.append(
            ModeFunctions(q, omega, {name: response(name, omega) for name in FUNCTIONS}, peaks)
        )
    return GangOfFour(loop, stable, tuple(modes))
