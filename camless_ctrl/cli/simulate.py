"""`camless simulate`: the controller in closed loop with the full plant."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from ._common import JsonFile, Quiet, Seed, at_least_one, bar, out, print_requirements, status

Demands = Annotated[
    tuple[float, ...],
    Parameter(
        name="--demand-mg",
        consume_multiple=True,
        negative=(),
        help="Demands in turn, mg per event.",
    ),
]


def simulate(
    *,
    speed_rpm: Annotated[float, Parameter(help="Engine speed, rpm.")] = 1500.0,
    demand_mg: Demands = (170.0, 400.0, 170.0),
    cycles: Annotated[int, Parameter(help="Engine cycles per demand.")] = 40,
    adapt: Annotated[
        bool, Parameter(negative="--feedforward-alone", help="Adapt a factor per cylinder.")
    ] = True,
    seed: Seed = 0,
    seeds: Annotated[
        int, Parameter(help="Runs, with this seed and the following; requirements hold the mean.")
    ] = 8,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> int:
    """Run load steps with one weak cylinder against the full plant, sensor lag and noise on.

    The exit status is 1 when a requirement on the load step is not met.

    Example: camless simulate --demand-mg 170 400 170 --json run.json
    """
    from plant._checks import in_range, positive, whole
    from plant._map_grid import SPEED_RANGE_RPM
    from plant.mean_value import MeanValuePlant

    from ..assessment import AFTER_CYCLES, as_dict, assess_load_step
    from ..closed_loop import averaged, run_load_step
    from ..jsonable import to_json
    from ..output import reserved_file

    at_least_one("--demand-mg", demand_mg)
    in_range("--speed-rpm", speed_rpm, *SPEED_RANGE_RPM, "rpm", remedy="the maps end there")
    for value in demand_mg:
        positive("--demand-mg", value, "mg")
    whole("--seed", seed, 0, 2**63 - 1)
    whole("--seeds", seeds, 1, 10_000)
    whole(
        "--cycles",
        cycles,
        AFTER_CYCLES + 1,
        100_000,
        remedy=f"errors are averaged from cycle {AFTER_CYCLES} on",
    )
    with reserved_file(json) as file:
        with bar("maps", quiet) as progress:
            maps = MeanValuePlant.fit(progress=lambda done, all_: progress("maps", done, all_))
            runs = []
            for k in range(seeds):
                progress("closed loop", k, seeds)
                runs.append(
                    run_load_step(
                        maps,
                        speed_rpm=speed_rpm,
                        demand_mg=demand_mg,
                        cycles=cycles,
                        seed=seed + k,
                        adapt=adapt,
                    )
                )
        found = assess_load_step(runs)
        result = runs[0]
        if file is not None:
            signals = {
                str(name): {"unit": signal.attrs["units"], "values": signal.to_numpy()}
                for name, signal in result.to_dataset().items()
            }
            content = {
                "name": result.name,
                "seed": result.seed,
                "seeds": seeds,
                "adapt": adapt,
                "signals": signals,
                "requirements": [as_dict(f) for f in found],
            }
            file.write(to_json(content))
    console = out(quiet)
    console.print(str(averaged(runs)), markup=False)
    print_requirements(console, found)
    return status(found)
