"""Runs of scenarios in a test session: designs made once, pictures of failures, a record."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest

from plant.errors import ConvergenceError, ParameterError, SimulationError

from .scenario_result import ScenarioResult

if TYPE_CHECKING:
    from plant import Engine

    from ._pytest_record import RunRecord
    from .closed_loop_requirement import ClosedLoopRequirement, Verdict
    from .controller_design import ControllerDesign
    from .scenario import Scenario

# What a scenario may run into that its author can mend. Anything else is a defect.
SCENARIO_ERRORS = (ParameterError, ConvergenceError, SimulationError)

_RUNS = pytest.StashKey["ScenarioRuns"]()


class RunScenario(Protocol):
    """What the fixture `run_scenario` is."""

    def __call__(
        self,
        scenario: Scenario | str | os.PathLike[str],
        *,
        seed: int | None = None,
        record_deg: float | None = None,
    ) -> ScenarioResult:
        """Run a scenario."""
        ...


def runs_of(config: pytest.Config) -> ScenarioRuns:
    """Return the runs of a session, the same ones each time."""
    if _RUNS not in config.stash:
        config.stash[_RUNS] = ScenarioRuns(config)
    return config.stash[_RUNS]


@dataclass(frozen=True, eq=False, repr=False)
class RecordedResult(ScenarioResult):
    """A result that records what is asked of it.

    Attributes
    ----------
    record : RunRecord
        The record.
    key : str
        Name of the run in the record.
    """

    record: RunRecord | None = field(default=None, repr=False)
    key: str = field(default="", repr=False)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts on the requirements of the scenario; they are recorded."""
        found = super().verdicts
        for verdict in found:
            self._record(verdict)
        return found

    def meets(self, requirement: ClosedLoopRequirement | str) -> Verdict:
        """Return the verdict on a requirement, as `ScenarioResult.meets` does; it is recorded."""
        verdict = super().meets(requirement)
        self._record(verdict)
        return verdict

    def _record(self, verdict: Verdict) -> None:
        if self.record is not None:
            self.record.verdict(self.key, verdict)


class ScenarioRuns:
    """Runs scenarios for the tests of one session.

    Parameters
    ----------
    config : pytest.Config
        Of the session.
    """

    def __init__(self, config: pytest.Config) -> None:
        from ._pytest_report import SessionReport

        self._root = config.rootpath
        self._plots = _plots_folder(config)
        report = config.pluginmanager.get_plugin("camless-report")
        self._record = report.record if isinstance(report, SessionReport) else None
        self._designs: dict[tuple[Any, ...], ControllerDesign] = {}

    def run(
        self,
        scenario: Scenario | str | os.PathLike[str],
        *,
        seed: int | None = None,
        record_deg: float | None = None,
    ) -> ScenarioResult:
        """Run a scenario.

        Parameters
        ----------
        scenario : Scenario, str or path-like
            The scenario; the path of a TOML file that holds one (ends in ``.toml``, relative to
            pytest's root folder); or the name of a shipped one.
        seed : int, optional
            Seed of noise and jitter; the scenario's own by default.
        record_deg : float, optional
            Step at which crank-level signals are kept, deg; none are by default.

        Raises
        ------
        ParameterError
            If there is no such scenario, or it cannot be run.
        """
        from .scenario_run import run_scenario

        which = self._scenario(scenario)
        try:
            result = run_scenario(which, self._design(which), seed=seed, record_deg=record_deg)
        except SCENARIO_ERRORS as error:
            if self._record is not None:
                self._record.failure(which.name, error)
            raise
        given: dict[str, Any] = {f.name: getattr(result, f.name) for f in fields(result)}
        given["plots_to"] = self._plots
        if self._record is not None:
            given |= {"record": self._record, "key": self._record.run(result)}
        return RecordedResult(**given)

    def design(self, engine: Engine) -> ControllerDesign:
        """Return the design of an engine's controller, made once in the session."""
        from .model_store import stored_design

        key = (engine, None, None)
        if key not in self._designs:
            self._designs[key] = stored_design(engine)
        return self._designs[key]

    def _design(self, scenario: Scenario) -> ControllerDesign:
        from .scenario_run import scenario_design

        key = (scenario.engine, scenario.assumed_sensors, scenario.controller.speed_range_rpm)
        if key not in self._designs:
            self._designs[key] = scenario_design(scenario)
        return self._designs[key]

    def _scenario(self, given: Scenario | str | os.PathLike[str]) -> Scenario:
        from .scenario import Scenario

        if isinstance(given, Scenario):
            return given
        if isinstance(given, os.PathLike) or str(given).endswith(".toml"):
            from .scenario_toml import load_scenario

            return load_scenario(self._root / given)
        from .shipped import shipped_scenario

        return shipped_scenario(given)


def _plots_folder(config: pytest.Config) -> Path:
    given = config.getoption("camless_plots")
    if given:
        return Path(config.invocation_params.dir / given)
    if config.pluginmanager.hasplugin("cacheprovider"):
        return Path(config.cache.mkdir("camless-plots"))
    return config.rootpath / ".camless-plots"
