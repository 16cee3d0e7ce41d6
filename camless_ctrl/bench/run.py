"""One run of the benchmark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from plant._checks import whole

from ._scipy_peers import ScipySolveIvp
from .comparison import compare
from .controller_timing import measure_controller
from .floor import stage_time_ns
from .goals import judge
from .kernel_timing import survey_kernel, time_call, time_kernel
from .loop_timing import measure_loop
from .peers import installed_peers
from .points import PEER_POINTS, BenchPoint, nominal_points, random_points
from .reference import Reference, solve_references
from .result import BenchResult
from .scaling import measure_cylinders, measure_points, measure_threads
from .startup import measure_startup

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class BenchOptions:
    """How much is measured.

    Attributes
    ----------
    repeats : int
        Timings of each kind, of which the least counts.
    map_points : int
        Random points of the map at which the kernel's error is measured.
    matching_points : int
        How many of them each peer must be as accurate at, besides the timed ones.
    batch_points : int or None
        Size of the largest map; None for what takes half a minute.
    processes : int
        Fresh processes for start-up.
    seed : int
        Of the points.
    """

    repeats: int = 20
    map_points: int = 240
    matching_points: int = 40
    batch_points: int | None = None
    processes: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        whole("repeats", self.repeats, 1, 100_000)
        whole("map_points", self.map_points, 1, 1_000_000)
        whole("matching_points", self.matching_points, 0, self.map_points)
        if self.batch_points is not None:
            whole("points", self.batch_points, 10, 10_000_000)
        whole("processes", self.processes, 1, 1000)
        whole("seed", self.seed, 0, 2**63 - 1)


def run_bench(
    options: BenchOptions | None = None,
    *,
    timed: tuple[BenchPoint, ...] = PEER_POINTS,
    progress: Progress | None = None,
) -> BenchResult:
    """Measure the kernel and its peers on this machine.

    Parameters
    ----------
    options : BenchOptions, optional
        How much is measured.
    timed : tuple of BenchPoint
        Where the solvers are timed.
    progress : callable, optional
        Called with what is being done, how much is done, and of how much.
    """
    options = options or BenchOptions()
    say = progress or (lambda label, done, total: None)
    say("start-up", 0, 1)
    startup = measure_startup(options.processes)
    points = [*timed, *random_points(options.map_points, options.seed)]
    references = solve_references(points, lambda done, total: say("reference", done, total))
    at_timed, over_map = references[: len(timed)], references[len(timed) :]
    survey = survey_kernel(
        over_map, min(options.repeats, 5), lambda done, total: say("kernel", done, total)
    )
    say("kernel", 0, 1)
    nominal = time_kernel(nominal_points(), options.repeats)
    call_us = time_call(options.repeats)
    peers, missing = installed_peers()
    comparison = compare(
        peers, missing, at_timed, over_map[: options.matching_points], options.repeats, say
    )
    say("threads", 0, 1)
    threads = measure_threads(min(options.repeats, 5))
    scaling = measure_points(options.batch_points, say)
    say("cylinders", 0, 1)
    cylinders = measure_cylinders(options.repeats)
    say("controller", 0, 1)
    controller = measure_controller(options.repeats)
    say("closed loop", 0, 1)
    loop = measure_loop(options.repeats)
    return BenchResult(
        nominal,
        call_us,
        stage_time_ns(),
        survey,
        comparison,
        _reference_error(at_timed),
        threads,
        scaling,
        cylinders,
        startup,
        controller,
        loop,
        judge(nominal, survey, comparison, threads, startup, controller, loop),
    )


def _reference_error(references: list[Reference]) -> float:
    """Largest difference of charge when another method solves the references' cycles."""
    other = ScipySolveIvp("Radau")
    found = 0.0
    for reference in references:
        solution = other.prepare(reference.problem, 1e-8)()
        found = max(found, reference.errors(solution.air_charge, solution.pumping_loss)[0])
    return found
