"""Record of a test session: every run and verdict as a file in a folder that processes share."""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .metrics import METRICS
from .output import reserved_file

if TYPE_CHECKING:
    from .closed_loop_requirement import Verdict
    from .report.chapters.scenario_runs import FailedScenario, ScenarioCheck, ScenarioRun
    from .scenario_result import ScenarioResult

_RUN, _TEST, _VERDICT, _FAILURE = "run-", "test-", "verdict-", "failure-"
_KEY_DIGITS = 20


def current_test() -> str:
    """Id of the test that is being run; empty outside of one."""
    name, _, _ = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")
    return name


class RunRecord:
    """Writes what happens in this process, reads what happened in all.

    A run's name is the digest of its file, so that a run that several processes have repeated bit
    for bit is one run.

    Parameters
    ----------
    folder : Path
        The shared folder; it exists.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, result: ScenarioResult) -> str:
        """Record a finished run; returns its key.

        Requirements are left out: what is asked of the run is recorded when it is, and a metric
        of a user's own could not be read again.
        """
        draft = self.folder / f"draft-{uuid.uuid4().hex}.json"
        replace(result, scenario=result.scenario.replace(requirements=())).to_json(draft)
        key = hashlib.sha256(draft.read_bytes()).hexdigest()[:_KEY_DIGITS]
        draft.replace(self.folder / f"{_RUN}{key}.json")
        self._note(_TEST, {"run": key, "test": current_test()})
        return key

    def verdict(self, key: str, verdict: Verdict) -> None:
        """Record a verdict on a run."""
        requirement = verdict.requirement
        known = requirement.metric.kind in METRICS  # not one of a user's own
        self._note(
            _VERDICT,
            {
                "run": key,
                "test": current_test(),
                "stated": asdict(requirement.stated),
                "requirement": requirement.to_dict() if known else None,
                "value": float(verdict.value),
                "time": float(verdict.time),
                "event": None if verdict.event is None else int(verdict.event),
                "cylinder": None if verdict.cylinder is None else int(verdict.cylinder),
                "note": verdict.note,
            },
        )

    def failure(self, scenario: str, error: Exception) -> None:
        """Record a scenario that could not be run."""
        message = f"{type(error).__name__}: {error}"
        self._note(_FAILURE, {"scenario": scenario, "error": message, "test": current_test()})

    def runs(self) -> tuple[ScenarioRun, ...]:
        """Return the runs of all processes with the verdicts on them, by name and seed."""
        from .report.chapters.scenario_runs import ScenarioRun
        from .scenario_result import load_result

        checks: dict[str, dict[str, ScenarioCheck]] = {}
        tests: dict[str, set[str]] = {}
        for note in self._notes(_TEST):
            tests.setdefault(note["run"], set()).add(note["test"])
        for note in self._notes(_VERDICT):
            check = _check(note)
            # What is asked twice is answered the same twice.
            checks.setdefault(note["run"], {})[repr(check.found)] = check
            tests.setdefault(note["run"], set()).add(note["test"])
        runs = [
            ScenarioRun(
                load_result(self.folder / f"{_RUN}{key}.json"),
                tuple(check for _, check in sorted(checks.get(key, {}).items())),
                tuple(sorted(tests[key])),
            )
            for key in sorted(tests)
        ]
        return tuple(sorted(runs, key=lambda run: (run.result.scenario.name, run.result.seed)))

    def failures(self) -> tuple[FailedScenario, ...]:
        """Return the scenarios that could not be run, in any process."""
        from .report.chapters.scenario_runs import FailedScenario

        found = {
            FailedScenario(note["scenario"], note["error"], note["test"])
            for note in self._notes(_FAILURE)
        }
        return tuple(sorted(found, key=lambda failed: (failed.scenario, failed.test)))

    def _note(self, kind: str, content: dict[str, Any]) -> None:
        with reserved_file(self.folder / f"{kind}{uuid.uuid4().hex}.json") as file:
            if file is not None:
                # Not the package's own form of JSON: infinite numbers must come back as such.
                file.write(json.dumps(content, default=float))

    def _notes(self, kind: str) -> Iterator[dict[str, Any]]:
        for path in sorted(self.folder.glob(f"{kind}*.json")):
            yield json.loads(path.read_text(encoding="utf-8"))


def _check(note: dict[str, Any]) -> ScenarioCheck:
    """Return what was noted of a verdict."""
    from .closed_loop_requirement import ClosedLoopRequirement, Verdict
    from .report.chapters.scenario_runs import ScenarioCheck
    from .requirements import Requirement, RequirementResult

    value, time, text = note["value"], note["time"], note["note"]
    verdict = None
    if note["requirement"] is not None:
        requirement = ClosedLoopRequirement.from_dict(note["requirement"])
        verdict = Verdict(requirement, value, time, note["event"], text, cylinder=note["cylinder"])
    return ScenarioCheck(
        RequirementResult(Requirement(**note["stated"]), value, text), time, verdict
    )
