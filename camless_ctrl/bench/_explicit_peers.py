"""Explicit methods of fixed step, compiled with the right-hand side."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plant._compile import compiled
from plant.intake_problem import (
    CHARGE,
    LOSS,
    IntakeProblem,
    IntakeSolution,
    IntakeTables,
    begin_segment,
    end_segment,
    fill_manifold,
)
from plant.right_hand_side import right_hand_side

from .peers import STEPS_US, Run

_NOTE = "compiled as a whole; fixed step"
CompiledCycle = Callable[[IntakeTables, np.ndarray, np.ndarray, float], None]


@compiled
def euler_cycle(
    tables: IntakeTables, manifold: np.ndarray, cylinders: np.ndarray, longest: float
) -> None:
    """Explicit Euler, in equal steps of at most `longest` seconds in each segment."""
    for k in range(len(tables.start)):
        if tables.n_breathing[k] == 0:
            fill_manifold(tables, k, manifold)
            continue
        y = begin_segment(tables, k, manifold, cylinders)
        f = np.empty_like(y)
        p, start = tables.parameters[k], tables.start[k]
        steps = math.ceil((tables.end[k] - start) / longest)
        h = (tables.end[k] - start) / steps
        for step in range(steps):
            right_hand_side(start + step * h, y, p, f)
            for i in range(y.size):
                y[i] += h * f[i]
        end_segment(tables, k, y, manifold, cylinders)


@compiled
def runge_kutta_cycle(
    tables: IntakeTables, manifold: np.ndarray, cylinders: np.ndarray, longest: float
) -> None:
    """Classical fourth-order Runge-Kutta, in steps as `euler_cycle`."""
    for k in range(len(tables.start)):
        if tables.n_breathing[k] == 0:
            fill_manifold(tables, k, manifold)
            continue
        y = begin_segment(tables, k, manifold, cylinders)
        size = y.size
        f, total, z = np.empty(size), np.empty(size), np.empty(size)
        p, start = tables.parameters[k], tables.start[k]
        steps = math.ceil((tables.end[k] - start) / longest)
        h = (tables.end[k] - start) / steps
        for step in range(steps):
            t = start + step * h
            right_hand_side(t, y, p, f)
            for i in range(size):
                total[i] = f[i]
                z[i] = y[i] + 0.5 * h * f[i]
            right_hand_side(t + 0.5 * h, z, p, f)
            for i in range(size):
                total[i] += 2.0 * f[i]
                z[i] = y[i] + 0.5 * h * f[i]
            right_hand_side(t + 0.5 * h, z, p, f)
            for i in range(size):
                total[i] += 2.0 * f[i]
                z[i] = y[i] + h * f[i]
            right_hand_side(t + h, z, p, f)
            for i in range(size):
                y[i] += h / 6.0 * (total[i] + f[i])
        end_segment(tables, k, y, manifold, cylinders)


def run_compiled(cycle: CompiledCycle, problem: IntakeProblem, setting: float) -> IntakeSolution:
    """Integrate a cycle with a compiled loop over its segments."""
    manifold, cylinders = problem.manifold.copy(), problem.cylinders.copy()
    cycle(problem.tables, manifold, cylinders, setting)
    charge, loss = cylinders[:, CHARGE].copy(), cylinders[:, LOSS].copy()
    if not np.all(np.isfinite(charge)):
        raise RuntimeError("the solution is not finite")
    return IntakeSolution(charge, loss, manifold, cylinders)


@dataclass(frozen=True)
class ExplicitEuler:
    """Explicit Euler in Numba."""

    name: str = "explicit Euler (Numba)"
    note: str = _NOTE
    compiled: bool = True
    unit: str = "us"
    settings: tuple[float, ...] = STEPS_US

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Return the run at a longest step in microseconds."""
        return lambda: run_compiled(euler_cycle, problem, 1e-6 * setting)


@dataclass(frozen=True)
class RungeKutta4:
    """Classical Runge-Kutta of fourth order in Numba."""

    name: str = "Runge-Kutta 4 (Numba)"
    note: str = _NOTE
    compiled: bool = True
    unit: str = "us"
    settings: tuple[float, ...] = STEPS_US

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Return the run at a longest step in microseconds."""
        return lambda: run_compiled(runge_kutta_cycle, problem, 1e-6 * setting)
