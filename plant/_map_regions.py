"""Inverse of the charge map, and the lift saturation of section 5."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ._checks import in_range
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import ChargeInverse

if TYPE_CHECKING:
    from .mean_value import MeanValuePlant

SATURATION_SHARE = 0.98  # of the charge at the highest lift
_ON_LIMIT = 1e-9  # share of the peak by which a charge may miss a limit and count as on it


def duration_for_charge(
    maps: MeanValuePlant, charge: ArrayLike, lift_mm: ArrayLike, speed_rpm: ArrayLike
) -> ChargeInverse:
    """See `MeanValuePlant.duration_for_charge`."""
    wanted, lift, speed = np.broadcast_arrays(
        np.asarray(charge, dtype=float),
        np.asarray(lift_mm, dtype=float),
        np.asarray(speed_rpm, dtype=float),
    )
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
    maps: MeanValuePlant, speed_rpm: ArrayLike, duration_deg: float | None, share: float
) -> FloatArray:
    """See `MeanValuePlant.lift_saturation`."""
    in_range("share", share, 0.0, 1.0, "1", open_low=True, open_high=True)
    speeds = np.asarray(speed_rpm, dtype=float)
    lifts = np.geomspace(maps.region.lowest_lift_mm, maps.region.highest_lift_mm, 400)
    lifts[[0, -1]] = maps.region.lowest_lift_mm, maps.region.highest_lift_mm
    result = np.empty(speeds.size)
    for k, speed in enumerate(speeds.ravel()):
        if duration_deg is None:
            charge = maps.charge_lines(lifts, np.full_like(lifts, speed)).peak().value
        else:
            charge = maps.air_charge(lifts, duration_deg, speed)
        excess = charge - share * charge[-1]
        below = np.flatnonzero(excess < 0.0)
        if not len(below):
            result[k] = lifts[0]
            continue
        last = below[-1]
        step = excess[last] / (excess[last] - excess[last + 1])
        result[k] = lifts[last] + step * (lifts[last + 1] - lifts[last])
    return result.reshape(speeds.shape)[()]
