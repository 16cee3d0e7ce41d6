"""Gains at which a loop breaks: predicted by its description, and on the full plant.

A loop whose measurement hardly depends on the sensor breaks nowhere near the bounds of its
parameters, and where it does says little: a change of some per cent of the gain moves that place
by a multiple of the bounds. It breaks by its gain. So the gains are raised until the loop of given
parameters loses stability, in the description and on the full plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from plant import CrankAnglePlant, ParameterError
from plant._checks import positive, whole
from uncertainty.sampling import Sample

from ._closed_loop_runs import step_response
from ._loop_cases import sampled_cases
from ._step_response import turns_of_fastest
from .adaptation import AdaptationGains, GainSchedule
from .charge_model import ChargeModel
from .feedforward import Feedforward
from .uncertain_loop import UncertainLoop
from .uncertain_measurement import UncertainMeasurement

WITHIN = 0.1  # of the prediction, in which the full plant should break
_FINE = 0.005  # of the factor
_FARTHEST = 2.0  # times the prediction, and one over it
_HIGHEST = 100.0  # gain up to which a break is sought


@dataclass(frozen=True)
class GainBreak:
    """Factor on the gains at which one loop breaks.

    Attributes
    ----------
    speed_rpm : float
        Speed.
    gains : AdaptationGains
        Gains of the loop, per cycle.
    values : dict of str to float
        Parameters of the plant and its sensor, where they are not nominal.
    predicted, simulated : float
        Factor on the gains at which the description breaks, and the full plant; `simulated` is
        infinite (0) if it does not (does) up to twice (from half) the prediction.
    predicted_turns, simulated_turns : float
        Turns per cycle of the pole that breaks: q for mode q.
    """

    speed_rpm: float
    gains: AdaptationGains
    values: Mapping[str, float] = field(repr=False)
    predicted: float
    simulated: float
    predicted_turns: float
    simulated_turns: float

    @property
    def ratio(self) -> float:
        """Simulated over predicted factor."""
        return self.simulated / self.predicted

    @property
    def tight(self) -> bool:
        """Whether they agree within `WITHIN`."""
        return abs(self.ratio - 1.0) <= WITHIN

    def __str__(self) -> str:
        """Return gains, both factors and the modes that break."""
        return (
            f"{self.speed_rpm:g} rpm, gains {self.gains.mean:.3f} (mean) and "
            f"{self.gains.imbalance:.3f} (imbalance): the description breaks with "
            f"{self.predicted:.2f} times the gains ({self.predicted_turns:.2f} turns per cycle), "
            f"the full plant with {self.simulated:.2f} times ({self.simulated_turns:.2f} turns; "
            f"ratio {self.ratio:.3f})"
        )


def check_gain_break(
    measurement: UncertainMeasurement,
    feedforward: Feedforward | ChargeModel,
    gains: AdaptationGains,
    *,
    values: Mapping[str, float] | None = None,
    plant: CrankAnglePlant | None = None,
    cycles: int = 40,
    progress: Callable[[int, int], None] | None = None,
) -> GainBreak:
    """Raise the gains until the loop breaks, in the description and on the full plant.

    Parameters
    ----------
    measurement : UncertainMeasurement
        Operating point, estimator and uncertainty.
    feedforward : Feedforward or ChargeModel
        What the controller believes.
    gains : AdaptationGains
        Gains per cycle.
    values : mapping of str to float, optional
        Modelled parameters of the set that are not nominal.
    plant : CrankAnglePlant, optional
        Nominal plant; the paper's with runner and oscillation by default.
    cycles : int
        Length of a run.
    progress : callable, optional
        Called with the number of runs done and about how many there will be.

    Raises
    ------
    ParameterError
        If the description breaks with no gains, or a parameter has no direction.
    """
    plant = CrankAnglePlant(runner=True, oscillation=True) if plant is None else plant
    whole("cycles", cycles, 8, 100_000)
    own = dict(values or {})
    for name in own:
        if name not in measurement.directions:
            raise ParameterError(
                f"{name} is given, but the directions are {', '.join(measurement.directions)}"
            )
    deltas = measurement.deltas(own)

    def poles(factor: float) -> np.ndarray:
        loop = UncertainLoop.adaptive(measurement, gains.scaled(factor))
        return np.linalg.eigvals(np.asarray(loop.perturbed(deltas).A))

    predicted = _predicted(lambda factor: float(np.abs(poles(factor)).max()), gains)
    uncertain = measurement.uncertain
    row = [own.get(p.name, p.nominal) for p in uncertain]
    sample = Sample(uncertain, np.array([row]))
    runs, turned = 0, math.nan

    def breaks(factor: float) -> bool:
        nonlocal runs, turned
        schedule = GainSchedule.constant(gains.mean * factor, gains.imbalance * factor)
        (case,) = sampled_cases(measurement, feedforward, schedule, sample, plant, cycles)
        found = step_response(case)
        runs += 1
        if progress is not None:
            progress(min(runs, 10), 10)
        if found.ended_early and found.values.size < 8:
            return True
        turned = turns_of_fastest(found.adapted_poles, measurement.n_cylinders)
        return found.worst_growth[0] >= 1.0

    return GainBreak(
        measurement.speed_rpm,
        gains,
        own,
        predicted,
        _simulated(breaks, predicted),
        turns_of_fastest(poles(predicted), measurement.n_cylinders),
        turned,
    )


def _predicted(radius: Callable[[float], float], gains: AdaptationGains) -> float:
    """Factor at which the largest pole radius per event reaches 1."""
    largest = positive("largest gain", max(gains.mean, gains.imbalance), "1")
    low, high = 1e-3, 2e-3
    if radius(low) >= 1.0:
        raise ParameterError("the loop is unstable with the lowest gains: there is no break")
    while radius(high) < 1.0:
        low, high = high, 2.0 * high
        if high * largest > _HIGHEST:
            raise ParameterError(f"no gains up to {_HIGHEST:g} break the loop")
    while high / low > 1.0 + 0.1 * _FINE:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if radius(middle) >= 1.0 else (middle, high)
    return math.sqrt(low * high)


def _simulated(breaks: Callable[[float], bool], predicted: float) -> float:
    """Factor at which the full plant breaks; infinite or 0 if it is far from the prediction."""
    low = high = predicted
    if breaks(predicted):
        while breaks(low := low / (1.0 + WITHIN)):
            high = low
            if low < predicted / _FARTHEST:
                return 0.0
    else:
        while not breaks(high := high * (1.0 + WITHIN)):
            low = high
            if high > predicted * _FARTHEST:
                return math.inf
    while high / low > 1.0 + _FINE:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if breaks(middle) else (middle, high)
    return math.sqrt(low * high)
