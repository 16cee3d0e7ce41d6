"""The H-infinity problem as a stoppable process solves it: bisection, back-off, verification.

Each trial value of gamma is one call of SLICOT SB10AD for a suboptimal controller, so that
nothing here searches without an end. What the solver returns is believed only after the loop
has been closed with it by other code and its poles and its norm have been computed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.errors import ParameterError

from ._realisation import Realisation, close, grid_peak, hinf_norm, to_continuous, to_discrete
from .errors import SynthesisError

# Backing off from the smallest gamma keeps the controller's gains and poles moderate.
_BACK_OFF = (1.0, 3.0, 10.0, 30.0, 100.0)
_SMALLEST = 1e-9  # a gamma below this counts as zero
_WHY = {
    1: "the plant from control to errors has a zero on the stability boundary",
    2: "the plant from disturbances to measurements has a zero on the stability boundary",
    3: "D12 has not full column rank",
    4: "D21 has not full row rank",
    5: "a singular value decomposition did not converge",
    6: "gamma is too small for a controller",
    7: "the control Riccati equation has no solution",
    8: "the filter Riccati equation has no solution",
    9: "the feedthrough of the loop is singular",
    10: "singular values of D11 are ill-conditioned",
    11: "the feedthrough of the loop is singular",
    12: "no stabilising controller was found",
}


@dataclass(frozen=True)
class Solution:
    """Verified controller: its matrices, those of the loop closed with it, the bounds."""

    controller: Realisation
    closed_loop: Realisation
    norm: float  # of the closed loop, computed apart from the solver
    smallest: float  # smallest gamma at which a controller was found
    log: tuple[str, ...]


def solve(P: Realisation, n_meas: int, n_ctrl: int, discrete: bool, tolerance: float) -> Solution:
    """Return a controller whose closed-loop norm is within `tolerance` of the least.

    Raises
    ------
    SynthesisError
        If no gamma up to 1e12 admits a controller, or none that is found stands its
        verification.
    """
    problem = to_continuous(P) if discrete else P
    log: list[str] = []
    high, low = _bracket(problem, n_meas, n_ctrl, log)
    while high - low > 0.25 * tolerance * high and high > _SMALLEST:
        middle = float(np.sqrt(high * low)) if low > 0.1 * high else 0.5 * (high + low)
        norm, why = _trial(problem, middle, n_meas, n_ctrl)
        log.append(f"gamma {middle:.6g}: " + (why or f"closed-loop norm {norm:.6g}"))
        if why:
            low = middle
        else:
            high = min(middle, norm) if norm > low else middle
    for factor in _BACK_OFF:
        gamma = high * (1.0 + 0.5 * factor * tolerance)
        K, why = _suboptimal(problem, gamma, n_meas, n_ctrl)
        if K is None:
            log.append(f"back-off to gamma {gamma:.6g}: {why}")
            continue
        try:
            controller = to_discrete(K) if discrete else K
            loop = close(P, controller, n_meas, n_ctrl)
        except ParameterError as error:
            log.append(f"back-off to gamma {gamma:.6g}: {error}")
            continue
        norm, on_grid = hinf_norm(loop, discrete), 0.0
        if np.isfinite(norm):
            on_grid = grid_peak(loop, discrete)
        log.append(
            f"back-off to gamma {gamma:.6g}: verified norm {norm:.6g}, {on_grid:.6g} on a grid"
        )
        if norm <= high * (1.0 + factor * tolerance) and on_grid <= norm * (1.0 + 1e-6):
            return Solution(controller, loop, norm, high, tuple(log))
    raise SynthesisError(
        f"a controller was found down to gamma = {high:.4g}, but none between that and "
        f"{gamma:.4g} stood its verification ({log[-1]}): the problem is ill-conditioned; "
        "scale the plant's signals to about 1, keep weights within six decades, and raise very "
        "small regularising weights"
    )


def _bracket(P: Realisation, n_meas: int, n_ctrl: int, log: list[str]) -> tuple[float, float]:
    """A gamma that admits a controller, and a smaller one that does not (or zero)."""
    gamma, low = 1.0, 0.0
    while gamma <= 1e12:
        norm, why = _trial(P, gamma, n_meas, n_ctrl)
        log.append(f"gamma {gamma:.6g}: " + (why or f"closed-loop norm {norm:.6g}"))
        if not why:
            return min(gamma, norm) if norm > low else gamma, low
        low, gamma = gamma, 10.0 * gamma
    hint = ""
    if P.D.shape == (n_meas + n_ctrl, n_meas + n_ctrl):
        hint = (
            "; with as many errors as controls and as many disturbances as measurements the "
            "central controller may be improper: add a small W2 weight, of 1e-3 of the gain"
        )
    raise SynthesisError(f"no controller makes the closed-loop norm less than 1e12: {why}{hint}")


def _trial(P: Realisation, gamma: float, n_meas: int, n_ctrl: int) -> tuple[float, str]:
    """Closed-loop norm of the controller for `gamma`, or why it is none."""
    K, why = _suboptimal(P, gamma, n_meas, n_ctrl)
    if K is None:
        return float("inf"), why
    try:
        norm = hinf_norm(close(P, K, n_meas, n_ctrl), False, 1e-6)
    except ParameterError as error:
        return float("inf"), str(error)
    if np.isinf(norm):
        return norm, "the solver's controller does not stabilise the loop"
    if norm > gamma * (1.0 + 1e-4):
        return norm, f"the solver's controller gives {norm:.4g} instead"
    return norm, ""


def _suboptimal(
    P: Realisation, gamma: float, n_meas: int, n_ctrl: int
) -> tuple[Realisation | None, str]:
    """Controller of SB10AD at one gamma, or the reason for which there is none."""
    import slycot
    from slycot.exceptions import SlycotArithmeticError

    p, m = P.D.shape
    try:
        out = slycot.sb10ad(P.order, m, p, n_ctrl, n_meas, gamma, P.A, P.B, P.C, P.D, job=4)
    except SlycotArithmeticError as error:
        return None, _WHY.get(error.info, f"the solver failed with code {error.info}")
    matrices = [np.array(M, dtype=float) for M in out[1:5]]
    if not all(np.all(np.isfinite(M)) for M in matrices):
        return None, "the solver returned numbers that are not finite"
    return Realisation(*matrices), ""
