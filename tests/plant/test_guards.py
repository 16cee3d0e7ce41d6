"""What machine code must never be handed, and what must never run for ever."""

import dataclasses

import numpy as np
import pytest

from plant import (
    CrankAnglePlant,
    Engine,
    HelmholtzRunner,
    ParameterError,
    SimulationError,
    ValveCommand,
)

COMMAND = ValveCommand(3.0, 189.0)


def edited(state, row, column, value):
    cylinders = state.cylinders.copy()
    cylinders[row, column] = value
    return dataclasses.replace(state, cylinders=cylinders)


@pytest.mark.parametrize("phase", [1e6, -1.0, 0.5, 7.0])
def test_a_state_with_an_unknown_valve_phase_is_refused(phase):
    state = CrankAnglePlant().start(1500.0, COMMAND).state
    with pytest.raises(ParameterError, match=r"valve phases .* from 0 to 6"):
        edited(state, 0, 0, phase)


def test_a_state_that_is_not_finite_is_refused():
    state = CrankAnglePlant().start(1500.0, COMMAND).state
    with pytest.raises(ParameterError, match="not finite"):
        edited(state, 1, 5, np.nan)


def test_a_run_takes_states_of_its_own_plant_only():
    plant, other = CrankAnglePlant(), CrankAnglePlant(runner=False)
    run = plant.start(1500.0, COMMAND)
    before = run.state
    with pytest.raises(ParameterError, match="belongs to plant"):
        run.state = other.start(1500.0, COMMAND).state
    with pytest.raises(ParameterError, match="2 cylinders, but this plant has 4"):
        run.state = dataclasses.replace(before, cylinders=before.cylinders[:2])
    assert run.state is before


def test_a_runner_too_fast_to_follow_ends_in_an_error():
    plant = CrankAnglePlant(Engine(helmholtz=HelmholtzRunner.constant(1e20, 0.1)))
    with pytest.raises(SimulationError, match="steps within one form"):
        plant.steady_cycle(1500.0, COMMAND)


def test_a_runner_without_overshoot_is_followed():
    """Damped to the brink of not ringing: stiff, but slow in its response."""
    engine = Engine(helmholtz=HelmholtzRunner.constant(20000.0, 0.99999))
    usual, fine = (
        CrankAnglePlant(engine, resolution=r).steady_cycle(1500.0, ValveCommand(3.0, 150.0))
        for r in (1.0, 8.0)
    )
    assert usual.air_charge == pytest.approx(fine.air_charge, rel=2e-4)
