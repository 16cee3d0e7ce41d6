"""Air that the open cylinders hold: identified from slow ramps of the full plant.

While the manifold pressure changes, the open cylinders fill along with the manifold. Eq. 1 to 3,
averaged over an event, then read

    dp_m/dt (V_m + V_s) / (R T) = m_phi - m(p_m, N) n N / 120,

with the charge ``m`` of the steady cycles. Where the valves hardly hold the air back, ``V_s`` is
the mean volume of the cylinders that are open; at high speed they lag behind, and it is less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .crank_angle import CrankAnglePlant
from .cycle import EventResult
from .errors import ParameterError
from .kinematics import FloatArray
from .valve import ValveCommand

EVENTS = 120  # of a ramp, which takes the pressure evenly through its range
_LEAD = 8  # events until the ramp is under way
# Nearer to wide open the throttle sets the pressure, whatever the cylinders store, and the two
# ramps differ by their pulsation at one mean pressure: there the last value is held.
HIGHEST_SHARE = 0.8  # of ambient pressure
_SAMPLES = 12
_SPEEDS_APART = 4  # nodes of speed from ramp to ramp: the storage changes slowly


def storage_at_nodes(
    plant: CrankAnglePlant,
    cam: ValveCommand,
    speeds: FloatArray,
    pressure: FloatArray,
    throttle_deg: FloatArray,
) -> FloatArray:
    """Storage volume at the nodes, from ramps at some of the speeds."""
    from scipy.interpolate import PchipInterpolator

    last = len(speeds) - 1
    chosen = sorted({*range(0, last, _SPEEDS_APART), last})
    volume = [
        identify_storage(plant, cam, float(speeds[i]), pressure[i], throttle_deg[i]) for i in chosen
    ]
    # Rows are at equal shares, not at equal pressures; both change slowly with speed.
    return np.asarray(PchipInterpolator(-1.0 / speeds[chosen], np.array(volume))(-1.0 / speeds))


def identify_storage(
    plant: CrankAnglePlant,
    cam: ValveCommand,
    speed_rpm: float,
    pressure: FloatArray,
    throttle_deg: FloatArray,
) -> FloatArray:
    """Volume ``V_s`` in m3 at pressures (k,) that throttle angles (k,) hold at a speed.

    The pressure is taken up and down again by the throttle. At one pressure the charge of the
    steady cycles is the same both times, so it drops out of the difference of the two throttle
    flows, and with it any error of the charge.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    engine = plant.engine
    angles = np.interp(np.linspace(pressure[0], pressure[-1], EVENTS), pressure, throttle_deg)
    ramps = [_ramp(plant, cam, speed_rpm, a) for a in (angles, angles[::-1])]
    lowest = max(float(p.min()) for p, _ in ramps)
    highest = min(HIGHEST_SHARE * engine.ambient_pressure, *(float(p.max()) for p, _ in ramps))
    at = np.linspace(lowest, highest, _SAMPLES)
    up, down = (CubicSpline(p[order], v[order])(at) for p, v, order in map(_ordered, ramps))
    gas = engine.gas_constant * engine.temperature
    flow, rate = (up - down).T
    volume = gas * flow / rate - engine.manifold_volume
    if np.min(volume) <= -engine.manifold_volume:
        raise ParameterError(
            f"the manifold of {1e3 * engine.manifold_volume:g} l fills within an event at "
            f"{speed_rpm:g} rpm, so that no mean-value description holds: enlarge it, or use the "
            "crank-angle plant"
        )
    return np.asarray(PchipInterpolator(at, volume)(np.clip(pressure, lowest, highest)))


def event_average(event: EventResult) -> float:
    """Time average of the manifold pressure over a traced event, Pa."""
    if event.trace is None:
        raise ParameterError("the event has no trace: give step_event a trace_step_deg")
    pressure = event.trace.manifold_pressure
    # The trace ends one step before the window does.
    ends = 0.5 * (event.manifold_pressure - pressure[0])
    return float((pressure.sum() + ends) / pressure.size)


def _ramp(
    plant: CrankAnglePlant, cam: ValveCommand, speed_rpm: float, throttle_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pressure, and throttle flow with the rate of pressure, along a ramp of events."""
    run = plant.start(speed_rpm, cam, float(throttle_deg[0]))
    events = [
        run.step_event(cam, throttle_deg=angle, trace_step_deg=1.0)
        for angle in throttle_deg.tolist()
    ]
    pressure = np.array([event_average(event) for event in events])
    flow = np.array([event.throttle_mass / event.duration for event in events])
    # Over a cycle, in which each cylinder has had its turn: they need not be equal.
    n = plant.engine.n_cylinders
    pressure, flow = (np.convolve(x, np.full(n, 1.0 / n), "valid") for x in (pressure, flow))
    rate = np.gradient(pressure, events[0].duration)
    inside = slice(_LEAD, -1)  # the gradient at the end is one-sided
    return pressure[inside], np.column_stack((flow, rate))[inside]


def _ordered(
    ramp: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    return (*ramp, np.argsort(ramp[0]))
