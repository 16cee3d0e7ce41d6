"""Structured robustness of the air-charge loop: what it withstands, and where it breaks.

Robust stability and performance by the structured singular value, the worst-case gain,
disturbance and step response, and how much of one block is withstood while all others take
their whole ranges (skewed mu).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import ParameterError
from plant._checks import one_of, whole
from plant.kinematics import FloatArray

from .mu.result import MuResult
from .mu.worst_case import WorstCaseGain
from .uncertain_loop import REMAINDER, UncertainLoop

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class StructuredRobustness:
    """Robustness of one loop at one speed against its structured uncertainty.

    Attributes
    ----------
    loop : UncertainLoop
        The loop.
    stability : MuResult or None
        Robust stability; None for a loop that is unstable in the middle of the set.
    performance : MuResult or None
        Robust performance: ``|S|`` within the loop's bound for the whole set.
    worst_gain : WorstCaseGain or None
        Largest error over the set; infinite if the loop is not robustly stable.
    nominal_peak : float
        Largest ``|S|`` in the middle of the set; NaN if unstable.
    """

    loop: UncertainLoop = field(repr=False)
    stability: MuResult | None = field(repr=False)
    performance: MuResult | None = field(repr=False)
    worst_gain: WorstCaseGain | None = field(repr=False)
    nominal_peak: float

    @property
    def speed_rpm(self) -> float:
        """Speed."""
        return self.loop.measurement.speed_rpm

    @property
    def stable(self) -> bool:
        """Whether the middle of the set is stable."""
        return self.stability is not None

    @property
    def robustly_stable(self) -> bool:
        """Whether the whole set is proved stable, between the frequencies too."""
        return _proved(self.stability)

    @property
    def robust_performance(self) -> bool:
        """Whether the sensitivity bound is proved for the whole set."""
        return _proved(self.performance)

    @property
    def margin(self) -> float:
        """Size of the set, of the assumed one, that is withstood; 0 if unstable.

        It is proved between the frequencies if `stability.guaranteed`.
        """
        return self.stability.margin if self.stability is not None else 0.0

    @property
    def worst_sensitivity(self) -> tuple[float, float]:
        """Lower and upper bound of the largest ``|S|`` over the set; NaN if unstable."""
        if self.worst_gain is None:
            return float("nan"), float("nan")
        bound = self.loop.sensitivity_bound
        return bound * self.worst_gain.peak_lower, bound * self.worst_gain.peak_upper

    @property
    def breaking_mode(self) -> int | None:
        """Circulant mode in whose band the set first breaks; None if nothing breaks it."""
        if self.stability is None or self.stability.worst is None:
            return None
        return self._mode(self.stability.worst_frequency)

    @property
    def breaking_values(self) -> dict[str, float]:
        """Values of the real parameters at which it first breaks; they may lie out of bounds."""
        if self.stability is None or self.stability.worst is None:
            return {}
        worst = self.stability.worst
        names = self.loop.measurement.directions
        return self.loop.measurement.values({name: float(worst[name].real) for name in names})

    @property
    def amplified_mode(self) -> int | None:
        """Circulant mode in whose band the worst disturbance lies; None without one."""
        found = self.worst_gain
        return None if found is None or found.worst is None else self._mode(found.frequency)

    def worst_disturbance(self, cycles: int = 8) -> FloatArray:
        """Charge disturbance of size 1 that is amplified most (cycles, cylinders).

        The sine, event by event in the order of induction, at whose frequency the worst
        perturbation has its largest sensitivity.

        Raises
        ------
        ParameterError
            If there is none: the loop is unstable, or nothing is amplified.
        """
        whole("cycles", cycles, 1, 100_000)
        if self.worst_gain is None or self.worst_gain.worst is None:
            raise ParameterError(
                f"the loop at {self.speed_rpm:g} rpm has no worst disturbance: it is unstable in "
                "the middle of the set, or no perturbation was found"
            )
        m = self.loop.measurement
        angle = self.worst_gain.frequency * m.event_time
        events = np.arange(cycles * m.n_cylinders)
        return np.asarray(np.cos(angle * events).reshape(cycles, m.n_cylinders))

    def withstood_alone(self, name: str, *, seed: int = 0) -> MuResult:
        """How much of one block is withstood while all others take their whole ranges.

        Parameters
        ----------
        name : str
            The block: a parameter, or ``remainder``. `MuResult.margin` is its size as a multiple
            of the assumed one; 0 if the others destabilise alone.
        seed : int
            Seed of the search.

        Raises
        ------
        ParameterError
            If there is no such block, or the loop is unstable in the middle of the set.
        """
        from .mu import skewed_mu

        structure = self.loop.structure
        one_of("block", name, structure.names)
        inner = self.loop.system[: structure.inputs, : structure.outputs]
        return skewed_mu(inner, structure, name, seed=seed)

    def _mode(self, frequency: float) -> int:
        """Mode in whose band a frequency lies."""
        m = self.loop.measurement
        return round(float(frequency) * m.event_time * m.n_cylinders / (2.0 * np.pi))

    def record(self) -> dict[str, Any]:
        """Return the figures, for a JSON file."""
        rs, rp = self.stability, self.performance
        low, high = self.worst_sensitivity
        nan = float("nan")
        return {
            "rs_upper": rs.peak_upper if rs else nan,
            "rs_lower": rs.peak_lower if rs else nan,
            "rp_upper": rp.peak_upper if rp else nan,
            "rp_lower": rp.peak_lower if rp else nan,
            "frequency": rs.frequency if rs else nan,
            "mode": self.breaking_mode,
            "proved": bool(rs and rs.guaranteed and rp and rp.guaranteed),
            "margin": self.margin,
            "breaks_at": self.breaking_values,
            "worst_case_gain": {
                "nominal": self.nominal_peak,
                "lower": low,
                "upper": high,
                "bound": self.loop.sensitivity_bound,
                "frequency": self.worst_gain.frequency if self.worst_gain else nan,
                "mode": self.amplified_mode,
            },
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw both singular values over the angle per event, with the modes' places."""
        from plant._plotting import COLOURS, axes, styled

        m = self.loop.measurement
        with styled():
            ax = axes(ax)
            for found, name, style, colour in (
                (self.stability, "robust stability", "-", COLOURS[0]),
                (self.performance, "robust performance", "--", COLOURS[1]),
            ):
                if found is not None:
                    angle = np.degrees(found.omega * m.event_time)
                    ax.plot(angle, found.upper, style, c=colour, label=name)
            ax.axhline(1.0, c="0.3", lw=0.9, ls=":", label="limit")
            for q in range(m.n_cylinders // 2 + 1):
                ax.axvline(360.0 * q / m.n_cylinders, c="0.85", lw=4.0, zorder=0)
            ax.set_xlim(0.0, 180.0)
            ax.set_ylim(bottom=0.0)
            ax.set_xticks([360.0 * q / m.n_cylinders for q in range(m.n_cylinders // 2 + 1)])
            ax.set_xlabel("angle per event (deg); grey: the modes' steady imbalances")
            ax.set_ylabel("structured singular value (1)")
            ax.set_title(f"{self.speed_rpm:g} rpm")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def plot_step(self, cycles: int = 20) -> Figure:
        """Draw the charge error after a step disturbance: middle and worst of the set."""
        import control
        from matplotlib.figure import Figure

        from plant._plotting import COLOURS, axes, styled

        whole("cycles", cycles, 1, 100_000)
        m, bound = self.loop.measurement, self.loop.sensitivity_bound
        time = m.event_time * np.arange(cycles * m.n_cylinders)
        with styled():
            ax = axes(None)
            shown = [(self.loop.perturbed({}), "middle of the set", "-", COLOURS[0])]
            if self.worst_gain is not None and np.isfinite(self.worst_gain.peak_upper):
                worst = self.worst_gain.worst_system()
                shown.append((worst, "worst case", "--", COLOURS[1]))
            for system, label, style, colour in shown:
                _, error = control.step_response(system, time)
                ax.step(
                    time / m.event_time / m.n_cylinders,
                    100.0 * bound * np.squeeze(error),
                    style,
                    where="post",
                    c=colour,
                    label=label,
                )
            ax.axhline(0.0, c="0.3", lw=0.8)
            ax.set_xlabel("cycles after the step")
            ax.set_ylabel("charge error (% of the step)")
            ax.set_title(f"Step of all cylinders' charge at {self.speed_rpm:g} rpm")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            figure = ax.figure
        assert isinstance(figure, Figure)
        return figure

    def __str__(self) -> str:
        """Return the verdict in plain words."""
        m = self.loop.measurement
        head = f"{m.speed_rpm:g} rpm, {1e6 * m.demand:.0f} mg"
        if self.stability is None or self.performance is None:
            return f"{head}: unstable in the middle of the assumed set; nothing is withstood"
        if self.robustly_stable:
            verdict = "robustly stable"
        else:
            verdict = "NOT " + ("" if self.stability.robust is False else "proved ")
            verdict += "robustly stable"
        low, high = self.worst_sensitivity
        gain = "the worst case is unstable"
        if np.isfinite(high):
            gain = f"an error is amplified up to {high:.2f} times in the worst case"
        elif np.isfinite(low):
            gain = f"an error is amplified {low:.2f} times or more, without a proved limit"
        breaks = ""
        if self.stability.worst is not None:
            values = ", ".join(
                f"{name} {_shown(value, m.uncertain[name].unit)}"
                for name, value in self.breaking_values.items()
            )
            breaks = (
                f"; breaks first in mode q={self.breaking_mode}, towards {values} and a "
                f"{REMAINDER} of {self.stability.worst.sizes[REMAINDER]:.2f} times the assumed one"
            )
        return (
            f"{head}: {verdict}: {self.margin:.2f} times the assumed set is withstood (mu "
            f"{self.stability.peak_lower:.3f} to {self.stability.peak_upper:.3f}); {gain} "
            f"(nominally {self.nominal_peak:.2f}, bound {self.loop.sensitivity_bound:g}: mu "
            f"{self.performance.peak_upper:.3f}){breaks}"
        )


def analyse_structured(loop: UncertainLoop, *, seed: int = 0) -> StructuredRobustness:
    """Analyse a loop against its structured uncertainty.

    Parameters
    ----------
    loop : UncertainLoop
        The loop.
    seed : int
        Seed of the searches for the worst perturbation.
    """
    from .mu import robust_performance, robust_stability, worst_case_gain

    if not loop.stable:
        return StructuredRobustness(loop, None, None, None, float("nan"))
    angle = np.linspace(0.0, np.pi, 2001)
    with np.errstate(divide="ignore", invalid="ignore"):
        response = loop.loop_response(np.exp(1j * angle))
        size = np.abs(1.0 / (1.0 + response))
    peak = float(np.max(size[np.isfinite(size)]))
    return StructuredRobustness(
        loop,
        robust_stability(loop.system, loop.structure, seed=seed),
        robust_performance(loop.system, loop.structure, seed=seed),
        worst_case_gain(loop.system, loop.structure, seed=seed),
        peak,
    )


def _proved(found: MuResult | None) -> bool:
    return found is not None and found.guaranteed and found.robust is True


def _shown(value: float, unit: str) -> str:
    if unit == "s":
        return f"{1e3 * value:.1f} ms"
    return f"{value:.3g}" if unit == "1" else f"{value:.3g} {unit}"
