import itertools
import json

import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, InfeasibleProfileError, ParameterError, ValveCommand
from plant.region import shortest_deg
from uncertainty.delta_result import QUANTITIES
from uncertainty.deltas import ActuatorOscillationDelta, HelmholtzDelta, ParametricDelta
from uncertainty.parameters import UncertainParameter, UncertaintySet

NOTHING = UncertaintySet(())
ENGINE = Engine.paper()
SMALL = {"speeds_rpm": (1500.0, 6000.0), "lifts_mm": (3.0,), "durations_deg": (100.0, 180.0, 260.0)}


@pytest.fixture(scope="module")
def helmholtz():
    return HelmholtzDelta().evaluate(
        speeds_rpm=(1500.0, 6000.0),
        lifts_mm=(3.0, 7.0),
        durations_deg=(60.0, 99.0, 130.0, 150.0, 166.0, 189.0, 280.0, 296.0),
    )


@pytest.fixture(scope="module")
def actuator():
    return ActuatorOscillationDelta().evaluate(**SMALL)


@pytest.fixture(scope="module")
def parametric():
    return ParametricDelta().evaluate(**SMALL)


def charge_and_loss(engine=ENGINE, command=None, speed=6000.0, **options):
    command = ValveCommand(3.0, 180.0) if command is None else command
    cycle = CrankAnglePlant(engine, **options).steady_cycle(speed, command)
    return np.array([cycle.air_charge[0], cycle.pumping_loss[0]])


def told(result, case, speed=6000.0, lift=3.0, duration=180.0):
    data = result.dataset.sel(case=case, speed=speed, lift=lift, duration=duration)
    return [float(data.charge), float(data.loss)]


# -- section 6.1 --------------------------------------------------------------------------------


def test_the_runner_hardly_changes_the_charge_at_1500_rpm(helmholtz):
    # Figure 11 at 3 mm, closing up to BDC (189 deg with seating); a little more at 7 mm.
    change = helmholtz.dataset.charge.sel(case="runner", speed=1500.0, duration=slice(90.0, 189.0))
    assert float(np.abs(change.sel(lift=3.0)).max()) < 0.025
    assert 0.002 < float(np.abs(change).max()) < 0.03


def test_the_runner_lowers_and_raises_the_charge_at_6000_rpm(helmholtz):
    # Figure 12 at 7 mm: early closing (130 deg and 36 deg of seating), and late (260 deg and 36)
    change = helmholtz.dataset.charge.sel(case="runner", speed=6000.0, lift=7.0)
    assert float(change.sel(duration=166.0)) == pytest.approx(-0.25, abs=0.015)
    assert float(change.sel(duration=296.0)) == pytest.approx(0.22, abs=0.015)


def test_changes_are_those_of_two_plants(helmholtz):
    command = ValveCommand(3.0, 150.0)
    off = charge_and_loss(command=command, runner=False)
    on = charge_and_loss(command=command)
    assert told(helmholtz, "runner", duration=150.0) == pytest.approx(on / off - 1.0, rel=1e-9)
    data = helmholtz.dataset.sel(speed=6000.0, lift=3.0, duration=150.0)
    assert float(data.nominal_charge) == pytest.approx(off[0], rel=1e-9)
    assert float(data.nominal_loss) == pytest.approx(off[1], rel=1e-9)


def test_a_corner_is_the_plant_with_all_parameters_at_their_bounds(helmholtz):
    h = ENGINE.helmholtz
    other = ENGINE.replace(
        helmholtz=h.replace(
            low_speed_frequency_hz=0.95 * h.low_speed_frequency_hz,
            high_speed_frequency_hz=0.95 * h.high_speed_frequency_hz,
            low_speed_damping=2.0 * h.low_speed_damping,
            high_speed_damping=2.0 * h.high_speed_damping,
        ),
        runner_constant=1.1 * ENGINE.runner_constant,
        runner_volume=1.05 * ENGINE.runner_volume,
        runner_area=0.95 * ENGINE.runner_area,
    )
    command = ValveCommand(3.0, 150.0)
    change = charge_and_loss(other, command) / charge_and_loss(command=command, runner=False) - 1.0
    case = "runner: low frequency, area; high damping, constant, volume"
    assert told(helmholtz, case, duration=150.0) == pytest.approx(change, rel=1e-8)


def test_constant_and_volume_of_the_runner_act_as_a_product():
    # Eq. 5-6: why the corners move them together
    one = charge_and_loss(ENGINE.replace(runner_constant=1.1 * ENGINE.runner_constant))
    other = charge_and_loss(ENGINE.replace(runner_volume=1.1 * ENGINE.runner_volume))
    assert one == pytest.approx(other, rel=1e-12)


def test_sensitivities_are_slopes_of_charge_and_loss(helmholtz):
    def slopes(runner):
        plant = CrankAnglePlant(runner=runner, resolution=4.0)
        found = []
        for step, commands in (
            (0.5, (ValveCommand(3.0, 150.25), ValveCommand(3.0, 149.75))),
            (0.04, (ValveCommand(3.02, 150.0), ValveCommand(2.98, 150.0))),
        ):
            high, low = (plant.steady_cycle(1500.0, c) for c in commands)
            found.append((high.air_charge[0] - low.air_charge[0]) / step)
            found.append((high.pumping_loss[0] - low.pumping_loss[0]) / step)
        return found

    data = helmholtz.dataset.sel(case="runner", speed=1500.0, lift=3.0, duration=150.0)
    names = ("charge_by_duration", "loss_by_duration", "charge_by_lift", "loss_by_lift")
    floors = (1e-6, 0.01, 1e-5, 0.1)
    for name, floor, off, on in zip(names, floors, slopes(False), slopes(True), strict=True):
        reference = max(abs(off), floor)
        assert float(data[f"nominal_{name}"]) == pytest.approx(off, abs=0.01 * reference)
        assert float(data[name]) == pytest.approx((on - off) / reference, abs=0.02)


def test_infeasible_points_are_nan_and_said_so(helmholtz):
    data = helmholtz.dataset
    # 7 mm needs 3.74 ms: 134.7 deg at 6000 rpm
    assert data.feasible.sel(speed=6000.0, lift=7.0).values.tolist() == [False] * 3 + [True] * 5
    assert (np.isnan(data.charge) == ~data.feasible).all()
    assert data.charge.attrs["units"] == "1"
    assert data.nominal_charge_by_duration.attrs["units"] == "kg/deg"
    assert data.nominal_loss_by_lift.attrs["units"] == "J/mm"
    assert "NaN" in data.attrs["infeasible"]


def test_small_values_are_compared_with_the_floor():
    short = HelmholtzDelta(NOTHING).evaluate(
        speeds_rpm=(1500.0,), lifts_mm=(2.0,), durations_deg=(30.0, 120.0)
    )
    command = ValveCommand(2.0, 30.0)
    off, on = (charge_and_loss(command=command, speed=1500.0, runner=r)[0] for r in (False, True))
    assert short.cases == ("runner",)
    assert abs(off) < 50e-6
    assert float(short.dataset.charge[0, 0, 0, 0]) == pytest.approx((on - off) / 50e-6, rel=1e-9)


def test_the_helmholtz_delta_vanishes_without_runner_volume_effect():
    engine = ENGINE.replace(runner_constant=1e-9)
    result = HelmholtzDelta(NOTHING).evaluate(engine, **SMALL)
    # What is left is the integration error of the kernel, which steps more finely with a runner.
    assert abs(result.worst_charge.value) < 4e-4
    assert abs(result.worst_loss.value) < 2e-3


# -- section 6.2 and the delivered duration -----------------------------------------------------


def test_the_oscillation_vanishes_at_amplitude_zero():
    engine = ENGINE.replace(valvetrain=ENGINE.valvetrain.replace(oscillation_amplitude=0.0))
    delta = ActuatorOscillationDelta(duration=NOTHING, jitter=0.0)
    result = delta.evaluate(engine, **SMALL)
    assert len(result.cases) == 1 + 6 + 8
    assert abs(result.worst_charge.value) < 4e-4
    assert abs(result.worst_loss.value) < 2e-3


def test_the_oscillation_is_small_at_full_load_and_grows_with_speed():
    # Section 6.2 and Figure 14: 7 mm, closing at 180 deg
    delta, changes = ActuatorOscillationDelta(NOTHING, NOTHING, 0.0), []
    for speed in (1500.0, 3000.0, 6000.0):
        result = delta.evaluate(
            speeds_rpm=(speed,), lifts_mm=(7.0,), durations_deg=(180.0 + 6e-3 * speed,)
        )
        assert abs(result.worst_charge.value) < 0.02
        changes.append(max(abs(result.worst_charge.value), abs(result.worst_loss.value)))
    assert changes[0] < changes[2]
    assert changes[0] < 0.002


def test_a_duration_offset_is_a_longer_command(actuator):
    # 0.2 ms are 7.2 deg at 6000 rpm
    longer = ValveCommand(3.0, 187.2)
    nominal = charge_and_loss()
    assert told(actuator, "duration offset high") == pytest.approx(
        charge_and_loss(command=longer) / nominal - 1.0, rel=1e-8
    )
    assert told(actuator, "oscillation + duration offset high") == pytest.approx(
        charge_and_loss(command=longer, oscillation=True) / nominal - 1.0, rel=1e-8
    )


def test_jitter_is_one_event_of_one_valve_in_a_running_engine(actuator):
    # 3 x 0.05 ms are 5.4 deg at 6000 rpm. The steady cycle of the delta against the transient.
    nominal, longer = ValveCommand(3.0, 180.0), ValveCommand(3.0, 185.4)
    run = CrankAnglePlant().start(6000.0, nominal)
    events = [run.step_event(longer if k == 4 else nominal) for k in range(12)]
    charges = [done.air_charge for event in events for done in event.completed]
    changes = np.array(charges) / charge_and_loss()[0] - 1.0
    worst = changes[np.argmax(np.abs(changes))]
    assert abs(worst) > 1e-3
    assert told(actuator, "duration jitter high")[0] == pytest.approx(worst, rel=0.02)


def test_a_valve_that_cannot_be_driven_is_nan_in_its_case_alone():
    # 0.2 ms are 1.8 deg at 1500 rpm, and the lowest lift has 0.1 deg to spare.
    lift = ENGINE.valvetrain.lowest_lift_mm
    duration = float(shortest_deg(lift, 1500.0, ENGINE.valvetrain)) + 0.1
    result = ActuatorOscillationDelta(NOTHING).evaluate(
        speeds_rpm=(1500.0,), lifts_mm=(lift,), durations_deg=(duration, 100.0)
    )
    with pytest.raises(InfeasibleProfileError):
        CrankAnglePlant().steady_cycle(
            1500.0, ValveCommand(lift, duration - 1.8), on_infeasible="limit"
        )
    change = result.dataset.charge.isel(speed=0, lift=0, duration=0)
    assert np.isnan(change.sel(case="duration offset low"))
    assert np.isfinite(change.sel(case="duration offset high"))
    assert np.isfinite(result.lower("charge").isel(speed=0, lift=0, duration=0))


# -- parameters ---------------------------------------------------------------------------------


def scaling(low=0.9, high=1.2):
    """All pressures and flow areas together: charge and loss scale with them."""
    names = ("ambient_pressure", "exhaust_pressure", "flow_coefficient", "throttle.scale")
    return UncertaintySet((UncertainParameter("density", low, high, 1.0, names),))


@pytest.mark.parametrize("options", [{}, {"runner": False}, {"oscillation": True}])
def test_all_quantities_scale_with_pressures_and_areas(options):
    result = ParametricDelta(scaling(), NOTHING, **options).evaluate(**SMALL)
    assert result.cases == ("density low", "density high")
    floors = (50e-6, 1e-6, 1e-5, 0.5, 0.01, 0.1)
    # Accuracy that is claimed: by the plant, and for the central differences by the delta.
    claimed = dict.fromkeys(QUANTITIES, 1.3e-2) | {"charge": 2e-4, "loss": 1e-3}
    for quantity, floor in zip(QUANTITIES, floors, strict=True):
        nominal = result.dataset[f"nominal_{quantity}"]
        share = nominal / np.maximum(np.abs(nominal), floor)  # 1 in magnitude above the floor
        for case, k in (("density low", 0.9), ("density high", 1.2)):
            error = result.dataset[quantity].sel(case=case) - (k - 1.0) * share
            assert float(np.abs(error).max()) < claimed[quantity]
    assert result.highest("charge").value == pytest.approx(0.2, abs=2e-5)
    assert result.lowest("loss").value == pytest.approx(-0.1, abs=2e-5)


def test_a_parameter_at_its_bound_is_the_engine_with_that_parameter(parametric):
    hot = ENGINE.replace(temperature=1.1 * ENGINE.temperature)
    assert told(parametric, "temperature high") == pytest.approx(
        charge_and_loss(hot) / charge_and_loss() - 1.0, rel=1e-8
    )


def test_the_spread_of_cylinders_tells_the_cylinder_concerned(parametric):
    one = ENGINE.replace(cylinder_flow_factors=(0.97, 1.0, 1.0, 1.0))
    nominal = charge_and_loss()
    change = charge_and_loss(one) / nominal - 1.0
    assert change[0] < -0.005
    assert told(parametric, "flow factor 1 low") == pytest.approx(change, rel=1e-8)
    late = [ValveCommand(3.0, 187.2), *[ValveCommand(3.0, 180.0)] * 3]
    assert told(parametric, "duration offset 1 high") == pytest.approx(
        charge_and_loss(command=late) / nominal - 1.0, rel=1e-8
    )


def test_equal_cylinders_are_told_by_the_first_and_unequal_ones_by_each():
    third = UncertaintySet.cylinders(4).only(["flow factor 3"])
    first = UncertaintySet.cylinders(4).only(["flow factor 1"])
    one, other = (
        ParametricDelta(NOTHING, each).evaluate(**SMALL).changes("charge")
        for each in (first, third)
    )
    assert one == pytest.approx(other, rel=1e-7)
    unequal = ENGINE.replace(cylinder_flow_factors=(1.0, 1.02, 0.99, 1.0))
    assert len(ParametricDelta().cases(ENGINE)) == 16 + 4
    assert len(ParametricDelta().cases(unequal)) == 16 + 16


def test_all_parameters_at_once_is_the_worst_corner_of_all():
    # Three parameters: all eight corners by single steady cycles.
    ranges = UncertaintySet.engine().only(["flow coefficient", "temperature", "ambient pressure"])
    grid = {"speeds_rpm": (3000.0,), "lifts_mm": (3.0,), "durations_deg": (120.0,)}
    result = ParametricDelta(ranges, NOTHING).evaluate(**grid)
    command = ValveCommand(3.0, 120.0)
    nominal = charge_and_loss(command=command, speed=3000.0)
    corners = [
        charge_and_loss(
            ENGINE.replace(
                flow_coefficient=flow * ENGINE.flow_coefficient,
                temperature=warm * ENGINE.temperature,
                ambient_pressure=weather * ENGINE.ambient_pressure,
            ),
            command,
            3000.0,
        )
        / nominal
        - 1.0
        for flow, warm, weather in itertools.product((0.85, 1.05), (0.93, 1.1), (0.96, 1.03))
    ]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    for k, quantity in enumerate(("charge", "loss")):
        assert result.lowest(quantity).value == pytest.approx(low[k], rel=1e-8)
        assert result.highest(quantity).value == pytest.approx(high[k], rel=1e-8)
        assert result.lowest(quantity).case == f"all, {quantity} lowest"
        assert result.highest(quantity).case == f"all, {quantity} highest"


def test_deltas_vanish_where_the_bounds_are_points():
    point = UncertaintySet.engine()
    for name in point.names:
        point = point.replace(name, low=1.0, high=1.0)
    result = ParametricDelta(point, NOTHING).evaluate(**SMALL)
    assert all(result.worst(quantity).value == 0.0 for quantity in QUANTITIES)


# -- results ------------------------------------------------------------------------------------


def test_worst_points_envelope_and_sentence_agree(helmholtz):
    data = helmholtz.dataset
    worst = helmholtz.worst_charge
    speed, lift, duration = worst.at
    assert worst.value == float(
        data.charge.sel(case=worst.case, speed=speed, lift=lift, duration=duration)
    )
    assert abs(worst.value) == pytest.approx(float(np.abs(data.charge).max()))
    assert speed == 6000.0
    envelope = helmholtz.over_speed().charge
    low, high = (float(envelope.sel(statistic=s, speed=6000.0)) for s in ("min", "max"))
    assert low == pytest.approx(float(data.charge.min()))
    assert low == helmholtz.lowest("charge").value
    assert f"by {100 * low:+.1f} % to {100 * high:+.1f} %" in helmholtz.sentence()
    assert worst.case in str(helmholtz)
    rms = envelope.sel(statistic="rms")
    assert float(rms.sel(speed=1500.0)) < 0.2 * float(rms.sel(speed=6000.0))


def test_envelopes_bound_every_case_and_touch_one(helmholtz):
    change = helmholtz.dataset.loss
    low, high = helmholtz.lower("loss"), helmholtz.upper("loss")
    feasible = helmholtz.dataset.feasible
    assert ((low <= change) & (change <= high) | ~feasible).all()
    assert ((change == low).any("case") & (change == high).any("case") | ~feasible).all()


def test_a_result_of_one_case_is_that_of_a_delta_with_one_case(helmholtz):
    with pytest.raises(ParameterError, match="no case is named"):
        helmholtz.only()
    grid = {
        f"{dim}s_{unit}": helmholtz.dataset[dim].values
        for dim, unit in (("speed", "rpm"), ("lift", "mm"), ("duration", "deg"))
    }
    alone = HelmholtzDelta(NOTHING).evaluate(**grid)
    np.testing.assert_array_equal(helmholtz.only("runner").changes("loss"), alone.changes("loss"))
    with pytest.raises(ParameterError, match="did you mean 'runner"):
        helmholtz.only("runer")


def test_the_record_is_json_and_names_point_and_case(helmholtz):
    record = json.loads(json.dumps(helmholtz.record()))
    assert record["worst_charge"] == helmholtz.worst_charge.value
    assert record["at"]["speed_rpm"] == 6000.0
    assert set(record["at"]) == {"speed_rpm", "lift_mm", "duration_deg", "case"}
    whole = json.loads(json.dumps(helmholtz.to_dict(), allow_nan=False))
    assert whole["quantities"]["loss"]["highest"]["value"] == helmholtz.highest("loss").value


def test_a_speed_without_feasible_points_is_a_gap_in_the_envelope():
    result = HelmholtzDelta(NOTHING).evaluate(
        speeds_rpm=(1500.0, 6000.0), lifts_mm=(7.0,), durations_deg=(60.0, 100.0)
    )
    envelope = result.over_speed()
    for quantity in QUANTITIES:
        assert np.isfinite(envelope[quantity].sel(speed=1500.0)).all()
        assert np.isnan(envelope[quantity].sel(speed=6000.0)).all()
    assert result.worst_charge.at.speed_rpm == 1500.0


def test_progress_counts_all_plants_and_bad_input_is_refused():
    calls = []
    HelmholtzDelta(NOTHING).evaluate(
        speeds_rpm=(1500.0,),
        lifts_mm=(3.0,),
        durations_deg=(100.0, 180.0),
        progress=lambda *call: calls.append(call),
    )
    # two plants, two points, each with four neighbours
    assert calls[-1] == (20, 20)
    assert calls == sorted(calls)
    with pytest.raises(ParameterError, match="no point of the grid is feasible"):
        HelmholtzDelta().evaluate(speeds_rpm=(6000.0,), lifts_mm=(7.0,), durations_deg=(60.0,))
    with pytest.raises(ParameterError, match=r"speeds_rpm is -100 rpm, but must be .*above 0"):
        HelmholtzDelta().evaluate(speeds_rpm=(-100.0, 1500.0))
    with pytest.raises(ParameterError, match=r"durations_deg is 0 deg, but must be .*above 0"):
        HelmholtzDelta().evaluate(durations_deg=(0.0, 120.0))
    with pytest.raises(ParameterError, match="lifts_mm is"):
        HelmholtzDelta().evaluate(lifts_mm=(3.0, 2.0))
    with pytest.raises(ParameterError, match="lifts_mm is 9 mm"):
        HelmholtzDelta().evaluate(lifts_mm=(3.0, 9.0))
    with pytest.raises(ParameterError, match="shorten durations_deg"):
        ActuatorOscillationDelta().evaluate(
            speeds_rpm=(6000.0,), lifts_mm=(3.0,), durations_deg=(180.0, 359.0)
        )
    with pytest.raises(ParameterError, match="jitter"):
        ActuatorOscillationDelta(jitter=-1e-4)
    with pytest.raises(ParameterError, match="give it uncertain parameters"):
        ParametricDelta(NOTHING, NOTHING).evaluate(**SMALL)


def test_pictures_show_what_is_asked(helmholtz):
    import matplotlib

    matplotlib.use("agg")
    ax = helmholtz.plot()
    labels = " ".join(ax.get_legend_handles_labels()[1])
    assert "air charge" in labels
    assert "pumping loss" in labels
    ax = helmholtz.plot_map("loss", speed_rpm=6000.0, bound="highest")
    shown = np.ma.filled(ax.collections[0].get_array(), np.nan).reshape(2, 8)
    np.testing.assert_allclose(shown, 100.0 * helmholtz.upper("loss").sel(speed=6000.0))
    assert not ax.collections[0].get_rasterized()
    with pytest.raises(ParameterError, match="speed of the grid"):
        helmholtz.plot_map(speed_rpm=1600.0)
    matplotlib.pyplot.close("all")
