import numpy as np
import pytest
from scipy import stats

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant.lag import first_order_lag
from plant.sampling import CrankSampling, TimeSampling
from plant.sensors import DurationSensor, MafSensor, MapSensor, SensorSet

WIDE = {"lowest": -10.0, "highest": 10.0}


def ideal_maf(**changes):
    return MafSensor().ideal().replace(**{**WIDE, **changes})


@pytest.fixture(scope="module")
def cycle():
    plant = CrankAnglePlant()
    return plant.steady_cycle(speed_rpm=1500, command=ValveCommand(3.0, 120.0))


def test_step_response_is_exponential_and_late_by_the_delay():
    # the signal jumps from 0 to 1 at 10.3 ms, between two samples
    tau, delay, jump = 0.015, 0.001, 0.0103
    sensor = ideal_maf(time_constant=tau, delay=delay)
    samples = sensor.start(seed=0).measure([0.0, jump, jump, 0.2], [0.0, 0.0, 1.0, 1.0])
    since = samples.time - delay - jump
    expected = np.where(since > 0.0, 1.0 - np.exp(-np.maximum(since, 0.0) / tau), 0.0)
    np.testing.assert_allclose(samples.value, expected, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(samples.time, 1e-3 * np.arange(201), rtol=0.0, atol=1e-15)


def test_ramp_lags_by_the_time_constant_whatever_the_points():
    # tau y' = t - y, y(0) = 0: y = t - tau (1 - exp(-t/tau))
    tau = 0.015
    uneven = np.sort(np.random.default_rng(1).uniform(0.0, 0.1, 37))
    time = np.concatenate(([0.0], uneven, [0.1]))
    expected = time - tau * (1.0 - np.exp(-time / tau))
    np.testing.assert_allclose(first_order_lag(time, time, tau), expected, atol=1e-15)


def test_pure_delay_shifts_the_signal_exactly():
    time = np.linspace(0.0, 0.05, 23)
    signal = np.sin(200.0 * time)
    samples = ideal_maf(time_constant=0.0, delay=2.7e-3).start(0).measure(time, signal)
    expected = np.interp(samples.time - 2.7e-3, time, signal)
    np.testing.assert_allclose(samples.value, expected, rtol=0.0, atol=1e-14)


def test_sine_is_attenuated_and_turned_as_the_transfer_function_says():
    # H(iw) = exp(-iw delay)/(1 + iw tau), at 12.5 Hz: once per cycle at 1500 rpm
    w, tau, delay = 2.0 * np.pi * 12.5, 0.015, 1e-3
    time = np.arange(0.0, 0.48, 2e-5)
    samples = ideal_maf(time_constant=tau, delay=delay).start(0).measure(time, np.cos(w * time))
    late = samples.time > 0.3999
    h = 1.0 / (1.0 + 1j * w * tau) * np.exp(-1j * w * delay)
    expected = np.real(h * np.exp(1j * w * samples.time[late]))
    np.testing.assert_allclose(samples.value[late], expected, rtol=0.0, atol=2e-6)


@pytest.mark.parametrize(
    "sampling", [TimeSampling(), TimeSampling(1.7e-3, 4e-4), CrankSampling(7.0)]
)
@pytest.mark.parametrize("seed", [0, 1])
def test_samples_do_not_depend_on_how_the_signal_is_cut(sampling, seed):
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(5e-5, 3e-4, 700))
    angle = np.cumsum(np.diff(time, prepend=0.0) * random.uniform(4e3, 4e4, 700))  # speed varies
    signal = 0.03 + 0.02 * np.sin(300.0 * time) + 0.002 * random.standard_normal(700)
    sensor = MafSensor(sampling=sampling)
    whole = sensor.start(5).measure(time, signal, angle)
    run = sensor.start(5)
    cuts = np.sort(random.choice(np.arange(1, 700), 25, replace=False))
    pieces = [
        run.measure(t, u, a)
        for t, u, a in zip(*(np.split(x, cuts) for x in (time, signal, angle)), strict=True)
    ]
    assert min(len(p) for p in pieces) < 3 < max(len(p) for p in pieces)
    for name in ("time", "value", "crank_angle_deg", "saturated"):
        joined = np.concatenate([getattr(p, name) for p in pieces])
        np.testing.assert_allclose(joined, getattr(whole, name), rtol=1e-12)


def test_one_point_at_a_time_is_the_same_as_all_at_once():
    time = np.arange(100) * 4e-4
    signal = np.cos(500.0 * time)
    sensor = ideal_maf()
    whole = sensor.start(0).measure(time, signal)
    run = sensor.start(0)
    single = [run.measure(time[[i]], signal[[i]]) for i in range(100)]
    np.testing.assert_allclose(np.concatenate([s.value for s in single]), whole.value, rtol=1e-12)


def test_lag_agrees_with_a_general_solver_on_a_plant_signal(cycle):
    from scipy.integrate import solve_ivp

    trace, tau = cycle.trace, 0.015
    time, flow = trace.time[:360], trace.throttle_flow[:360]
    solution = solve_ivp(
        lambda t, y: (np.interp(t, time, flow) - y) / tau,
        (0.0, time[-1]),
        [flow[0]],
        t_eval=time,
        rtol=1e-9,
        atol=1e-13,
        max_step=time[1] / 4,
    )
    np.testing.assert_allclose(first_order_lag(time, flow, tau), solution.y[0], rtol=0.0, atol=1e-9)


def test_noise_is_white_with_the_stated_deviation():
    # 99.9 % confidence, fixed seed. Constant signal: what varies is noise.
    k = 20000
    sensor = MafSensor(bits=None, gain_error=0.0)
    noise = sensor.start(11).measure([0.0, (k - 0.5) * 1e-3], [0.04, 0.04]).value - 0.04
    assert noise.size == k
    sigma = 0.01 * 0.04
    low, high = stats.chi2.ppf([0.0005, 0.9995], k - 1)
    assert low < (k - 1) * np.var(noise, ddof=1) / sigma**2 < high
    z = stats.norm.ppf(0.9995)
    assert abs(noise.mean()) < z * sigma / np.sqrt(k)
    # autocorrelation at 20 lags, bound shared among them
    z20 = stats.norm.ppf(1.0 - 0.0005 / 20)
    for lag in range(1, 21):
        r = np.sum(noise[lag:] * noise[:-lag]) / np.sum(noise**2)
        assert abs(r) < z20 / np.sqrt(k)
    assert stats.kstest(noise / sigma, "norm").pvalue > 0.001


def test_map_noise_is_absolute():
    samples = MapSensor(bits=None).start(3).measure([0.0, 9.9995], [50e3, 50e3])
    low, high = stats.chi2.ppf([0.0005, 0.9995], len(samples) - 1)
    assert len(samples) == 10000
    assert low < (len(samples) - 1) * np.var(samples.value, ddof=1) / 100.0**2 < high


def test_noise_follows_the_seed():
    points = [0.0, 0.1], [0.03, 0.03]
    same = [MafSensor().start(s).measure(*points).value for s in (4, 4, 5)]
    np.testing.assert_array_equal(same[0], same[1])
    assert np.any(same[0] != same[2])


def test_twelve_bits_give_even_levels_and_half_a_step_of_error():
    sensor = ideal_maf(bits=12, time_constant=0.0, delay=0.0, lowest=-0.05, highest=0.15)
    assert sensor.step == pytest.approx(0.2 / 4095)
    time = np.linspace(0.0, 2.0, 2001)
    signal = -0.05 + 0.1 * time
    samples = sensor.start(0).measure(time, signal)
    code = (samples.value + 0.05) / sensor.step
    np.testing.assert_allclose(code, np.round(code), atol=1e-8)
    error = samples.value - np.interp(samples.time, time, signal)
    assert np.abs(error).max() <= 0.5 * sensor.step * (1.0 + 1e-9)
    assert np.abs(error).max() > 0.45 * sensor.step
    assert samples.value[0] == pytest.approx(-0.05)
    assert samples.value[-1] == pytest.approx(0.15)


def test_readings_outside_the_range_are_limited_and_told():
    sensor = MapSensor(time_constant=0.0, noise=0.0)
    samples = sensor.start(0).measure([0.0, 0.01], [110e3, 130e3])
    np.testing.assert_array_equal(samples.saturated, samples.time > 0.005 + 1e-9)
    assert np.all(samples.value[samples.saturated] == 120e3)
    assert "5 saturated" in str(samples)


def test_gain_and_offset():
    time = [0.0, 0.1]
    flow = ideal_maf(gain_error=0.03).start(0).measure(time, [0.05, 0.05])
    np.testing.assert_allclose(flow.value, 0.0515, rtol=1e-12)
    pressure = MapSensor(noise=0.0, bits=None, offset=1500.0).start(0).measure(time, [9e4, 9e4])
    np.testing.assert_allclose(pressure.value, 91.5e3, rtol=1e-12)


def test_nominal_sensors_have_no_bias_and_worst_ones_the_assumed_tolerances():
    assert MafSensor().gain_error == MafSensor().offset == MapSensor().offset == 0.0
    assert MafSensor.worst(-1).gain_error == -0.03
    assert (MafSensor.worst().time_constant, MafSensor.worst().delay) == (0.020, 0.003)
    assert MapSensor.worst().offset == 1500.0


def test_crank_synchronous_samples_lie_at_their_angles_through_a_change_of_speed():
    sensor = ideal_maf(time_constant=0.0, delay=0.0, sampling=CrankSampling(30.0, first_deg=10.0))
    run = sensor.start(0)
    # the signal is the crank angle itself: 1500 rpm for 180 deg, then 3000 rpm
    first, second = np.arange(0.0, 180.0), np.arange(180.0, 540.0)
    t1 = first / 9000.0
    t2 = 0.02 + (second - 180.0) / 18000.0
    a = run.measure(t1, first / 100.0, first)
    b = run.measure(t2, second / 100.0, second)
    angles = np.concatenate((a.crank_angle_deg, b.crank_angle_deg))
    np.testing.assert_allclose(angles, 10.0 + 30.0 * np.arange(18))
    np.testing.assert_allclose(100.0 * np.concatenate((a.value, b.value)), angles)
    expected = np.where(angles < 180.0, angles / 9000.0, 0.02 + (angles - 180.0) / 18000.0)
    np.testing.assert_allclose(np.concatenate((a.time, b.time)), expected, rtol=1e-12)


@pytest.mark.parametrize("sampling", [TimeSampling(5e-4), CrankSampling(5.0)])
def test_event_average_of_a_periodic_flow_is_the_mass_per_event(sampling):
    # 80 ms and four events a cycle; the lag leaves so little above half the sampling rate that
    # the mean of the samples is the integral. The fine plant has a trace that integrates well.
    plant = CrankAnglePlant(resolution=8.0)
    cycle = plant.steady_cycle(speed_rpm=1500, command=ValveCommand(3.0, 120.0))
    trace = cycle.trace_at(0.25)
    run = ideal_maf(sampling=sampling).start(0)
    for _ in range(6):  # 32 time constants: settled
        samples = run.observe(trace)
    assert len(samples) == (160 if isinstance(sampling, TimeSampling) else 144)
    per_event = cycle.throttle_mass / 4
    assert samples.mean * 0.02 == pytest.approx(per_event, rel=1e-4)
    quarter = len(samples) // 4
    np.testing.assert_allclose(
        samples.value.reshape(4, quarter).mean(axis=1) * 0.02, per_event, rtol=1e-4
    )


def test_windows_of_a_run_join_to_one_signal_through_speed_changes():
    plant = CrankAnglePlant()
    command = ValveCommand(3.0, 120.0)
    run = plant.start(1500, command)
    sensors = SensorSet().replace(maf=ideal_maf(), map=MapSensor().ideal()).start(0)
    time, flow, values, clock = [], [], [], 0.0
    for speed in (1500.0, 1500.0, 2100.0, 2700.0, 2000.0, 1300.0):
        result = run.step_event(command, speed_rpm=speed, trace_step_deg=2.0)
        time.append(clock + result.trace.time)
        flow.append(result.trace.throttle_flow)
        clock += result.duration
        values.append(sensors.observe(result.trace).maf)
    whole = ideal_maf().start(0).measure(np.concatenate(time), np.concatenate(flow))
    joined = np.concatenate([v.value for v in values])
    np.testing.assert_allclose(joined, whole.value, rtol=1e-9)
    assert sensors.maf.state.clock == pytest.approx(clock, rel=1e-12)


def test_a_kept_state_takes_a_run_back(cycle):
    run = MafSensor().start(8)
    run.observe(cycle.trace)
    kept, twin = run.state, run.copy()
    first = run.observe(cycle.trace)
    again = twin.observe(cycle.trace)
    run.state = kept
    third = run.observe(cycle.trace)
    np.testing.assert_array_equal(first.value, again.value)
    np.testing.assert_array_equal(first.value, third.value)
    assert first.time[0] == third.time[0] > 0.07


def test_duration_error_is_one_of_time():
    # 0.05 ms are 0.45 deg at 1500 rpm and 1.8 deg at 6000 rpm
    run = DurationSensor().start(2)
    k = 4000
    low, high = stats.chi2.ppf([0.0005, 0.9995], k)
    for speed, sigma_deg in ((1500.0, 0.45), (6000.0, 1.8)):
        samples = run.measure(np.full(k, 150.0), speed)
        error = samples.duration_deg - 150.0
        assert low < np.sum(error**2) / sigma_deg**2 < high
        np.testing.assert_allclose(samples.duration, samples.duration_deg / (6.0 * speed))
    exact = DurationSensor(noise=0.0, offset=1e-4).start(0).measure(90.0, 1500.0)
    assert float(exact.duration) == pytest.approx(0.0101)
    assert "10.100 ms (90.90 deg)" in str(exact)


def test_duration_state_is_kept_too():
    run = DurationSensor().start(2)
    twin, kept = run.copy(), run.state
    values = [float(run.measure(90.0, 1500.0).duration)]
    values.append(float(twin.measure(90.0, 1500.0).duration))
    run.state = kept
    values.append(float(run.measure(90.0, 1500.0).duration))
    assert values[0] == values[1] == values[2] != 0.01


def test_sensor_set_draws_independent_noise_and_can_be_copied(cycle):
    run = SensorSet().start(1)
    twin = run.copy()
    seen, again = run.observe(cycle.trace), twin.observe(cycle.trace)
    np.testing.assert_array_equal(seen.maf.value, again.maf.value)
    np.testing.assert_array_equal(seen.map.value, again.map.value)
    steady = SensorSet(MafSensor(bits=None, **WIDE), MapSensor(bits=None)).start(1)
    k = 2000
    points = [0.0, (k - 0.5) * 1e-3]
    maf = steady.maf.measure(points, [0.05, 0.05]).value
    map_ = steady.map.measure(points, [1e5, 1e5]).value
    assert abs(np.corrcoef(maf, map_)[0, 1]) < stats.norm.ppf(0.9995) / np.sqrt(k)
    assert "air mass flow" in str(seen)
    assert "manifold pressure" in str(seen)


def test_samples_can_be_plotted():
    import matplotlib

    matplotlib.use("Agg")
    samples = MapSensor().start(0).measure([0.0, 0.01], [110e3, 130e3])
    ax = samples.plot()
    assert ax.get_ylabel() == "manifold pressure (Pa)"
    assert len(ax.lines) == 2  # samples, and those that are saturated
    matplotlib.pyplot.close(ax.figure)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_constant": -1.0}, "time_constant is -1 s"),
        ({"delay": float("nan")}, "delay is nan s"),
        ({"gain_error": -1.0}, "gain_error is -1"),
        ({"bits": 0}, "bits is 0.*None leaves quantisation out"),
        ({"highest": -1.0}, "highest is -1 kg/s, but must be above lowest = -0.05"),
        ({"relative_noise": -0.1}, "relative_noise is -0.1"),
        ({"sampling": 1e-3}, "sampling is 0.001"),
        ({"time_const": 1e-3}, "did you mean 'time_constant'"),
    ],
)
def test_bad_parameters_are_refused(change, message):
    with pytest.raises(ParameterError, match=message):
        MafSensor().replace(**change)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (([0.0, 1.0], [1.0]), "one-dimensional"),
        (([], []), "not empty"),
        (([0.0, 2.0, 1.0], [1.0, 1.0, 1.0]), "time falls from 2 to 1 s at point 2"),
        (([0.0, 1.0], [1.0, np.nan]), "point 1 .* signal nan"),
        (([0.0, np.inf], [1.0, 1.0]), "finite"),
    ],
)
def test_bad_signals_are_refused(points, message):
    with pytest.raises(ParameterError, match=message):
        MafSensor().start(0).measure(*points)


def test_windows_out_of_order_are_refused_and_change_nothing():
    run = MafSensor().start(0)
    run.measure([0.0, 0.01], [0.05, 0.05])
    twin = run.copy()
    with pytest.raises(ParameterError, match=r"time starts at 0.005 s, .* up to 0.01 s"):
        run.measure([0.005, 0.02], [0.05, 0.05])
    after = [r.measure([0.01, 0.02], [0.05, 0.05]).value for r in (run, twin)]
    np.testing.assert_array_equal(*after)


def test_crank_sampling_needs_crank_angle():
    run = MafSensor(sampling=CrankSampling(30.0)).start(0)
    with pytest.raises(ParameterError, match="crank_angle_deg is missing"):
        run.measure([0.0, 0.01], [0.05, 0.05])
    with pytest.raises(ParameterError, match="step_deg is 0 deg"):
        CrankSampling(0.0)
    mixed = MafSensor().start(0)
    mixed.measure([0.0, 0.01], [0.05, 0.05])
    with pytest.raises(ParameterError, match="for some windows only"):
        mixed.measure([0.02], [0.05], [180.0])


def test_single_point_trace_and_empty_mean_are_refused(cycle):
    with pytest.raises(ParameterError, match="has 1 point"):
        MafSensor().start(0).observe(
            CrankAnglePlant()
            .start(1500, ValveCommand(3.0, 120.0))
            .step_event(ValveCommand(3.0, 120.0), trace_step_deg=180.0)
            .trace
        )
    with pytest.raises(ParameterError, match="no sample"):
        _ = MafSensor().start(0).measure([1e-4, 2e-4], [0.05, 0.05]).mean


def test_bad_durations_and_signs_are_refused():
    run = DurationSensor().start(0)
    with pytest.raises(ParameterError, match="duration_deg is -1 deg"):
        run.measure(-1.0, 1500.0)
    with pytest.raises(ParameterError, match="speed_rpm is 0 rpm"):
        run.measure(90.0, 0.0)
    with pytest.raises(ParameterError, match="noise is -1 s"):
        DurationSensor(noise=-1.0)
    with pytest.raises(ParameterError, match="sign is 2"):
        MafSensor.worst(2)
