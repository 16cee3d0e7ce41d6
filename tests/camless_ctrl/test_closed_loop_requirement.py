import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.closed_loop_requirement import ClosedLoopRequirement, Verdict
from camless_ctrl.metrics import (
    METRICS,
    AlarmTime,
    Settling,
    SteadyError,
    WorstError,
    metric_from_dict,
)
from plant.errors import ParameterError

# what a requirement is told of a run: four cylinders, events 20 ms apart, one of them 0.72 % off
ERROR = np.where(np.arange(160) == 115, 0.0072, 0.001)
RESULT = SimpleNamespace(
    run=SimpleNamespace(
        n_cylinders=4,
        time=0.02 * np.arange(160),
        cylinder=np.arange(160) % 4 + 1,
        demand=np.full(160, 2e-4),
        charge=2e-4 * (1.0 + ERROR),
    ),
    scenario=SimpleNamespace(faults=()),
)


def worst(bound, **changes):
    return ClosedLoopRequirement("every event", WorstError(), bound, "%", "customer", **changes)


def test_a_verdict_is_one_line_with_number_instant_bound_and_picture():
    verdict = worst(0.5).evaluate(RESULT)
    assert str(verdict) == (
        "every event: 0.72 % at 2.30 s (event 115, cylinder 4) [+0.72 %], but must be at most 0.5 %"
    )
    assert repr(verdict) == str(verdict)
    assert not verdict
    shown = Verdict(verdict.requirement, 0.72, plot=Path("folder/a.png"))
    assert str(shown) == "every event: 0.72 %, but must be at most 0.5 %; picture: folder/a.png"
    met = worst(0.8).evaluate(RESULT)
    assert met
    assert str(met).endswith(", met (at most 0.8 %)")


def test_margin_and_sense():
    assert worst(0.5).evaluate(RESULT).margin == pytest.approx(-0.22)
    assert worst(1.0).evaluate(RESULT).margin == pytest.approx(0.28)
    at_least = worst(0.5, sense="at least").evaluate(RESULT)
    assert at_least.met
    assert at_least.margin == pytest.approx(0.22)
    assert not worst(1.0, sense="at least").evaluate(RESULT)


def test_no_value_is_not_met_whatever_the_sense():
    for sense in ("at most", "at least"):
        short = ClosedLoopRequirement("steady", SteadyError(100), 5.0, "%", "me", sense)
        verdict = short.evaluate(RESULT)
        assert not verdict.met
        assert math.isnan(verdict.margin)
        assert str(verdict) == (
            "steady: none [no demand is held for more than 100 cycles in this time], but must be "
            f"{sense} 5 %"
        )


def test_a_value_just_beyond_its_bound_is_told_apart_from_it():
    verdict = Verdict(worst(0.5), 0.500004)
    assert "0.500004 %" in str(verdict)
    assert Verdict(worst(0.5), 0.5).met
    assert "inf %" in str(Verdict(worst(0.5), math.inf))


def test_a_failing_assert_shows_the_line():
    verdict = worst(0.5).evaluate(RESULT)
    with pytest.raises(AssertionError, match=r"0\.72 % at 2\.30 s \(event 115, cylinder 4\)"):
        assert verdict


def test_plain_data_and_back():
    data = {
        "name": "alarm in time",
        "kind": "alarm-time",
        "alarm": "maf",
        "fault": 2,
        "bound": 40.0,
        "source": "safety concept",
    }
    requirement = ClosedLoopRequirement.from_dict(data)
    assert requirement.metric == AlarmTime("maf", 2)
    assert (requirement.unit, requirement.sense) == ("events", "at most")
    assert requirement.to_dict() == data | {"unit": "events", "sense": "at most"}
    assert ClosedLoopRequirement.from_dict(requirement.to_dict()) == requirement
    assert str(requirement) == "alarm in time at most 40 events"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"unit": "mg"}, "unit is 'mg', but metric 'worst-error' is in '%'"),
        ({"sense": "atmost"}, "did you mean 'at most'"),
        ({"bound": "low"}, "bound is 'low', but must be a number in %"),
        ({"bound": math.nan}, "bound is nan"),
        ({"name": ""}, "lacks a name"),
        ({"source": 3}, "source is 3, but must be a text"),
        ({"kind": "worst"}, "did you mean 'worst-error'"),
        ({"mean_event": 2}, "did you mean 'mean_events'"),
    ],
)
def test_a_wrong_requirement_is_told_with_the_remedy(changes, message):
    data = {"name": "a", "kind": "worst-error", "bound": 1.0, "source": "me"} | changes
    with pytest.raises(ParameterError, match=message):
        ClosedLoopRequirement.from_dict(data)


@pytest.mark.parametrize("key", ["name", "kind", "bound", "source"])
def test_a_missing_key_is_named(key):
    data = {"name": "a", "kind": "worst-error", "bound": 1.0, "source": "me"}
    del data[key]
    with pytest.raises(ParameterError, match=f"^{key} is missing"):
        ClosedLoopRequirement.from_dict(data)


def test_a_metric_must_be_one():
    with pytest.raises(ParameterError, match="metric is 'worst-error', but must be a metric"):
        ClosedLoopRequirement("a", "worst-error", 1.0, "%", "me")


def test_metrics_as_plain_data_and_back():
    metrics = (
        SteadyError(3, from_s=1.0, without_cylinders=(2, 3)),
        WorstError(window="after", settle_s=0.5),
        AlarmTime("valve", 2),
        Settling(),
    )
    for metric in metrics:
        assert metric_from_dict(metric.to_dict()) == metric
    assert metrics[0].to_dict() == {
        "kind": "steady-error",
        "after_cycles": 3,
        "from_s": 1.0,
        "without_cylinders": [2, 3],
    }
    assert {metric.kind for metric in METRICS.values()} == set(METRICS)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "kind is missing: give one of settling"),
        ({"kind": "setling"}, "did you mean 'settling'"),
        ({"kind": "settling", "tolerence_percent": 1.0}, "did you mean 'tolerance_percent'"),
        ({"kind": "alarm-time"}, "lacks 'alarm'"),
        ({"kind": "settling", "tolerance_percent": -1.0}, "above 0 %"),
        ({"kind": "settling", "tolerance_percent": "small"}, "must be a number in %"),
        ({"kind": "worst-error", "from_s": 2.0, "until_s": 1.0}, r"in \(2, 1e\+06\] s"),
        ({"kind": "worst-error", "window": "befor"}, "did you mean 'before'"),
        ({"kind": "worst-error", "without_cylinders": 3}, "must hold cylinders"),
    ],
)
def test_a_wrong_metric_is_told_with_the_remedy(data, message):
    with pytest.raises(ParameterError, match=message):
        metric_from_dict(data)
