"""The whole robust analysis of the air-charge loop over speed, and its confirmation.

At each speed: poles first, then margins, then the structured singular value; linear members of
the set and sampled full plants in closed loop, which no verdict of "robust" may contradict
(*sound*); and the full plant driven along the predicted worst direction, or with rising gains,
until it breaks (*tight*).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plant import CrankAnglePlant, Engine, MeanValuePlant, ParameterError
from uncertainty.parameters import UncertaintySet

from ._processes import in_processes
from .adaptation import AdaptationGains, GainSchedule
from .analysed_control import AnalysedControl, DesignedControl, WindowControl
from .charge_model import ChargeModel
from .controller_design import ControllerDesign
from .controller_parts import Adaptation
from .disk_margins import disk_margins
from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .gain_break import GainBreak, check_gain_break
from .gang_of_four import gang_of_four
from .mu.result import MuResult
from .mu.worst_case import WorstCaseGain
from .robustness import SPEEDS_RPM, demand_at
from .soundness import (
    SampledPlantsCheck,
    check_lti,
    check_sampled_plants,
)
from .speed_analysis import SpeedAnalysis
from .structured_robustness import StructuredRobustness, analyse_structured
from .tightness import TightnessCheck, check_tightness
from .uncertain_loop import SENSITIVITY_BOUND, UncertainLoop
from .uncertain_measurement import UncertainMeasurement

__all__ = ["PLANT_SAMPLES", "RobustAnalysis", "SpeedAnalysis", "analyse_robustness"]

LTI_SAMPLES = 1000
PLANT_SAMPLES = 20  # full plants at each speed

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class RobustAnalysis:
    """Robust analysis over speed.

    Attributes
    ----------
    speeds : tuple of SpeedAnalysis
        One a speed.
    schedule : GainSchedule
        Gains analysed.
    plants : SampledPlantsCheck or None
        All sampled full plants.
    seed : int
        Seed.
    """

    speeds: tuple[SpeedAnalysis, ...]
    schedule: GainSchedule
    plants: SampledPlantsCheck | None
    seed: int

    @property
    def measurements(self) -> tuple[UncertainMeasurement, ...]:
        """Uncertain measurement at each speed."""
        return tuple(s.measurement for s in self.speeds)

    @property
    def sound(self) -> bool:
        """Whether it was confirmed: nothing sampled contradicts a verdict of robust performance."""
        return self.plants is not None and all(
            s.plant_violations == 0 and (s.lti is None or s.lti.violations == 0)
            for s in self.speeds
            if s.structured.robust_performance
        )

    def records(self) -> list[dict[str, Any]]:
        """Return a record of each speed, for a JSON file."""
        return [s.record() for s in self.speeds]

    def __str__(self) -> str:
        """Return the verdict of each speed."""
        return "\n".join(str(s) for s in self.speeds)


def analyse_robustness(
    maps: MeanValuePlant | ControllerDesign,
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    *,
    engine: Engine | None = None,
    estimator: ChargeEstimator | None = None,
    gains: GainSchedule | None = None,
    adaptation: Adaptation | None = None,
    demand: Callable[[float], float] = demand_at,
    uncertain: UncertaintySet | None = None,
    sensitivity_bound: float = SENSITIVITY_BOUND,
    confirm: bool = True,
    samples: int = PLANT_SAMPLES,
    tight_at: Sequence[float] | None = None,
    seed: int = 0,
    processes: int = 2,
    progress: Progress | None = None,
) -> RobustAnalysis:
    """Analyse the loop at several speeds and confirm the verdicts.

    Parameters
    ----------
    maps : MeanValuePlant or ControllerDesign
        Maps that the window controller believes, or a designed controller.
    speeds_rpm : sequence of float
        Speeds, each once.
    engine : Engine, optional
        The engine; the paper's by default, or that of the design.
    estimator : ChargeEstimator, optional
        Estimator of the window controller; the default one if not given.
    gains : GainSchedule, optional
        Gains of the window controller; the default schedule if not given.
    adaptation : Adaptation, optional
        Law of a designed controller, if it is not its own.
    demand : callable
        Charge in kg against speed in rpm.
    uncertain : UncertaintySet, optional
        What is uncertain; as in `uncertain_measurement` by default.
    sensitivity_bound : float
        Bound on ``|S|`` that stands for performance.
    confirm : bool
        Whether to confirm the verdicts with linear members and full plants.
    samples : int
        Full plants at each speed.
    tight_at : sequence of float, optional
        Speeds, of those analysed, at which the full plant is driven to where it breaks (some
        seconds each); all by default.
    seed : int
        Seed of all random work.
    processes : int
        Processes for the full plants.
    progress : callable, optional
        Called with what is done, how much of it and how much in all.

    Raises
    ------
    ParameterError
        If a speed is given twice or none is, a demand is out of the plant's reach, or parts of
        one kind of controller are given for the other.
    """
    speeds_rpm = tuple(float(speed) for speed in speeds_rpm)
    if not speeds_rpm or len(set(speeds_rpm)) != len(speeds_rpm):
        given = ", ".join(f"{speed:g}" for speed in speeds_rpm) or "none"
        raise ParameterError(f"the speeds are {given} rpm, but must be one or more, each once")
    tight_at = speeds_rpm if tight_at is None else tight_at
    plant, controlled = _controlled(maps, engine, estimator, gains, adaptation)
    found: list[SpeedAnalysis] = []
    own: dict[float, AdaptationGains] = {}
    described = in_processes(
        _describe,
        [
            _Point(controlled, demand(speed), speed, uncertain, sensitivity_bound, seed)
            for speed in speeds_rpm
        ],
        processes,
        None if progress is None else lambda done, total: progress("robustness", done, total),
    )
    for speed, (measurement, structured) in zip(speeds_rpm, described, strict=True):
        own[speed] = controlled.gains(measurement)
        nominal = controlled.nominal(measurement, own[speed])
        loop = UncertainLoop.adaptive(measurement, own[speed], sensitivity_bound)
        found.append(
            SpeedAnalysis(
                structured.of_loop(loop),
                gang_of_four(nominal),
                disk_margins(nominal, at_delay=controlled.at_delay(measurement, own[speed])),
            )
        )
    schedule = _schedule(controlled, own)
    if not confirm:
        return RobustAnalysis(tuple(found), schedule, None, seed)

    # What a verdict allows: the worst case where it is proved, the stated bound where not.
    bounds = {}
    for s in found:
        bound, worst = s.structured.loop.sensitivity_bound, s.structured.worst_gain
        proved = worst is not None and np.isfinite(worst.ceiling)
        bounds[s.speed_rpm] = bound * worst.ceiling if worst is not None and proved else bound
    plants = check_sampled_plants(
        [s.measurement for s in found],
        controlled.believed,
        schedule,
        samples=samples,
        bounds=bounds,
        plant=plant,
        seed=seed,
        processes=processes,
        progress=None
        if progress is None
        else lambda done, total: progress("full plants", done, total),
    )
    driven = [s for s in found if s.speed_rpm in tight_at]
    cases = [
        _Drive(
            s.measurement,
            controlled.map_at(s.speed_rpm),
            schedule.at(s.speed_rpm),
            plant,
            seed,
        )
        for s in driven
    ]
    outcomes = in_processes(
        _drive,
        cases,
        processes,
        None if progress is None else lambda done, total: progress("worst directions", done, total),
    )
    by_speed = {s.speed_rpm: o for s, o in zip(driven, outcomes, strict=True)}
    confirmed = []
    for s in found:
        lti = check_lti(
            s.structured.loop, samples=LTI_SAMPLES, seed=seed, bound=bounds[s.speed_rpm]
        )
        broke, why = by_speed.get(s.speed_rpm, (None, ""))
        confirmed.append(
            replace(
                s,
                lti=lti,
                plants=plants.at(s.speed_rpm),
                tightness=broke if isinstance(broke, TightnessCheck) else None,
                gain_break=broke if isinstance(broke, GainBreak) else None,
                untested=why,
            )
        )
    return RobustAnalysis(tuple(confirmed), schedule, plants, seed)


def _controlled(
    maps: MeanValuePlant | ControllerDesign,
    engine: Engine | None,
    estimator: ChargeEstimator | None,
    gains: GainSchedule | None,
    adaptation: Adaptation | None,
) -> tuple[CrankAnglePlant, AnalysedControl]:
    """Nominal plant and controller; raises if their parts are of two kinds."""
    if isinstance(maps, ControllerDesign):
        if estimator is not None or gains is not None:
            raise ParameterError(
                "an estimator or gains are given beside a design, which has its own: give an "
                "adaptation, or the maps of a window controller"
            )
        law = maps.controller.adaptation if adaptation is None else adaptation
        plant = CrankAnglePlant(
            maps.engine if engine is None else engine, runner=True, oscillation=True
        )
        return plant, DesignedControl(plant, maps, law)
    if adaptation is not None:
        raise ParameterError(
            "an adaptation is given, but the window controller has its own: give gains, or a design"
        )
    engine = Engine.paper() if engine is None else engine
    plant = CrankAnglePlant(engine, runner=True, oscillation=True)
    return plant, WindowControl(
        plant,
        Feedforward(maps, valvetrain=engine.valvetrain),
        ChargeEstimator() if estimator is None else estimator,
        GainSchedule() if gains is None else gains,
    )


def _schedule(controlled: AnalysedControl, gains: dict[float, AdaptationGains]) -> GainSchedule:
    """Gains over speed: the schedule that there is, or what was found at the speeds."""
    if isinstance(controlled, WindowControl):
        return controlled.schedule
    speeds = sorted(gains)
    return GainSchedule(
        tuple(speeds),
        tuple(gains[s].mean for s in speeds),
        tuple(gains[s].imbalance for s in speeds),
    )


@dataclass(frozen=True)
class _Point:
    """What the analysis at one speed needs; small enough for another process."""

    controlled: AnalysedControl
    demand: float
    speed_rpm: float
    uncertain: UncertaintySet | None
    sensitivity_bound: float
    seed: int


@dataclass(frozen=True)
class _Singular:
    """What `StructuredRobustness` holds beside its loop, which another process cannot send."""

    stability: MuResult | None
    performance: MuResult | None
    worst_gain: WorstCaseGain | None
    nominal_peak: float

    def of_loop(self, loop: UncertainLoop) -> StructuredRobustness:
        """Return the whole, with the loop that it was found of."""
        worst = self.worst_gain
        return StructuredRobustness(
            loop,
            self.stability,
            self.performance,
            None if worst is None else replace(worst, system=loop.system),
            self.nominal_peak,
        )


def _describe(point: _Point) -> tuple[UncertainMeasurement, _Singular]:
    """Measurement at a speed, and the singular values of the loop with it."""
    measurement = point.controlled.measurement(
        point.demand, point.speed_rpm, point.uncertain, point.seed
    )
    gains = point.controlled.gains(measurement)
    loop = UncertainLoop.adaptive(measurement, gains, point.sensitivity_bound)
    found = analyse_structured(loop, seed=point.seed)
    worst = found.worst_gain
    return measurement, _Singular(
        found.stability,
        found.performance,
        None if worst is None else replace(worst, system=None),
        found.nominal_peak,
    )


@dataclass(frozen=True)
class _Drive:
    """What a drive along the worst direction needs; small enough for another process."""

    measurement: UncertainMeasurement
    feedforward: Feedforward | ChargeModel
    gains: AdaptationGains
    plant: CrankAnglePlant
    seed: int


def _drive(case: _Drive) -> tuple[TightnessCheck | GainBreak | None, str]:
    """Drive the full plant to where it breaks, or tell why that is not possible.

    The loop of a window breaks along the worst direction of its parameters. A designed one
    hardly depends on them, and is broken by its gains.
    """
    try:
        if not isinstance(case.feedforward, Feedforward):
            return check_gain_break(
                case.measurement, case.feedforward, case.gains, plant=case.plant
            ), ""
        found = check_tightness(
            case.measurement, case.feedforward, case.gains, plant=case.plant, seed=case.seed
        )
    except ParameterError as error:  # no gain, or no distance, at which it breaks
        return None, str(error)
    return found, ""
