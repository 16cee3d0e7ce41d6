import math

import pytest

from camless_ctrl.requirements import REQUIREMENTS, Requirement, evaluate, requirement, table
from plant.errors import ParameterError


def test_bounds_of_the_report():
    stated = {
        "published-worst": (2.0, "at most"),
        "published-rms": (0.7, "at most"),
        "map-charge-rms": (0.3, "at most"),
        "map-charge-worst": (1.5, "at most"),
        "map-loss-rms": (0.5, "at most"),
        "map-loss-worst": (3.0, "at most"),
        "throttle-step": (2.0, "at most"),
        "cylinder-error": (1.0, "at most"),
        "imbalance": (0.5, "at most"),
        "command-lift-lowest": (0.5, "at least"),
        "command-lift-highest": (8.0, "at most"),
    }
    for name, (bound, sense) in stated.items():
        assert (requirement(name).bound, requirement(name).sense) == (bound, sense)
    assert all(name == r.name for name, r in REQUIREMENTS.items())


@pytest.mark.parametrize(
    ("sense", "value", "met", "margin"),
    [
        ("at most", 1.5, True, 0.5),
        ("at most", 2.0, True, 0.0),
        ("at most", 2.5, False, -0.5),
        ("at least", 2.5, True, 0.5),
        ("at least", 1.5, False, -0.5),
        ("at least", math.inf, True, math.inf),
        ("at most", math.inf, False, -math.inf),
    ],
)
def test_sense_and_margin(sense, value, met, margin):
    result = evaluate(Requirement("x", 2.0, "mm", sense, "here", "a length"), value)
    assert result.met is met
    assert result.margin == margin


@pytest.mark.parametrize("sense", ["at most", "at least"])
def test_no_figure_meets_nothing(sense):
    result = evaluate(Requirement("x", 2.0, "1", sense, "here", "a number"), math.nan)
    assert not result.met
    assert "none, NOT MET" in str(result)


def test_table_counts_what_is_met():
    text = table([evaluate("imbalance", 0.4), evaluate("loop-gain-margin", 1.2, "at 6000 rpm")])
    assert "imbalance" in text
    assert "NOT MET  (at 6000 rpm)" in text
    assert text.endswith("1 of 2 met")


def test_unknown_name_suggests_the_nearest():
    with pytest.raises(ParameterError, match="did you mean 'imbalance'"):
        evaluate("inbalance", 0.1)


@pytest.mark.parametrize(
    "change", [{"name": ""}, {"bound": math.nan}, {"sense": "below"}, {"source": ""}]
)
def test_incomplete_requirement_is_refused(change):
    fields = {
        "name": "x",
        "bound": 1.0,
        "unit": "1",
        "sense": "at most",
        "source": "here",
        "description": "a number",
    }
    with pytest.raises(ParameterError):
        Requirement(**{**fields, **change})
