import math

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.gang_of_four import FUNCTIONS, gang_of_four
from camless_ctrl.margins import stability_margins
from camless_ctrl.nominal_loop import NominalLoop
from plant import ParameterError

GAINS = AdaptationGains(0.4, 0.25)


def event_loop(n=4, gains=GAINS, speed_rpm=3000.0):
    return EventLoop.at_speed(speed_rpm, ChargeEstimator(), gains, n_cylinders=n, delay=2e-3)


@pytest.fixture(scope="module")
def four():
    return gang_of_four(NominalLoop.of_event_loop(event_loop()))


def by_hand(loop, z):
    """The four from the loop's closed form and the pulse response, no state space."""
    P = z**-loop.latency * loop.measurement(z)
    L = loop(z)
    S = 1.0 / (1.0 + L)
    return {"S": S, "T": L * S, "CS": L / P * S, "PS": P * S}


def test_responses_are_the_closed_forms(four):
    loop = event_loop()
    for mode in four.modes:
        z = np.exp(1j * mode.omega * four.loop.event_time)
        away = np.abs(z**4 - 1.0) > 1e-3  # there the loop response is infinite
        for name, expected in by_hand(loop, z[away]).items():
            np.testing.assert_allclose(mode.responses[name][away], expected, rtol=1e-8, atol=1e-10)


def test_integrators_leave_no_error(four):
    # Where the law is infinite, in the middle of each mode: S = PS = 0, T = 1, CS = 1/P.
    for mode in four.modes:
        z = np.exp(2j * np.pi * mode.q / 4)
        k = int(np.argmin(np.abs(mode.omega * four.loop.event_time - np.angle(z))))
        P = z ** -event_loop().latency * event_loop().measurement(z)
        assert abs(mode.responses["S"][k]) < 1e-9
        assert abs(mode.responses["PS"][k]) < 1e-9
        assert mode.responses["T"][k] == pytest.approx(1.0, abs=1e-9)
        assert mode.responses["CS"][k] == pytest.approx(1.0 / complex(P), rel=1e-8)


def test_peaks_by_hand():
    # L = kappa/(z - 1) with P = 1: S = (z - 1)/(z - 1 + kappa) peaks at z = -1.
    kappa, T = 0.5, 0.02
    law = control.ss([[1.0]], [[kappa]], [[1.0]], [[0.0]], T)
    unit = control.ss([], [], [], [[1.0]], T)
    found = gang_of_four(NominalLoop(law, unit, 1))
    for name in ("S", "PS"):
        assert found.peak(name).value == pytest.approx(2.0 / (2.0 - kappa), rel=1e-9)
        assert found.peak(name).frequency == pytest.approx(np.pi / T, rel=1e-6)
    for name in ("T", "CS"):
        assert found.peak(name).value == pytest.approx(1.0, rel=1e-9)
        assert found.peak(name).frequency == pytest.approx(0.0, abs=1e-6)


def test_peaks_of_s_and_t_are_those_of_the_margins(four):
    whole = stability_margins(event_loop().system())
    assert four.peak("S").value == pytest.approx(whole.sensitivity_peak, rel=1e-6)
    assert four.peak("T").value == pytest.approx(whole.complementary_peak, rel=1e-6)


@pytest.mark.parametrize("n", [1, 3, 4])
@pytest.mark.parametrize("function", FUNCTIONS)
def test_lifted_singular_values_are_the_sizes_of_the_modes(n, function):
    found = gang_of_four(NominalLoop.of_event_loop(event_loop(n)))
    theta = np.array([-2.0, 0.4, 1.3, 3.0])
    values = found.singular_values(function, theta)
    assert values.shape == (4, n)
    for row, phase in zip(values, theta, strict=True):
        z = np.exp(1j * (phase + 2.0 * np.pi * np.arange(n)) / n)
        expected = np.sort(np.abs(by_hand(event_loop(n), z)[function]))[::-1]
        np.testing.assert_allclose(row, expected, rtol=1e-8)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_norm_of_the_lifted_function_is_the_largest_peak(four, function):
    norm, where = control.linfnorm(four.lifted(function), tol=1e-8)
    peak = four.peak(function)
    assert peak.value == pytest.approx(norm, rel=1e-6)
    # The same cycle phase, whatever its sign
    cycle = 4.0 * four.loop.event_time
    assert math.cos(peak.frequency * cycle) == pytest.approx(math.cos(where * cycle), abs=1e-2)
    assert max(four.peak(function, q).value for q in (0, 1, 2)) == peak.value


def test_unstable_loop_has_no_finite_peak():
    found = gang_of_four(NominalLoop.of_event_loop(event_loop(gains=AdaptationGains(4.0, 4.0))))
    assert not found.stable
    assert all(math.isinf(found.peak(name).value) for name in FUNCTIONS)
    assert str(found).startswith("The loop is unstable (pole radius ")


def test_it_prints_and_plots(four):
    import matplotlib.pyplot as plt

    lines = str(four).splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("Peaks of the mean mode: |S| ")
    assert "alternating" in lines[2]
    figure = four.plot()
    assert len(figure.axes) == 4
    for ax in figure.axes:
        curves = [line for line in ax.get_lines() if len(line.get_xdata()) > 1]
        assert len({(c.get_linestyle(), c.get_color()) for c in curves}) == 3
        assert ax.get_ylabel()
    plt.close(figure)


def test_unknown_names_are_refused(four):
    with pytest.raises(ParameterError, match="function is 'SC'"):
        four.peak("SC")
    with pytest.raises(ParameterError, match="mode is 3, but must be one of 0, 1, 2"):
        four.peak("S", 3)
