"""Direct search on the full plant: no map, only steady cycles in batches."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plant.errors import ParameterError
from plant.kinematics import FloatArray
from plant.region import shortest_deg

if TYPE_CHECKING:
    from plant import CrankAnglePlant

    from .least_loss_motion import FeedforwardOptions

CHARGE_TOLERANCE = 5e-5  # 1, relative, to which a charge is met
# At resolution 1 the plant's steps leave up to 1e-4 of noise in charge and 4e-4 in loss, which
# is too much to compare losses within 1e-3; it falls with the cube of the resolution.
RESOLUTION = 3.0
_LIFTS = 31
_DURATIONS = (32, 128)  # of the first look along a lift; the finer one where that finds none
_MOST_STEPS = 40
_STEP_DEG = 0.5  # first step of a duration
_FINE = 7  # lifts of a refinement
_REFINEMENTS = 2


class FullMotion(NamedTuple):
    """Motions of the full plant, one a point; NaN where none gives the charge."""

    lift_mm: FloatArray
    duration_deg: FloatArray
    charge: FloatArray  # kg per event
    loss: FloatArray  # J per event


def cycles(
    plant: CrankAnglePlant, lift: FloatArray, duration: FloatArray, speed: FloatArray
) -> FullMotion:
    """Steady cycles, one a point; where the duration is too short for the lift, it is lowered."""
    data = plant.steady_cycles(speed, lift, duration, per_cylinder=False, on_infeasible="limit")
    return FullMotion(
        data["delivered_lift_mm"].values.reshape(lift.size),
        duration,
        data["air_charge"].values.reshape(lift.size),
        data["pumping_loss"].values.reshape(lift.size),
    )


def refined(plant: CrankAnglePlant) -> CrankAnglePlant:
    """Return the plant at `RESOLUTION` at least."""
    return plant.with_resolution(max(plant.resolution, RESOLUTION))


def trimmed(
    plant: CrankAnglePlant,
    charge: FloatArray,
    lift: FloatArray,
    duration: FloatArray,
    speed: FloatArray,
) -> FullMotion:
    """Motions at given lifts whose durations, near given ones, give charges exactly.

    Raises
    ------
    ParameterError
        If a charge is not met to `CHARGE_TOLERANCE`.
    """
    before, now = cycles(plant, lift, duration, speed), duration + _STEP_DEG
    slope = np.ones(lift.size)
    for _ in range(_MOST_STEPS):
        new = cycles(plant, lift, now, speed)
        left = new.charge - charge
        open_still = np.abs(left) > CHARGE_TOLERANCE * charge
        if not open_still.any():
            return new
        change = now - before.duration_deg
        # A slope over a tiny step would be noise: keep the last good one.
        wide = np.abs(change) > 0.05 * _STEP_DEG
        slope[wide] = (new.charge - before.charge)[wide] / change[wide]
        move = np.clip(-left / slope, -4.0 * _STEP_DEG, 4.0 * _STEP_DEG)
        before, now = new, now + np.where(open_still, move, 0.0)
    worst = int(np.argmax(np.abs(left) / charge))
    raise ParameterError(
        f"no duration near {duration[worst]:.2f} deg gives {1e6 * charge[worst]:.2f} mg with "
        f"{lift[worst]:.2f} mm at {speed[worst]:.0f} rpm on this plant: check it against the plant "
        "that the maps were fitted to"
    )


def first_rise(
    plant: CrankAnglePlant,
    charge: FloatArray,
    lift: FloatArray,
    speed: FloatArray,
    shortest: FloatArray,
    longest: FloatArray,
    durations: int,
) -> FullMotion:
    """Motions at given lifts with the shortest durations that give charges, by bracketing.

    All arguments but `durations`, the number looked at first, have one value a point.
    """
    share = np.linspace(0.0, 1.0, durations)
    duration = shortest[:, None] + np.maximum(longest - shortest, 0.0)[:, None] * share
    shape = duration.shape

    def spread(values: FloatArray) -> FloatArray:
        return np.broadcast_to(values[:, None], shape).ravel()

    seen = cycles(plant, spread(lift), duration.ravel(), spread(speed)).charge.reshape(shape)
    excess = seen - charge[:, None]
    rises = (excess[:, :-1] < 0.0) & (excess[:, 1:] >= 0.0)
    usable = np.flatnonzero(rises.any(axis=1) & (shortest < longest))
    k = np.argmax(rises[usable], axis=1)
    result = FullMotion(*(np.full(lift.size, np.nan) for _ in range(4)))
    if not usable.size:
        return result
    wanted, u, n = charge[usable], lift[usable], speed[usable]
    far, far_value = duration[usable, k], excess[usable, k]
    near, near_value = duration[usable, k + 1], excess[usable, k + 1]
    for _ in range(_MOST_STEPS):  # the Illinois method
        new = near - near_value * (near - far) / (near_value - far_value)
        found = cycles(plant, u, new, n)
        value = found.charge - wanted
        if np.all(np.abs(value) <= CHARGE_TOLERANCE * wanted):
            break
        crossed = (value < 0.0) != (near_value < 0.0)
        far, far_value = (
            np.where(crossed, near, far),
            np.where(crossed, near_value, 0.5 * far_value),
        )
        near, near_value = new, np.where(value == 0.0, 1e-30, value)
    met = np.abs(found.charge - wanted) <= 2.0 * CHARGE_TOLERANCE * wanted
    for target, values in zip(result, found, strict=True):
        target[usable] = np.where(met, values, np.nan)
    return result


def least_loss(
    plant: CrankAnglePlant,
    charge: FloatArray,
    speed: FloatArray,
    options: FeedforwardOptions,
    longest: FloatArray,
) -> FullMotion:
    """Motion of least loss for each charge (p,): a grid of lifts, refined about the best one.

    The options' limits on lift and dwell hold, and the longest durations (p,) in deg; the
    options' penalties do not count.

    Raises
    ------
    ParameterError
        If no motion gives a charge.
    """
    low, high = options.lowest_lift_mm, options.highest_lift_mm
    grid = np.linspace(low, high, _LIFTS)
    best = _best(plant, charge, speed, np.tile(grid, (charge.size, 1)), options, longest)
    missing = np.isnan(best.loss)
    if missing.any():
        worst = int(np.argmax(missing))
        raise ParameterError(
            f"no motion of this plant gives {1e6 * charge[worst]:.2f} mg at {speed[worst]:.0f} "
            "rpm: check it against the plant that the maps were fitted to"
        )
    width = grid[1] - grid[0]
    for _ in range(_REFINEMENTS):
        offsets = np.linspace(-width, width, _FINE + 2)[1:-1]
        lifts = np.clip(best.lift_mm[:, None] + offsets, low, high)
        finer = _best(plant, charge, speed, lifts, options, longest)
        better = finer.loss < best.loss  # not where it found none
        best = FullMotion(*(np.where(better, a, b) for a, b in zip(finer, best, strict=True)))
        width = offsets[1] - offsets[0]
    return best


def _best(
    plant: CrankAnglePlant,
    charge: FloatArray,
    speed: FloatArray,
    lifts: FloatArray,
    options: FeedforwardOptions,
    longest: FloatArray,
) -> FullMotion:
    """Best of lifts (p, m) for each of p charges; NaN where none gives it."""
    valvetrain = plant.engine.valvetrain
    result = FullMotion(*(np.full(charge.size, np.nan) for _ in range(4)))
    for durations in _DURATIONS:
        rows = np.flatnonzero(np.isnan(result.loss))
        if not rows.size:
            break
        lift = lifts[rows].ravel()
        q, n, latest = (np.repeat(v[rows], lifts.shape[1]) for v in (charge, speed, longest))
        shortest = shortest_deg(lift, n, valvetrain) + 6.0 * n * options.least_dwell
        found = first_rise(plant, q, lift, n, shortest, latest, durations)
        loss = np.where(np.isnan(found.loss), np.inf, found.loss).reshape(rows.size, -1)
        k = np.argmin(loss, axis=1) + np.arange(rows.size) * lifts.shape[1]
        for target, values in zip(result, found, strict=True):
            target[rows] = values[k]
    return result
