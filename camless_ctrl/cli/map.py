"""`camless map`: charge and pumping loss over speed, lift and duration."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from ._common import MET, JsonFile, Quiet, at_least_one, bar, out, print_table

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


def map_(
    *,
    speed_rpm: Speeds = (750.0, 1500.0, 3000.0, 6000.0),
    lift_mm: Lifts = (2.0, 4.0, 8.0),
    duration_deg: Durations = (60.0, 90.0, 120.0, 180.0, 240.0),
    json: JsonFile = None,
    quiet: Quiet = False,
) -> int:
    """Tabulate charge and pumping loss of the full plant, unthrottled, opening at TDC.

    A lift that the duration does not allow at a speed is limited, and marked so; a duration
    too short for any valve motion gives a dash.

    Example: camless map --speed-rpm 1500 3000 --lift-mm 2 4 --duration-deg 90 180
    """
    from itertools import product

    from plant import CrankAnglePlant, InfeasibleProfileError, ValveCommand

    from ..jsonable import to_json
    from ..output import reserved_file

    at_least_one("--speed-rpm", speed_rpm)
    at_least_one("--lift-mm", lift_mm)
    at_least_one("--duration-deg", duration_deg)
    plant = CrankAnglePlant()
    points = list(product(speed_rpm, lift_mm, duration_deg))
    commands = [(speed, ValveCommand(lift, duration)) for speed, lift, duration in points]
    rows = []
    with reserved_file(json) as file:
        with bar("map", quiet) as progress:
            for k, (speed, command) in enumerate(commands):
                progress("map", k, len(commands))
                row = {
                    "speed_rpm": speed,
                    "lift_mm": command.lift_mm,
                    "duration_deg": command.duration_deg,
                    "delivered_lift_mm": None,
                    "air_charge_mg": None,
                    "pumping_loss_J": None,
                }
                rows.append(row)
                try:
                    cycle = plant.steady_cycle(speed, command, on_infeasible="limit")
                except InfeasibleProfileError:
                    continue  # no valve motion fits; the row stays empty
                row["delivered_lift_mm"] = float(cycle.delivered_lift_mm[0])
                row["air_charge_mg"] = 1e6 * float(cycle.air_charge.mean())
                row["pumping_loss_J"] = float(cycle.pumping_loss.mean())
        if file is not None:
            file.write(to_json({"plant_fingerprint": plant.fingerprint, "points": rows}))
    print_table(
        out(quiet),
        "Charge and pumping loss per event, unthrottled (full plant); * lift limited by duration",
        ["speed rpm", "lift mm", "duration deg", "delivered mm", "charge mg", "loss J"],
        [_shown(row) for row in rows],
    )
    return MET


def _shown(row: dict[str, float | None]) -> list[str]:
    given = [f"{row[name]:g}" for name in ("speed_rpm", "lift_mm", "duration_deg")]
    lift, charge, loss = row["delivered_lift_mm"], row["air_charge_mg"], row["pumping_loss_J"]
    if lift is None:
        return [*given, "–", "–", "–"]
    limited = "*" if row["lift_mm"] != lift else ""
    return [*given, f"{lift:.2f}{limited}", f"{charge:.1f}", f"{loss:.2f}"]
