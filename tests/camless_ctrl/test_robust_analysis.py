from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.adaptation import GainSchedule
from camless_ctrl.robust_analysis import (
    RobustAnalysis,
    SpeedAnalysis,
    analyse_robustness,
)
from plant import ParameterError
from uncertainty.coverage import bound_from_scores, check_fresh


@pytest.mark.parametrize("speeds", [(), (1500.0, 3000.0, 1500)])
def test_speeds_are_given_once_each(speeds):
    with pytest.raises(ParameterError, match="one or more, each once"):
        analyse_robustness(None, speeds)  # before the maps are looked at


def test_what_was_not_confirmed_is_not_sound():
    assert not RobustAnalysis((), GainSchedule(), None, 0).sound


@pytest.mark.parametrize(("inside", "doubt"), [(200, False), (190, True)])
def test_a_description_that_fresh_plants_refute_is_told_beside_the_verdict(inside, doubt):
    bound = bound_from_scores(np.full(500, 1.0), confidence=0.95, share=0.99)
    fresh = check_fresh(bound, np.repeat([0.5, 2.0], [inside, 200 - inside]))

    class Structured(SimpleNamespace):
        def __str__(self):
            return "robustly stable"

    measurement = SimpleNamespace(coverage=fresh)
    structured = Structured(loop=SimpleNamespace(measurement=measurement))
    text = str(SpeedAnalysis(structured, None, None))
    assert ("in doubt" in text) == doubt
