import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ValveCommand
from plant import _layout as layout
from plant.errors import ParameterError

COMMAND = ValveCommand(4.0, 130.0)
N = 4


@pytest.fixture(scope="module")
def plant():
    return CrankAnglePlant(runner=True, oscillation=True)


def started(plant, events=2, throttle_deg=90.0):
    run = plant.start(1500.0, COMMAND, throttle_deg, event_advance_deg=5.0)
    for _ in range(events):
        run.step_event(COMMAND)
    return run


def charges(run, events):
    """Charge of each event that ends in the next windows, and the air through the throttle."""
    done, inflow = [], 0.0
    for _ in range(events):
        event = run.step_event(COMMAND)
        done += [e.air_charge for e in event.completed]
        inflow += event.throttle_mass
    return np.array(done), inflow


def manifold_pressure(run):
    e = run.plant.engine
    mass = run.state.manifold[layout.MANIFOLD_MASS]
    return mass * e.gas_constant * e.temperature / e.manifold_volume


def test_an_equal_plant_goes_on_bit_for_bit(plant):
    run = started(plant)
    other = run.continue_with(CrankAnglePlant(runner=True, oscillation=True))
    np.testing.assert_array_equal(charges(other, 6)[0], charges(run, 6)[0])


def test_the_manifold_keeps_its_pressure(plant):
    run = started(plant, throttle_deg=20.0)
    other = run.continue_with(plant.with_engine(plant.engine.replace(temperature=250.0)))
    assert manifold_pressure(run) < 0.9e5
    assert manifold_pressure(other) == pytest.approx(manifold_pressure(run), rel=1e-13)
    assert other.state.manifold[0] == pytest.approx(run.state.manifold[0] * 290.0 / 250.0)
    np.testing.assert_array_equal(other.state.cylinders, run.state.cylinders)
    assert other.throttle_deg == 20.0
    assert other.next_cylinder == run.next_cylinder == 3


def test_the_first_run_stays_where_it_was(plant):
    run, undisturbed = started(plant), started(plant)
    other = run.continue_with(plant.with_engine(plant.engine.replace(ambient_pressure=8e4)))
    charges(other, 5)
    np.testing.assert_array_equal(charges(run, 5)[0], charges(undisturbed, 5)[0])


@pytest.mark.parametrize(
    "changes",
    [
        {"ambient_pressure": 8e4},
        {"temperature": 320.0},
        {"exhaust_pressure": 1.3e5},
        {"flow_coefficient": 0.014},
        {"cylinder_flow_factors": (1.0, 0.8, 1.1, 1.0)},
    ],
)
def test_it_comes_to_the_steady_cycle_of_the_new_engine(plant, changes):
    changed = plant.with_engine(Engine.paper().replace(**changes))
    run = started(plant, throttle_deg=30.0).continue_with(changed)
    settled = np.roll(charges(run, 40 * N)[0][-N:], 2)  # cylinders 3, 4, 1, 2 stood in it
    steady = changed.steady_cycle(1500.0, COMMAND, 30.0).air_charge
    before = plant.steady_cycle(1500.0, COMMAND, 30.0).air_charge
    assert settled == pytest.approx(steady, rel=2e-5)
    assert np.max(np.abs(steady / before - 1.0)) > 0.01


def test_no_air_is_lost_when_the_pressure_changes(plant):
    # over whole cycles, from IVO to IVO, what passed the throttle is in manifold or cylinders
    changed = plant.with_engine(plant.engine.replace(ambient_pressure=7e4))
    run = started(plant, events=N).continue_with(changed)
    before = run.state.manifold[layout.MANIFOLD_MASS]
    taken, inflow = charges(run, 3 * N)
    after = run.state.manifold[layout.MANIFOLD_MASS]
    assert taken.size == 3 * N
    assert inflow == pytest.approx(taken.sum() + after - before, abs=1e-12)
    assert before - after > 1e-4 * 3.0  # 30 kPa of a litre are 0.36 g


@pytest.mark.parametrize(
    ("other", "what"),
    [
        (CrankAnglePlant(Engine.paper().replace(n_cylinders=3), oscillation=True), "n_cylinders"),
        (
            CrankAnglePlant(Engine.paper().replace(manifold_volume=2e-3), oscillation=True),
            "manifold_volume is 0.002",
        ),
        (CrankAnglePlant(oscillation=False), "oscillation is False"),
        (CrankAnglePlant(oscillation=True, runner=False), "runner is False"),
        (CrankAnglePlant(oscillation=True, resolution=2.0), "resolution is 2.0"),
        (
            CrankAnglePlant(
                Engine.paper().replace(valvetrain=Engine().valvetrain.replace(roundness=0.2)),
                oscillation=True,
            ),
            "valvetrain",
        ),
    ],
)
def test_another_geometry_is_refused(plant, other, what):
    run = started(plant)
    with pytest.raises(ParameterError, match=what):
        run.continue_with(other)
