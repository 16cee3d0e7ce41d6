import casadi
import numpy as np
import pytest

from plant import CrankAnglePlant, ParameterError
from plant.boundary import NAMES, BoundaryConditions
from plant.mean_value import MeanValuePlant
from plant.sweep import sweep

PLANT = CrankAnglePlant()
VARIABLES = ("lift", "duration", "speed")


@pytest.fixture(scope="module")
def maps():
    fitted = MeanValuePlant.fit(
        PLANT, speed_range_rpm=(1000.0, 4000.0), lift_range_mm=(1.0, 7.0), most_points=6000
    )
    return fitted.with_boundary_conditions(PLANT, samples=300)


@pytest.fixture(scope="module")
def function(maps):
    return maps.casadi_function()


def called(function, *x):
    """Outputs at many points, each an ndarray."""
    found = function.map(len(x[0]))(*(np.asarray(v)[None] for v in x))
    return [np.asarray(out.full()).ravel() for out in found]


def test_values_are_those_of_the_maps(maps, function):
    x = maps.region.sample(300, seed=1)
    charge, loss, inside = called(function, *x)
    np.testing.assert_allclose(charge, maps.air_charge(*x), rtol=1e-12, atol=1e-17)
    np.testing.assert_allclose(loss, maps.pumping_loss(*x), rtol=1e-12, atol=1e-13)
    assert (inside == 1.0).all()
    assert function.name_in() == ["lift_mm", "duration_deg", "speed_rpm"]
    assert function.name_out() == ["air_charge", "pumping_loss", "inside"]


def test_corners_of_the_region_are_inside(maps, function):
    r = maps.region
    lift, speed, share = np.meshgrid(
        [r.lowest_lift_mm, r.highest_lift_mm], [r.lowest_speed_rpm, r.highest_speed_rpm], [0.0, 1.0]
    )
    x = (lift.ravel(), r.duration_deg(lift, share, speed).ravel(), speed.ravel())
    charge, _, inside = called(function, *x)
    assert (inside == 1.0).all()
    np.testing.assert_allclose(charge, maps.air_charge(*x), rtol=1e-10)


@pytest.mark.parametrize("output", ["charge", "loss"])
def test_its_derivatives_are_the_maps_own(maps, function, output):
    x = [casadi.MX.sym(name) for name in VARIABLES]
    value = function(*x)[output == "loss"]
    slope = casadi.gradient(value, casadi.vertcat(*x))
    second = casadi.jacobian(slope, casadi.vertcat(*x))
    derivatives = casadi.Function("derivatives", x, [slope, second])
    points = maps.region.sample(80, seed=2)
    gradient = getattr(maps, f"{output}_gradient")(*points)
    hessian = getattr(maps, f"{output}_hessian")(*points)
    found = [derivatives(*point) for point in zip(*points, strict=True)]
    slopes = np.array([f[0].full().ravel() for f in found])
    seconds = np.array([f[1].full() for f in found])
    for i, name in enumerate(VARIABLES):
        close(slopes[:, i], getattr(gradient, name))
        for j in range(i, 3):
            close(seconds[:, i, j], getattr(hessian, f"{name}_{VARIABLES[j]}"))
            close(seconds[:, j, i], seconds[:, i, j])


def close(value, expected):
    np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


OUTSIDE = {
    "infeasible corner": (7.0, 60.0, 4000.0),
    "slow": (3.0, 180.0, 990.0),
    "fast": (3.0, 180.0, 4010.0),
    "low": (0.99, 180.0, 2000.0),
    "high": (7.01, 180.0, 2000.0),
    "long": (3.0, 281.0, 2000.0),
}


@pytest.mark.parametrize("point", OUTSIDE.values(), ids=OUTSIDE)
def test_outside_the_region_is_nan_or_the_value_at_its_border(maps, function, point):
    charge, loss, inside = (float(v) for v in function(*point))
    assert np.isnan([charge, loss]).all()
    assert inside == 0.0
    r = maps.region
    lift = np.clip(point[0], r.lowest_lift_mm, r.highest_lift_mm)
    speed = np.clip(point[2], r.lowest_speed_rpm, r.highest_speed_rpm)
    duration = np.clip(point[1], r.shortest_deg(lift, speed), r.longest_deg)
    held = [float(v) for v in maps.casadi_function(outside="hold")(*point)]
    assert held[0] == pytest.approx(maps.air_charge(lift, duration, speed), rel=1e-7)
    assert held[1] == pytest.approx(maps.pumping_loss(lift, duration, speed), rel=1e-7)
    assert held[2] == 0.0


def test_holding_is_continuous_over_the_border(maps):
    held = maps.casadi_function(outside="hold")
    # Through the infeasible corner, along lift, past the longest duration and both speeds.
    for start, end in (
        ((2.0, 100.0, 4000.0), (7.5, 100.0, 4000.0)),
        ((7.0, 40.0, 3900.0), (7.0, 300.0, 3900.0)),
        ((3.0, 200.0, 800.0), (3.0, 200.0, 4300.0)),
    ):
        places = np.linspace(0.0, 1.0, 4001)[:, None]
        x = np.array(start) + places * (np.array(end) - np.array(start))
        charge, loss, inside = called(held, *x.T)
        assert 0.0 < inside.mean() < 1.0
        for values in (charge, loss):
            assert np.abs(np.diff(values)).max() < 0.005 * np.abs(values).max()


def test_with_shares_the_region_is_a_box(maps):
    function = maps.casadi_function(coordinates="share")
    assert function.name_in() == ["lift_mm", "share", "speed_rpm"]
    random = np.random.default_rng(3)
    lift, speed = random.uniform(1.0, 7.0, 100), random.uniform(1000.0, 4000.0, 100)
    share = random.uniform(size=100)
    charge, loss, inside, duration = called(function, lift, share, speed)
    assert (inside == 1.0).all()
    np.testing.assert_allclose(duration, maps.region.duration_deg(lift, share, speed), rtol=1e-12)
    np.testing.assert_allclose(charge, maps.air_charge(lift, duration, speed), rtol=1e-10)
    np.testing.assert_allclose(
        loss, maps.pumping_loss(lift, duration, speed), rtol=1e-10, atol=1e-12
    )
    for share_outside in (-0.01, 1.01):
        charge, _, inside = (float(v) for v in function(3.0, share_outside, 2000.0)[:3])
        assert np.isnan(charge)
        assert inside == 0.0


def test_boundary_conditions_are_inputs(maps):
    function = maps.casadi_function(boundary_conditions=True)
    assert function.name_in()[3:] == list(NAMES)
    random = np.random.default_rng(4)
    x = maps.region.sample(100, seed=4)
    air = [random.uniform(*r, 100) for r in maps.boundary.ranges]
    conditions = BoundaryConditions(*air)
    charge, loss, inside = called(function, *x, *air)
    assert (inside == 1.0).all()
    close(charge, maps.air_charge(*x, conditions=conditions))
    close(loss, maps.pumping_loss(*x, conditions=conditions))
    for k in range(3):
        beyond = [9e4, 290.0, 1.1e5]
        beyond[k] = 1.001 * maps.boundary.ranges[k][1]
        charge, _, inside = (float(v) for v in function(3.0, 180.0, 2000.0, *beyond))
        assert np.isnan(charge)
        assert inside == 0.0


@pytest.mark.parametrize(("k", "step"), [(0, 500.0), (1, 1.0), (2, 500.0)])
def test_derivatives_by_the_boundary_conditions(maps, k, step):
    function = maps.casadi_function(boundary_conditions=True)
    x = [casadi.MX.sym(f"x{i}") for i in range(6)]
    by_condition = casadi.Function(
        "by_condition", x, [casadi.gradient(out, x[3 + k]) for out in function(*x)[:2]]
    )
    lift, duration, speed = maps.region.sample(60, seed=5)
    base = np.array([0.85e5, 285.0, 1.15e5])
    own, full = [], []
    for sign in (1.0, -1.0):
        air = base.copy()
        air[k] += sign * step
        conditions = BoundaryConditions(*air)
        found = PLANT.steady_cycles(
            speed, lift, duration, parameters=dict(zip(NAMES, air, strict=True)), per_cylinder=False
        )
        own.append(
            [
                evaluate(lift, duration, speed, conditions=conditions)
                for evaluate in (maps.air_charge, maps.pumping_loss)
            ]
        )
        full.append([found[name].values for name in ("air_charge", "pumping_loss")])
    exact = called(by_condition, lift, duration, speed, *np.repeat(base[:, None], 60, axis=1))
    for value, plus, minus, true, away in zip(exact, *own, *full, strict=True):
        difference, truth = (plus - minus) / (2 * step), (true - away) / (2 * step)
        assert np.abs(value - difference).max() < 1e-4 * np.abs(difference).max()
        size = np.sqrt(np.mean(truth**2))
        assert np.sqrt(np.mean((value - truth) ** 2)) < 0.05 * size


def test_least_pumping_loss_at_a_charge_is_found_by_a_solver(maps):
    speed, wanted = 2000.0, 150e-6
    function = maps.casadi_function(coordinates="share", outside="hold")
    x = casadi.MX.sym("x", 2)
    charge, loss, _, _ = function(x[0], x[1], speed)
    solver = casadi.nlpsol(
        "least_loss",
        "ipopt",
        {"x": x, "f": loss, "g": 1e6 * charge},
        {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"},
    )
    found = solver(
        x0=[3.0, 0.3], lbx=[1.0, 0.0], ubx=[7.0, 1.0], lbg=1e6 * wanted, ubg=1e6 * wanted
    )
    assert solver.stats()["success"]
    lift, share = found["x"].full().ravel()
    duration = float(function(lift, share, speed)[3])
    truth = sweep(PLANT, speed, lift, duration)
    error = maps.error_against(PLANT, samples=1000, seed=6)
    largest = maps.largest_charge(speed)
    assert abs(truth.air_charge - wanted) <= error.charge_max * largest
    # No lift of the full plant does better at this charge, by brute force over lift and duration.
    lifts, shares = np.linspace(1.0, 7.0, 25), np.linspace(0.0, 1.0, 400)
    durations = maps.region.duration_deg(lifts[:, None], shares, speed)
    every = sweep(PLANT, speed, lifts[:, None], durations)
    least = []
    for m, e in zip(every.air_charge, every.pumping_loss, strict=True):
        crossing = np.flatnonzero((m[:-1] < wanted) != (m[1:] < wanted))
        part = (wanted - m[crossing]) / (m[crossing + 1] - m[crossing])
        least += (e[crossing] + part * (e[crossing + 1] - e[crossing])).tolist()
    assert truth.pumping_loss <= min(least) + 2.0 * error.loss_max * maps.largest_loss(speed)


def test_what_cannot_be_asked_for(maps):
    with pytest.raises(ParameterError, match=r"coordinates is 'shares'.*did you mean 'share'"):
        maps.casadi_function(coordinates="shares")
    with pytest.raises(ParameterError, match="outside is 'raise'"):
        maps.casadi_function(outside="raise")
    plain = maps.at(BoundaryConditions(0.9e5, 290.0, 1.1e5))
    with pytest.raises(ParameterError, match="with_boundary_conditions"):
        plain.casadi_function(boundary_conditions=True)


def test_slopes_at_the_shortest_duration_are_those_inside(maps):
    # The share of a border is a hair below 0 or above it, by rounding.
    random = np.random.default_rng(4)
    r = maps.region
    lift = random.uniform(r.lowest_lift_mm, r.highest_lift_mm, 300)
    speed = random.uniform(r.lowest_speed_rpm, r.highest_speed_rpm, 300)
    duration = r.shortest_deg(lift, speed)
    for outside in ("nan", "hold"):
        x = casadi.MX.sym("x", 3)
        charge, _, inside = maps.casadi_function(outside=outside)(x[0], x[1], x[2])
        slope = casadi.Function("slope", [x], [casadi.jacobian(charge, x), inside])
        gradient = maps.charge_gradient(lift, duration, speed)
        for k, point in enumerate(np.stack((lift, duration, speed), axis=1)):
            found, holds = slope(point)
            assert float(holds) == 1.0
            expected = [gradient.lift[k], gradient.duration[k], gradient.speed[k]]
            np.testing.assert_allclose(found.full().ravel(), expected, rtol=1e-5)
