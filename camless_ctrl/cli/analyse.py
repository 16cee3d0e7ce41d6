"""`camless analyse`: robust stability of the air-charge loop."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from ._common import JsonFile, Quiet, at_least_one, bar, out, print_requirements, status

Speeds = Annotated[
    tuple[float, ...],
    Parameter(name="--speed-rpm", consume_multiple=True, negative=(), help="Speeds, rpm."),
]


def analyse(
    *,
    speed_rpm: Speeds = (750.0, 1500.0, 3000.0, 4500.0, 6000.0),
    json: JsonFile = None,
    quiet: Quiet = False,
) -> int:
    """Analyse poles, margins and uncertainty of the air-charge loop at each speed.

    The exit status is 1 when a requirement on the loop is not met.

    Example: camless analyse --speed-rpm 1500 6000 --json analysis.json
    """
    from plant._checks import in_range
    from plant._map_grid import SPEED_RANGE_RPM
    from plant.mean_value import MeanValuePlant

    from ..assessment import as_dict, assess_robustness
    from ..jsonable import to_json
    from ..output import reserved_file
    from ..robustness import analyse as run

    at_least_one("--speed-rpm", speed_rpm)
    for speed in speed_rpm:
        in_range("--speed-rpm", speed, *SPEED_RANGE_RPM, "rpm", remedy="the maps end there")
    with reserved_file(json) as file:
        with bar("maps", quiet) as progress:
            maps = MeanValuePlant.fit(progress=lambda done, all_: progress("maps", done, all_))
            results = run(
                maps, speed_rpm, progress=lambda done, all_: progress("speeds", done, all_)
            )
        found = assess_robustness(results)
        if file is not None:
            speeds = [
                {
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
                for r in results
            ]
            file.write(to_json({"speeds": speeds, "requirements": [as_dict(f) for f in found]}))
    console = out(quiet)
    for result in results:
        console.print(str(result), markup=False)
    print_requirements(console, found)
    return status(found)
