import control
import numpy as np
import pytest

from plant.air_path import FlowShape, PulseResponse, event_time, mode_point
from plant.errors import ParameterError


def test_event_time_is_the_cycle_shared_by_the_cylinders():
    assert event_time(1500.0, 4) == pytest.approx(0.02)  # 80 ms a cycle
    assert event_time(6000.0, 1) == pytest.approx(0.02)
    assert mode_point(2, 4) == pytest.approx(-1.0)


def test_an_even_pulse_by_hand():
    # In its own event the reading rises to (1 - a)/T and takes tau of that with it; from then
    # on it decays, and tau times each event's fall has passed.
    T, tau = 0.02, 0.015
    a = np.exp(-T / tau)
    response = PulseResponse.of_window(T, time_constant=tau, delay=0.0)
    assert response.first == 0
    expected = [1.0 - tau / T * (1.0 - a), tau / T * (1.0 - a) ** 2]
    np.testing.assert_allclose(response.taps, expected, rtol=1e-13)
    assert response.pole == pytest.approx(a, rel=1e-14)
    assert response(1.0) == pytest.approx(1.0, abs=1e-14)


def test_a_delay_of_whole_events_is_a_shift():
    T = 0.005
    late = PulseResponse.of_window(T, time_constant=0.015, delay=3 * T)
    prompt = PulseResponse.of_window(T, time_constant=0.015, delay=0.0)
    z = np.exp(1j * np.linspace(0.1, np.pi, 9))
    np.testing.assert_allclose(late(z), prompt(z) * z**-3, atol=1e-13)


@pytest.mark.parametrize(
    ("shift", "taper", "correction"), [(0.0, 0.0, 0.0), (-3e-3, 0.0, 0.0), (4e-3, 2e-3, 0.012)]
)
@pytest.mark.parametrize("delay", [0.0, 2.3e-3, 17e-3])
def test_taps_and_tail_are_the_windows_of_an_integrated_lag(shift, taper, correction, delay):
    T, tau, parts, h = 0.01, 0.008, 5, 1e-5
    shares = np.random.default_rng(4).normal(0.2, 0.3, 13)  # over more than two events
    shape = FlowShape(shares / shares.sum(), parts)
    response = PulseResponse.of_window(
        T,
        time_constant=tau,
        delay=delay,
        shape=shape,
        shift=shift,
        taper=taper,
        correction=correction,
    )
    # Charge of 1 at event 0, in steps of h; Heun's rule, not the closed form.
    begin = -5 * T
    time = begin + h * np.arange(round(20 * T / h) + 1)
    flow = np.zeros(time.size - 1)
    first = round((delay - begin) / h)
    each = np.repeat(shape.shares * parts / T, round(T / parts / h))
    flow[first : first + each.size] = each
    reading = np.zeros(time.size)
    for i, u in enumerate(flow):
        slope = (u - reading[i]) / tau
        reading[i + 1] = reading[i] + h * slope * (1.0 - 0.5 * h / tau)
    passed = np.concatenate(([0.0], np.cumsum(0.5 * h * (reading[1:] + reading[:-1]))))

    def at(values, t):
        if not taper:
            return np.interp(t, time, values)
        around = t + np.linspace(-0.5, 0.5, 401) * taper
        return np.trapezoid(np.interp(around, time, values), dx=1.0 / 400)

    for k in range(-3, 12):
        edges = k * T + shift, (k + 1) * T + shift
        seen = at(passed, edges[1]) - at(passed, edges[0])
        seen += correction * (at(reading, edges[1]) - at(reading, edges[0]))
        j = k - response.first
        last = response.taps.size - 1
        told = 0.0
        if j >= 0:
            told = response.taps[min(j, last)] * response.pole ** max(j - last, 0)
        assert told == pytest.approx(seen, abs=2e-5)


def test_the_system_is_the_response_after_its_latency():
    shape = FlowShape(np.array([0.3, -0.2, 0.5, 0.4]), 3)
    response = PulseResponse.of_window(0.01, time_constant=0.015, delay=4e-3, shape=shape)
    charge = np.random.default_rng(0).normal(size=25)
    for latency in (1, 3):
        seen = control.forced_response(response.system(latency), inputs=charge).outputs
        lags = np.arange(25) - response.first
        weight = np.zeros(25)
        last = response.taps.size - 1
        for k, j in enumerate(lags):
            if j >= 0:
                weight[k] = response.taps[min(j, last)] * response.pole ** max(j - last, 0)
        expected = np.convolve(weight, charge)[: 25 - latency]
        np.testing.assert_allclose(seen[latency:], expected, atol=1e-12)
    with pytest.raises(ParameterError, match="latency is 0 events, but must be at least"):
        PulseResponse.of_window(0.01, time_constant=0.015, delay=0.0).system(0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"event_time": 0.0}, "event_time is 0 s"),
        ({"time_constant": 0.0}, "time_constant is 0 s"),
        ({"time_constant": np.nan}, "time_constant is nan s"),
        ({"delay": -1e-3}, r"delay is -0\.001 s"),
    ],
)
def test_bad_windows_are_refused(arguments, message):
    given = {"event_time": 0.02, "time_constant": 0.015, "delay": 0.0, **arguments}
    with pytest.raises(ParameterError, match=message):
        PulseResponse.of_window(given.pop("event_time"), **given)


@pytest.mark.parametrize("shares", [[], [0.5, 0.4], [np.nan, 1.0], [[1.0]]])
def test_shares_that_are_not_a_whole_charge_are_refused(shares):
    with pytest.raises(ParameterError, match="must be a list that sums up to 1"):
        FlowShape(np.array(shares), 2)
