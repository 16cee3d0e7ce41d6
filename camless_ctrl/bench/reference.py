"""Converged solutions by a general solver at a tight tolerance, the truth of the benchmark."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from plant.errors import ConvergenceError
from plant.intake_problem import IntakeProblem, IntakeSolution
from plant.right_hand_side import MASS

from ._scipy_peers import ScipyOdeint
from .peers import Peer, state_scale
from .points import BenchPoint, relative_errors

RTOL = 1e-10
METHOD = f"scipy LSODA at rtol {RTOL:g}, repeated until periodic"
PERIODIC = 1e-7  # largest change of a mass over a cycle, relative
MOST_CYCLES = 100


@dataclass(frozen=True)
class Reference:
    """The periodic cycle at one point.

    Attributes
    ----------
    point : BenchPoint
        The point.
    problem : IntakeProblem
        The cycle from its periodic state, for solvers to be timed on.
    solution : IntakeSolution
        Its end.
    change : float
        Change of the masses over the cycle, relative.
    """

    point: BenchPoint
    problem: IntakeProblem
    solution: IntakeSolution
    change: float

    def errors(self, charge: np.ndarray, loss: np.ndarray) -> tuple[float, float]:
        """Errors of other results for this point, as `relative_errors`."""
        truth = self.solution
        return relative_errors(charge, loss, truth.air_charge, truth.pumping_loss)

    def __str__(self) -> str:
        """Return the point, charge and loss of the first cylinder."""
        truth = self.solution
        return (
            f"{self.point}: charge {1e6 * truth.air_charge[0]:.3f} mg, loss "
            f"{truth.pumping_loss[0]:.4f} J (periodic to {self.change:.0e})"
        )


def solve_reference(
    point: BenchPoint, peer: Peer | None = None, setting: float = RTOL
) -> Reference:
    """Repeat the cycle with a general solver until it is periodic.

    The kernel at a fine resolution gives the state to start from, and nothing else: the
    cycle must repeat for the general solver.

    Raises
    ------
    ConvergenceError
        If the cycle does not become periodic.
    """
    solver = ScipyOdeint() if peer is None else peer
    problem = IntakeProblem.from_cycle(point.converged_cycle)
    for _ in range(MOST_CYCLES):
        solution = solver.prepare(problem, setting)()
        change = _change(problem, solution)
        if change <= PERIODIC:
            return Reference(point, problem, solution, change)
        problem = problem.restarted(solution)
    raise ConvergenceError(
        f"no periodic reference after {MOST_CYCLES} cycles at {point}: the last change was "
        f"{change:.1e}, but must be at most {PERIODIC:.1e}: leave this point out"
    )


def solve_references(
    points: Sequence[BenchPoint], progress: Callable[[int, int], None] | None = None
) -> list[Reference]:
    """Solve the reference at each point."""
    found = []
    for k, point in enumerate(points):
        if progress is not None:
            progress(k, len(points))
        found.append(solve_reference(point))
    return found


def _change(problem: IntakeProblem, solution: IntakeSolution) -> float:
    manifold = float(np.abs(solution.manifold / problem.manifold - 1.0)[0])
    tables = problem.tables
    inherited = [
        j for j in tables.breathing[0, : tables.n_breathing[0]] if not tables.opening[0, j]
    ]
    masses = solution.cylinders[inherited, MASS] - problem.cylinders[inherited, MASS]
    return max([manifold, *(np.abs(masses) / state_scale(5)[1 + MASS])])
