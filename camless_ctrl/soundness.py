"""Is the robustness verdict sound? Random members of the set against what was proved of it.

Two kinds of members: linear ones of the description M-Delta, of which thousands cost nothing,
and full plants, drawn from the whole uncertainty set and run in closed loop with the controller
itself. A verdict is sound if none of them is unstable or less well damped than proved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from plant import CrankAnglePlant
from plant._checks import positive, whole
from plant.kinematics import FloatArray
from uncertainty.sampling import Sample, corners, draw

from ._closed_loop_runs import step_response
from ._loop_cases import Case, sampled_cases
from ._lti_members import random_all_passes, sensitivity_peaks, spectral_radii
from ._processes import in_processes
from ._step_response import StepResponse
from .adaptation import GainSchedule
from .charge_model import ChargeModel
from .feedforward import Feedforward
from .uncertain_loop import SENSITIVITY_BOUND, UncertainLoop
from .uncertain_measurement import UncertainMeasurement

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class LtiCheck:
    """Random linear members of one loop's set.

    Attributes
    ----------
    speed_rpm : float
        Speed.
    seed : int
        Seed of the samples.
    bound : float
        Largest ``|S|`` allowed.
    radius : ndarray (samples,)
        Spectral radius per cycle.
    peak : ndarray (samples,)
        Largest ``|S|``; NaN where unstable.
    """

    speed_rpm: float
    seed: int
    bound: float
    radius: FloatArray = field(repr=False)
    peak: FloatArray = field(repr=False)

    @property
    def samples(self) -> int:
        """Number of members."""
        return self.radius.size

    @property
    def unstable(self) -> int:
        """Number of unstable ones."""
        return int(np.count_nonzero(~(self.radius < 1.0)))

    @property
    def beyond(self) -> int:
        """Number of stable ones whose ``|S|`` is beyond the bound."""
        return int(np.count_nonzero(self.peak > self.bound))

    @property
    def violations(self) -> int:
        """Number of either."""
        return self.unstable + self.beyond

    def __str__(self) -> str:
        """Return counts and worst figures."""
        peak = np.max(self.peak, initial=-math.inf, where=np.isfinite(self.peak))
        worst = f"worst |S| of the stable ones {peak:.3f}, " if np.isfinite(peak) else ""
        return (
            f"{self.speed_rpm:g} rpm, {self.samples} linear members (seed {self.seed}): "
            f"{self.unstable} unstable, {self.beyond} beyond |S| = {self.bound:.3f}; {worst}"
            f"worst radius {np.max(self.radius):.3f} per cycle"
        )


@dataclass(frozen=True)
class SampledPlantRun:
    """One sampled full plant in closed loop.

    Attributes
    ----------
    speed_rpm : float
        Speed.
    values : dict of str to float
        Its parameters.
    predicted_radius : float
        Spectral radius per cycle of the description at its modelled parameters.
    growth, left : tuple of float
        Growth per cycle of each mode, 0 for one that died in the noise, and what is left of it
        at the end.
    held : bool
        Whether differences between cylinders are not adapted, and have to stay.
    stable : bool
        Whether every adapted mode decays and every held one stays.
    peak, bound : float
        Largest ``|S|`` (NaN if unstable), and the largest allowed.
    """

    speed_rpm: float
    values: Mapping[str, float] = field(repr=False)
    predicted_radius: float
    growth: tuple[float, ...]
    left: tuple[float, ...]
    held: bool
    stable: bool
    peak: float
    bound: float

    @property
    def violation(self) -> bool:
        """Whether it is unstable or beyond the bound."""
        return not (self.stable and self.peak <= self.bound)

    @property
    def worst_growth(self) -> float:
        """Largest growth per cycle of an adapted mode."""
        return max(self.growth[:1] if self.held else self.growth)

    def __str__(self) -> str:
        """Return growth of each mode and peak."""
        modes = ", ".join(f"{growth:.3f}" for growth in self.growth)
        state = "stable" if self.stable else "UNSTABLE"
        return (
            f"{self.speed_rpm:g} rpm: {state}, growth per cycle of the modes {modes}"
            f"{' (differences held)' if self.held else ''}, predicted radius "
            f"{self.predicted_radius:.3f}; largest |S| {self.peak:.3f} (allowed {self.bound:.3f})"
        )


@dataclass(frozen=True)
class SampledPlantsCheck:
    """Sampled full plants in closed loop at several speeds.

    Attributes
    ----------
    runs : tuple of SampledPlantRun
        The runs.
    seed : int
        Seed of the samples.
    """

    runs: tuple[SampledPlantRun, ...] = field(repr=False)
    seed: int

    @property
    def violations(self) -> tuple[SampledPlantRun, ...]:
        """Runs that are unstable or beyond the bound."""
        return tuple(run for run in self.runs if run.violation)

    @property
    def unstable(self) -> int:
        """Number of unstable runs."""
        return sum(not run.stable for run in self.runs)

    def at(self, speed_rpm: float) -> tuple[SampledPlantRun, ...]:
        """Runs at a speed."""
        return tuple(run for run in self.runs if run.speed_rpm == speed_rpm)

    def __str__(self) -> str:
        """Return a line for each speed, and the violations."""
        lines = [
            f"{len(self.runs)} sampled full plants in closed loop (seed {self.seed}): "
            f"{self.unstable} unstable, {len(self.violations) - self.unstable} stable ones beyond "
            "the bound"
        ]
        for speed in dict.fromkeys(run.speed_rpm for run in self.runs):
            runs = self.at(speed)
            peaks = [run.peak for run in runs if run.stable]
            peak = f"{max(peaks):.3f}" if peaks else "none"
            held = " of the mean, differences held" if runs[0].held else ""
            lines.append(
                f"  {speed:g} rpm: {len(runs)} plants, worst growth{held} "
                f"{max(run.worst_growth for run in runs):.3f} per cycle, worst |S| {peak} (allowed "
                f"{runs[0].bound:.3f})"
            )
        return "\n".join(lines + [f"  violation: {run}" for run in self.violations])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw growth on the full plants against the radius predicted for them."""
        from plant._plotting import COLOURS, axes, styled

        speeds = list(dict.fromkeys(run.speed_rpm for run in self.runs))
        with styled():
            ax = axes(ax, (5.6, 4.2))
            for k, speed in enumerate(speeds):
                runs = self.at(speed)
                ax.plot(
                    [run.predicted_radius for run in runs],
                    [run.worst_growth for run in runs],
                    "os^DvP*"[k % 7],
                    c=COLOURS[k % len(COLOURS)],
                    mfc="none",
                    label=f"{speed:g} rpm",
                )
            low, high = ax.get_xlim()
            ax.plot([low, high], [low, high], c="0.5", lw=0.9, zorder=0, label="as predicted")
            ax.axhline(1.0, c="0.3", lw=0.9, ls=":", label="limit")
            ax.set_xlim(low, high)
            ax.set_xlabel("spectral radius per cycle, predicted (1)")
            ax.set_ylabel("growth per cycle, full plant (1)")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax


def check_lti(
    loop: UncertainLoop, *, samples: int = 1000, seed: int = 0, bound: float | None = None
) -> LtiCheck:
    """Count linear members of the set that are unstable or less well damped than proved.

    Every other member has its parameters at corners of the box, the rest anywhere in it. The
    remainder is plus or minus 1, a delay, or an all-pass of order 1 or 2: all of size 1.

    Parameters
    ----------
    loop : UncertainLoop
        The loop.
    samples : int
        Number of members.
    seed : int
        Seed of the samples.
    bound : float, optional
        Largest ``|S|`` proved for the set, such as `WorstCaseGain.ceiling` times the loop's
        `sensitivity_bound`; that bound alone by default.
    """
    whole("samples", samples, 1, 1_000_000)
    whole("seed", seed, 0, 2**63 - 1)
    allowed = positive("bound", loop.sensitivity_bound if bound is None else bound, "1")
    random = np.random.default_rng(seed)
    reals = list(loop.measurement.directions)
    deltas = random.uniform(-1.0, 1.0, (samples, len(reals)))
    deltas[::2] = np.sign(deltas[::2])
    numerator, denominator = random_all_passes(samples, random)
    radius = spectral_radii(loop, deltas, numerator, denominator)
    peak = sensitivity_peaks(loop, deltas, numerator, denominator)
    return LtiCheck(
        loop.measurement.speed_rpm, seed, allowed, radius, np.where(radius < 1.0, peak, np.nan)
    )


def check_sampled_plants(
    measurements: Sequence[UncertainMeasurement],
    feedforward: Feedforward | ChargeModel,
    gains: GainSchedule | None = None,
    *,
    samples: int = 20,
    at_corners: bool = False,
    cycles: int = 30,
    bounds: Mapping[float, float] | None = None,
    plant: CrankAnglePlant | None = None,
    seed: int = 0,
    processes: int = 2,
    progress: Progress | None = None,
) -> SampledPlantsCheck:
    """Run the controller against full plants drawn from the whole uncertainty set.

    A random plant is seldom near a corner, where a loop breaks first: look there as well.

    Each starts at its own equilibrium, the sensor without noise; then the valve of the first
    cylinder closes late by what the map takes for 2 % of charge, which disturbs all modes.

    Parameters
    ----------
    measurements : sequence of UncertainMeasurement
        Operating point, estimator and uncertainty of each speed.
    feedforward : Feedforward or ChargeModel
        What the controller believes.
    gains : GainSchedule, optional
        Gains; the default ones if not given.
    samples : int
        Plants at each speed.
    at_corners : bool
        Whether to run all corners of the modelled parameters instead, all else nominal.
    cycles : int
        Length of a run.
    bounds : mapping of float to float, optional
        Largest ``|S|`` allowed at each speed; `SENSITIVITY_BOUND` by default.
    plant : CrankAnglePlant, optional
        Nominal plant; the paper's with runner and oscillation by default.
    seed : int
        Seed of the samples.
    processes : int
        Number of processes.
    progress : callable, optional
        Called with the number of plants done and the number in all.
    """
    plant = CrankAnglePlant(runner=True, oscillation=True) if plant is None else plant
    schedule = GainSchedule() if gains is None else gains
    whole("seed", seed, 0, 2**63 - 1)
    seeds = np.random.SeedSequence(seed).generate_state(max(len(measurements), 1))
    cases: list[Case] = []
    drawn: list[tuple[UncertainMeasurement, Sample, int]] = []
    for m, own in zip(measurements, seeds, strict=True):
        sample = _corners(m) if at_corners else draw(m.uncertain, samples, int(own))
        cases += sampled_cases(m, feedforward, schedule, sample, plant, cycles)
        drawn += [(m, sample, i) for i in range(len(sample))]
    responses = in_processes(step_response, cases, processes, progress)
    loops = {m.speed_rpm: UncertainLoop.adaptive(m, schedule.at(m.speed_rpm)) for m in measurements}
    runs = []
    for (m, sample, i), response in zip(drawn, responses, strict=True):
        values = sample.at(i)
        radius = loops[m.speed_rpm].spectral_radius(m.deltas(values))
        bound = SENSITIVITY_BOUND if bounds is None else bounds[m.speed_rpm]
        runs.append(_run(m.speed_rpm, values, radius, response, bound))
    return SampledPlantsCheck(tuple(runs), seed)


def _corners(measurement: UncertainMeasurement) -> Sample:
    """Corners of the modelled parameters, the others nominal."""
    uncertain = measurement.uncertain
    modelled = corners(uncertain.only(measurement.directions))
    values = np.tile(uncertain.nominal, (len(modelled), 1))
    for name in modelled.uncertain.names:
        values[:, uncertain.names.index(name)] = modelled.column(name)
    return Sample(uncertain, values)


def _run(
    speed_rpm: float, values: dict[str, float], radius: float, r: StepResponse, bound: float
) -> SampledPlantRun:
    return SampledPlantRun(
        speed_rpm=speed_rpm,
        values=values,
        predicted_radius=radius,
        growth=tuple(r.growth(q) for q in r.modes),
        left=tuple(r.left(q) for q in r.modes),
        held=r.held,
        stable=r.stable,
        peak=r.sensitivity_peak,
        bound=bound,
    )
