from dataclasses import replace

import control
import matplotlib
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.structured_robustness import analyse_structured
from camless_ctrl.uncertain_loop import UncertainLoop
from camless_ctrl.uncertain_measurement import uncertain_measurement
from plant import CrankAnglePlant, MeanValuePlant, ParameterError

matplotlib.use("agg")


@pytest.fixture(scope="module")
def measurement():
    maps = MeanValuePlant.fit(
        CrankAnglePlant(),
        speed_range_rpm=(1300.0, 1700.0),
        lift_range_mm=(2.5, 3.5),
        tolerance=0.02,
        most_points=800,
    )
    return uncertain_measurement(
        CrankAnglePlant(oscillation=True),
        Feedforward(maps),
        250e-6,
        1500.0,
        share=0.8,
        confidence=0.8,
        design=8,
        fresh=10,
    )


@pytest.fixture(scope="module")
def found(measurement):
    return analyse_structured(UncertainLoop.adaptive(measurement, AdaptationGains(0.4, 0.4)))


def test_the_worst_perturbation_brings_a_pole_to_the_unit_circle(found):
    rs = found.stability
    radii = []
    for factor in (0.98, 1.0, 1.02):
        delta = rs.worst.scaled(factor).realise(rs.worst_frequency, found.loop.system.dt)
        closed = found.loop.perturbed(delta)
        radii.append(float(np.max(np.abs(np.linalg.eigvals(closed.A)))))
    assert radii[0] < 1.0 - 1e-6
    assert radii[1] == pytest.approx(1.0, abs=1e-5)
    assert radii[2] > 1.0 + 1e-6


def test_the_margin_is_proved_and_nearly_reached(found):
    assert found.robustly_stable
    assert found.stability.guaranteed
    assert found.margin == pytest.approx(found.stability.worst.size, rel=0.02)


def test_where_it_breaks_is_a_mode_and_values_of_the_parameters(found, measurement):
    assert found.breaking_mode in (0, 1, 2)
    worst = found.stability.worst
    for name, value in found.breaking_values.items():
        p = measurement.uncertain[name]
        # by hand: the middle of the range and half its width
        by_hand = 0.5 * (p.low + p.high) + 0.5 * worst[name] * (p.high - p.low)
        assert value == pytest.approx(by_hand)
    assert f"q={found.breaking_mode}" in str(found)


def test_nominal_peak_is_that_of_the_closed_loop(found):
    closed = found.loop.perturbed({})
    omega = np.linspace(1e-3, np.pi, 4000) / found.loop.measurement.event_time
    response = np.asarray(closed(np.exp(1j * omega * float(closed.dt))))
    peak = found.loop.sensitivity_bound * np.abs(response).max()
    assert found.nominal_peak == pytest.approx(float(peak), rel=1e-3)
    low, high = found.worst_sensitivity
    assert found.nominal_peak < low <= high * (1.0 + 1e-9)


def test_sampled_loops_stay_within_the_worst_case(found):
    rng = np.random.default_rng(0)
    omega = np.linspace(1e-3, np.pi, 400) / found.loop.measurement.event_time
    names = list(found.loop.measurement.directions)
    _, high = found.worst_sensitivity
    for signs in rng.choice([-1.0, 1.0], (20, len(names) + 1)):
        delta = dict(zip([*names, "remainder"], signs.tolist(), strict=True))
        closed = found.loop.perturbed(delta)
        assert np.all(np.abs(np.linalg.eigvals(closed.A)) < 1.0)
        response = np.asarray(closed(np.exp(1j * omega * float(closed.dt))))
        assert found.loop.sensitivity_bound * np.abs(response).max() <= high * (1.0 + 1e-6)


def test_an_unstable_loop_withstands_nothing(measurement):
    broken = analyse_structured(UncertainLoop.adaptive(measurement, AdaptationGains(2.5, 2.5)))
    assert not broken.stable
    assert broken.margin == 0.0
    assert "nothing is withstood" in str(broken)
    assert np.isnan(broken.record()["rs_upper"])
    with pytest.raises(ParameterError, match="no worst disturbance"):
        broken.worst_disturbance()
    with pytest.raises(ParameterError, match="not stable"):
        broken.withstood_alone("MAF delay")


def test_one_block_alone_is_withstood_farther_and_its_break_is_on_the_circle(found):
    alone = found.withstood_alone("MAF delay")
    assert alone.guaranteed
    assert "MAF delay" not in alone.held
    assert len(alone.held) == len(found.loop.structure) - 1
    # All else within its ranges, so the delay alone is taken farther than all together.
    assert alone.margin > found.margin > 1.0
    delta = alone.worst
    assert abs(delta["MAF delay"]) == pytest.approx(alone.margin, rel=0.06)
    assert all(abs(delta[name]) <= 1.0 + 1e-9 for name in alone.held)
    realised = delta.realise(alone.worst_frequency, found.loop.system.dt)
    poles = np.linalg.eigvals(found.loop.perturbed(realised).A)
    assert np.max(np.abs(poles)) == pytest.approx(1.0, abs=1e-5)
    with pytest.raises(ParameterError, match="block is 'delay'"):
        found.withstood_alone("delay")


def test_the_worst_disturbance_is_amplified_as_the_worst_case_says(found):
    cycles = 400
    disturbance = found.worst_disturbance(cycles).ravel()
    assert np.abs(disturbance).max() <= 1.0
    worst = found.worst_gain.worst_system()
    error = np.squeeze(control.forced_response(worst, U=disturbance).outputs)
    settled = found.loop.sensitivity_bound * error[error.size // 2 :]
    low, _ = found.worst_sensitivity
    # A sine: its mean square is half the square of its amplitude.
    rms = np.sqrt(np.mean(settled**2) / np.mean(disturbance[error.size // 2 :] ** 2))
    assert rms == pytest.approx(low, rel=0.02)
    assert found.amplified_mode in (0, 1, 2)


def test_without_proof_nothing_is_called_robust(found):
    unproved = replace(found, stability=replace(found.stability, guaranteed=False))
    assert unproved.stability.robust is True  # on the frequencies
    assert not unproved.robustly_stable
    assert "NOT proved robustly stable" in str(unproved)


def test_plots_and_record(found):
    record = found.record()
    assert {"rs_upper", "rs_lower", "rp_upper", "rp_lower", "frequency"} <= record.keys()
    assert record["worst_case_gain"]["bound"] == 2.0
    labels = found.plot().get_legend_handles_labels()[1]
    assert labels[:2] == ["robust stability", "robust performance"]
    assert len(found.plot_step(5).axes[0].lines) == 3  # with the zero line
    matplotlib.pyplot.close("all")
