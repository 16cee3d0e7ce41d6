"""Many scenarios run with one design, and what all of them found.

A requirement of single events, or of means of at most one cycle, may be missed by the jitter of
the valves alone, which comes after the command. Where the suite has the same scenario without
jitter, and that run meets the very same requirement, the miss is told but does not count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from plant._checks import one_of
from plant.errors import ParameterError
from plant.sensors import SensorSet

from ._metric_errors import FirstEventsError, WorstError
from ._processes import in_processes
from .closed_loop_requirement import ClosedLoopRequirement, Verdict
from .controller_design import ControllerDesign
from .scenario import Scenario
from .scenario_result import ScenarioResult
from .scenario_run import run_scenario

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHOWN = 2.0  # shares of a bound that the picture reaches to

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class SuiteCheck:
    """One requirement of one run.

    Attributes
    ----------
    result : ScenarioResult
        The run.
    verdict : Verdict
        What was found.
    jitter_alone : bool
        Whether it is missed, but met by the same scenario without jitter.
    """

    result: ScenarioResult = field(repr=False)
    verdict: Verdict
    jitter_alone: bool = False

    @property
    def counts(self) -> bool:
        """Whether it is a miss that counts."""
        return not (self.verdict.met or self.jitter_alone)

    @property
    def share(self) -> float:
        """Value over bound, 1; NaN where the bound is 0 or from below, or there is no value."""
        stated = self.verdict.requirement
        if stated.bound <= 0.0 or stated.sense != "at most":
            return math.nan
        return self.verdict.value / stated.bound

    def to_dict(self) -> dict[str, Any]:
        """Return scenario and verdict as plain data."""
        return {
            "scenario": self.result.scenario.name,
            **self.verdict.to_dict(),
            "jitter_alone": self.jitter_alone,
        }

    def __str__(self) -> str:
        """Return scenario and verdict in one line."""
        told = "; by jitter alone, not counted" if self.jitter_alone else ""
        return f"{self.result.scenario.name}: {self.verdict}{told}"


@dataclass(frozen=True)
class ScenarioSuite:
    """Results of several scenarios.

    Attributes
    ----------
    results : tuple of ScenarioResult
        One for each scenario, in their order.
    """

    results: tuple[ScenarioResult, ...] = field(repr=False)

    @cached_property
    def checks(self) -> tuple[SuiteCheck, ...]:
        """Every requirement of every run."""
        return tuple(
            SuiteCheck(result, verdict, not verdict.met and self._by_jitter(result, verdict))
            for result in self.results
            for verdict in result.verdicts
        )

    @property
    def missed(self) -> tuple[SuiteCheck, ...]:
        """Requirements that are not met, those by jitter alone among them."""
        return tuple(check for check in self.checks if not check.verdict.met)

    def result(self, name: str) -> ScenarioResult:
        """Return the run of a scenario.

        Raises
        ------
        ParameterError
            If there is none of that name.
        """
        by_name = {result.scenario.name: result for result in self.results}
        return by_name[one_of("scenario", name, by_name)]

    def records(self) -> list[dict[str, Any]]:
        """Return the checks as plain data."""
        return [check.to_dict() for check in self.checks]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw every figure of every scenario over its bound.

        What is beyond twice the bound, or has no value, and what is missed of a bound of 0,
        stands on the right edge.
        """
        from plant._plotting import COLOURS, axes, styled

        names = [result.scenario.name for result in self.results]
        with styled():
            ax = axes(ax, (8.0, 0.17 * len(names) + 1.2))
            kinds = (
                ("met", [c for c in self.checks if c.verdict.met], "o", COLOURS[0]),
                ("missed by jitter alone", [c for c in self.missed if not c.counts], "D", "0.5"),
                ("missed", [c for c in self.missed if c.counts], "X", COLOURS[1]),
            )
            for label, checks, marker, colour in kinds:
                places = [
                    (_place(check), names.index(check.result.scenario.name))
                    for check in checks
                    if not (check.verdict.met and math.isnan(check.share))
                ]
                if places:
                    x, y = zip(*places, strict=True)
                    ax.plot(x, y, marker, ms=4.5, c=colour, label=label, alpha=0.8)
            ax.axvline(1.0, c="0.3", lw=1.0)
            ax.set_xlim(-0.02, _SHOWN + 0.05)
            ax.set_yticks(range(len(names)), names, fontsize=7)
            ax.set_ylim(len(names) - 0.4, -0.6)
            ax.grid(axis="y", lw=0.4)
            ax.set_xlabel(f"value over bound (at {_SHOWN:g}: that or more, or no value)")
            if ax.get_legend_handles_labels()[0]:
                ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
        return ax

    def __str__(self) -> str:
        """Return how many requirements hold, and a line for each that does not."""
        met = sum(check.verdict.met for check in self.checks)
        lines = [
            f"{len(self.results)} scenarios: {met} of {len(self.checks)} requirements met",
            *(f"  {check}" for check in self.missed),
        ]
        return "\n".join(lines)

    def _by_jitter(self, result: ScenarioResult, missed: Verdict) -> bool:
        """Whether the same scenario without jitter meets a requirement that was missed."""
        if not _of_single_events(missed.requirement, result.scenario):
            return False
        return any(
            _differ_in_jitter(result.scenario, other.scenario)
            and missed.requirement.evaluate(other).met
            for other in self.results
        )


def _place(check: SuiteCheck) -> float:
    """Where a check stands in the picture."""
    return check.share if check.share <= _SHOWN else _SHOWN


def _of_single_events(requirement: ClosedLoopRequirement, scenario: Scenario) -> bool:
    metric = requirement.metric
    if isinstance(metric, WorstError):
        return metric.mean_events <= scenario.engine.n_cylinders
    return isinstance(metric, FirstEventsError)


def _differ_in_jitter(jittery: Scenario, steady: Scenario) -> bool:
    """Whether the second is the first without jitter; names and requirements aside."""
    if not jittery.valves.duration_jitter > 0.0 or steady.valves.duration_jitter != 0.0:
        return False
    like = replace(
        jittery,
        name=steady.name,
        description=steady.description,
        requirements=steady.requirements,
        valves=jittery.valves._replace(duration_jitter=0.0),
    )
    return like == steady


@dataclass(frozen=True)
class _Case:
    """One run, as it is sent to another process."""

    scenario: Scenario
    design: ControllerDesign | None = field(repr=False)


def run_scenarios(
    scenarios: Iterable[Scenario],
    design: ControllerDesign | None = None,
    *,
    processes: int = 2,
    progress: Progress | None = None,
) -> ScenarioSuite:
    """Run scenarios in several processes, and hold them against their requirements.

    Parameters
    ----------
    scenarios : iterable of Scenario
        What to run; their names must differ.
    design : ControllerDesign, optional
        Used for every scenario of its engine whose controller is made for the default sensors;
        the others, or all without it, get that of `scenario_design`.
    processes : int
        Processes to run in.
    progress : callable, optional
        Called with the number of runs done and the number in all.

    Raises
    ------
    ParameterError
        If two scenarios have one name.
    """
    scenarios = tuple(scenarios)
    names = [scenario.name for scenario in scenarios]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(f"two scenarios are called {name!r}: give each a name of its own")
    cases = [_Case(scenario, _design_for(scenario, design)) for scenario in scenarios]
    order = _dealt([_events(scenario) for scenario in scenarios], processes)
    found = in_processes(_judged, [cases[i] for i in order], processes, progress)
    by_place = dict(zip(order, found, strict=True))
    return ScenarioSuite(tuple(by_place[i] for i in range(len(scenarios))))


def _design_for(scenario: Scenario, design: ControllerDesign | None) -> ControllerDesign | None:
    """The given design where it is the scenario's."""
    fits = (
        design is not None
        and design.engine == scenario.engine
        and scenario.assumed_sensors == SensorSet()
    )
    return design if fits else None


def _events(scenario: Scenario) -> int:
    n = scenario.engine.n_cylinders
    return scenario.profile.events(n, warm_up_cycles=scenario.controller.warm_up_cycles).time.size


def _dealt(sizes: Sequence[int], processes: int) -> list[int]:
    """Order in which work dealt to processes in turn is shared evenly: there and back."""
    longest_first = sorted(range(len(sizes)), key=lambda i: -sizes[i])
    order: list[int] = []
    for first in range(0, len(sizes), processes):
        group = longest_first[first : first + processes]
        order += group[::-1] if first // processes % 2 else group
    return order


def _judged(case: _Case) -> ScenarioResult:
    result = run_scenario(case.scenario, case.design)
    _ = result.verdicts  # found here, and kept in the result: some take seconds
    return result
