"""`camless map`: the mean-value maps of charge and pumping loss, their regions and error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
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
    print_table,
    status,
)

if TYPE_CHECKING:
    from plant import CrankAnglePlant

SAMPLES = 1000  # random points at which the error is measured

Speeds = Annotated[
    tuple[float, ...],
    Parameter(name="--speed-rpm", consume_multiple=True, negative=(), help="Engine speeds, rpm."),
]
Lifts = Annotated[
    tuple[float, ...],
    Parameter(name="--lift-mm", consume_multiple=True, negative=(), help="Maximum lifts, mm."),
]
Durations = Annotated[
    tuple[float, ...],
    Parameter(name="--duration-deg", consume_multiple=True, negative=(), help="IVO to IVC, deg."),
]


Save = Annotated[Path | None, Parameter(name="--save", help="Write the maps to this netCDF file.")]
Load = Annotated[
    Path | None,
    Parameter(name="--load", help="Read the maps from this netCDF file instead of fitting them."),
]
Boundary = Annotated[
    bool,
    Parameter(
        name="--boundary-conditions",
        negative="",
        help="Fit other ambient pressures, temperatures and exhaust pressures too.",
    ),
]


def map_(
    *,
    speed_rpm: Speeds = (750.0, 1500.0, 3000.0, 6000.0),
    lift_mm: Lifts = (2.0, 4.0, 8.0),
    duration_deg: Durations = (60.0, 90.0, 120.0, 180.0, 240.0),
    boundary_conditions: Boundary = False,
    save: Save = None,
    load: Load = None,
    seed: Seed = 0,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> int:
    """Fit the mean-value maps of charge and pumping loss, and measure their error.

    Prints a table of the full plant (unthrottled, opening at TDC; a lift that the duration does
    not allow is limited, and marked so; a duration too short for any valve motion gives a
    dash), then the maps' regions and their error at 1000 random points against the full plant.

    Example: camless map --speed-rpm 1500 3000 --lift-mm 2 4 --duration-deg 90 180
    --save maps.nc
    """
    import math
    import time
    from dataclasses import asdict

    from plant import CrankAnglePlant, MeanValuePlant, ParameterError

    from ..assessment import as_dict, assess_maps
    from ..jsonable import to_json
    from ..output import require_place, reserved_file

    at_least_one("--speed-rpm", speed_rpm)
    at_least_one("--lift-mm", lift_mm)
    at_least_one("--duration-deg", duration_deg)
    if seed < 0:
        raise ParameterError(f"--seed is {seed}, but must be 0 or more")
    if save is not None:
        require_place(save)
        if json is not None and save.absolute() == json.absolute():
            raise ParameterError(f"--save and --json both name {save}: give them different files")
    plant = CrankAnglePlant()
    with reserved_file(json) as file:
        with bar("map", quiet) as progress:

            def step(label: str) -> Callable[[int, int], None]:
                return lambda done, of: progress(label, done, of)

            # The table first: it refuses bad points, and compiles the plant before the clock runs.
            rows = _table(plant, list(product(speed_rpm, lift_mm, duration_deg)), step("table"))
            begin = time.perf_counter()
            if load is None:
                maps = MeanValuePlant.fit(plant, progress=step("maps"))
            else:
                try:
                    maps = MeanValuePlant.load(load, plant)
                except OSError as fault:
                    raise ParameterError(
                        f"{load} cannot be read ({fault.strerror or fault}): name a file that "
                        "--save wrote"
                    ) from fault
            maps.largest_charge(maps.speeds_rpm)  # the surfaces are made on first use
            maps.largest_loss(maps.speeds_rpm)
            build_seconds = time.perf_counter() - begin if load is None else math.nan  # null
            if boundary_conditions and maps.boundary is None:
                maps = maps.with_boundary_conditions(plant, progress=step("boundary conditions"))
            error = maps.error_against(plant, samples=SAMPLES, seed=seed, progress=step("error"))
        regions = maps.regions(sorted({*map(float, speed_rpm)}))
        found = assess_maps(error)
        if save is not None:
            maps.save(save)
        if file is not None:
            content = {
                "build_seconds": build_seconds,
                "points": int(maps.charge.size),
                "error": {
                    name: getattr(error, name)
                    for name in ("charge_rms", "charge_max", "loss_rms", "loss_max", "points")
                },
                "loaded_from": None if load is None else str(load),
                "plant_fingerprint": plant.fingerprint,
                "provenance": maps.provenance,
                "boundary": None if maps.boundary is None else asdict(maps.boundary.error),
                "regions": regions.to_dataset().to_dict(),
                "requirements": [as_dict(row) for row in found],
                "table": rows,
            }
            file.write(to_json(content))
    console = out(quiet)
    print_table(
        console,
        "Charge and pumping loss per event, unthrottled (full plant); * lift limited by duration",
        ["speed rpm", "lift mm", "duration deg", "delivered mm", "charge mg", "loss J"],
        [_shown(row) for row in rows],
    )
    how = f"built in {build_seconds:.1f} s" if load is None else f"read from {load}"
    console.print(f"{maps}, {how}", markup=False)
    console.print(f"{error}", markup=False)
    if maps.boundary is not None:
        console.print(f"{maps.boundary.error}", markup=False)
    console.print(f"{regions}", markup=False)
    print_requirements(console, found)
    return status(found)


def _table(
    plant: CrankAnglePlant,
    points: Sequence[tuple[float, float, float]],
    progress: Callable[[int, int], None],
) -> list[dict[str, float | None]]:
    """Steady cycles of the full plant at speeds, lifts and durations."""
    from plant import InfeasibleProfileError, ValveCommand

    rows: list[dict[str, float | None]] = []
    for k, (speed, lift, duration) in enumerate(points):
        progress(k, len(points))
        row: dict[str, float | None] = {
            "speed_rpm": speed,
            "lift_mm": lift,
            "duration_deg": duration,
            "delivered_lift_mm": None,
            "air_charge_mg": None,
            "pumping_loss_J": None,
        }
        rows.append(row)
        try:
            cycle = plant.steady_cycle(speed, ValveCommand(lift, duration), on_infeasible="limit")
        except InfeasibleProfileError:
            continue  # no valve motion fits; the row stays empty
        row["delivered_lift_mm"] = float(cycle.delivered_lift_mm[0])
        row["air_charge_mg"] = 1e6 * float(cycle.air_charge.mean())
        row["pumping_loss_J"] = float(cycle.pumping_loss.mean())
    return rows


def _shown(row: dict[str, float | None]) -> list[str]:
    given = [f"{row[name]:g}" for name in ("speed_rpm", "lift_mm", "duration_deg")]
    lift, charge, loss = row["delivered_lift_mm"], row["air_charge_mg"], row["pumping_loss_J"]
    if lift is None:
        return [*given, "–", "–", "–"]
    limited = "*" if row["lift_mm"] != lift else ""
    return [*given, f"{lift:.2f}{limited}", f"{charge:.1f}", f"{loss:.2f}"]
