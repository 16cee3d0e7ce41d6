"""Error of the throttled maps against a full plant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ._progress import Progress
from ._throttled_grid import SteadyPoint
from ._throttled_results import ThrottledMapError, ThrottlePoint
from .crank_angle import CrankAnglePlant
from .kinematics import FloatArray

if TYPE_CHECKING:
    from .throttled import ThrottledMeanValuePlant


def error_against(
    maps: ThrottledMeanValuePlant,
    plant: CrankAnglePlant,
    samples: int,
    seed: int,
    progress: Progress | None,
) -> ThrottledMapError:
    """See `ThrottledMeanValuePlant.error_against`."""
    angle, speed = _draw(maps, samples, seed)
    truth = np.empty((samples, 3))
    for k in range(samples):
        point = SteadyPoint.of(plant, maps.cam, float(speed[k]), float(angle[k]))
        truth[k] = point.pressure, point.charge, point.loss
        if progress is not None:
            progress(k + 1, samples)
    low, high = maps.pressure_range(speed)
    # Another plant may leave the range, and is then compared with what the maps say at its end.
    pressure = np.minimum(np.maximum(truth[:, 0], low), high)
    along = low + (high - low) * np.linspace(0.0, 1.0, 101)[:, None]
    errors = (
        (maps.steady_pressure(angle, speed) - truth[:, 0]) / high,
        (maps.air_charge(pressure, speed) - truth[:, 1])
        / maps.air_charge(along, speed).max(axis=0),
        (maps.pumping_loss(pressure, speed) - truth[:, 2])
        / maps.pumping_loss(along, speed).max(axis=0),
    )
    rms = [float(np.sqrt(np.mean(error**2))) for error in errors]
    worst = [int(np.argmax(np.abs(error))) for error in errors]
    largest = [float(np.abs(error[k])) for error, k in zip(errors, worst, strict=True)]
    points = [ThrottlePoint(float(speed[k]), float(angle[k])) for k in worst]
    return ThrottledMapError(
        charge_rms=rms[1],
        charge_max=largest[1],
        loss_rms=rms[2],
        loss_max=largest[2],
        pressure_rms=rms[0],
        pressure_max=largest[0],
        worst_charge=points[1],
        worst_loss=points[2],
        worst_pressure=points[0],
        points=samples,
        seed=seed,
        same_plant=plant.fingerprint == maps.provenance["plant_fingerprint"],
    )


def _draw(maps: ThrottledMeanValuePlant, samples: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Throttle angles and speeds: uniform in speed, every other one in pressure or in angle.

    Uniform in pressure alone would leave out wide open, where the pressure hardly changes.
    """
    random = np.random.default_rng(seed)
    speed = random.uniform(maps.speeds_rpm[0], maps.speeds_rpm[-1], samples)
    share = random.uniform(0.0, 1.0, samples)
    lowest, highest = maps.pressure_range(speed)
    charge = maps.air_charge(lowest + (highest - lowest) * share, speed)
    by_pressure = maps.throttle_for_charge(charge, speed).throttle_deg
    low, high = maps.throttle_range_deg
    by_angle = low + (high - low) * share
    return np.where(np.arange(samples) % 2 == 0, by_pressure, by_angle), speed
