import math

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.delay_margin import MOST_EVENTS, delay_margin
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.linearise import LocalResponse
from camless_ctrl.measurement_response import FlowShape
from camless_ctrl.nominal_loop import NominalLoop
from camless_ctrl.robustness import analyse_point
from plant import ParameterError, ValveCommand

T = 0.02
UNIT = control.ss([], [], [], [[1.0]], T)


def integrator(kappa):
    return NominalLoop(control.ss([[1.0]], [[kappa]], [[1.0]], [[0.0]], T), UNIT, 1)


@pytest.mark.parametrize("kappa", [0.05, 0.3, 0.9, 1.5])
def test_delayed_integrator_by_hand(kappa):
    # z^m (z - 1) + kappa is stable for kappa < 2 sin(pi/(4 m + 2)), a textbook limit.
    m = 0
    while kappa < 2.0 * math.sin(math.pi / (4.0 * (m + 1) + 2.0)):
        m += 1
    found = delay_margin(integrator(kappa))
    assert found.stable
    assert found.events == m
    # |L| = 1 at sin(w/2) = kappa/2, where the phase is -90 deg - w/2
    omega = 2.0 * math.asin(0.5 * kappa)
    assert found.frequency == pytest.approx(omega / T, rel=1e-9)
    assert found.time == pytest.approx(0.5 * (math.pi - omega) / omega * T, rel=1e-9)
    assert found.events == math.floor(found.time / T)  # both say the same here
    assert math.isnan(found.sensor_delay)


def test_weak_loop_withstands_all_delays():
    found = delay_margin(NominalLoop(0.5 * UNIT, control.ss([], [], [], [[0.9]], T), 1))
    assert found.events == MOST_EVENTS
    assert math.isinf(found.time)
    assert "100 or more events" in str(found)


def test_unstable_loop_has_none():
    found = delay_margin(integrator(2.5))
    assert not found.stable
    assert found.events == 0
    assert math.isnan(found.time)
    assert str(found) == "unstable: no delay margin"


@pytest.mark.parametrize("speed_rpm", [1500.0, 3000.0])
def test_delay_of_the_sensor_is_that_of_the_analysis(speed_rpm):
    estimator, gains = ChargeEstimator(), AdaptationGains(0.4, 0.25)
    local = LocalResponse(
        speed_rpm, 4, ValveCommand(5.0, 150.0), 250e-6, 1.0, 1.1, FlowShape.even()
    )
    expected = analyse_point(local, 250e-6, estimator, gains, 0.1, points=(2, 2)).delay_limit
    loop = NominalLoop.of_event_loop(
        EventLoop.at_speed(speed_rpm, estimator, gains, sensitivity=1.1)
    )

    def at_delay(delay):
        return NominalLoop.of_sensor(loop.law, local, estimator, delay=delay)

    found = delay_margin(loop, at_delay)
    assert found.sensor_delay == pytest.approx(expected, abs=1e-8)
    assert found.sensor_margin == pytest.approx(expected - 1e-3, abs=1e-8)
    assert at_delay(found.sensor_delay - 1e-7).stable
    assert not at_delay(found.sensor_delay + 1e-7).stable
    assert "of the sensor" in str(found)
    assert math.isinf(delay_margin(loop, at_delay, longest=1.5e-3).sensor_delay)
    with pytest.raises(ParameterError, match="try longer delays"):
        delay_margin(loop, at_delay, longest=1e-3)


def test_estimate_that_comes_later_goes_to_the_wrong_cylinder():
    # The law still credits it to the cylinder of the event before: each event is then off by
    # one, a phase turn of the alternating mode by 180 deg, which no gain withstands.
    loop = NominalLoop.of_event_loop(
        EventLoop.at_speed(1500.0, ChargeEstimator(), AdaptationGains(0.1, 0.1))
    )
    found = delay_margin(loop)
    assert found.events == 0
    assert 0.0 < found.time < T
    poles = loop.later(1).poles
    assert np.any((np.abs(poles) > 1.0) & (np.abs(np.angle(poles)) > 0.75 * np.pi))
