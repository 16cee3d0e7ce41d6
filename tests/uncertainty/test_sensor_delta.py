import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand
from plant.air_path import FlowShape
from uncertainty.deltas import SensorDelta
from uncertainty.parameters import UncertaintySet

SENSORS = UncertaintySet.sensors()
SPEEDS = (750.0, 1500.0, 3000.0, 6000.0)


@pytest.fixture(scope="module")
def result():
    return SensorDelta().evaluate(
        speeds_rpm=(1500.0, 6000.0), lifts_mm=(3.0,), durations_deg=(120.0, 180.0, 260.0)
    )


def bounds(name, **changes):
    """The set with one uncertain parameter, all others known."""
    kept = UncertaintySet.sensors().replace(name, **changes)
    for other in kept.names:
        if other != name:
            kept = kept.replace(other, low=kept[other].nominal, high=kept[other].nominal)
    return kept


def test_the_gain_error_changes_the_indicated_charge_and_nothing_of_the_loss(result):
    data = result.dataset
    for case, gain in (("MAF gain error low", -0.03), ("MAF gain error high", 0.03)):
        assert (data.nominal_charge > 50e-6).all()
        assert data.charge.sel(case=case).values == pytest.approx(gain, rel=1e-12)
        # 3 % of the sensitivities, which are negative where a longer duration gives less
        nominal = data.nominal_charge_by_duration
        assert (np.abs(nominal) > 1e-6).any()
        expected = gain * nominal / np.maximum(np.abs(nominal), 1e-6)
        assert data.charge_by_duration.sel(case=case).values == pytest.approx(expected.values)
        for quantity in ("loss", "loss_by_duration", "loss_by_lift"):
            assert (data[quantity].sel(case=case) == 0.0).all()


def test_the_pressure_offset_is_another_ambient_pressure(result):
    engine, command = Engine.paper(), ValveCommand(3.0, 120.0)
    other = engine.replace(ambient_pressure=engine.ambient_pressure + 1500.0)
    before, after = (CrankAnglePlant(e).steady_cycle(1500.0, command) for e in (engine, other))
    at = result.dataset.sel(case="MAP offset high", speed=1500.0, lift=3.0, duration=120.0)
    assert float(at.charge) == pytest.approx(after.air_charge[0] / before.air_charge[0] - 1.0)
    assert float(at.loss) == pytest.approx(after.pumping_loss[0] / before.pumping_loss[0] - 1.0)
    assert float(at.charge) > 0.01


def test_lag_and_delay_change_nothing_in_a_steady_mean(result):
    cases = [f"MAF {what} {end}" for what in ("time constant", "delay") for end in ("low", "high")]
    assert (result.dataset.charge.sel(case=cases) == 0.0).all()
    assert (result.dataset.loss.sel(case=cases) == 0.0).all()


# -- frequency response -------------------------------------------------------------------------

OMEGA = np.geomspace(1.0, 3000.0, 50)


def test_a_pure_delay_leaves_twice_the_sine_of_half_its_angle():
    delta = SensorDelta()
    error = delta.relative_response(OMEGA, delay=1e-3 + 2e-3)
    assert np.abs(error) == pytest.approx(np.abs(2.0 * np.sin(OMEGA * 2e-3 / 2.0)))


def test_a_lag_that_is_not_known_of_leaves_the_textbook_error():
    delta = SensorDelta(bounds("MAF time constant", low=0.0, high=0.02, nominal=0.0))
    s = 1j * OMEGA
    expected = -0.02 * s / (1.0 + 0.02 * s)
    assert delta.relative_response(OMEGA, time_constant=0.02) == pytest.approx(expected)
    # The error grows with the lag: the bound is that of the longest.
    assert delta.response_bound(OMEGA) == pytest.approx(np.abs(expected))


def test_the_nominal_sensor_has_no_error_and_a_gain_error_is_itself():
    delta = SensorDelta()
    assert np.abs(delta.relative_response(OMEGA)) == pytest.approx(0.0)
    assert delta.relative_response(OMEGA, gain_error=-0.03) == pytest.approx(-0.03)


def test_the_bound_of_a_delay_is_that_of_the_longest_and_at_most_two():
    delta = SensorDelta(bounds("MAF delay", low=0.0, high=2e-3, nominal=0.0))
    angle = np.minimum(OMEGA * 2e-3, np.pi)
    bound = delta.response_bound(OMEGA, points=401)
    assert bound == pytest.approx(2.0 * np.sin(angle / 2.0), rel=1e-3)


def test_the_bound_holds_for_random_sensors():
    delta, random = SensorDelta(), np.random.default_rng(3)
    bound = delta.response_bound(OMEGA, points=41)
    for tau, d, g in random.uniform((0.01, 0.0, -0.03), (0.02, 3e-3, 0.03), (300, 3)):
        error = np.abs(delta.relative_response(OMEGA, time_constant=tau, delay=d, gain_error=g))
        assert (error <= bound * (1.0 + 1e-3)).all()
    assert bound[0] == pytest.approx(0.03, rel=0.05)  # at low frequency only the gain is left


def test_impossible_sensors_are_refused():
    with pytest.raises(ParameterError, match="time_constant"):
        SensorDelta().relative_response(OMEGA, time_constant=-0.01)
    with pytest.raises(ParameterError, match="points"):
        SensorDelta().response_bound(OMEGA, points=1)


# -- modes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "gain_1", "phase_1", "gain_2"),
    [(750, 0.71, -27, 0.35), (1500, 0.52, -48, 0.13), (3000, 0.31, -66, 0.035),
     (6000, 0.16, -77, 0.009)],
)  # fmt: skip
def test_what_a_lag_of_15_ms_leaves_of_the_modes(speed, gain_1, phase_1, gain_2):
    # Computed independently for four cylinders, charge spread evenly over its event, no delay.
    delta = SensorDelta(bounds("MAF delay", low=0.0, high=0.0, nominal=0.0))
    data = delta.mode_changes(speed).dataset
    assert float(data.nominal_gain.sel(mode=0)) == pytest.approx(1.0)
    assert float(data.nominal_gain.sel(mode=1)) == pytest.approx(gain_1, abs=0.006)
    assert float(data.nominal_phase_deg.sel(mode=1)) == pytest.approx(phase_1, abs=0.6)
    assert float(data.nominal_gain.sel(mode=2)) == pytest.approx(gain_2, rel=0.06)


def test_a_wrong_lag_is_harmless_for_the_first_mode():
    # 10 or 20 instead of 15 ms: gain 0.76 to 1.46 over all speeds, phase at most 12 deg
    delta = SensorDelta(bounds("MAF time constant", low=0.010, high=0.020))
    gains, phases = [], []
    for speed in SPEEDS:
        changes = delta.mode_changes(speed)
        gains += changes.gain_range(1)
        phases += changes.phase_range_deg(1)
    assert min(gains) == pytest.approx(0.76, abs=0.005)
    assert max(gains) == pytest.approx(1.46, abs=0.005)
    assert max(np.abs(phases)) == pytest.approx(12.0, abs=0.5)


@pytest.mark.parametrize(
    ("speed", "phases"),
    [(750, (-3, -8, -13)), (1500, (-5, -16, -27)), (3000, (-11, -31, -47)),
     (6000, (-21, -54, -90))],
)  # fmt: skip
def test_a_delay_that_is_not_known_of_turns_the_first_mode(speed, phases):
    for delay, phase in zip((1e-3, 3e-3, 5e-3), phases, strict=True):
        delta = SensorDelta(bounds("MAF delay", low=0.0, high=delay, nominal=0.0))
        low, high = delta.mode_changes(speed).phase_range_deg(1)
        assert low == pytest.approx(phase, abs=0.7)
        assert high == 0.0


@pytest.mark.parametrize(
    ("speed", "delay", "flips"),
    [(1500, 1e-3, False), (3000, 1e-3, True), (6000, 1e-3, True), (1500, 3e-3, True)],
)
def test_a_delay_turns_the_sign_of_the_alternating_mode(speed, delay, flips):
    delta = SensorDelta(bounds("MAF delay", low=0.0, high=delay, nominal=0.0))
    low, high = delta.mode_changes(speed).phase_range_deg(2)
    assert (max(-low, high) > 90.0) is flips


def test_the_mean_is_changed_by_the_gain_alone_and_the_words_say_so():
    changes = SensorDelta().mode_changes(3000.0, 6)
    assert changes.dataset["mode"].values.tolist() == [0, 1, 2, 3]
    assert changes.gain_range(0) == pytest.approx((0.97, 1.03))
    assert changes.phase_range_deg(0) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert "mode 0 to 0.97 to 1.03" in str(changes)


def test_a_shorter_pulse_of_flow_leaves_more_of_the_alternating_mode():
    delta = SensorDelta(bounds("MAF delay", low=0.0, high=0.0, nominal=0.0))
    even, short = (
        float(delta.mode_changes(1500.0, shape=shape).dataset.nominal_gain.sel(mode=2))
        for shape in (None, FlowShape(np.array([0.8, 0.2]), 2))
    )
    assert short > even
