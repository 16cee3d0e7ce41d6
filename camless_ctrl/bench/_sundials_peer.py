"""SUNDIALS' CVODE through scikit-sundae."""

from __future__ import annotations

from dataclasses import dataclass

from sksundae.cvode import CVODE

from plant.intake_problem import IntakeProblem
from plant.kinematics import FloatArray
from plant.right_hand_side import FIRST_CYLINDER, STATE_STRIDE, jacobian, right_hand_side

from .peers import TOLERANCES, Run, state_scale

# As Numba calls them: the shortest way in from Python.
_RATE, _JACOBIAN = right_hand_side.dispatcher, jacobian.dispatcher


@dataclass
class _Parameters:
    """Parameters of the segment at hand; CVODE keeps the object that it is given."""

    values: FloatArray


def _rate(t: float, y: FloatArray, out: FloatArray, p: _Parameters) -> None:
    _RATE(t, y, p.values, out)


def _jacobian(t: float, y: FloatArray, _rate: FloatArray, out: FloatArray, p: _Parameters) -> None:
    _JACOBIAN(t, y, p.values, out)


@dataclass(frozen=True)
class SundialsCvode:
    """CVODE, BDF of variable order with a dense Newton matrix."""

    name: str = "CVODE (scikit-sundae)"
    note: str = "compiled right-hand side and Jacobian, called through Python"
    compiled: bool = False
    unit: str = "rtol"
    settings: tuple[float, ...] = TOLERANCES

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Make a solver for each length of the state, and return the run."""
        parameters = _Parameters(problem.tables.parameters[0])
        solvers = {}
        for count in set(problem.tables.n_breathing.tolist()) - {0}:
            size = FIRST_CYLINDER + STATE_STRIDE * count
            solvers[size] = CVODE(
                _rate, jacfn=_jacobian, userdata=parameters, rtol=setting,
                atol=setting * state_scale(size), max_num_steps=100_000,
            )  # fmt: skip

        def advance(start: float, end: float, y: FloatArray, p: FloatArray) -> FloatArray:
            parameters.values = p
            solver = solvers[y.size]
            solver.init_step(start, y)
            step = solver.step(end, tstop=end)
            if not step.success:
                raise RuntimeError(step.message)
            return step.y

        return lambda: problem.solve(advance)
