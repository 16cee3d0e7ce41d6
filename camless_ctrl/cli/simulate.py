"""`camless simulate`: the controller in closed loop with the full plant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ._common import JsonFile, Quiet

ScenarioName = Annotated[
    str | None,
    Parameter(
        help="A TOML file, one of its scenarios as FILE::NAME, a folder of such files, or the "
        "name of a shipped scenario."
    ),
]
Demands = Annotated[
    tuple[float, ...] | None,
    Parameter(
        name="--demand-mg",
        consume_multiple=True,
        negative=(),
        help="Load step: demands in turn, mg per event; 170 400 170 by default.",
    ),
]


def simulate(
    scenario: ScenarioName = None,
    /,
    *,
    plot: Annotated[
        Path | None, Parameter(help="Scenario: draw the run to this file (.png, .svg, .pdf).")
    ] = None,
    json: JsonFile = None,
    csv: Annotated[
        Path | None, Parameter(help="Scenario: write the signals of each event to this file.")
    ] = None,
    netcdf: Annotated[
        Path | None, Parameter(help="Scenario: write the signals with units to this file.")
    ] = None,
    crank_deg: Annotated[
        float | None,
        Parameter(
            help="Scenario: keep signals at about this step of the crank too, deg, with --netcdf "
            "or --json."
        ),
    ] = None,
    seed: Annotated[
        int | None,
        Parameter(help="Seed of all random work: the scenario's, or 0 by default."),
    ] = None,
    replay: Annotated[
        Path | None,
        Parameter(
            help="Run a result again that --json or --netcdf wrote; tell whether it is the same."
        ),
    ] = None,
    list_: Annotated[
        bool, Parameter(name="--list", negative="", help="Print the shipped scenarios.")
    ] = False,
    speed_rpm: Annotated[
        float | None, Parameter(help="Load step: engine speed, rpm; 1500 by default.")
    ] = None,
    demand_mg: Demands = None,
    cycles: Annotated[
        int | None, Parameter(help="Load step: engine cycles per demand; 40 by default.")
    ] = None,
    adapt: Annotated[
        bool | None,
        Parameter(
            negative="--feedforward-alone", help="Load step: adapt parameters of each cylinder."
        ),
    ] = None,
    bars: Annotated[
        bool,
        Parameter(
            negative="",
            help="Run the cases of the performance table with all laws instead of a load step.",
        ),
    ] = False,
    seeds: Annotated[
        int | None,
        Parameter(
            help="Load step: runs, with this seed and the following: 8 by default (requirements "
            "hold the mean), 20 with --bars (each run is held)."
        ),
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Run a scenario in closed loop with the full plant, and hold it to its requirements.

    Without a scenario, run load steps with one weak cylinder, sensors and actuators real. With
    --bars, run every case of the performance table: with the controller, with feedforward and
    integral correction alone, and with the LTI law of the robust synthesis.

    The exit status is 1 when a requirement is not met, with --bars when the controller misses a
    bar (bars of single events count where the valves do not jitter), and with --replay when the
    result is not the same bit for bit.

    Example: camless simulate scenario.toml --plot run.png --json run.json

    Example: camless simulate --replay run.json

    Example: camless simulate --demand-mg 170 400 170 --json run.json

    Example: camless simulate --bars --json bars.json
    """
    from plant._checks import whole

    of_scenario = {
        "--plot": plot,
        "--csv": csv,
        "--netcdf": netcdf,
        "--crank-deg": crank_deg,
    }
    of_step = {
        "--speed-rpm": speed_rpm,
        "--demand-mg": demand_mg,
        "--cycles": cycles,
        "--adapt or --feedforward-alone": adapt,
        "--seeds": seeds,
        "--bars": bars or None,
    }
    if seed is not None:
        whole("--seed", seed, 0, 2**63 - 1)
    if list_ or replay is not None:
        more = {"SCENARIO": scenario, "--json": json, "--seed": seed, **of_scenario, **of_step}
        if list_:
            _refuse({"--replay": replay, **more}, "--list takes no other option")
        else:
            _refuse(more, "--replay runs what the file says and writes nothing")
    elif scenario is not None:
        _refuse(of_step, "a scenario says that itself")
    else:
        _refuse(of_scenario, "it belongs to a scenario, and none is given")

    if list_:
        from ._simulate_scenario import list_scenarios

        return list_scenarios(quiet)
    if replay is not None:
        from ._simulate_scenario import replay_result

        return replay_result(replay, quiet)
    if scenario is not None:
        from ._simulate_scenario import run_scenarios

        outputs = {"--plot": plot, "--json": json, "--csv": csv, "--netcdf": netcdf}
        return run_scenarios(scenario, outputs, crank_deg, seed, quiet)

    from . import _simulate_load_step as step

    first = 0 if seed is None else seed
    runs = (20 if bars else 8) if seeds is None else seeds
    whole("--seeds", runs, 1, 10_000)
    if bars:
        return step.bars(first, runs, json, quiet)
    return step.load_step(
        step.SPEED_RPM if speed_rpm is None else speed_rpm,
        step.DEMAND_MG if demand_mg is None else demand_mg,
        step.CYCLES if cycles is None else cycles,
        adapt is not False,
        first,
        runs,
        json,
        quiet,
    )


def _refuse(options: Mapping[str, object], why: str) -> None:
    """Refuse options that would be passed over.

    Raises
    ------
    ParameterError
        If one is given.
    """
    from plant import ParameterError

    for option, value in options.items():
        if value is not None:
            raise ParameterError(f"{option} is given, but {why}: leave it out")
