"""`camless bench`: time the full plant."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from ._common import MET, JsonFile, Quiet, bar, out, print_table

# Speed in rpm, lift in mm, duration in deg: idle, cruise, full load, high speed.
POINTS = ((750.0, 2.0, 60.0), (1500.0, 3.0, 189.0), (3000.0, 6.0, 200.0), (6000.0, 7.0, 220.0))


def bench(
    *,
    repeats: Annotated[int, Parameter(help="Periodic solutions timed at each point.")] = 30,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> int:
    """Time the full plant at a few points: microseconds per simulated engine cycle.

    A solution is timed as a user calls it, without traces: from rest to periodic, checks
    included; its time is divided by the cycles that it took. Compilation is left out. Run it
    on an idle machine.

    Example: camless bench --repeats 100
    """
    import statistics
    import time

    from plant import CrankAnglePlant, ValveCommand
    from plant._checks import whole

    from ..jsonable import to_json
    from ..output import reserved_file

    whole("repeats", repeats, 1, 100_000)
    plant = CrankAnglePlant()
    rows = []
    with reserved_file(json) as file:
        with bar("bench", quiet) as progress:
            for k, (speed, lift, duration) in enumerate(POINTS):
                progress(f"{speed:g} rpm", k, len(POINTS))
                command = ValveCommand(lift, duration)
                plant.steady_cycle(speed, command)  # compiles
                each = []
                for _ in range(repeats):
                    started = time.perf_counter()
                    cycle = plant.steady_cycle(speed, command)
                    each.append(1e6 * (time.perf_counter() - started) / cycle.cycles)
                rows.append(
                    {
                        "speed_rpm": speed,
                        "lift_mm": lift,
                        "duration_deg": duration,
                        "cycles": cycle.cycles,
                        "min_us_per_cycle": min(each),
                        "median_us_per_cycle": statistics.median(each),
                    }
                )
        if file is not None:
            content = {"n_cylinders": plant.engine.n_cylinders, "repeats": repeats, "points": rows}
            file.write(to_json(content))
    print_table(
        out(quiet),
        f"Time per simulated cycle of {plant.engine.n_cylinders} cylinders, {repeats} repeats",
        ["speed rpm", "lift mm", "duration deg", "cycles", "min us", "median us"],
        [
            [
                *(f"{row[name]:g}" for name in ("speed_rpm", "lift_mm", "duration_deg", "cycles")),
                f"{row['min_us_per_cycle']:.1f}",
                f"{row['median_us_per_cycle']:.1f}",
            ]
            for row in rows
        ],
    )
    return MET
