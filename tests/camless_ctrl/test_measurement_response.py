import control
import numpy as np
import pytest

from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.measurement_response import (
    FlowShape,
    MeasurementResponse,
    event_time,
)
from plant.errors import ParameterError
from plant.sampling import TimeSampling
from plant.sensors import MafSensor

AVERAGE = ChargeEstimator.event_average()


def average_response(speed_rpm, delay=0.0):
    T = event_time(speed_rpm, 4)
    return MeasurementResponse.of_maf(AVERAGE, T, time_constant=0.015, delay=delay)


# Four cylinders, charge spread evenly over its event, lag 15 ms; computed by another program.
@pytest.mark.parametrize(
    ("speed_rpm", "gain", "phase_deg", "gain_q2", "extra_deg"),
    [
        (750, 0.71, -27, 0.35, (-3, -8, -13)),
        (1500, 0.52, -48, 0.13, (-5, -16, -27)),
        (3000, 0.31, -66, 0.035, (-11, -31, -47)),
        (6000, 0.16, -77, 0.009, (-21, -54, -90)),
    ],
)
def test_event_average_of_imbalance_modes(speed_rpm, gain, phase_deg, gain_q2, extra_deg):
    response = average_response(speed_rpm)
    once = response.mode(1, 4)
    assert abs(once) == pytest.approx(gain, abs=0.0055)
    assert np.degrees(np.angle(once)) == pytest.approx(phase_deg, abs=0.6)
    assert abs(response.mode(2, 4)) == pytest.approx(gain_q2, rel=0.04)
    for delay, extra in zip((1e-3, 3e-3, 5e-3), extra_deg, strict=True):
        turned = average_response(speed_rpm, delay).mode(1, 4)
        assert np.degrees(np.angle(turned / once)) == pytest.approx(extra, abs=0.6)


@pytest.mark.parametrize(("speed_rpm", "delay"), [(3000, 1e-3), (6000, 1e-3), (1500, 3e-3)])
def test_delay_flips_the_sign_of_the_alternating_mode(speed_rpm, delay):
    assert average_response(speed_rpm).mode(2, 4).real > 0.0
    assert average_response(speed_rpm, delay).mode(2, 4).real < 0.0


def test_event_average_by_hand():
    # H = 1 + ((1 - a)/(z - a) - 1) tau/T (1 - a) for an even flow without delay
    T, tau, z = 0.02, 0.015, 1j
    a = np.exp(-T / tau)
    expected = 1.0 + ((1.0 - a) / (z - a) - 1.0) * tau / T * (1.0 - a)
    assert average_response(1500)(z) == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("shape", [FlowShape.even(), FlowShape(np.array([-0.2, 0.1, 0.8, 0.3]), 5)])
def test_matched_estimator_sees_every_mode(shape):
    estimator = ChargeEstimator(time_constant=0.02, delay=2e-3, taper=0.0)
    response = MeasurementResponse.of_maf(
        estimator, 0.005, time_constant=0.02, delay=2e-3, shape=shape
    )
    z = np.exp(1j * np.linspace(0.0, np.pi, 7))
    np.testing.assert_allclose(response(z), 1.0, atol=1e-12)


@pytest.mark.parametrize("taper", [0.0, 2e-3])
@pytest.mark.parametrize("delay", [0.0, 2.7e-3, 11e-3])
def test_mean_mode_passes_unchanged_whatever_the_mismatch(taper, delay):
    estimator = ChargeEstimator(taper=taper)
    response = MeasurementResponse.of_maf(estimator, 0.005, time_constant=0.01, delay=delay)
    assert response.mode(0, 4) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("n", [1, 3, 4])
@pytest.mark.parametrize("delay", [0.0, 2.6e-3])
def test_response_predicts_the_sampled_sensor(n, delay):
    T, parts, events = event_time(3000, n), 4, 30
    shape = FlowShape(np.array([0.1, 0.2, 0.5, 0.3, -0.1]), parts)
    estimator = ChargeEstimator(taper=1.5e-3)
    charge = np.random.default_rng(1).uniform(0.5, 1.5, events)
    flow = np.zeros(events * parts + shape.shares.size)
    for k, m in enumerate(charge):
        flow[k * parts : k * parts + shape.shares.size] += m * shape.shares * parts / T
    edges = np.repeat(np.arange(flow.size + 1) * T / parts, 2)[1:-1]
    sensor = MafSensor(delay=delay, sampling=TimeSampling(2e-5)).ideal()
    # starts from no flow, as the response does
    run = sensor.replace(lowest=-1e6, highest=1e6).start(0)
    samples = run.measure(np.append(0.0, edges), np.append(0.0, np.repeat(flow, 2)))
    response = MeasurementResponse.of_maf(
        estimator, T, time_constant=0.015, delay=delay, shape=shape
    )
    latency = estimator.latency_events(T)
    system = response.system(latency)
    predicted = control.forced_response(system, inputs=charge).outputs
    for k in range(latency + 3, events - 3):
        seen = estimator.charge(samples.time, samples.value, k * T, (k + 1) * T)
        assert predicted[k + latency] == pytest.approx(seen, abs=2e-4)


def test_an_estimate_cannot_be_used_before_it_is_there():
    late = ChargeEstimator(delay=3e-3)
    response = MeasurementResponse.of_maf(late, 0.005, time_constant=0.01, delay=0.0)
    with pytest.raises(ParameterError, match="latency is 1 events, but must be at least 2"):
        response.system(1)


@pytest.mark.parametrize(
    ("estimator", "T", "latency"),
    [
        (ChargeEstimator.event_average(), 0.02, 1),
        (ChargeEstimator(delay=1e-3, taper=2e-3), 0.02, 2),
        (ChargeEstimator(delay=4e-3, taper=2e-3), 0.005, 2),
        (ChargeEstimator(delay=5e-3, taper=2e-3), 0.005, 3),
    ],
)
def test_latency(estimator, T, latency):
    assert estimator.latency_events(T) == latency


def test_shares_must_sum_up_to_one():
    with pytest.raises(ParameterError, match=r"sum up to 0\.9"):
        FlowShape(np.array([0.5, 0.4]), 2)
    assert FlowShape(np.array([0.0, 1.0]), 2).centre == 0.75
