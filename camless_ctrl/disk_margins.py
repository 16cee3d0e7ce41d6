"""Disk margins: how far gain and phase may be off, in one loop, one at a time and in all.

Each loop is multiplied by a complex factor, constant or a system,

    f = (1 + (1 - s)/2 d)/(1 - (1 + s)/2 d),    |d| < alpha,

with the skew ``s`` (0 balanced: gain up and down alike; 1 from S, -1 from T). One loop is
stable for all of them up to ``alpha = 1/max |S + (s - 1)/2|``; several loops at once up to
``alpha = 1/max mu(S + (s - 1)/2 I)``, with one complex ``d`` a loop (Seiler, Packard and
Gahinet, "An Introduction to Disk Margins", 2020). A loop that is unstable has no margin,
whatever its frequency response says.

For equal cylinders ``S`` lifted over a cycle is normal, so that ``mu`` in all cylinders at once
is its largest size over the modes; one cylinder alone sees the mean over the modes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError
from plant._checks import in_range
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from .delay_margin import DelayMargin, delay_margin
from .mu.blocks import BlockStructure, ComplexBlock
from .nominal_loop import NominalLoop

if TYPE_CHECKING:
    from collections.abc import Callable

    import control
    from matplotlib.axes import Axes

    from .margins import StabilityMargins

_LOOKS = ("-", "--", ":", "-.")
_PEAK = 1e-9  # relative accuracy of the peak of one loop
_PROOF = 1e-3  # relative distance of what is proved for all loops from the peak


@dataclass(frozen=True)
class DiskMargin:
    """Disk margin of one loop or of several at once; NaN throughout if unstable.

    Attributes
    ----------
    stable : bool
        Whether the closed loop is stable.
    skew : float
        Skew ``s`` of the disk.
    alpha : float
        Size of ``d`` that is withstood; infinite if every one is.
    broken_by : float
        Size of the factors in `worst`; for several loops at or above `alpha`.
    frequency : float
        Where, rad per time unit.
    worst : tuple of complex
        Factor in each loop that puts a pole on the boundary there; empty if none was found.
    proved : bool
        Whether `alpha` holds at all frequencies for certain, not on a grid that is refined at
        its peak (as for a mode, which has a band of its own).
    """

    stable: bool
    skew: float
    alpha: float = math.nan
    broken_by: float = math.nan
    frequency: float = math.nan
    worst: tuple[complex, ...] = field(default=(), repr=False)
    proved: bool = False

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Smallest and largest real factor within the disk; the latter may be infinite."""
        if math.isinf(self.alpha):
            return -math.inf, math.inf
        up, down = self.alpha * (1.0 - self.skew), self.alpha * (1.0 + self.skew)
        return (2.0 - up) / (2.0 + down), math.inf if down >= 2.0 else (2.0 + up) / (2.0 - down)

    @property
    def phase_margin_deg(self) -> float:
        """Phase turn within the disk, deg; infinite if the unit circle lies within it."""
        square = self.alpha**2
        if math.isinf(self.alpha) or self.alpha * abs(self.skew) > 2.0:
            return math.inf
        cosine = (4.0 - square * (1.0 + self.skew**2)) / (4.0 + square * (1.0 - self.skew**2))
        return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))  # beyond 1 by rounding

    def boundary(self, points: int = 361) -> ComplexArray:
        """Factors ``f`` on the boundary of the disk, ``|d| = alpha``."""
        return factor(self.alpha * np.exp(1j * np.linspace(-np.pi, np.pi, points)), self.skew)

    def __str__(self) -> str:
        """Return the margin in a line."""
        if not self.stable:
            return "unstable: no disk margin"
        low, high = self.gain_margin
        return (
            f"disk margin {self.alpha:.3f} (gain x{low:.2f} to x{high:.2f}, phase "
            f"+-{self.phase_margin_deg:.0f} deg)"
        )


def factor(d: ComplexArray, skew: float = 0.0) -> ComplexArray:
    """Factor ``f`` on a loop for values of ``d``."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((1.0 + 0.5 * (1.0 - skew) * d) / (1.0 - 0.5 * (1.0 + skew) * d))


@dataclass(frozen=True)
class ModeMargins:
    """Margins of one circulant mode: what all cylinders together may be off in its pattern.

    Attributes
    ----------
    q : int
        Mode.
    disk : DiskMargin
        Its disk margin.
    classical : StabilityMargins
        Its gain and phase margin.
    """

    q: int
    disk: DiskMargin
    classical: StabilityMargins


@dataclass(frozen=True)
class DiskMargins:
    """Margins of the air-charge loop.

    Attributes
    ----------
    loop : NominalLoop
        The loop.
    stable : bool
        Whether it is stable; if not, there is no margin.
    modes : tuple of ModeMargins
        Mode by mode.
    one_at_a_time : tuple of DiskMargin
        Each cylinder with the others closed and as they should be.
    all_loops : DiskMargin
        All cylinders at once, each with a factor of its own.
    delay : DelayMargin
        Delay that is withstood.
    """

    loop: NominalLoop = field(repr=False)
    stable: bool
    modes: tuple[ModeMargins, ...]
    one_at_a_time: tuple[DiskMargin, ...]
    all_loops: DiskMargin
    delay: DelayMargin

    @property
    def weakest_mode(self) -> int:
        """Mode with the smallest disk margin."""
        return min(self.modes, key=lambda mode: mode.disk.alpha).q

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw what gain and phase may be off at once: per mode, one cylinder, all cylinders."""
        from plant._plotting import COLOURS, axes, styled

        shown = [(self.loop.mode_name(m.q), m.disk) for m in self.modes]
        if self.stable:  # wide and grey below the mode that it coincides with
            shown.append(("one cylinder", min(self.one_at_a_time, key=lambda m: m.alpha)))
            shown.append(("all cylinders", self.all_loops))
        last = len(shown) - 1
        with styled():
            ax = axes(ax)
            for k, (name, margin) in enumerate(shown):
                if not (margin.stable and math.isfinite(margin.alpha)):
                    continue
                edge = margin.boundary()
                with np.errstate(divide="ignore"):
                    gain = 20.0 * np.log10(np.abs(edge))
                ax.plot(
                    gain,
                    np.degrees(np.angle(edge)),
                    ls="-" if k == last else _LOOKS[k % len(_LOOKS)],
                    c="0.78" if k == last else COLOURS[k % len(COLOURS)],
                    lw=5.0 if k == last else 1.5,
                    zorder=1.5 if k == last else 2.0,
                    label=name,
                )
            ax.plot(0.0, 0.0, "+", c="0.2")
            ax.set_xlim(-24.0, 24.0)
            ax.set_ylim(-120.0, 120.0)
            ax.set_xlabel("gain of the loop, of its own (dB)")
            ax.set_ylabel("phase turn (deg)")
            ax.set_title(
                "Gain and phase withstood: inside the curves" if self.stable else "Unstable loop"
            )
            if self.stable:
                ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return the margins in plain words."""
        if not self.stable:
            radius = float(np.max(np.abs(self.loop.poles))) ** self.loop.n_cylinders
            return f"The loop is unstable (pole radius {radius:.3g} a cycle): it has no margin."
        lines = [
            f"{self.loop.mode_name(m.q).capitalize()} mode: {m.disk}; gain margin "
            f"{m.classical.gain_margin:.2f}, phase margin {m.classical.phase_margin_deg:.0f} deg."
            for m in self.modes
        ]
        worst = min(self.one_at_a_time, key=lambda m: m.alpha)
        lines.append(f"One cylinder at a time: {worst}.")
        lines.append(f"All cylinders at once: {self.all_loops}.")
        lines.append(str(self.delay))
        return "\n".join(lines)


def disk_margins(
    loop: NominalLoop,
    *,
    skew: float = 0.0,
    at_delay: Callable[[float], NominalLoop] | None = None,
    nominal_delay: float = 1e-3,
) -> DiskMargins:
    """Return the margins of the air-charge loop.

    Parameters
    ----------
    loop : NominalLoop
        The loop.
    skew : float
        Skew of the disks, from -1 to 1.
    at_delay, nominal_delay
        As for `delay_margin`: the loop with a delay of the MAF sensor, and the delay it has.
    """
    in_range("skew", skew, -1.0, 1.0, "1")
    stable = loop.stable
    sensitivity = loop.lifted("charge", "disturbance")
    return DiskMargins(
        loop=loop,
        stable=stable,
        modes=tuple(_mode_margins(loop, q, skew, stable) for q in loop.modes),
        one_at_a_time=_one_at_a_time(sensitivity, skew),
        all_loops=_all_loops(sensitivity, skew, "cylinder"),
        delay=delay_margin(loop, at_delay, nominal=nominal_delay),
    )


def loop_at_a_time(loop: control.StateSpace, *, skew: float = 0.0) -> tuple[DiskMargin, ...]:
    """Disk margin of each loop of a square loop gain, the others closed.

    Parameters
    ----------
    loop : control.StateSpace
        Loop gain under negative feedback, continuous or discrete.
    skew : float
        Skew of the disk, from -1 to 1.
    """
    in_range("skew", skew, -1.0, 1.0, "1")
    return _one_at_a_time(_sensitivity(loop), skew)


def all_loops_at_once(loop: control.StateSpace, *, skew: float = 0.0) -> DiskMargin:
    """Disk margin of a square loop gain with an independent factor in every loop.

    Parameters
    ----------
    loop, skew
        As for `loop_at_a_time`.
    """
    in_range("skew", skew, -1.0, 1.0, "1")
    return _all_loops(_sensitivity(loop), skew, "loop")


def _sensitivity(loop: control.StateSpace) -> control.StateSpace:
    import control

    if loop.ninputs != loop.noutputs:
        raise ParameterError(
            f"the loop has {loop.ninputs} inputs and {loop.noutputs} outputs, but must have as "
            "many of both: close it first around what is left"
        )
    identity = control.ss([], [], [], np.eye(loop.ninputs), loop.dt)
    return control.feedback(identity, control.ss(loop))


def _is_stable(system: control.StateSpace) -> bool:
    import control

    poles = np.linalg.eigvals(np.asarray(system.A)) if system.nstates else np.zeros(0)
    if control.isdtime(system, strict=True):
        return bool(np.all(np.abs(poles) < 1.0))
    return bool(np.all(poles.real < 0.0))


def _one_at_a_time(sensitivity: control.StateSpace, skew: float) -> tuple[DiskMargin, ...]:
    import control

    count = sensitivity.ninputs
    if not _is_stable(sensitivity):
        return tuple(DiskMargin(False, skew) for _ in range(count))
    found = []
    A, B, C, D = (
        np.asarray(x) for x in (sensitivity.A, sensitivity.B, sensitivity.C, sensitivity.D)
    )
    for i in range(count):
        shifted = D[i : i + 1, i : i + 1] - 0.5 * (1.0 - skew)
        one = control.ss(A, B[:, i : i + 1], C[i : i + 1], shifted, sensitivity.dt)
        peak, where = control.linfnorm(one, tol=_PEAK)
        found.append(_of_peak(float(peak), float(where), _value(one, float(where)), skew, True))
    return tuple(found)


def _value(system: control.StateSpace, omega: float) -> complex:
    """Value of a system of one input and output at a frequency, which may be infinite."""
    import control

    if math.isinf(omega):
        return complex(system.D[0, 0])
    dt = system.dt if control.isdtime(system, strict=True) else 0.0
    point = np.exp(1j * omega * (1.0 if dt is True else dt)) if dt else 1j * omega
    return complex(system(point))


def _of_peak(peak: float, where: float, value: complex, skew: float, proved: bool) -> DiskMargin:
    """Margin of one loop from the peak of ``S + (s - 1)/2`` and its value there."""
    if peak == 0.0:
        return DiskMargin(True, skew, math.inf, math.inf, where, (), proved)
    d = np.array(1.0 / value)
    return DiskMargin(
        True, skew, 1.0 / peak, float(abs(d)), where, (complex(factor(d, skew)),), proved
    )


def _all_loops(sensitivity: control.StateSpace, skew: float, name: str) -> DiskMargin:
    import control

    from .mu import mu_analysis

    if not _is_stable(sensitivity):
        return DiskMargin(False, skew)
    n = sensitivity.ninputs
    shifted = control.ss(
        sensitivity.A,
        sensitivity.B,
        sensitivity.C,
        np.asarray(sensitivity.D) - 0.5 * (1.0 - skew) * np.eye(n),
        sensitivity.dt,
    )
    structure = BlockStructure([ComplexBlock(f"{name} {i + 1}") for i in range(n)])
    found = mu_analysis(shifted, structure, tolerance=_PROOF)
    worst = () if found.worst is None else np.diag(found.worst.matrix())
    return DiskMargin(
        True,
        skew,
        found.margin,
        math.inf if found.worst is None else found.worst.size,
        found.frequency if found.worst is None else found.worst_frequency,
        tuple(complex(factor(d, skew)) for d in worst),
        found.guaranteed,
    )


def _mode_margins(loop: NominalLoop, q: int, skew: float, stable: bool) -> ModeMargins:
    from .margins import _peak, margins_of_response

    omega, T = loop.band(q), loop.event_time

    def sensitivity(w: FloatArray) -> ComplexArray:
        found = np.asarray(loop.closed(np.exp(1j * w * T), squeeze=False), dtype=complex)
        return np.asarray(found[0, 0] - 0.5 * (1.0 - skew))

    classical = margins_of_response(lambda w: loop(np.exp(1j * w * T)), omega, stable)
    if not stable:
        return ModeMargins(q, DiskMargin(False, skew), classical)
    peak, where = _peak(lambda w: np.abs(sensitivity(w)), omega)
    return ModeMargins(
        q, _of_peak(peak, where, complex(sensitivity(np.array([where]))[0]), skew, False), classical
    )
