from __future__ import annotations

import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ValveCommand

CASES = {
    "camless": ({}, ValveCommand(3.0, 189.0), 1500.0, 90.0),
    "camless, early": ({"runner": False}, ValveCommand(2.0, 99.0, 10.0), 1500.0, 90.0),
    "oscillation": ({"oscillation": True}, ValveCommand(7.0, 230.0, -10.0), 6000.0, 90.0),
    "cam, throttled": ({"profile": "conventional"}, ValveCommand.conventional(), 1500.0, 22.8),
    "exact orifice": ({"orifice": "exact"}, ValveCommand(5.0, 200.0), 3000.0, 35.0),
}


def solved(case, resolution):
    options, command, speed, throttle = CASES[case]
    return CrankAnglePlant(**options, resolution=resolution).steady_cycle(speed, command, throttle)


@pytest.fixture(params=CASES, scope="module")
def cycle(request):
    """Finely resolved: else a solution repeats no better than its choice of steps."""
    return solved(request.param, 8.0)


def volume(engine, angle_deg):
    """Eq. 3."""
    return (
        engine.displaced_volume / 2 * (1 - np.cos(np.radians(angle_deg))) + engine.clearance_volume
    )


def after_closing(cycle, j):
    """Samples of cylinder j between its IVC and the compression TDC."""
    angle = (cycle.trace.crank_angle_deg - 720.0 / cycle.plant.engine.n_cylinders * j) % 720.0
    return (angle > cycle.commands[j].closing_deg + 1e-9) & (angle < 360.0)


def test_cylinder_mass_is_initial_mass_plus_charge(cycle):
    e, trace = cycle.plant.engine, cycle.trace
    gas = e.gas_constant * e.temperature
    for j, command in enumerate(cycle.commands):
        shut = after_closing(cycle, j)
        assert shut.sum() > 100
        mass = trace.cylinder_pressure[shut, j] * trace.volume[shut, j] / gas
        initial = e.exhaust_pressure * volume(e, command.opening_deg) / gas
        assert mass == pytest.approx(initial + cycle.air_charge[j], rel=1e-9)


def test_closed_valve_compression_is_isothermal(cycle):
    trace = cycle.trace
    for j in (0, 1):
        angle = trace.crank_angle_deg - 180.0 * j
        shut = (angle > cycle.commands[j].closing_deg + 1e-9) & (angle < 360.0)
        product = trace.cylinder_pressure[shut, j] * volume(cycle.plant.engine, angle[shut])
        assert product.size > 100
        assert product == pytest.approx(product[0], rel=1e-12)
        assert np.all(trace.port_flow[shut, j] == 0.0)


def test_cylinder_is_at_exhaust_pressure_when_its_valve_opens(cycle):
    e, trace = cycle.plant.engine, cycle.trace
    opening = cycle.commands[0].opening_deg
    at_opening = np.flatnonzero(np.abs(trace.crank_angle_deg - opening) < 1e-9)
    assert at_opening.size == 1
    assert trace.cylinder_pressure[at_opening[0], 0] == pytest.approx(e.exhaust_pressure, rel=1e-9)


def test_throttle_mass_feeds_the_cylinders(cycle):
    assert cycle.throttle_mass == pytest.approx(np.sum(cycle.air_charge), rel=1e-8)


def test_manifold_mass_follows_its_flows(cycle):
    """Eq. 1 between samples: trapezoidal sums of the flows against the pressure.

    The sums are as coarse as the samples where the flow of an opening valve reverses.
    """
    trace = cycle.trace_at(0.25)
    e = trace.engine
    net = trace.throttle_flow - trace.port_flow.sum(axis=1)
    gained = np.concatenate([[0.0], np.cumsum(0.5 * (net[1:] + net[:-1]) * np.diff(trace.time))])
    mass = trace.manifold_pressure * e.manifold_volume / (e.gas_constant * e.temperature)
    assert mass == pytest.approx(mass[0] + gained, rel=4e-4)


@pytest.mark.parametrize("j", [0, 1])
def test_port_flow_integrates_to_the_charge(cycle, j):
    for step, bar in ((1.0, 1e-2), (0.1, 2e-4)):
        trace = cycle.trace_at(step)
        integral = np.trapezoid(trace.port_flow[:, j], trace.time)
        assert integral == pytest.approx(cycle.air_charge[j], abs=bar * cycle.air_charge[j] + 1e-9)


def simplified(ratio, feeding):
    """Eq. 13-14."""
    return np.where(ratio <= 0.5, 1.0, 2.0 * np.sqrt(ratio - ratio**2))


def exact(ratio, feeding):
    """Eq. 10-11 over the sonic flow at 1 bar, for gamma = 1.4."""
    x = np.maximum(ratio, 0.528282)
    return feeding / 1e5 * x ** (1 / 1.4) * np.sqrt(7.0 * (1.0 - x ** (2 / 7))) / 0.684731


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("resolution", "bar"), [(1.0, 1e-2), (4.0, 2e-3)])
def test_port_flow_follows_the_orifice(case, resolution, bar):
    """Eq. 16 and 17 between the trace's own signals, away from the infinite slope.

    Between the ends of a step a trace's flow is a parabola.
    """
    cycle = solved(case, resolution)
    psi = {"simplified": simplified, "exact": exact}[cycle.plant.orifice]
    trace = cycle.trace_at(0.25)
    compared = 0
    for j in range(4):
        p_1, p_2 = trace.cylinder_pressure[:, j], trace.runner_pressure[:, j]
        low, high = np.minimum(p_1, p_2), np.maximum(p_1, p_2)
        clear = (trace.lift_mm[:, j] > 0.3) & (low < 0.97 * high)
        sonic = trace.engine.flow_coefficient * trace.lift_mm[clear, j]
        expected = np.sign(p_2 - p_1)[clear] * sonic * psi(low[clear] / high[clear], high[clear])
        assert trace.port_flow[clear, j] == pytest.approx(expected, abs=bar * np.max(sonic))
        compared += clear.sum()
    assert compared > 100


def test_charge_does_not_depend_on_being_watched(cycle):
    before = cycle.air_charge.copy()
    trace = cycle.trace_at(0.7)
    again = cycle.trace_at(0.7)
    assert np.array_equal(trace.manifold_pressure, again.manifold_pressure)
    assert np.array_equal(cycle.air_charge, before)
    run = cycle.plant.start(cycle.speed_rpm, cycle.commands, cycle.throttle_deg)
    state = run.state
    for command in cycle.commands:
        run.step_event(command)
    unwatched = run.state
    run.state = state
    for command in cycle.commands:
        run.step_event(command, trace_step_deg=0.7)
    assert np.array_equal(unwatched.cylinders, run.state.cylinders)
    assert np.array_equal(unwatched.manifold, run.state.manifold)


def test_balance_for_any_number_of_cylinders():
    for n in (1, 3, 6, 12):
        engine = Engine.paper().replace(n_cylinders=n)
        # finely resolved: else a solution repeats no better than its choice of steps
        plant = CrankAnglePlant(engine, resolution=8.0)
        cycle = plant.steady_cycle(2000, ValveCommand(4.0, 200.0), 50.0)
        assert cycle.air_charge.shape == (n,)
        assert cycle.throttle_mass == pytest.approx(np.sum(cycle.air_charge), rel=1e-8)
        assert np.ptp(cycle.air_charge) < 1e-8 * cycle.air_charge[0]
