"""Chapter: closed-loop scenarios that were run, and the requirements that they were held to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from camless_ctrl.requirements import Requirement, RequirementResult

from ..chapter import Context
from ..content import (
    Block,
    Cell,
    ChapterResult,
    Column,
    Figure,
    Heading,
    Number,
    Table,
    Text,
    printed,
)

if TYPE_CHECKING:
    from camless_ctrl.closed_loop_requirement import Verdict
    from camless_ctrl.scenario_result import ScenarioResult


@dataclass(frozen=True)
class ScenarioCheck:
    """A requirement that a run was held to.

    Attributes
    ----------
    found : RequirementResult
        Requirement and value.
    time : float
        When it was worst, s; NaN if that is no one time.
    verdict : Verdict, optional
        The verdict, for the picture.
    """

    found: RequirementResult
    time: float = math.nan
    verdict: Verdict | None = None


@dataclass(frozen=True)
class ScenarioRun:
    """A run, what it was held to, and the tests that ran it.

    Attributes
    ----------
    result : ScenarioResult
        The run.
    checks : tuple of ScenarioCheck
        What it was held to; if empty, the scenario's own requirements are taken.
    tests : tuple of str
        Tests that ran it.
    """

    result: ScenarioResult
    checks: tuple[ScenarioCheck, ...] = ()
    tests: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the scenario, with the seed where it is not the scenario's own."""
        scenario = self.result.scenario
        if self.result.seed == scenario.seed:
            return scenario.name
        return f"{scenario.name}, seed {self.result.seed}"

    def assessed(self) -> tuple[ScenarioCheck, ...]:
        """Return the checks, or the scenario's own requirements if nothing was asked."""
        return self.checks or tuple(
            ScenarioCheck(verdict.result, verdict.time, verdict) for verdict in self.result.verdicts
        )


@dataclass(frozen=True)
class FailedScenario:
    """A scenario that could not be run: its name, why, and the test that asked for it."""

    scenario: str
    error: str
    test: str = ""


class ScenarioRunsChapter:
    """Scenarios, their requirements and their pictures.

    Parameters
    ----------
    runs : sequence of ScenarioRun
        The runs.
    failures : sequence of FailedScenario
        Scenarios that could not be run.
    """

    id = "scenarios"
    title = "Closed-loop scenarios"
    concludes = False

    def __init__(
        self, runs: Sequence[ScenarioRun], failures: Sequence[FailedScenario] = ()
    ) -> None:
        self.runs = tuple(runs)
        self.failures = tuple(failures)

    def compute(self, context: Context) -> ChapterResult:
        """Gather the verdicts and draw the runs."""
        held = [(run, check) for run in self.runs for check in run.assessed()]
        requirements = [_named(run, check.found) for run, check in held]
        requirements += [_not_run(failed) for failed in self.failures]
        numbers = {
            "held": Number(sum(found.met for found in requirements)),
            "stated": Number(len(requirements)),
            "runs": Number(len(self.runs)),
            "scenarios": Number(len({run.result.scenario.name for run in self.runs})),
            "failed": Number(len(self.failures)),
        }
        blocks: list[Block] = [
            Text(
                "Each scenario drives the adaptive controller against the full plant, event by "
                "event, with its own engine, operating profile, sensors, valves and faults. Times "
                "count from the beginning of its profile. The same scenario, seed, engine and "
                "versions give the same numbers bit for bit."
            )
        ]
        if held:
            blocks.append(verdict_table(held))
        if self.failures:
            blocks.append(_failures(self.failures))
        for number, run in enumerate(self.runs):
            blocks += _pictured(context, number, run)
        if self.runs:
            blocks += [Heading("What is needed to run them again"), *_provenance(self.runs)]
        if any(run.tests for run in self.runs):
            blocks.append(_tests(self.runs))
        return ChapterResult(
            finding=Text(
                "{held:.0f} of {stated:.0f} requirements hold in {runs:.0f} closed-loop runs of "
                "{scenarios:.0f} scenarios"
                + ("; {failed:.0f} could not be run." if self.failures else "."),
                **numbers,
            ),
            blocks=blocks,
            numbers=numbers,
            requirements=requirements,
        )


def _named(run: ScenarioRun, found: RequirementResult) -> RequirementResult:
    """Return a result under a name that tells the run."""
    name = f"{run.name}: {found.requirement.name}"
    return replace(found, requirement=replace(found.requirement, name=name))


def _not_run(failed: FailedScenario) -> RequirementResult:
    stated = Requirement(
        f"{failed.scenario}: runs", 1.0, "1", "at least", "scenario", "whether it can be run"
    )
    return RequirementResult(stated, math.nan, failed.error)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value + 0.0  # no negative zero


def verdict_table(held: Sequence[tuple[ScenarioRun, ScenarioCheck]]) -> Table:
    """Return the table of requirements, each with its run."""
    rows: list[list[Cell]] = [
        [
            run.name,
            check.found.requirement.name,
            f"{check.found.requirement.sense} {printed(check.found.requirement.bound, 'g')}",
            _number(check.found.value),
            _number(check.found.margin),
            check.found.requirement.unit,
            _number(check.time),
            check.found.met,
            check.found.note,
        ]
        for run, check in held
    ]
    return Table(
        "verdicts",
        Text("Every requirement that a run was held to, and when it was worst."),
        [
            Column("scenario"),
            Column("requirement"),
            Column("bound"),
            Column("value"),
            Column("margin", spec="+.3g"),
            Column("unit"),
            Column("worst at", "s", ".3f"),
            Column("verdict", words=("met", "not met")),
            Column("where"),
        ],
        rows,
    )


def _failures(failures: Sequence[FailedScenario]) -> Table:
    return Table(
        "not-run",
        Text("Scenarios that could not be run."),
        [Column("scenario"), Column("why"), Column("asked for by")],
        [[failed.scenario, failed.error, failed.test] for failed in failures],
    )


def _pictured(context: Context, number: int, run: ScenarioRun) -> list[Block]:
    checks = run.assessed()
    verdicts = [check.verdict for check in checks if check.verdict is not None]
    met, stated = f"held_{number}", f"stated_{number}"
    figure = Figure(
        f"run-{number}",
        Text(
            f"Scenario {{name}}: {{{met}:.0f}} of {{{stated}:.0f}} requirements hold.",
            name=run.name,
            **{
                met: Number(sum(check.found.met for check in checks)),
                stated: Number(len(checks)),
            },
        ),
        "Charge of each cylinder against demand, charge error, speed, mode and alarms over time in "
        f"the scenario {run.name}; the instants at which requirements that are not met were worst "
        "are flagged.",
        context.draw(run.result.plot(verdicts)),
    )
    description = run.result.scenario.description
    said: list[Block] = [Text("{said}", said=description)] if description else []
    return [Heading(run.name), *said, figure]


def _provenance(runs: Sequence[ScenarioRun]) -> list[Block]:
    told = [{key: str(value) for key, value in run.result.provenance.items()} for run in runs]
    keys = list(dict.fromkeys(key for one in told for key in one))
    common = [key for key in keys if len({one.get(key) for one in told}) == 1]
    return [
        Table(
            "provenance",
            Text("What all runs have in common."),
            [Column("what"), Column("value")],
            [[key, told[0][key]] for key in common],
        ),
        Table(
            "seeds",
            Text("Seed of each run, and in what it differs from others."),
            [Column("scenario"), Column("seed", "", ".0f"), Column("differs in")],
            [
                [
                    run.result.scenario.name,
                    run.result.seed,
                    "; ".join(f"{key}: {one[key]}" for key in one if key not in common),
                ]
                for run, one in zip(runs, told, strict=True)
            ],
        ),
    ]


def _tests(runs: Sequence[ScenarioRun]) -> Table:
    return Table(
        "tests",
        Text("The tests that ran the scenarios, or asked for a verdict on them."),
        [Column("scenario"), Column("test")],
        [[run.name, test] for run in runs for test in run.tests],
    )
