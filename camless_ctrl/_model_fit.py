"""Making of the charge model's table from steady cycles of the full plant.

Every node is simulated with the path's command delivered exactly: nominal, with the flow
coefficient of all cylinders or of the throttle scaled, with other durations and with lower lifts.
The shares of the inflow vary little with speed and are taken at fewer speeds. Private to
`charge_model`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant.kinematics import FloatArray
from plant.region import shortest_deg
from plant.sweep import Progress

from ._model_table import HIGHEST_GAIN, LOWEST_GAIN, MOST_DROP_MM, ModelTable, MotionPath
from .event_data import EVENTS, PARTS
from .inflow_shares import inflow_share_slopes, inflow_shares

if TYPE_CHECKING:
    import xarray as xr

_GAINS = 9  # simulated at each node, the nominal one apart
_DENSITIES = (0.55, 0.75, 1.25)  # by which the throttle's coefficient is divided, 1
_STEP_DEG = 1.0  # of duration, for its slope: a small part of a runner's oscillation
_DROPS = (0.25, 0.6, 1.0)  # shares of the most lift taken off that are simulated
_SLOPE_NODES = 15  # of the slopes of the shares, at most, in speed and along the path
_SHARE_SPEEDS = 57  # speeds of the shares, at most; they vary much along the path only


class _Simulation:
    """Steady cycles with a running count."""

    def __init__(
        self, plant: CrankAnglePlant, total: int, threads: int, progress: Progress | None
    ) -> None:
        self.plant, self.total, self.threads, self.progress = plant, total, threads, progress
        self.done = 0

    def cycles(
        self,
        speed: FloatArray,
        lift: FloatArray,
        duration_deg: FloatArray,
        gain: ArrayLike = 1.0,
        throttle_gain: ArrayLike = 1.0,
    ) -> xr.Dataset:
        """Simulate cycles, averaged over the cylinders."""
        before = self.done

        def tell(k: int, _: int) -> None:
            self.done = before + k
            if self.progress is not None:
                self.progress(self.done, self.total)

        engine = self.plant.engine
        scaled = {
            "flow_coefficient": engine.flow_coefficient * np.asarray(gain),
            "throttle.scale": engine.throttle.scale * np.asarray(throttle_gain),
        }
        return self.plant.steady_cycles(
            speed,
            lift,
            duration_deg,
            parameters=scaled,
            per_cylinder=False,
            threads=self.threads,
            progress=tell,
        )


def build_table(
    path: MotionPath,
    plant: CrankAnglePlant,
    speeds_rpm: FloatArray,
    positions: FloatArray,
    threads: int,
    progress: Progress | None,
) -> ModelTable:
    """Simulate all nodes.

    Raises
    ------
    ParameterError
        If a charge of the path is not above zero, or its motion cannot be driven.
    """
    speed = np.broadcast_to(speeds_rpm[:, None], (speeds_rpm.size, positions.size))
    point = path.at(positions, speeds_rpm[:, None])
    lift = np.broadcast_to(np.asarray(point.lift_mm, dtype=float), speed.shape)
    degrees = np.broadcast_to(np.asarray(point.duration_deg, dtype=float), speed.shape)
    shortest = shortest_deg(lift, speed, plant.engine.valvetrain)
    # Rounding may not make a motion infeasible; what is shorter by more is left to the plant.
    degrees = np.where(degrees < (1.0 - 1e-6) * shortest, degrees, np.maximum(degrees, shortest))
    n = speeds_rpm.size
    rows = np.unique(np.linspace(0, n - 1, min(n, _SHARE_SPEEDS)).round().astype(int))
    each = 1 + _GAINS + 3 + len(_DROPS) + len(_DENSITIES)
    total = each * speed.size + rows.size * positions.size
    total += 2 * _coarse(speed.shape[0]).size * _coarse(speed.shape[1]).size
    simulation = _Simulation(plant, total, threads, progress)
    nominal = simulation.cycles(speed, lift, degrees)
    charge = nominal["air_charge"].values
    lowest = np.unravel_index(int(np.argmin(charge)), charge.shape)
    if not charge[lowest] > 0.0:
        raise ParameterError(
            f"the full plant takes in {1e6 * charge[lowest]:.2f} mg at {speed[lowest]:.0f} rpm, "
            f"lift {lift[lowest]:.2f} mm, duration {degrees[lowest]:.1f} deg, but the charge must "
            "be above 0 mg on the whole path: start the path at a larger charge"
        )
    flow, wide, narrow = _flow_response(simulation, speed, lift, degrees, charge)
    return ModelTable(
        charge=charge,
        lift_mm=np.array(lift),
        duration=degrees / (6.0 * speed),
        loss=nominal["pumping_loss"].values,
        duration_slope=_duration_slope(simulation, speed, lift, degrees, shortest),
        flow_response=flow,
        lift_response=_lift_response(simulation, speed, lift, degrees, charge),
        throttle_response=_throttle_response(simulation, speed, lift, degrees, charge),
        shares=_shares(simulation, speeds_rpm, lift, degrees, rows),
        share_slopes=_share_slopes(simulation, speeds_rpm, lift, degrees),
        flow_residual=wide,
        narrow_residual=narrow,
        cycles=simulation.done,
    )


def _flow_response(
    simulation: _Simulation,
    speed: FloatArray,
    lift: FloatArray,
    degrees: FloatArray,
    charge: FloatArray,
) -> tuple[FloatArray, float, float]:
    """Fit ln m by powers of ln g, and tell the residuals over all gains and within 20 %."""
    gains = np.geomspace(LOWEST_GAIN, HIGHEST_GAIN, _GAINS)
    found = simulation.cycles(speed, lift, degrees, gains[:, None, None])["air_charge"].values
    for k, i, j in np.argwhere(~(found > 0.0))[:1]:
        raise ParameterError(
            f"with {gains[k]:.2f} times the flow coefficient the full plant takes in "
            f"{1e6 * found[k, i, j]:.2f} mg at {speed[i, j]:.0f} rpm, lift {lift[i, j]:.2f} mm, "
            f"duration {degrees[i, j]:.1f} deg, but the charge must be above 0 mg: start the path "
            "at a larger charge"
        )
    x = np.log(gains)
    powers = np.stack([x**k for k in (1, 2, 3, 4)], axis=1)
    # Where controllers are, near 1, the fit shall be close.
    weight = np.where(np.abs(x) < 0.25, 3.0, 1.0)[:, None]
    wanted = np.log(found / charge).reshape(gains.size, -1)
    fitted = np.linalg.lstsq(weight * powers, weight * wanted, rcond=None)[0]
    residual = np.abs(powers @ fitted - wanted).max(axis=1)
    near = (gains >= 0.8 - 1e-9) & (gains <= 1.2 + 1e-9)
    return fitted.T.reshape(*charge.shape, 4), float(residual.max()), float(residual[near].max())


def _duration_slope(
    simulation: _Simulation,
    speed: FloatArray,
    lift: FloatArray,
    degrees: FloatArray,
    shortest: FloatArray,
) -> FloatArray:
    """Slope of ln m over duration in 1/s, by a parabola through three durations."""
    first = np.maximum(degrees - _STEP_DEG, shortest)
    durations = np.stack([first, first + _STEP_DEG, first + 2.0 * _STEP_DEG])
    charges = simulation.cycles(speed, lift, durations)["air_charge"].values
    y = np.log(charges)
    t = (degrees - durations[1]) / _STEP_DEG
    per_step = 0.5 * (y[2] - y[0]) + t * (y[2] - 2.0 * y[1] + y[0])
    return per_step / _STEP_DEG * 6.0 * speed


def _lift_response(
    simulation: _Simulation,
    speed: FloatArray,
    lift: FloatArray,
    degrees: FloatArray,
    charge: FloatArray,
) -> FloatArray:
    """Fit ln m by powers 1 and 2 of the lift that is taken off, mm."""
    lowest = simulation.plant.engine.valvetrain.lowest_lift_mm
    most = np.minimum(MOST_DROP_MM, np.maximum(lift - lowest, 0.0))
    drops = np.asarray(_DROPS)[:, None, None] * most
    found = simulation.cycles(speed, lift - drops, degrees)["air_charge"].values
    # A parabola through the origin by least squares, in shares of the most lift.
    z = np.asarray(_DROPS)
    # The charge may vanish with the lift: then the smaller drops alone count.
    y = np.log(np.maximum(found, 1e-3 * charge) / charge).reshape(z.size, -1)
    by_share = np.linalg.lstsq(np.stack([z, z * z], axis=1), y, rcond=None)[0]
    scale = np.where(most > 0.0, most, np.inf)
    first, second = by_share.reshape(2, *charge.shape)
    return np.stack([first / scale, second / scale**2], axis=-1)


def _throttle_response(
    simulation: _Simulation,
    speed: FloatArray,
    lift: FloatArray,
    degrees: FloatArray,
    charge: FloatArray,
) -> FloatArray:
    """Fit ln m by powers 1 and 2 of the ln of the throttle's gain."""
    gains = 1.0 / np.asarray(_DENSITIES)
    found = simulation.cycles(speed, lift, degrees, throttle_gain=gains[:, None, None])
    x = np.log(gains)
    y = np.log(found["air_charge"].values / charge).reshape(x.size, -1)
    fitted = np.linalg.lstsq(np.stack([x, x * x], axis=1), y, rcond=None)[0]
    return fitted.T.reshape(*charge.shape, 2)


def _shares(
    simulation: _Simulation,
    speeds_rpm: FloatArray,
    lift: FloatArray,
    degrees: FloatArray,
    rows: np.ndarray,
) -> FloatArray:
    """Shares of the inflow at some rows of nodes, splined over speed to all."""
    from scipy.interpolate import make_interp_spline

    known = np.empty((rows.size, lift.shape[1], EVENTS * PARTS))
    for a, i in enumerate(rows):
        for j in range(lift.shape[1]):
            command = ValveCommand(float(lift[i, j]), float(degrees[i, j]))
            known[a, j] = inflow_shares(simulation.plant, command, float(speeds_rpm[i]))
            simulation.done += 1
        if simulation.progress is not None:
            simulation.progress(simulation.done, simulation.total)
    # A spline is linear in the values: the shares go on summing to 1.
    shares: FloatArray = make_interp_spline(rows, known, k=3, axis=0)(np.arange(lift.shape[0]))
    return shares


def _coarse(nodes: int) -> np.ndarray:
    """Some of the nodes, evenly, both ends among them."""
    return np.unique(np.round(np.linspace(0, nodes - 1, min(_SLOPE_NODES, nodes))).astype(int))


def _share_slopes(
    simulation: _Simulation, speeds_rpm: FloatArray, lift: FloatArray, degrees: FloatArray
) -> FloatArray:
    """How the shares change with the ln of the flow gain, splined from a few nodes to all."""
    from scipy.interpolate import make_interp_spline

    rows, places = _coarse(lift.shape[0]), _coarse(lift.shape[1])
    known = np.empty((rows.size, places.size, EVENTS * PARTS))
    for a, i in enumerate(rows):
        for b, j in enumerate(places):
            command = ValveCommand(float(lift[i, j]), float(degrees[i, j]))
            known[a, b] = inflow_share_slopes(simulation.plant, command, float(speeds_rpm[i]))
            simulation.done += 2
        if simulation.progress is not None:
            simulation.progress(simulation.done, simulation.total)
    # Linear in the values: the slopes go on summing to 0.
    for axis, nodes, size in ((0, rows, lift.shape[0]), (1, places, lift.shape[1])):
        degree = min(3, nodes.size - 1)
        known = make_interp_spline(nodes, known, k=degree, axis=axis)(np.arange(size))
    return known
