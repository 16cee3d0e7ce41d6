import dataclasses

import control
import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand, published_point
from plant.throttled import ThrottledMeanValuePlant, throttle_step

PLANT = CrankAnglePlant(profile="conventional")
ENGINE = PLANT.engine
CAM = ValveCommand.conventional()
GAS = ENGINE.gas_constant * ENGINE.temperature


@pytest.fixture(scope="module")
def throttled():
    return ThrottledMeanValuePlant.fit(PLANT)


def full(throttle_deg, speed_rpm):
    """Mean pressure, charge and loss of the full plant's steady cycle."""
    cycle = PLANT.steady_cycle(speed_rpm, CAM, float(throttle_deg))
    pressure = cycle.trace_at(0.5).manifold_pressure.mean()
    return pressure, cycle.air_charge.mean(), cycle.pumping_loss.mean()


def eq_15(throttle_deg, pressure):
    """Throttle flow, written down a second time from Eq. 13, 14, 15 and 19."""
    area = 1.268e-4 * (-0.2215 - 2.275 * throttle_deg + 0.23 * throttle_deg**2)
    x = np.asarray(pressure) / 1e5
    return area * np.where(x <= 0.5, 1.0, 2.0 * np.sqrt(np.maximum(x - x**2, 0.0)))


def events_per_second(speed_rpm):
    return ENGINE.n_cylinders * speed_rpm / 120.0


# -- charge and loss -----------------------------------------------------------------------------


@pytest.mark.parametrize("point_id", ["cam-1500", "cam-3000", "cam-4000"])
def test_wide_open_it_gives_the_published_charges_and_losses(throttled, point_id):
    point = published_point(point_id)
    pressure = throttled.steady_pressure(90.0, point.speed_rpm)
    charge = 1e6 * throttled.air_charge(pressure, point.speed_rpm)
    assert charge == pytest.approx(point.charge_mg, rel=0.02)
    loss = throttled.pumping_loss(pressure, point.speed_rpm)
    assert loss == pytest.approx(point.loss_J, rel=0.03)


def test_the_throttled_case_of_figure_5(throttled):
    # Printed are 17 deg and 13.8 J; Eq. 19 passes this charge at about 22.8 deg only.
    found = throttled.throttle_for_charge(171e-6, 1500.0)
    assert found.reachable
    assert found.throttle_deg == pytest.approx(22.8, abs=0.1)
    assert found.pumping_loss == pytest.approx(15.2, rel=0.01)
    assert "171.00 mg at 22.79 deg" in str(found)
    pressure, charge, loss = full(found.throttle_deg, 1500.0)
    assert charge == pytest.approx(171e-6, rel=1e-3)
    assert loss == pytest.approx(found.pumping_loss, rel=2e-3)
    assert pressure == pytest.approx(found.manifold_pressure, rel=1e-3)


def test_error_between_nodes(throttled):
    error = throttled.error_against(PLANT, samples=300, seed=7)
    assert error.same_plant
    assert error.charge_rms <= 0.001
    assert error.charge_max <= 0.005
    assert error.loss_rms <= 0.001
    assert error.loss_max <= 0.005
    assert error.pressure_rms <= 0.0005
    assert "300 random points" in str(error)


def test_error_sees_a_plant_that_was_not_fitted(throttled):
    other = CrankAnglePlant(profile="conventional", runner=False)
    error = throttled.error_against(other, samples=40, seed=0)
    assert not error.same_plant
    assert error.charge_max > 0.05
    with pytest.raises(ParameterError, match="must be 'conventional'"):
        throttled.error_against(CrankAnglePlant())


def test_slow_charge_grows_with_pressure_as_the_trapped_volume_says(throttled):
    # Ideal gas at manifold pressure, in a volume between that at which the cam has shut the valve
    # quite (46 deg after BDC) and the largest one: it is nearly shut before.
    shut = ENGINE.displaced_volume / 2.0 * (1.0 - np.cos(np.radians(226.0)))
    for speed in (750.0, 1000.0):
        charge = throttled.air_charge([25e3, 45e3], speed)
        volume = GAS * (charge[1] - charge[0]) / 20e3 - ENGINE.clearance_volume
        assert shut < volume < ENGINE.displaced_volume


# -- steady state --------------------------------------------------------------------------------


def test_in_steady_state_throttle_and_cylinders_pass_the_same_flow(throttled):
    angle, speed = np.meshgrid(
        [12.0, 16.0, 21.0, 30.0, 45.0, 90.0], [800.0, 1500.0, 2700.0, 6000.0]
    )
    pressure = throttled.steady_pressure(angle, speed)
    for p, a, n in zip(pressure.ravel(), angle.ravel(), speed.ravel(), strict=True):
        truth, charge, _ = full(a, n)
        assert p == pytest.approx(truth, rel=2e-3)
        flow = charge * events_per_second(n)  # of the full plant
        flows = throttled.flows(p, a, n)
        assert float(flows.throttle) == pytest.approx(flow, rel=0.01)
        assert abs(float(flows.throttle) - float(flows.cylinder)) < 1e-9
        # Pulsation lowers the mean of a concave function; where the flow is choked it cannot.
        assert float(flows.throttle) <= eq_15(a, p) * (1.0 + 1e-3)
        if truth < 0.45 * ENGINE.ambient_pressure:
            assert float(flows.throttle) == pytest.approx(float(eq_15(a, p)), rel=1e-4)


def test_pulsation_near_wide_open_matters(throttled):
    # At 750 rpm and wide open Eq. 15 at the mean pressure passes a sixth too much.
    pressure, charge, _ = full(90.0, 750.0)
    excess = eq_15(90.0, pressure) / (charge * events_per_second(750.0))
    assert excess > 1.1
    assert throttled.flow_factor[0, -1] == pytest.approx(1.0 / excess, rel=1e-3)


def test_a_steady_run_stays_where_it_is(throttled):
    for angle in (15.0, 33.0, 90.0):
        run = throttled.simulate([0.0, 0.5, 2.0], angle, 1300.0)
        assert np.ptp(run.manifold_pressure) < 1.0
        assert run.identified.all()


# -- dynamics ------------------------------------------------------------------------------------


def test_mass_is_conserved_in_the_manifold(throttled):
    t = np.linspace(0.0, 0.4, 8001)
    time = np.concatenate([t, 0.4 + t])
    throttle = np.concatenate([np.linspace(18.0, 70.0, t.size), np.full(t.size, 18.0)])
    run = throttled.simulate(time, throttle, np.linspace(1200.0, 4000.0, time.size))
    stored = ENGINE.manifold_volume * (run.manifold_pressure - run.manifold_pressure[0]) / GAS
    net = run.throttle_flow - run.cylinder_flow
    steps = 0.5 * (net[1:] + net[:-1]) * np.diff(time)
    balance = np.concatenate([[0.0], np.cumsum(steps)])
    # Against what the manifold holds, kg; the rest is the trapezoidal rule's.
    assert np.max(np.abs(balance - stored)) < 1e-4 * np.max(stored)


def test_throttle_flow_is_constant_while_choked(throttled):
    pressure = np.linspace(16e3, 45e3, 30)
    flow = throttled.flows(pressure, 25.0, 2000.0).throttle
    np.testing.assert_allclose(flow, eq_15(25.0, 0.0), rtol=1e-4)


def test_choked_filling_is_the_closed_form(throttled):
    # Constant inflow and a charge that is linear in pressure: an exponential approach with time
    # constant (V_m + V_s)/(R T) / (n N/120 dm/dp). The charge is taken from the full plant, the
    # storage from the geometry: the mean volume of the cylinders that are open.
    speed, low, high = 1000.0, 15.0, 16.5
    (p_0, m_0, _), (p_1, m_1, _) = full(low, speed), full(high, speed)
    angle = np.radians(np.linspace(-8.0, 226.0, 20001))
    volume = ENGINE.displaced_volume / 2.0 * (1.0 - np.cos(angle)) + ENGINE.clearance_volume
    open_volume = volume.mean() * 234.0 / ENGINE.event_angle_deg
    slope = (m_1 - m_0) / (p_1 - p_0) * events_per_second(speed)
    time = np.linspace(0.0, 0.3, 61)
    run = throttled.simulate(time, high, speed, initial_pressure=p_0)
    for extra, tolerance in ((open_volume, 0.035), (0.8 * open_volume, 0.01)):
        constant = (ENGINE.manifold_volume + extra) / GAS / slope
        expected = p_1 + (p_0 - p_1) * np.exp(-time / constant)
        assert np.max(np.abs(run.manifold_pressure - expected)) < tolerance * (p_1 - p_0)


def test_open_cylinders_store_less_when_the_valves_throttle(throttled):
    geometric = 3.49e-4  # m3, mean volume of the open cylinders
    storage = throttled.storage_volume
    slow, fast = storage[0], storage[-1]
    assert np.all((slow > 0.75 * geometric) & (slow < 1.02 * geometric))
    assert fast[-1] < 0.3 * geometric
    assert np.all(storage > 0.0)


@pytest.mark.parametrize("speed", [1000.0, 1500.0, 3000.0, 5000.0])
@pytest.mark.parametrize("angles", [(20.0, 40.0, 20.0), (25.0, 90.0, 25.0)])
def test_throttle_steps_follow_the_full_plant(throttled, speed, angles):
    step = throttle_step(PLANT, throttled, throttles_deg=angles, speed_rpm=speed)
    assert step.rms_each.max() <= 0.02
    assert step.rms == pytest.approx(np.sqrt(np.mean(step.rms_each**2)))
    assert step.worst <= 0.06
    assert abs(step.error[[step.events - 1, -1]]).max() < 2e-3
    assert f"at {speed:g} rpm" in str(step)
    assert step.full_pressure.size == step.time.size == 48


def test_without_the_air_in_the_open_cylinders_a_step_is_too_fast(throttled):
    bare = dataclasses.replace(throttled, storage_volume=np.zeros_like(throttled.storage_volume))
    step = throttle_step(PLANT, bare, throttles_deg=(20.0, 40.0, 20.0), speed_rpm=1500.0)
    assert step.rms_each.max() > 0.03
    assert step.error[0] > 0.05  # rises too fast
    assert step.error[step.events + 1] < -0.05  # and falls too fast


def test_the_nonlinear_system_runs_like_the_simulation(throttled):
    system = throttled.as_nonlinear_system()
    assert system.input_labels == ["throttle_deg", "speed_rpm"]
    assert system.state_labels == ["manifold_pressure"]
    assert system.output_labels == [
        "manifold_pressure",
        "throttle_flow",
        "cylinder_flow",
        "air_charge",
    ]
    assert system.isctime(strict=True)
    start = float(throttled.steady_pressure(20.0, 1500.0))
    time = np.linspace(0.0, 0.3, 61)
    inputs = np.vstack([np.linspace(20.0, 45.0, 61), np.linspace(1500.0, 2500.0, 61)])
    response = control.input_output_response(
        system, time, inputs, [start], solve_ivp_kwargs={"rtol": 1e-8}
    )
    run = throttled.simulate(time, *inputs)
    for k, name in enumerate(system.output_labels):
        np.testing.assert_allclose(response.outputs[k], getattr(run, name), rtol=1e-5)
    with pytest.raises(ParameterError, match="speed_rpm is 300 rpm"):
        system.dynamics(0.0, [start], [20.0, 300.0])


def test_its_pole_while_choked_is_that_of_the_charge(throttled):
    # With constant throttle flow the slope of the charge alone empties the manifold.
    system = throttled.as_nonlinear_system()
    pressure = float(throttled.steady_pressure(20.0, 1500.0))
    pole = control.linearize(system, [pressure], [20.0, 1500.0], eps=1e-3).poles()[0].real
    (p_0, m_0, _), (p_1, m_1, _) = full(19.8, 1500.0), full(20.2, 1500.0)
    slope = (m_1 - m_0) / (p_1 - p_0) * events_per_second(1500.0)
    extra = np.interp(pressure, throttled.pressure[16], throttled.storage_volume[16])
    assert throttled.speeds_rpm[16] == pytest.approx(1500.0)
    assert pole == pytest.approx(-GAS * slope / (ENGINE.manifold_volume + extra), rel=5e-3)


def test_a_short_pulse_is_not_missed(throttled):
    time = [0.0, 5.0, 5.0, 5.01, 5.01, 10.0]
    throttle = [20.0, 20.0, 60.0, 60.0, 20.0, 20.0]
    run = throttled.simulate(time, throttle, 1500.0)
    assert run.manifold_pressure[3] > 1.5 * run.manifold_pressure[0]
    assert run.manifold_pressure[1] == pytest.approx(run.manifold_pressure[0], abs=1.0)
    assert run.manifold_pressure[1] == run.manifold_pressure[2]


def test_what_was_not_identified_is_reported(throttled):
    low, _ = throttled.pressure_range(1500.0)
    run = throttled.simulate([0.0, 0.05, 3.0], 20.0, 1500.0, initial_pressure=0.5 * low)
    assert run.identified.tolist() == [False, True, True]
    assert "1 of 3 points outside the identified pressures" in str(run)


# -- inverse, refusals, data ---------------------------------------------------------------------


def test_inverse_reports_what_cannot_be_reached(throttled):
    found = throttled.throttle_for_charge([[1e-6], [171e-6], [600e-6]], [1500.0, 3000.0])
    assert found.reachable.tolist() == [[False, False], [True, True], [False, False]]
    assert np.isnan(found.throttle_deg[~found.reachable]).all()
    assert np.isnan(found.pumping_loss[~found.reachable]).all()
    _, wide_open, _ = full(90.0, 1500.0)
    assert found.highest_charge[0, 0] == pytest.approx(wide_open, rel=1e-3)
    most = throttled.throttle_for_charge(found.highest_charge[0, 0], 1500.0)
    assert most.reachable
    assert most.throttle_deg == pytest.approx(90.0, abs=0.5)
    assert "out of reach: 6.4" in str(throttled.throttle_for_charge(600e-6, 1500.0))
    with pytest.raises(ParameterError, match="not finite"):
        throttled.throttle_for_charge(np.nan, 1500.0)


def test_arrays_broadcast_and_the_outside_is_refused_or_nan(throttled):
    charge = throttled.air_charge(np.array([[30e3], [60e3]]), [1000.0, 2000.0, 4000.0])
    assert charge.shape == (2, 3)
    with pytest.raises(ParameterError, match=r"manifold_pressure at 1500 rpm is 5000 Pa.*10735"):
        throttled.air_charge(5e3, 1500.0)
    with pytest.raises(ParameterError, match=r"rpm \(element 1\) is 120000 Pa"):
        throttled.pumping_loss([50e3, 120e3], 1500.0)
    with pytest.raises(ParameterError, match=r"speed_rpm is 500 rpm.*\[750, 6000\] rpm"):
        throttled.air_charge(50e3, 500.0)
    values = throttled.air_charge([5e3, 50e3, 120e3, np.nan], 1500.0, outside="nan")
    assert np.isnan(values).tolist() == [True, False, True, True]
    assert np.isnan(throttled.air_charge(50e3, [500.0, 7000.0], outside="nan")).all()
    with pytest.raises(ParameterError, match="outside is 'clip'"):
        throttled.air_charge(50e3, 1500.0, outside="clip")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"plant": CrankAnglePlant()}, "profile is 'camless', but must be 'conventional'"),
        ({"cam": 8.1}, "cam is 8.1, but must be a ValveCommand"),
        ({"speeds_rpm": [1000.0, 2000.0]}, "at least 4 rising values in rpm"),
        ({"points": 5}, "points is 5, but must be from 8"),
        ({"throttle_range_deg": (5.0, 90.0)}, r"throttle_range_deg\[0\] is 5 deg.*Eq. 19"),
        ({"throttle_range_deg": (60.0, 20.0)}, "must rise"),
    ],
)
def test_bad_fits_are_refused(arguments, message):
    with pytest.raises(ParameterError, match=message):
        ThrottledMeanValuePlant.fit(**{"plant": PLANT, **arguments})


@pytest.mark.parametrize(
    ("time", "throttle", "speed", "initial", "message"),
    [
        ([0.0, 1.0], 5.0, 1500.0, None, r"throttle_deg.* is 5 deg.*Eq. 19"),
        ([0.0, 1.0], [20.0, 95.0], 1500.0, None, r"throttle_deg \(element 1\) is 95 deg"),
        ([0.0, 1.0], 20.0, 400.0, None, "speed_rpm.* is 400 rpm"),
        ([1.0, 0.0], 20.0, 1500.0, None, "must not fall"),
        ([0.0], 20.0, 1500.0, None, "at least 2"),
        ([0.0, 1.0], 20.0, 1500.0, 2e5, "initial_pressure is 200000 Pa"),
        ([0.0, 1.0], [20.0, 30.0, 40.0], 1500.0, None, "of one length"),
    ],
)
def test_bad_runs_are_refused(throttled, time, throttle, speed, initial, message):
    with pytest.raises(ParameterError, match=message):
        throttled.simulate(time, throttle, speed, initial)


def test_bad_steps_are_refused(throttled):
    with pytest.raises(ParameterError, match="must be 'conventional'"):
        throttle_step(CrankAnglePlant(), throttled)
    with pytest.raises(ParameterError, match="at least 2 angles"):
        throttle_step(PLANT, throttled, throttles_deg=(20.0,))
    with pytest.raises(ParameterError, match="events"):
        throttle_step(PLANT, throttled, events=0)


def test_a_variant_with_few_nodes_and_progress():
    done = []
    engine = Engine.paper().replace(n_cylinders=3)
    plant = CrankAnglePlant(engine, profile="conventional", runner=False)
    small = ThrottledMeanValuePlant.fit(
        plant,
        speeds_rpm=[1000.0, 1500.0, 2200.0, 3000.0, 4000.0],
        points=12,
        throttle_range_deg=(14.0, 80.0),
        progress=lambda i, n: done.append((i, n)),
    )
    assert done == [(i, 5) for i in range(1, 6)]
    assert small.error_against(plant, samples=40, seed=1).charge_rms < 0.005
    assert small.throttle_deg[:, [0, -1]].tolist() == [[14.0, 80.0]] * 5


def test_data_text_and_pictures(throttled):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    data = throttled.to_dataset()
    assert data["manifold_pressure"].attrs["units"] == "Pa"
    assert data["air_charge"].attrs["units"] == "kg"
    assert data.attrs["plant_fingerprint"] == PLANT.fingerprint
    assert "37 speeds 750 to 6000 rpm" in str(throttled)
    step = throttle_step(PLANT, throttled, events=6)
    run = throttled.simulate([0.0, 0.1, 0.2], 30.0, [1500.0, 1500.0, 1600.0])
    for figure in (throttled.plot(), step.plot(), run.plot(), step.run.plot()):
        labels = [ax.get_ylabel() for ax in figure.axes]
        assert all("(" in label for label in labels)
        plt.close(figure)
