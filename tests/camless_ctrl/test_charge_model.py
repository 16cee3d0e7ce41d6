from typing import NamedTuple

import numpy as np
import pytest

from camless_ctrl.charge_model import ChargeModel
from camless_ctrl.cylinder_parameters import CylinderParameters
from camless_ctrl.inflow_shares import inflow_shares
from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand, Valvetrain
from plant.valve import shortest_duration

RANGES = ((1300.0, 1700.0), (2800.0, 3200.0))  # rpm


class Motions(NamedTuple):
    lift_mm: np.ndarray
    duration_deg: np.ndarray


class LinearPath:
    """Lift and duration rise along the path, from the shortest duration of the lift on."""

    positions = np.array([0.0, 1.0])

    def __init__(self, low_rpm, high_rpm):
        self.speeds_rpm = np.array([low_rpm, high_rpm])

    def at(self, position, speed_rpm, /):
        q, speed = np.broadcast_arrays(position, speed_rpm)
        lift = 1.5 + 0.001 * speed + q
        shortest = shortest_deg(lift, speed)
        return Motions(lift, np.maximum(shortest, 40.0) * (1.0 - q) + 150.0 * q)


def shortest_deg(lift_mm, speed_rpm):
    return 6.0 * speed_rpm * shortest_duration(lift_mm, Valvetrain()) * (1.0 + 1e-8)


@pytest.fixture(scope="module")
def plant():
    return CrankAnglePlant(oscillation=True)


@pytest.fixture(scope="module")
def models(plant):
    return [ChargeModel.fit(LinearPath(*r), plant, speeds=9, positions=25) for r in RANGES]


@pytest.fixture
def model(models):
    return models[0]


def delivered(plant, speed_rpm, points, gains, offsets, **parameters):
    """Charge of cylinders that are all alike, for each command, kg."""
    coefficient = plant.engine.flow_coefficient * np.asarray(gains)
    duration = np.array([p.duration_deg for p in points]) + 6.0 * speed_rpm * np.asarray(offsets)
    return plant.steady_cycles(
        speed_rpm,
        np.array([p.lift_mm for p in points]),
        duration,
        parameters={"flow_coefficient": coefficient, **parameters},
        per_cylinder=False,
    )["air_charge"].values


def draw(model, count, seed, *, gains=(0.8, 1.2), offsets=(-2e-4, 2e-4)):
    random = np.random.default_rng(seed)
    speeds = random.uniform(model.speeds_rpm[0], model.speeds_rpm[-1], count)
    found = []
    for speed in speeds:
        parameters = CylinderParameters(
            random.uniform(*gains), random.uniform(*offsets), random.uniform(0.9, 1.1)
        )
        low, high = model.limits(speed, parameters)
        found.append((random.uniform(low, high), speed, parameters))
    return found


@pytest.mark.parametrize("k", [0, 1])
def test_full_plant_takes_in_the_demand(models, plant, k):
    cases = draw(models[k], 300, seed=k)
    points = [models[k].inverse(*case) for case in cases]
    speed = np.array([c[1] for c in cases])
    gains, offsets, factors = np.array([c[2] for c in cases]).T
    charge = factors * delivered(plant, speed, points, gains, offsets)
    demand = np.array([c[0] for c in cases])
    taken_off = np.array(
        [
            p.duration_deg < (1.0 + 1e-6) * shortest_deg(p.lift_mm, s)
            for p, s in zip(points, speed, strict=True)
        ]
    )
    assert not any(p.limited for p in points)
    assert [p.charge for p in points] == pytest.approx(demand, rel=1e-9)
    assert charge[~taken_off] == pytest.approx(demand[~taken_off], rel=2e-3)
    # Where lift had to be taken off, gain and lift act together, which is not modelled.
    assert charge[taken_off] == pytest.approx(demand[taken_off], rel=1e-2)


def test_lift_is_taken_off_where_the_command_is_too_short_for_it(models, plant):
    model, speed, offset = models[1], 3000.0, 2e-4
    low, _ = model.limits(speed)
    path = model.inverse(1.02 * low, speed)
    point = model.inverse(1.02 * low, speed, CylinderParameters(duration_offset=offset))
    assert not point.limited
    assert point.lift_mm < path.lift_mm - 0.1
    # The command lies on the limit, and the valve motion is accepted.
    assert point.duration_deg == pytest.approx(shortest_deg(point.lift_mm, speed), rel=1e-6)
    charge = delivered(plant, speed, [point], 1.0, offset)
    assert charge == pytest.approx(1.02 * low, rel=2e-3)


def test_cylinders_that_differ_are_balanced(model, plant):
    speed, demand = 1500.0, 3e-4
    parameters = [
        CylinderParameters(g, d) for g, d in ((1.03, 0.0), (0.85, 1e-4), (0.96, 0.0), (1.05, -1e-4))
    ]
    points = [model.inverse(demand, speed, p) for p in parameters]
    engine = plant.engine.replace(cylinder_flow_factors=tuple(p.flow_gain for p in parameters))
    commands = [
        ValveCommand(point.lift_mm, point.duration_deg + 6.0 * speed * p.duration_offset)
        for point, p in zip(points, parameters, strict=True)
    ]
    cycle = plant.with_engine(engine).steady_cycle(speed, commands)
    assert cycle.air_charge == pytest.approx(demand, rel=3e-3)


def test_nodes_are_those_of_the_full_plant(model, plant):
    i, j = 3, 11
    found = model.at(model.positions[j], model.speeds_rpm[i])
    path = LinearPath(*RANGES[0]).at(model.positions[j], model.speeds_rpm[i])
    cycle = plant.steady_cycle(
        model.speeds_rpm[i], ValveCommand(float(path.lift_mm), float(path.duration_deg))
    )
    assert found["charge"] == pytest.approx(cycle.air_charge[0], rel=1e-7)
    assert found["loss"] == pytest.approx(cycle.pumping_loss[0], rel=1e-7)
    assert found["lift_mm"] == pytest.approx(float(path.lift_mm), rel=1e-12)
    degrees = 6.0 * model.speeds_rpm[i] * found["duration"]
    assert degrees == pytest.approx(float(path.duration_deg), rel=1e-12)


def test_error_between_the_nodes_is_what_is_told(model, plant):
    random = np.random.default_rng(7)
    speed, position = random.uniform(1300.0, 1700.0, 300), random.uniform(0.0, 1.0, 300)
    path = LinearPath(*RANGES[0]).at(position, speed)
    # The path itself, not what the table makes of it.
    charge = plant.steady_cycles(speed, path.lift_mm, path.duration_deg, per_cylinder=False)
    ratio = model.charge_at(position, speed) / charge["air_charge"].values
    assert np.abs(ratio - 1.0).max() < 3e-3
    assert 1e-4 < model.node_error < 6e-3  # at ten times as many points, of this coarse table
    assert 0.0 < model.flow_error <= model.wide_flow_error < 1e-2


@pytest.mark.parametrize("k", [0, 1])
def test_slopes_are_those_of_the_full_plant(models, plant, k):
    speed = float(np.mean(RANGES[k]))
    low, high = models[k].limits(speed)
    for demand in (0.8 * low + 0.2 * high, 0.4 * low + 0.6 * high):
        point = models[k].inverse(demand, speed)
        step = 2e-2
        more, less = delivered(plant, speed, [point] * 2, [1.0 + step, 1.0 - step], [0.0, 0.0])
        assert point.flow_slope == pytest.approx(np.log(more / less) / (2 * step), rel=2e-2)
        step = 5e-5  # s
        more, less = delivered(plant, speed, [point] * 2, [1.0, 1.0], [step, -step])
        assert point.duration_slope == pytest.approx(np.log(more / less) / (2 * step), rel=3e-2)


def test_shares_are_those_of_the_inflow(model, plant):
    speed = 1480.0
    point = model.inverse(2.5e-4, speed)
    assert point.shares.shape == (32,)
    assert point.shares.sum() == pytest.approx(1.0, abs=1e-9)
    cycle = plant.steady_cycle(speed, ValveCommand(point.lift_mm, point.duration_deg))
    # The flow of the first cylinder, integrated by trapezia over halves of the event angle.
    trace = cycle.trace_at(0.25)
    flow = trace.port_flow[:, 0]
    steps = np.diff(trace.time) * 0.5 * (flow[1:] + flow[:-1])
    halves = steps[: 4 * 360].reshape(4, 360).sum(axis=1) / cycle.air_charge[0]
    assert point.shares.reshape(4, 8).sum(axis=1) == pytest.approx(halves, abs=5e-3)


@pytest.mark.parametrize("gain", [0.85, 1.1])
def test_weak_valve_fills_its_cylinder_in_another_rhythm(models, plant, gain):
    model, speed = models[1], 3000.0
    known = CylinderParameters(flow_gain=gain)
    point = model.inverse(2.5e-4, speed, known)
    scaled = plant.with_engine(
        plant.engine.replace(flow_coefficient=gain * plant.engine.flow_coefficient)
    )
    truth = inflow_shares(scaled, ValveCommand(point.lift_mm, point.duration_deg), speed)
    nominal = inflow_shares(plant, ValveCommand(point.lift_mm, point.duration_deg), speed)
    left = np.abs(np.cumsum(point.shares - truth)).max()
    assert left < 0.3 * np.abs(np.cumsum(nominal - truth)).max()
    assert left < 3e-3
    assert point.shares.sum() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("gain", [0.7, 1.0, 1.3])
def test_charge_rises_along_the_path(model, gain):
    position = np.linspace(0.0, 1.0, 500)
    charge = model.charge_at(position, 1421.0, CylinderParameters(gain))
    assert np.all(np.diff(charge) > 0.0)


def test_fit_names_where_the_charge_falls(plant):
    class TooLong(LinearPath):
        def at(self, position, speed_rpm, /):
            motion = super().at(position, speed_rpm)
            return Motions(motion.lift_mm, motion.duration_deg + 110.0 * np.asarray(position))

    with pytest.raises(ParameterError, match=r"falls from .* mg from position .* at 1[34]\d\d rpm"):
        ChargeModel.fit(TooLong(*RANGES[0]), plant, speeds=5, positions=9)


def test_similarity_with_density(model, plant):
    speed, demand, density = 1500.0, 2.4e-4, 0.75
    engine = plant.engine
    points = [
        model.inverse(demand, speed, CylinderParameters(g), density=density) for g in (0.9, 1.0)
    ]
    assert not any(p.limited for p in points)
    charge = delivered(
        plant,
        speed,
        points,
        [0.9, 1.0],
        [0.0, 0.0],
        ambient_pressure=density * engine.ambient_pressure,
        exhaust_pressure=density * engine.exhaust_pressure,
    )
    assert charge == pytest.approx(demand, rel=2e-3)
    # The charge of the path at that density is what the inverse has solved for.
    position = np.linspace(0.0, 1.0, 2001)
    along = model.charge_at(position, speed, CylinderParameters(0.9), density)
    lift = np.interp(demand, along, model.at(position, speed)["lift_mm"])
    assert points[0].lift_mm == pytest.approx(lift, rel=1e-4)


@pytest.mark.parametrize(("runner", "warmer"), [(True, 1.0), (False, 320.0 / 290.0)])
def test_similarity_is_exact_when_the_throttle_scales_too(runner, warmer):
    # Independent of any model: the same motion in air of another density. With the runner a
    # change of temperature is none of density alone, for the runner's pressure follows 1/T.
    plant = CrankAnglePlant(runner=runner, oscillation=True)
    engine, density = plant.engine, 0.75 / warmer
    other = engine.replace(
        ambient_pressure=0.75 * engine.ambient_pressure,
        exhaust_pressure=0.75 * engine.exhaust_pressure,
        temperature=engine.temperature * warmer,
        flow_coefficient=engine.flow_coefficient * density,
        throttle=engine.throttle.replace(scale=engine.throttle.scale * density),
    )
    command = ValveCommand(3.0, 120.0)
    one = plant.steady_cycle(1500.0, command).air_charge
    assert plant.with_engine(other).steady_cycle(1500.0, command).air_charge == pytest.approx(
        density * one, rel=1e-5
    )


def test_demand_out_of_reach_gets_the_nearest_charge(model):
    parameters = CylinderParameters(0.9, 5e-5, 1.05)
    low, high = model.limits(1500.0, parameters)
    for demand, reached in ((0.5 * low, low), (-1.0, low), (0.0, low), (1.2 * high, high)):
        point = model.inverse(demand, 1500.0, parameters)
        assert point.limited
        assert point.charge == pytest.approx(reached, rel=1e-12)
    for demand in (low, high):
        assert not model.inverse(demand, 1500.0, parameters).limited


@pytest.mark.parametrize(("speed", "nearest"), [(500.0, 1300.0), (0.0, 1300.0), (1e7, 1700.0)])
def test_speed_beyond_the_table_is_held_at_its_end(model, speed, nearest):
    point, held = model.inverse(2e-4, speed), model.inverse(2e-4, nearest)
    assert point.limited
    assert not held.limited
    assert point.duration_deg == pytest.approx(held.duration_deg)
    assert point.charge == pytest.approx(2e-4)
    assert 0.5 <= point.lift_mm <= held.lift_mm


def test_flow_gain_beyond_what_was_fitted_is_told(model):
    assert model.inverse(2e-4, 1500.0, CylinderParameters(0.5)).limited
    assert model.inverse(2e-4, 1500.0, CylinderParameters(1.0), density=0.5).limited


def test_longest_command_limits_the_charge(plant):
    path = LinearPath(1400.0, 1600.0)
    model = ChargeModel.fit(path, plant, speeds=5, positions=9, longest_deg=150.0)
    late = CylinderParameters(duration_offset=-2e-4)  # shuts early, wants a longer command
    low, high = model.limits(1500.0, late)
    assert high < 0.99 * model.limits(1500.0)[1]
    assert low == pytest.approx(model.limits(1500.0)[0])
    point = model.inverse(1.0, 1500.0, late)
    assert point.limited
    assert point.charge == pytest.approx(high)
    assert point.duration_deg == pytest.approx(150.0)
    hopeless = CylinderParameters(duration_offset=-0.1)
    with pytest.raises(ParameterError, match=r"-100 ms leaves no command .* 150 deg at 1500 rpm"):
        model.inverse(2e-4, 1500.0, hopeless)
    with pytest.raises(ParameterError, match="leaves no command"):
        model.limits(1500.0, hopeless)


@pytest.mark.parametrize(
    ("demand", "speed", "parameters", "density", "name"),
    [
        (np.nan, 1500.0, (1.0, 0.0, 1.0), 1.0, "demand"),
        (np.inf, 1500.0, (1.0, 0.0, 1.0), 1.0, "demand"),
        (2e-4, np.nan, (1.0, 0.0, 1.0), 1.0, "speed_rpm"),
        (2e-4, 1500.0, (0.0, 0.0, 1.0), 1.0, "flow_gain"),
        (2e-4, 1500.0, (1.0, -np.inf, 1.0), 1.0, "duration_offset"),
        (2e-4, 1500.0, (1.0, 0.0, np.nan), 1.0, "charge_factor"),
        (2e-4, 1500.0, (1.0, 0.0, 1.0), -1.0, "density"),
    ],
)
def test_bad_numbers_are_refused_by_name(model, demand, speed, parameters, density, name):
    with pytest.raises(ParameterError, match=name):
        model.inverse(demand, speed, CylinderParameters(*parameters), density)


def test_bad_nodes_and_plants_are_refused(plant, model):
    path = LinearPath(*RANGES[0])
    with pytest.raises(ParameterError, match=r"speeds is 3, but must be from 5"):
        ChargeModel.fit(path, plant, speeds=3)
    with pytest.raises(ParameterError, match="lowest speed is 900 rpm"):
        ChargeModel.fit(path, plant, speed_range_rpm=(900.0, 1500.0))
    with pytest.raises(ParameterError, match="conventional"):
        ChargeModel.fit(path, CrankAnglePlant(profile="conventional"))
    with pytest.raises(ParameterError, match=r"position is 1\.2"):
        model.at(1.2, 1500.0)
    with pytest.raises(ParameterError, match="speed_rpm is 1000 rpm"):
        model.charge_at(0.5, 1000.0)


def test_path_with_no_charge_is_refused(plant):
    class Short(LinearPath):
        def at(self, position, speed_rpm, /):
            q, speed = np.broadcast_arrays(position, speed_rpm)
            lift = np.full(q.shape, 0.5)
            return Motions(lift, shortest_deg(lift, speed) + 100.0 * q)

    with pytest.raises(ParameterError, match=r"takes in -?\d.* mg at 1\d\d\d rpm, lift 0.50 mm"):
        ChargeModel.fit(Short(*RANGES[0]), plant, speeds=5, positions=5)


def test_no_finite_number_raises_or_leaves_the_limits(model):
    random = np.random.default_rng(3)
    wide = 10.0 ** random.uniform(-9.0, 9.0, (400, 5)) * random.choice([-1.0, 1.0], (400, 5))
    for demand, speed, gain, factor, density in wide:
        offset = random.uniform(-5e-4, 5e-4)
        parameters = CylinderParameters(abs(gain), offset, abs(factor))
        point = model.inverse(demand, speed, parameters, abs(density))
        assert np.isfinite([*point[:3], *point[4:6]]).all()
        assert np.isfinite(point.shares).all()
        assert 0.5 <= point.lift_mm <= 8.0
        assert 0.0 < point.duration_deg <= model.longest_deg


def test_whole_numbers_are_numbers(model):
    low, high = model.limits(1500)
    assert (low, high) == model.limits(1500.0)
    assert model.inverse(1, 1500, CylinderParameters(1, 0, 1), 1).charge == high


@pytest.mark.parametrize("n", [3, 6])
def test_other_numbers_of_cylinders(n):
    plant = CrankAnglePlant(Engine.paper().replace(n_cylinders=n), oscillation=True)
    model = ChargeModel.fit(LinearPath(1400.0, 1600.0), plant, speeds=5, positions=17)
    parameters = CylinderParameters(0.9, 1e-4, 1.0)
    point = model.inverse(2e-4, 1470.0, parameters)
    charge = delivered(plant, 1470.0, [point], [0.9], [1e-4])
    assert charge == pytest.approx(2e-4, rel=5e-3)
    assert model.n_cylinders == n


def test_the_same_question_has_the_same_answer(model):
    first = model.inverse(2e-4, 1500.0, CylinderParameters(0.9))
    kept = first.shares.copy()
    model.inverse(4e-4, 1400.0)
    again = model.inverse(2e-4, 1500.0, CylinderParameters(0.9))
    assert first[:-1] == again[:-1]
    assert np.array_equal(first.shares, kept)
    assert np.array_equal(again.shares, kept)
    with pytest.raises(ValueError, match="read-only"):
        model.table[0, 0, 0] = 0.0


def test_threads_and_progress_leave_the_result_alone(plant):
    told = []
    path = LinearPath(1400.0, 1600.0)
    one, two = (
        ChargeModel.fit(path, plant, speeds=5, positions=5, threads=t, progress=p)
        for t, p in ((1, lambda *x: told.append(x)), (2, None))
    )
    assert np.array_equal(one.table, two.table)
    done = [x[0] for x in told]
    assert done == sorted(done)
    assert told[-1][0] == told[-1][1]


def test_saved_model_comes_back(model, plant, tmp_path):
    file = tmp_path / "model.nc"
    model.save(file)
    loaded = ChargeModel.load(file, plant)
    assert np.array_equal(loaded.table, model.table)
    assert str(loaded) == str(model)
    assert repr(loaded) == repr(model)
    case = (2.1e-4, 1444.0, CylinderParameters(1.1, 1e-4, 0.98))
    assert loaded.inverse(*case)[:-1] == model.inverse(*case)[:-1]
    assert list(tmp_path.iterdir()) == [file]
    with pytest.raises(ParameterError, match="holds the model of plant"):
        ChargeModel.load(file, CrankAnglePlant())


def test_other_files_are_refused(model, tmp_path):
    file = tmp_path / "other.nc"
    file.write_bytes(b"not a model")
    with pytest.raises(ParameterError, match="does not hold a charge model"):
        ChargeModel.load(file)
    data = model.to_dataset()
    data.attrs["format"] = "another"
    data.to_netcdf(file, engine="scipy")
    with pytest.raises(ParameterError, match="format is 'another'"):
        ChargeModel.load(file)
    damaged = model.to_dataset()  # a copy
    damaged["charge"][2, 2] = np.nan
    damaged.to_netcdf(file, engine="scipy")
    with pytest.raises(ParameterError, match="finite numbers"):
        ChargeModel.load(file)
    model.to_dataset().isel(speed=[0, 1, 2, 4, 5, 6, 7]).to_netcdf(file, engine="scipy")
    with pytest.raises(ParameterError, match="nodes of 1/speed"):
        ChargeModel.load(file)
    with pytest.raises(FileNotFoundError):
        ChargeModel.load(tmp_path / "missing.nc")


def test_dataset_has_units(model):
    data = model.to_dataset()
    assert all(v.attrs["units"] and v.attrs["long_name"] for v in data.variables.values())
    assert data["charge"].shape == (9, 25)


def test_stands_in_for_a_feedforward(model, plant):
    found = model.command(2e-4, 1500.0)
    assert not found.limited
    assert found.charge == pytest.approx(2e-4)
    step = 0.5
    durations = [found.command.duration_deg + x for x in (-step, step)]
    less, more = (
        plant.steady_cycle(1500.0, ValveCommand(found.command.lift_mm, d)).air_charge[0]
        for d in durations
    )
    assert model.sensitivity(2e-4, 1500.0) == pytest.approx((more - less) / (2 * step), rel=0.03)
    assert model.command(1.0, 1500.0).limited


def test_picture_names_its_axes(model):
    ax = model.plot(speeds_rpm=[1300.0, 1700.0])
    assert ax.get_xlabel() == "air charge (mg)"
    assert len(ax.lines) == 2
    assert "flow gain" in ax.get_ylabel()
