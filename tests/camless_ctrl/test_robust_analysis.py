import pytest

from camless_ctrl.adaptation import GainSchedule
from camless_ctrl.robust_analysis import RobustAnalysis, _driven, analyse_robustness
from plant import ParameterError


@pytest.mark.parametrize("speeds", [(), (1500.0, 3000.0, 1500)])
def test_speeds_are_given_once_each(speeds):
    with pytest.raises(ParameterError, match="one or more, each once"):
        analyse_robustness(None, speeds)  # before the maps are looked at


@pytest.mark.parametrize(
    ("speeds", "driven"),
    [
        ((750.0, 1500.0, 3000.0, 6000.0), [1500.0, 3000.0]),
        ((6000.0, 3000.0), [3000.0]),
        ((6000.0, 4500.0), [6000.0]),  # none of the usual ones: still one is tried
    ],
)
def test_the_full_plant_is_driven_to_its_break_at_one_speed_at_least(speeds, driven):
    assert list(_driven(speeds)) == driven


def test_what_was_not_confirmed_is_not_sound():
    assert not RobustAnalysis((), GainSchedule(), None, 0).sound
