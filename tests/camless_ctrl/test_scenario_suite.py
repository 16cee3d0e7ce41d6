import dataclasses
import math

import matplotlib as mpl
import numpy as np
import pytest

from camless_ctrl.closed_loop import ValveErrors
from camless_ctrl.closed_loop_requirement import ClosedLoopRequirement
from camless_ctrl.closed_loop_result import ClosedLoopResult
from camless_ctrl.metrics import CommandViolations, FirstEventsError, SteadyError, WorstError
from camless_ctrl.operating_profile import OperatingProfile
from camless_ctrl.scenario import Scenario
from camless_ctrl.scenario_result import ScenarioResult
from camless_ctrl.scenario_run import run_scenario
from camless_ctrl.scenario_suite import ScenarioSuite, _dealt, run_scenarios
from camless_ctrl.shipped import shipped_scenario
from plant.errors import ParameterError

mpl.use("Agg")

EVENTS = 160


def asked(metric, bound=2.0):
    return ClosedLoopRequirement("asked", metric, bound, metric.unit, "customer")


def scenario(name="rough", metric=None, jitter=5e-5, demand=200.0, **changes):
    return Scenario(
        name,
        "",
        OperatingProfile(demand, 1500.0, length=3.2),
        valves=ValveErrors(0.0, jitter),
        requirements=(asked(metric or WorstError()),),
        **changes,
    )


def result_of(which, error_percent):
    """Result of a scenario with one relative error at all events."""
    ones = np.ones(EVENTS)
    charge = 2e-4 * (1.0 + error_percent / 100.0) * ones
    run = ClosedLoopResult(which.name, 4, 0, 0.02 * np.arange(EVENTS), np.arange(EVENTS) % 4 + 1,
                           1500.0 * ones, 2e-4 * ones, charge, charge, ones, ones, 3.0 * ones,
                           100.0 * ones, ones, 0.0 * ones, ones, ones > 2, ones > 2)  # fmt: skip
    return ScenarioResult(which, run, 0, {})


def checked(*results):
    """The first check of a suite of results."""
    return ScenarioSuite(results).checks[0]


@pytest.mark.parametrize("mean_events", [1, 4])
def test_a_miss_of_single_events_is_by_jitter_if_the_same_scenario_without_it_meets_it(mean_events):
    rough = result_of(scenario(metric=WorstError(mean_events=mean_events)), 3.0)
    calm = result_of(scenario("calm", jitter=0.0), 1.0)
    check = checked(rough, calm)
    assert not check.verdict.met
    assert check.jitter_alone
    assert not check.counts
    assert str(check).startswith("rough: asked: 3 %")
    assert str(check).endswith("; by jitter alone, not counted")
    assert ScenarioSuite((rough, calm)).missed == (check,)


@pytest.mark.parametrize(
    ("rough", "calm"),
    [
        ({}, None),  # nothing like it without jitter
        ({}, {"error": 2.5}),  # which misses it as well
        ({}, {"jitter": 1e-5}),  # it jitters too
        ({}, {"demand": 210.0}),  # another profile
        ({}, {"seed": 1}),  # other noise
        ({}, {"true": {"flow_factor": 0.9}}),  # another engine
        ({"jitter": 0.0}, {}),  # nothing to be blamed
        ({"metric": SteadyError()}, {}),  # jitter is averaged out
        ({"metric": WorstError(mean_events=5)}, {}),  # more than a cycle
    ],
)
def test_any_other_miss_counts(rough, calm):
    results = [result_of(scenario(**rough), 3.0)]
    if calm is not None:
        error = calm.pop("error", 1.0)
        results.append(result_of(scenario("calm", **{"jitter": 0.0} | calm), error))
    check = checked(*results)
    assert not check.jitter_alone
    assert check.counts


def test_what_is_met_does_not_count_and_is_not_by_jitter():
    check = checked(result_of(scenario(), 1.5), result_of(scenario("calm", jitter=0.0), 1.0))
    assert check.verdict.met
    assert not check.counts
    assert not check.jitter_alone
    assert check.share == pytest.approx(0.75)


def test_first_events_are_single_events():
    profile = OperatingProfile.from_dict(
        {"demand_mg": {"steps": [150.0, 200.0], "at": [1.0]}, "speed_rpm": 1500.0, "length": 3.2}
    )
    rough = scenario(metric=FirstEventsError(), jitter=1e-5).replace(profile=profile)
    calm = scenario("calm", jitter=0.0).replace(profile=profile)
    results = []
    for which, error in ((rough, 3.0), (calm, 1.0)):
        result = result_of(which, error)
        demand = np.where(result.run.time < 1.0, 1.5e-4, 2e-4)
        charge = demand * (1.0 + error / 100.0)
        run = dataclasses.replace(result.run, demand=demand, charge=charge)
        results.append(dataclasses.replace(result, run=run))
    assert checked(*results).verdict.value == pytest.approx(3.0)
    assert checked(*results).jitter_alone


def test_shares_are_of_bounds_from_above_alone():
    of_zero = scenario().replace(requirements=(asked(CommandViolations(), 0.0),))
    from_below = scenario().replace(
        requirements=(dataclasses.replace(asked(WorstError()), sense="at least"),)
    )
    for which in (of_zero, from_below):
        assert math.isnan(checked(result_of(which, 3.0)).share)


def test_records_and_text_tell_every_miss():
    suite = ScenarioSuite((result_of(scenario(), 3.0), result_of(scenario("calm"), 1.0)))
    assert str(suite).splitlines()[0] == "2 scenarios: 1 of 2 requirements met"
    assert str(suite).splitlines()[1].startswith("  rough: asked: 3 %")
    record = suite.records()[0]
    assert (record["scenario"], record["met"], record["jitter_alone"]) == ("rough", False, False)
    assert record["value"] == pytest.approx(3.0)
    assert suite.result("calm") is suite.results[1]
    with pytest.raises(ParameterError, match="did you mean 'calm'"):
        suite.result("clam")


def test_the_picture_shows_shares_and_puts_what_is_beyond_on_its_edge():
    zero = (asked(CommandViolations(), 0.0),)
    suite = ScenarioSuite(
        (
            result_of(scenario("met"), 1.5),
            result_of(scenario("missed"), 3.0),
            result_of(scenario("beyond"), 9.0),
            result_of(scenario("no value"), math.nan),
            result_of(scenario("zero").replace(requirements=zero), 0.0),
        )
    )
    ax = suite.plot()
    places = {
        line.get_label(): sorted(zip(*line.get_data(), strict=True))
        for line in ax.lines
        if not line.get_label().startswith("_")
    }
    assert suite.checks[4].verdict.met
    assert places["met"] == [(pytest.approx(0.75), 0)]
    assert places["missed"] == [(pytest.approx(1.5), 1), (2.0, 2), (2.0, 3)]
    assert places.keys() == {"met", "missed"}
    assert [text.get_text() for text in ax.get_yticklabels()][3] == "no value"
    mpl.pyplot.close(ax.figure)


@pytest.mark.parametrize("processes", [1, 2, 3, 8])
def test_work_is_dealt_evenly(processes):
    sizes = np.random.default_rng(0).integers(100, 6000, 53).tolist()
    order = _dealt(sizes, processes)
    assert sorted(order) == list(range(53))
    shares = [sum(sizes[i] for i in order[k::processes]) for k in range(processes)]
    assert max(shares) - min(shares) <= max(sizes)
    assert max(shares) <= 1.1 * sum(sizes) / processes


def test_two_scenarios_of_one_name_are_refused():
    with pytest.raises(ParameterError, match="two scenarios are called 'rough'"):
        run_scenarios([scenario(), scenario(demand=210.0)])


def test_processes_give_what_one_run_gives_and_keep_the_order(narrow_design):
    chosen = [shipped_scenario(name) for name in ("more-flow", "demand-step", "late-valve")]
    told = []
    suite = run_scenarios(
        chosen, narrow_design, progress=lambda done, total: told.append((done, total))
    )
    assert told[-1] == (3, 3)
    assert [result.scenario for result in suite.results] == chosen
    for result in suite.results:
        alone = run_scenario(result.scenario, narrow_design)
        np.testing.assert_array_equal(result.run.charge, alone.run.charge)
        assert [str(v) for v in result.verdicts] == [str(v) for v in alone.verdicts]
    assert len(suite.checks) == sum(len(s.requirements) for s in chosen)
