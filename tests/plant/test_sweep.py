import numpy as np
import pytest

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant.sweep import sweep


def test_a_sweep_gives_the_steady_cycles_in_the_order_of_its_points():
    plant = CrankAnglePlant()
    durations = np.linspace(60.0, 220.0, 150).reshape(3, 50)
    calls = []
    result = sweep(plant, 1500.0, 3.0, durations, progress=lambda *call: calls.append(call))
    assert result.air_charge.shape == result.pumping_loss.shape == (3, 50)
    for index in [(0, 0), (1, 17), (2, 49)]:
        cycle = plant.steady_cycle(1500.0, ValveCommand(3.0, durations[index]))
        assert result.air_charge[index] == pytest.approx(cycle.air_charge.mean(), rel=1e-12)
        assert result.pumping_loss[index] == pytest.approx(cycle.pumping_loss.mean(), rel=1e-12)
    assert calls[-1] == (150, 150)
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)


def test_bad_points_stop_the_sweep():
    with pytest.raises(ParameterError, match=r"cannot reach 8 mm"):
        sweep(CrankAnglePlant(), 6000.0, 8.0, [60.0, 200.0])
    with pytest.raises(ParameterError, match="no operating point"):
        sweep(CrankAnglePlant(), 6000.0, 8.0, [])
