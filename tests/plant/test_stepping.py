from __future__ import annotations

import numpy as np
import pytest

from plant import (
    CrankAnglePlant,
    Engine,
    ParameterError,
    PlantState,
    SimulationError,
    ValveCommand,
)

UNEQUAL = (
    ValveCommand(3.0, 189.0),
    ValveCommand(2.0, 120.0, 10.0),
    ValveCommand(5.0, 230.0, -8.0),
    ValveCommand(1.0, 150.0, 5.0),
)


@pytest.fixture(scope="module")
def plant():
    return CrankAnglePlant()


def step_cycles(run, commands, cycles):
    """Charges, losses and throttle mass of `cycles` cycles, event by event."""
    done, air = [], []
    for _ in range(cycles):
        for command in commands:
            result = run.step_event(command)
            done += result.completed
            air.append(result.throttle_mass)
    return done, air


@pytest.mark.parametrize("throttle_deg", [90.0, 25.0])
def test_steps_give_the_numbers_of_the_steady_run(plant, throttle_deg):
    cycle = plant.steady_cycle(1800.0, UNEQUAL, throttle_deg)
    run = plant.start(1800.0, UNEQUAL, throttle_deg)
    done, air = step_cycles(run, UNEQUAL, 2)
    last = {event.cylinder: event for event in done}
    charge = np.array([last[j].air_charge for j in (1, 2, 3, 4)])
    loss = np.array([last[j].pumping_loss for j in (1, 2, 3, 4)])
    scale = np.max(cycle.air_charge)
    # periodic to 1e-10 of a displaced volume of air
    assert charge == pytest.approx(cycle.air_charge, abs=1e-9 * scale)
    assert loss == pytest.approx(cycle.pumping_loss, rel=1e-8)
    assert sum(air[:4]) == pytest.approx(cycle.throttle_mass, rel=1e-9)
    assert run.state.time == pytest.approx(2 * 120.0 / 1800.0, rel=1e-12)


def test_every_event_is_reported_once_with_its_cylinder(plant):
    run = plant.start(1800.0, UNEQUAL)
    first = [run.step_event(c) for c in UNEQUAL * 2]
    assert [r.cylinder for r in first] == [1, 2, 3, 4, 1, 2, 3, 4]
    assert [r.event_index for r in first] == list(range(8))
    # with windows that start 8 deg early, events 1 and 3 (shut at 189 and 222) end in the next
    assert [[c.cylinder for c in r.completed] for r in first] == [
        [], [1, 2], [], [3, 4], [], [1, 2], [], [3, 4],
    ]  # fmt: skip


def test_command_is_latched_at_its_opening(plant):
    """What the next cylinders are told does not move an event whose valve has closed."""
    early = ValveCommand(3.0, 120.0)
    charges = []
    for other in (early, ValveCommand(8.0, 200.0)):
        run = plant.start(1500.0, early)
        charges.append(run.step_event(early).completed[0].air_charge)
        run.step_event(other)
    assert charges[0] == charges[1]


def test_saved_state_goes_on_bit_for_bit(plant, tmp_path):
    run = plant.start(3000.0, UNEQUAL, 40.0)
    step_cycles(run, UNEQUAL, 1)
    run.step_event(UNEQUAL[0], speed_rpm=2500.0)  # the first valve is still open here
    run.state.save(tmp_path / "state.json")
    restored = PlantState.load(tmp_path / "state.json")
    assert restored.event_index == run.state.event_index
    assert np.array_equal(restored.cylinders, run.state.cylinders)
    other = CrankAnglePlant().resume(restored, 2500.0, 40.0)
    assert other.next_cylinder == run.next_cylinder == 2
    for command in UNEQUAL[1:] + UNEQUAL[:1]:
        a, b = run.step_event(command), other.step_event(command)
        assert a == b
    assert np.array_equal(run.state.cylinders, other.state.cylinders)
    assert np.array_equal(run.state.manifold, other.state.manifold)


@pytest.mark.parametrize(
    "other",
    [
        {"runner": False},
        {"oscillation": True},
        {"resolution": 2.0},
        {"engine": Engine.paper().replace(temperature=316.0)},
    ],
)
def test_state_of_another_plant_is_refused(plant, other):
    state = plant.start(1500.0, UNEQUAL).state
    with pytest.raises(ParameterError, match="belongs to plant"):
        CrankAnglePlant(**other).resume(state, 1500.0)


@pytest.mark.parametrize(
    "text",
    ["", "[1, 2]", "{}", '{"format": "something else"}', "not json"],
)
def test_a_file_that_is_no_state_is_refused(tmp_path, text):
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(ParameterError, match=r"state\.json"):
        PlantState.load(path)


def test_a_state_that_cannot_be_written_leaves_nothing(plant, tmp_path):
    state = plant.start(1500.0, UNEQUAL).state
    with pytest.raises(OSError):  # noqa: PT011 (the kind depends on the system)
        state.save(tmp_path / "missing" / "state.json")
    assert list(tmp_path.iterdir()) == []


def test_state_is_immutable(plant):
    state = plant.start(1500.0, UNEQUAL).state
    with pytest.raises(ValueError, match="read-only"):
        state.cylinders[0, 0] = 1.0


def test_a_refused_step_leaves_the_run_where_it_stood(plant):
    run = plant.start(1500.0, UNEQUAL)
    before = run.state
    with pytest.raises(ParameterError):
        run.step_event(ValveCommand(7.0, 20.0), speed_rpm=6000.0)
    assert run.state is before
    assert run.speed_rpm == 1500.0


@pytest.mark.parametrize("shift", [1, 2, 3])
def test_cylinders_differ_only_by_their_place_in_the_firing_order(plant, shift):
    cycle = plant.steady_cycle(2000.0, UNEQUAL, 30.0)
    moved = plant.steady_cycle(2000.0, UNEQUAL[-shift:] + UNEQUAL[:-shift], 30.0)
    # both are periodic to 1e-10, from different starts
    scale = np.max(cycle.air_charge)
    assert moved.air_charge == pytest.approx(np.roll(cycle.air_charge, shift), abs=1e-8 * scale)
    assert moved.pumping_loss == pytest.approx(np.roll(cycle.pumping_loss, shift), rel=1e-7)


def test_windows_may_begin_earlier():
    """`event_advance_deg` places the windows; the periodic solution does not depend on it."""
    plant = CrankAnglePlant(resolution=8.0)
    cycle = plant.steady_cycle(1500.0, UNEQUAL, 35.0)
    for advance in (30.0, 90.0):
        run = plant.start(1500.0, UNEQUAL, 35.0, event_advance_deg=advance)
        done, _ = step_cycles(run, UNEQUAL, 2)
        last = {event.cylinder: event for event in done}
        charge = np.array([last[j].air_charge for j in (1, 2, 3, 4)])
        assert charge == pytest.approx(cycle.air_charge, rel=1e-5)


def test_a_step_of_the_throttle_fills_or_empties_the_manifold(plant):
    """Closing the throttle lowers the manifold pressure event by event, towards the new cycle."""
    command = ValveCommand(5.0, 200.0)
    run = plant.start(1500.0, command)
    pressures = [run.step_event(command, throttle_deg=20.0).manifold_pressure for _ in range(60)]
    assert np.all(np.diff(pressures[:8]) < 0.0)
    target = plant.steady_cycle(1500.0, command, 20.0)
    end = plant.start(1500.0, command, 20.0).step_event(command).manifold_pressure
    assert pressures[-1] == pytest.approx(end, rel=1e-4)
    assert target.throttle_mass == pytest.approx(np.sum(target.air_charge), rel=1e-8)


@pytest.mark.parametrize(
    ("n", "command", "speeds"),
    [
        (4, ValveCommand(8.0, 300.0), (1500.0, 2500.0)),  # closes past the compression TDC
        (4, ValveCommand(8.0, 360.0), (750.0, 6000.0)),  # would open again while open
        (3, ValveCommand(4.0, 350.0), (750.0, 1200.0)),
    ],
)
def test_valve_that_a_rising_speed_carries_past_compression_is_refused(n, command, speeds):
    plant = CrankAnglePlant(Engine(n_cylinders=n), runner=False)
    run = plant.start(speeds[0], command)
    run.step_event(command)
    start = run.state.event_index

    def rise():
        for _ in range(n):
            run.step_event(command, speed_rpm=speeds[1])

    with pytest.raises(SimulationError, match="still open at the compression TDC"):
        rise()
    assert start <= run.state.event_index < start + n


def test_damaged_state_is_refused(plant, tmp_path):
    plant.start(1500.0, ValveCommand(3.0, 189.0)).state.save(tmp_path / "state.json")
    text = (tmp_path / "state.json").read_text()
    number = text.split('"manifold": [')[1].split(",")[0].strip()
    (tmp_path / "state.json").write_text(text.replace(number, "NaN"))
    with pytest.raises(ParameterError, match="not finite"):
        PlantState.load(tmp_path / "state.json")
