import matplotlib
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.mu import lft
from camless_ctrl.structured_robustness import analyse_structured
from camless_ctrl.uncertain_loop import UncertainLoop
from camless_ctrl.uncertain_measurement import uncertain_measurement
from plant import CrankAnglePlant, MeanValuePlant

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
        closed = lft(found.loop.system, delta)
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


def test_plots_and_record(found):
    record = found.record()
    assert {"rs_upper", "rs_lower", "rp_upper", "rp_lower", "frequency"} <= record.keys()
    assert record["worst_case_gain"]["bound"] == 2.0
    labels = found.plot().get_legend_handles_labels()[1]
    assert labels[:2] == ["robust stability", "robust performance"]
    assert len(found.plot_step(5).axes[0].lines) == 3  # with the zero line
    matplotlib.pyplot.close("all")
