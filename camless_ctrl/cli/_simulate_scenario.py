"""`camless simulate SCENARIO`: run scenarios and hold them to their requirements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ._common import MET, NOT_MET, bar, out, print_table
from ._simulate_outputs import reserved_outputs, write_outputs

if TYPE_CHECKING:
    from rich.console import Console

    from ..closed_loop_requirement import Verdict
    from ..scenario import Scenario
    from ..scenario_result import ScenarioResult

_COLUMNS = ("requirement", "bound", "value", "where worst", "verdict", "source")
_WORDS = ("where worst", "verdict", "source")  # columns of them
_PART = "::"  # between a file and the name of one of its scenarios


def run_scenarios(
    name: str,
    outputs: Mapping[str, Path | None],
    crank_deg: float | None,
    seed: int | None,
    quiet: bool,
) -> int:
    """Run the scenarios of a file or folder, or a shipped one; return the exit status.

    Raises
    ------
    ParameterError
        If there is no such scenario, it is wrong, outputs are asked of several, or an output is
        a file that the scenario is read from.
    OutputError
        If an output cannot be made where it was asked for.
    """
    from plant import ParameterError
    from plant._checks import positive

    if crank_deg is not None:
        positive("--crank-deg", crank_deg, "deg")
        if outputs["--netcdf"] is None and outputs["--json"] is None:
            raise ParameterError(
                "--crank-deg asks for signals over the crank angle, but only --netcdf and --json "
                "keep them: give one of those too"
            )
    scenarios = find_scenarios(name)
    inputs = _inputs(name)
    asked = [option for option, path in outputs.items() if path is not None]
    if asked and len(scenarios) > 1:
        raise ParameterError(
            f"{asked[0]} takes one scenario, but {name} holds {len(scenarios)}: name one as "
            f"{name}{_PART}{scenarios[0].name}"
        )
    console, met = out(quiet), True
    with reserved_outputs(outputs, inputs) as places:
        for scenario in scenarios:
            result = _run(scenario, crank_deg, seed, quiet)
            write_outputs(result, places)
            _print(console, result)
            met = met and result.met
    return MET if met else NOT_MET


def list_scenarios(quiet: bool) -> int:
    """Print the shipped scenarios; return the exit status."""
    from ..shipped import shipped_scenarios

    console = out(quiet)
    for name, scenario in sorted(shipped_scenarios().items()):
        console.print(f"{name}: {' '.join(scenario.description.split())}", markup=False)
    return MET


def replay_result(path: Path, quiet: bool) -> int:
    """Run a saved result again and compare; return the exit status.

    Raises
    ------
    ParameterError
        If the file cannot be read, or holds no result.
    """
    from ..replay import replay_result as replayed

    with bar("replay", quiet):
        found = replayed(path)
    out(quiet).print(str(found), markup=False)
    return MET if found.same else NOT_MET


def find_scenarios(name: str) -> tuple[Scenario, ...]:
    """Return the scenarios that a word of the command line names.

    Parameters
    ----------
    name : str
        A file, a folder, ``FILE::NAME`` for one scenario of several, or a shipped scenario.

    Raises
    ------
    ParameterError
        If there is no such scenario, or the file is wrong.
    """
    from plant import ParameterError

    from ..scenario_toml import load_scenarios
    from ..shipped import shipped_scenarios

    text, _, part = name.partition(_PART)
    path = Path(text)
    if not path.is_file() and text in shipped_scenarios():
        found: tuple[Scenario, ...] = (shipped_scenarios()[text],)
    elif path.exists():
        found = load_scenarios(path)
    else:
        raise ParameterError(_unknown(text, list(shipped_scenarios())))
    if part:
        names = [scenario.name for scenario in found]
        found = tuple(scenario for scenario in found if scenario.name == part)
        if not found:
            raise ParameterError(
                f"{text} holds no scenario {part!r}, but {', '.join(names)}: name one of them"
            )
    return found


def _inputs(name: str) -> tuple[Path, ...]:
    """Files that the scenarios of `find_scenarios` are read from."""
    from .._scenario_inputs import input_files
    from ..shipped import FOLDER, shipped_scenarios

    text = name.partition(_PART)[0]
    path = Path(text)
    if not path.is_file() and text in shipped_scenarios():
        return tuple(FOLDER.iterdir())
    return input_files(path)


def _run(
    scenario: Scenario, crank_deg: float | None, seed: int | None, quiet: bool
) -> ScenarioResult:
    from ..scenario_run import run_scenario

    with bar(scenario.name, quiet) as progress:
        return run_scenario(scenario, seed=seed, progress=progress, record_deg=crank_deg)


def _print(console: Console, result: ScenarioResult) -> None:
    """Print what was run, its verdicts, and what else is to be told."""
    verdicts = result.verdicts
    if verdicts:
        title = f"{result.scenario.name} (seed {result.seed})"
        rows = [_row(verdict) for verdict in verdicts]
        print_table(console, title, _COLUMNS, rows, words=_WORDS)
        missed = sum(not verdict.met for verdict in verdicts)
        told = f"{missed} of {len(verdicts)} NOT MET" if missed else f"all {len(verdicts)} met"
    else:
        told = "states no requirement"
    for text in (told, *result.remarks):
        console.print(f"{result.scenario.name}: {text}", markup=False)


def _row(verdict: Verdict) -> tuple[str, ...]:
    stated = verdict.requirement
    unit = "" if stated.unit == "1" else f" {stated.unit}"
    value = "none" if math.isnan(verdict.value) else f"{verdict.value:.4g}{unit}"
    return (
        stated.name,
        f"{stated.sense} {stated.bound:g}{unit}",
        value,
        _where(verdict),
        "met" if verdict.met else "NOT MET",
        stated.source,
    )


def _where(verdict: Verdict) -> str:
    """Instant at which it was worst, and the note."""
    told = [] if math.isnan(verdict.time) else [f"{verdict.time:.2f} s"]
    if verdict.event is not None:
        told.append(f"event {verdict.event}")
    if verdict.cylinder is not None:
        told.append(f"cylinder {verdict.cylinder}")
    return "; ".join(filter(None, (", ".join(told), verdict.note)))


def _unknown(name: str, shipped: Sequence[str]) -> str:
    from difflib import get_close_matches

    near = get_close_matches(name, shipped, 1)
    hint = f", did you mean {near[0]}?" if near else ":"
    return (
        f"{name} is neither a file, nor a folder, nor a shipped scenario{hint} "
        "camless simulate --list names the shipped ones"
    )
