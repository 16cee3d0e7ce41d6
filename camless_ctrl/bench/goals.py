"""What the kernel is to reach; the benchmark shows each goal met or missed."""

from __future__ import annotations

import math

from ..requirements import Requirement, RequirementResult
from .comparison import Comparison
from .controller_timing import ControllerTiming
from .kernel_timing import KernelFigures, KernelSurvey
from .loop_timing import LoopTiming
from .points import CHARGE_BAR, LOSS_BAR
from .scaling import ThreadScaling
from .startup import Startup

_SOURCE = "goal of the kernel"

TIME = Requirement(
    "kernel-time", 40.0, "us", "at most", _SOURCE,
    "Time of a four-cylinder cycle, traces off, on one core: the worst over speeds from 750 to "
    "6000 rpm of the nominal plant with runner",
)  # fmt: skip
CHARGE = Requirement(
    "kernel-charge", 100.0 * CHARGE_BAR, "%", "at most", _SOURCE,
    "Largest charge error over the map against the converged solution",
)  # fmt: skip
LOSS = Requirement(
    "kernel-loss", 100.0 * LOSS_BAR, "%", "at most", _SOURCE,
    "Largest pumping-loss error over the map against the converged solution",
)  # fmt: skip
LSODA = Requirement(
    "over-scipy-lsoda", 100.0, "1", "at least", _SOURCE,
    "Time of scipy's fastest LSODA over the kernel's at matched accuracy, at the worst point",
)  # fmt: skip
COMPILED = Requirement(
    "over-best-compiled", 10.0, "1", "at least", _SOURCE,
    "Time of the best general solver that never calls Python over the kernel's, at the worst point",
)  # fmt: skip
THREADS = Requirement(
    "thread-efficiency", 0.85, "1", "at least", _SOURCE,
    "Speed-up of a map by two threads, over two",
)  # fmt: skip
IMPORT = Requirement(
    "import", 0.5, "s", "at most", _SOURCE, "Time of `import plant` in a fresh process"
)  # fmt: skip
FIRST_CYCLE = Requirement(
    "first-cycle", 0.5, "s", "at most", _SOURCE,
    "Time from there to the first cycle, with machine code on disk",
)  # fmt: skip
UPDATE = Requirement(
    "controller-update", 50.0, "us", "at most", "goal of the controller",
    "Median time of one update of the air-charge controller in Python",
)  # fmt: skip

CLOSED_LOOP = Requirement(
    "closed-loop-speed", 20.0, "1", "at least", "goal of the closed loop",
    "Simulated over wall time of controller, full plant and sensors: four cylinders, 1500 rpm, "
    "one core",
)  # fmt: skip


def judge(
    nominal: tuple[KernelFigures, ...],
    survey: KernelSurvey,
    comparison: Comparison,
    threads: ThreadScaling,
    startup: Startup,
    controller: ControllerTiming,
    loop: LoopTiming,
) -> tuple[RequirementResult, ...]:
    """Hold what was measured against the goals."""
    slowest = max(nominal, key=lambda f: f.us_per_cycle)
    worst_charge, worst_loss = survey.worst_charge, survey.worst_loss
    lsoda = [p for p in comparison.peers if p.name.startswith("scipy LSODA")]
    compiled = [p for p in comparison.peers if p.compiled]
    return (
        RequirementResult(TIME, slowest.us_per_cycle, str(slowest.point)),
        RequirementResult(CHARGE, 100.0 * worst_charge.charge_error, str(worst_charge.point)),
        RequirementResult(LOSS, 100.0 * worst_loss.loss_error, str(worst_loss.point)),
        _least(LSODA, {p.name: p.least_ratio for p in lsoda}),
        _least(COMPILED, {p.name: p.least_ratio for p in compiled}),
        RequirementResult(THREADS, threads.efficiency, f"{threads.cores} cores"),
        RequirementResult(IMPORT, startup.import_s),
        RequirementResult(FIRST_CYCLE, startup.first_cycle_s),
        RequirementResult(UPDATE, controller.step_us, str(controller)),
        RequirementResult(CLOSED_LOOP, loop.times_real, str(loop)),
    )


def _least(goal: Requirement, ratios: dict[str, float]) -> RequirementResult:
    known = {name: ratio for name, ratio in ratios.items() if not math.isnan(ratio)}
    if not known:
        return RequirementResult(goal, math.nan, "no such solver ran")
    name = min(known, key=known.__getitem__)
    return RequirementResult(goal, known[name], name)
