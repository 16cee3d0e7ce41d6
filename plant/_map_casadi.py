"""The mean-value maps as a CasADi function with exact derivatives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ._boundary_correction import POWERS, relative_numbers, units_of_air
from ._checks import one_of, truth
from ._surface import DEGREE, Surface
from .boundary import NAMES, BoundaryConditions
from .region import _ROUNDING

if TYPE_CHECKING:
    import casadi

    from .mean_value import MeanValuePlant


def map_function(
    maps: MeanValuePlant, coordinates: str, boundary_conditions: bool, outside: str
) -> casadi.Function:
    """See `MeanValuePlant.casadi_function`."""
    import casadi

    one_of("coordinates", coordinates, ("duration", "share"))
    one_of("outside", outside, ("nan", "hold"))
    truth("boundary_conditions", boundary_conditions)
    own = BoundaryConditions.of(maps.engine)
    if boundary_conditions:
        maps.require_boundary(own)
    by_share = coordinates == "share"
    names = ["lift_mm", "share" if by_share else "duration_deg", "speed_rpm"]
    names += NAMES if boundary_conditions else ()
    x = [casadi.MX.sym(name) for name in names]
    lift, second, speed = x[:3]
    r = maps.region
    inside: Any = _within(lift, r.lowest_lift_mm, r.highest_lift_mm)
    inside *= _within(speed, r.lowest_speed_rpm, r.highest_speed_rpm)
    held_lift = _held(lift, r.lowest_lift_mm, r.highest_lift_mm)
    held_speed = _held(speed, r.lowest_speed_rpm, r.highest_speed_rpm)
    shortest = shortest_duration_deg(maps, held_lift, held_speed)
    span = r.longest_deg - shortest
    share = second if by_share else (second - shortest) / span
    inside *= _within(share, 0.0, 1.0)
    share = _held(share, 0.0, 1.0)
    point = casadi.vertcat(-r.lowest_speed_rpm / held_speed, casadi.log(held_lift), share)
    values = [
        _spline(surface, name)(point)
        for surface, name in zip((maps._charge, maps._loss), ("charge", "loss"), strict=True)
    ]
    if boundary_conditions and maps.boundary is not None:
        b = maps.boundary
        held = []
        for symbol, (low, high) in zip(x[3:], b.ranges, strict=True):
            inside *= _within(symbol, low, high)
            held.append(_held(symbol, low, high))
        numbers = relative_numbers(maps.engine, held[0], held[1], held[2], casadi.log)
        basis = casadi.vertcat(
            *(numbers[0] ** a * numbers[1] ** k * numbers[2] ** c for a, k, c in POWERS)
        )
        work = held[0] * maps.engine.displaced_volume
        units = work / (maps.engine.gas_constant * held[1]), work
        for k, surface in enumerate((b.charge_surface, b.loss_surface)):
            change = casadi.dot(_spline(surface, f"change_{k}")(point), basis)
            values[k] = units[k] * (values[k] / units_of_air(maps.engine, own)[k] + change)
    if outside == "nan":
        values = [casadi.if_else(inside, value, np.nan) for value in values]
    outputs, output_names = [*values, inside], ["air_charge", "pumping_loss", "inside"]
    if by_share:
        outputs.append(shortest + span * share)
        output_names.append("duration_deg")
    return casadi.Function("mean_value_maps", x, outputs, names, output_names)


def shortest_duration_deg(maps: MeanValuePlant, lift: Any, speed: Any) -> Any:
    """`OperatingRegion.shortest_deg` for symbols: linear in lift, proportional to speed."""
    rest = float(maps.region.shortest_deg(0.0, 1.0))
    rate = float(maps.region.shortest_deg(1.0, 1.0)) - rest
    return speed * (rest + rate * lift)


def _within(value: Any, low: float, high: float) -> Any:
    slack = _ROUNDING * (high - low)
    return (value >= low - slack) * (value <= high + slack)


def _held(value: Any, low: float, high: float) -> Any:
    """The value, or the bound that it passes by more than rounding.

    Up to there the splines go on (`_spline`), so that their derivatives at a border are right
    on either side of its last digit.
    """
    import casadi

    slack = _ROUNDING * (high - low)
    inner = casadi.if_else(value > high + slack, high, value)
    return casadi.if_else(inner < low - slack, low, inner)


def _spline(surface: Surface, name: str) -> casadi.Function:
    import casadi
    from scipy.interpolate import BSpline, make_interp_spline

    # CasADi's splines are zero beyond their ends: move these out, the polynomials stay the same.
    knots, c = [], surface.coefficients
    for axis, t in enumerate(surface.knots):
        reach = 4.0 * _ROUNDING * (t[-1] - t[0])
        wider = np.concatenate((t[:4] - reach, t[4:-4], t[-4:] + reach))
        at = (t[1:-3] + t[2:-2] + t[3:-1]) / 3.0  # one place for each coefficient
        line = np.moveaxis(c, axis, 0)
        on = BSpline(t, line, DEGREE)(at)
        c = np.moveaxis(make_interp_spline(at, on, k=DEGREE, t=wider).c, 0, axis)
        knots.append(wider)
    # CasADi runs through the outputs of a point first, then through the first coordinate.
    many = c.reshape(*c.shape[:3], -1)
    flat = np.moveaxis(many, -1, 0).ravel(order="F")
    return casadi.Function.bspline(
        name, [t.tolist() for t in knots], flat.tolist(), [DEGREE] * 3, many.shape[-1]
    )
