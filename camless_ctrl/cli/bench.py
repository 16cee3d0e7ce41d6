"""`camless bench`: time the full plant beside general solvers."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from ._common import MET, JsonFile, Quiet, Seed, bar, out, print_requirements, print_table

WIDTH = 140  # of the tables, which say too little when their words are broken


def bench(
    *,
    points: Annotated[
        int | None,
        Parameter(help="Points of the largest map; as many as half a minute allows by default."),
    ] = None,
    map_points: Annotated[
        int, Parameter(help="Points of the map at which the kernel's error is measured.")
    ] = 240,
    repeats: Annotated[int, Parameter(help="Timings of each kind; the least counts.")] = 20,
    quick: Annotated[
        bool, Parameter(negative="", help="A few points and repeats, to see that all works.")
    ] = False,
    json: JsonFile = None,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Measure the kernel's time and error beside general solvers on the same right-hand side.

    It measures and does not judge: a missed goal is shown as missed, and the exit status is 0.
    Run it on an idle machine.

    Example: camless bench --json bench.json
    """
    from ..bench import BenchOptions, run_bench
    from ..jsonable import to_json
    from ..output import reserved_file

    options = BenchOptions(
        repeats=min(repeats, 3) if quick else repeats,
        map_points=min(map_points, 6) if quick else map_points,
        matching_points=min(map_points, 2 if quick else 40),
        batch_points=100 if quick and points is None else points,
        processes=1 if quick else 5,
        seed=seed,
    )
    with reserved_file(json) as file:
        with bar("bench", quiet) as progress:
            result = run_bench(options, progress=progress)
        if file is not None:
            file.write(to_json(result.as_dict()))
    console = out(quiet)
    console.width = max(console.width, WIDTH)
    for table in result.tables():
        print_table(console, table.title, table.columns, table.rows)
    print_requirements(console, result.goals)
    for note in result.notes:
        console.print(note, markup=False)
    return MET
