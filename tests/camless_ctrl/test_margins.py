import math

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_loop import MODE_WIDTH, EventLoop
from camless_ctrl.margins import margins_of_response, stability_margins
from plant.errors import ParameterError


def test_crossing_at_nyquist_by_hand():
    # L = c/(z - 0.5): the pole 0.5 - k c reaches -1 at k = 1.5/c, where L(-1) = -c/1.5.
    loop = control.tf([1.5 / 1.36], [1.0, -0.5], 1.0)
    assert math.isinf(control.stability_margins(loop)[0])  # the trap
    found = stability_margins(loop)
    assert found.stable
    assert found.gain_margin == pytest.approx(1.36, rel=1e-9)
    assert found.gain_reduction_margin == 0.0
    # |S| is largest at Nyquist: 1/(1 - 1/1.36)
    assert found.sensitivity_peak == pytest.approx(1.36 / 0.36, rel=1e-9)
    # S - 1/2 there is 1.36/0.36 - 1/2
    assert found.disk_margin == pytest.approx(1.0 / (1.36 / 0.36 - 0.5), rel=1e-9)
    assert found.disk_gain_margin == pytest.approx(1.36, rel=1e-9)


@pytest.mark.parametrize("kappa", [0.2, 0.5, 1.9])
def test_integrator_by_hand(kappa):
    # z - 1 + kappa = 0 leaves the circle at kappa = 2.
    found = stability_margins(control.tf([kappa], [1.0, -1.0], True))
    assert found.gain_margin == pytest.approx(2.0 / kappa, rel=1e-9)
    # |L| = 1 at sin(omega/2) = kappa/2, where the phase is -90 deg - omega/2
    expected = 90.0 - math.degrees(math.asin(kappa / 2.0))
    assert found.phase_margin_deg == pytest.approx(expected, rel=1e-6)


def test_unstable_loop_has_no_margin():
    loop = control.ss(control.tf([3.0], [1.0, -1.0], 1.0))  # pole at -2
    assert control.disk_margins(loop, np.linspace(0.01, np.pi, 200))[0] > 0.3  # the trap
    found = stability_margins(loop)
    assert not found.stable
    for value in (found.gain_margin, found.phase_margin_deg, found.disk_margin):
        assert math.isnan(value)
    assert str(found) == "unstable: no margin"


def test_textbook_disk_margin():
    # Seiler, Packard and Gahinet (2020), L = 25/(s^3 + 10 s^2 + 10 s + 10): gain margin 3.6,
    # phase margin 29.1 deg, disk margin 0.46.
    loop = control.tf([25.0], [1.0, 10.0, 10.0, 10.0])
    found = stability_margins(loop)
    assert found.gain_margin == pytest.approx(3.6, rel=1e-6)
    assert found.phase_margin_deg == pytest.approx(29.1, abs=0.05)
    assert found.disk_margin == pytest.approx(0.458, abs=5e-4)


def test_conditionally_stable_loop_has_two_gain_margins():
    # z - 1.2 + k 0.5 = 0: stable for 0.4 < k < 4.4
    found = stability_margins(control.tf([0.5], [1.0, -1.2], 1.0))
    assert found.gain_margin == pytest.approx(4.4, rel=1e-9)
    assert found.gain_reduction_margin == pytest.approx(0.4, rel=1e-9)


@pytest.mark.parametrize("speed_rpm", [1500, 6000])
def test_margin_of_the_modes_is_that_of_the_loop(speed_rpm):
    loop = EventLoop.at_speed(speed_rpm, ChargeEstimator(), AdaptationGains(0.3, 0.2), delay=2e-3)
    theta = 2.0 * np.pi * np.linspace(-MODE_WIDTH, MODE_WIDTH, 1201)
    modal = [margins_of_response(mode, theta, True) for mode in loop.modes()]
    whole = stability_margins(loop.system())
    assert min(m.gain_margin for m in modal) == pytest.approx(whole.gain_margin, rel=1e-6)
    assert min(m.disk_margin for m in modal) == pytest.approx(whole.disk_margin, rel=1e-5)
    assert max(m.sensitivity_peak for m in modal) == pytest.approx(whole.sensitivity_peak, rel=1e-5)
    # and the gain margin is where the poles leave the circle
    for factor, stable in ((0.999, True), (1.001, False)):
        gains = loop.gains.scaled(factor * whole.gain_margin)
        scaled = EventLoop(4, loop.measurement, gains, loop.latency)
        assert (np.max(np.abs(scaled.poles())) < 1.0) == stable


def test_multivariable_loop_is_refused():
    with pytest.raises(ParameterError, match="2 inputs and 2 outputs"):
        stability_margins(control.ss([], [], [], np.eye(2), 1.0))
