import numpy as np
import pytest

from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.estimator_response import (
    AnalysedEstimator,
    ChangedPoint,
    _readings,
    estimator_response,
)
from camless_ctrl.event_data import EVENTS, PARTS, ModelPoint
from camless_ctrl.kalman_estimator import KalmanEstimator
from camless_ctrl.window_estimator import WindowEstimator
from plant import (
    CrankAnglePlant,
    CrankSampling,
    FlowShape,
    MafSensor,
    ParameterError,
    PulseResponse,
    TimeSampling,
    ValveCommand,
)
from plant.sensors import MapSensor
from uncertainty._event_pulse import Pulse
from uncertainty.motion_pulses import ChangedMotion, FollowedPlant, follow_motion

SPEED, T, CHARGE, CHANGE = 1500.0, 0.02, 250e-6, 0.01
Z = np.exp(1j * np.linspace(0.0, np.pi, 91))
SAMPLES = 360


def made_up(shape):
    """Plant of even flow, to which a change adds charge in a given shape over two events."""
    per_event = SAMPLES
    added = np.asarray(shape, dtype=float)
    flow = CHANGE * CHARGE * added / (added.sum() * T / per_event)
    pulse = Pulse(
        0,
        np.array([CHANGE * CHARGE]),
        flow.reshape(2, per_event),
        np.zeros((2, per_event)),
        np.array([CHANGE * CHARGE, 0.0]),
        0.0,
    )
    steady = np.full(per_event, CHARGE / T)
    return FollowedPlant(CHARGE, steady, np.full(per_event, 99e3), pulse)


def point(shares=None):
    shares = np.full(EVENTS * PARTS, 1.0 / PARTS) if shares is None else shares
    shares = np.where(np.arange(EVENTS * PARTS) < PARTS, shares, 0.0)
    return ModelPoint(8.0, 110.0, CHARGE, False, 0.1, 160.0, shares)


POINTS = ChangedPoint(point(), point(), point(), CHANGE)
LATE = np.concatenate((np.zeros(120), np.hanning(300), np.zeros(300)))  # over two events


@pytest.mark.parametrize(
    ("window", "lag", "delay"),
    [
        (ChargeEstimator(), 15e-3, 1e-3),
        (ChargeEstimator(), 10e-3, 3e-3),
        (ChargeEstimator(delay=0.0, taper=0.0), 20e-3, 0.0),
        (ChargeEstimator.event_average(), 15e-3, 1e-3),
    ],
)
def test_window_has_the_response_of_its_closed_form(window, lag, delay):
    maf = MafSensor(time_constant=lag, delay=delay)
    found = [
        estimator_response(
            WindowEstimator(window), made_up(LATE), POINTS, SPEED, 4, maf=maf, sample_time=time
        )
        for time in (4e-4, 1e-4)
    ]
    between = LATE + np.append(LATE[1:], 0.0)  # linear between its samples
    closed = PulseResponse.of_window(
        T,
        time_constant=lag,
        delay=delay,
        shape=FlowShape(between / between.sum(), SAMPLES),
        shift=window.delay,
        taper=window.taper,
        correction=window.time_constant,
    )
    coarse, fine = (np.abs(f.response(Z) - closed(Z)).max() for f in found)
    assert fine < 2e-3  # of which the taps that are left out may be half
    assert coarse < 5e-3
    assert found[1].latency == window.latency_events(T)
    assert found[1].charge == pytest.approx(CHARGE, rel=1e-3)


def test_readings_are_those_of_the_sensor():
    # The sensor itself, run over event after event.
    maf = MafSensor(
        time_constant=7e-3, delay=2.5e-3, gain_error=0.02, sampling=TimeSampling(1e-3, 0.4e-3)
    ).ideal().replace(gain_error=0.02)  # fmt: skip
    plant = made_up(LATE)
    wave = plant.flow * (1.0 + 0.4 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES))
    events, changed = 30, 20
    time = np.arange(events * SAMPLES + 1) * T / SAMPLES
    signal = np.append(np.tile(wave, events), wave[0])
    added = np.zeros_like(signal)
    added[changed * SAMPLES : (changed + 2) * SAMPLES] = plant.pulse.flow.ravel()
    for sign in (0.0, 1.0):
        seen = maf.start(0).measure(time, signal + sign * added)
        late = seen.time > 12 * T  # its lag has settled
        reading, moved = _readings(maf, seen.time[late], changed, T, wave, plant.pulse.flow)
        np.testing.assert_allclose(reading + sign * moved, seen.value[late], rtol=2e-5)


@pytest.fixture(scope="module")
def followed():
    plant = CrankAnglePlant(runner=True, oscillation=True)
    motion = ChangedMotion(*(ValveCommand(8.0, d) for d in (110.0, 110.5, 109.5)))
    return plant, follow_motion(plant, motion, SPEED)


def kalman_points(seen):
    """Points whose shares are those of the plant itself, by the flow of its valve."""
    plant, found = seen
    cycle = plant.steady_cycle(SPEED, ValveCommand(8.0, 110.0))
    trace = cycle.trace_at(720.0 / 4 / PARTS / 20)
    flow = trace.port_flow[: EVENTS * PARTS * 20, 0].reshape(-1, 20).sum(axis=1)
    rest = point()._replace(charge=found.charge, shares=flow / flow.sum())
    change = float(found.pulse.charge.sum()) / found.charge
    return ChangedPoint(rest, rest, rest, change)


def test_kalman_estimate_of_a_steady_change_is_the_charge(followed):
    plant, found = followed
    estimator = KalmanEstimator.of(plant.engine)
    response = estimator_response(estimator, found, kalman_points(followed), SPEED, 4)
    assert response.charge == pytest.approx(found.charge, rel=2e-3)
    # The air-flow sensor fixes the level, whatever the filter believes of the rest.
    assert response.response(1.0).real == pytest.approx(1.0, abs=0.02)
    assert response.latency == 3
    assert response.standing < 0.01
    assert "used after 3 events" in str(response)


@pytest.mark.parametrize(
    ("maf", "map_"),
    [
        (MafSensor(gain_error=0.03), MapSensor()),
        (MafSensor(), MapSensor(offset=1500.0)),
    ],
)
def test_gain_and_offset_of_the_sensors_drop_out(followed, maf, map_):
    plant, found = followed
    estimator = KalmanEstimator.of(plant.engine)
    points = kalman_points(followed)
    nominal = estimator_response(estimator, found, points, SPEED, 4)
    other = estimator_response(estimator, found, points, SPEED, 4, maf=maf, map=map_)
    np.testing.assert_allclose(other.response(Z), nominal.response(Z), atol=0.01)
    assert other.charge == pytest.approx(nominal.charge * (1.0 + maf.gain_error), rel=2e-3)


def test_an_estimator_that_tells_nothing_is_refused(followed):
    plant, found = followed
    deaf = KalmanEstimator.of(plant.engine, maf=MafSensor(sampling=CrankSampling(1.0)))
    with pytest.raises(ParameterError, match="have gaps or do not come to rest"):
        estimator_response(deaf, found, kalman_points(followed), SPEED, 4)


def test_changes_and_counts_are_checked(followed):
    plant, found = followed
    estimator = KalmanEstimator.of(plant.engine)
    points = kalman_points(followed)
    with pytest.raises(ParameterError, match="change"):
        estimator_response(estimator, found, points._replace(change=0.0), SPEED, 4)
    with pytest.raises(ParameterError, match="settling_events"):
        estimator_response(estimator, found, points, SPEED, 4, settling_events=3)


def test_latency_is_kept():
    assert AnalysedEstimator(WindowEstimator(), 3).latency_events(0.01) == 3
