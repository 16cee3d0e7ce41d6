"""The mean-value plant of section 5: air charge and pumping loss as maps (Eq. 18).

``m = F_m(u_l, u_d, N)`` and ``e = F_e(u_l, u_d, N)`` for unthrottled operation and opening at
TDC, read from the steady cycles of the crank-angle plant. The maps cover the whole feasible
region (`OperatingRegion`) and nothing else: outside they refuse, or give NaN on request.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from ._map_grid import LONGEST_DEG, POINTS, map_grid, provenance
from ._map_regions import SATURATION_SHARE, duration_for_charge, lift_saturation
from ._surface import Lines, Surface
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import ChargeInverse, MapError, MapGradient
from .parameters import Engine
from .region import OperatingPoint, OperatingRegion, Outside, check_outside
from .sweep import Progress, sweep

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class MeanValuePlant:
    """Air charge and pumping loss of one intake event against lift, duration and speed.

    Make one with `fit`. All methods take scalars or arrays that broadcast against each other.

    Attributes
    ----------
    engine : Engine
        Engine that the maps belong to.
    region : OperatingRegion
        Where they hold.
    speeds_rpm : ndarray (n,)
        Nodes of speed.
    lifts_mm : ndarray (m,)
        Nodes of lift.
    shares : ndarray (k,)
        Nodes of the share of the way from the shortest to the longest duration.
    charge : ndarray (n, m, k)
        Air charge at the nodes, kg per event.
    loss : ndarray (n, m, k)
        Pumping loss at the nodes, J per event.
    provenance : dict
        Fingerprint and options of the full plant, version of the package, opening and throttle
        angle.

    Notes
    -----
    Cubic splines (C2) in ``1/speed``, the logarithm of lift, and the share. The maps pass
    through every node. At the runner's break points (1500 and 3000 rpm) the full plant has a
    kink in speed, which the spline rounds.
    """

    engine: Engine
    region: OperatingRegion
    speeds_rpm: FloatArray
    lifts_mm: FloatArray
    shares: FloatArray
    charge: FloatArray
    loss: FloatArray
    provenance: dict[str, str | float | int]

    @classmethod
    def fit(
        cls,
        plant: CrankAnglePlant | None = None,
        *,
        speeds_rpm: Sequence[float] | FloatArray | None = None,
        points: tuple[int, int] = POINTS,
        lift_range_mm: tuple[float, float] | None = None,
        longest_deg: float = LONGEST_DEG,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> Self:
        """Build the maps from steady cycles of the full plant.

        Parameters
        ----------
        plant : CrankAnglePlant, optional
            Camless full plant; the paper's by default.
        speeds_rpm : sequence of float, optional
            Nodes of speed, rising, at least 4; `default_speeds` of 750 to 6000 rpm by default.
        points : tuple of 2 int
            Number of lifts and of durations, at least 4 each.
        lift_range_mm : tuple of 2 float, optional
            Lowest and highest lift; 0.5 to 8 mm within the valvetrain's limits by default.
        longest_deg : float
            Longest duration.
        threads : int
            Threads to simulate on.
        progress : callable, optional
            Called with the number of cycles done and the number in all.

        Raises
        ------
        ParameterError
            For a cam-driven plant, and for grids that are too small or not feasible.
        """
        plant = CrankAnglePlant() if plant is None else plant
        if plant.profile != "camless":
            raise ParameterError(
                f"the plant's profile is {plant.profile!r}, but must be 'camless': a cam leaves "
                "no lift and duration to choose"
            )
        region, speeds, lifts, shares = map_grid(
            plant.engine, speeds_rpm, points, lift_range_mm, longest_deg
        )
        speed, lift, share = np.meshgrid(speeds, lifts, shares, indexing="ij")
        duration = region.duration_deg(lift, share, speed)
        values = sweep(plant, speed, lift, duration, threads=threads, progress=progress)
        return cls(
            plant.engine,
            region,
            speeds,
            lifts,
            shares,
            values.air_charge,
            values.pumping_loss,
            provenance(plant),
        )

    # -- evaluation --------------------------------------------------------------------------

    def air_charge(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        outside: Outside = "raise",
    ) -> FloatArray:
        """Air charge ``F_m`` in kg per event (Eq. 18).

        Parameters
        ----------
        lift_mm, duration_deg, speed_rpm : array_like
            Operating points.
        outside : {"raise", "nan"}
            What to do outside the feasible region.

        Raises
        ------
        ParameterError, InfeasibleProfileError
            For a point outside the region, naming value and limit.
        """
        return self._evaluate(self._charge, lift_mm, duration_deg, speed_rpm, outside)

    def pumping_loss(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        outside: Outside = "raise",
    ) -> FloatArray:
        """Pumping loss ``F_e`` in J per event (Eq. 18). Arguments as for `air_charge`."""
        return self._evaluate(self._loss, lift_mm, duration_deg, speed_rpm, outside)

    def charge_gradient(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        outside: Outside = "raise",
    ) -> MapGradient:
        """Derivatives of the air charge, exact for the spline. Arguments as for `air_charge`."""
        return self._gradient(self._charge, lift_mm, duration_deg, speed_rpm, outside)

    def loss_gradient(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        outside: Outside = "raise",
    ) -> MapGradient:
        """Derivatives of the pumping loss, exact for the spline. Arguments as for `air_charge`."""
        return self._gradient(self._loss, lift_mm, duration_deg, speed_rpm, outside)

    # -- inverse and regions -----------------------------------------------------------------

    def duration_for_charge(
        self, charge: ArrayLike, lift_mm: ArrayLike, speed_rpm: ArrayLike
    ) -> ChargeInverse:
        """Shortest duration that gives a charge (kg), on the early-closing branch.

        The branch goes from the shortest duration to that of the largest charge, at which flow
        reversal sets in. Where the runner makes the charge rise in waves, the first rise
        through the wanted charge counts.

        Raises
        ------
        ParameterError
            If a charge is not a number, or lift or speed out of the map's range. A charge out
            of reach is no error: the result tells.
        """
        return duration_for_charge(self, charge, lift_mm, speed_rpm)

    def flow_reversal(self, speed_rpm: ArrayLike, lift_mm: ArrayLike) -> FloatArray:
        """Duration in deg of the largest charge, beyond which flow reverses (section 5).

        NaN where the charge still rises at the longest duration.
        """
        speed, lift = np.broadcast_arrays(
            np.asarray(speed_rpm, dtype=float), np.asarray(lift_mm, dtype=float)
        )
        at = self.charge_lines(lift.ravel(), speed.ravel()).peak().at
        duration = self.region.duration_deg(lift.ravel(), at, speed.ravel())
        return np.where(at < 1.0, duration, np.nan).reshape(speed.shape)[()]

    def lift_saturation(
        self,
        speed_rpm: ArrayLike,
        *,
        duration_deg: float | None = 180.0,
        share: float = SATURATION_SHARE,
    ) -> FloatArray:
        """Lift in mm from which on the charge is nearly that of the highest lift (section 5).

        Parameters
        ----------
        speed_rpm : array_like
            Speeds.
        duration_deg : float or None
            Duration to compare at; None takes, at each lift, the one of the largest charge.
        share : float
            Share of the charge at the highest lift that counts as nearly.
        """
        return lift_saturation(self, speed_rpm, duration_deg, share)

    def largest_charge(self, speed_rpm: ArrayLike) -> FloatArray:
        """Largest charge at a speed over all lifts and durations, kg per event."""
        speeds = np.asarray(speed_rpm, dtype=float)
        self._require(self.region.highest_lift_mm, speeds)
        # Lifts of the nodes and between them; the charge is flat in lift where it is largest.
        lifts = np.geomspace(self.lifts_mm[0], self.lifts_mm[-1], 3 * len(self.lifts_mm))
        lifts[[0, -1]] = self.lifts_mm[[0, -1]]
        lift, speed = np.meshgrid(lifts, speeds.ravel())
        peak = self.charge_lines(lift.ravel(), speed.ravel()).peak()
        return peak.value.reshape(lift.shape).max(axis=1).reshape(speeds.shape)[()]

    # -- check, data, pictures ---------------------------------------------------------------

    def error_against(
        self,
        plant: CrankAnglePlant,
        *,
        samples: int = 1000,
        seed: int = 0,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> MapError:
        """Compare the maps with a full plant at random points between the nodes.

        Parameters
        ----------
        plant : CrankAnglePlant
            Full plant; the one that was fitted, or another to see what the maps ignore.
        samples, seed : int
            Number of points, uniform in speed, lift and share, and the seed that draws them.

        Returns
        -------
        MapError
            Map less plant, relative to the largest charge and loss at the point's speed.
        """
        lift, duration, speed = self.region.sample(samples, seed)
        truth = sweep(plant, speed, lift, duration, threads=threads, progress=progress)
        charge = self.air_charge(lift, duration, speed) - truth.air_charge
        loss = self.pumping_loss(lift, duration, speed) - truth.pumping_loss
        charge = charge / self.largest_charge(speed)
        loss = loss / self._largest_loss(speed)
        worst = [int(np.argmax(np.abs(error))) for error in (charge, loss)]
        points = [OperatingPoint(speed[k], lift[k], duration[k]) for k in worst]
        return MapError(
            charge_rms=float(np.sqrt(np.mean(charge**2))),
            charge_max=float(np.abs(charge[worst[0]])),
            loss_rms=float(np.sqrt(np.mean(loss**2))),
            loss_max=float(np.abs(loss[worst[1]])),
            worst_charge=points[0],
            worst_loss=points[1],
            points=samples,
            seed=seed,
            same_plant=plant.fingerprint == self.provenance["plant_fingerprint"],
        )

    def to_dataset(self) -> xr.Dataset:
        """Return the nodes as an `xarray.Dataset` with units and provenance."""
        from ._map_data import to_dataset

        return to_dataset(self)

    def plot_charge(self, speed_rpm: float, ax: Axes | None = None) -> Axes:
        """Draw contours of the air charge over duration and lift (Figure 9); return the axes."""
        from ._map_plots import contours

        return contours(self, "charge", speed_rpm, ax)

    def plot_loss(self, speed_rpm: float, ax: Axes | None = None) -> Axes:
        """Draw contours of the pumping loss over duration and lift (Figure 10)."""
        from ._map_plots import contours

        return contours(self, "loss", speed_rpm, ax)

    def __str__(self) -> str:
        """Return what the maps cover and come from."""
        n, m, k = self.charge.shape
        r, p = self.region, self.provenance
        return (
            f"mean-value plant: {self.charge.size} nodes ({n} speeds {r.lowest_speed_rpm:g} to "
            f"{r.highest_speed_rpm:g} rpm, {m} lifts {r.lowest_lift_mm:g} to "
            f"{r.highest_lift_mm:g} mm, {k} durations from the shortest to {r.longest_deg:g} deg) "
            f"of the full plant {p['plant_fingerprint']} (runner {p['runner']}, oscillation "
            f"{p['oscillation']})"
        )

    __repr__ = __str__

    # -- internals ---------------------------------------------------------------------------

    @cached_property
    def _charge(self) -> Surface:
        return Surface(self._nodes, self.charge)

    @cached_property
    def _loss(self) -> Surface:
        return Surface(self._nodes, self.loss)

    @property
    def _nodes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self._slowness(self.speeds_rpm), np.log(self.lifts_mm), self.shares

    def _slowness(self, speed_rpm: FloatArray) -> FloatArray:
        """Coordinate of speed, rising: ``-N_low/N``, 1."""
        return -self.region.lowest_speed_rpm / speed_rpm

    def _evaluate(
        self,
        surface: Surface,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        outside: Outside,
    ) -> FloatArray:
        lift, duration, speed, inside = self._inside(lift_mm, duration_deg, speed_rpm, outside)
        share = np.clip(self.region.share(lift, duration, speed).value, 0.0, 1.0)
        value = surface(self._slowness(speed), np.log(lift), share)
        return np.where(inside, value, np.nan)[()]

    def _gradient(
        self,
        surface: Surface,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        outside: Outside,
    ) -> MapGradient:
        lift, duration, speed, inside = self._inside(lift_mm, duration_deg, speed_rpm, outside)
        share = self.region.share(lift, duration, speed)
        x = self._slowness(speed), np.log(lift), np.clip(share.value, 0.0, 1.0)
        by_share = surface(*x, by=2)
        derivatives = (
            surface(*x, by=1) / lift + by_share * share.by_lift,
            by_share * share.by_duration,
            surface(*x, by=0) * -x[0] / speed + by_share * share.by_speed,
        )
        return MapGradient(*(np.where(inside, d, np.nan)[()] for d in derivatives))

    def _inside(
        self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike, outside: Outside
    ) -> tuple[FloatArray, FloatArray, FloatArray, np.ndarray]:
        """Broadcast points, with a feasible stand-in for those outside, and which are inside."""
        allowed = check_outside(outside)
        if not allowed:
            self.region.require(lift_mm, duration_deg, speed_rpm)
        inside = self.region.feasible(lift_mm, duration_deg, speed_rpm)
        r = self.region
        lift, duration, speed = (
            np.where(inside, value, stand_in)
            for value, stand_in in (
                (lift_mm, r.lowest_lift_mm),
                (duration_deg, r.longest_deg),
                (speed_rpm, r.lowest_speed_rpm),
            )
        )
        return lift, duration, speed, inside

    def _require(self, lift_mm: ArrayLike, speed_rpm: ArrayLike) -> None:
        # The longest duration is feasible at every lift and speed of the region.
        self.region.require(lift_mm, self.region.longest_deg, speed_rpm)

    def charge_lines(self, lift: FloatArray, speed: FloatArray) -> Lines:
        """Charge along the share at `p` pairs of lift and speed."""
        self._require(lift, speed)
        return self._charge.lines(self._slowness(speed), np.log(lift))

    def _largest_loss(self, speed_rpm: FloatArray) -> FloatArray:
        """Largest pumping loss at each speed over the nodes' lifts and all durations, J."""
        lift, speed = np.meshgrid(self.lifts_mm, speed_rpm)
        lines = self._loss.lines(self._slowness(speed.ravel()), np.log(lift.ravel()))
        return lines.peak().value.reshape(lift.shape).max(axis=1)
