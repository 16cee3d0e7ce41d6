"""Sampled full plants where their adaptation settles, and what the estimator sees of each.

With charge factor ``f`` the controller asks the map for ``p = demand/f``, the plant takes in
``m`` and the estimate is ``e = (1 + g) M m``, with ``g`` the gain error and ``M`` the rest of
the sensor and the estimator, of gain 1 when steady. The adaptation integrates ``e/p - f``, so

    (1 + g) m = demand      at rest, and
    d(e/p - f)/f = M dm/m   around it: neither ``f`` nor ``g`` is left.

A relative correction ``c = df/f`` lowers ``p`` by ``c p``, and so the charge by

    dm/m = -c (dm/dd)/m p/(dp/dd),

the slope of the plant over that of the map, both relative and at the duration ``d`` at rest.

Private to `uncertain_measurement`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from plant import CrankAnglePlant, FlowShape, MafSensor, ParameterError, PulseResponse
from plant.air_path import event_time
from plant.kinematics import FloatArray
from plant.region import OperatingPoint
from uncertainty.parameters import DURATION_OFFSET, UncertainParameter, UncertaintySet
from uncertainty.perturbed import PerturbedPlants
from uncertainty.pulse_sampling import SampledPulses, sampled_pulses
from uncertainty.sampling import Sample

from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .linearise import LocalResponse, local_response

TRIM = UncertainParameter(
    "trim", -0.02, 0.02, 0.0, (DURATION_OFFSET,), False, "s", "what the adaptation commands"
)
TRIMMED = 2e-3  # relative error of the estimate that is left
_TRIMS = 8  # steps
_PARTS = 60  # of an event, in the shape of the flow


@dataclass(frozen=True)
class WindowLoops:
    """Sampled plants in loops of a map inverse at scheduled lift and of a window on the air flow.

    Attributes
    ----------
    plant : CrankAnglePlant
        Nominal full plant.
    feedforward : Feedforward
        Map that the controller believes.
    estimator : ChargeEstimator
        The estimator.
    demand, speed_rpm : float
        Operating point: kg, rpm.
    """

    plant: CrankAnglePlant = field(repr=False)
    feedforward: Feedforward = field(repr=False)
    estimator: ChargeEstimator
    demand: float
    speed_rpm: float

    limits: ClassVar[str] = "duration"

    @cached_property
    def local(self) -> LocalResponse:
        """Nominal plant at the operating point."""
        return local_response(self.plant, self.feedforward, self.demand, self.speed_rpm)

    def follow(
        self, sample: Sample, progress: Callable[[int, int], None] | None = None
    ) -> tuple[list[PulseResponse], int]:
        """Response of the estimate on each plant, and how many are beyond the durations."""
        local, feedforward = self.local, self.feedforward
        trimmed = trimmed_sample(self.plant, sample, local, self.demand, feedforward)
        pulses = sampled_pulses(
            PerturbedPlants(self.plant, trimmed),
            local.command,
            self.speed_rpm,
            reference_charge=self.demand,
            progress=progress,
        )
        found = [
            estimate_response(pulses, i, self.estimator, feedforward) for i in range(len(pulses))
        ]
        return found, beyond_reach(trimmed, local, feedforward)


def trimmed_sample(
    plant: CrankAnglePlant,
    sample: Sample,
    local: LocalResponse,
    demand: float,
    feedforward: Feedforward,
) -> Sample:
    """Return the sample with the change of duration that each plant's adaptation settles at.

    There the *estimate* meets the demand: with a gain error of the sensor the charge does not.
    The longest duration of the controller does not bound the change, see `beyond_reach`.
    """
    uncertain = sample.uncertain + UncertaintySet((TRIM,))
    point = OperatingPoint(local.speed_rpm, local.command.lift_mm, local.command.duration_deg)
    slope = _relative_slope(feedforward, local.command.duration_deg, local.speed_rpm)
    trim = np.zeros(len(sample))
    # Relative charge per s of duration, of the nominal plant.
    per_second = slope * local.sensitivity * 6.0 * local.speed_rpm
    error = np.full(len(sample), np.inf)
    sensors = PerturbedPlants(plant, sample)
    seen = np.array([1.0 + sensors.maf_at(i, MafSensor()).gain_error for i in range(len(sample))])
    for _ in range(_TRIMS):
        tried = Sample(uncertain, np.column_stack((sample.values, trim)))
        cycles = PerturbedPlants(plant, tried).steady_cycles(*point, per_cylinder=False)
        error = seen * cycles["air_charge"].to_numpy()[:, 0] / demand - 1.0
        if float(np.abs(error).max()) < TRIMMED:
            return tried
        trim = trim - error / per_second
        if not float(np.abs(trim).max()) <= TRIM.high:
            break
    worst = int(np.argmax(np.abs(error)))
    raise ParameterError(
        f"the estimate of sample {worst} is {100.0 * error[worst]:+.1f} % off the demand of "
        f"{1e6 * demand:.0f} mg at {local.speed_rpm:g} rpm, with every duration that was tried: "
        "choose a demand further inside the plant's reach, or narrow the set"
    )


def settled_durations(trimmed: Sample, local: LocalResponse) -> FloatArray:
    """Duration in deg that the adaptation of each plant of a trimmed sample commands."""
    return local.command.duration_deg + 6.0 * local.speed_rpm * trimmed.column(TRIM.name)


def beyond_reach(trimmed: Sample, local: LocalResponse, feedforward: Feedforward) -> int:
    """Count the plants of a trimmed sample that need a duration that the controller has not.

    Their estimate does not meet the demand, and nothing is adapted but a factor that runs away.
    They are described as if the map went on with the slope and the charge of its end.
    """
    durations = settled_durations(trimmed, local)
    low, high = (
        feedforward.command(charge, local.speed_rpm).command.duration_deg
        for charge in (0.0, math.inf)
    )
    return int(np.count_nonzero((durations < low) | (durations > high)))


def _relative_slope(feedforward: Feedforward, duration_deg: float, speed_rpm: float) -> float:
    """Slope of the map over its charge at a duration, 1/deg."""
    promised = feedforward.charge_at(duration_deg, speed_rpm)
    return feedforward.sensitivity(promised, speed_rpm) / promised


def estimate_response(
    pulses: SampledPulses, i: int, estimator: ChargeEstimator, feedforward: Feedforward
) -> PulseResponse:
    """Response of the estimate to a correction on one plant of a trimmed sample.

    The estimate is relative to its own value at rest, the demand. The correction is relative
    to what the map promises at the duration that this plant's adaptation has settled at, and
    moves the duration by the slope of the map there.
    """
    pulse = pulses.pulses[i]
    assert pulse is not None  # failures are raised
    speed, command = pulses.speed_rpm, pulses.command
    trim = 6.0 * speed * pulses.plants.sample.at(i)[TRIM.name]
    slope = _relative_slope(feedforward, command.duration_deg + trim, speed)
    gain = float(pulse.charge.sum()) / pulses.step / pulses.charge[i] / slope
    events, samples = pulse.flow.shape
    flow = np.append(pulse.flow, 0.0)  # linear between its samples
    shares = (flow[1:] + flow[:-1]).reshape(events * _PARTS, samples // _PARTS).sum(axis=1)
    maf = pulses.plants.maf_at(i, MafSensor())
    response = PulseResponse.of_window(
        event_time(pulses.speed_rpm, pulses.n_cylinders),
        time_constant=maf.time_constant,
        delay=maf.delay,
        shape=FlowShape(shares / shares.sum(), _PARTS),
        shift=estimator.delay,
        taper=estimator.taper,
        correction=estimator.time_constant,
    )
    taps = gain * response.taps  # a gain error scales the estimate at rest and its change alike
    return PulseResponse(response.event_time, response.first, taps, response.pole)
