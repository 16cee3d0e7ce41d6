"""What `CrankAnglePlant` refuses: options, speeds, throttle angles, commands."""

from __future__ import annotations

import math

import pytest

from plant import (
    ConvergenceError,
    CrankAnglePlant,
    Engine,
    InfeasibleProfileError,
    MafSensor,
    ParameterError,
    SimulationError,
    ValveCommand,
)
from plant.parameters import PRINTED_RUNNER_AREA

COMMAND = ValveCommand(3.0, 189.0)


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        ({"engine": "paper"}, ("engine is 'paper'", "must be an Engine")),
        ({"profile": "camles"}, ("profile is 'camles'", "camless, conventional", "did you mean")),
        ({"orifice": "heywood"}, ("orifice is 'heywood'", "simplified, exact")),
        ({"resolution": 0.0}, ("resolution is 0", "[0.1, 1000]")),
        ({"resolution": math.nan}, ("resolution is nan", "[0.1, 1000]")),
        (
            {"profile": "conventional", "oscillation": True},
            ("oscillation is True", "use profile='camless'"),
        ),
    ],
)
def test_options_are_checked(options, fragments):
    with pytest.raises(ParameterError) as e:
        CrankAnglePlant(**options)
    for fragment in fragments:
        assert fragment in str(e.value)


@pytest.mark.parametrize("speed", [0.0, -1500.0, math.nan, math.inf, 1e6, "1500"])
def test_speed_is_checked(speed):
    plant = CrankAnglePlant()
    run = plant.start(1500.0, COMMAND)
    for call in (
        lambda: plant.steady_cycle(speed, COMMAND),
        lambda: plant.start(speed, COMMAND),
        lambda: run.step_event(COMMAND, speed_rpm=speed),
    ):
        with pytest.raises(ParameterError, match=r"speed_rpm .*rpm"):
            call()


def test_speed_message_says_value_bound_and_unit():
    with pytest.raises(ParameterError) as e:
        CrankAnglePlant().steady_cycle(-5.0, COMMAND)
    assert "speed_rpm is -5 rpm, but must be in (0, 20000] rpm" in str(e.value)


@pytest.mark.parametrize("throttle", [0.0, 9.9, 90.1, math.nan])
def test_throttle_is_checked(throttle):
    with pytest.raises(ParameterError) as e:
        CrankAnglePlant().steady_cycle(1500.0, COMMAND, throttle)
    for fragment in (f"throttle_deg is {throttle:g} deg", "90] deg", "Eq. 19 gives no flow"):
        assert fragment in str(e.value)


@pytest.mark.parametrize(
    ("command", "fragments"),
    [
        (
            [COMMAND] * 3,
            ("3 valve commands for 4 cylinders", "one command for all", "one for each"),
        ),
        ([COMMAND] * 5, ("5 valve commands for 4 cylinders",)),
        ([], ("0 valve commands for 4 cylinders",)),
        ([COMMAND, None, COMMAND, COMMAND], ("command holds None", "ValveCommand")),
        ([(3.0, 189.0)] * 4, ("command holds (3.0, 189.0)", "ValveCommand")),
    ],
)
def test_commands_are_checked(command, fragments):
    with pytest.raises(ParameterError) as e:
        CrankAnglePlant().steady_cycle(1500.0, command)
    for fragment in fragments:
        assert fragment in str(e.value)


def test_opening_after_the_event_window_is_refused():
    plant = CrankAnglePlant(Engine.paper().replace(n_cylinders=6))  # windows of 120 deg
    with pytest.raises(ParameterError) as e:
        plant.steady_cycle(1500.0, ValveCommand(3.0, 150.0, 130.0))
    for fragment in ("opening_deg is 130 deg", "[0, 120) deg", "6 cylinders", "event_advance_deg"):
        assert fragment in str(e.value)


def test_windows_that_begin_after_a_valve_opens_are_refused():
    with pytest.raises(ParameterError) as e:
        CrankAnglePlant().start(1500.0, ValveCommand(3.0, 200.0, -20.0), event_advance_deg=10.0)
    for fragment in ("event_advance_deg is 10 deg", "[20, 180) deg", "no valve may open before"):
        assert fragment in str(e.value)


def test_infeasible_profile_is_refused_or_limited():
    plant = CrankAnglePlant()
    command = ValveCommand(7.0, 60.0)
    with pytest.raises(InfeasibleProfileError, match=r"60 deg at 6000 rpm cannot reach 7 mm"):
        plant.steady_cycle(6000.0, command)
    with pytest.raises(InfeasibleProfileError):
        plant.start(3000.0, COMMAND).step_event(command, speed_rpm=6000.0)
    cycle = plant.steady_cycle(6000.0, command, on_infeasible="limit")
    assert cycle.limited.all()
    result = plant.start(6000.0, command, on_infeasible="limit").step_event(command)
    assert result.limited
    assert result.delivered_lift_mm == cycle.delivered_lift_mm[0]


@pytest.mark.parametrize("tolerance", [0.0, -1e-9, math.nan])
def test_tolerance_is_checked(tolerance):
    with pytest.raises(ParameterError, match="tolerance is"):
        CrankAnglePlant().steady_cycle(1500.0, COMMAND, tolerance=tolerance)


def test_cycles_that_do_not_settle_are_told(monkeypatch):
    """At 15 deg of throttle the manifold empties over many cycles."""
    monkeypatch.setattr("plant.crank_angle.MOST_CYCLES", 1)
    with pytest.raises(ConvergenceError) as e:
        CrankAnglePlant().steady_cycle(1500.0, ValveCommand(5.0, 200.0), 15.0)
    for fragment in ("after 1 cycles at 1500 rpm", "throttle 15 deg", "1.0e-10", "raise the toler"):
        assert fragment in str(e.value)


def test_printed_runner_area_is_refused_in_words():
    engine = Engine.paper().replace(runner_area=PRINTED_RUNNER_AREA)
    with pytest.raises(SimulationError, match=r"runner_area, m2") as e:
        CrankAnglePlant(engine).steady_cycle(3000.0, COMMAND)
    assert "runner=False" in str(e.value)


@pytest.mark.parametrize("step", [0.0, -1.0, 200.0, math.nan])
def test_trace_step_is_checked(step):
    cycle = CrankAnglePlant().steady_cycle(1500.0, COMMAND)
    with pytest.raises(ParameterError, match=r"trace step is .*deg"):
        cycle.trace_at(step)


@pytest.mark.parametrize("cylinder", [0, 5, -1])
def test_cylinder_to_plot_is_checked(cylinder):
    trace = CrankAnglePlant().steady_cycle(1500.0, COMMAND).trace
    with pytest.raises(ParameterError, match=f"cylinder is {cylinder}, but must be from 1 to 4"):
        trace.plot(cylinder)


def test_trace_says_its_units():
    dataset = CrankAnglePlant().steady_cycle(1500.0, COMMAND).trace.to_dataset()
    assert dataset["manifold_pressure"].attrs["units"] == "Pa"
    assert dataset["lift"].attrs["units"] == "mm"
    assert dataset["port_flow"].dims == ("crank_angle", "cylinder")
    assert list(dataset["cylinder"].values) == [1, 2, 3, 4]
    assert all("units" in dataset[name].attrs for name in dataset.data_vars)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: CrankAnglePlant(runner="no"), "runner is 'no'"),
        (lambda: CrankAnglePlant().steady_cycle(1500, None), "command is None"),
        (lambda: CrankAnglePlant().steady_cycle(1500, 3.0), "command is 3.0"),
        (lambda: CrankAnglePlant().resume(None, 1500), "state is None"),
        (
            lambda: CrankAnglePlant(profile="conventional").steady_cycle(
                1500, ValveCommand.conventional(), on_infeasible="foo"
            ),
            "on_infeasible is 'foo'",
        ),
        (lambda: MafSensor().start(-1), "seed is -1"),
    ],
)
def test_arguments_of_the_wrong_kind_are_named(call, named):
    with pytest.raises(ParameterError, match=named):
        call()
