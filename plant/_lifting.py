"""A system whose matrices repeat after n events, lifted over the n events."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .kinematics import FloatArray

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def lifted(events: Sequence[Matrices]) -> Matrices:
    """Matrices ``A, B, C, D`` over a cycle of events with matrices of their own.

    Inputs and outputs are stacked event by event.

    Parameters
    ----------
    events : sequence of (A, B, C, D)
        Matrices of each event, in order.
    """
    states = events[0][0].shape[0]
    reach = np.eye(states)  # from the state at the start of the cycle
    from_inputs: list[FloatArray] = []  # from each event's input to the present state
    rows_C, rows_D = [], []
    for A, B, C, D in events:
        rows_C.append(C @ reach)
        rows_D.append([*(C @ g for g in from_inputs), D])
        reach = A @ reach
        from_inputs = [*(A @ g for g in from_inputs), B]
    outputs, inputs = events[0][3].shape
    whole_D = np.zeros((outputs * len(events), inputs * len(events)))
    for i, row in enumerate(rows_D):
        whole_D[i * outputs : (i + 1) * outputs, : (i + 1) * inputs] = np.hstack(row)
    return reach, np.hstack(from_inputs), np.vstack(rows_C), whole_D
