"""Values and derivatives of the mean-value maps, at points and along lines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ._boundary_correction import BoundaryCorrection, units_of_air
from ._checks import broadcast
from ._map_grid import BoxCoordinates
from ._surface import Lines, Surface
from .boundary import BoundaryConditions
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import MapGradient, MapHessian
from .parameters import Engine
from .region import OperatingRegion, Outside, check_outside

_VARIABLES = 3
MOST_MOVED = 5e-3  # of the largest value: what a node may be left by for the shape


@dataclass(frozen=True, eq=False)
class MapEvaluation:
    """Maps of charge and loss: nodes, and what is between them; fields as in `MeanValuePlant`."""

    engine: Engine
    region: OperatingRegion
    speeds_rpm: FloatArray
    lifts_mm: FloatArray
    shares: FloatArray
    charge: FloatArray
    loss: FloatArray
    provenance: dict[str, str | float | int]
    boundary: BoundaryCorrection | None = None

    # -- points --------------------------------------------------------------------------

    def air_charge(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        conditions: BoundaryConditions | None = None,
        outside: Outside = "raise",
    ) -> FloatArray:
        """Air charge ``F_m`` in kg per event (Eq. 18).

        Parameters
        ----------
        lift_mm, duration_deg, speed_rpm : array_like
            Operating points.
        conditions : BoundaryConditions, optional
            Boundary conditions that broadcast with the points; the engine's own by default.
        outside : {"raise", "nan"}
            What to do outside the feasible region.

        Raises
        ------
        ParameterError, InfeasibleProfileError
            For a point outside the region, naming value and limit, and for conditions that are
            not covered.
        """
        point = self._inside(lift_mm, duration_deg, speed_rpm, outside)
        return self._evaluate("charge", *point, conditions)

    def pumping_loss(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        conditions: BoundaryConditions | None = None,
        outside: Outside = "raise",
    ) -> FloatArray:
        """Pumping loss ``F_e`` in J per event (Eq. 18). Arguments as for `air_charge`."""
        point = self._inside(lift_mm, duration_deg, speed_rpm, outside)
        return self._evaluate("loss", *point, conditions)

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

    def charge_hessian(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        outside: Outside = "raise",
    ) -> MapHessian:
        """Second derivatives of the air charge, exact for the spline."""
        return self._hessian(self._charge, lift_mm, duration_deg, speed_rpm, outside)

    def loss_hessian(
        self,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        *,
        outside: Outside = "raise",
    ) -> MapHessian:
        """Second derivatives of the pumping loss, exact for the spline."""
        return self._hessian(self._loss, lift_mm, duration_deg, speed_rpm, outside)

    @property
    def shape_adjustment(self) -> tuple[float, float]:
        """Largest distance of the charge and loss maps from a node, relative to the largest value.

        It is the price of the surface's shape, see the class's notes: at most 0.5 %, and rounding
        only where it would be more and the spline is left alone.
        """
        speed, lift, share = np.meshgrid(*self._nodes, indexing="ij")
        charge, loss = (
            float(np.abs(surface(speed, lift, share) - values).max() / np.abs(values).max())
            for surface, values in ((self._charge, self.charge), (self._loss, self.loss))
        )
        return charge, loss

    def largest_charge(self, speed_rpm: ArrayLike) -> FloatArray:
        """Largest charge at a speed over all lifts and durations, kg per event."""
        (speeds,) = broadcast("speeds", speed_rpm)
        self._require(self.region.highest_lift_mm, speeds)
        # Lifts of the nodes and between them; the charge is flat in lift where it is largest.
        lifts = np.geomspace(self.lifts_mm[0], self.lifts_mm[-1], 3 * len(self.lifts_mm))
        lifts[[0, -1]] = self.lifts_mm[[0, -1]]
        lift, speed = np.meshgrid(lifts, speeds.ravel())
        peak = self.charge_lines(lift.ravel(), speed.ravel()).peak()
        return peak.value.reshape(lift.shape).max(axis=1).reshape(speeds.shape)[()]

    def largest_loss(self, speed_rpm: ArrayLike) -> FloatArray:
        """Largest pumping loss at a speed over all lifts and durations, J per event."""
        (speeds,) = broadcast("speeds", speed_rpm)
        self._require(self.region.highest_lift_mm, speeds)
        lift, speed = np.meshgrid(self.lifts_mm, speeds.ravel())
        lines = self._loss.lines(self.box.slowness(speed.ravel()), np.log(lift.ravel()))
        peak = lines.peak().value.reshape(lift.shape).max(axis=1)
        return peak.reshape(speeds.shape)[()]

    # -- internals ---------------------------------------------------------------------------

    @cached_property
    def box(self) -> BoxCoordinates:
        """Coordinates of the splines."""
        return BoxCoordinates(self.region)

    @cached_property
    def _charge(self) -> Surface:
        return Surface.shaped(self._nodes, self.charge, MOST_MOVED)

    @cached_property
    def _loss(self) -> Surface:
        return Surface.shaped(self._nodes, self.loss, MOST_MOVED)

    @property
    def _nodes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.box.slowness(self.speeds_rpm), np.log(self.lifts_mm), self.shares

    def _evaluate(
        self,
        quantity: Literal["charge", "loss"],
        lift: FloatArray,
        duration: FloatArray,
        speed: FloatArray,
        inside: np.ndarray,
        conditions: BoundaryConditions | None,
    ) -> FloatArray:
        x = self.box.of(lift, duration, speed)
        value = (self._charge if quantity == "charge" else self._loss)(*x)
        if conditions is not None:
            correction = self.require_boundary(conditions)
            k = 0 if quantity == "charge" else 1
            unit = units_of_air(self.engine, conditions)[k]
            own = units_of_air(self.engine, BoundaryConditions.of(self.engine))[k]
            surface = correction.charge_surface if k == 0 else correction.loss_surface
            change = (surface(*x) * correction.basis(conditions)).sum(axis=-1)
            value = unit * (value / own + change)
        return np.where(inside, value, np.nan)[()]

    def require_boundary(self, conditions: BoundaryConditions) -> BoundaryCorrection:
        """Return the correction after checking that it covers the conditions.

        Raises
        ------
        ParameterError
            If there is none, or it does not.
        """
        if self.boundary is None:
            raise ParameterError(
                f"the maps hold for {BoundaryConditions.of(self.engine)} only: use "
                "with_boundary_conditions(plant) to fit them for others"
            )
        self.boundary.require(conditions)
        return self.boundary

    def _gradient(
        self,
        surface: Surface,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        outside: Outside,
    ) -> MapGradient:
        *point, inside = self._inside(lift_mm, duration_deg, speed_rpm, outside)
        slope = _slopes(surface, self.box.of(*point))
        derivatives = np.einsum("k...,ki...->i...", slope, self.box.jacobian(*point))
        return MapGradient(*(np.where(inside, d, np.nan)[()] for d in derivatives))

    def _hessian(
        self,
        surface: Surface,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        speed_rpm: ArrayLike,
        outside: Outside,
    ) -> MapHessian:
        *point, inside = self._inside(lift_mm, duration_deg, speed_rpm, outside)
        x, jacobian = self.box.of(*point), self.box.jacobian(*point)
        second = np.array([[surface(*x, order=_order(k, m)) for m in range(3)] for k in range(3)])
        h = np.einsum("km...,ki...,mj...->ij...", second, jacobian, jacobian)
        h += np.einsum("k...,kij...->ij...", _slopes(surface, x), self.box.curvature(*point))
        pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        return MapHessian(*(np.where(inside, h[pair], np.nan)[()] for pair in pairs))

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
        return self._charge.lines(self.box.slowness(speed), np.log(lift))


def _order(*axes: int) -> tuple[int, int, int]:
    """Order of a derivative by each of the box's coordinates."""
    return axes.count(0), axes.count(1), axes.count(2)


def _slopes(surface: Surface, x: FloatArray) -> FloatArray:
    return np.stack([surface(*x, order=_order(k)) for k in range(_VARIABLES)])
