"""The conventional engine as a mean-value plant: throttle, manifold and a cam (section 5).

Its charge is ``m = F_conv(p_m, N)``, in contrast to the camless engine's, which does not depend
on the manifold pressure. It is what the camless engine is compared with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._checks import in_range, whole
from ._progress import Progress
from ._throttled_checks import require_cam_driven, require_range
from ._throttled_dynamics import Flows, ThrottledRun, as_nonlinear_system, simulate
from ._throttled_grid import (
    PRESSURES,
    angle_of_area,
    check_speeds,
    check_throttles,
    identify_nodes,
    pressure_shares,
)
from ._throttled_maps import EDGE, PressureMaps
from ._throttled_results import ThrottledMapError, ThrottleInverse, ThrottlePoint
from ._throttled_step import ThrottleStep, throttle_step
from ._throttled_storage import storage_at_nodes
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .orifice import simplified_flow
from .parameters import Engine
from .region import Outside, check_outside
from .valve import ValveCommand

if TYPE_CHECKING:
    import control
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = [
    "ThrottleInverse",
    "ThrottlePoint",
    "ThrottleStep",
    "ThrottledMapError",
    "ThrottledMeanValuePlant",
    "ThrottledRun",
    "throttle_step",
]


@dataclass(frozen=True, eq=False)
class ThrottledMeanValuePlant:
    """Manifold filling of a throttled engine with a cam, identified from the full plant.

    Make one with `fit`. All methods take scalars or arrays that broadcast against each other.

    Attributes
    ----------
    engine : Engine
        Engine that it describes.
    cam : ValveCommand
        Its cam.
    throttle_range_deg : tuple of 2 float
        Smallest and largest throttle angle; they bound the pressures at a speed.
    speeds_rpm : ndarray (n,)
        Nodes of speed.
    shares : ndarray (k,)
        Nodes of the share of the way from the lowest to the highest pressure at a speed.
    pressure : ndarray (n, k)
        Mean manifold pressure at the nodes, averaged over time, Pa.
    throttle_deg : ndarray (n, k)
        Throttle angle that holds it.
    charge : ndarray (n, k)
        Air charge at the nodes, kg per event.
    loss : ndarray (n, k)
        Pumping loss at the nodes, J per event.
    flow_factor : ndarray (n, k)
        Mean throttle flow over that of Eq. 15 at the mean pressure, 1. It is 1 while the flow is
        choked, and less near wide open: the pressure pulsates, and Eq. 14 is concave.
    storage_volume : ndarray (n, k)
        Volume by which the open cylinders add to the manifold while its pressure changes, m3.
    provenance : dict
        Fingerprint and options of the full plant.

    Notes
    -----
    ``dp_m/dt = R T/(V_m + V_s) (k A_phi d(p_m, p_o) - m n N/120)``: Eq. 1 with Eq. 15, averaged
    over an event. The factor ``k`` and the storage ``V_s`` are functions of pressure and speed,
    as the charge ``m`` is; without them the steady pressure is right within 0.5 %, but single
    events of a step are wrong by up to 13 %.
    """

    engine: Engine
    cam: ValveCommand
    throttle_range_deg: tuple[float, float]
    speeds_rpm: FloatArray
    shares: FloatArray
    pressure: FloatArray
    throttle_deg: FloatArray
    charge: FloatArray
    loss: FloatArray
    flow_factor: FloatArray
    storage_volume: FloatArray
    provenance: dict[str, str | float]

    @classmethod
    def fit(
        cls,
        plant: CrankAnglePlant | None = None,
        *,
        cam: ValveCommand | None = None,
        speeds_rpm: Sequence[float] | FloatArray | None = None,
        points: int = PRESSURES,
        throttle_range_deg: tuple[float, float] | None = None,
        progress: Progress | None = None,
    ) -> Self:
        """Identify it from steady cycles and slow ramps of the full plant.

        Parameters
        ----------
        plant : CrankAnglePlant, optional
            Cam-driven full plant; the paper's by default.
        cam : ValveCommand, optional
            The cam; that of section 4 by default.
        speeds_rpm : sequence of float, optional
            Nodes of speed, rising, at least 4; 750 to 6000 rpm by default.
        points : int
            Number of pressures at each speed, at least 8.
        throttle_range_deg : tuple of 2 float, optional
            Smallest and largest throttle angle; by default from 1 deg above the angle at which
            Eq. 19 closes to wide open.
        progress : callable, optional
            Called with the number of speeds done and the number in all.

        Raises
        ------
        ParameterError
            For a camless plant, for grids that are too small, and where the mean pressure does
            not rise with the throttle angle.
        """
        plant = CrankAnglePlant(profile="conventional") if plant is None else plant
        require_cam_driven(plant)
        cam = ValveCommand.conventional() if cam is None else cam
        if not isinstance(cam, ValveCommand):
            raise ParameterError(f"cam is {cam!r}, but must be a ValveCommand")
        speeds = check_speeds(plant.engine, speeds_rpm)
        throttles = check_throttles(plant.engine, throttle_range_deg)
        shares = pressure_shares(points)
        nodes = identify_nodes(plant, cam, speeds, shares, throttles, progress)
        return cls(
            engine=plant.engine,
            cam=cam,
            throttle_range_deg=throttles,
            speeds_rpm=speeds,
            shares=shares,
            pressure=nodes.pressure,
            throttle_deg=nodes.throttle_deg,
            charge=nodes.charge,
            loss=nodes.loss,
            flow_factor=nodes.flow_factor,
            storage_volume=storage_at_nodes(plant, cam, speeds, nodes.pressure, nodes.throttle_deg),
            provenance={
                "plant_fingerprint": plant.fingerprint,
                "runner": str(plant.runner),
                "orifice": plant.orifice,
                "resolution": plant.resolution,
            },
        )

    # -- charge and loss ---------------------------------------------------------------------

    def air_charge(
        self, manifold_pressure: ArrayLike, speed_rpm: ArrayLike, *, outside: Outside = "raise"
    ) -> FloatArray:
        """Air charge ``F_conv(p_m, N)`` in kg per event (section 5).

        Parameters
        ----------
        manifold_pressure : array_like
            Mean manifold pressure, Pa.
        speed_rpm : array_like
            Speed.
        outside : {"raise", "nan"}
            What to do outside the identified range.

        Raises
        ------
        ParameterError
            For a point outside the range, naming value and limit.
        """
        return self._evaluate("charge", manifold_pressure, speed_rpm, outside)

    def pumping_loss(
        self, manifold_pressure: ArrayLike, speed_rpm: ArrayLike, *, outside: Outside = "raise"
    ) -> FloatArray:
        """Pumping loss in J per event. Arguments as for `air_charge`."""
        return self._evaluate("loss", manifold_pressure, speed_rpm, outside)

    def pressure_range(self, speed_rpm: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest mean manifold pressure in Pa that were identified at speeds."""
        speed = np.asarray(speed_rpm, dtype=float)
        self._require_speed(speed)
        ends = self._maps.ends(speed)
        return ends[..., 0][()], ends[..., 1][()]

    # -- steady state ------------------------------------------------------------------------

    def steady_pressure(self, throttle_deg: ArrayLike, speed_rpm: ArrayLike) -> FloatArray:
        """Manifold pressure in Pa at which throttle flow and charge flow are equal.

        Raises
        ------
        ParameterError
            For an angle or a speed outside the identified range.
        """
        angle, speed = np.broadcast_arrays(
            np.asarray(throttle_deg, dtype=float), np.asarray(speed_rpm, dtype=float)
        )
        low, high = self.throttle_range_deg
        require_range(
            "throttle_deg", angle, low, high, "deg", "fit with a wider throttle_range_deg"
        )
        self._require_speed(speed)
        # The ends of the range are interpolated in speed; the balance may lie a hair beyond them.
        below, above = np.full(angle.shape, -10.0 * EDGE), np.full(angle.shape, 1.0 + 10.0 * EDGE)
        for _ in range(52):
            middle = 0.5 * (below + above)
            rises = self.flows(self._maps.pressure_at(middle, speed), angle, speed).rate > 0.0
            below, above = np.where(rises, middle, below), np.where(rises, above, middle)
        return self._maps.pressure_at(0.5 * (below + above), speed)[()]

    def throttle_for_charge(self, charge: ArrayLike, speed_rpm: ArrayLike) -> ThrottleInverse:
        """Throttle angle that gives a charge (kg), its manifold pressure and its pumping loss.

        Raises
        ------
        ParameterError
            If a charge is not a number, or a speed out of range. A charge out of reach is no
            error: the result tells.
        """
        wanted, speed = np.broadcast_arrays(
            np.asarray(charge, dtype=float), np.asarray(speed_rpm, dtype=float)
        )
        if not np.all(np.isfinite(wanted)):
            raise ParameterError("a charge is not finite: give charges in kg per event")
        self._require_speed(speed)
        shape = wanted.shape
        m, n = wanted.ravel(), speed.ravel()
        rise = self._maps.first_rise("charge", m, n)
        share = np.where(rise.found, rise.share, 0.5)
        pressure = self._maps.pressure_at(share, n)
        passes = self._maps.held("flow_factor", share, n) * simplified_flow(
            pressure, self.engine.ambient_pressure
        )
        angle = angle_of_area(self.engine, m * self._events_per_second(n) / passes)
        # At the ends of the range the angle is that of the fit up to the error in speed.
        angle = np.minimum(
            np.maximum(angle, self.throttle_range_deg[0]), self.throttle_range_deg[1]
        )
        values = angle, pressure, self._maps.held("loss", share, n)
        angle, pressure, loss = (np.where(rise.found, x, np.nan).reshape(shape)[()] for x in values)
        return ThrottleInverse(
            throttle_deg=angle,
            manifold_pressure=pressure,
            pumping_loss=loss,
            reachable=rise.found.reshape(shape)[()],
            charge=wanted[()],
            lowest_charge=rise.lowest.reshape(shape)[()],
            highest_charge=rise.highest.reshape(shape)[()],
        )

    # -- dynamics ----------------------------------------------------------------------------

    def flows(
        self, manifold_pressure: ArrayLike, throttle_deg: ArrayLike, speed_rpm: ArrayLike
    ) -> Flows:
        """Flows into and out of the manifold, kg/s, and the rate of its pressure, Pa/s.

        Beyond the identified pressures the charge goes on along its tangent; the factor of the
        throttle flow and the storage are held. Nothing is checked here.
        """
        e, maps = self.engine, self._maps
        p, angle, n = (np.asarray(x, float) for x in (manifold_pressure, throttle_deg, speed_rpm))
        share = maps.share(p, n)
        t = e.throttle
        area = t.scale * (t.constant + t.linear * angle + t.quadratic * angle**2)  # Eq. 19
        # A trial step of a solver may go below zero; the flow is choked long before.
        passes = simplified_flow(np.maximum(p, 1.0), e.ambient_pressure)
        throttle = maps.held("flow_factor", share, n) * area * passes
        charge = maps.extended("charge", share, n)
        volume = e.manifold_volume + maps.held("storage_volume", share, n)
        gas = e.gas_constant * e.temperature
        rate = gas / volume * (throttle - charge * self._events_per_second(n))
        return Flows(throttle, throttle - e.manifold_volume / gas * rate, charge, rate, share)

    def simulate(
        self,
        time: ArrayLike,
        throttle_deg: ArrayLike,
        speed_rpm: ArrayLike,
        initial_pressure: float | None = None,
    ) -> ThrottledRun:
        """Simulate the manifold pressure.

        Parameters
        ----------
        time : array_like (m,)
            Times, s, not falling; a repeated time is a jump of the inputs.
        throttle_deg, speed_rpm : array_like (m,) or scalar
            Inputs at these times, linear between them.
        initial_pressure : float, optional
            Manifold pressure at the first time, Pa; that of the steady state by default.

        Raises
        ------
        ParameterError
            For an angle or a speed outside the identified range, and for times that fall.
        """
        return simulate(self, time, throttle_deg, speed_rpm, initial_pressure)

    def as_nonlinear_system(self, name: str = "throttled") -> control.NonlinearIOSystem:
        """Return it as a continuous-time system of python-control.

        Inputs ``throttle_deg`` and ``speed_rpm``; state ``manifold_pressure`` in Pa; outputs
        ``manifold_pressure`` in Pa, ``throttle_flow`` and ``cylinder_flow`` in kg/s, and
        ``air_charge`` in kg per event, without the delay from intake to power.
        """
        return as_nonlinear_system(self, name)

    # -- check, data, pictures ---------------------------------------------------------------

    def error_against(
        self,
        plant: CrankAnglePlant,
        *,
        samples: int = 400,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> ThrottledMapError:
        """Compare it with steady cycles of a full plant at random points between the nodes.

        Parameters
        ----------
        plant : CrankAnglePlant
            Cam-driven full plant; the one that was fitted, or another.
        samples, seed : int
            Number of points, uniform in speed and in the share of the way through the
            pressures, and the seed that draws them.
        progress : callable, optional
            Called with the number of points done and the number in all.
        """
        from ._throttled_error import error_against

        require_cam_driven(plant)
        whole("samples", samples, 1, 10_000_000)
        return error_against(self, plant, samples, seed, progress)

    def to_dataset(self) -> xr.Dataset:
        """Return the nodes as an `xarray.Dataset` with units and provenance."""
        from ._throttled_data import to_dataset

        return to_dataset(self)

    def plot(self, speeds_rpm: Sequence[float] = (1000.0, 2000.0, 4000.0, 6000.0)) -> Figure:
        """Draw charge and pumping loss against manifold pressure at some speeds."""
        from ._throttled_plots import plot_maps

        return plot_maps(self, speeds_rpm)

    def __str__(self) -> str:
        """Return what it covers and comes from."""
        n, k = self.charge.shape
        low, high = self.throttle_range_deg
        return (
            f"throttled mean-value plant: {n * k} nodes ({n} speeds {self.speeds_rpm[0]:g} to "
            f"{self.speeds_rpm[-1]:g} rpm, {k} pressures at throttle angles of {low:.2f} to "
            f"{high:g} deg), cam {self.cam.lift_mm:g} mm from {self.cam.opening_deg:g} to "
            f"{self.cam.closing_deg:g} deg, of the full plant "
            f"{self.provenance['plant_fingerprint']} (runner {self.provenance['runner']})"
        )

    __repr__ = __str__

    # -- for the modules beside this one -----------------------------------------------------

    def inside(self, share: FloatArray) -> NDArray[np.bool_]:
        """Whether shares of the way through the pressures are in the identified range."""
        return (share >= -EDGE) & (share <= 1.0 + EDGE)

    def require_inputs(self, throttle_deg: ArrayLike, speed_rpm: ArrayLike) -> None:
        """Check that the throttle lets air through, and that the speeds were identified.

        Any such angle will do: between the identified pressures its flow is that of Eq. 15.
        """
        t = self.engine.throttle
        remedy = "Eq. 19 gives no flow below, and wide open is the end"
        require_range("throttle_deg", throttle_deg, t.closed_deg, t.wide_open_deg, "deg", remedy)
        self._require_speed(speed_rpm)

    # -- internals ---------------------------------------------------------------------------

    @cached_property
    def _maps(self) -> PressureMaps:
        values = {
            "charge": self.charge,
            "loss": self.loss,
            "flow_factor": self.flow_factor,
            "storage_volume": self.storage_volume,
        }
        return PressureMaps(self.speeds_rpm, self.shares, self.pressure, values)

    def _events_per_second(self, speed_rpm: FloatArray) -> FloatArray:
        return self.engine.n_cylinders * speed_rpm / 120.0

    def _require_speed(self, speed_rpm: ArrayLike) -> None:
        low, high = float(self.speeds_rpm[0]), float(self.speeds_rpm[-1])
        require_range("speed_rpm", speed_rpm, low, high, "rpm", "fit with other speeds_rpm")

    def _evaluate(
        self, name: str, manifold_pressure: ArrayLike, speed_rpm: ArrayLike, outside: Outside
    ) -> FloatArray:
        allowed = check_outside(outside)
        p, speed = np.broadcast_arrays(
            np.asarray(manifold_pressure, dtype=float), np.asarray(speed_rpm, dtype=float)
        )
        if not allowed:
            self._require_speed(speed)
        known = (speed >= self.speeds_rpm[0]) & (speed <= self.speeds_rpm[-1])
        n = np.where(known, speed, self.speeds_rpm[0])
        share = self._maps.share(p, n)
        inside = known & self.inside(share)
        if not allowed and not inside.all():
            k = tuple(int(i) for i in np.argwhere(~inside)[0])
            low, high = self._maps.ends(n[k])
            at = f" (element {', '.join(map(str, k))})" if p.size > 1 else ""
            in_range(
                f"manifold_pressure at {speed[k]:g} rpm{at}",
                float(p[k]),
                round(float(low), 1),
                round(float(high), 1),
                "Pa",
                remedy=f"no throttle angle of {self.throttle_range_deg[0]:.2f} to "
                f"{self.throttle_range_deg[1]:g} deg holds it",
            )
        value = self._maps.held(name, np.where(inside, share, 0.5), n)
        return np.where(inside, value, np.nan)[()]
