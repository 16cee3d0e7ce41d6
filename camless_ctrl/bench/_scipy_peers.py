"""scipy's solvers, with the compiled right-hand side and its Jacobian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.integrate import odeint, solve_ivp

from plant.intake_problem import IntakeProblem
from plant.kinematics import FloatArray
from plant.right_hand_side import jacobian, right_hand_side

from .peers import TOLERANCES, Run, state_scale

# As Numba calls them: the shortest way in from Python.
_RATE, _JACOBIAN = right_hand_side.dispatcher, jacobian.dispatcher
# Their stubs know neither tolerances by entry nor further arguments of a Jacobian.
_ODEINT: Any = odeint
_SOLVE_IVP: Any = solve_ivp
_NOTE = "compiled right-hand side and Jacobian, called through Python"


def rate(t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Right-hand side that returns a new array."""
    out = np.empty_like(y)
    _RATE(t, y, parameters, out)
    return out


def rate_jacobian(t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Jacobian that returns a new array."""
    out = np.empty((y.size, y.size))
    _JACOBIAN(t, y, parameters, out)
    return out


@dataclass(frozen=True)
class ScipyOdeint:
    """ODEPACK's LSODA through `scipy.integrate.odeint`: scipy's fastest way to it."""

    name: str = "scipy LSODA (odeint)"
    note: str = _NOTE
    compiled: bool = False
    unit: str = "rtol"
    settings: tuple[float, ...] = TOLERANCES

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Return the run at a relative tolerance."""

        def advance(start: float, end: float, y: FloatArray, p: FloatArray) -> FloatArray:
            states, told = _ODEINT(
                rate, y, [start, end], (p,), rate_jacobian, tfirst=True,
                rtol=setting, atol=setting * state_scale(y.size),
                mxstep=100_000, full_output=True,
            )  # fmt: skip
            if told["message"] != "Integration successful.":
                raise RuntimeError(told["message"])
            return states[-1]

        return lambda: problem.solve(advance)


@dataclass(frozen=True)
class ScipySolveIvp:
    """A method of `scipy.integrate.solve_ivp`."""

    method: Literal["LSODA", "BDF", "Radau"]
    note: str = _NOTE
    compiled: bool = False
    unit: str = "rtol"
    settings: tuple[float, ...] = TOLERANCES

    @property
    def name(self) -> str:
        """Name in the table."""
        return f"scipy {self.method} (solve_ivp)"

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Return the run at a relative tolerance."""

        def advance(start: float, end: float, y: FloatArray, p: FloatArray) -> FloatArray:
            solution = _SOLVE_IVP(
                rate, (start, end), y, self.method, args=(p,), jac=rate_jacobian,
                rtol=setting, atol=setting * state_scale(y.size),
            )  # fmt: skip
            if not solution.success:
                raise RuntimeError(solution.message)
            return solution.y[:, -1]

        return lambda: problem.solve(advance)
