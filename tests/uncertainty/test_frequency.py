import matplotlib.pyplot as plt
import numpy as np
import pytest

from plant import (
    ConvergenceError,
    CrankAnglePlant,
    Engine,
    FlowShape,
    InfeasibleProfileError,
    MafSensor,
    MeanValuePlant,
    ParameterError,
    PulseResponse,
    ValveCommand,
    first_order_lag,
)
from plant.air_path import event_time
from uncertainty._maf_average import averaged_pulse, steady_averages
from uncertainty.lifted_full_plant import full_plant_response
from uncertainty.lifted_mean_value import mean_value_modes, mean_value_response

PLANT = CrankAnglePlant()
EARLY = ValveCommand(3.0, 120.0)  # the valve shuts in its own event
LATE = ValveCommand(5.0, 220.0)  # it is still open in the next one
UNEQUAL = CrankAnglePlant(Engine.paper().replace(cylinder_flow_factors=(0.95, 1.0, 1.04, 1.01)))
COMMANDS = [LATE.replace(duration_deg=d) for d in (220.0, 216.0, 223.0, 219.0)]
SIX = CrankAnglePlant(Engine.paper().replace(n_cylinders=6))
# Charges jump by about 1e-6 with the choice of steps, which is 1e-4 of what 1 deg changes; they
# jump less on these plants.
FINE, FINE_UNEQUAL, FINE_SIX = (
    CrankAnglePlant(plant.engine, resolution=4.0) for plant in (PLANT, UNEQUAL, SIX)
)
PROMPT = MafSensor(delay=0.0)
FEW = 5


def grid(speed_rpm, count=FEW):
    """Frequencies from 0 to the Nyquist frequency of a cycle."""
    return np.linspace(0.0, np.pi * speed_rpm / 120.0, count)


@pytest.fixture(scope="module")
def maps():
    """Coarse maps: their charge is good to 5 %."""
    return MeanValuePlant.fit(PLANT, tolerance=0.05, most_points=512)


# -- steady state, a second way ------------------------------------------------------------------


def steady_change(plant, commands, speed_rpm, pattern, step, throttle_deg=90.0):
    """Change of each charge per deg when all durations change for ever by a pattern."""
    charges = []
    for sign in (1.0, -1.0):
        changed = [
            c.replace(duration_deg=c.duration_deg + sign * step * p)
            for c, p in zip(commands, pattern, strict=True)
        ]
        charges.append(plant.steady_cycle(speed_rpm, changed, throttle_deg).air_charge)
    return (charges[0] - charges[1]) / (2.0 * step)


# At frequency zero the lifted response is the derivative of the periodic cycle.
@pytest.mark.parametrize(
    ("plant", "commands", "speed_rpm", "throttle_deg"),
    [
        (FINE, [EARLY] * 4, 1500.0, 90.0),
        (FINE, [LATE] * 4, 6000.0, 90.0),
        (FINE, [EARLY] * 4, 1500.0, 25.0),
        (FINE_UNEQUAL, COMMANDS, 6000.0, 45.0),
        (FINE_SIX, [EARLY] * 6, 3000.0, 40.0),
    ],
)
@pytest.mark.parametrize("q", [0, 1, 2])
def test_steady_patterns_of_commands(plant, commands, speed_rpm, throttle_deg, q):
    n = len(commands)
    response = full_plant_response(
        plant, commands, speed_rpm, omega=[0.0], throttle_deg=throttle_deg, relative=False
    ).response[0]
    pattern = np.cos(2.0 * np.pi * q * np.arange(n) / n)
    told = response @ pattern
    truth = steady_change(plant, commands, speed_rpm, pattern, 0.5, throttle_deg)
    np.testing.assert_allclose(told.imag, 0.0, atol=1e-18)
    np.testing.assert_allclose(told.real, truth, atol=3e-4 * np.abs(truth).max())


@pytest.mark.parametrize(("command", "speed_rpm"), [(EARLY, 1500.0), (LATE, 6000.0)])
def test_relative_sensitivities_to_all_commands(command, speed_rpm):
    for name, value in (("duration_deg", command.duration_deg), ("lift_mm", command.lift_mm)):
        values = value * np.array([1.0 - 2e-3, 1.0, 1.0 + 2e-3])
        given = {"lift_mm": command.lift_mm, "duration_deg": command.duration_deg, name: values}
        charge = FINE.steady_cycles(speed_rpm, **given).air_charge.values.mean(axis=-1)
        truth = (charge[2] - charge[0]) / charge[1] / 4e-3
        response = full_plant_response(FINE, command, speed_rpm, input=name, omega=[0.0])
        assert response.mode(0)[0] == pytest.approx(truth, rel=1e-3)


def event_averages(flow, T, tau, delay, initial):
    """Event averages of a lagging and late reading of a flow (events, points), by sums."""
    points = flow.shape[1]
    u = np.append(flow.ravel(), flow[-1, -1])
    reading = first_order_lag(T / points * np.arange(u.size), u, tau, initial)
    late = round(delay / T * points)
    reading = np.concatenate((np.full(late, initial), reading))[: u.size]
    return (0.5 * (reading[1:] + reading[:-1])).reshape(flow.shape).mean(axis=1)


def test_steady_readings_of_an_unequal_pattern():
    # The event averages of cycles that have repeated until the lag has settled.
    maf, T, points = MafSensor(), event_time(3000.0, 4), 1000
    readings = []
    for sign in (1.0, 0.0, -1.0):
        changed = [
            EARLY.replace(duration_deg=120.0 + 1.0 * sign * p) for p in (1.0, -1.0, 1.0, -1.0)
        ]
        flow = PLANT.steady_cycle(3000.0, changed).trace_at(180.0 / points).throttle_flow
        cycles = np.tile(flow.reshape(4, points), (12, 1))
        tail = event_averages(cycles, T, maf.time_constant, maf.delay, flow.mean())[-4:]
        readings.append(tail)
    truth = (readings[0] - readings[2]) / 2.0 / readings[1].mean() * 120.0
    response = full_plant_response(PLANT, EARLY, 3000.0, output="maf", omega=[0.0])
    told = response.mode(2)[0]
    np.testing.assert_allclose(truth, told.real * np.array([1.0, -1.0, 1.0, -1.0]), rtol=0.02)
    assert abs(told.imag) < 1e-9
    np.testing.assert_allclose(response.output_values, readings[1], rtol=1e-4)


@pytest.mark.parametrize(
    ("plant", "commands", "throttle_deg"),
    [(PLANT, EARLY, 90.0), (UNEQUAL, COMMANDS, 90.0), (PLANT, EARLY, 25.0), (SIX, EARLY, 90.0)],
)
def test_what_the_valves_take_in_has_passed_the_throttle(plant, commands, throttle_deg):
    n, options = plant.engine.n_cylinders, {"throttle_deg": throttle_deg, "relative": False}
    charge, flow = (
        full_plant_response(plant, commands, 3000.0, output=output, omega=[0.0], **options)
        for output in ("air_charge", "maf")
    )
    taken, passed = (r.response[0].sum(axis=0) for r in (charge, flow))
    np.testing.assert_allclose(passed * event_time(3000.0, n), taken, rtol=1e-4)


# -- time, a second way --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "speed_rpm", "throttle_deg"),
    [(LATE, 6000.0, 90.0), (EARLY, 1500.0, 25.0), (EARLY, 3000.0, 90.0)],
)
@pytest.mark.parametrize("turns", [5, 13, 27])  # in 64 events: bands of modes 0, 1 and 2
def test_a_wave_of_commands(command, speed_rpm, throttle_deg, turns):
    # 32 cycles, of which the last 16 count; a wave that repeats in them has no other component.
    omega, T = 2.0 * np.pi * turns / 64, event_time(speed_rpm, 4)
    points, maf, size = 800, MafSensor(delay=T), 0.5
    run = PLANT.start(speed_rpm, command, throttle_deg)
    charges, flows = np.empty(130), []
    for k in range(130):
        change = size * np.cos(omega * k)
        result = run.step_event(
            command.replace(duration_deg=command.duration_deg + change),
            trace_step_deg=180.0 / points,
        )
        flows.append(result.trace.throttle_flow)
        for done in result.completed:
            charges[k - (k - (done.cylinder - 1)) % 4] = done.air_charge
    flow = np.array(flows)
    readings = event_averages(flow, T, maf.time_constant, maf.delay, flow.mean())
    counted = np.arange(64, 128)
    for output, values in (("air_charge", charges), ("maf", readings)):
        wave = 2.0 * np.mean(values[counted] * np.exp(-1j * omega * counted))
        truth = wave / values[counted].mean() * command.duration_deg / size
        response = full_plant_response(
            PLANT,
            command,
            speed_rpm,
            output=output,
            maf=maf,
            throttle_deg=throttle_deg,
            omega=grid(speed_rpm, 33),
        )
        # 4/n of the grid's spacing: the wave lies on it.
        told = response.event_response(omega / T)
        assert told == pytest.approx(truth, abs=0.001 * abs(response.mode(0)[0]))


# -- the MAF sensor ------------------------------------------------------------------------------


def measured_shape(command, speed_rpm, parts=60):
    """How the air that a longer duration adds flows through the throttle, from steady cycles."""
    flows = []
    for change in (-0.5, 0.5):
        first = command.replace(duration_deg=command.duration_deg + change)
        cycle = PLANT.steady_cycle(speed_rpm, [first, *[command] * 3])
        flow = cycle.trace_at(180.0 / parts / 12).throttle_flow
        flows.append(flow.reshape(4 * parts, 12).sum(axis=1))
    added = flows[1] - flows[0]
    return FlowShape(added / added.sum(), parts)


@pytest.mark.parametrize(("command", "speed_rpm"), [(EARLY, 1500.0), (LATE, 6000.0)])
@pytest.mark.parametrize("tau", [0.002, 0.015])
def test_readings_are_the_charges_through_the_pulse_response(command, speed_rpm, tau):
    shape, T = measured_shape(command, speed_rpm), event_time(speed_rpm, 4)
    maf = MafSensor(time_constant=tau, delay=1.3e-3)
    pulse = PulseResponse.of_window(T, time_constant=tau, delay=maf.delay, shape=shape)
    total = full_plant_response(PLANT, command, speed_rpm, omega=[0.0]).mode(0)[0]
    reading = full_plant_response(
        PLANT, command, speed_rpm, output="maf", maf=maf, omega=grid(speed_rpm)
    )
    angle = reading.event_omega * T
    truth = total * pulse(np.exp(1j * angle))
    # The parts of the shape are steps, the trace is linear between points.
    np.testing.assert_allclose(reading.event_response(), truth, atol=0.005 * abs(total))


@pytest.mark.parametrize("delay", [0.0, 0.7e-3, 2.3e-3, 0.0431])
def test_a_flow_in_ramps_against_its_pulses_in_closed_form(delay):
    # Triangles of flow over three events, cut into very short even pulses.
    T, tau, samples, fine = 0.02, 0.015, 8, 4000
    flow = np.array([[0, 1, 3, 2, -1, 0, 4, 1], [2, 5, 3, 1, 0, 0, 1, 2], [1, 0, 0, 0, 0, 0, 0, 0]])
    corners = np.append(flow.ravel(), 0.0) * 1e-3
    at = (np.arange(3 * fine) + 0.5) / fine * samples
    inflow = 0.5 * (corners[1:] + corners[:-1]).reshape(3, samples).sum(axis=1) * T / samples
    shares = np.interp(at, np.arange(corners.size), corners)
    pulse = PulseResponse.of_window(
        T, time_constant=tau, delay=delay, shape=FlowShape(shares / shares.sum(), fine)
    )
    z = np.exp(1j * np.linspace(0.0, np.pi, 9))
    maf = MafSensor(time_constant=tau, delay=delay, gain_error=-0.02)
    told = averaged_pulse(1e-3 * flow, inflow, T, maf)(z)
    np.testing.assert_allclose(told, 0.98 * inflow.sum() / T * pulse(z), rtol=1e-6)


def test_a_prompt_sensor_shows_the_air_of_each_event():
    flow = np.array([[0.0, 2.0, 1.0, 3.0], [1.0, 0.0, 0.0, 0.0]])
    told = averaged_pulse(flow, np.array([0.05, 0.01]), 0.02, MafSensor(time_constant=0, delay=0))
    np.testing.assert_allclose(told.taps, [2.5, 0.5, 0.0], rtol=1e-12, atol=1e-15)
    assert told.pole == 0.0


@pytest.mark.parametrize("events", [1, 3])
def test_a_delay_of_whole_events_is_a_power_of_the_shift(events):
    T = event_time(3000.0, 4)
    prompt, late = (
        full_plant_response(
            PLANT, LATE, 3000.0, output="maf", maf=MafSensor(delay=d), omega=grid(3000.0)
        )
        for d in (0.0, events * T)
    )
    z = np.exp(1j * prompt.event_omega * T)
    np.testing.assert_allclose(
        late.event_response(), prompt.event_response() * z**-events, rtol=1e-9
    )


def test_the_residual_of_a_lag_against_a_prompt_sensor():
    # Sums of events: what a lag holds back of event 0 comes by exp(-T/tau) an event later.
    speed, T, tau = 1500.0, event_time(1500.0, 4), 0.015
    command = EARLY.replace(duration_deg=60.0)
    shape = measured_shape(command, speed)
    readings = [
        full_plant_response(
            PLANT, command, speed, output="maf", maf=MafSensor(time_constant=t, delay=0.0)
        )
        for t in (1e-6, tau)
    ]
    z = np.exp(1j * readings[0].event_omega * T)
    prompt, lagging = (r.event_response() for r in readings)
    k = np.arange(shape.shares.size)
    edges = T * np.array([0.0, 1.0]) - k[:, None] * T / shape.parts
    begin, end = edges[:, 1], edges[:, 1] - T / shape.parts  # to the event's end, of each part
    held = shape.shares[:60] @ (
        tau * (np.exp(-end[:60] / tau) - np.exp(-begin[:60] / tau)) * shape.parts / T
    )
    assert np.abs(shape.shares[60:]).max() < 1e-6  # all flows within the event
    # lagging/prompt = 1 - held (1 - 1/z)/(1 - a/z): a first-order lag of event averages
    truth = -held * (1.0 - 1.0 / z) / (1.0 - np.exp(-T / tau) / z)
    np.testing.assert_allclose((lagging - prompt) / prompt, truth, atol=5e-3)


def test_steady_averages_of_a_wave():
    # u = 1 + cos(w t): amplitude and phase of lag and delay, averaged over quarters of a cycle
    T, tau, delay, points = 0.01, 0.015, 0.053, 500
    w = 2.0 * np.pi / (4 * T)
    t = T / points * np.arange(4 * points)
    maf = MafSensor(time_constant=tau, delay=delay, gain_error=0.01, offset=2e-3)
    told = steady_averages((1.0 + np.cos(w * t)).reshape(4, points), 4 * T, T, maf)
    factor = np.exp(-1j * w * delay) / (1.0 + 1j * w * tau) / (1j * w * T)
    edges = np.exp(1j * w * T * np.arange(5))
    truth = 1.01 * (1.0 + np.real(factor * np.diff(edges))) + 2e-3
    np.testing.assert_allclose(told, truth, rtol=1e-5)


# -- modes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("plant", "throttle_deg"), [(PLANT, 25.0), (PLANT, 90.0), (SIX, 40.0)])
@pytest.mark.parametrize("output", ["air_charge", "maf"])
def test_modes_are_the_eigenvalues_of_the_lifted_response(plant, throttle_deg, output):
    n = plant.engine.n_cylinders
    response = full_plant_response(
        plant, EARLY, 2000.0, output=output, throttle_deg=throttle_deg, omega=grid(2000.0)
    )
    for k, theta in enumerate(response.theta):
        for q in range(n):
            z = np.exp(1j * (theta + 2.0 * np.pi * q) / n)
            v = z ** np.arange(n)
            g = response.mode(q)[k]
            np.testing.assert_allclose(response.response[k] @ v, g * v, atol=1e-11)
    np.testing.assert_allclose(
        response.largest_singular_value,
        np.max([np.abs(response.mode(q)) for q in range(n)], axis=0),
        rtol=1e-10,
    )
    assert response.leakage.max() < 1e-10


def test_the_circle_of_events_joins_the_modes():
    response = full_plant_response(PLANT, EARLY, 1500.0, output="maf", omega=grid(1500.0))
    T = event_time(1500.0, 4)
    # 5 phases of 4 modes on the upper half circle share their borders.
    np.testing.assert_allclose(response.event_omega * T, np.linspace(0.0, np.pi, 17), rtol=1e-12)
    values = response.event_response()
    for q, k in ((0, 0), (1, 8), (2, 16)):  # centres of the modes
        assert values[k] == response.mode(q)[0]
    assert values[4] == pytest.approx(response.mode(0)[-1], rel=1e-9)
    assert values[4] == pytest.approx(np.conj(response.mode(3)[-1]), rel=1e-9)
    theta, band = response.mode_band(1)
    np.testing.assert_allclose(theta, np.linspace(-np.pi, np.pi, 9), atol=1e-12)
    np.testing.assert_allclose(band, values[4:13], rtol=1e-9)
    middle = response.event_response(0.5 * (response.event_omega[3] + response.event_omega[4]))
    assert middle == pytest.approx(0.5 * (values[3] + values[4]), rel=1e-12)
    with pytest.raises(ParameterError, match="the frequencies of the grid end there"):
        response.event_response([1e4])
    with pytest.raises(ParameterError, match="4 cylinders have 4 modes"):
        response.mode(4)


def test_unequal_cylinders_leak_from_mode_to_mode():
    equal, unequal = (
        full_plant_response(plant, EARLY, 1500.0, omega=grid(1500.0), relative=False)
        for plant in (PLANT, UNEQUAL)
    )
    assert equal.leakage.max() < 1e-9
    # Each charge follows its own command alone: G is diagonal, and a diagonal of mean g leaks
    # what deviates from the mean.
    diagonal = np.diagonal(unequal.response[0]).real
    rest = np.fft.fft(diagonal) / 4.0
    circulant = np.array([[rest[(p - q) % 4] for q in range(4)] for p in range(4)])
    np.fill_diagonal(circulant, 0.0)
    truth = np.linalg.norm(circulant, 2) / abs(rest[0])
    assert truth > 0.01
    np.testing.assert_allclose(unequal.leakage, truth, rtol=1e-3)


def test_charge_in_an_earlier_event_feels_the_next_command():
    # Throttled, the late valve of the event before is still open when the next one opens.
    response = full_plant_response(
        PLANT,
        ValveCommand(5.0, 280.0),
        3000.0,
        input="lift_mm",
        throttle_deg=30.0,
        omega=grid(3000.0, 33),
        relative=False,
    )
    # Markov parameters by the inverse transform of H(1, 4) and H(4, 1).
    both = np.concatenate((response.response, np.conj(response.response[-2:0:-1])))
    markov = np.fft.ifft(both, axis=0)
    own = abs(markov[0, 0, 0])
    # A run, event by event: the first charge that is completed is that of cylinder 4, which
    # opened before the changed one.
    charges = []
    for lift in (5.05, 4.95):
        run = PLANT.start(3000.0, ValveCommand(5.0, 280.0), 30.0)
        (done,) = run.step_event(ValveCommand(lift, 280.0)).completed
        assert done.cylinder == 4
        charges.append(done.air_charge)
    truth = (charges[0] - charges[1]) / 0.1
    assert abs(truth) > 0.1 * own
    assert markov[-1, 3, 0].real == pytest.approx(truth, rel=0.01)
    assert abs(markov[-1, 1, 0]) < 1e-6 * own  # cylinder 2 had shut


# -- the mean-value plant ------------------------------------------------------------------------


@pytest.mark.parametrize("output", ["air_charge", "maf"])
def test_mean_value_response_is_control_s_own_evaluation(maps, output):
    dynamics = maps.dynamics(gains=(0.9, 1.0, 1.15, 1.05))
    commands = [EARLY.replace(duration_deg=120.0 + 4.0 * k) for k in (0, 1, -1, 2)]
    response = mean_value_response(dynamics, commands, 1500.0, output=output, omega=grid(1500.0))
    system = dynamics.lifted(commands, 1500.0, outputs=(output,))
    frd = response.frd()
    np.testing.assert_allclose(
        frd.frdata, system.frequency_response(response.omega).frdata, rtol=1e-9, atol=1e-12
    )
    assert frd.input_labels == system.input_labels == [f"duration_deg[{k}]" for k in (1, 2, 3, 4)]
    assert frd.output_labels == system.output_labels
    assert frd.dt == system.dt == pytest.approx(0.08)
    assert response.linearity_error == 0.0
    assert response.linear


def test_mean_value_modes_are_those_of_the_lifted_plant(maps):
    dynamics = maps.dynamics()
    lifted = mean_value_response(dynamics, EARLY, 1500.0, output="maf", omega=grid(1500.0))
    for q in range(4):
        theta, truth = lifted.mode_band(q)
        modes = mean_value_modes(dynamics, EARLY, 1500.0, output="maf", modes=[q], theta=theta)
        np.testing.assert_allclose(modes.mode(q), truth, rtol=1e-8)
    with pytest.raises(ParameterError, match="mode q is 1, but must be one of 3"):
        modes.mode(1)


# -- amplitude, memory, errors -------------------------------------------------------------------


def test_the_linearity_error_falls_with_the_square_of_the_amplitude():
    # The central difference errs by the third derivative.
    errors = [
        full_plant_response(PLANT, EARLY, 1500.0, omega=[0.0], amplitude=a).linearity_error
        for a in (0.1, 0.05)
    ]
    assert errors[0] > 2e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def test_a_throttled_manifold_remembers_for_cycles():
    options = {"throttle_deg": 25.0, "omega": [0.0]}
    with pytest.raises(ConvergenceError, match="still felt after 3 cycles at 1500 rpm"):
        full_plant_response(PLANT, EARLY, 1500.0, most_cycles=3, **options)
    response = full_plant_response(PLANT, EARLY, 1500.0, **options)
    assert 0.0 < response.left <= 1e-6
    rough = full_plant_response(PLANT, EARLY, 1500.0, tolerance=0.05, **options)
    assert response.mode(0)[0] != rough.mode(0)[0]
    assert response.mode(0)[0] == pytest.approx(rough.mode(0)[0], rel=0.5)


def test_a_single_cylinder_is_its_own_mode():
    single = CrankAnglePlant(Engine.paper().replace(n_cylinders=1))
    response = full_plant_response(single, EARLY, 1500.0, output="maf", omega=grid(1500.0))
    np.testing.assert_array_equal(response.mode(0), response.response[:, 0, 0])
    charge = single.steady_cycles(1500.0, 3.0, [119.5, 120.0, 120.5]).air_charge.values.ravel()
    truth = (charge[2] - charge[0]) / charge[1] * 120.0
    assert response.mode(0)[0] == pytest.approx(truth, rel=2e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"input": "opening_deg"}, "input is 'opening_deg', but must be one of lift_mm"),
        ({"output": "map"}, "output is 'map', but must be one of air_charge"),
        ({"omega": [0.0, 40.0]}, "omega is 40 rad/s, but must be in"),
        ({"omega": [2.0, 1.0]}, "do not rise"),
        ({"omega": []}, "must be a list of finite frequencies"),
        ({"amplitude": 0.0}, "amplitude is 0, but must be in"),
        ({"tolerance": 1.0}, "tolerance is 1, but must be in"),
        ({"most_cycles": 0}, "most_cycles is 0, but must be from 1"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        full_plant_response(PLANT, EARLY, 1500.0, **options)


def test_commands_that_cannot_be_changed_are_refused():
    with pytest.raises(ParameterError, match=r"duration_deg changed by .* to both sides"):
        full_plant_response(PLANT, ValveCommand(3.0, 360.0), 1500.0)
    shortest = PLANT.valve_profile(ValveCommand(8.0, 50.0), 3000.0, "limit").delivered_lift_mm
    with pytest.raises(InfeasibleProfileError, match="lift_mm changed by"):
        full_plant_response(PLANT, ValveCommand(shortest, 50.0), 3000.0, input="lift_mm")
    with pytest.raises(ParameterError, match="opening_deg is 10 deg, but must be 0 deg"):
        full_plant_response(PLANT, ValveCommand(3.0, 120.0, 10.0), 1500.0, output="maf")
    assert full_plant_response(PLANT, ValveCommand(3.0, 120.0, 10.0), 1500.0, omega=[0.0]).linear


def test_a_response_prints_and_plots_and_goes_to_control():
    response = full_plant_response(PLANT, EARLY, 1500.0, output="maf", omega=grid(1500.0))
    assert str(response).startswith("full plant at 1500 rpm, duration_deg to maf, 4 cylinders")
    mode = response.mode_frd(1)
    np.testing.assert_array_equal(mode.frdata[0, 0], response.mode(1))
    events = response.event_frd()
    assert events.dt == pytest.approx(0.02)
    np.testing.assert_array_equal(events.frdata[0, 0], response.event_response())
    figure = response.plot(label="once")
    response.plot(figure, label="again")
    gain, phase = figure.axes
    texts = [t.get_text() for t in gain.get_legend().get_texts()]
    assert texts == [f"mode {q}, {who}" for who in ("once", "again") for q in (0, 1, 2)]
    assert gain.lines[0].get_linestyle() != gain.lines[-1].get_linestyle()
    assert phase.get_xlabel() == "angle per event (deg)"
    plt.close(figure)
