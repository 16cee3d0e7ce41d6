"""The mean-value plant in time: uniform flow, manifold filling, lags, delays as Padé fractions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _event_step as step
from .kinematics import FloatArray

if TYPE_CHECKING:
    import casadi
    import control

    from .mean_value_dynamics import MeanValueDynamics

_ORDER = 4  # of the Padé fractions, whose numerators are of one less: nothing passes at once


def time_system(model: MeanValueDynamics) -> control.NonlinearIOSystem:
    """See `MeanValueDynamics.as_nonlinear_system`."""
    import control

    function, names = _rates(model)

    def call(x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        rate, outputs, inside = function(x, u)
        if not float(inside):
            model.maps.region.require(*map(float, u))
            model.refuse_pressure(float(x[0]))
        if not x[0] > 0.0:
            model.refuse_emptied(float(u[2]), float(outputs[0]))
        return np.asarray(rate).ravel(), np.asarray(outputs).ravel()

    def update(_t: float, x: FloatArray, u: FloatArray, _: Mapping[str, Any]) -> FloatArray:
        return call(x, u)[0]

    def output(_t: float, x: FloatArray, u: FloatArray, _: Mapping[str, Any]) -> FloatArray:
        return call(x, u)[1]

    return control.nlsys(
        update,
        output,
        inputs=list(step.INPUTS),
        outputs=list(step.OUTPUTS),
        states=names,
        dt=0,
        name="mean_value_plant_in_time",
    )


def _rates(model: MeanValueDynamics) -> tuple[casadi.Function, list[str]]:
    """``(state, input) -> (rate of change, outputs, inside)``, and the names of the states."""
    import casadi

    lags = {"maf": model.maf.time_constant, "map": model.map.time_constant}
    names = ["manifold_pressure", *(f"{name}_reading" for name, tau in lags.items() if tau > 0.0)]
    delayed = model.maf.delay > 0.0
    names += [f"maf_delay_{k + 1}" for k in range(_ORDER if delayed else 0)]
    names += [f"power_delay_{k + 1}" for k in range(_ORDER if model.power_delay_deg else 0)]
    x = casadi.MX.sym("state", len(names))
    u = casadi.MX.sym("input", len(step.INPUTS))
    state = dict(zip(names, casadi.vertsplit(x), strict=True))
    T = 120.0 / (model.n_cylinders * u[2])
    pressure = state["manifold_pressure"]
    charge, loss, inside = step.charge_and_loss(model, u, pressure, T)
    charge *= float(np.mean(model.gains))
    flow = step.throttle_flow(model, pressure)
    rates = {"manifold_pressure": (flow - charge / T) / step.manifold_capacity(model)}

    at_sensor, power = flow, charge
    if delayed:
        at_sensor = _delay(state, rates, "maf_delay", flow, model.maf.delay)
    if model.power_delay_deg:
        wait = model.power_delay_deg / (6.0 * u[2])
        # In mg: solvers measure states by one absolute tolerance.
        power = 1e-6 * _delay(state, rates, "power_delay", 1e6 * charge, wait)
    readings = []
    for (name, tau), signal in zip(lags.items(), (at_sensor, pressure), strict=True):
        key = f"{name}_reading"
        if tau > 0.0:
            rates[key] = (signal - state[key]) / tau
            signal = state[key]
        sensor = model.maf if name == "maf" else model.map
        readings.append((1.0 + sensor.gain_error) * signal + sensor.offset)
    outputs = casadi.vertcat(charge, power, loss, flow, pressure, *readings)
    rate = casadi.vertcat(*(rates[name] for name in names))
    return casadi.Function("rates", [x, u], [rate, outputs, inside]), names


def _delay(
    state: Mapping[str, Any], rates: dict[str, Any], name: str, signal: Any, delay: Any
) -> Any:
    """Add the states of a delayed signal; return the delayed signal."""
    import casadi
    import control

    unit = control.ss(control.tf(*control.pade(1.0, _ORDER, _ORDER - 1)))
    inner = casadi.vertcat(*(state[f"{name}_{k + 1}"] for k in range(_ORDER)))
    change = (casadi.mtimes(unit.A, inner) + casadi.mtimes(unit.B, signal)) / delay
    for k in range(_ORDER):
        rates[f"{name}_{k + 1}"] = change[k]
    return casadi.mtimes(unit.C, inner) + unit.D * signal
