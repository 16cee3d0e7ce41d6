import math

import numpy as np
import pytest

from camless_ctrl.adaptation import GainSchedule
from camless_ctrl.adaptation_laws import ParameterBounds
from camless_ctrl.event_data import ChargeEvidence
from camless_ctrl.integral_adaptation import IntegralAdaptation
from plant.errors import ParameterError

TRUE = np.log([1.03, 0.85, 0.96, 1.05])


def evidence(cylinder, error, used, slope=0.5, duration=math.nan):
    return ChargeEvidence(cylinder, error, 1e-4, duration, slope, 60.0, used, 1500.0)


def run(law, cycles, slope=0.5):
    """Ideal measurement: all of a cycle commanded with the factors before it."""
    state = law.start(4)
    history = [np.array(state.log_charge_factor)]
    for _ in range(cycles):
        before = state
        for i in range(4):
            error = TRUE[i] - before.log_charge_factor[i]
            state = law.update(state, evidence(i + 1, error, before.of(i + 1), slope)).state
        history.append(np.array(state.log_charge_factor))
    return np.array(history)


@pytest.mark.parametrize("slope", [0.0, 0.5, 1.0])
def test_mean_and_imbalance_decay_with_their_own_gains_whatever_the_slope(slope):
    left = run(IntegralAdaptation(GainSchedule.constant(0.5, 0.2)), 12, slope) - TRUE
    mean, imbalance = left.mean(axis=1), left - left.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(mean[1:] / mean[:-1], 0.5, rtol=1e-9)
    np.testing.assert_allclose(imbalance[5], 0.8**5 * imbalance[0], rtol=1e-9)


def test_durations_are_ignored():
    law = IntegralAdaptation()
    state = law.start(4)
    assert not law.update(state, evidence(1, math.nan, state.of(1), duration=1e-4)).moved
    with_it = law.update(state, evidence(1, 0.02, state.of(1), duration=1e-4)).state
    without = law.update(state, evidence(1, 0.02, state.of(1))).state
    assert law.to_dict(with_it) == law.to_dict(without)
    assert with_it.log_flow_gain == (0.0,) * 4
    assert with_it.duration_offset == (0.0,) * 4


def test_factors_stay_within_their_bounds():
    law = IntegralAdaptation(
        GainSchedule.constant(0.9, 0.9), ParameterBounds(charge_factor=(0.9, 1.02))
    )
    final = np.exp(run(law, 40)[-1])
    np.testing.assert_allclose(final, [1.02, 0.9, 0.96, 1.02], atol=1e-6)
    state = law.start(4)
    step = law.update(state, evidence(1, 0.5, state.of(1)))
    assert step.projected
    assert step.state.of(1).charge_factor == pytest.approx(1.02)
    assert step.state.of(1).charge_factor <= 1.02


def test_dead_zone_and_export():
    law = IntegralAdaptation(GainSchedule.constant(0.5, 0.5), dead_zone=0.01)
    state = law.start(3)
    assert not law.update(state, evidence(2, -0.01, state.of(2))).moved
    moved = law.update(state, evidence(2, 0.03, state.of(2))).state
    assert moved.log_charge_factor == pytest.approx((0.0, 0.01, 0.0))
    assert law.from_dict(law.to_dict(moved)).log_charge_factor == moved.log_charge_factor


def test_impossible_parameters_are_refused():
    with pytest.raises(ParameterError, match="dead_zone"):
        IntegralAdaptation(dead_zone=-0.1)
    with pytest.raises(ParameterError, match="no field 'gain'"):
        IntegralAdaptation().replace(gain=0.1)
