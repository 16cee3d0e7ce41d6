"""LSODA in C++ through numbalsoda: no Python between solver and right-hand side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numbalsoda import lsoda, lsoda_sig

from plant.intake_problem import (
    IntakeProblem,
    IntakeTables,
    begin_segment,
    end_segment,
    fill_manifold,
)
from plant.right_hand_side import (
    COUNT,
    FIRST_CYLINDER,
    FIRST_VALVE,
    STATE_STRIDE,
    VALVE_STRIDE,
    right_hand_side,
)

from ._explicit_peers import run_compiled
from .peers import TOLERANCES, Run, state_scale

_ARRAY: Any = vars(numba)["carray"]  # its stubs do not export it
_SCALE = state_scale(FIRST_CYLINDER + 64 * STATE_STRIDE)


@numba.cfunc(lsoda_sig, error_model="numpy")
def _scaled_rate(t: float, u: Any, out: Any, data: Any) -> None:
    """Right-hand side of the scaled state: this solver takes one absolute tolerance."""
    count = int(_ARRAY(data, (1,))[COUNT])
    size = FIRST_CYLINDER + STATE_STRIDE * count
    parameters = _ARRAY(data, (FIRST_VALVE + VALVE_STRIDE * count,))
    scaled, scaled_rate = _ARRAY(u, (size,)), _ARRAY(out, (size,))
    y, rate = np.empty(size), np.empty(size)
    for i in range(size):
        y[i] = scaled[i] * _SCALE[i]
    right_hand_side(t, y, parameters, rate)
    for i in range(size):
        scaled_rate[i] = rate[i] / _SCALE[i]


_ADDRESS = _scaled_rate.address


@numba.njit(error_model="numpy", nogil=True)
def _lsoda_cycle(
    tables: IntakeTables, manifold: np.ndarray, cylinders: np.ndarray, tolerance: float
) -> None:
    times = np.empty(2)
    for k in range(len(tables.start)):
        if tables.n_breathing[k] == 0:
            fill_manifold(tables, k, manifold)
            continue
        y = begin_segment(tables, k, manifold, cylinders)
        times[0], times[1] = tables.start[k], tables.end[k]
        scale = _SCALE[: y.size]
        states, success = lsoda(
            _ADDRESS, y / scale, times, tables.parameters[k], tolerance, tolerance, 100000
        )
        end_segment(tables, k, states[1] * scale, manifold, cylinders)
        if not success:
            cylinders[:, :] = np.nan
            return


@dataclass(frozen=True)
class NumbaLsoda:
    """LSODA in C++, compiled with the right-hand side; it differences its own Jacobian."""

    name: str = "LSODA (numbalsoda)"
    note: str = "compiled as a whole; differences its own Jacobian"
    compiled: bool = True
    unit: str = "rtol"
    settings: tuple[float, ...] = TOLERANCES

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Return the run at a relative tolerance."""
        return lambda: run_compiled(_lsoda_cycle, problem, setting)
