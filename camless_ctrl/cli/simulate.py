"""`camless simulate`: the controller in closed loop with the full plant."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from ._common import (
    JsonFile,
    Quiet,
    Seed,
    at_least_one,
    bar,
    out,
    print_requirements,
    status,
)

if TYPE_CHECKING:
    from pathlib import Path

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
        bool, Parameter(negative="--feedforward-alone", help="Adapt parameters of each cylinder.")
    ] = True,
    bars: Annotated[
        bool,
        Parameter(
            negative="",
            help="Run the cases of the performance table with all laws instead of a load step.",
        ),
    ] = False,
    seed: Seed = 0,
    seeds: Annotated[
        int | None,
        Parameter(
            help="Runs, with this seed and the following: 8 by default (requirements hold the "
            "mean), 20 with --bars (each run is held)."
        ),
    ] = None,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> int:
    """Run load steps with one weak cylinder against the full plant, sensors and actuators real.

    With --bars, run every case of the performance table: with the controller, with feedforward
    and integral correction alone, and with the LTI law of the robust synthesis.

    The exit status is 1 when a requirement on the load step is not met, or with --bars when the
    controller misses a bar; bars of single events count where the valves do not jitter.

    Example: camless simulate --demand-mg 170 400 170 --json run.json
    Example: camless simulate --bars --json bars.json
    """
    from plant._checks import whole

    runs = (20 if bars else 8) if seeds is None else seeds
    whole("--seed", seed, 0, 2**63 - 1)
    whole("--seeds", runs, 1, 10_000)
    if bars:
        return _bars(seed, runs, json, quiet)
    return _load_step(speed_rpm, demand_mg, cycles, adapt, seed, runs, json, quiet)


def _load_step(
    speed_rpm: float,
    demand_mg: tuple[float, ...],
    cycles: int,
    adapt: bool,
    seed: int,
    seeds: int,
    json: Path | None,
    quiet: bool,
) -> int:
    from plant._checks import in_range, positive, whole
    from plant._map_grid import SPEED_RANGE_RPM

    from ..assessment import AFTER_CYCLES, as_dict, assess_load_step
    from ..closed_loop_result import averaged
    from ..controller_design import design_controller
    from ..jsonable import to_json
    from ..load_step import run_load_step
    from ..output import reserved_file

    at_least_one("--demand-mg", demand_mg)
    in_range("--speed-rpm", speed_rpm, *SPEED_RANGE_RPM, "rpm", remedy="the maps end there")
    for value in demand_mg:
        positive("--demand-mg", value, "mg")
    whole(
        "--cycles",
        cycles,
        AFTER_CYCLES + 1,
        100_000,
        remedy=f"errors are averaged from cycle {AFTER_CYCLES} on",
    )
    with reserved_file(json) as file:
        with bar("maps", quiet) as progress:
            design = design_controller(progress=progress)
            controller = design.controller if adapt else design.feedforward_alone()
            runs = []
            for k in range(seeds):
                progress("closed loop", k, seeds)
                runs.append(
                    run_load_step(
                        controller,
                        speed_rpm=speed_rpm,
                        demand_mg=demand_mg,
                        cycles=cycles,
                        seed=seed + k,
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


def _bars(seed: int, seeds: int, json: Path | None, quiet: bool) -> int:
    from ..assessment import assess_performance
    from ..baselines import ADAPTIVE, LTI, baseline_controllers, lti_controller
    from ..controller_design import design_controller
    from ..jsonable import to_json
    from ..output import reserved_file
    from ..performance import measure_performance

    with reserved_file(json) as file:
        with bar("maps", quiet) as progress:
            design = design_controller(progress=progress)
            controllers = baseline_controllers(design)
            controllers[LTI] = lti_controller(design, seed=seed, progress=progress)
            table = measure_performance(
                controllers,
                design,
                seeds=seeds,
                seed=seed,
                progress=lambda done, total: progress("closed loop", done, total),
            )
        if file is not None:
            file.write(to_json(table.to_dict()))
    console = out(quiet)
    console.print("Performance on the full plant, median and worst seed:", markup=False)
    console.print(str(table), markup=False)
    found = assess_performance(table, ADAPTIVE)
    print_requirements(console, found)
    return status(found)
