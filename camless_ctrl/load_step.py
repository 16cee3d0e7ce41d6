"""Load step with one weak cylinder: the standard run of report and command line."""

from __future__ import annotations

import numpy as np

from plant import CrankAnglePlant, Engine
from plant._checks import whole
from plant.sensors import SensorSet

from .closed_loop import ValveErrors, simulate
from .closed_loop_result import ClosedLoopResult
from .controller import AirChargeController
from .controller_cases import JITTER, WEAK_CYLINDER, each_of


def run_load_step(
    controller: AirChargeController,
    *,
    engine: Engine | None = None,
    flow_factors: tuple[float, ...] | None = None,
    speed_rpm: float = 1500.0,
    demand_mg: tuple[float, ...] = (170.0, 400.0, 170.0),
    cycles: int = 40,
    sensors: SensorSet | None = None,
    valves: ValveErrors | None = None,
    seed: int = 0,
) -> ClosedLoopResult:
    """Load step with one weak cylinder: runner and actuator oscillation on, sensors real.

    Parameters
    ----------
    controller : AirChargeController
        The controller. It starts unadapted, with the first demand.
    engine : Engine, optional
        The engine; the paper's by default.
    flow_factors : tuple of float, optional
        True over nominal flow coefficient of each cylinder; `WEAK_CYLINDER`, repeated, by
        default.
    speed_rpm : float
        Engine speed.
    demand_mg : tuple of float
        Demands in mg per event, each held for `cycles` cycles.
    cycles : int
        Cycles per demand.
    sensors : SensorSet, optional
        Sensors; the default ones if not given.
    valves : ValveErrors, optional
        Errors of the delivered durations; the assumed jitter by default.
    seed : int
        Seed of noise and jitter.
    """
    base = Engine.paper() if engine is None else engine
    if flow_factors is None:
        flow_factors = each_of(WEAK_CYLINDER, base.n_cylinders)
    whole("cycles", cycles, 1, 100_000)
    plant = CrankAnglePlant(
        base.replace(cylinder_flow_factors=flow_factors), runner=True, oscillation=True
    )
    demand = np.repeat(1e-6 * np.array(demand_mg), cycles * base.n_cylinders)
    steps = " -> ".join(f"{d:g}" for d in demand_mg)
    return simulate(
        plant,
        controller,
        demand,
        speed_rpm,
        sensors=sensors,
        valves=ValveErrors(0.0, JITTER) if valves is None else valves,
        seed=seed,
        name=f"load step {steps} mg at {speed_rpm:g} rpm, one weak cylinder",
    )
