import pytest

from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from plant.errors import ParameterError


def test_schedule_is_linear_between_its_nodes_and_held_outside():
    schedule = GainSchedule((1000.0, 3000.0), (0.4, 0.2), (0.3, 0.1))
    assert schedule.at(2000.0).mean == pytest.approx(0.3)
    assert schedule.at(2000.0).imbalance == pytest.approx(0.2)
    assert schedule.at(500.0) == AdaptationGains(0.4, 0.3)
    assert schedule.at(9000.0) == AdaptationGains(0.2, 0.1)
    assert schedule.scaled(0.5).at(500.0) == AdaptationGains(0.2, 0.15)


@pytest.mark.parametrize(
    "build",
    [
        lambda: GainSchedule((1000.0, 3000.0), (0.4,), (0.3, 0.1)),
        lambda: GainSchedule((3000.0, 1000.0), (0.4, 0.4), (0.3, 0.1)),
        lambda: GainSchedule((1000.0,), (-0.1,), (0.1,)),
    ],
)
def test_impossible_parameters_are_refused(build):
    with pytest.raises(ParameterError):
        build()
