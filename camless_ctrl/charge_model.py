"""Charge model: what a cylinder takes in along the path of optimal motions, and its inverse.

At every speed the path is a curve of (lift, duration), told by its nominal charge v. With a
cylinder's flow gain g, duration offset d and charge factor f, and the relative density r of the
air that it breathes,

    m = r f v exp(a1 x + a2 x^2 + a3 x^3 + a4 x^4 + b1 y + b2 y^2),  x = ln(g/r), y = -ln r,

(masses over the density obey the same equations with the coefficients of valve and throttle over
the density), and the motion is delivered by commanding the path's duration less d. The adapted
inverse solves this for the position on the path that gives a demand. Charges and responses are
those of the full plant at the nodes of a table, bicubic splines between. This law is this
project's own design; Part II's is not public.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant.sweep import Progress

from ._model_checks import TRIALS, check_rising, error_between_nodes, nodes_of
from ._model_fit import build_table
from ._model_lookup import ModelLookup
from ._model_table import HIGHEST_GAIN, LOWEST_GAIN, MotionPath
from .feedforward import FeedforwardCommand

if TYPE_CHECKING:
    import os

    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["LONGEST_DEG", "ChargeModel", "MotionPath"]

LOWEST_LIFT_MM = 0.5  # lowest lift that is commanded by default, the assumed actuator's
LONGEST_DEG = 280.0  # longest duration that is commanded by default, as in the maps


@dataclass(frozen=True, eq=False, repr=False)
class ChargeModel(ModelLookup):
    """Charge along the path of optimal motions, with its adapted inverse.

    Make one with `fit`. The nodes are uniform in 1/speed.

    Attributes
    ----------
    speeds_rpm : ndarray (s,)
        Speeds of the nodes, rising, uniform in 1/speed.
    positions : ndarray (q,)
        Positions of the nodes on the path, rising, closer at the least charge.
    table : ndarray (s, q, columns)
        Charge (kg), lift (mm), delivered duration (s), pumping loss (J), response of ln m by
        powers 1 to 4 of ln g, by powers 1 and 2 of lift taken off (mm) and of ln of the throttle's
        gain, slope of ln m over
        duration at fixed lift (1/s), and the shares of the inflow.
    valvetrain : Valvetrain
        Actuator, which sets the shortest duration of a lift.
    lowest_lift_mm : float
        Lowest lift that is commanded, mm.
    longest_deg : float
        Longest duration that is commanded, deg.
    n_cylinders : int
        Number of cylinders.
    plant_fingerprint : str
        Plant that was fitted.
    node_error : float
        Largest relative error of the charge between the nodes, against the full plant at random
        points, 1.
    flow_error, wide_flow_error : float
        Largest residual of the flow response at the nodes, relative to the charge, within 20 %
        of the nominal flow coefficient and over all that were fitted, 1.
    cycles : int
        Steady cycles that were simulated.
    """

    @classmethod
    def fit(
        cls,
        path: MotionPath,
        plant: CrankAnglePlant,
        *,
        speeds: int = 113,
        positions: int = 81,
        speed_range_rpm: tuple[float, float] | None = None,
        lowest_lift_mm: float = LOWEST_LIFT_MM,
        longest_deg: float = LONGEST_DEG,
        threads: int = 2,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Self:
        """Build the model from steady cycles of the full plant.

        Parameters
        ----------
        path : MotionPath
            The path, such as `OptimalPath`.
        plant : CrankAnglePlant
            The camless full plant that the controller is to know.
        speeds, positions : int
            Number of nodes. From 750 to 6000 rpm a multiple of 7, and one, puts nodes on the
            runner's break points.
        speed_range_rpm : (float, float), optional
            Lowest and highest speed; the path's by default.
        lowest_lift_mm, longest_deg : float
            Lowest lift and longest duration that may be commanded.
        threads : int
            Threads to simulate on.
        seed : int
            Draws the points at which the error between the nodes is measured.
        progress : callable, optional
            Called with the number of cycles done and the number in all.

        Raises
        ------
        ParameterError
            For a cam-driven plant, a path with charges that are not above zero, and where the
            charge does not rise with the position, which the message names.
        """
        if plant.profile != "camless":
            raise ParameterError(
                f"the plant's profile is {plant.profile!r}, but must be 'camless': a cam leaves "
                "no motion to choose"
            )
        nodes, along = nodes_of(path, speeds, positions, speed_range_rpm)
        made = build_table(path, plant, nodes, along, threads, progress)
        parts: dict[str, Any] = {
            "speeds_rpm": nodes,
            "positions": along,
            "table": made.columns(),
            "valvetrain": plant.engine.valvetrain,
            "lowest_lift_mm": float(lowest_lift_mm),
            "longest_deg": float(longest_deg),
            "n_cylinders": plant.engine.n_cylinders,
            "plant_fingerprint": plant.fingerprint,
            "flow_error": made.narrow_residual,
            "wide_flow_error": made.flow_residual,
            "cycles": made.cycles + TRIALS,
        }
        model = cls(**parts, node_error=math.nan)
        check_rising(model)
        return cls(**parts, node_error=error_between_nodes(model, plant, threads, seed))

    # -- as a feedforward --------------------------------------------------------------------

    def command(self, charge: float, speed_rpm: float) -> FeedforwardCommand:
        """Return the command for a charge in kg, as `Feedforward.command` does."""
        point = self.inverse(charge, speed_rpm)
        command = ValveCommand(point.lift_mm, point.duration_deg)
        return FeedforwardCommand(command, point.charge, point.limited)

    def sensitivity(self, charge: float, speed_rpm: float) -> float:
        """Slope of the charge over duration at fixed lift, where a charge (kg) is given, kg/deg."""
        point = self.inverse(charge, speed_rpm)
        return point.charge * point.duration_slope / (6.0 * speed_rpm)

    # -- data, text, picture -----------------------------------------------------------------

    def to_dataset(self) -> xr.Dataset:
        """Return the table as an `xarray.Dataset` with units in the attributes."""
        from ._model_data import to_dataset

        return to_dataset(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to a netCDF file, which appears whole or not at all."""
        from ._model_data import save

        save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str], plant: CrankAnglePlant | None = None) -> Self:
        """Read a model that `save` wrote.

        Raises
        ------
        ParameterError
            If the file holds something else, or a model of another plant than the one given.
        """
        from ._model_data import load

        return load(cls, path, plant)

    def __str__(self) -> str:
        """Return grid and errors."""
        s, q = self.speeds_rpm, self.positions
        return (
            f"charge model of {self.n_cylinders} cylinders: {s.size} speeds from {s[0]:.0f} to "
            f"{s[-1]:.0f} rpm, {q.size} positions from {q[0]:g} to {q[-1]:g} ({self.cycles} "
            f"cycles)\nerror between the nodes: at most {100.0 * self.node_error:.2f} % of the "
            f"charge\nflow response: residual at most {100.0 * self.flow_error:.2f} % within 20 % "
            f"of the flow coefficient, {100.0 * self.wide_flow_error:.2f} % from "
            f"{LOWEST_GAIN:g} to {HIGHEST_GAIN:g} times"
        )

    def __repr__(self) -> str:
        """Return the size and the plant."""
        size = f"{self.speeds_rpm.size} speeds x {self.positions.size} positions"
        return f"ChargeModel({size}, plant={self.plant_fingerprint})"

    def plot(self, ax: Axes | None = None, speeds_rpm: ArrayLike | None = None) -> Axes:
        """Draw flow and duration response over the charge at some speeds; see the legend."""
        from ._model_data import plot

        return plot(self, ax, speeds_rpm)
