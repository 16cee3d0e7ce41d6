"""Grid of the mean-value maps: where their nodes lie, and where they come from."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ._checks import whole
from ._surface import DEGREE
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .parameters import Engine, HelmholtzRunner
from .region import OperatingRegion

SPEED_RANGE_RPM = (750.0, 6000.0)  # section 5
LIFT_RANGE_MM = (0.5, 8.0)
LONGEST_DEG = 280.0
POINTS = (9, 30)  # lifts and durations


def default_speeds(helmholtz: HelmholtzRunner, lowest_rpm: float, highest_rpm: float) -> FloatArray:
    """Speeds of a map's nodes in rpm: even in ``1/N`` between the runner's break points.

    The phase that the runner has gone through when the valve shuts is linear in ``1/N``. The
    break points are nodes, since the maps have a kink there.
    """
    breaks = (helmholtz.low_speed_rpm, helmholtz.high_speed_rpm)
    edges = [lowest_rpm, *(b for b in breaks if lowest_rpm < b < highest_rpm), highest_rpm]
    nodes = [lowest_rpm]
    for low, high in pairwise(edges):
        # Nodes per octave: the ringing of the runner is undamped at low speed only; above, its
        # amplitude grows with the square of speed.
        per_octave = 11.0 if high <= breaks[0] else 7.0 if high <= breaks[1] else 9.0
        count = max(round(per_octave * np.log2(high / low)), 1)
        nodes.extend(1.0 / np.linspace(1.0 / low, 1.0 / high, count + 1)[1:-1])
        nodes.append(high)
    return np.array(nodes)


def map_grid(
    engine: Engine,
    speeds_rpm: Sequence[float] | FloatArray | None,
    points: tuple[int, int],
    lift_range_mm: tuple[float, float] | None,
    longest_deg: float,
) -> tuple[OperatingRegion, FloatArray, FloatArray, FloatArray]:
    """Region of a map and its nodes of speed, lift and share. Arguments as for a map's fit."""
    valvetrain = engine.valvetrain
    speeds = (
        default_speeds(engine.helmholtz, *SPEED_RANGE_RPM)
        if speeds_rpm is None
        else np.array(speeds_rpm, dtype=float)
    )
    if speeds.ndim != 1 or len(speeds) <= DEGREE or not np.all(np.diff(speeds) > 0.0):
        raise ParameterError(
            f"speeds_rpm is {speeds.tolist()}, but must be at least {DEGREE + 1} rising values in "
            "rpm, for a cubic spline"
        )
    n_lifts = whole("points[0]", points[0], DEGREE + 1, 1000)
    n_shares = whole("points[1]", points[1], DEGREE + 1, 1000)
    low, high = lift_range_mm or (
        max(LIFT_RANGE_MM[0], valvetrain.lowest_lift_mm),
        min(LIFT_RANGE_MM[1], valvetrain.maximum_lift_mm),
    )
    region = OperatingRegion(
        lowest_speed_rpm=float(speeds[0]),
        highest_speed_rpm=float(speeds[-1]),
        lowest_lift_mm=float(low),
        highest_lift_mm=float(high),
        longest_deg=float(longest_deg),
        valvetrain=valvetrain,
    )
    lifts = np.geomspace(region.lowest_lift_mm, region.highest_lift_mm, n_lifts)
    lifts[[0, -1]] = region.lowest_lift_mm, region.highest_lift_mm
    shares = np.linspace(0.0, 1.0, n_shares)
    return region, speeds, lifts, shares


def provenance(plant: CrankAnglePlant) -> dict[str, str | float | int]:
    """Where a map comes from: the full plant, its options and the version of the package."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        package = version("camless-ctrl")
    except PackageNotFoundError:  # run from a folder that was never installed
        package = "not installed"
    return {
        "plant_fingerprint": plant.fingerprint,
        "runner": str(plant.runner),
        "oscillation": str(plant.oscillation),
        "orifice": plant.orifice,
        "resolution": plant.resolution,
        "opening_deg": 0.0,
        "throttle_deg": plant.engine.throttle.wide_open_deg,
        "package": "camless-ctrl",
        "version": package,
    }
