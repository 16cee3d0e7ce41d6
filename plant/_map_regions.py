"""Inverse of the charge map, and the lift saturation of section 5."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ._checks import broadcast, in_range
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import ChargeInverse

if TYPE_CHECKING:
    from .mean_value import MeanValuePlant

SATURATION_SHARE = 0.98  # of the charge at the highest lift
_SCAN = 96  # lifts that bracket a crossing
_BLOCK = 200  # points scanned at a time, which bounds the memory
_MOST_STEPS = 60
_ROUNDING = 1e-13  # relative step of the lift at which a root is found
_ON_LIMIT = 1e-9  # share of the peak by which a charge may miss a limit and count as on it


def duration_for_charge(
    maps: MeanValuePlant, charge: ArrayLike, lift_mm: ArrayLike, speed_rpm: ArrayLike
) -> ChargeInverse:
    """See `MeanValuePlant.duration_for_charge`."""
    wanted, lift, speed = broadcast("charge, lift and speed", charge, lift_mm, speed_rpm)
    shape = wanted.shape
    wanted, lift, speed = wanted.ravel(), lift.ravel(), speed.ravel()
    if not np.isfinite(wanted).all():
        raise ParameterError("charge holds values that are not finite, but must be in kg")
    lines = maps.charge_lines(lift, speed)
    peak = lines.peak()
    rise = lines.first_rise(wanted, peak)
    slack = _ON_LIMIT * peak.value
    at_peak = (wanted > peak.value) & (wanted <= peak.value + slack)
    at_start = np.abs(wanted - lines.at(np.zeros_like(wanted))) <= slack
    share = np.where(at_peak, peak.at, np.where(at_start, 0.0, rise.at))
    reachable = np.isfinite(share)
    duration = maps.region.duration_deg(lift, share, speed)
    return ChargeInverse(
        duration_deg=duration.reshape(shape)[()],
        reachable=reachable.reshape(shape)[()],
        charge=wanted.reshape(shape)[()],
        lowest_charge=rise.lowest.reshape(shape)[()],
        highest_charge=peak.value.reshape(shape)[()],
        highest_at_deg=maps.region.duration_deg(lift, peak.at, speed).reshape(shape)[()],
    )


def lift_saturation(
    maps: MeanValuePlant,
    speed_rpm: ArrayLike,
    duration_deg: ArrayLike | None,
    share: float = SATURATION_SHARE,
) -> FloatArray:
    """Lift in mm from which on the charge is at least a share of that at the highest lift.

    Exact for the map: the crossing is bracketed by lifts and its root found between them.
    Where the charge crosses the share more than once, the last crossing counts; where it is
    above at every lift, the lowest lift.

    Parameters
    ----------
    maps : MeanValuePlant
        The maps.
    speed_rpm, duration_deg : array_like
        Speeds and durations, which broadcast against each other. None as duration takes, at
        each lift, the one of the largest charge.
    share : float
        Share of the charge at the highest lift.

    Returns
    -------
    float or ndarray
        Lift in mm. NaN where the highest lift cannot be driven at the duration and speed, or
        takes in no charge.

    Raises
    ------
    ParameterError
        For a speed or duration out of the map's range, or a share outside ``(0, 1)``.
    """
    in_range("share", share, 0.0, 1.0, "1", open_low=True, open_high=True)
    region = maps.region
    duration = region.longest_deg if duration_deg is None else duration_deg
    speed, duration = broadcast("speed and duration", speed_rpm, duration)
    shape = speed.shape
    speed, duration = speed.ravel(), duration.ravel()
    region.require(region.highest_lift_mm, region.longest_deg, speed)
    for value in duration[~((duration > 0.0) & (duration <= region.longest_deg))][:1]:
        in_range("duration_deg", float(value), 0.0, region.longest_deg, "deg", open_low=True)
    result = np.full(speed.size, np.nan)
    drivable = np.flatnonzero(region.feasible(region.highest_lift_mm, duration, speed))
    for start in range(0, drivable.size, _BLOCK):
        k = drivable[start : start + _BLOCK]
        at = None if duration_deg is None else duration[k]
        result[k] = _last_crossing(maps, speed[k], at, share)
    return result.reshape(shape)[()]


def _last_crossing(
    maps: MeanValuePlant, speed: FloatArray, duration: FloatArray | None, share: float
) -> FloatArray:
    """Saturation lift in mm at `p` speeds and durations at which every lift can be driven."""
    lifts = np.geomspace(maps.region.lowest_lift_mm, maps.region.highest_lift_mm, _SCAN)
    lifts[[0, -1]] = maps.region.lowest_lift_mm, maps.region.highest_lift_mm

    def charge(lift: FloatArray, point: np.ndarray) -> FloatArray:
        if duration is None:
            return maps.charge_lines(lift, speed[point]).peak().value
        return maps.air_charge(lift, duration[point], speed[point])

    every = np.repeat(np.arange(speed.size), _SCAN)
    scan = charge(np.tile(lifts, speed.size), every).reshape(speed.size, _SCAN)
    wanted = share * scan[:, -1]
    excess = scan - wanted[:, None]
    below = excess < 0.0
    result = np.where(scan[:, -1] > 0.0, lifts[0], np.nan)
    point = np.flatnonzero((scan[:, -1] > 0.0) & below.any(axis=1))
    if point.size:
        last = _SCAN - 1 - np.argmax(below[point, ::-1], axis=1)
        result[point] = _root(
            lambda lift: charge(lift, point) - wanted[point],
            (lifts[last], excess[point, last]),
            (lifts[last + 1], excess[point, last + 1]),
        )
    return result


def _root(
    function: Callable[[FloatArray], FloatArray],
    low: tuple[FloatArray, FloatArray],
    high: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Where each of `p` functions passes zero between two points: the Illinois method.

    Parameters
    ----------
    function : callable
        Takes and returns `p` values.
    low, high : tuple of 2 ndarray (p,)
        Ends of the brackets, and the values there, of opposite sign.
    """
    (far, far_value), (near, near_value) = low, high
    for _ in range(_MOST_STEPS):
        slope = near_value - far_value
        # Only a zero at both ends has no slope, and then it is the root.
        step = near_value * (far - near) / np.where(slope == 0.0, 1.0, slope)
        new = near + step
        value = function(new)
        crossed = (value < 0.0) != (near_value < 0.0)
        far = np.where(crossed, near, far)
        # Halving the value at an end that stays is what keeps a curved function from stalling.
        far_value = np.where(crossed, near_value, 0.5 * far_value)
        near, near_value = new, value
        if np.all(np.abs(step) <= _ROUNDING * np.abs(near)):
            break
    return near
