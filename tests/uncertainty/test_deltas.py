import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand
from uncertainty.deltas import ActuatorOscillationDelta, HelmholtzDelta


@pytest.fixture(scope="module")
def helmholtz():
    return HelmholtzDelta().evaluate(
        speeds_rpm=(1500.0, 6000.0),
        lifts_mm=(3.0, 7.0),
        durations_deg=(60.0, 99.0, 130.0, 150.0, 166.0, 189.0, 280.0, 296.0),
    )


def test_the_runner_hardly_changes_the_charge_at_1500_rpm(helmholtz):
    # Figure 11 at 3 mm, closing up to BDC (189 deg with seating); a little more at 7 mm.
    change = helmholtz.dataset.charge.sel(speed=1500.0, duration=slice(90.0, 189.0))
    assert float(np.abs(change.sel(lift=3.0)).max()) < 0.025
    assert 0.002 < float(np.abs(change).max()) < 0.03


def test_the_runner_lowers_and_raises_the_charge_at_6000_rpm(helmholtz):
    # Figure 12 at 7 mm: early closing (130 deg and 36 deg of seating), and late (260 deg and 36)
    change = helmholtz.dataset.charge.sel(speed=6000.0, lift=7.0)
    assert float(change.sel(duration=166.0)) == pytest.approx(-0.25, abs=0.015)
    assert float(change.sel(duration=296.0)) == pytest.approx(0.22, abs=0.015)


def test_changes_are_those_of_two_plants(helmholtz):
    command = ValveCommand(3.0, 150.0)
    off = CrankAnglePlant(runner=False).steady_cycle(6000.0, command)
    on = CrankAnglePlant().steady_cycle(6000.0, command)
    data = helmholtz.dataset.sel(speed=6000.0, lift=3.0, duration=150.0)
    assert float(data.charge) == pytest.approx(on.air_charge[0] / off.air_charge[0] - 1.0, rel=1e-9)
    assert float(data.loss) == pytest.approx(on.pumping_loss[0] / off.pumping_loss[0] - 1, rel=1e-9)
    assert float(data.nominal_charge) == pytest.approx(off.air_charge[0], rel=1e-9)


def test_sensitivity_is_the_slope_of_the_charge(helmholtz):
    slopes = []
    for runner in (False, True):
        plant = CrankAnglePlant(runner=runner)
        before, after = (
            plant.steady_cycle(1500.0, ValveCommand(3.0, d)).air_charge[0] for d in (147.0, 153.0)
        )
        slopes.append((after - before) / 6.0)
    data = helmholtz.dataset.sel(speed=1500.0, lift=3.0, duration=150.0)
    assert float(data.nominal_sensitivity) == pytest.approx(slopes[0], rel=0.02)
    assert float(data.sensitivity) == pytest.approx(slopes[1] / slopes[0] - 1.0, abs=0.03)


def test_infeasible_points_are_nan_and_said_so(helmholtz):
    data = helmholtz.dataset
    # 7 mm needs 3.74 ms: 134.7 deg at 6000 rpm
    assert data.feasible.sel(speed=6000.0, lift=7.0).values.tolist() == [False] * 3 + [True] * 5
    assert (np.isnan(data.charge) == ~data.feasible).all()
    assert data.charge.attrs["units"] == "1"
    assert data.nominal_sensitivity.attrs["units"] == "kg/deg"
    assert "NaN" in data.attrs["infeasible"]


def test_small_values_are_compared_with_the_floor():
    short = HelmholtzDelta().evaluate(
        speeds_rpm=(1500.0,), lifts_mm=(2.0,), durations_deg=(30.0, 120.0)
    )
    command = ValveCommand(2.0, 30.0)
    off, on = (
        CrankAnglePlant(runner=runner).steady_cycle(1500.0, command).air_charge[0]
        for runner in (False, True)
    )
    assert abs(off) < 50e-6
    assert float(short.dataset.charge[0, 0, 0]) == pytest.approx((on - off) / 50e-6, rel=1e-9)


def test_worst_points_envelope_and_sentence_agree(helmholtz):
    data = helmholtz.dataset
    worst = helmholtz.worst_charge
    speed, lift, duration = worst.at
    assert worst.value == float(data.charge.sel(speed=speed, lift=lift, duration=duration))
    assert abs(worst.value) == pytest.approx(float(np.abs(data.charge).max()))
    assert speed == 6000.0
    envelope = helmholtz.over_speed().charge
    low, high = (float(envelope.sel(statistic=s, speed=6000.0)) for s in ("min", "max"))
    assert low == pytest.approx(float(data.charge.min()))
    assert f"by {100 * low:+.1f} % to {100 * high:+.1f} %" in helmholtz.sentence()
    assert "6000 rpm" in str(helmholtz)
    rms = envelope.sel(statistic="rms")
    assert float(rms.sel(speed=1500.0)) < 0.2 * float(rms.sel(speed=6000.0))


def test_a_speed_without_feasible_points_is_a_gap_in_the_envelope():
    result = HelmholtzDelta().evaluate(
        speeds_rpm=(1500.0, 6000.0), lifts_mm=(7.0,), durations_deg=(60.0, 100.0)
    )
    envelope = result.over_speed()
    for quantity in ("charge", "loss", "sensitivity"):
        assert np.isfinite(envelope[quantity].sel(speed=1500.0)).all()
        assert np.isnan(envelope[quantity].sel(speed=6000.0)).all()
    assert result.worst_charge.at.speed_rpm == 1500.0


def test_the_helmholtz_delta_vanishes_without_runner_volume_effect():
    engine = Engine.paper().replace(runner_constant=1e-9)
    result = HelmholtzDelta().evaluate(
        engine, speeds_rpm=(3000.0, 6000.0), lifts_mm=(3.0,), durations_deg=(100.0, 180.0, 260.0)
    )
    # What is left is the integration error of the kernel, which steps more finely with a runner.
    assert abs(result.worst_charge.value) < 4e-4
    assert abs(result.worst_loss.value) < 2e-3


def test_the_oscillation_delta_vanishes_at_amplitude_zero():
    engine = Engine.paper()
    engine = engine.replace(valvetrain=engine.valvetrain.replace(oscillation_amplitude=0.0))
    result = ActuatorOscillationDelta().evaluate(
        engine, speeds_rpm=(3000.0, 6000.0), lifts_mm=(3.0,), durations_deg=(100.0, 180.0, 260.0)
    )
    assert abs(result.worst_charge.value) < 4e-4
    assert abs(result.worst_loss.value) < 2e-3


def test_the_oscillation_is_small_at_full_load_and_grows_with_speed():
    # Section 6.2 and Figure 14: 7 mm, closing at 180 deg
    changes = []
    for speed in (1500.0, 3000.0, 6000.0):
        result = ActuatorOscillationDelta().evaluate(
            speeds_rpm=(speed,), lifts_mm=(7.0,), durations_deg=(180.0 + 6e-3 * speed,)
        )
        assert abs(result.worst_charge.value) < 0.02
        changes.append(max(abs(result.worst_charge.value), abs(result.worst_loss.value)))
    assert changes[0] < changes[2]
    assert changes[0] < 0.002


def test_progress_counts_both_plants_and_bad_grids_are_refused():
    calls = []
    HelmholtzDelta().evaluate(
        speeds_rpm=(1500.0,),
        lifts_mm=(3.0,),
        durations_deg=(100.0, 180.0),
        progress=lambda *call: calls.append(call),
    )
    assert calls[-1] == (12, 12)
    with pytest.raises(ParameterError, match="no point of the grid is feasible"):
        HelmholtzDelta().evaluate(speeds_rpm=(6000.0,), lifts_mm=(7.0,), durations_deg=(60.0,))
    with pytest.raises(ParameterError, match="lifts_mm is"):
        HelmholtzDelta().evaluate(lifts_mm=(3.0, 2.0))


def test_plot_shows_charge_and_loss(helmholtz):
    import matplotlib

    matplotlib.use("agg")
    ax = helmholtz.plot()
    labels = " ".join(ax.get_legend_handles_labels()[1])
    assert "air charge" in labels
    assert "pumping loss" in labels
    matplotlib.pyplot.close(ax.figure)
