"""How the charge of a cylinder flows out of the manifold: net mass in equal parts of an event.

The estimator of the charge is this project's own design, and so is this description of the
inflow: a charge is spread over `PARTS` equal parts of an event angle, for `EVENTS` event angles
from IVO on. What flows back into the manifold counts as negative, so a share may be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, Cycle, ValveCommand
from plant._checks import broadcast
from plant.errors import ParameterError
from plant.kinematics import FloatArray, cylinder_volume

from .event_data import EVENTS, PARTS

# Points of the trace in a part. The mass in the cylinder is exact at each point; where IVO lies
# between two points, it is taken as linear there.
_POINTS = 8
_GAINS = (0.88, 1.1)  # flow gains between which a slope is taken: about as far as cylinders differ


def inflow_shares(plant: CrankAnglePlant, command: ValveCommand, speed_rpm: float) -> FloatArray:
    """Return the shares of the charge of equal cylinders in a steady cycle.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant; its cylinders are to be equal.
    command : ValveCommand
        One command for all cylinders.
    speed_rpm : float
        Engine speed.

    Returns
    -------
    ndarray (EVENTS * PARTS,)
        Net mass that flows from the manifold into a cylinder in each part from its IVO on, over
        its charge; the sum is 1.

    Raises
    ------
    ParameterError
        As `inflow_shares_from_cycle`, and for an operating point that the plant refuses.
    """
    return inflow_shares_from_cycle(plant.steady_cycle(speed_rpm, command))


def inflow_shares_table(
    plant: CrankAnglePlant, speed_rpm: ArrayLike, lift_mm: ArrayLike, duration_deg: ArrayLike
) -> FloatArray:
    """Return the shares at many operating points.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant; its cylinders are to be equal.
    speed_rpm, lift_mm, duration_deg : array_like
        Operating points, which broadcast.

    Returns
    -------
    ndarray (..., EVENTS * PARTS)
        See `inflow_shares`.
    """
    speed, lift, duration = broadcast(
        "speed_rpm, lift_mm and duration_deg", speed_rpm, lift_mm, duration_deg
    )
    table = np.empty((*speed.shape, EVENTS * PARTS))
    for at in np.ndindex(speed.shape):
        command = ValveCommand(float(lift[at]), float(duration[at]))
        table[at] = inflow_shares(plant, command, float(speed[at]))
    return table


def inflow_share_slopes(
    plant: CrankAnglePlant, command: ValveCommand, speed_rpm: float
) -> FloatArray:
    """Return how the shares change with the flow gain of a cylinder.

    A cylinder with a weak valve fills in another rhythm. At 6000 rpm shares that leave this out
    put an error of 0.8 % (four cylinders) or 2 % (six) on the charge of one that is 15 % weak.

    Parameters
    ----------
    plant, command, speed_rpm
        As for `inflow_shares`.

    Returns
    -------
    ndarray (EVENTS * PARTS,)
        d shares/d ln flow_gain, by central difference of cycles of equal cylinders; its sum is
        0, so that ``shares + ln(gain) * slopes`` adds up to 1.
    """
    low, high = (
        inflow_shares(
            plant.with_engine(
                plant.engine.replace(flow_coefficient=plant.engine.flow_coefficient * factor)
            ),
            command,
            speed_rpm,
        )
        for factor in _GAINS
    )
    return np.asarray((high - low) / np.log(_GAINS[1] / _GAINS[0]))


def inflow_shares_from_cycle(cycle: Cycle, cylinder: int = 1) -> FloatArray:
    """Return the shares of the charge of one cylinder in a cycle that is already known.

    Parameters
    ----------
    cycle : Cycle
        Periodic cycle.
    cylinder : int
        Cylinder, from 1.

    Returns
    -------
    ndarray (EVENTS * PARTS,)
        See `inflow_shares`.

    Raises
    ------
    ParameterError
        If the valve is open for more than `EVENTS` event angles, or takes nothing in.
    """
    engine = cycle.plant.engine
    command = cycle.commands[cylinder - 1]
    event, reach = engine.event_angle_deg, EVENTS * engine.event_angle_deg
    if command.duration_deg > reach:
        raise ParameterError(
            f"the valve is open for {command.duration_deg:g} deg, but the inflow is told over "
            f"{reach:g} deg, {EVENTS} events of {engine.n_cylinders} cylinders: shorten the "
            "duration"
        )
    charge = float(cycle.air_charge[cylinder - 1])
    if not charge > 0.0:
        raise ParameterError(
            f"the charge of cylinder {cylinder} is {1e6 * charge:g} mg, but must be above 0 to "
            "be divided into shares: lengthen the duration"
        )
    trace = cycle.trace_at(event / (PARTS * _POINTS))
    gas = engine.gas_constant * engine.temperature
    mass = trace.cylinder_pressure[:, cylinder - 1] * trace.volume[:, cylinder - 1] / gas
    opening = command.opening_deg + event * (cylinder - 1)
    # The trace is one cycle long; before and after it the cycle repeats.
    after = np.mod(trace.crank_angle_deg - opening + 1e-9, 720.0) - 1e-9
    order = np.argsort(after)
    after, mass = after[order], mass[order]
    at_opening = engine.exhaust_pressure / gas
    at_opening *= float(
        cylinder_volume(command.opening_deg, engine.displaced_volume, engine.clearance_volume)
    )
    open_now = (after > 1e-6) & (after < command.duration_deg) & np.isfinite(mass)
    # Beyond the closing the mass is that of the opening and the charge.
    angle = np.concatenate(([0.0], after[open_now], [command.duration_deg]))
    taken = np.concatenate(([0.0], mass[open_now] - at_opening, [charge]))
    edges = event / PARTS * np.arange(EVENTS * PARTS + 1)
    return np.asarray(np.diff(np.interp(edges, angle, taken)) / charge)
