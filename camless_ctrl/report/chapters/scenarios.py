"""Chapter: the scenarios that the package brings along, run on the report's engine."""

from __future__ import annotations

import math
from dataclasses import replace

from camless_ctrl.assessment import assess_scenarios
from camless_ctrl.scenario_suite import ScenarioSuite, SuiteCheck, run_scenarios
from camless_ctrl.shipped import shipped_scenarios

from ..chapter import Context
from ..content import Block, ChapterResult, Figure, Heading, Number, Text
from .feedforward import controller_design
from .run_pictures import light_picture
from .scenario_runs import ScenarioCheck, ScenarioRun, verdict_table

PICTURED = ("drive-cycle", "fault-maf-offset", "cylinder-deactivation")


class ScenariosChapter:
    """Library of scenarios: every requirement, where it was worst, and some pictures."""

    id = "scenario-library"
    title = "Scenarios"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Run all scenarios whose nominal engine is the report's."""
        known = shipped_scenarios()
        fitting = [s for s in known.values() if s.engine == context.engine]
        left_out = [s.name for s in known.values() if s.engine != context.engine]
        suite = run_scenarios(fitting, controller_design(context) if fitting else None)
        numbers = {
            "scenarios": Number(len(suite.results)),
            "stated": Number(len(suite.checks)),
            "held": Number(len(suite.checks) - len(suite.missed)),
            "counted": Number(sum(check.counts for check in suite.missed)),
            "by_jitter": Number(sum(check.jitter_alone for check in suite.missed)),
            "events": Number(sum(result.run.time.size for result in suite.results)),
            "left_out": Number(len(left_out)),
        }
        blocks: list[Block] = [
            Text(
                "The package brings a library of scenarios along: every row of the performance "
                "table, driving, ambient, ageing, deactivation, and every kind of fault. Each "
                "drives the adaptive controller against the full plant, event by event, with its "
                "own engine, profile, sensors, valves, faults and seed, and states what the run "
                "must meet. Bounds that are not met stay, and are told: a scenario is not made to "
                "pass."
            ),
            Text(
                "Requirements of single events, or of means of at most one cycle, can be missed "
                "by the jitter of the valves alone, which comes after the command. Where the "
                "library has the same scenario without jitter and that run meets the very same "
                "requirement, the miss is told but not counted (here: {by_jitter:.0f}).",
                **numbers,
            ),
        ]
        if left_out:
            blocks.append(
                Text(
                    "Left out, because their engine is not that of this report: {names}.",
                    names=", ".join(left_out),
                )
            )
        if fitting:
            blocks += [_overview(context, suite), _verdicts(suite)]
        names = {result.scenario.name for result in suite.results}
        for name in PICTURED:
            if name in names:
                blocks += _pictured(context, suite, name)
        return ChapterResult(
            finding=Text(
                "In {scenarios:.0f} scenarios of the library ({events:.0f} events) {held:.0f} of "
                "{stated:.0f} requirements are met; missed: {counted:.0f}, and by jitter alone "
                "{by_jitter:.0f}.",
                **numbers,
            ),
            blocks=blocks,
            numbers=numbers,
            requirements=assess_scenarios(suite),
        )


def _overview(context: Context, suite: ScenarioSuite) -> Figure:
    return Figure(
        "overview",
        Text(
            "Every figure of every scenario over its bound; to the left of the line it is met. "
            "Bounds of 0 are drawn where they are missed."
        ),
        "For each scenario a row of marks: value over bound of each requirement, with those that "
        "are missed in another colour.",
        context.draw(suite.plot()),
    )


def _verdicts(suite: ScenarioSuite) -> Block:
    return verdict_table([(ScenarioRun(check.result), _told(check)) for check in suite.checks])


def _told(check: SuiteCheck) -> ScenarioCheck:
    """A check as the table shows it."""
    found = check.verdict.result
    if check.jitter_alone:
        words = "by jitter alone, not counted"
        found = replace(found, note=f"{found.note}; {words}" if found.note else words)
    time = check.verdict.time
    return ScenarioCheck(found, time if math.isfinite(time) else math.nan, check.verdict)


def _pictured(context: Context, suite: ScenarioSuite, name: str) -> list[Block]:
    result = suite.result(name)
    met, stated = f"met_{name}", f"stated_{name}"
    return [
        Heading(name),
        Figure(
            name,
            Text(
                f"{{said}}: {{{met}:.0f}} of {{{stated}:.0f}} requirements are met.",
                said=result.scenario.description,
                **{
                    met: Number(sum(verdict.met for verdict in result.verdicts)),
                    stated: Number(len(result.verdicts)),
                },
            ),
            f"Charge of each cylinder and demand, and charge error, over time in {name}.",
            context.draw(light_picture(result)),
        ),
    ]
