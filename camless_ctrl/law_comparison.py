"""Several laws on one uncertain measurement, side by side: nominal and worst case."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import ParameterError
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._loop_figures import mode_responses, noise_gain, radii, settling
from ._rank_one import RankOneLoop, UncertainValues, mode_grid
from ._realised import (
    Matrices,
    centre_of,
    corners_of,
    matrices_of,
    noise_response,
    sensitivity,
)
from .adaptation import GainSchedule
from .gain_synthesis import design_gains, loop_margins
from .uncertain_loop import SENSITIVITY_BOUND, UncertainLoop, adaptation_law

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

    from .mu import WorstCaseGain
    from .uncertain_measurement import UncertainMeasurement

_CYCLES = 400  # in which a disturbance must settle
_SHOWN = 12  # cycles of the step responses drawn
_POINTS = 60  # frequencies a half band
_HELD = 0.5  # share of a steady difference that is left where it is not adapted
_LOOKS = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class LawFigures:
    """One law on the measurement.

    Attributes
    ----------
    name : str
        Name of the law.
    loop : UncertainLoop
        Loop with it.
    order : int
        States of the law.
    stable : bool
        Whether the loop is stable in the middle of the set; if not, all below is infinite or NaN.
    radius : tuple of float
        Largest pole radius per cycle in the band of each mode.
    peak, worst_peak : float
        Largest ``|S|`` in the middle of the set, and in the whole set.
    mu_stability, mu_performance : float
        Largest mixed mu, exact on the grid.
    disk_margin : float
        Of the loop in the middle of the set.
    noise : float
        Standard deviation of the correction for white noise of the estimate, a ratio.
    held : tuple of bool
        Modes of which a steady difference is left as it is.
    settling_cycles, worst_settling_cycles : tuple of float
        Cycles to 2 % of each mode: in the middle of the set, and the slowest at the corners of
        the real parameters and, if it was sought, at the perturbation of the largest ``|S|``;
        infinite if a member of the set is unstable.
    worst : WorstCaseGain or None
        Proof of the largest ``|S|``, as a share of the bound, and its perturbation.
    """

    name: str
    loop: UncertainLoop = field(repr=False)
    order: int
    stable: bool
    radius: tuple[float, ...]
    peak: float
    worst_peak: float
    mu_stability: float
    mu_performance: float
    disk_margin: float
    noise: float
    held: tuple[bool, ...]
    settling_cycles: tuple[float, ...]
    worst_settling_cycles: tuple[float, ...]
    worst: WorstCaseGain | None = field(repr=False)

    @property
    def robust(self) -> bool:
        """Whether mu for performance is below 1."""
        return self.stable and self.mu_performance < 1.0


@dataclass(frozen=True)
class LawComparison:
    """Laws on one measurement, in the order given.

    Attributes
    ----------
    measurement : UncertainMeasurement
        The measurement.
    laws : tuple of LawFigures
        One a law.
    """

    measurement: UncertainMeasurement = field(repr=False)
    laws: tuple[LawFigures, ...]

    def __getitem__(self, name: str) -> LawFigures:
        """Return the figures of a law by its name."""
        for law in self.laws:
            if law.name == name:
                return law
        raise ParameterError(
            f"there is no law {name!r}, but {', '.join(law.name for law in self.laws)}"
        )

    @property
    def fastest(self) -> LawFigures | None:
        """Robust law that settles fastest; None if none is robust.

        The sum of the settling times in the middle of the set decides, after the number of modes
        that are held.
        """
        robust = [law for law in self.laws if law.robust]
        return min(robust, key=_slowness) if robust else None

    @cached_property
    def _grid(self) -> FloatArray:
        return mode_grid(self.measurement.n_cylinders, _POINTS)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw ``|S|`` of each law over the angle per event: nominal thin, worst case thick."""
        from plant._plotting import COLOURS, axes, styled

        values = UncertainValues.of(self.measurement, self._grid)
        bound = max(law.loop.sensitivity_bound for law in self.laws)
        with styled():
            ax = axes(ax)
            for k, law in enumerate(self.laws):
                if not law.stable:
                    continue
                one = RankOneLoop.of_law(values, law.loop.law)
                look: dict[str, Any] = {"c": COLOURS[k % 7], "ls": _LOOKS[k % len(_LOOKS)]}
                degrees = np.degrees(self._grid)
                worst = one.worst_sensitivity()
                worst = np.where(np.isfinite(worst), worst, np.nan)
                ax.plot(degrees, worst, lw=2.2, label=law.name, **look)
                ax.plot(degrees, np.abs(one.sensitivity), lw=0.8, alpha=0.75, **look)
            ax.axhline(bound, c="0.3", lw=0.9, label="bound")
            ax.set_xlim(0.0, 180.0)
            ax.set_ylim(0.0, 1.5 * bound)
            ax.set_xlabel("angle per event (deg)")
            ax.set_ylabel("|S| (1)")
            ax.set_title(f"{self.measurement.speed_rpm:g} rpm: worst case (thick), nominal (thin)")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def plot_steps(self, ax: Axes | None = None) -> Axes:
        """Draw the charge error after a step of the mean: nominal thin, at the largest |S| bold."""
        from plant._plotting import COLOURS, axes, styled

        n = self.measurement.n_cylinders
        with styled():
            ax = axes(ax)
            cycles = np.arange(n * _SHOWN) / n
            for k, law in enumerate(self.laws):
                if not law.stable:
                    continue
                look: dict[str, Any] = {"c": COLOURS[k % 7], "ls": _LOOKS[k % len(_LOOKS)]}
                nominal = _nominal(law.loop)
                if law.worst is not None and law.worst.worst is not None:
                    worst = mode_responses(_worst(law.loop, law.worst), n, _SHOWN)
                    ax.plot(cycles, worst[0].real, lw=2.2, **look)
                response = mode_responses(nominal, n, _SHOWN)
                ax.plot(cycles, response[0].real, lw=0.9, label=law.name, **look)
            ax.set_xlim(0.0, _SHOWN)
            ax.set_xlabel("time (cycles)")
            ax.set_ylabel("charge error over its step (1)")
            ax.set_title("Step of the mean: at the largest |S| (thick), nominal (thin)")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return a row a law, and which robust law settles fastest."""
        width = max(len(law.name) for law in self.laws)
        modes = self.measurement.n_cylinders // 2
        rows = [
            f"Laws at {self.measurement.speed_rpm:g} rpm; settling in cycles to 2 %, of modes q = "
            f"0 to {modes}, in the middle of the set | slowest in the set",
            f"{'law':{width}}  order  radius per cycle  |S|, worst  mu: RS    RP  disk  noise  "
            "settling",
        ]
        for law in self.laws:
            if not law.stable:
                rows.append(
                    f"{law.name:{width}}  {law.order:5d}  unstable in the middle of the set"
                )
                continue
            rows.append(
                f"{law.name:{width}}  {law.order:5d}  "
                f"{' '.join(f'{r:.3f}' for r in law.radius):>16}  {law.peak:4.2f} "
                f"{law.worst_peak:6.2f}  {law.mu_stability:6.3f} {law.mu_performance:5.3f}  "
                f"{law.disk_margin:4.2f}  {law.noise:5.3f}  "
                f"{_times(law.settling_cycles, law.held)} | "
                f"{_times(law.worst_settling_cycles, law.held)}"
                + ("" if law.robust else "  NOT robust")
            )
        best = self.fastest
        rows.append(
            "No law is robust." if best is None else f"Fastest of the robust laws: {best.name}."
        )
        return "\n".join(rows)


def standard_laws(
    measurement: UncertainMeasurement,
    *,
    present: GainSchedule | None = None,
    timeout_s: float = 30.0,
    progress: Progress | None = None,
) -> dict[str, control.StateSpace]:
    """Return the laws that there are: present and designed gains, H-infinity and D-K.

    Parameters
    ----------
    measurement : UncertainMeasurement
        The measurement.
    present : GainSchedule, optional
        Gains in use; the default schedule if not given.
    timeout_s : float
        Time limit of each synthesis, s.
    progress : callable, optional
        Called with the laws done and their number.

    Raises
    ------
    SynthesisError
        If a synthesis finds no robust law.
    """
    from .lti_synthesis import dk_law, hinf_law

    present = GainSchedule() if present is None else present
    found = {"present gains": adaptation_law(measurement, present.at(measurement.speed_rpm))}
    gains = design_gains(measurement, confirm=False).gains
    found["designed gains"] = adaptation_law(measurement, gains)
    for name, make in (("H-infinity", hinf_law), ("D-K", dk_law)):
        if progress is not None:
            progress(len(found), 4)
        found[name] = make(measurement, gains, timeout_s=timeout_s, confirm=False).system
    if progress is not None:
        progress(len(found), 4)
    return found


def compare_laws(
    measurement: UncertainMeasurement,
    laws: Mapping[str, control.StateSpace],
    *,
    sensitivity_bound: float = SENSITIVITY_BOUND,
    worst_case: bool = True,
    progress: Progress | None = None,
) -> LawComparison:
    """Compare laws on one measurement.

    Parameters
    ----------
    measurement : UncertainMeasurement
        The measurement.
    laws : mapping of str to control.StateSpace
        Laws per event, from the estimate to the correction, by name.
    sensitivity_bound : float
        Bound on ``|S|`` that stands for performance.
    worst_case : bool
        Whether to prove the largest ``|S|`` with `mu.worst_case_gain`, and settle with its
        perturbation too (some seconds a law).
    progress : callable, optional
        Called with the laws done and their number.
    """
    if not laws:
        raise ParameterError("laws is empty, but must name at least one law")
    found = []
    for k, (name, law) in enumerate(laws.items()):
        loop = UncertainLoop(measurement, law, sensitivity_bound)
        found.append(_figures(name, loop, worst_case))
        if progress is not None:
            progress(k + 1, len(laws))
    return LawComparison(measurement, tuple(found))


def _figures(name: str, loop: UncertainLoop, worst_case: bool) -> LawFigures:
    m, n = loop.measurement, loop.measurement.n_cylinders
    order, modes = int(loop.law.nstates), n // 2 + 1
    radius = tuple(radii(loop.poles, n).tolist())
    endless = (math.inf,) * modes
    if not loop.stable:
        return LawFigures(
            name, loop, order, False, radius, math.inf, math.inf, math.inf, math.inf, math.nan,
            math.inf, (False,) * modes, endless, endless, None,
        )  # fmt: skip
    values = UncertainValues.of(m, mode_grid(n, _POINTS))
    one = RankOneLoop.of_law(values, loop.law)
    closed = _nominal(loop)
    at = np.exp(2j * np.pi * np.arange(modes) / n)
    left = np.abs(RankOneLoop.of_law(_points(m, at), loop.law).sensitivity)
    settled = settling(mode_responses(closed, n, _CYCLES), n)
    at_corners = sensitivity(corners_of(m), matrices_of(loop.law))
    late = settling(mode_responses(at_corners, n, _CYCLES), n).max(axis=0)
    mu_stability = float(one.mu_stability().max())
    if mu_stability >= 1.0:  # exact: some member of the set never settles
        late = np.full(modes, np.inf)
    worst: WorstCaseGain | None = None
    if worst_case:
        from .mu import worst_case_gain

        worst = worst_case_gain(loop.system, loop.structure)
        if math.isinf(worst.peak_lower):
            late = np.full(modes, np.inf)
        elif worst.worst is not None:
            responses = mode_responses(_worst(loop, worst), n, _CYCLES)
            late = np.maximum(late, settling(responses, n))
    return LawFigures(
        name,
        loop,
        order,
        True,
        radius,
        float(np.abs(one.sensitivity).max()),
        float(one.worst_sensitivity().max()),
        mu_stability,
        float(one.mu_performance(loop.sensitivity_bound).max()),
        loop_margins(loop).disk_margin,
        noise_gain(noise_response(centre_of(m), matrices_of(loop.law))),
        tuple((left > _HELD).tolist()),
        tuple(settled.tolist()),
        tuple(late.tolist()),
        worst,
    )


def _points(measurement: UncertainMeasurement, z: ComplexArray) -> UncertainValues:
    return UncertainValues.of(measurement, np.abs(np.angle(z)))


def _nominal(loop: UncertainLoop) -> Matrices:
    """Matrices from the disturbance to the error in the middle of the set."""
    return sensitivity(centre_of(loop.measurement), matrices_of(loop.law))


def _worst(loop: UncertainLoop, worst: WorstCaseGain) -> Matrices:
    """Matrices from the disturbance to the error with the worst perturbation."""
    A, B, C, D = matrices_of(worst.worst_system())
    return Matrices(A, B, loop.sensitivity_bound * C, loop.sensitivity_bound * D)


def _slowness(law: LawFigures) -> tuple[int, float]:
    times = [t for t, held in zip(law.settling_cycles, law.held, strict=True) if not held]
    return sum(law.held), sum(times)


def _times(times: tuple[float, ...], held: tuple[bool, ...]) -> str:
    """Settling times in words; those of a held mode mean nothing."""
    shown = []
    for time, kept in zip(times, held, strict=True):
        if kept:
            shown.append("held")
        else:
            shown.append(f"{time:.1f}" if math.isfinite(time) else "never")
    return " ".join(shown)
