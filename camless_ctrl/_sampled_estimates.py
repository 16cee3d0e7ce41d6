"""Sampled full plants, trimmed to the demand, and what the estimator sees of each.

Private to `uncertain_measurement`.
"""

from __future__ import annotations

import numpy as np

from plant import CrankAnglePlant, FlowShape, MafSensor, ParameterError, PulseResponse
from plant.air_path import event_time
from plant.region import OperatingPoint
from uncertainty.parameters import DURATION_OFFSET, UncertainParameter, UncertaintySet
from uncertainty.perturbed import PerturbedPlants
from uncertainty.pulse_sampling import SampledPulses
from uncertainty.sampling import Sample

from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .linearise import LocalResponse

TRIM = UncertainParameter(
    "trim", -0.02, 0.02, 0.0, (DURATION_OFFSET,), False, "s", "what the adaptation commands"
)
TRIMMED = 2e-3  # relative error of the charge that is left
_TRIMS = 8  # steps
_PARTS = 60  # of an event, in the shape of the flow


def trimmed_sample(
    plant: CrankAnglePlant, sample: Sample, local: LocalResponse, demand: float, slope: float
) -> Sample:
    """Return the sample with the change of duration that each plant's adaptation settles at.

    There the *estimate* meets the demand: with a gain error of the sensor the charge does not.
    """
    uncertain = sample.uncertain + UncertaintySet((TRIM,))
    point = OperatingPoint(local.speed_rpm, local.command.lift_mm, local.command.duration_deg)
    degrees = 6.0 * local.speed_rpm
    trim = np.zeros(len(sample))
    per_second = slope * local.sensitivity * degrees  # relative charge per s of duration
    error = np.full(len(sample), np.inf)
    seen = np.array([1.0 + gain_error(sample, i) for i in range(len(sample))])
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
        f"sample {worst} takes in {100.0 * error[worst]:+.1f} % more than the demand of "
        f"{1e6 * demand:.0f} mg at {local.speed_rpm:g} rpm, with every duration that was tried: "
        "choose a demand further inside the plant's reach, or narrow the set"
    )


def gain_error(sample: Sample, i: int) -> float:
    """Gain error of the MAF sensor of a plant."""
    values = sample.at(i)
    return sum(values[p.name] for p in sample.uncertain if p.acts_on == ("maf.gain_error",))


def estimate_response(
    pulses: SampledPulses, i: int, estimator: ChargeEstimator, feedforward: Feedforward
) -> PulseResponse:
    """Response of the estimate to a correction on one plant.

    The correction is relative to what the map promises at the duration that this plant's
    adaptation has settled at, and moves the duration by the slope of the map there.
    """
    pulse = pulses.pulses[i]
    assert pulse is not None  # failures are raised
    speed, command = pulses.speed_rpm, pulses.command
    trim = 6.0 * speed * pulses.plants.sample.at(i)[TRIM.name]
    promised = feedforward.charge_at(command.duration_deg + trim, speed)
    slope = feedforward.sensitivity(promised, speed) / promised  # relative, per deg
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
    taps = gain * response.taps  # a gain error scales estimate and demand of a plant alike
    return PulseResponse(response.event_time, response.first, taps, response.pole)
