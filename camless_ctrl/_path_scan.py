"""Scan of all lifts: the early-closing branch of each, and the cost of a charge on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant.kinematics import FloatArray

from ._path_problem import ambient_charge

if TYPE_CHECKING:
    from plant import MeanValuePlant

    from .least_loss_motion import FeedforwardOptions

_STEP_MM = 0.05  # of the lifts
_SHARES = 801  # points along a branch


@dataclass(frozen=True, eq=False)
class Branches:
    """Early-closing branch at speeds (s,) and lifts (m,): charge rises with duration.

    A branch begins with the shortest duration that may be driven and rises with at least the
    authority asked for; it ends where it no longer does, or at the longest duration.
    """

    lifts_mm: FloatArray  # (m,)
    share: FloatArray  # (k,) of the way from the shortest to the longest duration of the map
    charge: FloatArray  # (s, m, k) kg per event
    first: np.ndarray  # (s, m) index of the branch's begin
    last: np.ndarray  # (s, m) index of its end; below `first` where there is no branch
    begin: FloatArray  # (s, m) charge at the begin, kg; inf where there is none
    end: FloatArray  # (s, m) charge at the end, kg; -inf where there is none


def scanned_lifts(options: FeedforwardOptions) -> FloatArray:
    """Lifts of the scan in mm."""
    low, high = options.lowest_lift_mm, options.highest_lift_mm
    return np.linspace(low, high, max(2, 1 + round((high - low) / _STEP_MM)))


def branches(
    maps: MeanValuePlant,
    options: FeedforwardOptions,
    speeds_rpm: FloatArray,
    lifts_mm: FloatArray,
    dwell_margin: float = 0.0,
) -> Branches:
    """Find the branch of each lift at each speed.

    Parameters
    ----------
    dwell_margin : float
        Dwell in s by which the motions keep off the least one.
    """
    shape = speeds_rpm.size, lifts_mm.size
    lift, speed = (a.ravel() for a in np.meshgrid(lifts_mm, speeds_rpm))
    share = np.linspace(0.0, 1.0, _SHARES)
    lines = maps.charge_lines(lift, speed)
    region = maps.region
    shortest = region.shortest_deg(lift, speed)[:, None]
    span = region.longest_deg - shortest
    charge = lines.on(share)
    slope = lines.derivative().on(share) / span
    duration = shortest + span * share
    earliest = shortest + 6.0 * speed[:, None] * (options.least_dwell + dwell_margin)
    driven = (duration >= earliest) & (duration <= options.longest_deg(maps.engine, region))
    rising = driven & (slope >= ambient_charge(maps) * options.least_authority)
    lowest = options.lowest_charge_share * ambient_charge(maps)
    # The branch that counts: the rising piece in which the lowest demand is first passed.
    wanted = rising & (charge >= lowest)
    row = np.arange(lift.size)
    inner = np.argmax(wanted, axis=1)
    there = wanted[row, inner]
    index = np.arange(_SHARES)
    broken_before = ~rising & (index < inner[:, None])
    first = np.where(broken_before, index, -1).max(axis=1) + 1
    broken_after = ~rising & (index > inner[:, None])
    last = np.where(broken_after, index, _SHARES).min(axis=1) - 1
    begin = np.where(there, charge[row, first], np.inf)
    end = np.where(there, charge[row, last], -np.inf)
    return Branches(
        lifts_mm,
        share,
        charge.reshape(*shape, -1),
        first.reshape(shape),
        np.where(there, last, -1).reshape(shape),
        begin.reshape(shape),
        end.reshape(shape),
    )


@dataclass(frozen=True, eq=False)
class Scan:
    """Cost of charges (s, q) at speeds (s,) for all lifts (m,); inf where one cannot be used."""

    lifts_mm: FloatArray  # (m,)
    duration_deg: FloatArray  # (s, q, m), NaN where the lift does not give the charge
    loss: FloatArray  # (s, q, m) J per event
    cost: FloatArray  # (s, q, m) J per event
    branches: Branches

    def reach(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest charge in kg over all lifts at each speed, (s,)."""
        return self.branches.begin.min(axis=1), self.branches.end.max(axis=1)


def scan(
    maps: MeanValuePlant,
    options: FeedforwardOptions,
    speeds_rpm: FloatArray,
    charge: FloatArray,
    *,
    dwell_margin: float = 0.0,
    charge_margin: float = 0.0,
) -> Scan:
    """Cost of each charge (s, q) in kg at each speed (s,), lift by lift.

    Parameters
    ----------
    dwell_margin, charge_margin : float
        By which the motions keep off the least dwell, s, and off the charges at the ends of their
        branch, 1.
    """
    lifts = scanned_lifts(options)
    found = branches(maps, options, speeds_rpm, lifts, dwell_margin)
    share = np.full((*charge.shape, lifts.size), np.nan)
    for i in range(speeds_rpm.size):
        for m in range(lifts.size):
            part = slice(found.first[i, m], found.last[i, m] + 1)
            if found.last[i, m] <= found.first[i, m]:
                continue
            share[i, :, m] = np.interp(
                charge[i], found.charge[i, m, part], found.share[part], left=np.nan, right=np.nan
            )
    wide = (charge[..., None] >= (1.0 + charge_margin) * found.begin[:, None]) & (
        charge[..., None] <= (1.0 - charge_margin) * found.end[:, None]
    )
    share[~wide] = np.nan
    speed = np.broadcast_to(speeds_rpm[:, None, None], share.shape)
    lift = np.broadcast_to(lifts, share.shape)
    duration = maps.region.duration_deg(lift, share, speed)
    loss = maps.pumping_loss(lift, duration, speed, outside="nan")
    cost = np.where(np.isfinite(loss), loss + options.penalty(lift), np.inf)
    return Scan(lifts, duration, loss, cost, found)
