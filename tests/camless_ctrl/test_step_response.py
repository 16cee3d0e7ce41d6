import numpy as np
import pytest

from camless_ctrl._step_response import StepResponse, adapted_growth, turns_of_fastest

N, CYCLES = 4, 40


def held_response(growth, turns, amplitude=0.25):
    """One cylinder's step with differences held, and a mean that turns between two modes."""
    k = np.arange(N * CYCLES)
    stays = np.tile([0.75, -0.25, -0.25, -0.25], CYCLES)
    return stays + amplitude * growth ** (k / N) * np.cos(2.0 * np.pi * turns * k / N)


@pytest.mark.parametrize("turns", [0.0, 0.3, 0.72, 1.4])
@pytest.mark.parametrize("growth", [0.9, 1.004])
def test_with_held_differences_the_mean_may_turn_at_any_rate(growth, turns):
    response = StepResponse(N, True, held_response(growth, turns, 0.1))
    assert response.growth(0) == pytest.approx(growth, abs=1e-6)
    assert [response.growth(q) for q in (1, 2)] == pytest.approx([1.0, 1.0], abs=1e-6)
    assert response.stable == (growth < 1.0)
    assert turns_of_fastest(response.adapted_poles, N) == pytest.approx(turns, abs=1e-6)


def test_growth_of_adapted_modes_of_known_poles():
    poles = np.array([0.9, 0.8j, -0.8j, -0.5])
    assert adapted_growth(poles, False, N) == pytest.approx([0.9**4, 0.8**4, 0.5**4])
    assert adapted_growth(np.array([0.5, 0.8j, -0.8j]), True, N) == pytest.approx([0.8**4])
    assert np.isnan(turns_of_fastest(poles[:0], N))
