"""The periodic solution: that of long integration, in few cycles, and one to go on from."""

from __future__ import annotations

import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ValveCommand
from plant._layout import FLOW

LONG = ValveCommand(4.0, 330.0)  # overlaps with the next events
UNEQUAL = [
    ValveCommand(3.0, 190.0),
    ValveCommand(2.0, 150.0, -15.0),
    ValveCommand(4.0, 220.0, 10.0),
    ValveCommand(0.0, 100.0),
]


def settle(plant, speed, command, throttle, cycles):
    """Charge and loss of each cylinder at the end of a long run from wide open throttle."""
    commands = (
        [command] * plant.engine.n_cylinders if isinstance(command, ValveCommand) else command
    )
    run = plant.start(speed, command)
    last = {}
    for k in range(cycles * len(commands)):
        event = run.step_event(commands[k % len(commands)], throttle_deg=throttle)
        last.update({done.cylinder: done for done in event.completed})
    cylinders = range(1, len(commands) + 1)
    return (
        np.array([last[j].air_charge for j in cylinders]),
        np.array([last[j].pumping_loss for j in cylinders]),
    )


# The finer steps hide their own choice, which at resolution 1 shows from 1e-6 on.
@pytest.mark.parametrize(
    ("engine", "speed", "command", "throttle", "cycles"),
    [
        (Engine(n_cylinders=1), 1500.0, ValveCommand(5.0, 200.0), 17.0, 60),
        (Engine(n_cylinders=2), 3000.0, LONG, 22.0, 60),
        (Engine(), 1500.0, ValveCommand(5.0, 200.0), 14.0, 40),
        (Engine(), 6000.0, LONG, 17.0, 50),
        (Engine(), 3000.0, ValveCommand(4.0, 300.0, -60.0), 22.0, 50),
        (Engine(n_cylinders=12), 3000.0, LONG, 30.0, 30),
        (Engine(), 2000.0, UNEQUAL, 18.0, 40),
        (Engine(cylinder_flow_factors=(0.5, 1.0, 1.2, 0.9)), 3000.0, LONG, 20.0, 60),
    ],
)
def test_it_is_where_long_integration_ends(engine, speed, command, throttle, cycles):
    plant = CrankAnglePlant(engine, resolution=8.0)
    cycle = plant.steady_cycle(speed, command, throttle)
    charge, loss = settle(plant, speed, command, throttle, cycles)
    assert cycle.air_charge == pytest.approx(charge, rel=1e-6, abs=1e-12)
    assert cycle.pumping_loss == pytest.approx(loss, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("throttle", [16.0, 90.0])
@pytest.mark.parametrize("n", [2, 4, 6])
@pytest.mark.parametrize("command", [ValveCommand(3.0, 180.0), LONG, ValveCommand(5.0, 280.0, -40)])
def test_equal_cylinders_are_solved_by_events_as_by_cycles(n, command, throttle):
    """A flow factor off by less than matters has the cylinders told apart."""
    by_events = CrankAnglePlant(Engine(n_cylinders=n), resolution=8.0)
    factors = (1.0,) * (n - 1) + (1.0 + 1e-13,)
    by_cycles = CrankAnglePlant(
        Engine(n_cylinders=n, cylinder_flow_factors=factors), resolution=8.0
    )
    one, other = (plant.steady_cycle(3000.0, command, throttle) for plant in (by_events, by_cycles))
    assert one.air_charge == pytest.approx(other.air_charge, rel=1e-6)
    assert one.pumping_loss == pytest.approx(other.pumping_loss, rel=1e-6)
    assert one.throttle_mass == pytest.approx(other.throttle_mass, rel=1e-6)
    assert other.cycles == round(other.cycles)  # it ends at whole cycles only


def test_a_throttled_engine_takes_few_cycles():
    """Its manifold takes tens of cycles to empty; the extrapolation does not wait for it.

    Where the choice of steps jumps under it, it takes longer, but that is rare.
    """
    cycles = [
        CrankAnglePlant().steady_cycle(speed, ValveCommand(4.0, 240.0), throttle)
        for speed in (750.0, 1500.0, 3000.0, 6000.0)
        for throttle in (14.0, 17.0, 20.0, 25.0, 30.0)
    ]
    assert max(cycle.residual for cycle in cycles) <= 1e-6
    assert np.mean([cycle.cycles for cycle in cycles]) <= 4.0
    assert max(cycle.cycles for cycle in cycles) <= 15.0


@pytest.mark.parametrize(
    ("engine", "command"),
    [
        (Engine(n_cylinders=1), LONG),
        (Engine(), ValveCommand(3.0, 189.0)),
        (Engine(), LONG),
        (Engine(), ValveCommand(4.0, 300.0, -60.0)),
        (Engine(n_cylinders=12), LONG),
        (Engine(), UNEQUAL),
    ],
)
def test_its_state_repeats_after_a_cycle(engine, command):
    # finely resolved: else a solution repeats no better than its choice of steps
    plant = CrankAnglePlant(engine, resolution=16.0)
    cycle = plant.steady_cycle(2500.0, command, 20.0)
    n = engine.n_cylinders
    run = plant.start(2500.0, command, 20.0)
    start = run.state
    done = []
    for k in range(n):
        c = command if isinstance(command, ValveCommand) else command[k]
        done += run.step_event(c).completed
    assert sorted(event.cylinder for event in done) == list(range(1, n + 1))
    for event in done:
        j = event.cylinder - 1
        assert event.air_charge == pytest.approx(cycle.air_charge[j], rel=1e-7, abs=1e-15)
        assert event.pumping_loss == pytest.approx(cycle.pumping_loss[j], rel=1e-7, abs=1e-12)
    # every number of every cylinder but the count of its events, which grows by one
    grown = run.state.cylinders - start.cylinders
    assert np.all(grown[:, -1] == 1.0)
    size = np.max(np.abs(start.cylinders), axis=0)[:-1] + 1e-12
    share = np.max(np.abs(grown[:, :-1]) / size, axis=0)
    assert np.max(np.delete(share, FLOW)) < 1e-6
    assert share[FLOW] < 1e-4  # as the root of a small difference of pressures
    assert run.state.manifold[0] == pytest.approx(start.manifold[0], rel=1e-8)
    assert run.state.manifold[1] == pytest.approx(cycle.throttle_mass, rel=1e-7)


def test_the_trace_of_equal_cylinders_repeats_one_event_apart():
    """The trace starts from the state of the solution, for every cylinder."""
    cycle = CrankAnglePlant().steady_cycle(3000.0, LONG, 20.0)
    lift = cycle.trace.to_dataset()["lift"].values
    step = len(lift) // 4
    for j in range(1, 4):
        assert np.roll(lift[:, 0], step * j) == pytest.approx(lift[:, j], abs=1e-9)
