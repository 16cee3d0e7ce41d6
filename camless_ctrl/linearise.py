"""What a small change of one valve's duration does to charge and air flow on the full plant.

A longer duration lets in more air *around IVC*, not evenly over the event. The flow that a
correction adds therefore passes the sensor late in the event, and this shape, not that of the
whole charge, is what the adaptive loop sees.
"""

from __future__ import annotations

from dataclasses import dataclass

from plant import CrankAnglePlant, ValveCommand
from plant._checks import positive

from .feedforward import Feedforward
from .measurement_response import FlowShape

_PARTS = 60  # of an event
_STEP = 0.01  # relative change of charge that is aimed at


@dataclass(frozen=True)
class LocalResponse:
    """Full plant around one operating point.

    Attributes
    ----------
    speed_rpm : float
        Speed.
    n_cylinders : int
        Number of cylinders.
    command : ValveCommand
        Command of all cylinders.
    charge : float
        Charge, kg.
    factor : float
        Charge over that of the map at the command, 1.
    sensitivity : float
        Relative sensitivity of the charge to duration: the plant's over the map's, 1.
    shape : FlowShape
        How the charge that a correction adds flows into the manifold.
    """

    speed_rpm: float
    n_cylinders: int
    command: ValveCommand
    charge: float
    factor: float
    sensitivity: float
    shape: FlowShape


def local_response(
    plant: CrankAnglePlant, feedforward: Feedforward, demand: float, speed_rpm: float
) -> LocalResponse:
    """Differentiate the full plant by the duration of its first cylinder.

    The command is the one that gives the demand on the plant (not on the map), by three steps
    of the adaptation without noise.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant, its cylinders equal.
    feedforward : Feedforward
        The map to compare with.
    demand : float
        Charge, kg.
    speed_rpm : float
        Speed.
    """
    positive("demand", demand, "kg")
    n = plant.engine.n_cylinders
    asked = demand
    for _ in range(4):
        forward = feedforward.command(asked, speed_rpm)
        charge = float(plant.steady_cycle(speed_rpm, forward.command).air_charge[0])
        asked = forward.charge * demand / charge
    slope = feedforward.sensitivity(forward.charge, speed_rpm) / forward.charge  # 1/deg
    step = _STEP / slope
    flows, charges = [], []
    for change in (-0.5 * step, 0.5 * step):
        first = forward.command.replace(duration_deg=forward.command.duration_deg + change)
        cycle = plant.steady_cycle(speed_rpm, [first, *[forward.command] * (n - 1)])
        trace = cycle.trace_at(plant.engine.event_angle_deg / (4 * _PARTS))
        flows.append(trace.throttle_flow.reshape(n * _PARTS, 4).sum(axis=1))
        charges.append(float(cycle.air_charge[0]))
    added = flows[1] - flows[0]
    return LocalResponse(
        speed_rpm=float(speed_rpm),
        n_cylinders=n,
        command=forward.command,
        charge=charge,
        factor=charge / forward.charge,
        sensitivity=(charges[1] - charges[0]) / charge / _STEP,
        shape=FlowShape(added / added.sum(), _PARTS),
    )
