import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.linearise import LocalResponse
from camless_ctrl.measurement_response import FlowShape
from camless_ctrl.nominal_loop import NominalLoop
from plant import ParameterError, ValveCommand

GAINS = AdaptationGains(0.4, 0.25)
UNIT = control.ss([], [], [], [[1.0]], 0.02)


def of_event_loop(n=4, speed_rpm=3000.0, **sensor):
    loop = EventLoop.at_speed(
        speed_rpm, ChargeEstimator(), GAINS, n_cylinders=n, sensitivity=1.2, **sensor
    )
    return loop, NominalLoop.of_event_loop(loop)


def shared_poles(some, others, least=0.3):
    return all(np.min(np.abs(others - pole)) < 1e-7 for pole in some[np.abs(some) > least])


@pytest.mark.parametrize("n", [1, 3, 4])
def test_it_is_the_event_loop(n):
    event_loop, loop = of_event_loop(n, delay=2e-3)
    z = 1.05 * np.exp(1j * np.linspace(0.1, 3.0, 20))
    np.testing.assert_allclose(loop(z), event_loop(z), rtol=1e-9)
    assert shared_poles(loop.poles, event_loop.poles())
    assert shared_poles(event_loop.poles(), loop.poles)


def test_loop_of_a_sensor_is_the_event_loop():
    shape = FlowShape(np.array([0.0, 0.2, 0.8]), 3)
    local = LocalResponse(3000.0, 4, ValveCommand(5.0, 150.0), 250e-6, 1.0, 1.2, shape)
    event_loop, loop = of_event_loop(delay=2e-3, time_constant=12e-3, shape=shape)
    built = NominalLoop.of_sensor(
        loop.law, local, ChargeEstimator(), time_constant=12e-3, delay=2e-3
    )
    z = 1.05 * np.exp(1j * np.linspace(0.1, 3.0, 20))
    np.testing.assert_allclose(built(z), event_loop(z), rtol=1e-9)


def test_later_estimates_are_a_shift():
    _, loop = of_event_loop()
    z = 1.05 * np.exp(1j * np.linspace(0.1, 3.0, 20))
    for events in (0, 1, 5):
        np.testing.assert_allclose(loop.later(events)(z), z**-events * loop(z), rtol=1e-9)
        assert loop.later(events).measurement.nstates == loop.measurement.nstates + events


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
def test_bands_cover_the_circle_once(n):
    _, loop = of_event_loop(n)
    T = loop.event_time
    bands = [loop.band(q) * T for q in loop.modes]
    assert bands[0][0] == 0.0
    assert bands[-1][-1] == pytest.approx(np.pi, abs=1e-12)
    for q, band in enumerate(bands):
        assert np.all(np.diff(band) > 0.0)
        assert np.min(np.abs(band - 2.0 * np.pi * q / n)) < 1e-12  # the middle is among them
        if q:
            assert band[0] == pytest.approx(bands[q - 1][-1], abs=1e-12)


def test_closed_loop_solves_its_equations():
    _, loop = of_event_loop()
    z = 1.1 * np.exp(0.8j)
    C, P = complex(loop.law(z)), complex(loop.measurement(z))
    S = 1.0 / (1.0 + C * P)
    expected = [[S, -C * S], [C * P * S, C * S], [P * S, S]]
    # y = d - c, c = C (P y + noise)
    np.testing.assert_allclose(loop.closed(z), expected, rtol=1e-10)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ParameterError, match="the law has 2 inputs and 2 outputs"):
        NominalLoop(control.ss([], [], [], np.eye(2), 0.02), UNIT, 4)
    for dt in (0.0, True, None):
        with pytest.raises(ParameterError, match="the measurement has the sampling time"):
            NominalLoop(UNIT, control.ss([], [], [], [[1.0]], dt), 4)
    with pytest.raises(ParameterError, match=r"0\.02 s, but must be that of the measurement, 0.01"):
        NominalLoop(UNIT, control.ss([], [], [], [[1.0]], 0.01), 4)
    with pytest.raises(ParameterError, match="has no solution"):
        _ = NominalLoop(UNIT, -1.0 * UNIT, 4).closed
    loop = NominalLoop(UNIT, 0.5 * UNIT, 4)
    with pytest.raises(ParameterError, match="no signal is named 'lambda'"):
        loop.lifted("lambda", "noise")
    with pytest.raises(ParameterError, match="q is 3"):
        loop.band(3)
