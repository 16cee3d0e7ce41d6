"""Scenario files: TOML, with errors that name file, line, table, key and what is allowed."""

from __future__ import annotations

import re
import tomllib
from os import PathLike
from pathlib import Path
from typing import Any

from plant import ParameterError

from ._scenario_checks import check_design
from ._scenario_tables import ScenarioError, Table
from ._toml_lines import key_line
from .scenario import Scenario

_LIST = "scenario"  # name of the tables of a file that holds several


def load_scenario(path: str | PathLike[str]) -> Scenario:
    """Read the one scenario of a file.

    Parameters
    ----------
    path : path-like
        A TOML file; its keys are told in ``docs/scenarios.md``.

    Raises
    ------
    ParameterError
        If the file cannot be read, holds several scenarios, or is wrong: the message begins
        with ``FILE:LINE:``.
    """
    found = _read(Path(path))
    if len(found) != 1:
        raise ParameterError(
            f"{path} holds {len(found)} scenarios ({', '.join(s.name for s in found)}): read it "
            "with load_scenarios, or give a file with one"
        )
    return found[0]


def load_scenarios(path: str | PathLike[str]) -> tuple[Scenario, ...]:
    """Read all scenarios of a file, or of the TOML files of a folder in order of their names.

    Raises
    ------
    ParameterError
        If there is none, two have the same name, or a file is wrong: the message begins with
        ``FILE:LINE:``.
    """
    found: dict[str, tuple[Path, Scenario]] = {}
    for file in toml_files(Path(path)):
        for scenario in _read(file):
            if scenario.name in found:
                raise ParameterError(
                    f"{file} and {found[scenario.name][0]} both hold a scenario "
                    f"{scenario.name!r}: rename one"
                )
            found[scenario.name] = file, scenario
    return tuple(scenario for _, scenario in found.values())


def toml_files(place: Path) -> list[Path]:
    """Scenario files of a folder in order of their names, or the file itself.

    Raises
    ------
    ParameterError
        If the folder has none.
    """
    files = sorted(place.glob("*.toml")) if place.is_dir() else [place]
    if not files:
        raise ParameterError(f"{place} holds no scenario: put files *.toml there")
    return files


def _read(file: Path) -> list[Scenario]:
    """Scenarios of a file."""
    text, data = read_toml(file)
    try:
        return [_scenario(table, file.parent) for table in toml_tables(data)]
    except ScenarioError as error:
        raise ParameterError(f"{file}:{key_line(text, error.place)}: {error}") from error


def read_toml(file: Path) -> tuple[str, dict[str, Any]]:
    """Text and data of a TOML file.

    Raises
    ------
    ParameterError
        If it cannot be read, or is no TOML.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = (error.strerror or error) if isinstance(error, OSError) else error
        raise ParameterError(
            f"{file} cannot be read ({why}): give the name of a scenario file"
        ) from error
    try:
        return text, tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ParameterError(f"{file}:{_syntax_line(text, error)}: no TOML: {error}") from error


def _scenario(table: Table, folder: Path) -> Scenario:
    """Scenario of a table of a file, for which a design can be made."""
    scenario = Scenario.from_dict(table, folder)
    with table.around():
        check_design(scenario)
    return scenario


def toml_tables(data: dict[str, Any]) -> list[Table]:
    """Tables of the scenarios of a file.

    Raises
    ------
    ScenarioError
        If some keys belong to none of several scenarios.
    """
    whole = Table(data)
    if _LIST not in whole:
        return [whole]
    others = [key for key in data if key != _LIST]
    if others:
        raise ScenarioError(
            f"stands outside of [[{_LIST}]]: in a file with several scenarios each key belongs "
            "to one of them",
            (),
            others[0],
        )
    if not isinstance(data[_LIST], list) or not data[_LIST]:
        raise ScenarioError(f"must be given as [[{_LIST}]], once for each scenario", (), _LIST)
    return whole.tables(_LIST)


def _syntax_line(text: str, error: tomllib.TOMLDecodeError) -> int:
    """Line that a syntax error names, or the last one."""
    at = re.search(r"at line (\d+)", str(error))
    return int(at[1]) if at else text.count("\n") + 1
