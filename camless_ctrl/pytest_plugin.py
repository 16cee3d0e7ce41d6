"""Plugin of pytest: fixtures, scenarios in TOML files as tests, and a report of what was run.

pytest loads this module in every run of every environment that has the package, so it imports
nothing but pytest; the rest is loaded when a fixture or an option asks for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from plant import CrankAnglePlant, Engine, MeanValuePlant

    from ._pytest_runs import RunScenario
    from .controller_design import ControllerDesign


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the options."""
    group = parser.getgroup("camless", "closed-loop scenarios (camless-ctrl)")
    group.addoption(
        "--camless-scenarios",
        action="append",
        default=[],
        metavar="PATH",
        help="collect the scenarios in the TOML files of this folder, or in this file, as tests; "
        "may be given several times",
    )
    group.addoption(
        "--camless-plots",
        metavar="DIR",
        help="folder of the pictures of requirements that are not met (default: camless-plots in "
        "pytest's cache)",
    )
    group.addoption(
        "--camless-report",
        metavar="DIR",
        help="write the robustness report of the scenarios that were run to this folder",
    )
    parser.addini(
        "camless_scenarios",
        type="paths",
        default=[],
        help="folders or files of scenarios that are collected when pytest is given no path",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Load what the options ask for."""
    if config.getoption("camless_scenarios") or config.getini("camless_scenarios"):
        from ._pytest_scenarios import ScenarioCollection

        config.pluginmanager.register(ScenarioCollection(config), "camless-scenarios")
    if config.getoption("camless_report"):
        from ._pytest_report import SessionReport

        config.pluginmanager.register(SessionReport(config), "camless-report")


@pytest.fixture(scope="session")
def camless_engine() -> Engine:
    """Engine of the fixtures below: the paper's; a fixture of this name of your own replaces it."""
    from plant import Engine

    return Engine.paper()


@pytest.fixture(scope="session")
def camless_plant(camless_engine: Engine) -> CrankAnglePlant:
    """Full plant of `camless_engine`, runner and actuator oscillation on."""
    from plant import CrankAnglePlant

    return CrankAnglePlant(camless_engine, runner=True, oscillation=True)


@pytest.fixture(scope="session")
def camless_design(pytestconfig: pytest.Config, camless_engine: Engine) -> ControllerDesign:
    """Controller of `camless_engine`; made once, then read from disk."""
    from ._pytest_runs import runs_of

    return runs_of(pytestconfig).design(camless_engine)


@pytest.fixture(scope="session")
def camless_maps(camless_design: ControllerDesign) -> MeanValuePlant:
    """Maps of `camless_plant`, those of `camless_design`."""
    return camless_design.maps


@pytest.fixture(scope="session")
def run_scenario(pytestconfig: pytest.Config) -> RunScenario:
    """Call with a `Scenario`, a TOML file or the name of a shipped scenario: its result.

    ``run_scenario(scenario, *, seed=None, record_deg=None)``. Each call is a run of its own;
    designs are made once. ``result.meets(requirement)`` saves a picture when it is not met.
    """
    from ._pytest_runs import runs_of

    return runs_of(pytestconfig).run
