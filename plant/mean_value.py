"""The mean-value plant of section 5: air charge and pumping loss as maps (Eq. 18).

``m = F_m(u_l, u_d, N)`` and ``e = F_e(u_l, u_d, N)`` for unthrottled operation and opening at
TDC, read from the steady cycles of the crank-angle plant. The maps cover the whole feasible
region (`OperatingRegion`) and nothing else: outside they refuse, or give NaN on request.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from ._boundary_correction import RANGES
from ._checks import broadcast
from ._map_evaluation import MapEvaluation
from ._map_grid import (
    LONGEST_DEG,
    MOST_POINTS,
    SPEED_RANGE_RPM,
    TOLERANCE,
    BoxCoordinates,
    check_refinement,
    map_region,
    provenance,
)
from ._map_refinement import refined_grid
from ._map_regions import SATURATION_SHARE, duration_for_charge, lift_saturation
from .boundary import BoundaryConditions
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import ChargeInverse, MapError
from .parameters import Engine
from .sweep import Progress, sweep

if TYPE_CHECKING:
    import os

    import casadi
    import control
    import xarray as xr
    from matplotlib.axes import Axes

    from ._map_plots import Kind, Quantity
    from .map_error import MapDerivativeError, MapErrorField
    from .map_regions import MapRegions
    from .mean_value_dynamics import MeanValueDynamics
    from .valve import ValveCommand


@dataclass(frozen=True, eq=False, repr=False)
class MeanValuePlant(MapEvaluation):
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
        angle, how the nodes were chosen.
    boundary : BoundaryCorrection, optional
        What other boundary conditions do; see `with_boundary_conditions`.

    Notes
    -----
    Cubic splines (C2) in ``1/speed``, the logarithm of lift, and the share. Along these
    coordinates the surface rises (falls) wherever the values at the nodes around do; for that it
    leaves single nodes by `shape_adjustment` at most, which is limited to 0.5 % of the largest
    value; maps of few nodes, to which more would have to be done, keep to their nodes instead. At
    the runner's break points (1500 and 3000 rpm) the full plant has a kink in speed, which the
    spline rounds.
    """

    @classmethod
    def fit(
        cls,
        plant: CrankAnglePlant | None = None,
        *,
        speed_range_rpm: tuple[float, float] = SPEED_RANGE_RPM,
        lift_range_mm: tuple[float, float] | None = None,
        longest_deg: float = LONGEST_DEG,
        tolerance: float = TOLERANCE,
        most_points: int = MOST_POINTS,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> Self:
        """Build the maps from steady cycles of the full plant.

        The nodes are chosen where the plant curves, in three grids at most; provenance and text of
        the result tell the error that is left between them, shape aside.

        Parameters
        ----------
        plant : CrankAnglePlant, optional
            Camless full plant; the paper's by default.
        speed_range_rpm : tuple of 2 float
            Lowest and highest speed.
        lift_range_mm : tuple of 2 float, optional
            Lowest and highest lift; 0.5 to 8 mm within the valvetrain's limits by default.
        longest_deg : float
            Longest duration.
        tolerance : float
            Error to aim at between the nodes along each coordinate, relative to the largest
            charge at a speed; twice that for loss.
        most_points : int
            Most nodes.
        threads : int
            Threads to simulate on.
        progress : callable, optional
            Called with the number of cycles done and the number in all as far as known.

        Raises
        ------
        ParameterError
            For a cam-driven plant, and for ranges that are empty or not feasible.
        """
        plant = CrankAnglePlant() if plant is None else plant
        if not isinstance(plant, CrankAnglePlant):
            raise ParameterError(f"plant is {plant!r}, but must be a CrankAnglePlant")
        if plant.profile != "camless":
            raise ParameterError(
                f"the plant's profile is {plant.profile!r}, but must be 'camless': a cam leaves "
                "no lift and duration to choose"
            )
        tolerance, most_points = check_refinement(tolerance, most_points)
        region = map_region(plant.engine, speed_range_rpm, lift_range_mm, longest_deg)
        box = BoxCoordinates(region)
        done = 0

        def simulate(*x: FloatArray) -> tuple[FloatArray, FloatArray]:
            nonlocal done
            before = done

            def tell(k: int, count: int) -> None:
                if progress is not None:
                    progress(before + k, before + count)

            speed, lift = box.speed_and_lift(x[0], x[1])
            duration = region.duration_deg(lift, x[2], speed)
            values = sweep(plant, speed, lift, duration, threads=threads, progress=tell)
            done += values.air_charge.size
            return values.air_charge, values.pumping_loss

        helmholtz = plant.engine.helmholtz
        breaks = np.array([helmholtz.low_speed_rpm, helmholtz.high_speed_rpm])
        kinks = box.slowness(breaks).tolist() if plant.runner else []
        grid = refined_grid(simulate, box.bounds, tolerance, most_points, kinks)
        speeds, lifts = box.speed_and_lift(grid.nodes[0], grid.nodes[1])
        # The ends to the last digit: they are the region's when the maps are read from a file.
        speeds[[0, -1]] = region.lowest_speed_rpm, region.highest_speed_rpm
        lifts[[0, -1]] = region.lowest_lift_mm, region.highest_lift_mm
        return cls(
            plant.engine,
            region,
            speeds,
            lifts,
            grid.nodes[2],
            grid.charge,
            grid.loss,
            {
                **provenance(plant),
                "tolerance": tolerance,
                "most_points": most_points,
                "error_between_nodes": max(grid.error),
                "cycles_simulated": grid.simulated,
            },
        )

    def with_boundary_conditions(
        self,
        plant: CrankAnglePlant,
        *,
        ambient_pressure: tuple[float, float] = RANGES[0],
        temperature: tuple[float, float] = RANGES[1],
        exhaust_pressure: tuple[float, float] = RANGES[2],
        samples: int = 1000,
        seed: int = 0,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> Self:
        """Return the maps with what other boundary conditions do to them.

        Parameters
        ----------
        plant : CrankAnglePlant
            The full plant that was fitted.
        ambient_pressure, temperature, exhaust_pressure : tuple of 2 float
            Range to cover of each, Pa, K and Pa.
        samples, seed : int
            Random points at which the error is measured, and the seed that draws them.
        threads : int
            Threads to simulate on.
        progress : callable, optional
            Called with the number of cycles done and the number in all.

        Raises
        ------
        ParameterError
            If the plant is another one, or a range is empty or leaves out the engine's own.
        """
        from ._boundary_fit import with_boundary_conditions

        ranges = (ambient_pressure, temperature, exhaust_pressure)
        return with_boundary_conditions(self, plant, ranges, samples, seed, threads, progress)

    def at(self, conditions: BoundaryConditions) -> Self:
        """Return the maps at other boundary conditions (numbers, not arrays).

        They serve for everything that these serve for: inverse, regions, derivatives, dynamics.

        Raises
        ------
        ParameterError
            If the maps were not fitted for them (see `with_boundary_conditions`), or do not
            cover them.
        """
        from ._boundary_fit import at

        return at(self, conditions)

    def casadi_function(
        self,
        *,
        coordinates: Literal["duration", "share"] = "duration",
        boundary_conditions: bool = False,
        outside: Literal["nan", "hold"] = "nan",
    ) -> casadi.Function:
        """Return the maps as a CasADi function with exact derivatives of any order.

        Parameters
        ----------
        coordinates : {"duration", "share"}
            Whether the second input is ``duration_deg`` or ``share``, the share of the way from
            the shortest to the longest duration. With shares the feasible region is a box, as
            solvers like it; an output ``duration_deg`` is then added.
        boundary_conditions : bool
            Whether ``ambient_pressure``, ``temperature`` and ``exhaust_pressure`` are inputs too.
        outside : {"nan", "hold"}
            What to return outside the region: NaN, or the value at its border. Holding suits
            solvers that step outside on their way. Within 1e-7 of the border, which counts as
            inside, the splines go on. An output ``inside`` tells in both cases.

        Returns
        -------
        casadi.Function
            Inputs ``lift_mm``, ``duration_deg`` (or ``share``), ``speed_rpm``, outputs
            ``air_charge`` (kg), ``pumping_loss`` (J), ``inside`` (1 or 0); scalars.
        """
        from ._map_casadi import map_function

        return map_function(self, coordinates, boundary_conditions, outside)

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
        speed, lift = broadcast("speed and lift", speed_rpm, lift_mm)
        at = self.charge_lines(lift.ravel(), speed.ravel()).peak().at
        duration = self.region.duration_deg(lift.ravel(), at, speed.ravel())
        return np.where(at < 1.0, duration, np.nan).reshape(speed.shape)[()]

    def lift_saturation(
        self,
        speed_rpm: ArrayLike,
        *,
        duration_deg: ArrayLike | None = 180.0,
        share: float = SATURATION_SHARE,
    ) -> FloatArray:
        """Lift in mm from which on the charge is nearly that of the highest lift (section 5).

        Parameters
        ----------
        speed_rpm : array_like
            Speeds.
        duration_deg : array_like or None
            Duration to compare at; None takes, at each lift, the one of the largest charge.
            NaN is returned where the highest lift cannot be driven, or takes in no charge.
        share : float
            Share of the charge at the highest lift that counts as nearly.
        """
        return lift_saturation(self, speed_rpm, duration_deg, share)

    def regions(
        self,
        speeds_rpm: ArrayLike | None = None,
        *,
        lift_mm: ArrayLike | None = None,
        duration_deg: ArrayLike = 180.0,
    ) -> MapRegions:
        """Return lift saturation, flow reversal and feasibility limit against speed (section 5).

        Parameters
        ----------
        speeds_rpm : array_like, optional
            Speeds; every 50 rpm by default.
        lift_mm : array_like, optional
            Lifts at which flow reversal and shortest duration are told.
        duration_deg : array_like
            Durations at which lift saturation and highest lift are told.
        """
        from .map_regions import map_regions

        return map_regions(self, speeds_rpm, lift_mm=lift_mm, duration_deg=duration_deg)

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
        from .map_error import error_against

        return error_against(self, plant, samples, seed, threads, progress)

    def error_field(
        self,
        plant: CrankAnglePlant,
        *,
        bins: tuple[int, int, int] = (14, 8, 12),
        per_bin: int = 6,
        seed: int = 1,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> MapErrorField:
        """Measure the error of the maps everywhere: largest and rms error bin by bin.

        Parameters
        ----------
        plant : CrankAnglePlant
            Full plant.
        bins : tuple of 3 int
            Bins of speed, lift and share.
        per_bin, seed : int
            Random points in each bin, and the seed that draws them.
        """
        from .map_error import error_field

        return error_field(self, plant, bins, per_bin, seed, threads, progress)

    def derivative_error_against(
        self,
        plant: CrankAnglePlant,
        *,
        samples: int = 300,
        seed: int = 0,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> MapDerivativeError:
        """Compare first and second derivatives with finite differences of a full plant.

        Parameters
        ----------
        plant : CrankAnglePlant
            Full plant; it is simulated at a resolution of 32, so that the choice of steps does
            not disturb the differences.
        samples, seed : int
            Number of points, and the seed that draws them.
        """
        from .map_error import derivative_error_against

        return derivative_error_against(self, plant, samples, seed, threads, progress)

    def dynamics(self, **options: Any) -> MeanValueDynamics:
        """Return the plant for design with its dynamics; options as for `MeanValueDynamics`."""
        from .mean_value_dynamics import MeanValueDynamics

        return MeanValueDynamics(self, **options)

    def as_nonlinear_system(
        self, domain: Literal["event", "time"] = "event", **options: Any
    ) -> control.NonlinearIOSystem:
        """`MeanValueDynamics.as_nonlinear_system` of dynamics with these options."""
        return self.dynamics(**options).as_nonlinear_system(domain)

    def linearize(
        self, command: ValveCommand, speed_rpm: float, *, relative: bool = True, **options: Any
    ) -> control.StateSpace:
        """`MeanValueDynamics.linearize` of dynamics with these options."""
        return self.dynamics(**options).linearize(command, speed_rpm, relative=relative)

    def to_dataset(self) -> xr.Dataset:
        """Return the nodes as an `xarray.Dataset` with units and provenance."""
        from ._map_data import to_dataset

        return to_dataset(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the maps to a netCDF file; it appears whole or not at all.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        from ._map_data import save

        save(self, path)

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], plant: CrankAnglePlant | Engine | None = None
    ) -> Self:
        """Read maps that `save` wrote.

        Parameters
        ----------
        path : path
            The file.
        plant : CrankAnglePlant or Engine, optional
            The plant or engine that they must belong to; any by default.

        Raises
        ------
        ParameterError
            If the file holds no maps, or maps of another plant; the differences are named.
        OSError
            If it cannot be read.
        """
        from ._map_data import load

        return load(cls, path, plant)

    def plot_charge(self, speed_rpm: float, ax: Axes | None = None, kind: Kind = "contour") -> Axes:
        """Draw the air charge over duration and lift (Figure 9); return the axes.

        Parameters
        ----------
        speed_rpm : float
            Speed.
        ax : Axes, optional
            Where to draw; must be three-dimensional for a surface.
        kind : {"contour", "surface"}
            Contours with the regions of section 5, or a surface in 3-D.
        """
        return self._plot("charge", speed_rpm, ax, kind)

    def plot_loss(self, speed_rpm: float, ax: Axes | None = None, kind: Kind = "contour") -> Axes:
        """Draw the pumping loss over duration and lift (Figure 10), as `plot_charge`."""
        return self._plot("loss", speed_rpm, ax, kind)

    def plot_specific_loss(
        self, speed_rpm: float, ax: Axes | None = None, kind: Kind = "contour"
    ) -> Axes:
        """Draw the pumping loss per charge over duration and lift, as `plot_charge`."""
        return self._plot("specific", speed_rpm, ax, kind)

    def __str__(self) -> str:
        """Return what the maps cover and come from."""
        n, m, k = self.charge.shape
        r, p = self.region, self.provenance
        error = ""
        if "error_between_nodes" in p:
            error = (
                f"; between the nodes {100.0 * float(p['error_between_nodes']):.2g} % off at worst "
                f"where seen (asked for {100.0 * float(p['tolerance']):.2g} %)"
            )
        return (
            f"mean-value plant: {self.charge.size} nodes ({n} speeds {r.lowest_speed_rpm:g} to "
            f"{r.highest_speed_rpm:g} rpm, {m} lifts {r.lowest_lift_mm:g} to "
            f"{r.highest_lift_mm:g} mm, {k} durations from the shortest to {r.longest_deg:g} deg) "
            f"of the full plant {p['plant_fingerprint']} (runner {p['runner']}, oscillation "
            f"{p['oscillation']}){error}"
        )

    __repr__ = __str__

    def _plot(self, quantity: Quantity, speed_rpm: float, ax: Axes | None, kind: Kind) -> Axes:
        from ._map_plots import draw

        return draw(self, quantity, speed_rpm, ax, kind)
