"""Is the robustness verdict tight? The worst perturbation, driven into the full plant.

The structured singular value predicts which combination of parameters breaks the loop first,
and how far it has to be taken. Here the full plant is given these parameters, further and
further along the predicted direction, until its own closed loop loses stability. The complex
remainder cannot be given to a plant and is left out, so the prediction to compare with is that
of the real parameters alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from plant import CrankAnglePlant, ParameterError
from plant._checks import in_range, positive, whole
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray
from uncertainty.sampling import Sample

from ._closed_loop_runs import step_response
from ._loop_cases import sampled_cases, widened
from ._lti_members import spectral_radii
from ._step_response import adapted_growth, turns_of_fastest
from .adaptation import AdaptationGains, GainSchedule
from .charge_model import ChargeModel
from .feedforward import Feedforward
from .mu.blocks import BlockStructure, RealBlock
from .mu.result import MuResult
from .uncertain_loop import UncertainLoop
from .uncertain_measurement import UncertainMeasurement

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WITHIN = 0.25  # of the prediction, in which the full plant should break
FARTHEST = 4.0  # times the bounds, up to which a break is sought
_LEAST = {"maf.delay": 0.0, "maf.time_constant": 1e-3}  # s, below which no sensor can be
_SCAN = 201
_HIGHEST = 50.0  # gain up to which a break is sought
_RAISE, _FINE, _RUNS = 1.12, 0.01, 16  # steps of the search on the full plant; runs, about

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TightnessCheck:
    """Where one loop breaks along its worst direction, predicted and on the full plant.

    Attributes
    ----------
    speed_rpm : float
        Speed.
    gains : AdaptationGains
        Gains of the trial.
    gain_factor : float
        Their ratio to the gains given.
    stability : MuResult
        Structured singular value with the remainder.
    real_margin : float
        Margin of the real parameters alone, in any direction (`MuResult.margin`).
    direction : dict of str to float
        Worst direction in normalised parameters, the largest of size 1.
    predicted, simulated : float
        Distance along it at which the loop breaks, as a multiple of the assumed bounds;
        `simulated` is infinite if the full plant breaks at none of `scales`, 0 if at all.
    predicted_turns, simulated_turns : float
        Turns per cycle of the pole that breaks (or, at the last of `scales`, grows most): q for
        mode q, half-way between two modes where the error changes sign from cycle to cycle.
    values : dict of str to float
        Parameters at which the full plant breaks (or at the last of `scales`).
    limited : tuple of str
        Parameters that a plant cannot have so far out, held where it can.
    scales : ndarray (k,)
        Distances at which the full plant was run, rising.
    growth : ndarray (k, modes)
        Growth per cycle of each mode there, 0 for one that died in the noise.
    predicted_growth : ndarray (k, modes)
        That of the description.
    """

    speed_rpm: float
    gains: AdaptationGains
    gain_factor: float
    stability: MuResult = field(repr=False)
    real_margin: float
    direction: Mapping[str, float]
    predicted: float
    simulated: float
    predicted_turns: float
    simulated_turns: float
    values: Mapping[str, float]
    limited: tuple[str, ...]
    scales: FloatArray = field(repr=False)
    growth: FloatArray = field(repr=False)
    predicted_growth: FloatArray = field(repr=False)

    @property
    def ratio(self) -> float:
        """Simulated over predicted distance."""
        return self.simulated / self.predicted

    @property
    def tight(self) -> bool:
        """Whether they agree within `WITHIN`."""
        return abs(self.ratio - 1.0) <= WITHIN

    def __str__(self) -> str:
        """Return both distances, the modes and the parameters at the break."""
        values = ", ".join(f"{name} {value:.4g}" for name, value in self.values.items())
        held = f" ({', '.join(self.limited)} held where a sensor can be)" if self.limited else ""
        broke = (
            f"the full plant did not up to {self.scales[-1]:.3f}; there"
            if math.isinf(self.simulated)
            else f"the full plant at {self.simulated:.3f} ({self.simulated_turns:.2f} turns; ratio "
            f"{self.ratio:.3f}), with"
        )
        return (
            f"{self.speed_rpm:g} rpm, gains x {self.gain_factor:.2f}: the description breaks at "
            f"{self.predicted:.3f} times the bounds ({self.predicted_turns:.2f} turns per cycle), "
            f"{broke} {values}{held}. Margin with the remainder {self.stability.margin:.3f}, "
            f"without it {self.real_margin:.3f} in any direction."
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw growth per cycle of the modes along the worst direction."""
        from plant._plotting import COLOURS, axes, styled

        with styled():
            ax = axes(ax)
            for q in range(self.growth.shape[1]):
                colour = COLOURS[q % len(COLOURS)]
                name = "mean" if q == 0 else f"q={q}"
                ax.plot(
                    self.scales,
                    self.predicted_growth[:, q],
                    ("-", "--", "-.")[q % 3],
                    c=colour,
                    label=f"{name}, predicted",
                )
                ax.plot(
                    self.scales,
                    np.where(self.growth[:, q] > 0.0, self.growth[:, q], np.nan),
                    "os^"[q % 3],
                    c=colour,
                    mfc="none",
                    label=f"{name}, full plant",
                )
            ax.axhline(1.0, c="0.3", lw=0.9, ls=":", label="limit")
            ax.set_xlabel("distance along the worst direction (assumed bounds)")
            ax.set_ylabel("growth per cycle (1)")
            ax.set_title(f"{self.speed_rpm:g} rpm, gains x {self.gain_factor:.2f}")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax


def check_tightness(
    measurement: UncertainMeasurement,
    feedforward: Feedforward | ChargeModel,
    gains: AdaptationGains,
    *,
    target: float | None = 0.9,
    plant: CrankAnglePlant | None = None,
    cycles: int = 40,
    seed: int = 0,
    progress: Progress | None = None,
) -> TightnessCheck:
    """Drive the full plant along the predicted worst direction until it loses stability.

    Parameters
    ----------
    measurement : UncertainMeasurement
        Operating point, estimator and uncertainty.
    feedforward : Feedforward or ChargeModel
        What the controller believes.
    gains : AdaptationGains
        Gains per cycle; those of a loop in service leave so much margin that the parameters
        at the break would be absurd.
    target : float, optional
        Distance, in assumed bounds, at which the worst corner of the parameters shall break:
        the gains are scaled to it. None takes them as they are.
    plant : CrankAnglePlant, optional
        Nominal plant; the paper's with runner and oscillation by default.
    cycles : int
        Length of a run.
    seed : int
        Seed of the search for the worst perturbation.
    progress : callable, optional
        Called with the number of runs done and the most that there may be.

    Raises
    ------
    ParameterError
        If the gains cannot be scaled to the target, the middle of the set is unstable, or
        the description does not break along the direction.
    """
    from .mu import robust_stability

    plant = CrankAnglePlant(runner=True, oscillation=True) if plant is None else plant
    whole("cycles", cycles, 4, 100_000)
    factor = 1.0 if target is None else gain_factor_for(measurement, gains, target)
    trial = gains.scaled(factor)
    loop = UncertainLoop.adaptive(measurement, trial)
    if not loop.stable:
        raise ParameterError(
            f"the loop at {measurement.speed_rpm:g} rpm is unstable in the middle of the set: "
            "lower the gains, or give a target"
        )
    reals = list(measurement.directions)
    stability = robust_stability(loop.system, loop.structure, seed=seed)
    if stability.worst is None:
        raise ParameterError("no perturbation destabilises the loop: raise the gains")
    found = {name: float(stability.worst[name]) for name in reals}
    largest = max(abs(value) for value in found.values())
    if largest == 0.0:
        raise ParameterError("the remainder alone is worst, which no plant can be given")
    direction = {name: value / largest for name, value in found.items()}
    walk = _Walk(measurement, loop, direction, plant, feedforward, trial, cycles)
    predicted = walk.predicted()
    only_reals = BlockStructure([RealBlock(name) for name in reals])
    alone = robust_stability(loop.system, only_reals, seed=seed)
    simulated = walk.simulated(predicted, progress)
    order = sorted(walk.runs)
    at_break = order[-1] if math.isinf(simulated) else simulated
    deltas, limited = physical(measurement, direction, at_break)
    return TightnessCheck(
        speed_rpm=measurement.speed_rpm,
        gains=trial,
        gain_factor=factor,
        stability=stability,
        real_margin=alone.margin,
        direction=direction,
        predicted=predicted,
        simulated=simulated,
        predicted_turns=turns_of_fastest(walk.poles(predicted), measurement.n_cylinders),
        simulated_turns=walk.turns[min(order, key=lambda s: abs(s - at_break))],
        values=measurement.values(deltas),
        limited=limited,
        scales=np.array(order),
        growth=np.array([walk.runs[s] for s in order]),
        predicted_growth=np.array([walk.description(s) for s in order]),
    )


def gain_factor_for(
    measurement: UncertainMeasurement, gains: AdaptationGains, target: float
) -> float:
    """Factor on the gains with which the worst corner of the parameters breaks at a distance.

    Parameters
    ----------
    measurement : UncertainMeasurement
        The measurement.
    gains : AdaptationGains
        Gains per cycle.
    target : float
        Distance in assumed bounds.
    """
    positive("target", target, "1")
    largest = positive("largest gain", max(gains.mean, gains.imbalance), "1")
    names = list(measurement.directions)
    bits = (np.arange(2 ** len(names))[:, None] >> np.arange(len(names))) & 1
    corners = np.array(
        [
            list(physical(measurement, dict(zip(names, row, strict=True)), target)[0].values())
            for row in 2.0 * bits - 1.0
        ]
    )
    none = np.zeros((len(corners), 4))
    one = none + np.array([1.0, 0.0, 0.0, 0.0])

    def stable(factor: float) -> bool:
        loop = UncertainLoop.adaptive(measurement, gains.scaled(factor))
        return bool(np.all(spectral_radii(loop, corners, none, one) < 1.0))

    low, high = 1e-3, 1e-3
    while stable(high):
        low, high = high, 2.0 * high
        if high * largest > _HIGHEST:
            raise ParameterError(
                f"no gains break the loop at {target:g} times the bounds: choose a larger target"
            )
    if low == high:
        raise ParameterError(
            f"even the lowest gains break the loop at {target:g} times the bounds: choose a "
            "smaller target"
        )
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def physical(
    measurement: UncertainMeasurement, direction: Mapping[str, float], scale: float
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Normalised parameters at a distance along a direction, and which of them are held.

    No sensor has a negative delay or no lag at all; there they are held at the least.
    """
    values = measurement.values({name: scale * d for name, d in direction.items()})
    held = []
    for name in values:
        targets = measurement.uncertain[name].acts_on
        least = max((_LEAST.get(target, -math.inf) for target in targets), default=-math.inf)
        if values[name] < least:
            values[name] = least
            held.append(name)
    return measurement.deltas(values), tuple(held)


class _Walk:
    """Growth per cycle of the modes along a direction."""

    def __init__(
        self,
        measurement: UncertainMeasurement,
        loop: UncertainLoop,
        direction: Mapping[str, float],
        plant: CrankAnglePlant,
        feedforward: Feedforward | ChargeModel,
        gains: AdaptationGains,
        cycles: int,
    ) -> None:
        self.measurement, self.loop, self.direction = measurement, loop, direction
        self.plant, self.feedforward, self.cycles = plant, feedforward, cycles
        self.schedule = GainSchedule.constant(gains.mean, gains.imbalance)
        self.held = gains.imbalance == 0.0
        self.runs: dict[float, FloatArray] = {}
        self.turns: dict[float, float] = {}

    def poles(self, scale: float) -> ComplexArray:
        """Poles of the description."""
        deltas, _ = physical(self.measurement, self.direction, scale)
        return np.linalg.eigvals(np.asarray(self.loop.perturbed(deltas).A)).astype(complex)

    def description(self, scale: float) -> FloatArray:
        """Growth of the modes of the description."""
        return adapted_growth(self.poles(scale), self.held, self.measurement.n_cylinders)

    def predicted(self) -> float:
        """Distance at which the description breaks."""
        grid = np.linspace(0.0, FARTHEST, _SCAN)
        unstable = [s for s in grid if self.description(s).max() >= 1.0]
        if not unstable or unstable[0] == 0.0:
            raise ParameterError(
                f"the description does not break within {FARTHEST:g} times the bounds along its "
                "worst direction: raise the gains, or give a target"
            )
        low, high = unstable[0] - grid[1], float(unstable[0])
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.description(middle).max() < 1.0 else (low, middle)
        return high

    def full(self, scale: float) -> FloatArray:
        """Growth of the adapted modes of the full plant."""
        m = self.measurement
        deltas, _ = physical(m, self.direction, scale)
        values = m.values(deltas)
        uncertain = widened(m.uncertain, values)
        row = [values.get(p.name, p.nominal) for p in uncertain]
        sample = Sample(uncertain, np.array([row]))
        (case,) = sampled_cases(m, self.feedforward, self.schedule, sample, self.plant, self.cycles)
        response = step_response(case)
        self.runs[scale] = adapted_growth(response.adapted_poles, self.held, m.n_cylinders)
        self.turns[scale] = turns_of_fastest(response.adapted_poles, m.n_cylinders)
        return self.runs[scale]

    def simulated(self, start: float, progress: Progress | None) -> float:
        """Distance at which the full plant breaks; infinite if none is found, 0 if all do."""

        def unstable(scale: float) -> bool:
            found = bool(self.full(scale).max() >= 1.0)
            if progress is not None:
                progress(min(len(self.runs), _RUNS), _RUNS)
            return found

        in_range("start", start, 0.0, FARTHEST, "1", open_low=True)
        low = high = start
        if unstable(start):
            while unstable(low := low / _RAISE):
                high = low
                if low < 0.1 * start:
                    return 0.0
        else:
            while not unstable(high := high * _RAISE):
                low = high
                if high > 2.0 * start:
                    return math.inf
        while high / low > 1.0 + 2.0 * _FINE:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if unstable(middle) else (middle, high)
        # Between the two the growth is as good as linear.
        below, above = float(self.runs[low].max()) - 1.0, float(self.runs[high].max()) - 1.0
        return low + (high - low) * below / (below - above)
