"""`camless simulate` without a scenario: a load step, or the cases of the performance table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._common import at_least_one, bar, out, print_requirements, status

if TYPE_CHECKING:
    from pathlib import Path

SPEED_RPM, DEMAND_MG, CYCLES = 1500.0, (170.0, 400.0, 170.0), 40  # unless others are given


def load_step(
    speed_rpm: float,
    demand_mg: tuple[float, ...],
    cycles: int,
    adapt: bool,
    seed: int,
    seeds: int,
    json: Path | None,
    quiet: bool,
) -> int:
    """Run load steps with one weak cylinder; return the exit status."""
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


def bars(seed: int, seeds: int, json: Path | None, quiet: bool) -> int:
    """Run every case of the performance table with all laws; return the exit status."""
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
