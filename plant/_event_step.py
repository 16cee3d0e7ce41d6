"""One intake event of the mean-value plant as a CasADi function: next state and outputs.

Symbols instead of numbers, so that its derivatives are exact.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from .boundary import NAMES

if TYPE_CHECKING:
    import casadi

    from .mean_value_dynamics import MeanValueDynamics

INPUTS = ("lift_mm", "duration_deg", "speed_rpm")
INPUT_UNITS = ("mm", "deg", "rpm")
GAIN = "gain"
OUTPUTS = (
    "air_charge",
    "power_charge",
    "pumping_loss",
    "throttle_flow",
    "manifold_pressure",
    "maf",
    "map",
)
OUTPUT_UNITS = ("kg", "kg", "J", "kg/s", "Pa", "kg/s", "Pa")


def state_names(model: MeanValueDynamics) -> list[str]:
    """Names of the states of the event-based plant."""
    return [
        "manifold_pressure",
        "map_reading",
        "maf_tail",
        *(f"intake_{j}_events_ago" for j in range(1, maf_taps(model) + 1)),
        *(f"event_time_{j}_events_ago" for j in range(1, maf_taps(model) + 1)),
        *(f"charge_{j}_events_ago" for j in range(1, model.power_delay_events + 1)),
    ]


def maf_taps(model: MeanValueDynamics) -> int:
    """Events after which a charge has passed the MAF sensor at every speed of the maps."""
    shape = model.flow_shape
    shortest = 120.0 / (model.n_cylinders * model.maps.region.highest_speed_rpm)
    reach = shape.shares.size / shape.parts + model.maf.delay / shortest
    return max(math.ceil(reach - 1e-9), 1)


def event_step(model: MeanValueDynamics) -> casadi.Function:
    """Return ``(state, input, gain) -> (next state, outputs, inside)``.

    The input is lift, duration and speed; `inside` is 0 where the maps do not hold.
    """
    import casadi

    names = state_names(model)
    taps, wait = maf_taps(model), model.power_delay_events
    x = casadi.MX.sym("state", len(names))
    u = casadi.MX.sym("input", len(INPUTS))
    gain = casadi.MX.sym(GAIN)
    speed = u[2]
    T = 120.0 / (model.n_cylinders * speed)
    pressure, reading, tail, *past = casadi.vertsplit(x)
    intake, lengths, charges = past[:taps], past[taps : 2 * taps], past[2 * taps :]

    charge, loss, inside = charge_and_loss(model, u, pressure, T)
    charge = gain * charge
    next_pressure = filled(model, pressure, charge, T)
    capacity = manifold_capacity(model)
    passed = charge + capacity * (next_pressure - pressure)  # through the throttle, kg

    seen, next_tail = _reading(model, taps, T, [passed, *intake], lengths, tail)
    maf = (1.0 + model.maf.gain_error) * seen / T + model.maf.offset
    tau = model.map.time_constant
    left = casadi.exp(-T / tau) if tau > 0.0 else casadi.MX(0.0)
    average = next_pressure + (reading - next_pressure) * (1.0 - left) * tau / T
    map_ = (1.0 + model.map.gain_error) * average + model.map.offset

    following = casadi.vertcat(
        next_pressure,
        next_pressure + (reading - next_pressure) * left,
        next_tail,
        passed,
        *intake[:-1],
        T,
        *lengths[:-1],
        *([charge, *charges[:-1]] if wait else ()),
    )
    power = charges[wait - 1] if wait else charge
    outputs = casadi.vertcat(charge, power, loss, passed / T, next_pressure, maf, map_)
    return casadi.Function("event", [x, u, gain], [following, outputs, inside])


def charge_and_loss(model: MeanValueDynamics, u: Any, pressure: Any, T: Any) -> tuple[Any, ...]:
    """Charge and loss of an event, and whether the maps hold.

    Maps with boundary conditions see the manifold: its pressure stands for the ambient one
    with which, wide open, the manifold would be at that pressure.
    """
    maps, engine = model.maps, model.maps.engine
    if maps.boundary is None:
        found = maps.casadi_function(outside="hold")(u[0], u[1], u[2])
        return tuple(found)
    function = maps.casadi_function(boundary_conditions=True, outside="hold")
    own = [getattr(engine, name) for name in NAMES]
    base = function(u[0], u[1], u[2], *own)
    wide_open = _share_of_ambient(base[0] / (engine.throttle.area(_wide(model)) * T))
    return tuple(function(u[0], u[1], u[2], pressure / wide_open, *own[1:]))


def manifold_capacity(model: MeanValueDynamics) -> float:
    """Mass that raises the manifold's pressure by one pascal, kg/Pa (Eq. 1)."""
    e = model.maps.engine
    return e.manifold_volume / (e.gas_constant * e.temperature)


def throttle_flow(model: MeanValueDynamics, pressure: Any) -> Any:
    """Flow through the throttle at a manifold pressure, kg/s (Eq. 13-15).

    Above ambient pressure the flow is mirrored at ambient pressure, which is Eq. 13 but for
    second order in the difference.
    """
    import casadi

    x = pressure / model.maps.engine.ambient_pressure
    y = casadi.if_else(x > 1.0, 2.0 - x, x)
    size = casadi.if_else(y <= 0.5, 1.0, 2.0 * casadi.sqrt(casadi.fmax(y - y**2, 0.0)))
    return model.throttle_area * casadi.if_else(x > 1.0, -size, size)


def filled(model: MeanValueDynamics, pressure: Any, charge: Any, T: Any) -> Any:
    """Manifold pressure after an event that takes a charge out of it (Eq. 1, 13-15).

    The implicit step ``capacity (p+ - p) = T A d(p+/p_o) - charge`` is a quadratic in
    ``p+/p_o``: stable for a manifold that fills in a fraction of an event.
    """
    import casadi

    ambient = model.maps.engine.ambient_pressure
    flow = 2.0 * model.throttle_area * T
    c = manifold_capacity(model) * ambient
    b = charge - manifold_capacity(model) * pressure
    choked = (0.5 * flow - b) / c
    # (b + c x)^2 = flow^2 (x - x^2) for inflow; in 2 - x for outflow, with b + c x below zero
    outward = b + c < 0.0

    def larger_root(offset: Any) -> Any:
        middle = flow**2 - 2.0 * offset * c
        inner = casadi.fmax(middle**2 - 4.0 * (c**2 + flow**2) * offset**2, 0.0)
        return (middle + casadi.sqrt(inner)) / (2.0 * (c**2 + flow**2))

    inflow = larger_root(b)
    outflow = 2.0 - larger_root(-(b + 2.0 * c))
    x = casadi.if_else(choked <= 0.5, choked, casadi.if_else(outward, outflow, inflow))
    return ambient * x


def _share_of_ambient(flow: Any) -> Any:
    """Pressure ratio at which an orifice passes a share of its sonic flow (Eq. 14)."""
    import casadi

    return 0.5 * (1.0 + casadi.sqrt(casadi.fmax(1.0 - flow**2, 0.0)))


def _wide(model: MeanValueDynamics) -> float:
    return model.maps.engine.throttle.wide_open_deg


def _reading(
    model: MeanValueDynamics, taps: int, T: Any, charges: Any, lengths: Any, tail: Any
) -> tuple[Any, Any]:
    """Integral of the MAF reading over an event, and the reading that old pulses leave at its end.

    The pulses of this event and the `taps` before it are followed through delay and lag, each
    with its own event's length; what older ones have left is `tail`, which decays.
    """
    import casadi

    shape, tau, delay = model.flow_shape, model.maf.time_constant, model.maf.delay
    integral = tail * tau * -casadi.expm1(-T / tau)
    before: Any = 0.0  # time from the pulse's own IVO to this event's
    for j in range(taps + 1):
        length = (lengths[j - 1] if j else T) / shape.parts
        before = before + lengths[j - 1] if j else before
        for k, share in enumerate(shape.shares):
            start = before - delay - k * length
            area = _pulse_area(start + T, length, tau) - _pulse_area(start, length, tau)
            integral += charges[j] * share * area
    oldest = sum(
        share * _pulse(before + T - delay - k * length, length, tau)
        for k, share in enumerate(shape.shares)
    )
    return integral, tail * casadi.exp(-T / tau) + charges[taps] * oldest


def _pulse(t: Any, length: Any, tau: float) -> Any:
    """Reading of an even pulse of unit charge after it has passed, 1/s."""
    import casadi

    return (casadi.exp(-(t - length) / tau) - casadi.exp(-t / tau)) / length


def _pulse_area(t: Any, length: Any, tau: float) -> Any:
    """Integral of the reading of an even pulse of unit charge up to a time, 1."""
    import casadi

    def ramp(s: Any) -> Any:
        s = casadi.fmax(s, 0.0)
        return s + tau * casadi.expm1(-s / tau)

    return (ramp(t) - ramp(t - length)) / length
