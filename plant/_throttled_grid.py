"""Nodes of the throttled engine's maps: steady cycles of the cam-driven full plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ._checks import in_range, whole
from ._progress import Progress
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .orifice import simplified_flow
from .parameters import Engine, HelmholtzRunner
from .valve import ValveCommand

SPEED_RANGE_RPM = (750.0, 6000.0)  # section 5
PRESSURES = 24  # nodes at each speed
LEAST_NODES = 4  # for a cubic spline
LOWEST_ABOVE_CLOSED_DEG = 1.0  # the smallest throttle angle, above that at which Eq. 19 closes
_SCOUTS = 14  # throttle angles that tell where the pressures lie


@dataclass(frozen=True, eq=False)
class ThrottledNodes:
    """What the full plant says at the nodes, all (n, k): speeds by shares of the pressures."""

    pressure: FloatArray  # time average over the cycle, Pa
    throttle_deg: FloatArray  # deg
    charge: FloatArray  # kg per event
    loss: FloatArray  # J per event
    flow_factor: FloatArray  # mean throttle flow over that of Eq. 15 at the mean pressure, 1


@dataclass(frozen=True)
class SteadyPoint:
    """One steady cycle of the throttled engine."""

    pressure: float
    charge: float
    loss: float
    flow_factor: float

    @classmethod
    def of(
        cls, plant: CrankAnglePlant, cam: ValveCommand, speed_rpm: float, throttle_deg: float
    ) -> SteadyPoint:
        """Simulate it; charge and loss are means over the cylinders."""
        cycle = plant.steady_cycle(speed_rpm, cam, throttle_deg)
        pressure = float(np.mean(cycle.trace.manifold_pressure))
        engine = plant.engine
        steady = engine.throttle.area(throttle_deg) * float(
            simplified_flow(pressure, engine.ambient_pressure)
        )
        return cls(
            pressure,
            float(np.mean(cycle.air_charge)),
            float(np.mean(cycle.pumping_loss)),
            cycle.throttle_mass * speed_rpm / 120.0 / steady,
        )


def default_speeds(helmholtz: HelmholtzRunner) -> FloatArray:
    """Speeds of the nodes in rpm: even in ``1/N`` between the runner's break points.

    The phase that the runner has gone through when the cam shuts the valve is linear in
    ``1/N``; below the first break point its ringing is hardly damped.
    """
    lowest, highest = SPEED_RANGE_RPM
    breaks = (helmholtz.low_speed_rpm, helmholtz.high_speed_rpm)
    edges = [lowest, *(b for b in breaks if lowest < b < highest), highest]
    nodes = [lowest]
    for low, high in pairwise(edges):
        per_octave = 16.0 if high <= breaks[0] else 10.0
        count = max(round(per_octave * np.log2(high / low)), 1)
        nodes.extend(1.0 / np.linspace(1.0 / low, 1.0 / high, count + 1)[1:-1])
        nodes.append(high)
    return np.array(nodes)


def check_speeds(engine: Engine, speeds_rpm: Sequence[float] | FloatArray | None) -> FloatArray:
    """Nodes of speed, checked."""
    if speeds_rpm is None:
        return default_speeds(engine.helmholtz)
    speeds = np.array(speeds_rpm, dtype=float)
    if speeds.ndim != 1 or len(speeds) < LEAST_NODES or not np.all(np.diff(speeds) > 0.0):
        raise ParameterError(
            f"speeds_rpm is {speeds.tolist()}, but must be at least {LEAST_NODES} rising values "
            "in rpm, for a cubic spline"
        )
    return speeds


def check_throttles(
    engine: Engine, throttle_range_deg: tuple[float, float] | None
) -> tuple[float, float]:
    """Smallest and largest throttle angle, checked."""
    throttle = engine.throttle
    closed, wide = throttle.closed_deg, throttle.wide_open_deg
    if throttle_range_deg is None:
        return closed + LOWEST_ABOVE_CLOSED_DEG, wide
    low, high = (
        in_range(
            f"throttle_range_deg[{k}]",
            value,
            closed,
            wide,
            "deg",
            open_low=True,
            remedy="Eq. 19 gives no flow below, and wide open is the end",
        )
        for k, value in enumerate(throttle_range_deg)
    )
    if low >= high:
        raise ParameterError(
            f"throttle_range_deg is ({low:g}, {high:g}) deg, but must rise: give the smaller angle "
            "first"
        )
    return low, high


def pressure_shares(points: int) -> FloatArray:
    """Shares of the way from the lowest to the highest pressure, denser towards wide open.

    There the throttle hardly holds the air back, and the pulsation of the pressure changes
    most.
    """
    points = whole("points", points, 2 * LEAST_NODES, 1000)
    return 1.0 - np.linspace(1.0, 0.0, points) ** 2


def identify_nodes(
    plant: CrankAnglePlant,
    cam: ValveCommand,
    speeds_rpm: FloatArray,
    shares: FloatArray,
    throttle_range_deg: tuple[float, float],
    progress: Progress | None,
) -> ThrottledNodes:
    """Simulate the steady cycles at the nodes.

    Scouting cycles tell which angles give the wanted pressures. What these angles give in
    fact lies within about a percent of it, and a spline through them carries it there.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    throttle = plant.engine.throttle
    low, high = throttle_range_deg
    # Even in the logarithm of the area: the pressure follows the area while the flow is choked.
    scouts = angle_of_area(
        plant.engine, np.geomspace(throttle.area(low), throttle.area(high), _SCOUTS)
    )
    scouts[[0, -1]] = low, high
    result = np.empty((5, len(speeds_rpm), len(shares)))
    for i, speed in enumerate(speeds_rpm.tolist()):
        scouted = np.array([SteadyPoint.of(plant, cam, speed, a).pressure for a in scouts.tolist()])
        _check_rising(speed, scouts, scouted)
        wanted = scouted[0] + (scouted[-1] - scouted[0]) * shares
        wanted[-1] = scouted[-1]
        area = PchipInterpolator(scouted, np.log([throttle.area(a) for a in scouts.tolist()]))
        angles = angle_of_area(plant.engine, np.exp(area(wanted)))
        angles[[0, -1]] = low, high
        points = [SteadyPoint.of(plant, cam, speed, a) for a in angles.tolist()]
        pressure = np.array([point.pressure for point in points])
        _check_rising(speed, angles, pressure)
        columns = np.array(
            [
                (np.log(throttle.area(a)), p.charge, p.loss, p.flow_factor)
                for a, p in zip(angles.tolist(), points, strict=True)
            ]
        )
        at = CubicSpline(pressure, columns)(wanted)
        result[0, i] = wanted
        result[1, i] = angle_of_area(plant.engine, np.exp(at[:, 0]))
        result[2:, i] = at[:, 1:].T
        if progress is not None:
            progress(i + 1, len(speeds_rpm))
    result[1, :, 0], result[1, :, -1] = low, high
    return ThrottledNodes(*result)


def angle_of_area(engine: Engine, area: FloatArray) -> FloatArray:
    """Throttle angle in deg that has an effective area in kg/s: Eq. 19, solved for the angle."""
    t = engine.throttle
    root = t.linear**2 - 4.0 * t.quadratic * (t.constant - area / t.scale)
    return (-t.linear + np.sqrt(root)) / (2.0 * t.quadratic)


def _check_rising(speed_rpm: float, throttle_deg: FloatArray, pressure: FloatArray) -> None:
    falls = np.flatnonzero(np.diff(pressure) <= 0.0)
    if falls.size:
        k = int(falls[0])
        raise ParameterError(
            f"the mean manifold pressure falls from {pressure[k]:.1f} to {pressure[k + 1]:.1f} Pa "
            f"when the throttle opens from {throttle_deg[k]:.2f} to {throttle_deg[k + 1]:.2f} deg "
            f"at {speed_rpm:g} rpm, so that it cannot stand for the throttle: narrow "
            "throttle_range_deg"
        )
