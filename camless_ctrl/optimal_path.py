"""Path of optimal valve motions: lift and duration over demanded charge and speed, continuous.

At each speed the charges that the early-closing branch can give are numbered by a position from
0 (lowest demand) to 1 (highest). The lift over position and speed is a smooth surface (C2) close
to the lifts of least pumping loss; the duration is the exact inverse of the charge map at that
lift, so that the charge of the map is met exactly. Where two minima of the loss trade places,
the best lift jumps; the path crosses over in a steep but continuous way, and its certificates
tell what that gives up. The laws of Part II are not public; this is this project's own design.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError, ValveCommand
from plant._checks import broadcast, in_range
from plant.kinematics import FloatArray

from ._path_certificates import PathCertificates
from ._path_fit import POSITIONS, exact_motion, fit_path
from ._path_limits import ChargeLimits
from ._path_surface import LiftSurface
from .feedforward import FeedforwardCommand
from .least_loss_motion import FeedforwardOptions

if TYPE_CHECKING:
    import os

    import xarray as xr
    from matplotlib.axes import Axes

    from plant import MeanValuePlant

_ROUNDING = 1e-12  # by which a position may miss an end of the path


class PathPoint(NamedTuple):
    """Points of a path, of one shape."""

    charge: FloatArray  # kg per event, that the map promises
    lift_mm: FloatArray  # mm
    duration_deg: FloatArray  # deg


@dataclass(frozen=True, eq=False, repr=False)
class OptimalPath:
    """Valve motions of least pumping loss over position and speed; make one with `fit`.

    Attributes
    ----------
    maps : MeanValuePlant
        Maps that it is the optimum of.
    options : FeedforwardOptions
        Limits and weights.
    surface : LiftSurface
        Lift over position and speed.
    charge_limits : ChargeLimits
        Lowest and highest charge over speed.
    speeds_rpm : ndarray (s,)
        Nodes of speed.
    positions : ndarray (q,)
        Nodes of position, from 0 to 1.
    certificates : PathCertificates
        Proven optimum of each node, and what the path gives up there for continuity.

    Examples
    --------
    >>> path = OptimalPath.fit(maps)  # doctest: +SKIP
    >>> path.command(250e-6, 1500.0)  # doctest: +SKIP
    """

    maps: MeanValuePlant
    options: FeedforwardOptions
    surface: LiftSurface
    charge_limits: ChargeLimits
    speeds_rpm: FloatArray
    positions: FloatArray
    certificates: PathCertificates

    @classmethod
    def fit(
        cls,
        maps: MeanValuePlant,
        *,
        options: FeedforwardOptions | None = None,
        speeds_rpm: Sequence[float] | FloatArray | None = None,
        nodes: int = POSITIONS,
        progress: Callable[[int, int], None] | None = None,
    ) -> Self:
        """Find the path on maps.

        Parameters
        ----------
        maps : MeanValuePlant
            Maps of charge and loss.
        options : FeedforwardOptions, optional
            Limits and weights.
        speeds_rpm : sequence of float, optional
            Nodes of speed, rising, at least 4; 51 over the maps' range by default.
        nodes : int
            Number of positions.
        progress : callable, optional
            Called with the number of nodes proven and the number in all.

        Raises
        ------
        ParameterError
            If the options leave no motion at a speed, the maps do not cover the lifts, or the
            nodes are too few for a path that stays on reachable motions.
        """
        options = FeedforwardOptions() if options is None else options
        made = fit_path(maps, options, speeds_rpm, nodes, progress)
        return cls(
            maps,
            options,
            made.surface,
            made.limits,
            made.speeds_rpm,
            made.positions,
            made.certificates,
        )

    # -- the path ------------------------------------------------------------------------

    def at(self, position: ArrayLike, speed_rpm: ArrayLike) -> PathPoint:
        """Motions at positions (0 to 1) and speeds (rpm) that broadcast against each other.

        Raises
        ------
        ParameterError
            If a position or speed is out of range.
        """
        position, speed = broadcast("position and speed", position, speed_rpm)
        self._require_speed(speed)
        _require("position", position, 0.0, 1.0, "1", "limit the demand first")
        low, high = self.charge_limits.at(speed)
        charge = low + position * (high - low)
        lift = self.surface(position, speed)
        duration, allowed = exact_motion(self.maps, self.options, charge, lift, speed)
        if not np.all(allowed):
            at = tuple(np.argwhere(~np.atleast_1d(allowed))[0])
            raise ParameterError(
                f"at {float(np.atleast_1d(speed)[at]):g} rpm and "
                f"{1e6 * float(np.atleast_1d(charge)[at]):.2f} mg the path leaves the motions that "
                "the options allow: fit it with more nodes"
            )
        return PathPoint(charge[()], lift[()], np.asarray(duration)[()])

    def limits(self, speed_rpm: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest charge in kg per event at speeds in rpm."""
        speed = np.asarray(speed_rpm, dtype=float)
        self._require_speed(speed)
        low, high = self.charge_limits.at(speed)
        return low[()], high[()]

    def position_of(self, charge: ArrayLike, speed_rpm: ArrayLike) -> FloatArray:
        """Position of charges in kg at speeds; below 0 or above 1 for those out of reach."""
        charge, speed = broadcast("charge and speed", charge, speed_rpm)
        low, high = self.limits(speed)
        position = np.asarray((charge - low) / (high - low))
        for end in (0.0, 1.0):  # the ends to the last digit
            position = np.where(np.abs(position - end) <= _ROUNDING, end, position)
        return position[()]

    def command(self, charge: float, speed_rpm: float) -> FeedforwardCommand:
        """Command for a charge in kg; for the nearest one in reach, flagged, if it must be.

        Raises
        ------
        ParameterError
            If the charge is not finite, or the speed out of range.
        """
        wanted = in_range("charge", charge, -np.inf, np.inf, "kg")
        low, high = (float(limit) for limit in self.limits(speed_rpm))
        reached = min(max(wanted, low), high)
        point = self.at(self.position_of(reached, speed_rpm), speed_rpm)
        command = ValveCommand(float(point.lift_mm), float(point.duration_deg))
        return FeedforwardCommand(command, reached, reached != wanted)

    # -- at the nodes --------------------------------------------------------------------

    @property
    def charge(self) -> FloatArray:
        """Charge at the nodes, (s, q), kg per event."""
        return self._nodes.charge

    @property
    def lift_mm(self) -> FloatArray:
        """Lift at the nodes, (s, q), mm."""
        return self._nodes.lift_mm

    @property
    def duration_deg(self) -> FloatArray:
        """Duration at the nodes, (s, q), deg."""
        return self._nodes.duration_deg

    @cached_property
    def loss(self) -> FloatArray:
        """Pumping loss of the map at the nodes, (s, q), J per event."""
        return self.maps.pumping_loss(self.lift_mm, self.duration_deg, self.speeds_rpm[:, None])

    @cached_property
    def _nodes(self) -> PathPoint:
        return self.at(self.positions, self.speeds_rpm[:, None])

    # -- data and pictures ---------------------------------------------------------------

    def to_dataset(self) -> xr.Dataset:
        """Return nodes, surface, certificates and options as an `xarray.Dataset` with units."""
        from ._path_data import to_dataset

        return to_dataset(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the path to a netCDF file; it appears whole or not at all.

        The maps are not in it; save them too.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        from ._path_data import save

        save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str], maps: MeanValuePlant) -> Self:
        """Read a path that `save` wrote, with the maps that it was fitted to.

        Raises
        ------
        ParameterError
            If the file holds no path, or that of other maps.
        OSError
            If it cannot be read.
        """
        from ._path_data import load

        return load(cls, path, maps)

    def plot_lift(self, ax: Axes | None = None, speeds_rpm: ArrayLike | None = None) -> Axes:
        """Draw the lift over charge at several speeds; return the axes."""
        from ._path_plots import draw_lines

        return draw_lines(self, "lift_mm", ax, speeds_rpm)

    def plot_duration(self, ax: Axes | None = None, speeds_rpm: ArrayLike | None = None) -> Axes:
        """Draw the duration over charge at several speeds; return the axes."""
        from ._path_plots import draw_lines

        return draw_lines(self, "duration_deg", ax, speeds_rpm)

    def plot_lift_contours(self, ax: Axes | None = None) -> Axes:
        """Draw the lift over speed and charge; return the axes."""
        from ._path_plots import draw_contours

        return draw_contours(self, "lift_mm", ax)

    def plot_duration_contours(self, ax: Axes | None = None) -> Axes:
        """Draw the duration over speed and charge; return the axes."""
        from ._path_plots import draw_contours

        return draw_contours(self, "duration_deg", ax)

    def plot_given_up(self, ax: Axes | None = None) -> Axes:
        """Draw what is given up for continuity over speed and charge; return the axes."""
        from ._path_plots import draw_contours

        return draw_contours(self, "given_up", ax)

    def __str__(self) -> str:
        """Return what the path covers and its certificates."""
        s, q = self.charge.shape
        return (
            f"optimal path: {s} speeds {self.speeds_rpm[0]:g} to {self.speeds_rpm[-1]:g} rpm, {q} "
            f"positions from {1e6 * self.charge.min():.1f} to {1e6 * self.charge.max():.1f} mg, "
            f"lifts {self.lift_mm.min():.2f} to {self.lift_mm.max():.2f} mm, durations "
            f"{self.duration_deg.min():.1f} to {self.duration_deg.max():.1f} deg, of maps of the "
            f"full plant {self.maps.provenance['plant_fingerprint']}; {self.certificates}"
        )

    __repr__ = __str__

    def _require_speed(self, speed: FloatArray) -> None:
        _require(
            "speed_rpm",
            speed,
            float(self.speeds_rpm[0]),
            float(self.speeds_rpm[-1]),
            "rpm",
            "fit the path over more speeds",
        )


def _require(
    name: str, values: FloatArray, low: float, high: float, unit: str, remedy: str
) -> None:
    """Name the first value outside its range."""
    outside = ~((values >= low) & (values <= high))
    for value in values[outside][:1]:
        in_range(name, float(value), low, high, unit, remedy=remedy)
