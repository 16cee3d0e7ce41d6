import numpy as np
import pytest
from scipy.signal import lfilter

from plant import (
    ConvergenceError,
    CrankAnglePlant,
    Engine,
    MafSensor,
    ParameterError,
    PulseResponse,
    SimulationError,
    ValveCommand,
)
from plant.air_path import event_time
from uncertainty import pulse_sampling
from uncertainty.parameters import UncertaintySet
from uncertainty.perturbed import PerturbedPlants
from uncertainty.pulse_sampling import sampled_pulses
from uncertainty.sampling import Sample, draw, nominal_sample

PLANT = CrankAnglePlant(oscillation=True)
ALL = UncertaintySet.plant() + UncertaintySet.sensors()
POINTS = {
    750.0: ValveCommand(2.0, 100.0),
    1500.0: ValveCommand(3.0, 120.0),
    3000.0: ValveCommand(4.0, 150.0),
    6000.0: ValveCommand(5.0, 220.0),
}
FAILING = 2


@pytest.fixture(scope="module")
def pulses():
    plants = PerturbedPlants(PLANT, draw(ALL, 4, seed=5))
    return sampled_pulses(plants, POINTS[3000.0], 3000.0)


def shift(theta, q, n=4):
    return np.exp(1j * (theta + 2.0 * np.pi * q) / n)


def nominal_pulses(speed_rpm, **options):
    plants = PerturbedPlants(PLANT, nominal_sample(ALL))
    return sampled_pulses(plants, POINTS[speed_rpm], speed_rpm, **options)


@pytest.mark.parametrize("output", ["air_charge", "maf"])
def test_grids_agree_where_they_meet(pulses, output):
    coarse = pulses.responses(output, theta=np.linspace(-np.pi, np.pi, 9))
    fine = pulses.responses(output, theta=np.linspace(-np.pi, np.pi, 33), modes=(2, 0))
    for q in (0, 2):
        np.testing.assert_allclose(fine.mode(q)[:, ::4], coarse.mode(q), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(fine.nominal.mode(q)[::4], coarse.nominal.mode(q), rtol=1e-12)


@pytest.mark.parametrize("output", ["air_charge", "maf"])
def test_modes_mirror_and_meet(pulses, output):
    # A real system: g_(n-q)(theta) is the conjugate of g_q(-theta); and mode q at pi is mode
    # q + 1 at -pi, so that the modes together go round the circle once.
    found = pulses.responses(output, modes=(0, 1, 2, 3))
    np.testing.assert_allclose(found.mode(3), np.conj(found.mode(1)[:, ::-1]), rtol=1e-11)
    for q in range(3):
        np.testing.assert_allclose(found.mode(q)[:, -1], found.mode(q + 1)[:, 0], rtol=1e-11)


def test_the_charge_responses_are_the_sums_of_the_pulses(pulses):
    theta = np.array([-2.0, 0.3, 3.0])
    found = pulses.responses("air_charge", theta=theta)
    unit = 150.0 / pulses.reference_charge / pulses.step
    for i, pulse in enumerate(pulses.pulses):
        for q in range(3):
            z = shift(theta, q)
            truth = sum(c * z ** -(pulse.first + k) for k, c in enumerate(pulse.charge))
            np.testing.assert_allclose(found.mode(q)[i], unit * truth, rtol=1e-12)


def test_the_readings_are_those_of_a_lag_that_is_stepped_through(pulses):
    # Second method: the flow, held and late, through a lag on a grid 20 times finer, averaged
    # event by event, and summed until nothing is left.
    T = event_time(3000.0, 4)
    theta = np.array([-1.0, 0.0, 2.5])
    found = pulses.responses("maf", theta=theta)
    fine = 20
    for i in (0, 2):
        pulse = pulses.pulses[i]
        maf = pulses.plants.maf_at(i, MafSensor())
        events = len(pulse.flow) + 80
        dt = T / (360 * fine)
        t = dt * (np.arange(events * 360 * fine) + 0.5)
        flow = np.append(pulse.flow, 0.0)
        late = np.interp(t - maf.delay, T / 360 * np.arange(flow.size), flow, left=0.0, right=0.0)
        keep = np.exp(-dt / maf.time_constant)
        reading = (1.0 + maf.gain_error) * lfilter([1.0 - keep], [1.0, -keep], late)
        averages = reading.reshape(events, -1).mean(axis=1)
        unit = 150.0 / pulses.step * T / pulses.reference_charge
        for q in range(3):
            z = shift(theta, q)
            truth = unit * (averages[:, None] * z ** -np.arange(events)[:, None]).sum(axis=0)
            largest = np.abs(found.mode(0)[i]).max()
            np.testing.assert_allclose(found.mode(q)[i], truth, atol=2e-3 * largest)


@pytest.mark.parametrize("speed_rpm", POINTS)
def test_the_flow_shape_is_that_of_the_air(speed_rpm):
    command = POINTS[speed_rpm]
    pulses = nominal_pulses(speed_rpm)
    shape = pulses.flow_shape()
    assert shape.shares.sum() == pytest.approx(1.0, abs=1e-12)
    # A longer duration adds air near the end of the stroke that the valve stays open for: after
    # its middle, and not after the valve has shut, but for what the runner makes of it.
    middle, end = 0.5 * command.duration_deg / 180.0, command.duration_deg / 180.0
    assert middle < shape.centre < end + 0.1
    for parts in (1, 36):
        coarse = pulses.flow_shape(parts)
        assert coarse.parts == parts
        assert coarse.shares.sum() == pytest.approx(1.0, abs=1e-12)
    assert coarse.centre == pytest.approx(shape.centre, abs=0.5 / 36)


@pytest.mark.parametrize("speed_rpm", POINTS)
def test_the_flow_shape_tells_the_nominal_readings(speed_rpm):
    # Charge, flow shape and sensor in closed form against the averages of the crank-resolved
    # flow itself: the measurement model of the air-charge loop.
    pulses = nominal_pulses(speed_rpm)
    T = event_time(speed_rpm, 4)
    maf = MafSensor()
    model = PulseResponse.of_window(
        T, time_constant=maf.time_constant, delay=maf.delay, shape=pulses.flow_shape()
    )
    readings = pulses.responses("maf").nominal
    charge = pulses.responses("air_charge", theta=[0.0]).nominal.mode(0)[0]
    for q in range(3):
        z = shift(readings.theta, q)
        np.testing.assert_allclose(readings.mode(q) / charge, model(z), atol=2e-4)
    assert model(1.0) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("parts", "message"), [(7, "must divide 360"), (0, "from 1 to 360")])
def test_parts_that_do_not_fit_are_refused(pulses, parts, message):
    with pytest.raises(ParameterError, match=message):
        pulses.flow_shape(parts)


@pytest.fixture
def a_plant_that_fails(monkeypatch):
    plant_at = PerturbedPlants.plant_at

    def failing(self, i):
        if len(self) > 1 and i == FAILING:
            raise SimulationError("pressure is gone")
        return plant_at(self, i)

    monkeypatch.setattr(PerturbedPlants, "plant_at", failing)


@pytest.mark.usefixtures("a_plant_that_fails")
def test_a_failure_is_kept_and_told():
    plants = PerturbedPlants(PLANT, draw(ALL, 4, seed=5))
    seen = []
    kept = sampled_pulses(
        plants,
        POINTS[3000.0],
        3000.0,
        keep_going=True,
        progress=lambda done, of: seen.append((done, of)),
    )
    assert list(kept.failures) == [FAILING]
    assert kept.failures[FAILING].startswith("sample 2 ({'flow coefficient': ")
    assert kept.failures[FAILING].endswith("pressure is gone")
    assert kept.pulses[FAILING] is None
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for output in ("air_charge", "maf"):
        found = kept.responses(output)
        lost = np.isnan(found.response).all(axis=(1, 2))
        assert lost.tolist() == [False, False, True, False]
        assert not np.isnan(found.response[~lost]).any()
        assert not np.isnan(found.nominal.response).any()
        assert np.isnan(found.charge).tolist() == lost.tolist()


@pytest.mark.usefixtures("a_plant_that_fails")
def test_the_others_are_as_if_none_had_failed(pulses):
    plants = PerturbedPlants(PLANT, draw(ALL, 4, seed=5))
    kept = sampled_pulses(plants, POINTS[3000.0], 3000.0, keep_going=True)
    others = [0, 1, 3]
    for output in ("air_charge", "maf"):
        found, truth = (p.responses(output).response[others] for p in (kept, pulses))
        np.testing.assert_allclose(found, truth, rtol=1e-12)


@pytest.mark.usefixtures("a_plant_that_fails")
def test_a_failure_is_raised_with_its_number():
    plants = PerturbedPlants(PLANT, draw(ALL, 4, seed=5))
    with pytest.raises(SimulationError, match=r"sample 2 \(\{'flow coefficient'.*pressure is gone"):
        sampled_pulses(plants, POINTS[3000.0], 3000.0)


def test_a_plant_that_does_not_come_to_rest_is_followed_with_finer_steps(monkeypatch):
    # At 6000 rpm one plant in some thousand is held apart for ever at resolution 1.
    plants = PerturbedPlants(PLANT, draw(ALL, 3, seed=5))
    truth = sampled_pulses(plants, POINTS[6000.0], 6000.0)
    original, tried = pulse_sampling.changed_pulse, []

    def restless(operation, *arguments):
        engine, resolution = operation._plant.engine, operation._plant.resolution
        if engine == plants.plant_at(1).engine:
            tried.append(resolution)
            if resolution == 1.0:
                raise ConvergenceError("still felt")
        return original(operation, *arguments)

    monkeypatch.setattr(pulse_sampling, "changed_pulse", restless)
    found = sampled_pulses(plants, POINTS[6000.0], 6000.0)
    assert tried == [1.0, 4.0]
    a, b = (p.responses("air_charge").response for p in (found, truth))
    np.testing.assert_allclose(a, b, rtol=2e-3)  # another step control, the same plant
    assert np.any(a[1] != b[1])


def test_all_plants_may_fail(monkeypatch):
    plant_at = PerturbedPlants.plant_at
    sample = draw(ALL, 2, seed=5)

    def failing(self, i):
        if len(self) > 1:
            raise SimulationError("pressure is gone")
        return plant_at(self, i)

    monkeypatch.setattr(PerturbedPlants, "plant_at", failing)
    kept = sampled_pulses(PerturbedPlants(PLANT, sample), POINTS[3000.0], 3000.0, keep_going=True)
    found = kept.responses("maf")
    assert np.isnan(found.response).all()
    assert not np.isnan(found.nominal.response).any()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_other_numbers_of_cylinders(n):
    engine = Engine.paper().replace(n_cylinders=n)
    plant = CrankAnglePlant(engine)
    plants = PerturbedPlants(plant, Sample(ALL.only(["temperature"]), np.array([[1.0], [1.02]])))
    pulses = sampled_pulses(plants, POINTS[1500.0], 1500.0)
    found = pulses.responses("air_charge")
    assert found.modes == tuple(range(n // 2 + 1))
    step = np.array([-0.5, 0.0, 0.5])
    charge = plant.steady_cycles(1500.0, 3.0, 120.0 + step).air_charge.values.mean(axis=-1)
    truth = (charge[2] - charge[0]) / charge[1] * 120.0
    assert found.nominal.mode(0)[20] == pytest.approx(truth, rel=5e-3)
    # The air that comes in is that which passes the throttle.
    reading = pulses.responses("maf").nominal.mode(0)[20]
    assert reading == pytest.approx(found.nominal.mode(0)[20], rel=1e-3)


def test_readings_need_windows_from_tdc_to_tdc():
    plants = PerturbedPlants(PLANT, nominal_sample(ALL))
    pulses = sampled_pulses(plants, ValveCommand(4.0, 150.0, opening_deg=5.0), 3000.0)
    assert pulses.responses("air_charge").response.shape == (1, 3, 41)
    with pytest.raises(ParameterError, match="opening_deg is 5 deg"):
        pulses.responses("maf")


@pytest.mark.parametrize("output", ["air_charge", "maf"])
def test_half_the_change_gives_the_same_response_but_for_curvature(output):
    # The central difference errs by the third derivative: a fourth of it at half the change.
    errors = []
    for amplitude in (0.04, 0.02):
        pulses = nominal_pulses(1500.0, amplitude=amplitude)
        errors.append(pulses.linearity_error(output))
    assert 0.0 < errors[1] < errors[0] < 0.05
