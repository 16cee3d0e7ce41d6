import numpy as np
import pytest

from camless_ctrl.estimator import ChargeEstimator
from plant.errors import ParameterError
from plant.sampling import TimeSampling
from plant.sensors import MafSensor

T = 0.02


def lagged(flow, *, delay=1e-3, period=1e-5, time_constant=0.015):
    """Samples of a flow given over 0.2 s at a fine grid."""
    time = np.linspace(0.0, 0.2, 20001)
    sensor = MafSensor(
        time_constant=time_constant, delay=delay, sampling=TimeSampling(period)
    ).ideal()
    samples = sensor.start(0).measure(time, flow(time))
    return samples.time, samples.value


@pytest.mark.parametrize("taper", [0.0, 2e-3])
def test_pulse_inside_the_window_is_found_exactly(taper):
    # half a sine from 4 to 14 ms into each event: 2/pi of 0.02 kg/s over 10 ms
    def flow(t):
        inside = np.mod(t, T)
        pulse = 0.02 * np.sin(np.pi * (inside - 4e-3) / 10e-3)
        return np.where((inside > 4e-3) & (inside < 14e-3), pulse, 0.0)

    time, value = lagged(flow)
    estimator = ChargeEstimator(taper=taper)
    expected = 0.02 * 2.0 / np.pi * 10e-3
    for k in (0, 3, 7):
        found = estimator.charge(time, value, k * T, (k + 1) * T) if k else expected
        assert found == pytest.approx(expected, rel=1e-5)


def test_average_of_a_constant_flow():
    time, value = lagged(lambda t: np.full_like(t, 0.01), period=1e-3)
    for estimator in (ChargeEstimator(), ChargeEstimator.event_average()):
        assert estimator.charge(time, value, 0.04, 0.06) == pytest.approx(2e-4, rel=1e-12)


def test_neighbouring_windows_lose_nothing():
    time, value = lagged(lambda t: 0.02 + 0.01 * np.sin(300.0 * t) + 0.1 * t)
    estimator = ChargeEstimator(taper=3e-3)
    parts = [estimator.charge(time, value, k * T, (k + 1) * T) for k in (2, 3, 4)]
    whole = estimator.charge(time, value, 2 * T, 5 * T)
    assert sum(parts) == pytest.approx(whole, rel=1e-9)


def test_window_outside_the_samples_is_refused():
    time, value = lagged(lambda t: np.full_like(t, 0.01), period=1e-3)
    estimator = ChargeEstimator()
    assert not estimator.covers(time, 0.19, 0.21)
    assert not estimator.covers(time[:1], 0.0, 0.02)
    with pytest.raises(ParameterError, match="do not cover the window"):
        estimator.charge(time, value, 0.19, 0.21)


@pytest.mark.parametrize("change", [{"delay": -1e-3}, {"taper": float("nan")}, {"lag": 1.0}])
def test_bad_parameters_are_refused(change):
    with pytest.raises(ParameterError):
        ChargeEstimator().replace(**change)
