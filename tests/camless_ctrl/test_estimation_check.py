import functools
import math

import numpy as np
import pytest

from camless_ctrl.estimation_check import EstimationPoint, check_estimator
from camless_ctrl.kalman_estimator import KalmanEstimator
from plant import CrankAnglePlant, Engine
from plant.errors import ParameterError
from plant.sampling import TimeSampling
from plant.sensors import MafSensor, MapSensor, SensorSet

# One weak cylinder, the others within 5 %
FACTORS = {3: (1.03, 0.85, 0.97), 4: (1.03, 0.85, 0.96, 1.05), 6: (1.03, 0.85, 0.96, 1.05, 1, 0.98)}
POINTS = {
    750: EstimationPoint(750.0, 2.0, 75.0),
    1500: EstimationPoint(1500.0, 3.0, 115.0),
    3000: EstimationPoint(3000.0, 6.0, 155.0),
    6000: EstimationPoint(6000.0, 7.5, 190.0),
}
CYCLES = {750: 40, 1500: 50, 3000: 80, 6000: 160}


def checked(n, speed, sensors=None, engine=None, **options):
    engine = Engine.paper().replace(n_cylinders=n) if engine is None else engine
    plant = CrankAnglePlant(engine.replace(cylinder_flow_factors=FACTORS[n]), oscillation=True)
    # The estimator is made for the nominal engine, whatever the plant is.
    estimator = KalmanEstimator.of(Engine.paper().replace(n_cylinders=n))
    options = {"cycles": CYCLES[speed], "sensors": sensors, **options}
    return check_estimator(estimator, plant, [POINTS[speed]], **options)


nominal = functools.cache(checked)


@pytest.mark.parametrize("speed", POINTS)
@pytest.mark.parametrize("n", FACTORS)
def test_charge_of_each_cylinder_on_the_full_plant(n, speed):
    result = nominal(n, speed).results[0]
    assert result.missing == 0
    # a single event; expected of the noise of the sensors and the lag
    most = {750: 0.005, 1500: 0.008, 3000: 0.013, 6000: 0.026}[speed]
    assert result.spread < most
    # averaged over the run; six cylinders at 6000 rpm overlap, and are told apart less well
    bound = 0.008 if (n, speed) == (6, 6000) else 0.005
    assert np.max(np.abs(result.cylinder_errors)) < bound
    assert abs(result.bias) < 0.004
    # honest: neither far below nor above what the filter says of itself
    assert 0.5 < result.consistency < 1.2
    assert 0.7 < result.innovation_ratio < 1.3


def test_shares_of_equal_cylinders_do_at_low_speed():
    result = checked(4, 3000, known_gains=False).results[0]
    assert np.max(np.abs(result.cylinder_errors)) < 0.005


def test_shares_of_equal_cylinders_cost_a_percent_at_6000_rpm():
    result = checked(4, 6000, known_gains=False).results[0]
    weak = result.cylinder_errors[1]
    assert 0.004 < weak < 0.012
    assert weak == np.max(result.cylinder_errors)


@pytest.mark.parametrize("speed", [1500, 6000])
def test_gain_error_is_all_that_is_left_of_wrong_sensors(speed):
    sensors = SensorSet(maf=MafSensor(gain_error=0.03), map=MapSensor(offset=-1500.0))
    check = checked(4, speed, sensors)
    result = check.results[0]
    assert result.gain_error == 0.03
    assert np.max(np.abs(result.cylinder_errors)) < 0.005
    raw = np.mean(result.smoothed / result.charge) - 1.0
    assert raw == pytest.approx(0.03, abs=0.003)
    assert "MAF gain error of +3.0 %" in str(check)


@pytest.mark.parametrize(
    "maf",
    [
        MafSensor(time_constant=0.010),
        MafSensor(time_constant=0.020),
        MafSensor(delay=0.0),
        MafSensor(time_constant=0.020, delay=3e-3),
    ],
)
@pytest.mark.parametrize("speed", [1500, 6000])
def test_wrong_lag_and_delay_are_learnt(maf, speed):
    result = checked(4, speed, SensorSet(maf=maf)).results[0]
    assert result.missing == 0
    assert np.max(np.abs(result.cylinder_errors)) < 0.006
    assert result.consistency < 1.2


@pytest.mark.parametrize("map_lag", [0.5e-3, 2e-3])
def test_lag_of_the_pressure_sensor_is_learnt(map_lag):
    # The dips of the pressure, 5 kPa at 6000 rpm, would contradict a wrong one.
    result = checked(4, 6000, SensorSet(map=MapSensor(time_constant=map_lag))).results[0]
    assert result.missing == 0
    assert np.max(np.abs(result.cylinder_errors)) < 0.006
    assert 0.7 < result.innovation_ratio < 1.3


@pytest.mark.parametrize(
    ("point", "lag", "delay", "map_lag", "first"),
    [
        (EstimationPoint(3000.0, 8.0, 130.0), 10.30e-3, 2.97e-3, 1.83e-3, 0.82e-3),
        (EstimationPoint(3000.0, 8.0, 130.0), 10.16e-3, 2.88e-3, 1.91e-3, 0.26e-3),
        (EstimationPoint(3000.0, 6.0, 155.0), 10.54e-3, 2.99e-3, 1.37e-3, 0.89e-3),
        (EstimationPoint(4500.0, 8.0, 190.0), 20.00e-3, 3.00e-3, 0.50e-3, 0.0),
        (EstimationPoint(6000.0, 8.0, 190.0), 13.80e-3, 1.70e-3, 1.00e-3, 0.3e-3),
    ],
)
def test_cold_start_with_sensors_at_the_edge_of_their_range(point, lag, delay, map_lag, first):
    # Samples without noise hold nothing but the plant and the sensors: no window may be refused.
    phase = TimeSampling(first=first)
    sensors = SensorSet(
        maf=MafSensor(time_constant=lag, delay=delay, sampling=phase).ideal(),
        map=MapSensor(time_constant=map_lag, sampling=phase).ideal(),
    )
    engine = Engine.paper().replace(
        temperature=273.4, ambient_pressure=0.96e5, cylinder_flow_factors=(0.885,) * 4
    )
    bias = -0.1 if point.lift_mm == 6.0 else 0.0
    check = check_estimator(
        KalmanEstimator.of(Engine.paper()), CrankAnglePlant(engine, oscillation=True), [point],
        sensors=sensors, cycles=14, variation=0.0, step=1.0, prediction_bias=bias,
        prediction_spread=0.0,
    )  # fmt: skip
    result = check.results[0]
    assert result.missing == 0
    late = result.error.reshape(-1, 4)[6:]
    assert np.max(np.abs(late)) < 0.01


@pytest.mark.parametrize("delay", [0.0, 1e-3, 3e-3])
def test_every_sample_counts_once(delay):
    # Samples fall on the edges of the windows: the learnt delay, which moves by microseconds,
    # places them now in one window and now in the next.
    sensors = SensorSet(maf=MafSensor(delay=delay).ideal(), map=MapSensor().ideal())
    still = {"variation": 0.0, "step": 1.0, "prediction_bias": 0.0, "prediction_spread": 0.0}
    result = checked(4, 6000, sensors, cycles=60, **still).results[0]
    # a period of 1 ms, an event of 5 ms, two sensors
    assert abs(result.degrees.sum() - 10 * result.degrees.size) <= 2
    late = result.error.reshape(-1, 4)[30:]
    assert np.max(np.ptp(late, axis=0)) < 3e-4


def test_altitude_and_warm_air():
    # Tables of the nominal engine: the shares are a little off as well.
    engine = Engine.paper().replace(ambient_pressure=0.75e5, exhaust_pressure=0.85e5)
    result = checked(4, 3000, engine=engine.replace(temperature=320.0)).results[0]
    assert result.missing == 0
    assert np.max(np.abs(result.cylinder_errors)) < 0.01


def test_nothing_is_lost_over_a_long_run():
    clean = SensorSet(
        maf=MafSensor().ideal().replace(bits=None), map=MapSensor().ideal().replace(bits=None)
    )
    for speed in (1500, 3000):
        result = checked(4, speed, clean).results[0]
        total = result.smoothed.sum() / result.charge.sum() - 1.0
        assert abs(total) < 1e-3


def test_finer_traces_change_nothing():
    coarse, fine = (
        checked(4, 3000, cycles=20, trace_step_deg=step).results[0] for step in (0.5, 0.2)
    )
    assert fine.bias == pytest.approx(coarse.bias, abs=5e-4)


def test_results_print_plot_and_label():
    check = nominal(4, 1500)
    lines = str(check).splitlines()
    assert len(lines) == 2
    assert lines[1].split()[:2] == ["4", "1500"]
    data = check.to_dataset()
    assert data["bias"].attrs["units"] == "1"
    assert data["cylinder_error"].shape == (1, 4)
    assert float(data["spread"][0]) == check.results[0].spread
    assert check.worst_cylinder_error == np.max(np.abs(check.results[0].cylinder_errors))
    ax = check.plot()
    assert ax.get_xlabel() == "speed (rpm)"
    low, high = check.results[0].innovation_interval()
    assert low < 1.0 < high


def test_a_run_without_estimates_says_so():
    # a MAF sensor that shows nothing but its lowest value
    dead = SensorSet(maf=MafSensor(lowest=5.0, highest=6.0))
    result = checked(4, 1500, dead, cycles=8).results[0]
    assert result.missing == result.charge.size
    assert math.isnan(result.bias)
    assert math.isnan(result.innovation_ratio)
    assert str(result.missing) in str(result)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cycles": 2}, "cycles"),
        ({"variation": -0.1}, "variation"),
        ({"step": 2.0}, "step"),
        ({"known_gains": 1}, "known_gains"),
    ],
)
def test_bad_arguments_are_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        checked(4, 1500, **options)


def test_other_numbers_of_cylinders_are_refused():
    with pytest.raises(ParameterError, match="made for 4 cylinders"):
        check_estimator(
            KalmanEstimator.of(Engine.paper()),
            CrankAnglePlant(Engine.paper().replace(n_cylinders=3)),
            [POINTS[1500]],
        )
