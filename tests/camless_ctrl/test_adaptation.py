import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains, GainSchedule, NormalisedGradient
from plant.errors import ParameterError

TRUE = np.array([1.03, 0.85, 0.96, 1.05])


def run(law, cycles, true=TRUE):
    """Feed the law with perfect estimates, all of a cycle made with the factors before it."""
    factors = np.ones(4)
    history = [factors]
    for _ in range(cycles):
        used = factors
        for i in range(4):
            factors = law.update(factors, i + 1, true[i], used[i], 1500.0).factors
        history.append(factors)
    return np.array(history)


def test_mean_and_imbalance_decay_with_their_own_gains():
    law = NormalisedGradient(GainSchedule.constant(0.5, 0.2))
    error = run(law, 12) - TRUE
    mean, imbalance = error.mean(axis=1), error - error.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(mean[1:] / mean[:-1], 0.5, rtol=1e-9)
    np.testing.assert_allclose(imbalance[5], 0.8**5 * imbalance[0], rtol=1e-9)


def test_factors_stay_within_their_bounds():
    law = NormalisedGradient(GainSchedule.constant(0.9, 0.9), bounds=(0.9, 1.02))
    history = run(law, 40)
    assert history.min() >= 0.9
    assert history.max() <= 1.02
    np.testing.assert_allclose(history[-1], [1.02, 0.9, 0.96, 1.02], atol=1e-6)
    assert law.update(history[-1], 2, 0.5, 0.9, 1500.0).projected


def test_dead_zone_leaves_small_errors_alone():
    law = NormalisedGradient(GainSchedule.constant(0.5, 0.5), dead_zone=0.01)
    step = law.update(np.ones(4), 1, 1.009, 1.0, 1500.0)
    assert step.error == 0.0
    np.testing.assert_array_equal(step.factors, np.ones(4))
    assert law.update(np.ones(4), 1, 0.97, 1.0, 1500.0).error == pytest.approx(-0.02)


def test_update_does_not_change_its_input():
    factors = np.ones(4)
    NormalisedGradient().update(factors, 1, 0.9, 1.0, 1500.0)
    np.testing.assert_array_equal(factors, np.ones(4))


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
        lambda: NormalisedGradient(bounds=(1.1, 1.4)),
        lambda: NormalisedGradient(dead_zone=float("nan")),
        lambda: NormalisedGradient().replace(gain=1.0),
    ],
)
def test_impossible_parameters_are_refused(build):
    with pytest.raises(ParameterError):
        build()
