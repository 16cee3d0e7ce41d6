"""SUNDIALS' CVODES through CasADi, which derives the Jacobian by itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from plant import right_hand_side as rhs
from plant._layout import APPROACH, CAM, FALL, RETREAT, RISE
from plant.intake_problem import IntakeProblem
from plant.kinematics import FloatArray

from .peers import TOLERANCES, Run, state_scale

_START, _LENGTH = 0, 1  # in front of the parameters of a segment
_FRONT = 2
Forms = tuple[int, ...]  # form of motion of each breathing valve


@dataclass(frozen=True)
class CasadiCvodes:
    """CVODES, BDF of variable order, on CasADi's expression graph."""

    name: str = "CVODES (CasADi)"
    note: str = "expression graph in CasADi's virtual machine; its own derivatives"
    compiled: bool = True
    unit: str = "rtol"
    settings: tuple[float, ...] = TOLERANCES

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Build an integrator for each combination of forms of motion, and return the run."""
        tables = problem.tables
        swings = bool(tables.parameters[0, rhs.SWING] > 0.0)
        options = {"reltol": setting, "abstol": setting, "max_num_steps": 100_000}
        integrators: dict[Forms, Any] = {}
        for k in np.flatnonzero(tables.n_breathing):
            forms = _forms(tables.parameters[k])
            if forms not in integrators:
                equations = _equations(forms, swings)
                integrators[forms] = ca.integrator("cycle", "cvodes", equations, 0.0, 1.0, options)

        def advance(start: float, end: float, y: FloatArray, p: FloatArray) -> FloatArray:
            forms, scale = _forms(p), state_scale(y.size)
            used = p[: rhs.FIRST_VALVE + rhs.VALVE_STRIDE * len(forms)]
            given = np.concatenate([[start, end - start], used])
            found = integrators[forms](x0=y / scale, p=given)
            return scale * np.asarray(found["xf"]).ravel()

        return lambda: problem.solve(advance)


def _forms(parameters: FloatArray) -> Forms:
    places = rhs.FIRST_VALVE + rhs.FORM + rhs.VALVE_STRIDE * np.arange(int(parameters[rhs.COUNT]))
    return tuple(parameters[places].astype(int).tolist())


def _equations(forms: Forms, swings: bool) -> dict[str, Any]:
    """Write `plant.right_hand_side` for CasADi: scaled state, a segment's time from 0 to 1."""
    size = rhs.FIRST_CYLINDER + rhs.STATE_STRIDE * len(forms)
    scale = state_scale(size)
    tau, x = ca.SX.sym("tau"), ca.SX.sym("x", size)
    given = ca.SX.sym("p", _FRONT + rhs.FIRST_VALVE + rhs.VALVE_STRIDE * len(forms))
    p = given[_FRONT:]
    t = given[_START] + tau * given[_LENGTH]
    y = [x[i] * scale[i] for i in range(size)]
    rate = [ca.SX(0)] * size
    p_m = y[rhs.MANIFOLD] / p[rhs.CAPACITY]
    total = p[rhs.THROTTLE_AREA] * _orifice_flow(p_m, p[rhs.AMBIENT_PRESSURE])
    for i, form in enumerate(forms):
        o = rhs.FIRST_CYLINDER + rhs.STATE_STRIDE * i
        valve = p[rhs.FIRST_VALVE + rhs.VALVE_STRIDE * i :]
        angle = p[rhs.OMEGA] * (t - valve[rhs.TOP_TIME])
        volume = p[rhs.HALF_STROKE_VOLUME] * (1 - ca.cos(angle)) + p[rhs.CLEARANCE_VOLUME]
        p_c = y[o + rhs.MASS] * p[rhs.GAS] / volume
        p_r = p_m * (1 - p[rhs.RUNNER_GAIN] * y[o + rhs.RATE])
        lift = _lift(t - valve[rhs.OPENING_TIME], form, p, valve, swings)
        flow = valve[rhs.FLOW_COEFFICIENT] * lift * _orifice_flow(p_c, p_r)
        w = p[rhs.NATURAL_FREQUENCY]
        rate[o + rhs.MASS] = flow
        rate[o + rhs.VELOCITY] = y[o + rhs.RATE]
        forcing = p[rhs.RUNNER_FORCING] * ca.sin(angle) - y[o + rhs.VELOCITY]
        rate[o + rhs.RATE] = w * w * forcing - 2 * p[rhs.DAMPING] * w * y[o + rhs.RATE]
        growth = p[rhs.HALF_STROKE_VOLUME] * p[rhs.OMEGA] * ca.sin(angle)
        rate[o + rhs.WORK] = (p[rhs.EXHAUST_PRESSURE] - p_c) * growth
        total -= flow
    rate[rhs.MANIFOLD] = total
    ode = ca.vertcat(*(given[_LENGTH] * rate[i] / scale[i] for i in range(size)))
    return {"t": tau, "x": x, "p": given, "ode": ode}


def _orifice_flow(downstream: Any, upstream: Any) -> Any:
    """Eq. 13 and 14, with the linear zone of `plant.right_hand_side`."""
    x = ca.fmin(downstream, upstream) / ca.fmax(downstream, upstream)
    s = x - x * x
    subsonic = 2 * s / ca.sqrt(ca.sqrt(s * s + rhs.LINEAR_ZONE**2))
    return ca.sign(upstream - downstream) * ca.if_else(x <= 0.5, 1, subsonic)


def _lift(since: Any, form: int, p: Any, valve: Any, swings: bool) -> Any:
    """Lift in mm, as `plant.right_hand_side.valve_lift`."""
    top = valve[rhs.LIFT]
    if form == CAM:
        return top * ca.sin(math.pi * since / valve[rhs.DURATION]) ** 2
    if form == RISE:
        return p[rhs.OPENING_SLOPE] * since
    soft = p[rhs.ROUNDNESS] * top
    if form == APPROACH:
        rise = since - valve[rhs.RISE_END]
        lift = top - soft * ca.exp(-p[rhs.OPENING_SLOPE] / soft * rise)
    elif form == RETREAT:
        left = valve[rhs.DWELL_END] - since
        lift = top - soft * ca.exp(-p[rhs.CLOSING_SLOPE] / soft * left)
    elif form == FALL:
        lift = top - soft - p[rhs.CLOSING_SLOPE] * (since - valve[rhs.DWELL_END])
    else:
        lift = p[rhs.SEATING_SLOPE] * (valve[rhs.DURATION] - since)
    if swings:
        swung = since - valve[rhs.RISE_END]
        decay = ca.exp(-p[rhs.SWING_DECAY] * swung)
        lift += p[rhs.SWING] * top * decay * ca.sin(p[rhs.SWING_FREQUENCY] * swung)
        lift = ca.fmax(lift, 0)
    return lift
