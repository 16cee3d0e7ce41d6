"""Compiled estimate of a step's local error, by which the steps are chosen."""

from __future__ import annotations

import numpy as np

from ._compile import compiled
from ._layout import WORK, KernelEngine
from ._method import E_0, E_1, E_2, E_3
from ._workspace import FLOW, LANES, LIFT, OPEN, PER_MASS, POWER, SENSITIVITY, STAGE

TOLERANCE = 5e-6  # local error of a mass over about what it comes to, at resolution 1
LEAST_AIR = 0.1  # displaced volumes of ambient air, to which a small mass is compared
WORK_TOLERANCE = 2.5e-4  # local error of the work over itself or its least, at resolution 1
LEAST_WORK = 0.5  # J
KINK = 20.0  # weight of an error where the flow turns round or the valve rests: no smooth slope
REVERSAL = 1e-3  # error of a step over a reversal, of the air that its first flow would move
NEAR_REVERSAL = 0.25  # share of the flow at the start of a step below which it is about to turn
RESTING = 1e-6  # mm, below zero: not rounding but the seat


@compiled
def local_error(
    engine: KernelEngine,
    cylinders: np.ndarray,
    work: np.ndarray,
    forcing: np.ndarray,
    breathing: np.ndarray,
    n_breathing: int,
    h: float,
    pressure: float,
    damping: float,
) -> tuple[float, bool]:
    """Local error over the tolerance, and whether it is that of a flow that turns round.

    Of the masses, relative to about the air that a cylinder takes in, and of the work. The
    share of a stiff component is damped as the implicit step damps it.
    """
    error, reverses = 0.0, False
    for i in range(n_breathing):
        flow_0, flow_2, flow = work[i, FLOW], work[i, FLOW + 2], work[i, FLOW + 3]
        damped = 1.0 - work[i, SENSITIVITY] * pressure / work[i, STAGE]
        scale = h * damped * work[i, PER_MASS] * (1.0 / TOLERANCE)
        defect = abs(E_0 * flow_0 + E_1 * work[i, FLOW + 1] + E_2 * flow_2 + E_3 * flow)
        turns = flow_0 * flow_2 < 0.0 or flow_0 * flow < 0.0
        lift_1 = forcing[i, LANES * LIFT]
        lift_2 = forcing[i, LANES * LIFT + 1]
        lift_3 = forcing[i, LANES * LIFT + 2]
        # It is about to turn if it falls, and not only since the valve shuts.
        least = NEAR_REVERSAL * abs(flow_0)
        shuts = work[i, OPEN] == 0.0 and abs(flow) * lift_2 >= least * lift_3
        if turns or (abs(flow) < least and not shuts):
            defect = KINK * max(defect, REVERSAL * abs(flow_0))
            reverses = reverses or defect * scale > 1.0
        if min(lift_1, lift_2, lift_3) < -RESTING:
            defect *= KINK
        error = max(error, defect * scale)
        defect = E_0 * work[i, POWER] + E_1 * work[i, POWER + 1] + E_2 * work[i, POWER + 2]
        defect = abs(defect + E_3 * work[i, POWER + 3]) * h
        done = max(abs(cylinders[breathing[i], WORK]), LEAST_WORK)
        error = max(error, defect / (WORK_TOLERANCE * done))
    m = work.shape[0] - 1
    defect = E_0 * work[m, FLOW] + E_1 * work[m, FLOW + 1] + E_2 * work[m, FLOW + 2]
    defect = abs(defect + E_3 * work[m, FLOW + 3]) * h * damping
    inlet = work[m, POWER]
    if inlet * work[m, POWER + 3] < 0.0 or inlet * work[m, POWER + 2] < 0.0:
        defect *= KINK
    return max(error, defect / (TOLERANCE * engine.capacity * pressure)), reverses
