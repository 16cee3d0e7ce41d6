"""The robustness report of a test session, written by the process that leads it."""

from __future__ import annotations

import os
import shlex
import shutil
import tempfile
from pathlib import Path
from typing import Any

import pytest

from ._pytest_record import RunRecord
from .output import OutputError

_WORKER_INPUT = "camless_record"  # path of the shared folder, for the workers of pytest-xdist
TITLE = "Closed-loop scenarios of a test run: robustness report"


class SessionReport:
    """Keeps the record of a session, and writes the report when it ends.

    Parameters
    ----------
    config : pytest.Config
        Of the session.

    Raises
    ------
    pytest.UsageError
        If the report's folder is a file.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.out = Path(
            os.path.abspath(config.invocation_params.dir / config.option.camless_report)
        )
        if self.out.exists() and not self.out.is_dir():
            raise pytest.UsageError(
                f"--camless-report: {self.out} is a file, but must be a folder: name another"
            )
        given: str | None = getattr(config, "workerinput", {}).get(_WORKER_INPUT)
        self._leads = not hasattr(config, "workerinput")
        self._own = given is None
        self.record = RunRecord(Path(given or tempfile.mkdtemp(prefix="camless-record-")))
        self._said: list[str] = []

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        """Tell a worker of pytest-xdist where the record is."""
        node.workerinput[_WORKER_INPUT] = str(self.record.folder)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the report; the exit status of pytest stays what it is."""
        if self._leads and not session.config.option.collectonly:
            self._said = self._write(session.config)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Say where the report is, or why there is none."""
        if self._said:
            terminalreporter.section("camless report")
            for line in self._said:
                terminalreporter.write_line(line)

    def pytest_unconfigure(self) -> None:
        """Remove the record."""
        if self._own:
            shutil.rmtree(self.record.folder, ignore_errors=True)

    def _write(self, config: pytest.Config) -> list[str]:
        from .report.build import build_report
        from .report.chapter import Context
        from .report.chapters.reproducibility import ReproducibilityChapter
        from .report.chapters.requirements import RequirementsChapter
        from .report.chapters.scenario_runs import ScenarioRunsChapter
        from .report.chapters.summary import SummaryChapter

        runs, failures = self.record.runs(), self.record.failures()
        if not runs and not failures:
            return ["no scenario was run, so no report was written"]
        context = Context(command=shlex.join(["pytest", *map(str, config.invocation_params.args)]))
        if runs:
            context.engine = runs[0].result.scenario.engine
            context.seed = runs[0].result.seed
        chapters = (
            SummaryChapter(),
            ScenarioRunsChapter(runs, failures),
            RequirementsChapter(),
            ReproducibilityChapter(),
        )
        try:
            report = build_report(self.out, context=context, chapters=chapters, title=TITLE)
        except OutputError as error:
            return [f"not written: {error}"]
        return str(report).splitlines()
