"""Closed loops of sampled full plants with the controller of a charge model, at one point."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from plant import CrankAnglePlant, MafSensor, ParameterError, ValveCommand
from plant.sensors import MapSensor
from uncertainty.perturbed import PerturbedPlants, duration_offsets
from uncertainty.sampling import Sample

from ._loop_cases import WIDE, AtRest, Disturbed
from ._sampled_loops import settled_plants
from .adaptation import AdaptationGains, GainSchedule
from .adaptation_laws import ParameterBounds
from .charge_model import ChargeModel
from .command_limits import CommandLimits
from .controller import AirChargeController, ControllerState
from .controller_parts import Adaptation, Estimator
from .cylinder_parameters import CylinderParameters, ParameterSet
from .estimator_response import SETTLING_EVENTS, AnalysedEstimator
from .integral_adaptation import IntegralAdaptation
from .uncertain_measurement import UncertainMeasurement

_EVENTS_MORE = 40  # after the estimator stands still, for the loop


@dataclass(frozen=True)
class ModelCase:
    """A full plant, its sensors and the controller of a charge model at one operating point.

    Attributes
    ----------
    plant : CrankAnglePlant
        The plant; its cylinders are equal.
    maf, map : MafSensor, MapSensor
        The sensors.
    model : ChargeModel
        Model that the controller believes.
    estimator : Estimator
        The estimator.
    law : Adaptation
        The law; durations are not told to it.
    gains : AdaptationGains
        Its gains per cycle.
    learnt : CylinderParameters
        What has been learnt of the plant at rest.
    density : float
        Density that the controller sees there, 1.
    demand, speed_rpm : float
        Operating point: kg, rpm.
    cycles : int
        Length of the run after the step.
    amplitude : float
        Size of the step, relative to the charge.
    """

    plant: CrankAnglePlant
    maf: MafSensor
    map: MapSensor
    model: ChargeModel = field(repr=False)
    estimator: Estimator
    law: Adaptation = field(repr=False)
    gains: AdaptationGains
    learnt: CylinderParameters
    density: float
    demand: float
    speed_rpm: float
    cycles: int = 30
    amplitude: float = 0.02

    settling_events: ClassVar[int] = SETTLING_EVENTS + _EVENTS_MORE

    @property
    def held(self) -> bool:
        """Whether differences between cylinders are not adapted."""
        return self.gains.imbalance == 0.0

    @property
    def duration_offset(self) -> float:
        """Error of the delivered duration of all valves, s: learnt, and taken off the commands."""
        return self.learnt.duration_offset

    @cached_property
    def controller(self) -> AirChargeController:
        """Controller with limits and rates that do not act on a small deviation."""
        return AirChargeController(
            self.model,
            self.estimator,
            self.law,
            n_cylinders=self.plant.engine.n_cylinders,
            limits=CommandLimits(
                lift_mm=(self.model.lowest_lift_mm, self.model.valvetrain.maximum_lift_mm),
                longest_duration_deg=360.0,
                lift_rate_mm=1e3,
                duration_rate=1e3,
                valvetrain=self.model.valvetrain,
            ),
            duration_jitter=0.0,
            hold_events=0,
        )

    def at_rest(self) -> AtRest:
        """Return what is known of the cylinders, and the cycle that it makes the plant do."""
        known = CylinderParameters(
            self.learnt.flow_gain, 0.0, self.learnt.charge_factor
        )  # so that the motion is the delivered one
        point = self.model.inverse(self.demand, self.speed_rpm, known, self.density)
        cycle = self.plant.steady_cycle(
            self.speed_rpm,
            ValveCommand(point.lift_mm, point.duration_deg),
            on_infeasible="limit",
        )
        n = self.plant.engine.n_cylinders
        every = ParameterSet(*(np.full(n, value) for value in self.learnt))
        slope = point.duration_slope / (6.0 * self.speed_rpm)
        return AtRest(every, self.density, cycle, slope)

    def disturbed(self, state: ControllerState, rest: AtRest, sign: float) -> Disturbed:
        """Return a step in the charge factor that is believed of the first cylinder.

        A valve that closes late, unmeasured, would also let air flow in otherwise than the
        estimator takes it to, which its estimate then holds to: a second disturbance.
        """
        learnt = state.adaptation
        first, *others = learnt.log_charge_factor
        moved = replace(learnt, log_charge_factor=(first - sign * self.amplitude, *others))
        return Disturbed(state._replace(adaptation=moved), 0.0)


def model_cases(
    measurement: UncertainMeasurement,
    model: ChargeModel,
    gains: GainSchedule,
    sample: Sample,
    plant: CrankAnglePlant,
    cycles: int,
    *,
    law: Adaptation | None = None,
) -> list[ModelCase]:
    """Return the closed loop of each plant of a sample at the operating point of a measurement.

    The law is an integral correction of the charge factors with the given gains, unless another
    one is given, of which they are the gains.
    """
    analysed = measurement.estimator
    if not isinstance(analysed, AnalysedEstimator):
        raise ParameterError(
            f"the measurement is of a {type(analysed).__name__}, but a charge model goes with an "
            "estimator that a controller can use: give the feedforward"
        )
    speed, perturbed = measurement.speed_rpm, PerturbedPlants(plant, sample)
    own = gains.at(speed)
    if law is None:
        law = IntegralAdaptation(
            GainSchedule.constant(own.mean, own.imbalance),
            bounds=ParameterBounds(charge_factor=WIDE),
        )
    offsets = duration_offsets(sample.uncertain, sample.values, plant.engine.n_cylinders)
    if offsets.shape[1] > 1:
        raise ParameterError(
            "the valves of the sampled plants differ, but modes are told apart for equal ones "
            "alone: leave what acts on single cylinders out of the set"
        )
    maf, map_ = MafSensor().ideal(), MapSensor().ideal()
    settled = settled_plants(plant, sample, model, measurement.demand, speed, maf=maf, map=map_)
    return [
        ModelCase(
            perturbed.plant_at(i),
            perturbed.maf_at(i, maf),
            perturbed.map_at(i, map_),
            model,
            analysed.estimator,
            law,
            own,
            settled.parameters[i]._replace(duration_offset=float(offsets[i, 0])),
            float(settled.density[i]),
            measurement.demand,
            speed,
            cycles,
        )
        for i in range(len(sample))
    ]
