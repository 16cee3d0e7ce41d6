"""Sampled full plants in loops of a charge model: where each settles, what the estimator tells.

The controller commands the motion of which its model, with the parameters learnt, promises the
demand. At rest the *estimate* meets the demand: with gain error ``e`` the plant takes in
``demand/(1 + e)``. What is learnt there is a flow gain, as far as the law's bounds go, and a
charge factor for the rest; the density is that of the ambient pressure as the pressure sensor
shows it; the offset of the delivered duration is measured, and taken off each command. So the
delivered motion lies on the path of the model. A correction ``c`` of the predicted charge moves
it along the path by ``-c`` of the model's own charge: lift and duration both.

Private to `uncertain_measurement`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np

from plant import (
    CrankAnglePlant,
    FlowShape,
    MafSensor,
    ParameterError,
    PulseResponse,
    ValveCommand,
)
from plant.kinematics import FloatArray
from plant.sensors import MapSensor
from uncertainty.motion_pulses import ChangedMotion, follow_motion
from uncertainty.parameters import UncertaintySet
from uncertainty.perturbed import SAMPLE, PerturbedPlants
from uncertainty.pulse_sampling import SAMPLES
from uncertainty.sampling import Sample, nominal_sample

from ._sampled_estimates import TRIMMED
from .controller_parts import ChargeModel, Estimator
from .cylinder_parameters import CylinderParameters
from .estimator_response import (
    AnalysedEstimator,
    ChangedPoint,
    EstimatorResponse,
    LatentEstimator,
    estimator_response,
)
from .event_data import ModelPoint
from .linearise import LocalResponse

FLOW_GAINS = (0.65, 1.55)  # that the law may learn, inside its bounds and the model's
CHANGE = 0.01  # relative change of the model's charge in a pulse
_TRIMS = 12  # steps
_PARTS = 60  # of an event, in the shape of the flow
_LEAST_SLOPE = 1e-3  # of the charge over the flow gain: below, no gain explains a charge

Progress = Callable[[int, int], None]


class SampledLoops(Protocol):
    """Sampled full plants, each in the loop of one controller."""

    @property
    def local(self) -> LocalResponse:
        """Nominal plant at the operating point."""
        ...

    @property
    def estimator(self) -> LatentEstimator:
        """The estimator, with its latency."""
        ...

    @property
    def limits(self) -> str:
        """Name of what the controller is short of for the plants beyond its reach."""
        ...

    def follow(
        self, sample: Sample, progress: Progress | None = None
    ) -> tuple[list[PulseResponse], int]:
        """Response of the estimate on each plant, and how many are beyond reach."""
        ...


@dataclass(frozen=True)
class SettledPlants:
    """Plants of a sample where their controllers have settled.

    Attributes
    ----------
    sample : Sample
        The sample.
    parameters : tuple of CylinderParameters
        What is learnt of each plant.
    density : ndarray (samples,)
        Density of the intake air that each controller sees, over the model's.
    beyond : int
        Plants of which a flow gain within its bounds does not explain the charge.
    """

    sample: Sample
    parameters: tuple[CylinderParameters, ...]
    density: FloatArray = field(repr=False)
    beyond: int


def settled_plants(
    plant: CrankAnglePlant,
    sample: Sample,
    model: ChargeModel,
    demand: float,
    speed_rpm: float,
    *,
    maf: MafSensor,
    map: MapSensor,
) -> SettledPlants:
    """Return what the controller has learnt of each plant when its estimate meets the demand.

    Raises
    ------
    ParameterError
        If that is beyond the model for a plant.
    """
    import xarray as xr

    plants = PerturbedPlants(plant, sample)
    fields = {name: xr.DataArray(values, dims=SAMPLE) for name, values in plants.fields().items()}
    count, ambient = len(sample), plant.engine.ambient_pressure
    pressure = plants.fields().get("ambient_pressure", np.full(count, ambient))
    offset = [plants.map_at(i, map).offset for i in range(count)]
    density = (pressure + np.array(offset)) / ambient
    seen = np.array([1.0 + plants.maf_at(i, maf).gain_error for i in range(count)])
    gain, factor = np.zeros(count), np.zeros(count)  # logarithms
    low, high = np.log(FLOW_GAINS[0] * density), np.log(FLOW_GAINS[1] * density)
    error = np.full(count, np.inf)
    for _ in range(_TRIMS):
        learnt = [
            CylinderParameters(math.exp(g), 0.0, math.exp(f))
            for g, f in zip(gain, factor, strict=True)
        ]
        points = [
            model.inverse(demand, speed_rpm, p, d) for p, d in zip(learnt, density, strict=True)
        ]
        cycles = plant.steady_cycles(
            speed_rpm,
            xr.DataArray([p.lift_mm for p in points], dims=SAMPLE),
            xr.DataArray([p.duration_deg for p in points], dims=SAMPLE),
            parameters=fields,
            per_cylinder=False,
            on_infeasible="limit",
        )
        error = np.log(seen * cycles["air_charge"].to_numpy().reshape(count) / demand)
        short = np.array([p.limited for p in points])
        if float(np.abs(error).max()) < TRIMMED and not short.any():
            beyond = int(np.count_nonzero(factor != 0.0))
            return SettledPlants(sample, tuple(learnt), density, beyond)
        slope = np.maximum([p.flow_slope for p in points], _LEAST_SLOPE)
        wanted = np.where(factor == 0.0, gain + error / slope, gain)
        held = np.clip(wanted, low, high)
        factor += np.where(factor == 0.0, slope * (wanted - held), error)
        gain = held
    worst = int(np.argmax(np.where(short, np.inf, np.abs(error))))
    raise ParameterError(
        f"the estimate of sample {worst} is {100.0 * error[worst]:+.1f} % off the demand of "
        f"{1e6 * demand:.0f} mg at {speed_rpm:g} rpm with the nearest motion of the model: "
        "choose a demand further inside the plant's reach, or narrow the set"
    )


@dataclass(frozen=True)
class ModelLoops:
    """Sampled plants in loops of a charge model and an estimator that is fed with samples.

    Attributes
    ----------
    plant : CrankAnglePlant
        Nominal full plant.
    model : ChargeModel
        Model that the controller believes.
    own : Estimator
        The controller's estimator.
    demand, speed_rpm : float
        Operating point: kg, rpm.
    maf, map : MafSensor, MapSensor
        Nominal sensors.
    """

    plant: CrankAnglePlant = field(repr=False)
    model: ChargeModel = field(repr=False)
    own: Estimator = field(repr=False)
    demand: float
    speed_rpm: float
    maf: MafSensor = field(default_factory=MafSensor)
    map: MapSensor = field(default_factory=MapSensor)

    limits: ClassVar[str] = "flow gain"

    @cached_property
    def local(self) -> LocalResponse:
        """Nominal plant at the operating point."""
        settled = self._settled(nominal_sample(UncertaintySet(())))
        motion, points = _motions(self.model, settled, self.demand, self.speed_rpm)[0]
        followed = follow_motion(self.plant, motion, self.speed_rpm)
        pulse = followed.pulse
        flow = np.append(pulse.flow, 0.0)  # linear between its samples
        shares = (flow[1:] + flow[:-1]).reshape(-1, SAMPLES // _PARTS).sum(axis=1)
        return LocalResponse(
            speed_rpm=float(self.speed_rpm),
            n_cylinders=self.plant.engine.n_cylinders,
            command=motion.rest,
            charge=followed.charge,
            factor=followed.charge / points.rest.charge,
            sensitivity=float(pulse.charge.sum()) / followed.charge / points.change,
            shape=FlowShape(shares / shares.sum(), _PARTS),
        )

    @cached_property
    def nominal(self) -> EstimatorResponse:
        """The estimator on the nominal plant."""
        return next(self._responses(self._settled(nominal_sample(UncertaintySet(())))))

    @property
    def estimator(self) -> AnalysedEstimator:
        """The estimator, with its latency."""
        return AnalysedEstimator(self.own, self.nominal.latency)

    def replace(self, **changes: Any) -> ModelLoops:
        """Return a copy with the given fields changed."""
        return replace(self, **changes)

    def follow(
        self, sample: Sample, progress: Progress | None = None
    ) -> tuple[list[PulseResponse], int]:
        """Response of the estimate on each plant, and how many are beyond the flow gain.

        Raises
        ------
        ParameterError
            If a plant's estimates come later than those of the nominal one.
        """
        settled, found = self._settled(sample), []
        for i, response in enumerate(self._responses(settled)):
            if response.latency != self.nominal.latency:
                raise ParameterError(
                    f"the estimates of sample {i} come after {response.latency} events, those of "
                    f"the nominal plant after {self.nominal.latency}: narrow the sensor's delay"
                )
            found.append(response.response)
            if progress is not None:
                progress(i + 1, len(sample))
        return found, settled.beyond

    def _settled(self, sample: Sample) -> SettledPlants:
        return settled_plants(
            self.plant, sample, self.model, self.demand, self.speed_rpm, maf=self.maf, map=self.map
        )

    def _responses(self, settled: SettledPlants) -> Iterator[EstimatorResponse]:
        plants = PerturbedPlants(self.plant, settled.sample)
        motions = _motions(self.model, settled, self.demand, self.speed_rpm)
        for i, (motion, points) in enumerate(motions):
            yield estimator_response(
                self.own,
                follow_motion(plants.plant_at(i), motion, self.speed_rpm),
                points,
                self.speed_rpm,
                self.plant.engine.n_cylinders,
                maf=plants.maf_at(i, self.maf),
                map=plants.map_at(i, self.map),
            )


def _motions(
    model: ChargeModel, settled: SettledPlants, demand: float, speed_rpm: float
) -> list[tuple[ChangedMotion, ChangedPoint]]:
    """Motion of each settled plant, as delivered, with its changes, and what is believed of it."""
    found = []
    for learnt, density in zip(settled.parameters, settled.density, strict=True):
        rest, raised, lowered = (
            model.inverse(demand * share, speed_rpm, learnt, density)
            for share in (1.0, 1.0 + CHANGE, 1.0 - CHANGE)
        )
        motion = ChangedMotion(_command(rest), _command(raised), _command(lowered))
        found.append((motion, ChangedPoint(rest, raised, lowered, CHANGE)))
    return found


def _command(point: ModelPoint) -> ValveCommand:
    return ValveCommand(point.lift_mm, point.duration_deg)
