"""Plain matrices of a law's closed loop in the middle of the set; quick to build."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plant.kinematics import FloatArray

from .pulse_bank import pulse_bank

if TYPE_CHECKING:
    import control

    from .uncertain_measurement import UncertainMeasurement


class Matrices(NamedTuple):
    """State-space matrices per event."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


def matrices_of(system: control.StateSpace) -> Matrices:
    """Matrices of a system."""
    return Matrices(*(np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D)))


def centre_of(measurement: UncertainMeasurement) -> Matrices:
    """Measurement in the middle of the set with its latency, from charge to estimate."""
    m = measurement
    return matrices_of(
        pulse_bank([m.centre], m.latency, input="y", outputs=["estimate"], name="centre")
    )


def corners_of(measurement: UncertainMeasurement) -> Matrices:
    """Measurement at all corners of the real parameters, ``C`` a stack (corners, 1, s)."""
    m = measurement
    sums = [m.centre, *m.directions.values()]
    names = [f"y{k}" for k in range(len(sums))]
    A, B, C, D = matrices_of(pulse_bank(sums, m.latency, input="y", outputs=names, name="bank"))
    deltas = np.array(list(product((-1.0, 1.0), repeat=len(m.directions))))
    return Matrices(A, B, (C[0] + deltas @ C[1:])[:, None, :], D[:1])


def sensitivity(plant: Matrices, law: Matrices) -> Matrices:
    """Closed loop from the disturbance to the error; the plant has no feedthrough.

    ``C`` of the plant may be a stack (..., 1, s).
    """
    A, B, C, _ = plant
    a, b, c, d = law
    m, stack = len(A), C.shape[:-2]
    closed = np.zeros((*stack, m + len(a), m + len(a)))
    closed[..., :m, :m], closed[..., :m, m:] = A - B @ d @ C, -B @ c
    closed[..., m:, :m], closed[..., m:, m:] = b @ C, a
    error = np.concatenate((-d @ C, np.broadcast_to(-c, (*stack, *c.shape))), axis=-1)
    return Matrices(closed, np.vstack((B, np.zeros((len(a), 1)))), error, np.eye(1))


def noise_response(plant: Matrices, law: Matrices) -> Matrices:
    """Closed loop from noise of the estimate to the correction."""
    A, B, C, _ = plant
    a, b, c, d = law
    closed = np.block([[A - B @ d @ C, -B @ c], [b @ C, a]])
    return Matrices(closed, np.vstack((-B @ d, b)), np.hstack((d @ C, c)), d)
