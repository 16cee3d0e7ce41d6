"""Results held against the requirements that they decide, for report and command line alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .closed_loop_result import ClosedLoopResult, averaged
from .requirements import RequirementResult, evaluate

if TYPE_CHECKING:
    from plant.map_results import BoundaryError, MapError
    from plant.throttled import ThrottleStep
    from plant.validation import ValidationReport
    from uncertainty.quantification_result import Quantification

    from .estimation_check import EstimationCheck
    from .false_alarms import FalseAlarmCount
    from .fault_check import FaultRow, FaultTable
    from .feedforward_check import FeedforwardCheck
    from .loop_verdict import LoopVerdict
    from .performance import PerformanceTable
    from .robust_analysis import RobustAnalysis
    from .robustness import RobustnessResult
    from .scenario_suite import ScenarioSuite
    from .structured_robustness import StructuredRobustness

SENSORS = ("maf", "map", "duration", "speed")  # targets of faults
AFTER_CYCLES = 10  # after each load step, before errors are averaged


def assess_validation(report: ValidationReport) -> list[RequirementResult]:
    """Requirements on the published figures that can be met."""
    errors = [abs(row.relative_error) for row in report.figures if not row.known_exception]
    lost = [c.id for c in report.claims if not (c.reproduced or c.known_exception)]
    return [
        evaluate("published-claims", len(lost), ", ".join(lost)),
        evaluate("published-worst", 100.0 * max(errors)),
        evaluate("published-rms", 100.0 * report.rms),
    ]


def assess_maps(error: MapError) -> list[RequirementResult]:
    """Requirements on the mean-value maps."""
    return [
        evaluate("map-charge-rms", 100.0 * error.charge_rms),
        evaluate("map-charge-worst", 100.0 * error.charge_max, f"at {error.worst_charge}"),
        evaluate("map-loss-rms", 100.0 * error.loss_rms),
        evaluate("map-loss-worst", 100.0 * error.loss_max, f"at {error.worst_loss}"),
    ]


def assess_boundary(error: BoundaryError) -> list[RequirementResult]:
    """Requirement on the maps at other boundary conditions."""
    return [evaluate("map-boundary-charge-rms", 100.0 * error.charge_rms)]


def assess_throttle_steps(steps: Sequence[ThrottleStep]) -> list[RequirementResult]:
    """Requirement on the throttled plant; the worst step of all runs counts."""
    worst = max(steps, key=lambda run: float(run.rms_each.max()))
    angles = ", ".join(f"{angle:g}" for angle in worst.throttles_deg)
    return [
        evaluate(
            "throttle-step",
            100.0 * float(worst.rms_each.max()),
            f"{angles} deg at {worst.speed_rpm:g} rpm",
        )
    ]


def assess_uncertainty(found: Quantification) -> list[RequirementResult]:
    """Requirements on the weights and on the share of the set that they cover."""
    worst = min(found.channels, key=lambda channel: channel.check.min_ratio)
    check = found.coverage
    return [
        evaluate("uncertainty-weights", found.least_ratio, worst.channel.name),
        evaluate(
            "uncertainty-coverage",
            check.p_value,
            f"{check.fresh_inside} of {check.fresh_samples} inside, "
            f"{100.0 * check.bound.share:g} % claimed",
        ),
    ]


def assess_robustness(
    results: Sequence[RobustnessResult | LoopVerdict],
) -> list[RequirementResult]:
    """Requirements on poles and margins of a loop, over all speeds analysed; NaN where unstable."""
    radii = [(mode.spectral_radius, r) for r in results for mode in r.modes]
    radius, at = max(radii, key=lambda pair: pair[0])
    worst = max(results, key=lambda r: r.worst[0])
    worst_radius, lag, delay = worst.worst
    return [
        evaluate("loop-spectral-radius", radius, f"at {at.speed_rpm:g} rpm"),
        evaluate(
            "loop-worst-spectral-radius",
            worst_radius,
            f"at {worst.speed_rpm:g} rpm, lag {1e3 * lag:.0f} ms, delay {1e3 * delay:.1f} ms",
        ),
        evaluate("loop-gain-margin", least(r.gain_margin for r in results)),
        evaluate("loop-disk-margin", least(r.disk_margin for r in results)),
        # The largest is the least of the negatives: a NaN must not be lost.
        evaluate("loop-small-gain", -least(-r.small_gain for r in results)),
    ]


def assess_structured(found: RobustAnalysis) -> list[RequirementResult]:
    """Requirements on the structured robustness of the loop and on its confirmation."""
    mus = [(_ceiling(s.structured), s.speed_rpm) for s in found.speeds]
    worst, at = max(mus, key=lambda pair: (math.isnan(pair[0]), pair[0]))
    # A loop that was not called robust may break: only what was proved can be contradicted.
    proved = [s for s in found.speeds if s.lti is not None and s.structured.robust_performance]
    linear = sum(s.lti.violations for s in proved if s.lti is not None)
    members = sum(s.lti.samples for s in proved if s.lti is not None)
    plants, runs = sum(s.plant_violations for s in proved), sum(len(s.plants) for s in proved)
    coverages = [
        (s.measurement.coverage.p_value, s.speed_rpm)
        for s in found.speeds
        if s.measurement.coverage is not None
    ]
    doubt, doubtful = min(coverages, default=(math.nan, math.nan))
    return [
        evaluate("loop-robust-performance", worst, f"at {at:g} rpm"),
        evaluate(
            "loop-sound",
            linear + plants if members and runs else math.nan,
            f"{linear} of {members} linear members, {plants} of {runs} full plants",
        ),
        evaluate("loop-coverage", doubt, f"at {doubtful:g} rpm"),
        _tight(found),
    ]


def _tight(found: RobustAnalysis) -> RequirementResult:
    """Requirement on the breaks: by gain at every speed, or by distance where all is adapted."""
    from .gain_break import WITHIN as GAIN_BREAK_WITHIN
    from .tightness import WITHIN as DISTANCE_WITHIN

    by_gain = any(s.gain_break is not None for s in found.speeds)
    counted = [s for s in found.speeds if by_gain or found.schedule.at(s.speed_rpm).imbalance > 0.0]
    off: dict[float, float] = {}  # relative deviation at each speed
    for s in found.speeds:
        check = s.gain_break if by_gain else s.tightness
        if check is not None:
            off[s.speed_rpm] = abs(check.ratio - 1.0)
    tried = {s.speed_rpm: off[s.speed_rpm] for s in counted if s.speed_rpm in off}
    note = "not tried at every such speed"
    if tried:
        speed = max(tried, key=lambda at: tried[at])
        what = "gains" if by_gain else "distance"
        note = f"{what} {100.0 * tried[speed]:.1f} % off at {speed:g} rpm, of {len(tried)} speeds"
    held = [f"{at:g} rpm {100.0 * part:.1f} %" for at, part in off.items() if at not in tried]
    if held:
        note += f"; the mean alone, not counted: {', '.join(held)}"
    complete = bool(counted) and len(tried) == len(counted)
    allowed = GAIN_BREAK_WITHIN if by_gain else DISTANCE_WITHIN
    return evaluate("loop-tight", max(tried.values()) / allowed if complete else math.nan, note)


def _ceiling(found: StructuredRobustness) -> float:
    """Bound of mu for performance at all frequencies; NaN without one."""
    performance = found.performance
    return performance.ceiling if performance is not None else math.nan


def assess_feedforward(check: FeedforwardCheck) -> list[RequirementResult]:
    """Requirement on the loss of the optimal path on the full plant."""
    k = int(np.argmax(check.excess))
    return [
        evaluate(
            "feedforward-loss",
            100.0 * check.worst,
            f"at {1e6 * check.charge[k]:.0f} mg, {check.speed_rpm[k]:.0f} rpm",
        )
    ]


def assess_estimation(check: EstimationCheck) -> list[RequirementResult]:
    """Requirements on the charge estimates against the full plant's charges."""
    worst = max(check.results, key=lambda r: float(np.max(np.abs(r.cylinder_errors))))
    sure = max(check.results, key=lambda r: r.consistency)
    odd = max(check.results, key=lambda r: abs(r.innovation_ratio - 1.0))
    return [
        evaluate(
            "estimate-cylinder",
            100.0 * check.worst_cylinder_error,
            f"at {worst.point.speed_rpm:g} rpm, {worst.n_cylinders} cylinders",
        ),
        evaluate(
            "estimate-honest",
            sure.consistency,
            f"at {sure.point.speed_rpm:g} rpm, {sure.n_cylinders} cylinders",
        ),
        evaluate(
            "estimate-innovation",
            abs(odd.innovation_ratio - 1.0),
            f"{odd.innovation_ratio:.2f} at {odd.point.speed_rpm:g} rpm, {odd.n_cylinders} "
            "cylinders",
        ),
    ]


def assess_performance(table: PerformanceTable, law: str) -> list[RequirementResult]:
    """Requirement on the bars of the performance table; one run a seed counts.

    Bars of single events under jitter do not count: the like cases without jitter do.
    """
    missed = [row for row in table.of(law) if not row.met]
    counted = [row for row in missed if not row.single]
    words = [
        f"{row.name}: {row.worst:.2f} % of {row.bar:g} %{' (jitter, not counted)' * row.single}"
        for row in missed
    ]
    return [
        evaluate(
            "controller-bars",
            len(counted) if table.of(law) else math.nan,
            "; ".join(words),
        )
    ]


def assess_load_step(runs: Sequence[ClosedLoopResult]) -> list[RequirementResult]:
    """Requirements on the load step with one weak cylinder, run with one or more seeds.

    Errors are those of the mean over the seeds; single runs are told in the note.
    """
    mean = averaged(runs)
    errors = [100.0 * run.worst_error(AFTER_CYCLES) for run in runs]
    imbalances = [100.0 * run.worst_imbalance(AFTER_CYCLES) for run in runs]
    return [
        evaluate("cylinder-error", 100.0 * mean.worst_error(AFTER_CYCLES), _single(errors)),
        evaluate("imbalance", 100.0 * mean.worst_imbalance(AFTER_CYCLES), _single(imbalances)),
        evaluate("command-lift-lowest", min(float(run.lift_mm.min()) for run in runs)),
        evaluate("command-lift-highest", max(float(run.lift_mm.max()) for run in runs)),
    ]


def _single(values: Sequence[float]) -> str:
    if len(values) == 1:
        return "one seed"
    middle = float(np.median(values))
    return f"{len(values)} seeds; one by one {middle:.2f} % median, {max(values):.2f} % worst"


def of_sensors(rows: Iterable[FaultRow]) -> list[FaultRow]:
    """Rows whose fault is one of a sensor or of the speed signal."""
    return [row for row in rows if row.fault.of_kind.target in SENSORS]


def assess_faults(table: FaultTable) -> list[RequirementResult]:
    """Requirements on faults: found or harmless, how soon, at what cost, and what is left after."""
    missed = ", ".join(row.fault.kind for row in table.missed)
    sensors = of_sensors(table.rows)
    late = _most(sensors, lambda row: row.detection_events)
    costly = _most(sensors, lambda row: 100.0 * row.during)
    left = _most(table.rows, lambda row: 100.0 * row.recovered)
    return [
        evaluate("faults-missed", len(table.missed) if table.rows else math.nan, missed),
        evaluate("fault-detection", *late),
        evaluate("fault-charge-error", *costly),
        evaluate("fault-recovery", *left),
    ]


def _most(rows: Iterable[FaultRow], figure: Callable[[FaultRow], float]) -> tuple[float, str]:
    """Largest figure of those that have one, and whose it is; NaN if none has."""
    known = [row for row in rows if not math.isnan(figure(row))]
    if not known:
        return math.nan, "no such fault"
    worst = max(known, key=figure)
    return figure(worst), worst.fault.kind


def assess_false_alarms(found: FalseAlarmCount) -> list[RequirementResult]:
    """Requirement on fault-free operation; fewer cycles than asked for decide nothing."""
    from .false_alarms import CYCLES

    names = ", ".join(f"{name} {count}" for name, count in found.by_name.items())
    if found.cycles < CYCLES:
        return [evaluate("false-alarms", math.nan, f"only {found.cycles} cycles were run")]
    return [evaluate("false-alarms", found.alarms, names)]


def assess_scenarios(suite: ScenarioSuite) -> list[RequirementResult]:
    """Requirement on the library of scenarios; misses by jitter alone are told, not counted."""
    words = [
        f"{check.result.scenario.name}: {check.verdict.requirement.name}"
        + " (jitter, not counted)" * check.jitter_alone
        for check in suite.missed
    ]
    counted = sum(check.counts for check in suite.checks)
    return [
        evaluate("scenario-requirements", counted if suite.checks else math.nan, "; ".join(words))
    ]


def least(values: Iterable[float]) -> float:
    """Smallest of the values; NaN if one of them is."""
    return float(np.min(np.fromiter(values, dtype=float)))


def as_dict(found: RequirementResult) -> dict[str, Any]:
    """Return a requirement and what was found, for JSON."""
    stated = found.requirement
    return {
        "name": stated.name,
        "description": stated.description,
        "sense": stated.sense,
        "bound": stated.bound,
        "value": found.value,
        "margin": found.margin,
        "unit": stated.unit,
        "met": found.met,
        "note": found.note,
        "source": stated.source,
    }


def sentence(found: RequirementResult) -> str:
    """Return what was found and what was asked, in words."""
    stated = found.requirement
    unit = "" if stated.unit == "1" else f" {stated.unit}"
    value = "was not found" if np.isnan(found.value) else f"is {found.value:.4g}{unit}"
    note = f" ({found.note})" if found.note else ""
    return f"{stated.name} {value}, but must be {stated.sense} {stated.bound:g}{unit}{note}"
