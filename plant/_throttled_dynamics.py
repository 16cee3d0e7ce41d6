"""Manifold filling of the throttled mean-value plant, simulated in time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._checks import in_range
from .errors import ParameterError, SimulationError
from .kinematics import FloatArray
from .lag import points

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

    from .throttled import ThrottledMeanValuePlant

_RELATIVE_TOLERANCE = 1e-8
_ABSOLUTE_TOLERANCE = 1e-2  # Pa
_STRAIGHT = 1e-9  # of a signal's size over the whole time: slopes that differ by less are equal


class Flows(NamedTuple):
    """What flows at a manifold pressure, a throttle angle and a speed."""

    throttle: FloatArray  # into the manifold, kg/s
    cylinder: FloatArray  # out of it, kg/s
    charge: FloatArray  # kg per event
    rate: FloatArray  # of the manifold pressure, Pa/s
    share: FloatArray  # of the way through the identified pressures, 1


@dataclass(frozen=True, eq=False)
class ThrottledRun:
    """Response of the throttled mean-value plant to throttle and speed.

    Attributes
    ----------
    time : ndarray (m,)
        s.
    throttle_deg, speed_rpm : ndarray (m,)
        Inputs.
    manifold_pressure : ndarray (m,)
        Pa.
    throttle_flow, cylinder_flow : ndarray (m,)
        Into and out of the manifold, averaged over an event, kg/s.
    air_charge : ndarray (m,)
        Charge of an event that takes in at this pressure, kg.
    identified : ndarray of bool (m,)
        Whether the pressure is one that the full plant was seen at in steady state; where it is
        not, the charge follows its tangent.
    """

    time: FloatArray
    throttle_deg: FloatArray
    speed_rpm: FloatArray
    manifold_pressure: FloatArray
    throttle_flow: FloatArray
    cylinder_flow: FloatArray
    air_charge: FloatArray
    identified: NDArray[np.bool_]

    def plot(self) -> Figure:
        """Draw throttle angle, pressure, flows and charge against time."""
        from ._throttled_plots import plot_run

        return plot_run(self)

    def __str__(self) -> str:
        """Return where the run goes, and what of it lies outside the identified range."""
        p, m = self.manifold_pressure / 1e3, 1e6 * self.air_charge
        text = (
            f"{self.time[-1] - self.time[0]:.3g} s of the throttled mean-value plant: pressure "
            f"{p[0]:.2f} to {p[-1]:.2f} kPa (between {p.min():.2f} and {p.max():.2f}), charge "
            f"{m[0]:.1f} to {m[-1]:.1f} mg"
        )
        outside = int(np.sum(~self.identified))
        if outside:
            text += f"; {outside} of {self.time.size} points outside the identified pressures"
        return text


def simulate(
    plant: ThrottledMeanValuePlant,
    time: ArrayLike,
    throttle_deg: ArrayLike,
    speed_rpm: ArrayLike,
    initial_pressure: float | None,
) -> ThrottledRun:
    """See `ThrottledMeanValuePlant.simulate`."""
    t = np.asarray(time, dtype=float)
    throttle, speed = (
        points(t, np.broadcast_to(np.asarray(u, dtype=float), np.shape(u) or t.shape))[1]
        for u in (throttle_deg, speed_rpm)
    )
    if t.size < 2 or t[0] == t[-1]:
        raise ParameterError(
            f"time has {t.size} points over {t[-1] - t[0]:g} s, but must have at least 2, "
            "and not all at one time"
        )
    plant.require_inputs(throttle, speed)
    if initial_pressure is None:
        start = float(plant.steady_pressure(throttle[0], speed[0]))
    else:
        start = in_range(
            "initial_pressure",
            initial_pressure,
            0.0,
            plant.engine.ambient_pressure,
            "Pa",
            open_low=True,
            remedy="the throttle fills the manifold to ambient pressure at most",
        )
    pressure = np.empty(t.size)
    pressure[0] = start
    for first, last in _pieces(t, np.column_stack((throttle, speed))):
        piece = slice(first, last + 1)
        if t[first] == t[last]:  # a jump of the inputs; the pressure has none
            pressure[piece] = pressure[first]
        else:
            inputs = throttle[piece], speed[piece]
            pressure[piece] = _solve(plant, t[piece], *inputs, float(pressure[first]))
    flows = plant.flows(pressure, throttle, speed)
    return ThrottledRun(
        time=t.copy(),
        throttle_deg=throttle.copy(),
        speed_rpm=speed.copy(),
        manifold_pressure=pressure,
        throttle_flow=flows.throttle,
        cylinder_flow=flows.cylinder,
        air_charge=flows.charge,
        identified=plant.inside(flows.share),
    )


def _solve(
    plant: ThrottledMeanValuePlant,
    time: FloatArray,
    throttle: FloatArray,
    speed: FloatArray,
    start: float,
) -> FloatArray:
    """Pressure at times, while both inputs go straight from their first to their last value."""
    from scipy.integrate import solve_ivp

    span = time[-1] - time[0]
    steady = throttle[0] == throttle[-1] and speed[0] == speed[-1]

    def rate(t: float, pressure: FloatArray) -> FloatArray:
        share = 0.0 if steady else (t - time[0]) / span
        return plant.flows(
            pressure,
            throttle[0] + (throttle[-1] - throttle[0]) * share,
            speed[0] + (speed[-1] - speed[0]) * share,
        ).rate

    # Near wide open the orifice is stiff: its slope is infinite at ambient pressure.
    solution = solve_ivp(
        rate,
        (float(time[0]), float(time[-1])),
        [start],
        method="Radau",
        t_eval=time,
        rtol=_RELATIVE_TOLERANCE,
        atol=_ABSOLUTE_TOLERANCE,
    )
    if not solution.success:
        raise SimulationError(f"the manifold pressure cannot be integrated: {solution.message}")
    return np.asarray(solution.y[0])


def _pieces(time: FloatArray, inputs: FloatArray) -> list[tuple[int, int]]:
    """First and last point of each stretch over which the inputs are straight lines.

    A solver that chooses its own steps would miss what happens between them.
    """
    span = np.diff(time)
    jump = span == 0.0
    slope = np.diff(inputs, axis=0) / np.where(jump, 1.0, span)[:, None]
    scale = np.max(np.abs(inputs), axis=0) / (time[-1] - time[0])
    bends = np.any(np.abs(np.diff(slope, axis=0)) > _STRAIGHT * scale, axis=1)
    bends |= jump[1:] | jump[:-1]
    edges = [0, *(np.flatnonzero(bends) + 1).tolist(), time.size - 1]
    return list(pairwise(edges))


def as_nonlinear_system(plant: ThrottledMeanValuePlant, name: str) -> control.NonlinearIOSystem:
    """See `ThrottledMeanValuePlant.as_nonlinear_system`."""
    import control

    def at(state: FloatArray, inputs: FloatArray) -> Flows:
        plant.require_inputs(inputs[0], inputs[1])
        return plant.flows(state[0], inputs[0], inputs[1])

    def update(t: float, state: FloatArray, inputs: FloatArray, params: object) -> FloatArray:
        return np.atleast_1d(at(state, inputs).rate)

    def output(t: float, state: FloatArray, inputs: FloatArray, params: object) -> FloatArray:
        flows = at(state, inputs)
        return np.array([state[0], flows.throttle, flows.cylinder, flows.charge])

    return control.nlsys(
        update,
        output,
        inputs=["throttle_deg", "speed_rpm"],
        outputs=["manifold_pressure", "throttle_flow", "cylinder_flow", "air_charge"],
        states=["manifold_pressure"],
        name=name,
        dt=0,
    )
