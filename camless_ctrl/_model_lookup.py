"""Look-up and inverse of the charge model: what a controller asks before every event.

Private to `charge_model`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from plant import Valvetrain
from plant._checks import broadcast, in_range, positive
from plant.kinematics import FloatArray
from plant.valve import shortest_duration

from ._model_checks import check_table, no_command, places_along, refuse
from ._model_table import (
    COLUMNS,
    HIGHEST_DENSITY,
    HIGHEST_GAIN,
    LOWEST_DENSITY,
    LOWEST_GAIN,
    MOST_DROP_MM,
    named_columns,
    spline_coefficients,
)
from .cylinder_parameters import CylinderParameters
from .event_data import EVENTS, PARTS, ModelPoint

NOMINAL = CylinderParameters()
_FINITE = 1e300
_INSIDE = 1e-9  # relative clearance to the shortest duration, against rounding


@cache
def _kernel() -> ModuleType:
    """Return the compiled look-up: Numba takes its time to import."""
    from . import _model_kernel

    return _model_kernel


@dataclass(frozen=True, eq=False, repr=False)
class ModelLookup:
    """Table of a charge model and the questions to it; see `ChargeModel` for the fields."""

    speeds_rpm: FloatArray
    positions: FloatArray
    table: FloatArray
    valvetrain: Valvetrain
    lowest_lift_mm: float
    longest_deg: float
    n_cylinders: int
    plant_fingerprint: str
    node_error: float
    flow_error: float
    wide_flow_error: float
    cycles: int
    _spline: FloatArray = field(init=False)
    _settings: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        check_table(self)
        rest = shortest_duration(0.0, self.valvetrain)
        slowness = 1.0 / self.speeds_rpm[[0, -1]]
        settings = [
            math.log(LOWEST_GAIN),
            math.log(HIGHEST_GAIN),
            # Rounding may not make a motion infeasible.
            rest * (1.0 + _INSIDE),
            (shortest_duration(1.0, self.valvetrain) - rest) * (1.0 + _INSIDE),
            self.lowest_lift_mm,
            MOST_DROP_MM,
            self.longest_deg,
            slowness[0],
            (slowness[0] - slowness[1]) / (self.speeds_rpm.size - 1),
            self.valvetrain.maximum_lift_mm,
            math.log(LOWEST_DENSITY),
            math.log(HIGHEST_DENSITY),
        ]
        object.__setattr__(self, "_spline", spline_coefficients(self.table))
        object.__setattr__(self, "_settings", np.array(settings))
        for array in (self.speeds_rpm, self.positions, self.table, self._spline, self._settings):
            array.setflags(write=False)

    # -- the controller's questions ----------------------------------------------------------

    def inverse(
        self,
        demand: float,
        speed_rpm: float,
        parameters: CylinderParameters = NOMINAL,
        density: float = 1.0,
    ) -> ModelPoint:
        """Return the command that gives a demand, or the nearest charge in reach.

        Parameters
        ----------
        demand : float
            Charge, kg.
        speed_rpm : float
            Speed.
        parameters : CylinderParameters
            What is known of the cylinder.
        density : float
            Density of the intake air over the model's, 1. It is exact for pressures, that of the
            exhaust included, which all scale by it; a temperature also changes the runners'
            waves, which the model does not see.

        Returns
        -------
        ModelPoint
            With ``limited`` set where the demand is beyond the ends of the path, or the speed
            beyond those of the table (then the motion in degrees of the nearest end, at a lift
            that the time allows), or the flow gain over the density outside 0.6 to 1.8, or
            the density outside 0.55 to 1.25 (then those of the end are taken). A command that is
            too short for the path's lift gets the highest lift that it allows, at most 1 mm less
            than the path's, and the position is solved with it; where this does not suffice, and
            where a command would exceed ``longest_deg``, the nearest position that can be
            commanded is taken.

        Raises
        ------
        ParameterError
            If a number is not finite, a gain, factor or density is not above zero, or an offset
            leaves no command at all.
        """
        gain, offset, factor = parameters
        # One comparison for all: what is not finite makes it False.
        if not (
            abs(demand + speed_rpm + offset) < _FINITE
            and 0.0 < gain < _FINITE
            and 0.0 < factor < _FINITE
            and 0.0 < density < _FINITE
        ):
            refuse(demand, speed_rpm, parameters, density)
        shares = np.empty(EVENTS * PARTS)
        lift, duration, charge, limited, flow_slope, duration_slope, position = _kernel().invert(
            self._spline,
            self._settings,
            demand,
            speed_rpm,
            gain,
            offset,
            factor,
            density,
            shares,
        )
        if position < 0.0:
            raise no_command(offset, speed_rpm, self.longest_deg)
        return ModelPoint(lift, duration, charge, limited, flow_slope, duration_slope, shares)

    def limits(
        self,
        speed_rpm: float,
        parameters: CylinderParameters = NOMINAL,
        density: float = 1.0,
    ) -> tuple[float, float]:
        """Lowest and highest charge in kg that can be commanded; raises as `inverse`."""
        nothing, everything = -1.0, 1e9  # kg, below and beyond what a cylinder can take in
        low = self.inverse(nothing, speed_rpm, parameters, density)
        return low.charge, self.inverse(everything, speed_rpm, parameters, density).charge

    def at(self, position: ArrayLike, speed_rpm: ArrayLike) -> dict[str, FloatArray]:
        """Quantities of the table between its nodes, by name.

        Parameters
        ----------
        position, speed_rpm : array_like
            Positions on the path, and speeds; they broadcast against each other.

        Returns
        -------
        dict of str to ndarray
            ``charge`` (kg), ``lift_mm``, ``duration`` (s), ``loss`` (J), ``flow_response``
            (..., 4), ``lift_response`` (..., 2; 1/mm, 1/mm2), ``throttle_response`` (..., 2),
            ``duration_slope`` (1/s), ``shares`` (..., EVENTS * PARTS).

        Raises
        ------
        ParameterError
            For points outside the table.
        """
        q, speed = broadcast("position and speed", position, speed_rpm)
        for name, value, nodes, unit in (
            ("position", q, self.positions, "1"),
            ("speed_rpm", speed, self.speeds_rpm, "rpm"),
        ):
            for bad in value[~((value >= nodes[0]) & (value <= nodes[-1]))].ravel()[:1]:
                in_range(name, float(bad), float(nodes[0]), float(nodes[-1]), unit)
        out = np.empty((q.size, COLUMNS))
        places = np.ascontiguousarray(places_along(q.ravel(), self.positions))
        _kernel().look_up(
            self._spline, self._settings, np.ascontiguousarray(speed.ravel()), places, out
        )
        return named_columns(out.reshape(*q.shape, COLUMNS))

    def charge_at(
        self,
        position: ArrayLike,
        speed_rpm: ArrayLike,
        parameters: CylinderParameters = NOMINAL,
        density: float = 1.0,
    ) -> FloatArray:
        """Charge in kg of the path's motion, delivered exactly, at positions and speeds.

        Raises
        ------
        ParameterError
            For points outside the table, a density or a flow gain over the density outside what
            was fitted, and a charge factor that is not above zero.
        """
        found = self.at(position, speed_rpm)
        in_range("density", density, LOWEST_DENSITY, HIGHEST_DENSITY, "1")
        gain = in_range(
            "flow_gain over density", parameters.flow_gain / density, LOWEST_GAIN, HIGHEST_GAIN, "1"
        )
        scale = density * positive("charge_factor", parameters.charge_factor, "1")
        x, y = math.log(gain), -math.log(density)
        response = found["flow_response"] @ np.array([x, x**2, x**3, x**4])
        response += found["throttle_response"] @ np.array([y, y**2])
        charge: FloatArray = scale * found["charge"] * np.exp(response)
        return charge
