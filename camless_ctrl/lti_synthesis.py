"""H-infinity and D-K laws of the air-charge loop, one step an event.

Both ask for integral action at the harmonics of the cycle (`performance_weight`) under all
uncertainty as one complex weight, and differ in how they add the two: H-infinity bounds the
root of the sum of squares of ``|W1 S|`` and ``|W_a K S|``, D-K their sum, which is mu of the
complex set. A complex weight overstates real parameters. So the pace that W1 asks for and the
share of the uncertainty are varied, and every law is judged by the mixed mu of the whole set: of
those with mu at most `MU_LIMIT` for ``|S|`` at most 2, the one that settles fastest is taken. A
law that is unstable by itself is refused: it would run away when the correction is limited.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError
from plant._checks import in_range, positive
from plant.kinematics import FloatArray

from ._law_weights import (
    control_weight,
    mixed_plant,
    nominal_plant,
    performance_weight,
    structured_plant,
)
from ._loop_figures import mode_responses, settling
from ._rank_one import RankOneLoop, UncertainValues, mode_grid
from ._realised import Matrices, centre_of, matrices_of, sensitivity
from .adaptation import AdaptationGains
from .gain_synthesis import MU_LIMIT, confirmed, design_gains
from .synthesis.errors import SynthesisError
from .uncertain_loop import SENSITIVITY_BOUND, UncertainLoop
from .uncertain_measurement import UncertainMeasurement

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

    from .mu import MuResult
    from .synthesis import ReductionResult

SHARES = (0.2, 0.4, 0.7, 1.0)  # of the uncertainty, that H-infinity tries
DK_SHARES = (0.1, 0.4)  # that D-K tries
EFFORT = 0.05  # weight of the correction beside the uncertainty
_SCALES = (0.25, 1.3)  # of the paces, between which is sought
_STEPS = 5  # of each search for the pace
_IN_VAIN = 2  # trials in a row without a law that end the search for the pace
_FASTEST = 0.95  # pace per cycle that a weight can ask for
_CYCLES = 120  # in which a law must settle
_SLOWER = 1.1  # settling time that the reduction of the order may cost, a factor
_TOLERANCE = 0.01  # of each K step

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class LtiLaw:
    """Law per event that was synthesised, reduced and checked.

    Attributes
    ----------
    method : str
        ``H-infinity`` or ``D-K``.
    measurement : UncertainMeasurement
        What it was designed for.
    system : control.StateSpace
        The law: ``estimate`` in, ``correction`` out.
    paces : AdaptationGains
        What the performance weight asked for: gains per cycle of like integrators.
    share : float
        Share of the uncertainty in the synthesis.
    norm : float
        Norm that the synthesis reached before the reduction: of H-infinity, or the peak of mu
        of the complex set.
    mu_performance : float
        Largest mixed mu for robust performance with the whole uncertainty, on the grid.
    settling_cycles : tuple of float
        Cycles to 2 % of each mode in the middle of the set; infinite for a held mode.
    reduction : ReductionResult
        What each order gives.
    tried : tuple of (float, float, float, float)
        Share, scale of the paces, mu and settling (sum over modes, cycles) of every trial.
    confirmation : MuResult or None
        Proof of robust performance, if it was asked for.
    """

    method: str
    measurement: UncertainMeasurement = field(repr=False)
    system: control.StateSpace = field(repr=False)
    paces: AdaptationGains
    share: float
    norm: float
    mu_performance: float
    settling_cycles: tuple[float, ...]
    reduction: ReductionResult = field(repr=False)
    tried: tuple[tuple[float, float, float, float], ...] = field(repr=False)
    confirmation: MuResult | None = field(repr=False)

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.system.nstates)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the gain of the law over the angle per event."""
        from plant._plotting import COLOURS, axes, styled

        angle = mode_grid(self.measurement.n_cylinders, 60)
        with styled():
            ax = axes(ax)
            gain = np.abs(self.system(np.exp(1j * angle), warn_infinite=False))
            ax.semilogy(np.degrees(angle), gain, c=COLOURS[0])
            ax.set_xlim(0.0, 180.0)
            ax.set_xlabel("angle per event (deg)")
            ax.set_ylabel("correction over estimate (1)")
            ax.set_title(f"{self.method} law, order {self.order}")
        return ax

    def __str__(self) -> str:
        """Return method, order, norm, mu and settling."""
        proof = "not confirmed" if self.confirmation is None else "proved"
        times = ", ".join(
            f"q={q} {'held' if math.isinf(t) else f'in {t:.1f}'}"
            for q, t in enumerate(self.settling_cycles)
        )
        return (
            f"{self.method} law at {self.measurement.speed_rpm:g} rpm: order {self.order} (reduced "
            f"from {self.reduction.full_order}), {100.0 * self.share:.0f} % of the uncertainty in "
            f"the synthesis (norm {self.norm:.3f}), mu {self.mu_performance:.3f} with all of it "
            f"({proof}); settles, cycles: {times}"
        )


def hinf_law(
    measurement: UncertainMeasurement,
    paces: AdaptationGains | None = None,
    *,
    shares: tuple[float, ...] = SHARES,
    effort: float = EFFORT,
    sensitivity_bound: float = SENSITIVITY_BOUND,
    mu_limit: float = MU_LIMIT,
    timeout_s: float = 30.0,
    confirm: bool = True,
    progress: Progress | None = None,
) -> LtiLaw:
    """Return the H-infinity law of mixed sensitivity that settles fastest.

    Parameters
    ----------
    measurement : UncertainMeasurement
        Measurement at one speed.
    paces : AdaptationGains, optional
        Ratio of the paces of mean and imbalance, as gains per cycle; those of `design_gains` if
        left out. An imbalance of 0 holds the differences.
    shares : tuple of float
        Shares of the uncertainty to try.
    effort : float
        Weight of the correction beside the uncertainty.
    sensitivity_bound : float
        Bound on ``|S|`` over the whole set.
    mu_limit : float
        Largest mixed mu for robust performance that is allowed on the grid.
    timeout_s : float
        Time limit of each synthesis, s.
    confirm : bool
        Whether to prove the result with `mu.robust_performance` (some seconds).
    progress : callable, optional
        Called with the syntheses done and their number.

    Raises
    ------
    SynthesisError
        If no law is robust, a synthesis is stopped at its limit, or the proof fails.
    """
    from .synthesis import hinf_synthesis

    def build(plants: _Plants, share: float, asked: AdaptationGains) -> _Built:
        P = mixed_plant(plants.nominal, plants.performance(asked), plants.control(share))
        result = hinf_synthesis(P, 1, 1, timeout_s=timeout_s, tolerance=_TOLERANCE)
        return result.controller, result.gamma

    return _design(
        "H-infinity", build, measurement, paces, shares, effort, sensitivity_bound, mu_limit,
        confirm, progress,
    )  # fmt: skip


def dk_law(
    measurement: UncertainMeasurement,
    paces: AdaptationGains | None = None,
    *,
    shares: tuple[float, ...] = DK_SHARES,
    effort: float = EFFORT,
    iterations: int = 2,
    order: int = 1,
    sensitivity_bound: float = SENSITIVITY_BOUND,
    mu_limit: float = MU_LIMIT,
    timeout_s: float = 30.0,
    confirm: bool = True,
    progress: Progress | None = None,
) -> LtiLaw:
    """Return the law of D-K iteration that settles fastest.

    Its blocks are the uncertainty, complex, and the performance; with scalar blocks of one rank
    that is mu of the whole structure with the real parameters taken as complex. The verdict is
    the mixed mu of the true structure.

    Parameters
    ----------
    measurement, paces, shares, effort, sensitivity_bound, mu_limit, timeout_s, confirm, progress
        As in `hinf_law`.
    iterations, order : int
        Of each D-K iteration, see `synthesis.dk_synthesis`.

    Raises
    ------
    SynthesisError
        As in `hinf_law`.
    """
    from .synthesis import PerturbationBlock, dk_synthesis

    blocks = [PerturbationBlock(1, 1, "uncertainty"), PerturbationBlock(1, 1, "performance")]

    def build(plants: _Plants, share: float, asked: AdaptationGains) -> _Built:
        P = structured_plant(plants.nominal, plants.performance(asked), plants.control(share))
        result = dk_synthesis(
            P, blocks, 1, 1,
            iterations=iterations, order=order, timeout_s=timeout_s, tolerance=_TOLERANCE,
        )  # fmt: skip
        return result.controller, result.peak_mu

    return _design(
        "D-K", build, measurement, paces, shares, effort, sensitivity_bound, mu_limit,
        confirm, progress,
    )  # fmt: skip


_Built = tuple["control.StateSpace", float]


class _Plants:
    """Parts of the generalised plants at one speed, each made once."""

    def __init__(self, measurement: UncertainMeasurement, effort: float, bound: float) -> None:
        self.measurement, self.effort, self.bound = measurement, effort, bound
        self.nominal = nominal_plant(measurement)
        self._weights: dict[float, control.StateSpace] = {}

    def performance(self, paces: AdaptationGains) -> control.StateSpace:
        return performance_weight(self.measurement, paces, self.bound)

    def control(self, share: float) -> control.StateSpace:
        if share not in self._weights:
            self._weights[share] = control_weight(self.measurement, share, self.effort)
        return self._weights[share]


def stable_by_itself(law: control.StateSpace) -> bool:
    """Whether all poles of the law lie inside the unit circle."""
    return bool(np.all(np.abs(np.linalg.eigvals(np.asarray(law.A))) < 1.0))


class _Judge:
    """Mixed mu and settling of a law on one measurement."""

    def __init__(self, measurement: UncertainMeasurement, bound: float, held: bool) -> None:
        self.measurement, self.bound, self.held = measurement, bound, held
        self.values = UncertainValues.of(measurement, mode_grid(measurement.n_cylinders))
        self.plant = centre_of(measurement)

    def closed(self, law: control.StateSpace) -> Matrices:
        return sensitivity(self.plant, matrices_of(law))

    def stable(self, law: control.StateSpace) -> bool:
        """Whether the loop is stable, and the law itself as well."""
        loop = np.abs(np.linalg.eigvals(self.closed(law).A))
        return stable_by_itself(law) and bool(np.all(loop < 1.0))

    def mu(self, law: control.StateSpace) -> float:
        return float(RankOneLoop.of_law(self.values, law).mu_performance(self.bound).max())

    def settling(self, law: control.StateSpace) -> FloatArray:
        n = self.measurement.n_cylinders
        found = settling(mode_responses(self.closed(law), n, _CYCLES), n)
        return np.where(np.arange(found.size) > 0, np.inf, found) if self.held else found

    def total(self, law: control.StateSpace) -> float:
        """Sum of the settling times of the modes that are adapted."""
        found = self.settling(law)
        return float(found[0] if self.held else found.sum())


def _design(
    method: str,
    build: Callable[[_Plants, float, AdaptationGains], _Built],
    measurement: UncertainMeasurement,
    paces: AdaptationGains | None,
    shares: tuple[float, ...],
    effort: float,
    bound: float,
    mu_limit: float,
    confirm: bool,
    progress: Progress | None,
) -> LtiLaw:
    """Try shares and paces, take the fastest robust law, and reduce it."""
    positive("sensitivity_bound", bound, "1")
    positive("effort", effort, "1", remedy="without effort a synthesis may be ill-posed")
    in_range("mu_limit", mu_limit, 0.0, 1.0, "1", open_low=True)
    if not shares:
        raise ParameterError("shares is empty, but must name at least one share of the uncertainty")
    for share in shares:
        in_range("share", share, 0.0, 10.0, "1")
    if paces is None:
        paces = design_gains(
            measurement, sensitivity_bound=bound, mu_limit=mu_limit, confirm=False
        ).gains
    positive("paces.mean", paces.mean, "1")
    plants = _Plants(measurement, effort, bound)
    judge = _Judge(measurement, bound, paces.imbalance == 0.0)
    tried: list[tuple[float, float, float, float]] = []
    refused: list[str] = []
    best: tuple[float, control.StateSpace, AdaptationGains, float, float] | None = None
    for k, share in enumerate(shares):
        low, high = _SCALES
        in_vain = 0
        for step in range(_STEPS):
            done = _STEPS * k + step + 1
            scale = math.sqrt(low * high)
            asked = AdaptationGains(
                min(scale * paces.mean, _FASTEST), min(scale * paces.imbalance, _FASTEST)
            )
            mu = total = math.inf
            own, failed = True, False
            try:
                controller, norm = build(plants, share, asked)
            except SynthesisError as error:
                failed = True
                refused.append(f"share {share:g}, scale {scale:.2f}: {error}")
            else:
                law = _named(controller, measurement)
                own = stable_by_itself(law)
                if own and judge.stable(law):
                    mu, total = judge.mu(law), judge.total(law)
                if mu <= mu_limit and (best is None or total < best[0]):
                    best = (total, law, asked, share, norm)
            tried.append((share, scale, mu, total))
            # A law comes out unstable where little is asked of it.
            low, high = (scale, high) if mu <= mu_limit or not own else (low, scale)
            in_vain = in_vain + 1 if failed or not own else 0
            if progress is not None:
                progress(done, _STEPS * len(shares))
            if in_vain == _IN_VAIN:
                break
    if best is None or math.isinf(best[0]):
        table = "; ".join(
            f"share {s:g}, scale {c:.2f}: "
            + ("no stable loop" if math.isinf(mu) else f"mu {mu:.2f}")
            for s, c, mu, _ in tried
        )
        raise SynthesisError(
            f"no {method} law at {measurement.speed_rpm:g} rpm keeps mu below {mu_limit:g} and "
            f"settles within {_CYCLES} cycles ({table}"
            + (f"; failed: {'; '.join(refused)}" if refused else "")
            + "): try other shares or slower paces, or hold the imbalance"
        )
    total, law, asked, share, norm = best
    reduction = _reduced(law, judge, mu_limit, _SLOWER * total)
    system = _named(reduction.controller, measurement)
    loop = UncertainLoop(measurement, system, bound)
    return LtiLaw(
        method, measurement, system, asked, share, norm, judge.mu(system),
        tuple(judge.settling(system).tolist()), reduction, tuple(tried),
        confirmed(loop) if confirm else None,
    )  # fmt: skip


def _reduced(
    law: control.StateSpace, judge: _Judge, mu_limit: float, slowest: float
) -> ReductionResult:
    """Reduce the order as far as mu and settling allow."""
    from .synthesis import ClosedLoopCheck, reduce_controller

    def measure(trial: control.StateSpace) -> float:
        return max(judge.mu(trial) / mu_limit, judge.total(trial) / slowest)

    check = ClosedLoopCheck(judge.stable, measure, "mu or settling over what is allowed")
    # The full law is within both limits: allow the rise up to them.
    return reduce_controller(law, check, 1.0 / measure(law) - 1.0)


def _named(law: control.StateSpace, measurement: UncertainMeasurement) -> control.StateSpace:
    import control

    return control.ss(
        law.A, law.B, law.C, law.D, measurement.event_time,
        inputs=["estimate"], outputs=["correction"], name="law",
    )  # fmt: skip
