import numpy as np
import pytest

from plant import CrankAnglePlant, ParameterError
from plant._boundary_correction import numbers
from plant.boundary import NAMES, BoundaryConditions
from plant.mean_value import MeanValuePlant

PLANT = CrankAnglePlant()
ENGINE = PLANT.engine
OWN = BoundaryConditions.of(ENGINE)
OTHER = BoundaryConditions(0.78e5, 318.0, 1.22e5)


@pytest.fixture(scope="module")
def maps():
    fitted = MeanValuePlant.fit(
        PLANT, speed_range_rpm=(1000.0, 4000.0), lift_range_mm=(1.0, 7.0), most_points=6000
    )
    return fitted.with_boundary_conditions(PLANT, samples=500)


@pytest.fixture(scope="module")
def slow():
    """Maps without a runner, at low speed and wide open, and their plant."""
    plant = CrankAnglePlant(runner=False)
    fitted = MeanValuePlant.fit(
        plant, speed_range_rpm=(750.0, 900.0), lift_range_mm=(4.0, 8.0), most_points=1500
    )
    return fitted.with_boundary_conditions(plant, exhaust_pressure=(0.9e5, 1.3e5), samples=200)


def cycles(plant, x, **parameters):
    lift, duration, speed = x
    found = plant.steady_cycles(speed, lift, duration, parameters=parameters, per_cylinder=False)
    return found["air_charge"].values, found["pumping_loss"].values


def named(conditions):
    return {name: getattr(conditions, name) for name in NAMES}


def test_at_the_engine_s_own_conditions_the_maps_are_unchanged(maps):
    x = maps.region.sample(200, seed=1)
    for evaluate in (maps.air_charge, maps.pumping_loss):
        np.testing.assert_allclose(evaluate(*x, conditions=OWN), evaluate(*x), rtol=1e-13)
    np.testing.assert_allclose(maps.at(OWN).charge, maps.charge, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(maps.at(OWN).loss, maps.loss, rtol=1e-12, atol=1e-14)


def test_they_follow_the_full_plant_as_closely_as_stated(maps):
    random = np.random.default_rng(99)
    x = maps.region.sample(1000, seed=98)
    conditions = BoundaryConditions(*(random.uniform(*r, 1000) for r in maps.boundary.ranges))
    charge, loss = cycles(PLANT, x, **named(conditions))
    pressure = conditions.ambient_pressure / OWN.ambient_pressure
    mass = pressure * OWN.temperature / conditions.temperature
    told = maps.boundary.error
    for found, truth, largest, rms, most in (
        (
            maps.air_charge(*x, conditions=conditions),
            charge,
            maps.largest_charge(x[2]) * mass,
            told.charge_rms,
            told.charge_max,
        ),
        (
            maps.pumping_loss(*x, conditions=conditions),
            loss,
            maps.largest_loss(x[2]) * pressure,
            told.loss_rms,
            told.loss_max,
        ),
    ):
        error = (found - truth) / largest
        assert np.sqrt(np.mean(error**2)) < 1.2 * rms
        # The largest of twice as many points may be somewhat larger.
        assert np.abs(error).max() < 1.5 * most
    assert told.charge_max < 0.02
    assert told.loss_max < 0.04


def test_slow_and_wide_open_the_cylinder_fills_with_ambient_air(slow):
    # Ideal gas: what fills the cylinder at BDC less what the exhaust left in the clearance.
    volume = ENGINE.displaced_volume + ENGINE.clearance_volume
    for conditions in (
        BoundaryConditions(0.75e5, 255.0, 1.0e5),
        BoundaryConditions(1.0e5, 325.0, 1.25e5),
        BoundaryConditions(0.85e5, 300.0, 0.95e5),
    ):
        p, t, exhaust = (getattr(conditions, name) for name in NAMES)
        full = (p * volume - exhaust * ENGINE.clearance_volume) / (ENGINE.gas_constant * t)
        charge = slow.air_charge(8.0, 184.5, 750.0, conditions=conditions)
        assert charge == pytest.approx(full, rel=0.006)
        assert slow.at(conditions).air_charge(8.0, 184.5, 750.0) == pytest.approx(full, rel=0.006)


SCALE = 0.87


@pytest.mark.parametrize("runner", [False, True])
def test_in_units_of_ambient_air_pressures_and_orifices_scale_together(runner):
    # m = p V/(R T) mu: with both pressures and all orifices times s, charge and loss are too.
    plant = CrankAnglePlant(runner=runner, resolution=16.0)
    x = MAP_REGION_POINTS
    charge, loss = cycles(plant, x)
    scaled = cycles(
        plant,
        x,
        ambient_pressure=SCALE * ENGINE.ambient_pressure,
        exhaust_pressure=SCALE * ENGINE.exhaust_pressure,
        flow_coefficient=SCALE * ENGINE.flow_coefficient,
        **{"throttle.scale": SCALE * ENGINE.throttle.scale},
    )
    np.testing.assert_allclose(scaled[0], SCALE * charge, atol=1e-6 * charge.max())
    np.testing.assert_allclose(scaled[1], SCALE * loss, atol=1e-6 * loss.max())
    # The orifices' size is A R T/(p V): less pressure is as good as larger orifices.
    e = ENGINE.replace(flow_coefficient=ENGINE.flow_coefficient / SCALE)
    size = np.log(e.flow_coefficient / ENGINE.flow_coefficient)
    pressures = OWN.replace(
        ambient_pressure=SCALE * OWN.ambient_pressure, exhaust_pressure=SCALE * OWN.exhaust_pressure
    )
    np.testing.assert_allclose(numbers(ENGINE, pressures), (size, 0.0, 0.0), atol=1e-14)


MAP_REGION_POINTS = (
    np.array([1.0, 2.0, 3.0, 5.0, 7.0, 4.0]),
    np.array([60.0, 99.0, 189.0, 240.0, 180.0, 270.0]),
    np.array([1000.0, 1500.0, 1500.0, 2500.0, 3500.0, 4000.0]),
)


def test_temperature_alone_matters_to_the_runner_only(slow):
    # T/p_a and p_exh/p_a are kept: without a runner nothing is left to change mu.
    x = MAP_REGION_POINTS
    everything = {name: SCALE * getattr(ENGINE, name) for name in NAMES}
    change = {}
    for runner in (False, True):
        plant = CrankAnglePlant(runner=runner, resolution=16.0)
        charge, loss = cycles(plant, x)
        scaled = cycles(plant, x, **everything)
        change[runner] = (
            np.abs(scaled[0] - charge).max() / charge.max(),
            np.abs(scaled[1] / SCALE - loss).max() / loss.max(),
        )
    assert max(change[False]) < 1e-6
    assert min(change[True]) > 0.005
    conditions = BoundaryConditions(**everything)
    np.testing.assert_allclose(
        numbers(ENGINE, conditions), (0.0, 0.0, np.log(SCALE)), rtol=1e-12, atol=1e-14
    )
    # The fitted maps obey the law as well as they are stated to be.
    points, told = slow.region.sample(200, seed=3), slow.boundary.error
    charge = slow.air_charge(*points)
    error = slow.air_charge(*points, conditions=conditions) - charge
    assert np.abs(error).max() < told.charge_max * charge.max()
    loss = slow.pumping_loss(*points)
    error = slow.pumping_loss(*points, conditions=conditions) / SCALE - loss
    assert np.abs(error).max() < told.loss_max * loss.max()


def test_maps_at_other_conditions_are_those_maps(maps):
    there = maps.at(OTHER)
    x = maps.region.sample(300, seed=4)
    for name, k in (("air_charge", 0), ("pumping_loss", 1)):
        direct = getattr(maps, name)(*x, conditions=OTHER)
        # Both leave their nodes by what they tell, for their shape.
        allowed = there.shape_adjustment[k] + maps.shape_adjustment[k]
        assert np.abs(getattr(there, name)(*x) - direct).max() < allowed * direct.max()
        assert np.median(np.abs(getattr(there, name)(*x) - direct)) < 1e-4 * direct.max()
    plant = CrankAnglePlant(ENGINE.replace(**named(OTHER)))
    error = there.error_against(plant, samples=300, seed=5)
    assert error.same_plant
    assert error.charge_max < 0.02
    assert error.loss_max < 0.04
    assert there.engine == plant.engine
    assert there.provenance["scaled_from"] == PLANT.fingerprint


def test_maps_at_other_conditions_serve_the_inverse(maps):
    there = maps.at(OTHER)
    lift, speed, wanted = np.array([2.0, 3.0, 6.0]), np.array([1200.0, 2000.0, 3500.0]), 150e-6
    found = there.duration_for_charge(wanted, lift, speed)
    assert found.reachable.all()
    full, _ = cycles(PLANT, (lift, found.duration_deg, speed), **named(OTHER))
    np.testing.assert_allclose(full, wanted, atol=0.01 * there.largest_charge(2000.0))
    assert (found.duration_deg > maps.duration_for_charge(wanted, lift, speed).duration_deg).all()
    assert (there.largest_charge([1500.0, 3000.0]) < maps.largest_charge([1500.0, 3000.0])).all()


def test_points_and_conditions_broadcast(maps):
    pressures = np.array([0.75e5, 0.9e5, 1.0e5])
    conditions = OTHER.replace(ambient_pressure=pressures)
    table = maps.air_charge(3.0, np.array([[100.0], [180.0]]), 1500.0, conditions=conditions)
    assert table.shape == (2, 3)
    one = OTHER.replace(ambient_pressure=0.9e5)
    assert table[1, 1] == pytest.approx(
        maps.air_charge(3.0, 180.0, 1500.0, conditions=one), rel=1e-12
    )
    assert maps.air_charge(3.0, 180.0, 1500.0, conditions=conditions).shape == (3,)
    outside = maps.air_charge([3.0, 9.0], 180.0, 1500.0, conditions=one, outside="nan")
    assert np.isnan(outside).tolist() == [False, True]


def test_few_nodes_are_enough_for_a_correction():
    # With fewer than 6 nodes in a coordinate every one of them is needed for a cubic spline.
    plant = CrankAnglePlant(runner=False)
    fitted = MeanValuePlant.fit(
        plant, speed_range_rpm=(1500.0, 1700.0), lift_range_mm=(2.0, 3.0), most_points=600
    )
    assert min(fitted.charge.shape) < 6
    corrected = fitted.with_boundary_conditions(plant, samples=100)
    assert corrected.boundary.error.charge_rms < 0.01


def test_conditions_that_are_not_covered_are_refused(maps):
    x = (3.0, 180.0, 1500.0)
    plain = maps.at(OTHER)
    for call in (lambda: plain.air_charge(*x, conditions=OTHER), lambda: plain.at(OTHER)):
        with pytest.raises(ParameterError, match=r"hold for .*0\.78 bar.* only.*with_boundary"):
            call()
    for name, value, told in (
        ("ambient_pressure", 0.69e5, r"69000 Pa, but the maps cover \[70000, 105000\] Pa"),
        ("temperature", 331.0, r"331 K, but the maps cover \[250, 330\] K"),
        ("exhaust_pressure", [1.2e5, 1.4e5], r"140000 Pa, but the maps cover"),
    ):
        with pytest.raises(ParameterError, match=f"{name} is {told}"):
            maps.air_charge(*x, conditions=OTHER.replace(**{name: value}))
    with pytest.raises(ParameterError, match="temperature is 331 K"):
        maps.at(OTHER.replace(temperature=331.0))
    with pytest.raises(ParameterError, match="arrays, but maps are made at numbers"):
        maps.at(OTHER.replace(temperature=[290.0, 300.0]))


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1e5, [1e5, np.nan]])
@pytest.mark.parametrize("name", NAMES)
def test_conditions_must_be_numbers_above_zero(name, value):
    with pytest.raises(ParameterError, match=f"{name} is .* must be finite and above 0"):
        OTHER.replace(**{name: value})


def test_what_cannot_be_fitted(maps):
    with pytest.raises(ParameterError, match="give the plant that was fitted"):
        maps.with_boundary_conditions(CrankAnglePlant(runner=False))
    for ranges in (
        {"temperature": (300.0, 330.0)},  # leaves out 290 K
        {"temperature": (290.0, 290.0)},
        {"ambient_pressure": (1.05e5, 0.7e5)},
        {"exhaust_pressure": (0.0, 1.3e5)},
        {"exhaust_pressure": (1.0e5, np.inf)},
        {"exhaust_pressure": (np.nan, 1.3e5)},
    ):
        name = next(iter(ranges))
        with pytest.raises(ParameterError, match=rf"{name} is to be covered|{name}\[\d\] is"):
            maps.with_boundary_conditions(PLANT, **ranges)
