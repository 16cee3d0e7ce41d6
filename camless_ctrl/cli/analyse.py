"""`camless analyse`: uncertainty of the mean-value plant, robustness of the controller's loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from ._common import (
    Bar,
    JsonFile,
    Quiet,
    Seed,
    at_least_one,
    bar,
    out,
    print_requirements,
    print_table,
    status,
)

if TYPE_CHECKING:
    from rich.console import Console

    from plant import MeanValuePlant
    from uncertainty.attribution_result import SobolResult
    from uncertainty.deltas import AllDeltas
    from uncertainty.quantification_result import Quantification

    from ..loop_verdict import LoopVerdict
    from ..robust_analysis import RobustAnalysis
    from ..robustness import RobustnessResult

Speeds = Annotated[
    tuple[float, ...],
    Parameter(
        name=["--speed-rpm", "--speed"], consume_multiple=True, negative=(), help="Speeds, rpm."
    ),
]


def analyse(
    *,
    speed_rpm: Speeds = (750.0, 1500.0, 3000.0, 4500.0, 6000.0),
    uncertainty: Annotated[
        bool, Parameter(help="Whether to quantify the uncertainty of the mean-value plant.")
    ] = True,
    robustness: Annotated[
        bool,
        Parameter(
            help="Whether to confirm the structured singular value with sampled full plants, and "
            "hold it against its requirements."
        ),
    ] = True,
    window: Annotated[
        bool,
        Parameter(
            negative="",
            help="Analyse the simple loop that is known in closed form instead: averages of the "
            "air flow over event windows, scheduled gains.",
        ),
    ] = False,
    seed: Seed = 0,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> int:
    """Quantify the uncertainty of the mean-value plant, and analyse the controller's loop.

    Uncertainty: deltas, weights with a guarantee that fresh full plants check, Sobol' indices.
    Loop: that of the designed controller, with its estimator and its law at rest. Poles, margins,
    and what they withstand, at each speed; then the structured singular value, confirmed with
    sampled full plants. The exit status is 1 when a requirement on either is not met.

    Example: camless analyse --speed-rpm 1500 6000 --json analysis.json
    Example: camless analyse --window --no-uncertainty
    """
    from plant._checks import in_range
    from plant._map_grid import SPEED_RANGE_RPM
    from plant.mean_value import MeanValuePlant

    from ..assessment import as_dict, assess_robustness, assess_structured, assess_uncertainty
    from ..jsonable import to_json
    from ..output import reserved_file

    at_least_one("--speed-rpm", speed_rpm)
    for speed in speed_rpm:
        in_range("--speed-rpm", speed, *SPEED_RANGE_RPM, "rpm", remedy="the maps end there")
    with reserved_file(json) as file:
        with bar("maps", quiet) as progress:
            maps = None
            if uncertainty or window:
                maps = MeanValuePlant.fit(progress=lambda done, all_: progress("maps", done, all_))
            quantified = _quantify(maps, seed, progress) if maps and uncertainty else None
            results: Sequence[RobustnessResult | LoopVerdict]
            if maps is not None and window:
                results, structured = _window(maps, speed_rpm, robustness, seed, progress)
            else:
                results, structured = _designed(speed_rpm, robustness, seed, progress)
        found = assess_robustness(results)
        if quantified is not None:
            found = [*assess_uncertainty(quantified[1]), *found]
        if structured is not None:
            found += assess_structured(structured)
        if file is not None:
            content: dict[str, Any] = {
                "loop": "event windows" if window else "designed controller",
                "speeds": [_speed(r) for r in results],
            }
            if quantified is not None:
                content["uncertainty"] = _content(*quantified)
            if structured is not None:
                content["robustness"] = structured.records()
            content["requirements"] = [as_dict(f) for f in found]
            file.write(to_json(content))
    console = out(quiet)
    if quantified is not None:
        _print(console, *quantified)
    for result in results:
        console.print(str(result), markup=False)
    if structured is not None:
        console.print(str(structured), markup=False)
    print_requirements(console, found)
    return status(found)


def _designed(
    speeds_rpm: tuple[float, ...], robustness: bool, seed: int, progress: Bar
) -> tuple[list[LoopVerdict], RobustAnalysis | None]:
    """Loop of the designed controller: poles and margins, and the analysis if it is asked for."""
    from .. import robust_analysis
    from ..controller_design import design_controller
    from ..loop_verdict import loop_verdicts

    found = robust_analysis.analyse_robustness(
        design_controller(progress=progress),
        speeds_rpm,
        confirm=robustness,
        seed=seed,
        progress=progress,
    )
    return loop_verdicts(found), found if robustness else None


def _window(
    maps: MeanValuePlant,
    speeds_rpm: tuple[float, ...],
    robustness: bool,
    seed: int,
    progress: Bar,
) -> tuple[list[RobustnessResult], RobustAnalysis | None]:
    """Loop of event windows, in closed form; and the analysis if it is asked for."""
    from .. import robust_analysis
    from ..robustness import analyse as run

    results = run(maps, speeds_rpm, progress=lambda done, all_: progress("speeds", done, all_))
    if not robustness:
        return results, None
    return results, robust_analysis.analyse_robustness(
        maps, speeds_rpm, seed=seed, progress=progress
    )


def _speed(r: RobustnessResult | LoopVerdict) -> dict[str, Any]:
    return {
        "speed_rpm": r.speed_rpm,
        "demand_mg": 1e6 * r.demand,
        "stable": r.stable,
        "robustly_stable": r.robustly_stable,
        "gain_margin": r.gain_margin,
        "disk_margin": r.disk_margin,
        "sensitivity_peak": r.sensitivity_peak,
        "gain_error": r.sensitivity_error,
        "small_gain": r.small_gain,
        "worst_spectral_radius": r.worst[0],
        "worst_lag_s": r.worst[1],
        "worst_delay_s": r.worst[2],
        "delay_limit_s": r.delay_limit,
        "delay_limit_mode": r.delay_limit_mode,
        "gains": r.gains,
        "modes": r.modes,
    }


def _quantify(
    maps: MeanValuePlant, seed: int, progress: Bar
) -> tuple[AllDeltas, Quantification, SobolResult]:
    from uncertainty.attribution import attribute
    from uncertainty.deltas import evaluate_all
    from uncertainty.quantification import quantify

    def told(what: str) -> Any:
        return lambda done, all_: progress(what, done, all_)

    return (
        evaluate_all(progress=told("deltas")),
        quantify(maps=maps, seed=seed, progress=told("weights")),
        attribute(seed=seed, progress=told("attribution")),
    )


def _content(deltas: AllDeltas, found: Quantification, sobol: SobolResult) -> dict[str, Any]:
    return {
        "deltas": deltas.records(),
        "weights": found.records(),
        "coverage": found.coverage.to_dict(),
        "sobol": sobol.records(),
    }


def _print(console: Console, deltas: AllDeltas, found: Quantification, sobol: SobolResult) -> None:
    console.print(str(deltas), markup=False)
    print_table(
        console,
        "Weights (MAF: with the nominal full plant's flow shape): largest magnitude, and ratio to "
        "the residual",
        ["channel", "order", "weight", "ratio", "reduction alone"],
        [
            [
                c.channel.name,
                str(c.weight.order),
                f"{100.0 * c.peak:.1f} %",
                f"{c.check.min_ratio:.3f} to {c.check.max_ratio:.2f}",
                f"{100.0 * c.reduction_error:.2f} %",
            ]
            for c in found.channels
        ],
    )
    console.print(str(found.coverage), markup=False)
    for quantity in sobol.quantities:
        for k in range(len(sobol.points)):
            console.print(sobol.sentence(quantity, k), markup=False)
