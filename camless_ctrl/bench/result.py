"""The result of a benchmark: tables to print, and JSON."""

from __future__ import annotations

import math
import os
import platform
from dataclasses import dataclass
from typing import Any

from ..assessment import as_dict
from ..requirements import RequirementResult
from .comparison import Comparison, PeerFigures
from .controller_timing import ControllerTiming
from .floor import STAGES
from .kernel_timing import KernelFigures, KernelSurvey
from .loop_timing import LoopTiming
from .points import BenchPoint
from .reference import METHOD
from .scaling import CylinderScaling, PointScaling, ThreadScaling
from .startup import Startup
from .table import Table

SECONDS_PER_CYCLE = 120.0  # over the speed in rpm


@dataclass(frozen=True)
class BenchResult:
    """All that one run of the benchmark measured.

    Attributes
    ----------
    nominal : tuple of KernelFigures
        Times of the kernel over speeds and commands of the nominal plant.
    call_us : float
        What a call from Python adds to that, us.
    stage_ns : float
        Time of the two closed-form steps of a stage, ns.
    survey : KernelSurvey
        Errors and times of the kernel over the feasible map.
    comparison : Comparison
        The kernel beside other solvers.
    reference_error : float
        Largest difference of charge between the reference and another method at a tight
        tolerance, relative.
    threads, points, cylinders : ThreadScaling, PointScaling, CylinderScaling
        Cost of maps.
    startup : Startup
        What a second process waits for.
    controller : ControllerTiming
        One update of the air-charge controller.
    loop : LoopTiming
        Controller, plant and sensors in closed loop.
    goals : tuple of RequirementResult
        The goals, met or missed.
    """

    nominal: tuple[KernelFigures, ...]
    call_us: float
    stage_ns: float
    survey: KernelSurvey
    comparison: Comparison
    reference_error: float
    threads: ThreadScaling
    points: PointScaling
    cylinders: CylinderScaling
    startup: Startup
    controller: ControllerTiming
    loop: LoopTiming
    goals: tuple[RequirementResult, ...]

    @property
    def us_per_cycle(self) -> float:
        """The kernel's time of a cycle, us: the worst over the nominal points."""
        return max(found.us_per_cycle for found in self.nominal)

    def floor_us(self, found: KernelFigures) -> float:
        """What the chain of closed-form steps in a cycle would take alone, us."""
        return 1e-3 * found.steps_per_cycle * STAGES * self.stage_ns

    def tables(self) -> tuple[Table, ...]:
        """Return what is to be printed."""
        return (
            self._peer_table(),
            self._nominal_table(),
            self._survey_table(),
            self._cost_table(),
            self.loop.table(),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the tables must know."""
        by_note: dict[str, list[str]] = {}
        for peer in self.comparison.peers:
            by_note.setdefault(peer.note, []).append(peer.name)
        return (
            "All solve the same right-hand side from the same periodic state between the same cuts "
            "(IVO, IVC, corners of the lift), restart at each, and are given the closed form where "
            "no cylinder breathes. The least of several interleaved timings counts. Errors are the "
            "largest over their points and cylinders, relative to the value itself or to 50 mg and "
            "0.5 J; the kernel's are those of its own periodic cycles over the whole map. The "
            "kernel runs many cycles in a call from Python, the others one; what a call adds is "
            "told apart.",
            *(f"{', '.join(names)}: {note}." for note, names in by_note.items()),
            *(f"{name}: {why}." for name, why in self.comparison.missing.items()),
        )

    def __str__(self) -> str:
        """Return all tables and the goals as text."""
        goals = [
            f"{found.requirement}: {found.value:.4g}, {'met' if found.met else 'NOT MET'}"
            for found in self.goals
        ]
        return "\n\n".join([*map(str, self.tables()), "\n".join(goals)])

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        survey, comparison = self.survey, self.comparison
        return {
            "kernel": {
                "us_per_cycle": self.us_per_cycle,
                "call_us": self.call_us,
                "stage_ns": self.stage_ns,
                "max_charge_error": survey.worst_charge.charge_error,
                "max_loss_error": survey.worst_loss.loss_error,
                "points": len(survey.figures),
                "worst_charge_point": _point(survey.worst_charge.point),
                "worst_loss_point": _point(survey.worst_loss.point),
                "median_us_over_map": survey.median_us,
                "worst_us_over_map": survey.slowest.us_per_cycle,
                "nominal": [_figures(found) for found in self.nominal],
                "map": [_figures(found) for found in survey.figures],
            },
            "peers": [_peer(peer) for peer in comparison.peers],
            "not_installed": comparison.missing,
            "peer_points": [_point(point) for point in comparison.points],
            "kernel_us_at_peer_points": comparison.kernel_us,
            "matching_points": comparison.matching_points,
            "reference": {"method": METHOD, "charge_error": self.reference_error},
            "threads": {
                "efficiency": self.threads.efficiency,
                "points": self.threads.points,
                "points_per_second": self.threads.points_per_second,
                "cores": self.threads.cores,
            },
            "controller": {
                "step_us": self.controller.step_us,
                "estimator_us": self.controller.estimator_us,
                "model_us": self.controller.model_us,
                "law_us": self.controller.law_us,
            },
            "closed_loop": self.loop.as_dict(),
            "startup": {
                "import_s": self.startup.import_s,
                "first_cycle_s": self.startup.first_cycle_s,
                "processes": self.startup.processes,
            },
            "scaling": {
                "points": self.points.points,
                "seconds": self.points.seconds,
                "exponent": self.points.exponent,
                "left_out": self.points.left_out,
                "cylinders": self.cylinders.cylinders,
                "us_per_cycle": self.cylinders.us_per_cycle,
            },
            "goals": [as_dict(found) for found in self.goals],
            "machine": {
                "processor": platform.processor() or platform.machine(),
                "cores": os.cpu_count(),
                "system": platform.platform(),
                "python": platform.python_version(),
            },
        }

    def _peer_table(self) -> Table:
        c, s = self.comparison, self.survey
        speeds = [point.speed_rpm for point in c.points]
        rows = [
            (
                "this kernel",
                "",
                *(f"{us:.1f}" for us in c.kernel_us),
                _percent(s.worst_charge.charge_error),
                _percent(s.worst_loss.loss_error),
                "1",
                _real_time(c.kernel_us, speeds),
            )
        ]
        for peer in c.peers:
            m = peer.matched
            rows.append(
                (
                    peer.name,
                    f"{peer.unit} {m.setting:.2g}" + ("" if m.meets else " (misses)"),
                    *(f"{us:.0f}" for us in peer.us_per_cycle),
                    _percent(m.charge_error),
                    _percent(m.loss_error),
                    f"{peer.least_ratio:.1f}",
                    _real_time(peer.us_per_cycle, speeds),
                )
            )
        title = (
            "Microseconds a cycle at matched accuracy: each solver at one setting, the loosest "
            "that keeps charge within 0.02 % and loss within 0.1 % at all of "
            f"{c.matching_points} points"
        )
        times = tuple(f"{speed:.0f} rpm" for speed in speeds)
        columns = ("solver", "setting", *times, "charge", "loss", "least ratio", "x real time")
        return Table(title, columns, tuple(rows))

    def _nominal_table(self) -> Table:
        rows = (
            *(
                (
                    str(f.point),
                    f"{f.us_per_cycle:.1f}",
                    f"{f.steps_per_cycle:.0f}",
                    f"{self.floor_us(f):.1f}",
                )
                for f in self.nominal
            ),
            ("a call from Python adds", f"{self.call_us:.1f}", "", ""),
        )
        return Table(
            "This kernel, nominal four-cylinder plant, one core, traces off; the floor is what "
            "the chain of closed-form steps alone would take",
            ("point", "us a cycle", "steps", "floor us"),
            rows,
        )

    def _survey_table(self) -> Table:
        s = self.survey
        rows = [
            (
                "largest charge error",
                _percent(s.worst_charge.charge_error),
                str(s.worst_charge.point),
            ),
            ("largest loss error", _percent(s.worst_loss.loss_error), str(s.worst_loss.point)),
            ("median time of a cycle", f"{s.median_us:.1f} us", ""),
            ("longest time of a cycle", f"{s.slowest.us_per_cycle:.1f} us", str(s.slowest.point)),
        ]
        rows += [
            (
                f"{low:.0f} to {high:.0f} rpm, {n} points",
                f"median {median:.1f} us",
                f"longest {most:.1f} us",
            )
            for low, high, n, median, most in s.by_speed()
        ]
        title = (
            f"This kernel at {len(s.figures)} points of the map, against {METHOD} (another method "
            f"differs from that by {self.reference_error:.0e} in charge)"
        )
        return Table(title, ("figure", "value", "where"), tuple(rows))

    def _cost_table(self) -> Table:
        t, c, p = self.threads, self.cylinders, self.points
        rows = [
            ("map points a second, 1 thread", f"{t.points_per_second[0]:.0f}"),
            ("map points a second, 2 threads", f"{t.points_per_second[1]:.0f}"),
            (f"parallel efficiency ({t.cores} cores)", f"{t.efficiency:.2f}"),
            ("import plant, second process", f"{self.startup.import_s:.2f} s"),
            ("first cycle after that", f"{self.startup.first_cycle_s:.2f} s"),
            ("controller update", f"{self.controller.step_us:.1f} us"),
            ("of that, estimator", f"{self.controller.estimator_us:.1f} us"),
            ("of that, charge model", f"{self.controller.model_us:.1f} us"),
            ("of that, adaptation law", f"{self.controller.law_us:.1f} us"),
        ]
        rows += [
            (f"map of {size} points", f"{seconds:.3f} s, {1e6 * seconds / size:.0f} us a point")
            for size, seconds in zip(p.points, p.seconds, strict=True)
        ]
        rows += [(f"map of {n} points", f"left out: --points {n} does it") for n in p.left_out]
        rows.append(("map time grows with points to the power", f"{p.exponent:.3f}"))
        rows += [
            (f"cycle of {n} cylinder{'s' if n > 1 else ''}", f"{us:.1f} us, {us / n:.1f} us each")
            for n, us in zip(c.cylinders, c.us_per_cycle, strict=True)
        ]
        return Table("Maps, start-up, cylinders", ("figure", "value"), tuple(rows))


def _percent(error: float) -> str:
    return f"{100.0 * error:.4f} %" if math.isfinite(error) else "failed"


def _real_time(us: tuple[float, ...], speeds: list[float]) -> str:
    """How many times faster than the engine turns, at the least."""
    faster = min(1e6 * SECONDS_PER_CYCLE / n / t for t, n in zip(us, speeds, strict=True))
    return f"{faster:.0f}"


def _point(point: BenchPoint) -> dict[str, Any]:
    return {
        "speed_rpm": point.speed_rpm,
        "lift_mm": point.command.lift_mm,
        "duration_deg": point.command.duration_deg,
        "opening_deg": point.command.opening_deg,
        "throttle_deg": point.throttle_deg,
        "n_cylinders": point.engine.n_cylinders,
        "runner": point.runner,
        "oscillation": point.oscillation,
        "profile": point.profile,
    }


def _figures(found: KernelFigures) -> dict[str, Any]:
    return {
        **_point(found.point),
        "us_per_cycle": found.us_per_cycle,
        "steps_per_cycle": found.steps_per_cycle,
        "charge_error": found.charge_error,
        "loss_error": found.loss_error,
    }


def _peer(peer: PeerFigures) -> dict[str, Any]:
    m = peer.matched
    return {
        "name": peer.name,
        "us_per_cycle": max(peer.us_per_cycle),
        "charge_error": m.charge_error,
        "ratio": peer.least_ratio,
        "loss_error": m.loss_error,
        "accuracy_matched": m.meets,
        "setting": m.setting,
        "setting_unit": peer.unit,
        "us_at_peer_points": peer.us_per_cycle,
        "ratios": peer.ratios,
        "compiled": peer.compiled,
        "note": peer.note,
    }
