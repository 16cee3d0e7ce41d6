"""The whole robust analysis of the air-charge loop over speed, and its confirmation.

At each speed: poles first, then margins, then the structured singular value; linear members of
the set and sampled full plants in closed loop, which no verdict of "robust" may contradict
(*sound*); and the full plant driven along the predicted worst direction until it breaks
(*tight*).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from plant import CrankAnglePlant, Engine, MeanValuePlant, ParameterError
from uncertainty.parameters import UncertaintySet

from ._closed_loop_runs import at_speed, in_processes
from .adaptation import AdaptationGains, GainSchedule
from .disk_margins import DiskMargins, disk_margins
from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .gang_of_four import GangOfFour, gang_of_four
from .nominal_loop import NominalLoop
from .robustness import SPEEDS_RPM, demand_at
from .soundness import (
    LtiCheck,
    SampledPlantRun,
    SampledPlantsCheck,
    check_lti,
    check_sampled_plants,
)
from .structured_robustness import StructuredRobustness, analyse_structured
from .tightness import TightnessCheck, check_tightness
from .uncertain_loop import SENSITIVITY_BOUND, UncertainLoop, adaptation_law
from .uncertain_measurement import UncertainMeasurement, uncertain_measurement

LTI_SAMPLES = 1000
PLANT_SAMPLES = 20  # full plants at each speed

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class SpeedAnalysis:
    """Robustness of the loop at one speed, and what confirmed it.

    Attributes
    ----------
    structured : StructuredRobustness
        Structured singular value and worst case.
    gang : GangOfFour
        Sensitivity functions of the loop with the nominal sensor.
    margins : DiskMargins
        Margins of it, per mode, of one cylinder and of all.
    lti : LtiCheck or None
        Linear members of the set; None if it was not confirmed.
    plants : tuple of SampledPlantRun
        Sampled full plants in closed loop.
    tightness : TightnessCheck or None
        Full plant along the worst direction; None if it was not asked for or not possible.
    untested : str
        Why the worst direction was not possible, if it was asked for; else empty.
    """

    structured: StructuredRobustness
    gang: GangOfFour = field(repr=False)
    margins: DiskMargins = field(repr=False)
    lti: LtiCheck | None = field(default=None, repr=False)
    plants: tuple[SampledPlantRun, ...] = field(default=(), repr=False)
    tightness: TightnessCheck | None = field(default=None, repr=False)
    untested: str = ""

    @property
    def speed_rpm(self) -> float:
        """Speed."""
        return self.structured.speed_rpm

    @property
    def measurement(self) -> UncertainMeasurement:
        """Uncertain measurement at the speed."""
        return self.structured.loop.measurement

    @property
    def plant_violations(self) -> int:
        """Sampled full plants that are unstable or beyond the bound of their speed."""
        return sum(run.violation for run in self.plants)

    def record(self) -> dict[str, Any]:
        """Return the figures, for a JSON file."""
        found = self.structured.record()
        margins = self.margins
        one = min(margins.one_at_a_time, key=lambda m: m.alpha) if margins.stable else None
        confirmed: dict[str, Any] = {}
        t, coverage = self.tightness, self.measurement.coverage
        if self.lti is not None:
            confirmed = {
                "sampled_lti": self.lti.samples,
                "violations_lti": self.lti.violations,
                "sampled_plant": len(self.plants),
                "violations_plant": self.plant_violations,
                "predicted_margin": None if t is None else t.predicted,
                "simulated_margin": None if t is None else t.simulated,
                "gain_factor": None if t is None else t.gain_factor,
                "untested": self.untested,
            }
        return {
            "speed_rpm": self.speed_rpm,
            "demand_mg": 1e6 * self.measurement.demand,
            "stable": self.structured.stable,
            "robustly_stable": self.structured.robustly_stable,
            "robust_performance": self.structured.robust_performance,
            "modes": [
                {
                    "q": m.q,
                    "disk_margin": m.disk.alpha,
                    "gain_margin": m.classical.gain_margin,
                    "phase_margin_deg": m.classical.phase_margin_deg,
                    "peak_sensitivity": self.gang.peak("S", m.q).value,
                }
                for m in margins.modes
            ],
            "disk_margin": {
                "one_cylinder": one.alpha if one else float("nan"),
                "all_cylinders": margins.all_loops.alpha,
                "delay_s": margins.delay.sensor_delay,
                "delay_events": margins.delay.events,
            },
            "mu": {k: v for k, v in found.items() if k != "worst_case_gain"},
            "worst_case_gain": found["worst_case_gain"],
            "coverage": None if coverage is None else coverage.to_dict(),
            "beyond_reach": self.measurement.beyond_reach,
            "confirmed": confirmed,
        }

    def __str__(self) -> str:
        """Return the verdict and what confirmed it."""
        lines = [str(self.structured)]
        coverage = self.measurement.coverage
        if coverage is not None and not coverage.consistent:
            lines.append(f"  BUT the description of the set is in doubt: {coverage}")
        if self.lti is not None:
            told = (
                "contradict it"
                if self.structured.robust_performance
                else f"are unstable or beyond |S| = {self.lti.bound:.2f}"
            )
            lines.append(
                f"  sampled: {self.lti.violations} of {self.lti.samples} linear members and "
                f"{self.plant_violations} of {len(self.plants)} full plants {told}"
            )
        if self.tightness is not None:
            t = self.tightness
            lines.append(
                f"  tight: with gains x {t.gain_factor:.2f} the break is predicted at "
                f"{t.predicted:.2f} times the bounds, the full plant breaks at {t.simulated:.2f}"
            )
        elif self.untested:
            lines.append(f"  worst direction not tried: {self.untested}")
        return "\n".join(lines)


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
    maps: MeanValuePlant,
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    *,
    engine: Engine | None = None,
    estimator: ChargeEstimator | None = None,
    gains: GainSchedule | None = None,
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
    maps : MeanValuePlant
        Maps that the controller believes.
    speeds_rpm : sequence of float
        Speeds, each once.
    engine : Engine, optional
        The engine; the paper's by default.
    estimator : ChargeEstimator, optional
        The estimator; the default one if not given.
    gains : GainSchedule, optional
        Gains; the default schedule if not given.
    demand : callable
        Charge in kg against speed in rpm.
    uncertain : UncertaintySet, optional
        What is uncertain; `uncertainty.default_set` by default.
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
        If a speed is given twice or none is, or a demand is out of the plant's reach.
    """
    engine = Engine.paper() if engine is None else engine
    estimator = ChargeEstimator() if estimator is None else estimator
    schedule = GainSchedule() if gains is None else gains
    speeds_rpm = tuple(float(speed) for speed in speeds_rpm)
    if not speeds_rpm or len(set(speeds_rpm)) != len(speeds_rpm):
        given = ", ".join(f"{speed:g}" for speed in speeds_rpm) or "none"
        raise ParameterError(f"the speeds are {given} rpm, but must be one or more, each once")
    tight_at = speeds_rpm if tight_at is None else tight_at
    plant = CrankAnglePlant(engine, runner=True, oscillation=True)
    feedforward = Feedforward(maps, valvetrain=engine.valvetrain)
    found: list[SpeedAnalysis] = []
    count = len(speeds_rpm)
    for k, speed in enumerate(speeds_rpm):
        if progress is not None:
            progress("robustness", k, count)
        measurement = uncertain_measurement(
            plant,
            feedforward,
            demand(speed),
            speed,
            estimator=estimator,
            uncertain=uncertain,
            seed=seed,
        )
        own = schedule.at(speed)
        law = adaptation_law(measurement, own)
        local = measurement.local

        def at_delay(delay: float, law: Any = law, local: Any = local) -> NominalLoop:
            return NominalLoop.of_sensor(law, local, estimator, delay=delay)

        nominal = NominalLoop.of_sensor(law, local, estimator)
        found.append(
            SpeedAnalysis(
                analyse_structured(UncertainLoop(measurement, law, sensitivity_bound), seed=seed),
                gang_of_four(nominal),
                disk_margins(nominal, at_delay=at_delay),
            )
        )
    if progress is not None:
        progress("robustness", count, count)
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
        feedforward,
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
            at_speed(feedforward, s.speed_rpm),
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
        tight, why = by_speed.get(s.speed_rpm, (None, ""))
        confirmed.append(
            replace(s, lti=lti, plants=plants.at(s.speed_rpm), tightness=tight, untested=why)
        )
    return RobustAnalysis(tuple(confirmed), schedule, plants, seed)


@dataclass(frozen=True)
class _Drive:
    """What a drive along the worst direction needs; small enough for another process."""

    measurement: UncertainMeasurement
    feedforward: Feedforward
    gains: AdaptationGains
    plant: CrankAnglePlant
    seed: int


def _drive(case: _Drive) -> tuple[TightnessCheck | None, str]:
    """Drive the full plant along the worst direction, or tell why that is not possible."""
    try:
        found = check_tightness(
            case.measurement, case.feedforward, case.gains, plant=case.plant, seed=case.seed
        )
    except ParameterError as error:  # no gain, or no distance, at which it breaks
        return None, str(error)
    return found, ""
