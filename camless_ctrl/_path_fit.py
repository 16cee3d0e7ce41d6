"""Making of the optimal path: limits, choice of lifts, surface, certificates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant._checks import in_range, whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray

from ._path_certificates import PathCertificates
from ._path_limits import ChargeLimits
from ._path_problem import ambient_charge, motion_problem
from ._path_scan import Scan, scan
from ._path_selection import choose_lifts
from ._path_surface import DEGREE, LiftSurface

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from plant import MeanValuePlant

    from .least_loss_motion import FeedforwardOptions

SPEEDS = 51
POSITIONS = 49
LEAST_NODES = DEGREE + 1
_DENSITY = 0.25  # 1, spacing of the positions at the lowest demand over an even one
# By which the nodes keep off the limits, so that the path between them does not pass them: of
# dwell (s) and of charge at the ends of the branches (1). Tried in this order.
_MARGINS = ((2e-5, 7e-4), (4e-5, 1.4e-3), (8e-5, 2.8e-3), (1.6e-4, 5.6e-3), (3.2e-4, 1.1e-2))
_FINER = 3  # points per cell and direction at which the path is checked
_ROUNDING = 1e-9  # 1, by which a duration may miss its limit


@dataclass(frozen=True, eq=False)
class FittedPath:
    """What a fit makes; the fields are those of `OptimalPath`."""

    speeds_rpm: FloatArray
    positions: FloatArray
    limits: ChargeLimits
    surface: LiftSurface
    certificates: PathCertificates


def default_speeds(maps: MeanValuePlant) -> FloatArray:
    """Speeds in rpm, even in their logarithm, over the range of the maps."""
    r = maps.region
    speeds = np.geomspace(r.lowest_speed_rpm, r.highest_speed_rpm, SPEEDS)
    speeds[[0, -1]] = r.lowest_speed_rpm, r.highest_speed_rpm
    return speeds


def default_positions(nodes: int) -> FloatArray:
    """Positions, dense at low demands, where the best lift changes fast."""
    even = np.linspace(0.0, 1.0, nodes)
    return _DENSITY * even + (1.0 - _DENSITY) * even**3


def fit_path(
    maps: MeanValuePlant,
    options: FeedforwardOptions,
    speeds_rpm: Sequence[float] | FloatArray | None,
    nodes: int,
    progress: Callable[[int, int], None] | None,
) -> FittedPath:
    """See `OptimalPath.fit`."""
    options.require(maps)
    speeds = default_speeds(maps) if speeds_rpm is None else _speeds(maps, speeds_rpm)
    positions = default_positions(whole("nodes", nodes, LEAST_NODES, 1000))
    ambient = ambient_charge(maps)
    across = options.steepest_over_speed_mm * np.diff(np.log(speeds))
    missed: str | None = None
    for dwell, share in _MARGINS:
        limits = ChargeLimits.of(maps, options, speeds, dwell, 1.5 * share)
        low, high = limits.low[:, None], limits.high[:, None]
        charge = low + positions * (high - low)
        along = options.steepest_lift_mm * np.diff(charge, axis=1) / ambient
        kept = scan(maps, options, speeds, charge, dwell_margin=dwell, charge_margin=share)
        dead = ~np.isfinite(kept.cost).any(axis=2)
        if dead.any():
            i, j = (int(k) for k in np.argwhere(dead)[0])
            missed = (
                f"at {speeds[i]:.0f} rpm and {1e6 * charge[i, j]:.1f} mg, where no lift is left"
            )
            continue
        chosen = choose_lifts(kept.cost, kept.lifts_mm, along, across)
        surface = LiftSurface.through(speeds, positions, chosen)
        missed = _missed(maps, options, limits, surface, speeds, positions)
        if missed is None:
            break
    else:
        raise ParameterError(
            f"the path leaves the motions that the options allow {missed}; use more nodes, or "
            "widen the options' limits"
        )
    best = scan(maps, options, speeds, charge)
    certificates = _certified(maps, options, surface, speeds, positions, charge, best, progress)
    return FittedPath(speeds, positions, limits, surface, certificates)


def _speeds(maps: MeanValuePlant, values: Sequence[float] | FloatArray) -> FloatArray:
    speeds = np.array(values, dtype=float)
    r = maps.region
    if speeds.ndim != 1 or speeds.size < LEAST_NODES or not np.all(np.diff(speeds) > 0.0):
        raise ParameterError(
            f"speeds_rpm is {speeds.tolist()}, but must be {LEAST_NODES} or more rising speeds in "
            "rpm"
        )
    for k, speed in enumerate(speeds.tolist()):
        in_range(f"speeds_rpm[{k}]", speed, r.lowest_speed_rpm, r.highest_speed_rpm, "rpm")
    return speeds


def exact_motion(
    maps: MeanValuePlant,
    options: FeedforwardOptions,
    charge: FloatArray,
    lift_mm: FloatArray,
    speed_rpm: FloatArray,
) -> tuple[FloatArray, np.ndarray]:
    """Duration in deg that gives charges (kg) at lifts, and whether the options allow it."""
    region = maps.region
    duration = maps.duration_for_charge(charge, lift_mm, speed_rpm).duration_deg
    slope = maps.charge_gradient(lift_mm, duration, speed_rpm, outside="nan").duration
    shortest = region.shortest_deg(lift_mm, speed_rpm) + 6.0 * speed_rpm * options.least_dwell
    # A comparison with NaN is False: what the lift does not give is not allowed.
    allowed = (
        (duration >= shortest * (1.0 - _ROUNDING))
        & (duration <= options.longest_deg(maps.engine, region) * (1.0 + _ROUNDING))
        & (slope >= options.least_authority * ambient_charge(maps))
    )
    return duration, allowed


def _missed(
    maps: MeanValuePlant,
    options: FeedforwardOptions,
    limits: ChargeLimits,
    surface: LiftSurface,
    speeds: FloatArray,
    positions: FloatArray,
) -> str | None:
    """Where the path, between its nodes too, is not a motion that the options allow; or None."""
    fine = np.exp(_refined(np.log(speeds)))
    fine[[0, -1]] = speeds[[0, -1]]
    position, speed = np.meshgrid(_refined(positions), fine)
    low, high = limits.at(speed)
    charge = low + position * (high - low)
    _, allowed = exact_motion(maps, options, charge, surface(position, speed), speed)
    if allowed.all():
        return None
    worst = tuple(np.argwhere(~allowed)[0])
    return (
        f"at {np.count_nonzero(~allowed)} of {allowed.size} points, the first at "
        f"{speed[worst]:.0f} rpm and {1e6 * charge[worst]:.1f} mg"
    )


def _refined(nodes: FloatArray) -> FloatArray:
    """Nodes with points even between them."""
    part = np.arange(_FINER) / _FINER
    inner = nodes[:-1, None] + np.diff(nodes)[:, None] * part
    return np.append(inner.ravel(), nodes[-1])


def _certified(
    maps: MeanValuePlant,
    options: FeedforwardOptions,
    surface: LiftSurface,
    speeds: FloatArray,
    positions: FloatArray,
    charge: FloatArray,
    best: Scan,
    progress: Callable[[int, int], None] | None,
) -> PathCertificates:
    """Prove the optimum of each node, from the best lift of the scan."""
    problem = motion_problem(maps, options)
    start = np.argmin(best.cost, axis=2)
    rows = []
    for i, speed in enumerate(speeds.tolist()):
        row = []
        for j in range(positions.size):
            m = start[i, j]
            lift, duration = float(best.lifts_mm[m]), float(best.duration_deg[i, j, m])
            row.append(problem.solve(float(charge[i, j]), speed, lift, duration))
            if progress is not None:
                progress(i * positions.size + j + 1, charge.size)
        rows.append(row)
    position, speed_at = np.meshgrid(positions, speeds)
    lift_mm = surface(position, speed_at)
    duration_deg, _ = exact_motion(maps, options, charge, lift_mm, speed_at)
    cost = maps.pumping_loss(lift_mm, duration_deg, speed_at) + options.penalty(lift_mm)
    return PathCertificates.of(rows, cost)
