"""Scenarios in TOML files as tests: a file, its scenarios, their requirements."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from plant.errors import ParameterError

from ._pytest_runs import SCENARIO_ERRORS, runs_of
from .output import OutputError

if TYPE_CHECKING:
    from _pytest._code.code import TerminalRepr

    from .closed_loop_requirement import ClosedLoopRequirement, Verdict
    from .scenario import Scenario
    from .scenario_result import ScenarioResult

_NO_REQUIREMENT = "runs"  # name of the test of a scenario that requires nothing


class ScenarioCollection:
    """Collects the files that the option or the ini file names.

    Parameters
    ----------
    config : pytest.Config
        Of the session. Its arguments gain the files of the option, unless they name some of
        them already; those of the ini file are for a run without arguments.

    Raises
    ------
    pytest.UsageError
        If a path does not exist, or has no TOML file.
    """

    def __init__(self, config: pytest.Config) -> None:
        asked = [
            _absolute(config.invocation_params.dir / path)
            for path in config.getoption("camless_scenarios")
        ]
        known = [_absolute(path) for path in config.getini("camless_scenarios")]
        files = {place: _toml_files(place) for place in (*asked, *known)}
        self.files = frozenset(file for found in files.values() for file in found)
        named = [_absolute(config.invocation_params.dir / _path_of(arg)) for arg in config.args]
        if any(path in self.files for path in named):
            return  # single files or tests of them are asked for
        bare = config.args_source is not pytest.Config.ArgsSource.ARGS
        for place in (*asked, *(known if bare else ())):
            for file in files[place]:
                # pytest walks through its folders itself, and would take the file twice.
                if not any(file.is_relative_to(path) for path in named):
                    config.args.append(str(file))
                    named.append(file)

    def pytest_collect_file(
        self, file_path: Path, parent: pytest.Collector
    ) -> pytest.Collector | None:
        """Take the files that were asked for."""
        if _absolute(file_path) not in self.files:
            return None
        found: pytest.Collector = ScenarioFile.from_parent(parent, path=file_path)
        return found


class ScenarioFile(pytest.File):
    """A TOML file of scenarios."""

    def collect(self) -> Iterator[pytest.Collector]:
        """Read the file; one that cannot be read is an error that says where and why."""
        from .scenario_toml import load_scenarios

        try:
            scenarios = load_scenarios(self.path)
        except (ParameterError, OSError) as error:
            raise self.CollectError(str(error)) from error
        for scenario in scenarios:
            yield ScenarioCollector.from_parent(self, name=scenario.name, scenario=scenario)


class ScenarioCollector(pytest.Collector):
    """A scenario, run once for the tests of its requirements."""

    def __init__(self, *, scenario: Scenario, **given: Any) -> None:
        super().__init__(**given)
        self.scenario = scenario
        self._outcome: ScenarioResult | Exception | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """Yield a test for each requirement."""
        for requirement in self.scenario.requirements:
            yield RequirementItem.from_parent(self, name=requirement.name, requirement=requirement)
        if not self.scenario.requirements:
            yield RequirementItem.from_parent(self, name=_NO_REQUIREMENT, requirement=None)

    def result(self) -> ScenarioResult:
        """Return the result of the scenario; the first call runs it."""
        if self._outcome is None:
            try:
                self._outcome = runs_of(self.config).run(self.scenario)
            except SCENARIO_ERRORS as error:
                self._outcome = error
        if isinstance(self._outcome, Exception):
            raise self._outcome
        return self._outcome

    def teardown(self) -> None:
        """Forget the result: its last test is over."""
        self._outcome = None


class RequirementNotMetError(Exception):
    """Carries the verdict of a failed test."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(str(verdict))
        self.verdict = verdict


class RequirementItem(pytest.Item):
    """The test of one requirement of a scenario; None: that it runs."""

    def __init__(
        self,
        *,
        parent: ScenarioCollector,
        requirement: ClosedLoopRequirement | None,
        **given: Any,
    ) -> None:
        super().__init__(parent=parent, **given)
        self.of = parent
        self.requirement = requirement

    def runtest(self) -> None:
        """Run the scenario, if that is still to be done, and hold it against the requirement."""
        result = self.of.result()
        if self.requirement is None:
            return
        verdict = result.meets(self.requirement)
        self.user_properties += [
            ("value", float(verdict.value)),
            ("bound", float(self.requirement.bound)),
            ("unit", self.requirement.unit),
        ]
        if not verdict:
            raise RequirementNotMetError(verdict)

    def repr_failure(
        self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None
    ) -> str | TerminalRepr:
        """Say what was found instead of showing a traceback; a defect keeps its traceback."""
        error = excinfo.value
        if isinstance(error, RequirementNotMetError):
            return str(error)
        if isinstance(error, (*SCENARIO_ERRORS, OutputError)):
            return f"scenario {self.of.name}: {error}"
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[os.PathLike[str], None, str]:
        """Return file and title."""
        return self.path, None, f"{self.of.name}: {self.name}"


def _toml_files(place: Path) -> tuple[Path, ...]:
    if place.is_file():
        return (place,)
    if not place.is_dir():
        raise pytest.UsageError(f"no folder or file of scenarios: {place} does not exist")
    files = sorted(place.glob("*.toml"))  # not those of sub-folders, as `load_scenarios`
    if not files:
        raise pytest.UsageError(f"no scenarios: {place} has no .toml file")
    return tuple(files)


def _path_of(argument: str) -> str:
    """Return the path in an argument, which may name a test in it."""
    return argument.split("::", 1)[0]


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))
