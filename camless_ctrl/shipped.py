"""The library of scenarios that the package brings along."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from plant._checks import one_of

from .scenario import Scenario
from .scenario_toml import load_scenarios

FOLDER = Path(__file__).with_name("scenarios")  # TOML files, and the tables that they name


@functools.cache
def shipped_scenarios() -> Mapping[str, Scenario]:
    """Return the scenarios of the package by name, in the order of their names."""
    return MappingProxyType({scenario.name: scenario for scenario in load_scenarios(FOLDER)})


def shipped_scenario(name: str) -> Scenario:
    """Return a scenario of the package.

    Raises
    ------
    ParameterError
        If there is none of that name; the message suggests the nearest one.
    """
    known = shipped_scenarios()
    return known[one_of("scenario", name, known)]
