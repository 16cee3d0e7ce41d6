"""Closed loops of sampled full plants at one operating point: what is run, and where it rests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, Cycle, MafSensor, ParameterError
from plant.air_path import event_time
from plant.kinematics import FloatArray
from plant.sensors import MapSensor
from uncertainty.parameters import UncertaintySet
from uncertainty.perturbed import PerturbedPlants, duration_offsets
from uncertainty.sampling import Sample

from .adaptation import AdaptationGains, GainSchedule
from .charge_model import ChargeModel
from .controller import AirChargeController, ControllerState
from .cylinder_parameters import ParameterSet
from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .uncertain_measurement import UncertainMeasurement
from .window_loop import window_controller

WIDE = (0.11, 9.0)  # bounds of the charge factor: none acts on a small deviation
_TRIMMED, _TRIALS = 1e-4, 30  # relative error of the charge that a trim leaves, its steps


class AtRest(NamedTuple):
    """Where the loop of a plant is at rest."""

    known: ParameterSet  # what has been learnt there
    density: float  # of the intake air over the model's, 1
    cycle: Cycle
    slope: float  # relative charge over the duration that the model promises, 1/deg


class Disturbed(NamedTuple):
    """A step in one cylinder: in what has been learnt of it, or in what its valve delivers."""

    controller: ControllerState
    late_deg: float  # by which its valve closes later, deg


class Case(Protocol):
    """A full plant, its sensors and the controller at one operating point."""

    @property
    def plant(self) -> CrankAnglePlant:
        """The plant; its cylinders are equal."""
        ...

    @property
    def maf(self) -> MafSensor:
        """The air-flow sensor."""
        ...

    @property
    def map(self) -> MapSensor:
        """The pressure sensor."""
        ...

    @property
    def demand(self) -> float:
        """Demand, kg."""
        ...

    @property
    def speed_rpm(self) -> float:
        """Speed."""
        ...

    @property
    def duration_offset(self) -> float:
        """Error of the delivered duration of all valves, s."""
        ...

    @property
    def cycles(self) -> int:
        """Length of the run after the step."""
        ...

    @property
    def amplitude(self) -> float:
        """Size of the step, relative to the charge by the model's slope."""
        ...

    @property
    def held(self) -> bool:
        """Whether differences between cylinders are not adapted."""
        ...

    @property
    def settling_events(self) -> int:
        """Events until the estimator is at rest."""
        ...

    @property
    def controller(self) -> AirChargeController:
        """Controller with gains that hold at every speed, without bounds that would act."""
        ...

    def at_rest(self) -> AtRest:
        """Return where the estimate of the plant is the demand."""
        ...

    def disturbed(self, state: ControllerState, rest: AtRest, sign: float) -> Disturbed:
        """Return a step of the first cylinder's charge, from the next event on."""
        ...


@dataclass(frozen=True)
class LoopCase:
    """A full plant, its sensor and the controller of event windows at one operating point.

    Attributes
    ----------
    plant : CrankAnglePlant
        The plant; its cylinders are equal.
    maf : MafSensor
        The air-flow sensor.
    feedforward : Feedforward
        Map that the controller believes.
    estimator : ChargeEstimator
        The estimator.
    gains : AdaptationGains
        Gains per cycle.
    demand, speed_rpm : float
        Operating point: kg, rpm.
    duration_offset : float
        Error of the delivered duration of all valves, s.
    cycles : int
        Length of the run after the step.
    amplitude : float
        Size of the step, relative to the charge by the map's slope.
    """

    plant: CrankAnglePlant
    maf: MafSensor
    feedforward: Feedforward = field(repr=False)
    estimator: ChargeEstimator
    gains: AdaptationGains
    demand: float
    speed_rpm: float
    duration_offset: float = 0.0
    cycles: int = 30
    amplitude: float = 0.02

    map: ClassVar[MapSensor] = MapSensor().ideal()  # its readings are not used

    @property
    def held(self) -> bool:
        """Whether differences between cylinders are not adapted."""
        return self.gains.imbalance == 0.0

    @property
    def settling_events(self) -> int:
        """Events until estimates come in."""
        n = self.plant.engine.n_cylinders
        latency = self.estimator.latency_events(event_time(self.speed_rpm, n))
        return n * (1 + -(-latency // n))

    @property
    def controller(self) -> AirChargeController:
        """Controller with gains that hold at every speed, and without bounds that would act."""
        return window_controller(
            self.feedforward,
            self.estimator,
            self.gains,
            n_cylinders=self.plant.engine.n_cylinders,
            bounds=WIDE,
        )

    def at_rest(self) -> AtRest:
        """Return charge factor and cycle at which the estimate of the plant is the demand.

        Raises
        ------
        ParameterError
            If the demand is out of the plant's reach.
        """
        target = self.demand / (1.0 + self.maf.gain_error)
        late_deg, n = 6.0 * self.speed_rpm * self.duration_offset, self.plant.engine.n_cylinders
        factor = 1.0
        for _ in range(_TRIALS):
            forward = self.feedforward.command(self.demand / factor, self.speed_rpm)
            command = forward.command.replace(duration_deg=forward.command.duration_deg + late_deg)
            cycle = self.plant.steady_cycle(self.speed_rpm, command, on_infeasible="limit")
            ratio = float(cycle.air_charge[0]) / target
            if abs(ratio - 1.0) < _TRIMMED and not forward.limited:
                known = ParameterSet.nominal(n).replace(charge_factor=np.full(n, factor))
                slope = self.feedforward.sensitivity(forward.charge, self.speed_rpm)
                return AtRest(known, 1.0, cycle, slope / forward.charge)
            factor *= ratio
        raise ParameterError(
            f"the plant takes in {1e6 * ratio * target:.0f} mg, not {1e6 * target:.0f} mg, at "
            f"{self.speed_rpm:g} rpm whatever is commanded: lower the demand"
        )

    def disturbed(self, state: ControllerState, rest: AtRest, sign: float) -> Disturbed:
        """Return a step in the closing of the first cylinder's valve."""
        return Disturbed(state, sign * self.amplitude / rest.slope)


def at_speed(feedforward: Feedforward, speed_rpm: float) -> Feedforward:
    """Return the feedforward with its table of one speed for a map: small to send elsewhere."""
    feedforward.command(1e-4, speed_rpm)  # makes the table
    branch = feedforward._branches[float(speed_rpm)]
    table = replace(feedforward, charge_map=_Table(branch.duration_deg, branch.charge))
    table._branches[float(speed_rpm)] = branch
    return table


@dataclass(frozen=True)
class _Table:
    """Charge map at one speed and its scheduled lift."""

    duration_deg: FloatArray
    charge: FloatArray

    def air_charge(
        self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike, /
    ) -> ArrayLike:
        return np.interp(np.asarray(duration_deg, float), self.duration_deg, self.charge)


def window_cases(
    measurement: UncertainMeasurement,
    feedforward: Feedforward,
    gains: GainSchedule,
    sample: Sample,
    plant: CrankAnglePlant,
    cycles: int,
) -> list[LoopCase]:
    """Return the closed loop of each plant of a sample at the operating point of a measurement."""
    estimator = measurement.estimator
    if not isinstance(estimator, ChargeEstimator):
        raise ParameterError(
            f"the measurement is of a {type(estimator).__name__}, but a Feedforward goes with a "
            "ChargeEstimator: give the charge model"
        )
    speed = measurement.speed_rpm
    perturbed = PerturbedPlants(plant, sample)
    offsets = duration_offsets(sample.uncertain, sample.values, plant.engine.n_cylinders)
    plants = [perturbed.plant_at(i) for i in range(len(sample))]
    if offsets.shape[1] > 1 or any(len(set(p.engine.flow_coefficients)) > 1 for p in plants):
        raise ParameterError(
            "the cylinders of the sampled plants differ, but modes are told apart for equal ones "
            "alone: leave what acts on single cylinders out of the set"
        )
    small = at_speed(feedforward, speed)
    return [
        LoopCase(
            plants[i],
            perturbed.maf_at(i, MafSensor().ideal()),
            small,
            estimator,
            gains.at(speed),
            measurement.demand,
            speed,
            float(offsets[i, 0]),
            cycles,
        )
        for i in range(len(sample))
    ]


def widened(uncertain: UncertaintySet, values: Mapping[str, float]) -> UncertaintySet:
    """Return the set with bounds moved so far out that it holds the values."""
    for name, value in values.items():
        p = uncertain[name]
        uncertain = uncertain.replace(name, low=min(p.low, value), high=max(p.high, value))
    return uncertain


def sampled_cases(
    measurement: UncertainMeasurement,
    feedforward: Feedforward | ChargeModel,
    gains: GainSchedule,
    sample: Sample,
    plant: CrankAnglePlant,
    cycles: int,
) -> list[Case]:
    """Return the closed loop of each plant of a sample, of the kind that the map belongs to."""
    from ._model_cases import model_cases

    if isinstance(feedforward, Feedforward):
        return [*window_cases(measurement, feedforward, gains, sample, plant, cycles)]
    return [*model_cases(measurement, feedforward, gains, sample, plant, cycles)]
