import dataclasses

import control
import numpy as np
import pytest

from plant import (
    CrankAnglePlant,
    MafSensor,
    MapSensor,
    ParameterError,
    ValveCommand,
    first_order_lag,
)
from plant._lifting import lifted
from plant.air_path import FlowShape, PulseResponse, event_time
from plant.mean_value import MeanValuePlant

PLANT = CrankAnglePlant()
ENGINE = PLANT.engine
CAPACITY = ENGINE.manifold_volume / (ENGINE.gas_constant * ENGINE.temperature)  # kg/Pa
INPUTS = ["lift_mm", "duration_deg", "speed_rpm"]
OUTPUTS = [
    "air_charge",
    "power_charge",
    "pumping_loss",
    "throttle_flow",
    "manifold_pressure",
    "maf",
    "map",
]
GAINS = (0.9, 1.0, 1.15, 1.05)
COMMANDS = [ValveCommand(3.0, 120.0 + 4.0 * k) for k in (0, 1, -1, 2)]
PROMPT = MafSensor(delay=0.0)


@pytest.fixture(scope="module")
def maps():
    """Coarse maps of all speeds."""
    return MeanValuePlant.fit(PLANT, most_points=900)


@pytest.fixture(scope="module")
def fine():
    """Maps of a range of speeds; their charge is good to 2 %."""
    return MeanValuePlant.fit(PLANT, speed_range_rpm=(1000.0, 3200.0), most_points=3000)


@pytest.fixture(scope="module")
def throttled(fine):
    """The same, for a throttle down to 22 deg."""
    return fine.with_boundary_conditions(
        PLANT,
        ambient_pressure=(0.35e5, 1.05e5),
        temperature=(285.0, 295.0),
        exhaust_pressure=(1.08e5, 1.12e5),
        samples=5,
    )


def with_engine(maps, **changes):
    return dataclasses.replace(maps, engine=maps.engine.replace(**changes))


def sonic_flow(throttle_deg):
    """Eq. 19, written down a second time, kg/s."""
    return 1.268e-4 * (-0.2215 - 2.275 * throttle_deg + 0.23 * throttle_deg**2)


def eq_15(throttle_deg, pressure):
    """Flow through the throttle at a manifold pressure (Eq. 13-15), kg/s."""
    x = np.asarray(pressure) / ENGINE.ambient_pressure
    psi = np.where(x <= 0.5, 1.0, 2.0 * np.sqrt(np.maximum(x - x**2, 0.0)))
    return sonic_flow(throttle_deg) * psi


def some_state(dynamics, pressure):
    """A state at a manifold pressure, whatever the sensors saw before."""
    state = np.full(dynamics.as_nonlinear_system().nstates, 1e-4)
    state[0] = pressure
    return state


# -- conservation and steady state ---------------------------------------------------------------


@pytest.mark.parametrize("throttle_deg", [90.0, 30.0])
def test_what_passes_the_throttle_and_not_the_valves_is_in_the_manifold(throttled, throttle_deg):
    dynamics = throttled.dynamics(gains=GAINS, throttle_deg=throttle_deg)
    before = dynamics.operating_point(COMMANDS, 1500.0)
    random = np.random.default_rng(2)
    speed = np.linspace(1500.0, 3000.0, 60)
    run = dynamics.simulate(3.0, random.uniform(90.0, 150.0, 60), speed, first=before)
    T = 120.0 / (4 * speed)
    np.testing.assert_allclose(run.time, np.concatenate(([0.0], np.cumsum(T)[:-1])), rtol=1e-13)
    net = np.cumsum(run.throttle_flow.values * T - run.air_charge.values)
    pressure = run.manifold_pressure.values
    stored = CAPACITY * (pressure - before.output("manifold_pressure")[-1])
    assert np.ptp(stored) > 1e-6
    np.testing.assert_allclose(net, stored, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("throttle_deg", [14.0, 30.0, 90.0])
@pytest.mark.parametrize("pressure", [20e3, 45e3, 60e3, 90e3, 99.9e3])
def test_each_event_fills_the_manifold_with_the_flow_at_its_end(maps, throttle_deg, pressure):
    dynamics = maps.dynamics(throttle_deg=throttle_deg)
    state = some_state(dynamics, pressure)
    end, outputs = dynamics.advance(state, (3.0, 100.0, 1500.0))
    flow = outputs[OUTPUTS.index("throttle_flow")]
    assert flow == pytest.approx(float(eq_15(throttle_deg, end[0])), rel=1e-8)
    filled = CAPACITY * (end[0] - pressure) + outputs[0]
    assert flow * 0.02 == pytest.approx(filled, rel=1e-9)


def test_an_overfull_manifold_empties_through_the_throttle(maps):
    # Eq. 13 backwards: -A Psi(p_o/p). The step may differ from it in second order of p - p_o.
    dynamics = maps.dynamics(throttle_deg=14.0)
    state = some_state(dynamics, 1.08e5)
    end, outputs = dynamics.advance(state, (3.0, 40.0, 1500.0))
    assert 1e5 < end[0] < 1.08e5
    x = 1e5 / end[0]
    backwards = -sonic_flow(14.0) * 2.0 * np.sqrt(x - x**2)
    assert outputs[3] == pytest.approx(backwards, rel=1.5 * (1.0 - x))


@pytest.mark.parametrize("throttle_deg", [90.0, 40.0, 30.0, 24.0])
def test_steady_state_of_equal_cylinders(throttled, throttle_deg):
    dynamics = throttled.dynamics(throttle_deg=throttle_deg)
    point = dynamics.operating_point(ValveCommand(3.0, 120.0), 1500.0)
    charge, flow, pressure = (
        point.output(name) for name in ("air_charge", "throttle_flow", "manifold_pressure")
    )
    assert np.ptp(pressure) < 1e-4
    np.testing.assert_allclose(flow, charge / 0.02, rtol=1e-9)
    np.testing.assert_allclose(flow, eq_15(throttle_deg, pressure), rtol=1e-8)
    np.testing.assert_allclose(point.output("power_charge"), charge, rtol=1e-12)
    np.testing.assert_allclose(point.output("maf"), flow, rtol=1e-9)
    np.testing.assert_allclose(point.output("map"), pressure, rtol=1e-12)
    assert "1500 rpm: charges" in str(point)


def test_wide_open_the_charge_is_that_of_the_map(fine, throttled):
    expected = fine.air_charge(3.0, 120.0, 1500.0)
    loss = fine.pumping_loss(3.0, 120.0, 1500.0)
    for maps in (fine, throttled):
        point = maps.dynamics().operating_point(ValveCommand(3.0, 120.0), 1500.0)
        np.testing.assert_allclose(point.output("air_charge"), expected, rtol=1e-5)
        np.testing.assert_allclose(point.output("pumping_loss"), loss, rtol=1e-5)


def test_errors_of_the_sensors_are_in_their_readings(fine):
    dynamics = fine.dynamics(
        maf=MafSensor(gain_error=0.03, offset=2e-4), map=MapSensor(gain_error=-0.01, offset=1500.0)
    )
    point = dynamics.operating_point(ValveCommand(3.0, 120.0), 1500.0)
    flow, pressure = point.output("throttle_flow"), point.output("manifold_pressure")
    np.testing.assert_allclose(point.output("maf"), 1.03 * flow + 2e-4, rtol=1e-9)
    np.testing.assert_allclose(point.output("map"), 0.99 * pressure + 1500.0, rtol=1e-9)


def test_a_cycle_of_unequal_cylinders_repeats_itself(throttled):
    dynamics = throttled.dynamics(gains=GAINS, throttle_deg=30.0)
    point = dynamics.operating_point(COMMANDS, 1500.0)
    durations = [c.duration_deg for c in COMMANDS]
    run = dynamics.simulate(3.0, durations * 5, 1500.0, first=point)
    for name in OUTPUTS:
        np.testing.assert_allclose(run[name], np.tile(point.output(name), 5), rtol=1e-8)
    flow, charge = point.output("throttle_flow"), point.output("air_charge")
    assert np.ptp(charge) > 0.1 * charge.mean()
    assert flow.sum() * 0.02 == pytest.approx(charge.sum(), rel=1e-9)
    assert run.cylinder.values[:5].tolist() == [1, 2, 3, 4, 1]


@pytest.mark.parametrize("throttle_deg", [25.0, 26.0, 27.0])
def test_a_pressure_that_is_covered_is_found_from_maps_that_end_above_a_choked_throttle(
    fine, throttle_deg
):
    # At ambient pressure the valves would take more than the throttle passes: were the first
    # guess a choked throttle (0.5 bar), it would lie outside the maps.
    maps = fine.with_boundary_conditions(PLANT, samples=1)
    point = maps.dynamics(throttle_deg=throttle_deg).operating_point(
        ValveCommand(3.0, 120.0), 1500.0
    )
    assert fine.air_charge(3.0, 120.0, 1500.0) > sonic_flow(throttle_deg) * 0.02
    assert 70e3 < point.output("manifold_pressure")[0] < 85e3


def test_a_steady_state_is_found_for_charges_next_to_nothing(fine):
    dynamics = fine.dynamics(throttle_deg=25.0)
    for duration in np.arange(28.0, 34.0, 0.1):
        point = dynamics.operating_point(ValveCommand(2.64, float(duration)), 2121.75)
        charge = fine.air_charge(2.64, duration, 2121.75)
        assert charge < 6e-6
        flow = point.output("throttle_flow") * 120.0 / (4 * 2121.75)
        np.testing.assert_allclose(flow, charge, atol=1e-14)


# -- what the lag leaves -------------------------------------------------------------------------


def flow_response(maps, speed_rpm, delay, shape=None):
    """Event-averaged flow reading over charge, mode by mode, without manifold filling."""
    tiny = with_engine(maps, manifold_volume=1e-9)
    options = {"flow_shape": shape} if shape else {}
    dynamics = tiny.dynamics(maf=PROMPT.replace(delay=delay), **options)
    command = ValveCommand(3.0, 150.0)
    gains = [
        dynamics.lifted(
            command, speed_rpm, inputs=("gain",), outputs=(name,), relative=False
        ).dcgain()
        for name in ("maf", "air_charge")
    ]
    # Circulant: the eigenvalues are the Fourier transform of the first column.
    flow, charge = (np.fft.fft(g[:, 0]) for g in gains)
    for k in range(1, 4):
        np.testing.assert_allclose(np.roll(gains[0][:, 0], k), gains[0][:, k], rtol=1e-6)
    return flow * event_time(speed_rpm, 4) / charge


# Four cylinders, charge spread evenly over its event, lag 15 ms; computed by another program.
@pytest.mark.parametrize(
    ("speed_rpm", "gain", "phase_deg", "gain_q2", "extra_deg"),
    [
        (750.0, 0.71, -27, 0.35, (-3, -8, -13)),
        (1500.0, 0.52, -48, 0.13, (-5, -16, -27)),
        (3000.0, 0.31, -66, 0.035, (-11, -31, -47)),
        (6000.0, 0.16, -77, 0.009, (-21, -54, -90)),
    ],
)
def test_event_average_of_imbalance_modes(maps, speed_rpm, gain, phase_deg, gain_q2, extra_deg):
    modes = flow_response(maps, speed_rpm, 0.0)
    assert modes[0] == pytest.approx(1.0, abs=1e-6)
    assert abs(modes[1]) == pytest.approx(gain, abs=0.0055)
    assert np.degrees(np.angle(modes[1])) == pytest.approx(phase_deg, abs=0.6)
    assert abs(modes[2]) == pytest.approx(gain_q2, rel=0.04)
    for delay, extra in zip((1e-3, 3e-3, 5e-3), extra_deg, strict=True):
        turned = flow_response(maps, speed_rpm, delay)[1]
        assert np.degrees(np.angle(turned / modes[1])) == pytest.approx(extra, abs=0.6)


@pytest.mark.parametrize(("speed_rpm", "delay"), [(1500.0, 0.0), (6000.0, 7e-3)])
def test_the_flow_reading_is_the_pulse_response(maps, speed_rpm, delay):
    shares = np.random.default_rng(1).normal(0.2, 0.2, 11)
    shape = FlowShape(shares / shares.sum(), 5)  # over more than two events
    T = event_time(speed_rpm, 4)
    response = PulseResponse.of_window(T, time_constant=0.015, delay=delay, shape=shape)
    modes = flow_response(maps, speed_rpm, delay, shape)
    for q in range(4):
        assert modes[q] == pytest.approx(response.mode(q, 4), abs=1e-6)


def test_a_wide_open_manifold_hardly_fills(fine):
    # The unthrottled manifold fills in about 0.3 ms: against 20 ms it changes little.
    real = fine.dynamics(maf=PROMPT)
    command = ValveCommand(3.0, 150.0)
    for name in ("throttle_flow", "maf"):
        small, large = (
            d.lifted(command, 1500.0, inputs=("gain",), outputs=(name,)).dcgain()[:, 0]
            for d in (with_engine(fine, manifold_volume=1e-9).dynamics(maf=PROMPT), real)
        )
        difference = np.abs(small - large).max()
        assert 1e-4 < difference < 0.02


# -- linear plants -------------------------------------------------------------------------------


def difference(function, x, step):
    """Central differences of a vector function, column by column."""
    columns = []
    for k in range(len(x)):
        h = np.zeros(len(x))
        h[k] = step[k]
        columns.append((function(x + h) - function(x - h)) / (2.0 * step[k]))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("relative", [True, False])
def test_linear_plant_against_differences_of_an_event(throttled, relative):
    dynamics = throttled.dynamics(throttle_deg=30.0)
    point = dynamics.operating_point(ValveCommand(3.0, 120.0), 1500.0)
    x, u, y = point.states[0], point.inputs[0], point.outputs[0]
    scales = (x, u, y) if relative else (np.ones_like(x), np.ones_like(u), np.ones_like(y))
    n = x.size

    def event(xu):
        end, outputs = dynamics.advance(xu[:n], xu[n:])
        return np.concatenate((end, outputs))

    xu = np.concatenate((x, u))
    columns = np.concatenate(scales[:2])
    rows = np.concatenate((scales[0], scales[2]))
    J = difference(event, xu, 1e-5 * xu) * columns / rows[:, None]
    system = dynamics.linearize(ValveCommand(3.0, 120.0), 1500.0, relative=relative)
    told = np.block([[system.A, system.B], [system.C, system.D]])
    # Compared in relative terms: in units of their own the entries differ by ten powers of ten.
    size = np.concatenate((x, y))[:, None] / xu * columns / rows[:, None]
    np.testing.assert_allclose(told / size, J / size, rtol=1e-5, atol=1e-7)
    assert system.dt == pytest.approx(0.02)
    assert system.input_labels == INPUTS
    assert system.output_labels == OUTPUTS
    assert system.state_labels[:3] == ["manifold_pressure", "map_reading", "maf_tail"]


def test_lifted_plant_against_differences_of_a_cycle(throttled):
    dynamics = throttled.dynamics(gains=GAINS, throttle_deg=32.0)
    point = dynamics.operating_point(COMMANDS, 1500.0)
    kept = [OUTPUTS.index(name) for name in ("air_charge", "maf", "map")]
    x0 = point.states[0]

    def cycle(v):
        state, rows = v[: x0.size], []
        for k in range(4):
            duration, gain = v[x0.size + 2 * k], v[x0.size + 2 * k + 1]
            inputs = (point.inputs[k, 0], duration, point.inputs[k, 2])
            state, outputs = dynamics.advance(state, inputs, gain)
            rows.append(outputs[kept])
        return np.concatenate((state, *rows))

    inputs = np.stack((point.inputs[:, 1], GAINS), axis=1).ravel()
    v = np.concatenate((x0, inputs))
    J = difference(cycle, v, 1e-5 * v)
    size = np.concatenate((x0, point.outputs[:, kept].ravel()))[:, None] / v
    for relative in (False, True):
        system = dynamics.lifted(
            COMMANDS,
            1500.0,
            inputs=("duration_deg", "gain"),
            outputs=("air_charge", "maf", "map"),
            relative=relative,
        )
        told = np.block([[system.A, system.B], [system.C, system.D]])
        told = told if relative else told / size
        np.testing.assert_allclose(told, J / size, rtol=1e-5, atol=1e-7)
    assert system.dt == pytest.approx(0.08)
    assert system.input_labels[:3] == ["duration_deg[1]", "gain[1]", "duration_deg[2]"]
    assert system.output_labels[2:4] == ["map[1]", "air_charge[2]"]


def test_static_gains_are_differences_of_steady_states(throttled):
    dynamics = throttled.dynamics(gains=GAINS, throttle_deg=32.0)
    gain = dynamics.lifted(
        COMMANDS, 1500.0, outputs=("air_charge", "manifold_pressure"), relative=False
    ).dcgain()
    for k in (0, 2):
        sides = []
        for sign in (1.0, -1.0):
            changed = list(COMMANDS)
            changed[k] = changed[k].replace(duration_deg=changed[k].duration_deg + sign * 0.05)
            point = dynamics.operating_point(changed, 1500.0)
            sides.append(point.outputs[:, [0, OUTPUTS.index("manifold_pressure")]].ravel())
        slope = (sides[0] - sides[1]) / 0.1
        for row in (slice(0, None, 2), slice(1, None, 2)):
            size = np.abs(slope[row]).max()
            np.testing.assert_allclose(gain[row, k], slope[row], rtol=1e-4, atol=1e-4 * size)


def test_lifted_plant_of_equal_cylinders_has_the_modes_of_one_event(throttled):
    dynamics = throttled.dynamics(throttle_deg=30.0)
    command = ValveCommand(3.0, 120.0)
    event = dynamics.linearize(command, 1500.0)
    u, y = INPUTS.index("duration_deg"), OUTPUTS.index("maf")
    cycle = dynamics.lifted(command, 1500.0, outputs=("maf",))
    repeated = lifted([(event.A, event.B[:, [u]], event.C[[y]], event.D[[y]][:, [u]])] * 4)
    for told, expected in zip((cycle.A, cycle.B, cycle.C, cycle.D), repeated, strict=True):
        np.testing.assert_allclose(told, expected, rtol=1e-7, atol=1e-10)
    for angle in np.arange(4) * np.pi / 2 + 0.3:
        z = np.exp(1j * angle)
        mode = z ** np.arange(4)
        np.testing.assert_allclose(cycle(z**4) @ mode, event(z)[y, u] * mode, rtol=1e-7)
    static = cycle.dcgain()
    np.testing.assert_allclose(np.roll(static, (1, 1), (0, 1)), static, rtol=1e-7)


def test_without_boundary_conditions_each_charge_follows_its_own_command(fine):
    dynamics = fine.dynamics(gains=GAINS)
    gain = dynamics.lifted(COMMANDS, 1500.0).dcgain()
    expected = [
        fine.charge_gradient(c.lift_mm, c.duration_deg, 1500.0).duration
        * c.duration_deg
        / fine.air_charge(c.lift_mm, c.duration_deg, 1500.0)
        for c in COMMANDS
    ]
    np.testing.assert_allclose(gain, np.diag(expected), rtol=1e-8, atol=1e-12)
    by_gain = dynamics.lifted(COMMANDS, 1500.0, inputs=("gain",)).dcgain()
    np.testing.assert_allclose(by_gain, np.eye(4), atol=1e-12)


# -- the full plant ------------------------------------------------------------------------------


def measured_shape(speed_rpm, command, parts=30):
    """How the air that a longer duration adds flows past the sensor of the full plant."""
    flows = []
    for change in (-0.5, 0.5):
        first = command.replace(duration_deg=command.duration_deg + change)
        cycle = PLANT.steady_cycle(speed_rpm, [first, command, command, command])
        flow = cycle.trace_at(180.0 / parts / 8).throttle_flow
        flows.append(flow.reshape(4 * parts, 8).sum(axis=1))
    added = flows[1] - flows[0]
    return FlowShape(added / added.sum(), parts)


def step_on_the_full_plant(speed_rpm, before, after, events=24, points=400):
    """Event averages of a lagging flow reading, the step of duration after four events."""
    run = PLANT.start(speed_rpm, before)
    commands = [before] * 4 + [after] * (events - 4)
    flow = np.concatenate(
        [run.step_event(c, trace_step_deg=180.0 / points).trace.throttle_flow for c in commands]
    )
    assert flow.size == events * points
    flow = np.append(flow, flow[-1])
    h = event_time(speed_rpm, 4) / points
    settled = np.tile(flow[:points], 40)
    start = first_order_lag(h * np.arange(settled.size), settled, 0.015, flow[:points].mean())[-1]
    reading = first_order_lag(h * np.arange(flow.size), flow, 0.015, start)
    areas = 0.5 * (reading[1:] + reading[:-1])
    return areas.reshape(events, points).mean(axis=1)


# A longer duration adds its air late in the event. An even flow, which has half of it before, is
# ahead of the full plant: by 3 % of the step where the valve shuts early, by up to 22 % where late.
@pytest.mark.parametrize("speed_rpm", [1500.0, 3000.0])
@pytest.mark.parametrize(
    ("before", "after", "even_error"),
    [((4.0, 110.0), (4.0, 130.0), 0.05), ((5.0, 180.0), (5.0, 140.0), 0.3)],
)
def test_flow_reading_after_a_step_of_duration_follows_the_full_plant(
    fine, speed_rpm, before, after, even_error
):
    truth = step_on_the_full_plant(speed_rpm, ValveCommand(*before), ValveCommand(*after))
    step = truth[-1] - truth[0]
    durations = [before[1]] * 4 + [after[1]] * 20
    middle = ValveCommand(before[0], 0.5 * (before[1] + after[1]))
    errors = {}
    for name, shape in (
        ("measured", measured_shape(speed_rpm, middle)),
        ("even", FlowShape.even()),
    ):
        dynamics = fine.dynamics(maf=PROMPT, flow_shape=shape)
        reading = dynamics.simulate(before[0], durations, speed_rpm).maf.values
        assert reading[0] == pytest.approx(truth[0], rel=0.02)
        assert reading[-1] == pytest.approx(truth[-1], rel=0.02)
        change = (reading - reading[0]) / (reading[-1] - reading[0])
        errors[name] = np.abs(change - (truth - truth[0]) / step).max()
    assert errors["measured"] < 0.03
    assert errors["even"] < even_error


@pytest.mark.parametrize("speed_rpm", [1500.0, 3000.0])
@pytest.mark.parametrize("throttle_deg", [30.0, 45.0])
def test_throttled_manifold_pressure_is_that_of_the_full_plant(throttled, speed_rpm, throttle_deg):
    command = ValveCommand(3.0, 120.0)
    cycle = PLANT.steady_cycle(speed_rpm, command, throttle_deg)
    truth = cycle.trace_at(0.5).manifold_pressure.mean()
    point = throttled.dynamics(throttle_deg=throttle_deg).operating_point(command, speed_rpm)
    assert truth < 0.98 * ENGINE.ambient_pressure
    assert point.output("manifold_pressure")[0] == pytest.approx(truth, rel=0.02)
    # The pulsation, which a mean value has not, costs the full plant some of the charge.
    assert point.output("air_charge")[0] == pytest.approx(cycle.air_charge[0], rel=0.05)


# -- systems of python-control -------------------------------------------------------------------


def test_the_discrete_system_runs_like_the_simulation(throttled):
    dynamics = throttled.dynamics(gains=GAINS, throttle_deg=40.0)
    system = dynamics.as_nonlinear_system()
    assert system.dt == 1.0
    assert system.isdtime(strict=True)
    assert system.input_labels == INPUTS
    assert system.output_labels == OUTPUTS
    first = dynamics.operating_point(COMMANDS, 1500.0)
    random = np.random.default_rng(6)
    inputs = np.vstack(
        (random.uniform(2.5, 4.0, 21), random.uniform(100.0, 150.0, 21), np.full(21, 1600.0))
    )
    response = control.input_output_response(system, np.arange(21), inputs, first.states[0])
    run = dynamics.simulate(*inputs, first=first)
    for k, name in enumerate(OUTPUTS):
        np.testing.assert_allclose(response.outputs[k], run[name], rtol=1e-12)


def test_gains_are_those_of_the_cylinders_in_their_order(fine):
    dynamics = fine.dynamics(gains=GAINS)
    run = dynamics.simulate(3.0, np.full(9, 120.0), 1500.0)
    charge = fine.air_charge(3.0, 120.0, 1500.0)
    np.testing.assert_allclose(run.air_charge / charge, [*GAINS, *GAINS, GAINS[0]], rtol=1e-6)
    system = dynamics.as_nonlinear_system()
    state = dynamics.operating_point(ValveCommand(3.0, 120.0), 1500.0).states[0]
    for k in range(6):
        outputs = system.output(float(k), state, [3.0, 120.0, 1500.0])
        assert outputs[0] == pytest.approx(GAINS[k % 4] * charge, rel=1e-6)


def in_time(system, time, inputs, start):
    # Charges are of the order of 1e-4 kg: the solver's own absolute tolerance is 1e-6.
    return control.input_output_response(
        system,
        time,
        inputs,
        start,
        solve_ivp_method="LSODA",
        solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-12},
    )


def test_the_system_in_time_settles_where_the_events_do(throttled):
    dynamics = throttled.dynamics(throttle_deg=32.0)
    system = dynamics.as_nonlinear_system("time")
    assert system.isctime(strict=True)
    assert system.input_labels == INPUTS
    assert system.output_labels == OUTPUTS
    start = np.zeros(system.nstates)
    start[0] = 80e3
    time = np.linspace(0.0, 0.6, 40)
    inputs = np.outer([3.0, 120.0, 1500.0], np.ones(time.size))
    response = in_time(system, time, inputs, start)
    point = dynamics.operating_point(ValveCommand(3.0, 120.0), 1500.0)
    np.testing.assert_allclose(response.outputs[:, -1], point.outputs[0], rtol=1e-5)


def test_the_manifold_fills_in_a_third_of_a_millisecond(fine):
    # Section 4 of the design: wide open about 0.3 ms. From Eq. 1 and the slope of Eq. 15.
    system = fine.dynamics().as_nonlinear_system("time")
    u = [3.0, 189.0, 1500.0]
    flow = float(fine.air_charge(*u)) / 0.02
    pressure = 1e5 * 0.5 * (1.0 + np.sqrt(1.0 - (flow / sonic_flow(90.0)) ** 2))
    state = np.zeros(system.nstates)
    rates = []
    for change in (-1.0, 1.0):
        state[0] = pressure + change
        rates.append(system.dynamics(0.0, state, u)[0])
    assert abs(sum(rates)) < 1e-2 * abs(rates[0])
    constant = -2.0 / (rates[1] - rates[0])
    x = pressure / 1e5
    slope = sonic_flow(90.0) * (1.0 - 2.0 * x) / np.sqrt(x - x**2) / 1e5
    assert constant == pytest.approx(CAPACITY / -slope, rel=1e-3)
    assert constant == pytest.approx(0.3e-3, abs=0.05e-3)


@pytest.mark.parametrize(("n", "events"), [(1, 0), (2, 1), (3, 1), (4, 2), (6, 3)])
def test_a_charge_burns_one_revolution_later_in_whole_events(maps, n, events):
    dynamics = with_engine(maps, n_cylinders=n).dynamics()
    assert dynamics.power_delay_events == events
    durations = np.random.default_rng(n).uniform(100.0, 160.0, 20)
    run = dynamics.simulate(3.0, durations, 2000.0)
    charge, power = run.air_charge.values, run.power_charge.values
    np.testing.assert_allclose(power[events:], charge[: 20 - events], rtol=1e-12)
    np.testing.assert_allclose(power[:events], charge[0], rtol=1e-9)


@pytest.mark.parametrize("speed_rpm", [1200.0, 3000.0])
def test_delays_and_lags_in_time(fine, speed_rpm):
    # The area between a step and the answer is what delays and lags add up to.
    dynamics = fine.dynamics(maf=MafSensor(delay=2e-3), map=MapSensor(time_constant=4e-3))
    assert dynamics.power_delay(speed_rpm) == pytest.approx(60.0 / speed_rpm)
    system = dynamics.as_nonlinear_system("time")

    def run(duration, start, seconds):
        time = np.linspace(0.0, seconds, 4001)
        inputs = np.outer([3.0, duration, speed_rpm], np.ones(time.size))
        return time, in_time(system, time, inputs, start)

    start = np.zeros(system.nstates)
    start[0] = 99e3
    _, before = run(120.0, start, 0.6)
    time, after = run(122.0, before.states[:, -1], 0.6)
    areas = {}
    for name in ("air_charge", "power_charge", "throttle_flow", "maf", "map"):
        k = OUTPUTS.index(name)
        left = after.outputs[k, -1] - after.outputs[k]
        areas[name] = np.trapezoid(left, time) / (after.outputs[k, -1] - before.outputs[k, -1])
    assert areas["air_charge"] == pytest.approx(0.0, abs=1e-5)
    assert areas["power_charge"] == pytest.approx(60.0 / speed_rpm, rel=0.01)
    filling = areas["throttle_flow"]
    assert 0.05e-3 < filling < 0.4e-3
    assert areas["maf"] - filling == pytest.approx(17e-3, rel=0.01)
    pressure = after.outputs[OUTPUTS.index("manifold_pressure")]
    lag = np.trapezoid(pressure - after.outputs[OUTPUTS.index("map")], time)
    assert lag / (pressure[-1] - before.outputs[4, -1]) == pytest.approx(4e-3, rel=0.01)


def test_pressure_reading_is_the_lag_averaged_over_the_event(fine):
    # The pressure is taken to stand at its value at the end of the event.
    dynamics = fine.dynamics(map=MapSensor(time_constant=0.012), throttle_deg=40.0)
    run = dynamics.simulate(3.0, [120.0] * 2 + [135.0] * 10, 1500.0)
    time = np.linspace(0.0, 0.02, 2001)
    reading = float(run["map"][0])
    for pressure, told in zip(run.manifold_pressure.values, run["map"].values, strict=True):
        course = first_order_lag(time, np.full(time.size, pressure), 0.012, reading)
        assert told == pytest.approx(np.trapezoid(course, time) / 0.02, rel=1e-8)
        reading = course[-1]


@pytest.mark.parametrize("n", [1, 3, 6])
def test_other_numbers_of_cylinders(maps, n):
    dynamics = with_engine(maps, n_cylinders=n).dynamics(maf=PROMPT)
    command = ValveCommand(3.0, 150.0)
    point = dynamics.operating_point(command, 2000.0)
    np.testing.assert_allclose(
        point.output("throttle_flow"), point.output("air_charge") * n * 2000.0 / 120.0, rtol=1e-9
    )
    cycle = dynamics.lifted(command, 2000.0, outputs=("maf",), inputs=("gain",))
    assert cycle.D.shape == (n, n)
    assert cycle.dt == pytest.approx(0.06)
    mean_mode = np.atleast_2d(cycle.dcgain()).sum(axis=1)
    np.testing.assert_allclose(mean_mode, 1.0, rtol=1e-6)
    assert dynamics.linearize(command, 2000.0).dt == pytest.approx(0.06 / n)
    system = dynamics.as_nonlinear_system("time")
    assert system.dynamics(0.0, np.full(system.nstates, 99e3), [3.0, 150.0, 2000.0]).shape


# -- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gains": (1.0, 1.0, 1.0)}, "gains has 3 values, but the engine has 4 cylinders"),
        ({"gains": (1.0, 1.0, -0.1, 1.0)}, r"gains\[2\] is -0\.1"),
        ({"gains": (1.0, np.nan, 1.0, 1.0)}, r"gains\[1\] is nan"),
        ({"throttle_deg": 5.0}, "throttle_deg is 5 deg.*Eq. 19 gives no opening"),
        ({"throttle_deg": 95.0}, "throttle_deg is 95 deg"),
        ({"throttle_deg": np.nan}, "throttle_deg is nan deg"),
        ({"power_delay_deg": -1.0}, "power_delay_deg is -1 deg"),
    ],
)
def test_bad_options_are_refused(maps, options, message):
    with pytest.raises(ParameterError, match=message):
        maps.dynamics(**options)


COMMAND = ValveCommand(3.0, 120.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda d: d.operating_point([COMMAND] * 3, 1500.0), "one for each of the 4 cylinders"),
        (lambda d: d.operating_point(3.0, 1500.0), "must be one ValveCommand"),
        (lambda d: d.operating_point(COMMAND, 9000.0), "speed_rpm is 9000 rpm"),
        (lambda d: d.operating_point(COMMAND, np.nan), "speed_rpm is nan rpm"),
        (lambda d: d.operating_point(ValveCommand(3.0, 120.0, 5.0), 1500.0), "opening_deg is 5"),
        (lambda d: d.simulate([3.0, np.nan], 120.0, 1500.0), "lift_mm is nan mm"),
        (lambda d: d.simulate(3.0, 120.0, [1500.0, 1e4]), "speed_rpm is 10000 rpm"),
        (lambda d: d.simulate([[3.0]], 120.0, 1500.0), "must be one value an event"),
        (lambda d: d.simulate([], 120.0, 1500.0), "must be one value an event"),
        (lambda d: d.lifted(COMMAND, 1500.0, outputs=("torque",)), "output is 'torque'"),
        (lambda d: d.lifted(COMMAND, 1500.0, inputs=("spark",)), "input is 'spark'"),
        (lambda d: d.lifted(COMMAND, 1500.0, inputs=()), "must each name one signal or more"),
        (lambda d: d.linearize(COMMAND, 1500.0), r"gains are \[0\.9.*use lifted"),
        (lambda d: d.as_nonlinear_system("angle"), "domain is 'angle'"),
        (lambda d: d.operating_point(COMMAND, 1500.0).output("torque"), "output is 'torque'"),
    ],
)
def test_bad_input_is_refused(maps, call, message):
    with pytest.raises(ParameterError, match=message):
        call(maps.dynamics(gains=GAINS))


def test_a_manifold_that_the_charges_would_empty_is_refused(maps):
    # 2 mm and 200 deg take more than twice what 25 deg of throttle pass at sonic speed.
    model = maps.dynamics(throttle_deg=25.0)
    passed = 1e6 * ENGINE.throttle.area(25.0) * event_time(1500.0, 4)
    refusal = rf"passes at most {passed:.1f} mg.*empty the manifold: open the throttle"
    first = model.operating_point(ValveCommand(2.0, 90.0), 1500.0)
    with pytest.raises(ParameterError, match=refusal):
        model.simulate(2.0, [200.0] * 30, 1500.0, first=first)
    with pytest.raises(ParameterError, match=refusal):
        model.operating_point(ValveCommand(2.0, 200.0), 1500.0)
    system = model.as_nonlinear_system("time")
    start = np.zeros(system.nstates)
    start[:3] = first.states[0, 0], first.outputs[0, 5], first.states[0, 0]
    time = np.linspace(0.0, 0.6, 60)
    inputs = np.array([[2.0], [200.0], [1500.0]]) * np.ones(60)
    with pytest.raises(ParameterError, match=refusal):
        control.input_output_response(system, time, inputs, start, solve_ivp_method="BDF")


def test_an_engine_of_unequal_cylinders_asks_for_their_gains(maps):
    engine = ENGINE.replace(cylinder_flow_factors=(1.0, 0.8, 1.0, 1.2))
    unequal = dataclasses.replace(maps, engine=engine)
    with pytest.raises(ParameterError, match=r"means over the cylinders: give gains"):
        unequal.dynamics()
    point = unequal.dynamics(gains=GAINS).operating_point(ValveCommand(3.0, 120.0), 1500.0)
    np.testing.assert_allclose(
        point.output("air_charge") / maps.air_charge(3.0, 120.0, 1500.0), GAINS, rtol=1e-9
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"gains": 1.0}, "gains is 1.0, but must be a sequence"),
        ({"gains": "abcd"}, "gains is 'abcd'"),
        ({"maf": 1}, "maf is 1, but must be a MafSensor"),
        ({"map": MafSensor()}, "must be a MapSensor"),
        ({"flow_shape": 1}, "must be a FlowShape"),
    ],
)
def test_parts_of_another_kind_are_refused(maps, options, said):
    with pytest.raises(ParameterError, match=said):
        maps.dynamics(**options)


def test_inputs_and_gains_that_are_no_inputs_are_refused(maps):
    model = maps.dynamics()
    state = model.operating_point(ValveCommand(3.0, 120.0), 1500.0).states[0]
    with pytest.raises(ParameterError, match=r"inputs have shape \(2,\)"):
        model.advance(state, [3.0, 120.0])
    with pytest.raises(ParameterError, match="gain is nan"):
        model.advance(state, [3.0, 120.0, 1500.0], np.nan)
    with pytest.raises(ParameterError, match="state has shape"):
        model.advance(state[:-1], [3.0, 120.0, 1500.0])
    with pytest.raises(ParameterError, match="state holds values that are not finite"):
        model.advance(np.full_like(state, np.nan), [3.0, 120.0, 1500.0])
