"""The kernel against other solvers at matched accuracy.

The kernel has one setting for the whole map. Each peer has one too: the loosest of its settings
whose error is within the bars at every one of the matching points, the timed points among
them. It is then timed at the timed points, interleaved with the kernel and the others.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .kernel_timing import KernelTimer
from .peers import Peer
from .points import CHARGE_BAR, LOSS_BAR, BenchPoint
from .reference import Reference

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class MatchedSetting:
    """The setting of a peer and its largest errors over the matching points."""

    setting: float
    charge_error: float
    loss_error: float

    @property
    def meets(self) -> bool:
        """Whether both errors are within the bars."""
        return self.charge_error <= CHARGE_BAR and self.loss_error <= LOSS_BAR

    def __str__(self) -> str:
        """Return setting and errors."""
        return (
            f"{self.setting:.2g}: charge {100 * self.charge_error:.4f} %, "
            f"loss {100 * self.loss_error:.4f} %"
        )


@dataclass(frozen=True)
class PeerFigures:
    """One solver beside the kernel.

    Attributes
    ----------
    name, note, unit : str
        What it is, how it reaches the right-hand side, and what its setting means.
    compiled : bool
        Whether it runs without calling back into Python.
    matched : MatchedSetting
        Its setting and errors.
    us_per_cycle : tuple of float
        Time of a cycle at each timed point, us; NaN where the solver gave up.
    ratios : tuple of float
        Those over the kernel's at the same points.
    """

    name: str
    note: str
    unit: str
    compiled: bool
    matched: MatchedSetting
    us_per_cycle: tuple[float, ...]
    ratios: tuple[float, ...]

    @property
    def least_ratio(self) -> float:
        """Ratio at the point where the kernel gains least."""
        return min(self.ratios)

    def __str__(self) -> str:
        """Return name, setting, worst time and least ratio."""
        return (
            f"{self.name} at {self.unit} {self.matched}; at most {max(self.us_per_cycle):.0f} us "
            f"a cycle, at least {self.least_ratio:.1f} times the kernel's"
        )


@dataclass(frozen=True)
class Comparison:
    """The kernel and its peers at the timed points."""

    points: tuple[BenchPoint, ...]
    kernel_us: tuple[float, ...]
    peers: tuple[PeerFigures, ...]
    missing: dict[str, str]
    matching_points: int

    def __str__(self) -> str:
        """Return a line for each peer."""
        return "\n".join(
            [*map(str, self.peers), *(f"{name}: {why}" for name, why in self.missing.items())]
        )


def match_setting(peer: Peer, references: Sequence[Reference]) -> MatchedSetting:
    """Find the loosest setting that keeps a peer within the bars at all points.

    If none does, the one with the smallest errors at the last point that it missed; its
    errors tell.
    """
    order = list(references)
    found = []
    for setting in peer.settings:
        charge = loss = 0.0
        for reference in order:
            try:
                solution = peer.prepare(reference.problem, setting)()
            except RuntimeError:  # the solver gave up
                charge = loss = math.inf
            else:
                errors = reference.errors(solution.air_charge, solution.pumping_loss)
                charge, loss = max(charge, errors[0]), max(loss, errors[1])
            if not (charge <= CHARGE_BAR and loss <= LOSS_BAR):
                # This point is hard for the solver: ask it first next time.
                order.remove(reference)
                order.insert(0, reference)
                break
        else:
            return MatchedSetting(setting, charge, loss)
        found.append(MatchedSetting(setting, charge, loss))
    return min(found, key=lambda m: max(m.charge_error / CHARGE_BAR, m.loss_error / LOSS_BAR))


def compare(
    peers: Sequence[Peer],
    missing: dict[str, str],
    timed: Sequence[Reference],
    matching: Sequence[Reference],
    repeats: int,
    progress: Progress | None = None,
) -> Comparison:
    """Match every peer's accuracy and time it beside the kernel.

    Parameters
    ----------
    peers : sequence of Peer
        The solvers.
    missing : dict
        Solvers that are not installed, and why.
    timed, matching : sequence of Reference
        Where they are timed; where else they must be within the bars.
    repeats : int
        Timings of each solver at each point, of which the least counts.
    """
    say = progress or (lambda label, done, total: None)
    matched = []
    for k, peer in enumerate(peers):
        say(f"accuracy of {peer.name}", k, len(peers))
        matched.append(match_setting(peer, [*timed, *matching]))
    kernel_us, peer_us = [], []
    for k, reference in enumerate(timed):
        say(f"times at {reference.point.speed_rpm:g} rpm", k, len(timed))
        kernel = KernelTimer(reference.point.cycle()).time
        runs = [
            _timer(peer.prepare(reference.problem, m.setting))
            for peer, m in zip(peers, matched, strict=True)
        ]
        for run in runs:
            run()  # compiles, and warms the caches
        rounds = [[timer() for timer in (kernel, *runs)] for _ in range(repeats)]
        least = [1e6 * min(times) for times in zip(*rounds, strict=True)]
        kernel_us.append(least[0])
        peer_us.append(least[1:])
    figures = []
    for k, (peer, m) in enumerate(zip(peers, matched, strict=True)):
        times = tuple(row[k] for row in peer_us)
        ratios = tuple(t / own for t, own in zip(times, kernel_us, strict=True))
        figures.append(
            PeerFigures(peer.name, peer.note, peer.unit, peer.compiled, m, times, ratios)
        )
    return Comparison(
        tuple(reference.point for reference in timed),
        tuple(kernel_us),
        tuple(figures),
        missing,
        len(timed) + len(matching),
    )


def _timer(run: Callable[[], object]) -> Callable[[], float]:
    def timer() -> float:
        started = time.perf_counter()
        try:
            run()
        except RuntimeError:  # the solver gave up
            return math.nan
        return time.perf_counter() - started

    return timer
