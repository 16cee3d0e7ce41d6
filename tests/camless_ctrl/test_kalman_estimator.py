import json
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import stats

from camless_ctrl.cylinder_parameters import CylinderParameters
from camless_ctrl.event_data import EVENTS, PARTS, EventRecord, Measurement, ModelPoint
from camless_ctrl.kalman_estimator import EstimatorState, KalmanEstimator
from plant import Engine
from plant.errors import ParameterError
from plant.lag import first_order_lag
from plant.sampling import CrankSampling
from plant.sensors import MafSensor, MapSensor

ENGINE = Engine.paper()
AREA = ENGINE.throttle.area(90.0)
EDGES = np.linspace(0.0, 2.0, EVENTS * PARTS + 1)


def swell(phase):
    """Share that has flowed in up to a phase of the event: a sine squared over 0.8 events."""
    p = np.clip(np.asarray(phase) / 0.8, 0.0, 1.0)
    return p - np.sin(2.0 * np.pi * p) / (2.0 * np.pi)


SHARES = np.diff(swell(EDGES))


def air_path(charges, length, engine=ENGINE, step=2e-5, ambient=None):
    """Time, throttle flow and manifold pressure of charges that flow by `swell`.

    Implicit Euler steps, each the positive root of a quadratic: not the estimator's scheme.
    """
    ambient = engine.ambient_pressure if ambient is None else ambient
    steps = round(length / step)
    time = length / steps * np.arange(charges.size * steps + 1)
    phase = time / length
    event = np.minimum(phase.astype(int), charges.size - 1)
    drawn = np.concatenate(([0.0], np.cumsum(charges)))[event]
    drawn = drawn + charges[event] * swell(phase - event)
    full = ambient * engine.manifold_volume / (engine.gas_constant * engine.temperature)
    area = AREA * length / steps
    mass = np.empty(time.size)
    mass[0] = full * (1.0 - 1e-9)
    for i in range(time.size - 1):
        base = mass[i] - (drawn[i + 1] - drawn[i])
        # (M - B)^2 K^2 = 4 a^2 M (K - M)
        a, b = full**2 + 4.0 * area**2, -(2.0 * base * full**2 + 4.0 * area**2 * full)
        mass[i + 1] = (-b + math.sqrt(b * b - 4.0 * a * base**2 * full**2)) / (2.0 * a)
    flow = np.diff(mass + drawn, prepend=mass[0]) / (length / steps)
    flow[0] = flow[1]
    return time, flow, ambient * mass / full


def readings(time, signal, lag, delay, period=1e-3):
    """Samples of a lagging sensor without noise."""
    lagged = first_order_lag(time, signal, lag)
    at = period * np.arange(1, int(time[-1] / period))
    return at, np.interp(at - delay, time, lagged)


def records(charges, length, predicted, shares=SHARES, n=4):
    return [
        EventRecord(
            k,
            k % n + 1,
            k * length,
            120.0 / (n * length),
            ModelPoint(3.0, 120.0, predicted[k], False, 1.0, 1.0, shares),
            CylinderParameters(),
            math.nan,
        )
        for k in range(charges.size)
    ]


def run(estimator, events, length, maf, map_, state=None, change=lambda k, m: m):
    """Feed events in order; return their filtered and smoothed estimates and the last state."""
    state = estimator.start() if state is None else state
    filtered, smoothed = {}, {}
    for event in events:
        t = event.start
        inside = [(at > t - length) & (at <= t) for at, _ in (maf, map_)]
        told = Measurement(
            t, event.speed_rpm, maf[0][inside[0]], maf[1][inside[0]],
            map_[0][inside[1]], map_[1][inside[1]],
        )  # fmt: skip
        update = estimator.update(state, change(event.event_index, told))
        state = estimator.commanded(update.state, event)
        for found, into in ((update.filtered, filtered), (update.smoothed, smoothed)):
            if found is not None:
                into[found.event_index] = found
    return filtered, smoothed, state


def scenario(length, m=60, seed=0, spread=0.05, **path):
    random = np.random.default_rng(seed)
    charges = 0.6 * AREA * length * 0.15 * (1.0 + spread * random.normal(size=m))
    time, flow, pressure = air_path(charges, length, **path)
    return charges, readings(time, flow, 0.015, 1e-3), readings(time, pressure, 1e-3, 0.0)


@pytest.mark.parametrize("speed", [750.0, 1500.0, 3000.0, 6000.0])
def test_clean_samples_give_the_charge(speed):
    length = 30.0 / speed
    charges, maf, map_ = scenario(length)
    predicted = charges * (1.0 + 0.1 * np.sin(np.arange(charges.size)))
    estimator = KalmanEstimator.of(ENGINE)
    filtered, smoothed, _ = run(estimator, records(charges, length, predicted), length, maf, map_)
    late = range(20, charges.size - 3)
    assert set(late) <= set(filtered)
    error = np.array([smoothed[k].charge / charges[k] - 1.0 for k in late])
    assert np.max(np.abs(error)) < 3e-3
    assert np.std(error) < 1e-3
    # nothing is lost or counted twice
    total = sum(smoothed[k].charge for k in late) / charges[20:-3].sum() - 1.0
    assert abs(total) < 1e-3


def test_flow_that_is_even_over_the_event():
    # Without a manifold the flow is the charge over the event time: everything has a closed form.
    length, tau = 0.02, 0.015
    charges = np.tile([2.0e-4, 2.4e-4, 1.8e-4, 2.2e-4], 15)
    engine = ENGINE.replace(manifold_volume=1e-7)
    e = math.exp(-length / tau)
    starts = np.empty(charges.size)
    starts[0] = charges[0] / length
    for k in range(charges.size - 1):
        starts[k + 1] = charges[k] / length + (starts[k] - charges[k] / length) * e
    at = 1e-3 * np.arange(1, 20 * charges.size)
    seen = np.maximum(at - 1e-3, 0.0)
    event = np.minimum((seen / length + 1e-9).astype(int), charges.size - 1)
    flow = charges / length
    y = flow[event] + (starts[event] - flow[event]) * np.exp(-(seen - event * length) / tau)
    ratio = 0.5 * (1.0 + np.sqrt(1.0 - (flow / AREA) ** 2))  # Eq. 14
    event = np.minimum((at / length + 1e-9).astype(int), charges.size - 1)
    before = np.maximum(event - 1, 0)
    p = ratio[event] + (ratio[before] - ratio[event]) * np.exp(-(at - event * length) / 1e-3)
    shares = np.concatenate((np.full(PARTS, 1.0 / PARTS), np.zeros(PARTS)))
    predicted = np.full(charges.size, 2.1e-4)
    _, smoothed, state = run(
        KalmanEstimator.of(engine), records(charges, length, predicted, shares), length,
        (at, y), (at, 1e5 * p),
    )  # fmt: skip
    error = [smoothed[k].charge / charges[k] - 1.0 for k in range(20, charges.size - 3)]
    assert np.max(np.abs(error)) < 4e-3
    assert abs(np.mean(error)) < 1e-3
    # The corners of the flow are rounded by half a part, 0.6 ms.
    assert state.x[5] == pytest.approx(tau, abs=6e-4)
    assert state.x[6] == pytest.approx(1e-3, abs=3e-4)


@pytest.mark.parametrize("speed", [750.0, 3000.0, 6000.0])
def test_tangent_against_differences(speed):
    from camless_ctrl import _air_path_kernel as kernel

    length = 30.0 / speed
    charge = 0.6 * AREA * length * 0.15
    x = np.array([charge, 1.2 * charge, 0.015, 0.99e5, 1.03, 0.014, 1.2e-3, 0.8e-3])
    numbers = KalmanEstimator.of(ENGINE)._workspace.numbers
    shares = np.diff(swell(0.7 * EDGES))  # reaches into the next event
    variance = np.ones(2 * kernel.MOST_SAMPLES)

    def predict(x, phase, pressure):
        """Prediction of one sample, and output at the end; their gradients."""
        samples = np.zeros(4 * kernel.MOST_SAMPLES)
        samples[2 * kernel.MOST_SAMPLES if pressure else 0] = length * (1.0 + phase) + (
            0.0 if pressure else 1.2e-3
        )
        n = len(x)
        information, vector, tail = np.zeros((n, n)), np.zeros(n), np.zeros(kernel.CARRY)
        squares, used = kernel.trajectory(
            numbers, 0.0, length, 2.0 * length, charge, shares, shares, shares, charge / length,
            x, x, False, np.eye(n), samples, int(not pressure), int(pressure), variance,
            information, vector, tail,
        )  # fmt: skip
        assert used == 1
        value = math.sqrt(squares)
        return value, -vector / value, tail[0], tail[1 : 1 + n]

    for phase in (0.03, 0.4, 0.77):
        for pressure in (False, True):
            _, h, _, end = predict(x, phase, pressure)
            for i in range(x.size):
                step = 1e-5 * x[i]
                up, down = (
                    predict(x + s * step * np.eye(x.size)[i], phase, pressure) for s in (1, -1)
                )
                slope = (up[0] - down[0]) / (2.0 * step)
                slope_end = (up[2] - down[2]) / (2.0 * step)
                scale = 1e5 if pressure else 0.01
                assert h[i] == pytest.approx(slope, rel=1e-4, abs=1e-6 * scale / x[i])
                assert end[i] == pytest.approx(slope_end, rel=1e-4, abs=1e-8 / x[i])


@pytest.mark.parametrize("speed", [1500.0, 6000.0])
def test_normalised_innovation_is_chi_square(speed):
    # Noise of the assumed strength on clean samples, charges as uncertain as assumed
    length, m = 30.0 / speed, 240
    charges, maf, map_ = scenario(length, m)
    estimator = KalmanEstimator.of(
        ENGINE, flow_error=0.0, drop_error=0.0, part_error=0.0, output_error=0.0, shape_error=0.0,
        charge_spread=0.05,
    )  # fmt: skip
    random = np.random.default_rng(5)
    sigma = np.hypot(0.01 * maf[1], estimator.maf.step / math.sqrt(12.0))
    noisy = maf[0], maf[1] + sigma * random.normal(size=sigma.size)
    sigma_map = math.hypot(100.0, estimator.map.step / math.sqrt(12.0))
    noisy_map = map_[0], map_[1] + sigma_map * random.normal(size=map_[1].size)
    predicted = np.full(m, 0.6 * AREA * length * 0.15)
    filtered, smoothed, _ = run(
        estimator, records(charges, length, predicted), length, noisy, noisy_map
    )
    late = range(20, m - 3)
    squares = sum(filtered[k].innovation for k in late)
    degrees = sum(filtered[k].degrees for k in late)
    low, high = stats.chi2.interval(0.999, degrees)
    assert low < squares < high
    for found in (filtered, smoothed):
        z = np.array([(found[k].charge - charges[k]) / math.sqrt(found[k].variance) for k in late])
        assert np.mean(z**2) == pytest.approx(1.0, abs=0.35)  # neighbours are correlated
    spread = [math.sqrt(smoothed[k].variance) / charges[k] for k in late]
    assert np.mean(spread) < np.mean([math.sqrt(filtered[k].variance) / charges[k] for k in late])


def test_gain_and_offset_of_the_sensors():
    # The level is that of MAF, whatever MAP says; the ratio tells how they differ.
    length = 0.005
    charges, maf, map_ = scenario(length, 200)
    maf, map_ = (maf[0], 1.03 * maf[1]), (map_[0], map_[1] + 1500.0)
    _, smoothed, state = run(
        KalmanEstimator.of(ENGINE), records(charges, length, charges), length, maf, map_
    )
    error = np.array([smoothed[k].charge / charges[k] for k in range(100, 195)])
    assert np.mean(error) == pytest.approx(1.03, abs=2e-3)
    assert np.std(error) < 3e-3
    drop = state.x[3] - 1.015e5, state.x[4] - 1.03
    assert abs(drop[0]) < 300.0
    assert abs(drop[1]) < 0.03


@pytest.mark.parametrize("lag", [0.5e-3, 2e-3])
def test_lag_of_the_pressure_sensor(lag):
    length = 0.005
    charges, maf, _ = scenario(length, 120)
    time, _, pressure = air_path(charges, length)
    map_ = readings(time, pressure, lag, 0.0)
    _, smoothed, state = run(
        KalmanEstimator.of(ENGINE), records(charges, length, charges), length, maf, map_
    )
    assert state.x[7] == pytest.approx(lag, abs=0.15e-3)
    error = [smoothed[k].charge / charges[k] - 1.0 for k in range(40, 115)]
    assert np.max(np.abs(error)) < 3e-3


def test_of_two_delays_an_event_apart_the_one_in_range_is_taken():
    from camless_ctrl import _air_path_kernel as kernel
    from camless_ctrl._estimator_algebra import predict

    n, length = kernel.STATES, 20.0 / 6000.0  # six cylinders at 6000 rpm
    numbers = KalmanEstimator.of(ENGINE)._workspace.numbers
    for delay, taken in (
        (-0.05e-3, -0.05e-3),  # noise
        (-0.5e-3, length - 0.5e-3),
        (-0.22e-3, length - 0.22e-3),  # 0.11 ms beyond the range, instead of 0.22 ms
        (3.2e-3, 3.2e-3 - length),
        (3.05e-3, 3.05e-3),
        (1.5e-3, 1.5e-3),
        (-2e-4 - 0.5 * length, 0.5 * length - 2e-4),
    ):
        x = np.array([2e-4, 2e-4, 0.06, 1e5, 1.0, 0.015, delay, 1e-3])
        prior, P, scratch = np.empty(n), np.empty((n, n)), np.empty((n, n))
        carry = np.zeros(kernel.CARRY)
        predict(numbers, x, np.diag(x**2) * 1e-4, carry, 2e-4, length, prior, P, scratch)
        assert prior[6] == pytest.approx(taken, abs=1e-12)
        assert np.array_equal(P, P.T)


def test_states_compare_by_identity():
    start = KalmanEstimator.of(ENGINE).start()
    assert start == start
    assert start != KalmanEstimator.of(ENGINE).start()
    assert len({start, start}) == 1
    assert "rejections=-1" in repr(start)


def test_wild_samples_are_left_out():
    length = 0.02
    charges, maf, map_ = scenario(length)
    estimator, events = KalmanEstimator.of(ENGINE), records(charges, length, charges)
    _, clean, _ = run(estimator, events, length, maf, map_)

    def spoil(k, told):
        flow, pressure = told.sample_flow.copy(), told.pressure.copy()
        if k % 5 == 0 and k > 10:
            flow[3], flow[7], pressure[5], pressure[6] = 1e6, math.nan, -1e9, math.inf
        return Measurement(
            told.time, told.speed_rpm, told.sample_time, flow, told.pressure_time, pressure
        )

    _, spoilt, _ = run(estimator, events, length, maf, map_, change=spoil)
    late = range(10, charges.size - 3)
    assert set(late) <= set(spoilt)
    assert all(spoilt[k].charge == pytest.approx(clean[k].charge, rel=3e-3) for k in late)


def test_window_without_samples_has_no_estimate_and_the_next_ones_do():
    length = 0.02
    charges, maf, map_ = scenario(length)
    estimator, events = KalmanEstimator.of(ENGINE), records(charges, length, charges)
    empty = np.empty(0)

    def drop(k, told):
        if k in (30, 31):
            return Measurement(told.time, told.speed_rpm, empty, empty, empty, empty)
        return told

    filtered, smoothed, _ = run(estimator, events, length, maf, map_, change=drop)
    assert not {29, 30} & set(filtered)
    assert {28, 32, 33, 34} <= set(filtered)
    for k in range(33, charges.size - 3):
        assert smoothed[k].charge == pytest.approx(charges[k], rel=0.02)
    assert filtered[31].variance > filtered[28].variance


def test_filter_begins_anew_after_a_jump_of_pressure():
    length = 0.01
    charges, maf, map_ = scenario(length, 80)
    pressure = map_[1].copy()
    pressure[map_[0] > 40 * length] -= 20e3  # offset of MAP jumps
    _, smoothed, state = run(
        KalmanEstimator.of(ENGINE), records(charges, length, charges), length, maf,
        (map_[0], pressure),
    )  # fmt: skip
    for k in range(60, 76):
        assert smoothed[k].charge == pytest.approx(charges[k], rel=0.01)
    assert state.x[3] == pytest.approx(80e3, rel=0.02)


@pytest.mark.parametrize("n", range(1, 13))
@pytest.mark.parametrize("speed", [750.0, 6000.0])
def test_any_number_of_cylinders(n, speed):
    length = 120.0 / (n * speed)
    engine = ENGINE.replace(n_cylinders=n)
    charges, maf, map_ = scenario(length, 40, spread=0.02)
    filtered, smoothed, _ = run(
        KalmanEstimator.of(engine), records(charges, length, charges, n=n), length, maf, map_
    )
    late = range(20, 35)
    assert set(late) <= set(filtered)
    for k in late:
        error = abs(smoothed[k].charge - charges[k])
        assert error < 3.0 * math.sqrt(smoothed[k].variance) + 0.01 * charges[k]


def test_latency():
    estimator = KalmanEstimator.of(ENGINE)
    assert estimator.latency_events(0.02) == 2
    assert estimator.latency_events(1e-3) == 2
    late = KalmanEstimator.of(ENGINE, MafSensor(delay=3e-3))
    assert late.latency_events(0.005) == 2
    assert late.latency_events(0.002) == 3


def test_delay_beyond_an_event_is_waited_for():
    length, n = 1.0 / 600.0, 12
    engine = ENGINE.replace(n_cylinders=n)
    charges, _, map_ = scenario(length, 80)
    time, flow, _ = air_path(charges, length)
    maf = readings(time, flow, 0.015, 3e-3)
    filtered, _, _ = run(
        KalmanEstimator.of(engine, MafSensor(delay=3e-3)),
        records(charges, length, charges, n=n), length, maf, map_,
    )  # fmt: skip
    assert set(range(40, 75)) <= set(filtered)
    assert 77 not in filtered


def test_crank_samples():
    length = 0.02
    charges, _, _ = scenario(length)
    time, flow, pressure = air_path(charges, length)
    maf = readings(time, flow, 0.015, 1e-3, period=length / 30)
    map_ = readings(time, pressure, 1e-3, 0.0, period=length / 30)
    estimator = KalmanEstimator.of(ENGINE, MafSensor(sampling=CrankSampling(6.0)))
    _, smoothed, _ = run(estimator, records(charges, length, charges), length, maf, map_)
    for k in range(20, charges.size - 3):
        assert smoothed[k].charge == pytest.approx(charges[k], rel=3e-3)


def test_state_survives_json_and_is_not_changed():
    length = 0.02
    charges, maf, map_ = scenario(length)
    estimator, events = KalmanEstimator.of(ENGINE), records(charges, length, charges)
    _, whole, _ = run(estimator, events, length, maf, map_)
    _, _, state = run(estimator, events[:30], length, maf, map_)
    text = json.dumps(state.to_dict())
    _, first, _ = run(estimator, events[30:], length, maf, map_, state=state)
    assert json.dumps(state.to_dict()) == text
    _, again, _ = run(
        estimator, events[30:], length, maf, map_, state=EstimatorState.from_dict(json.loads(text))
    )
    assert again == first
    assert all(first[k] == whole[k] for k in range(32, 50))


def test_damaged_states_are_refused():
    good = KalmanEstimator.of(ENGINE).start().to_dict()
    with pytest.raises(ParameterError, match="lacks P"):
        EstimatorState.from_dict({k: v for k, v in good.items() if k != "P"})
    with pytest.raises(ParameterError, match="shapes"):
        EstimatorState.from_dict({**good, "x": [1.0]})
    with pytest.raises(ParameterError, match="counts"):
        EstimatorState.from_dict({**good, "samples": [3.0, 0.0, 0.0, 0.0]})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"charge_spread": 0.0}, "charge_spread"),
        ({"lag_spread": -1.0}, "lag_spread"),
        ({"maf": MapSensor()}, "must be a MafSensor"),
        ({"map": MapSensor().ideal()}, "neither noise nor quantisation"),
        ({"window": 1.0}, "no field"),
    ],
)
def test_bad_parameters_are_refused(change, message):
    with pytest.raises(ParameterError, match=message):
        KalmanEstimator.of(ENGINE).replace(**change)


anything = st.floats(allow_nan=True, allow_infinity=True)
plausible = st.floats(-0.01, 0.2)
arrays = st.integers(0, 30).flatmap(
    lambda n: hnp.arrays(np.float64, n, elements=st.one_of(anything, plausible))
)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.one_of(anything, plausible), anything, arrays, arrays, arrays, arrays),
        min_size=1,
        max_size=8,
    ),
    st.booleans(),
)
def test_no_measurement_raises_or_spoils_the_state(garbage, running):
    length = 0.02
    charges = np.full(24, 2e-4)
    estimator, events = KalmanEstimator.of(ENGINE), records(charges, length, charges)
    state = estimator.start()
    if running:
        t = 1e-3 * np.arange(1, 20 * 10)
        flow, pressure = np.full(t.size, 0.01), np.full(t.size, 1e5 - 50.0)
        _, _, state = run(estimator, events[:10], length, (t, flow), (t, pressure))
    for event, (time, speed, *samples) in zip(events[10:], garbage, strict=False):
        update = estimator.update(state, Measurement(time, speed, *samples))
        state = estimator.commanded(update.state, event._replace(start=time))
        for found in (update.filtered, update.smoothed):
            if found is not None:
                assert 0.0 < found.charge < math.inf
                assert 0.0 < found.variance < math.inf
        assert np.all(np.isfinite(state.x))
        assert np.all(np.isfinite(state.P))


def test_importing_loads_neither_compiler_nor_filter():
    code = (
        "import sys, camless_ctrl.kalman_estimator, camless_ctrl.inflow_shares; "
        "print([m for m in ('numba', 'filterpy', 'scipy', 'xarray') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_copy_has_scratch_space_of_its_own():
    estimator = KalmanEstimator.of(Engine.paper())
    copy = pickle.loads(pickle.dumps(estimator))
    assert copy == estimator
    work = copy._workspace
    assert np.shares_memory(work.x, work.out)
    assert not np.shares_memory(work.out, estimator._workspace.out)
