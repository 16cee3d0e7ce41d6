"""Solvers that the kernel is measured against, each behind the same small interface.

All solve the same right-hand side (`plant.right_hand_side`) between the same cuts, restart
at each cut, and are given the closed form where no cylinder breathes. The state is scaled by
`state_scale` in their absolute tolerances.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Protocol

import numpy as np

from plant.intake_problem import IntakeProblem, IntakeSolution
from plant.kinematics import FloatArray
from plant.right_hand_side import STATE_STRIDE

Run = Callable[[], IntakeSolution]

TOLERANCES = tuple(10.0 ** (-k / 2.0) for k in range(4, 19))  # 1e-2 to 1e-9
STEPS_US = tuple(2.0**-k for k in range(-7, 5))  # 128 to 1/16

# Size of manifold mass (kg); of cylinder mass (kg), velocity (m/s), its rate (m/s2), work (J).
_SCALE = np.array([1e-3, 5e-4, 50.0, 5e4, 10.0])


class Peer(Protocol):
    """A solver of initial value problems."""

    @property
    def name(self) -> str:
        """Name in the table."""

    @property
    def note(self) -> str:
        """How it reaches the right-hand side, and what else a reader must know."""

    @property
    def compiled(self) -> bool:
        """Whether it runs without calling back into Python."""

    @property
    def unit(self) -> str:
        """What a setting is: a relative tolerance, or a step in microseconds."""

    @property
    def settings(self) -> tuple[float, ...]:
        """Settings to try, the loosest first."""

    def prepare(self, problem: IntakeProblem, setting: float) -> Run:
        """Do all that is done once, and return what integrates the cycle.

        A run raises RuntimeError if the solver gives up.
        """


def state_scale(size: int) -> FloatArray:
    """Size of each entry of a state of `size` entries."""
    return np.concatenate([_SCALE[:1], np.tile(_SCALE[1:], size // STATE_STRIDE)])


def installed_peers() -> tuple[list[Peer], dict[str, str]]:
    """Return the peers that can run here, and for the others their name and what they lack."""
    from ._casadi_peer import CasadiCvodes
    from ._explicit_peers import ExplicitEuler, RungeKutta4
    from ._scipy_peers import ScipyOdeint, ScipySolveIvp

    peers: list[Peer] = [
        ScipyOdeint(),
        ScipySolveIvp("LSODA"),
        ScipySolveIvp("BDF"),
        ScipySolveIvp("Radau"),
    ]
    missing = {}
    if find_spec("sksundae"):
        from ._sundials_peer import SundialsCvode

        peers.append(SundialsCvode())
    else:
        missing["CVODE (scikit-sundae)"] = "not installed: pip install 'camless-ctrl[bench]'"
    peers.append(CasadiCvodes())
    if find_spec("numbalsoda"):
        from ._numbalsoda_peer import NumbaLsoda

        peers.append(NumbaLsoda())
    else:
        missing["LSODA (numbalsoda)"] = (
            "not installed: pip install numbalsoda (no wheels; it needs a Fortran compiler)"
        )
    return [*peers, ExplicitEuler(), RungeKutta4()], missing
