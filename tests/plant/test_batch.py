"""Batches of steady cycles: what they broadcast, label, refuse, and the physics they scale by."""

from __future__ import annotations

import threading
import tracemalloc

import numpy as np
import pytest
import xarray as xr

from plant import (
    CrankAnglePlant,
    Engine,
    InfeasibleProfileError,
    ParameterError,
    SimulationError,
    ValveCommand,
    engine_fields,
    replace_engine_fields,
)

ENGINE = Engine(cylinder_flow_factors=(1.0, 0.9, 1.1, 1.0))


def random_points(seed, count):
    rng = np.random.default_rng(seed)
    opening = rng.choice([-40.0, 0.0, 20.0], count)
    return {
        "speed_rpm": rng.uniform(750.0, 6000.0, count),
        "lift_mm": rng.uniform(0.5, 6.0, count),
        "duration_deg": rng.uniform(180.0, 320.0, count),
        "opening_deg": opening,
        "throttle_deg": rng.choice([16.0, 25.0, 90.0], count),
    }


@pytest.mark.parametrize(
    "plant",
    [
        CrankAnglePlant(),
        CrankAnglePlant(ENGINE, oscillation=True),
        CrankAnglePlant(profile="conventional"),
        CrankAnglePlant(Engine(n_cylinders=1), orifice="exact", runner=False),
    ],
    ids=repr,
)
def test_every_point_is_its_steady_cycle(plant):
    points = random_points(1, 12)
    dataset = plant.steady_cycles(**points, on_infeasible="limit")
    for k in range(12):
        command = ValveCommand(*(points[x][k] for x in ("lift_mm", "duration_deg", "opening_deg")))
        cycle = plant.steady_cycle(
            points["speed_rpm"][k], command, points["throttle_deg"][k], on_infeasible="limit"
        )
        point = dataset.isel(dim_0=k)
        assert np.array_equal(point["air_charge"], cycle.air_charge)
        assert np.array_equal(point["pumping_loss"], cycle.pumping_loss)
        assert float(point["delivered_lift_mm"]) == cycle.delivered_lift_mm[0]
        assert float(point["residual"]) == cycle.residual
        assert float(point["cycles"]) == cycle.cycles


@pytest.mark.parametrize("name", engine_fields(ENGINE))
def test_every_engine_parameter_can_vary(name):
    plant = CrankAnglePlant(ENGINE, oscillation=True)
    value = dict(zip(engine_fields(ENGINE), plant._row[0], strict=True))[name]
    factors = np.array([0.98, 0.99, 1.0])
    dataset = plant.steady_cycles(2200.0, 3.0, 200.0, 0.0, 45.0, parameters={name: value * factors})
    for k, factor in enumerate(factors):
        engine = replace_engine_fields(ENGINE, {name: value * factor})
        other = CrankAnglePlant(engine, oscillation=True)
        cycle = other.steady_cycle(2200.0, ValveCommand(3.0, 200.0), 45.0)
        assert np.array_equal(dataset["air_charge"][k], cycle.air_charge)
        assert np.array_equal(dataset["pumping_loss"][k], cycle.pumping_loss)


S = 2.0
SCALINGS = {
    # (parameters that are scaled, and by how much; of the speed; of charge; of loss)
    "pressures": (
        {"ambient_pressure": S, "exhaust_pressure": S, "flow_coefficient": S, "throttle.scale": S},
        1.0,
        S,
        S,
    ),
    "gas": (
        {
            "temperature": S,
            "flow_coefficient": 1.0 / S,
            "throttle.scale": 1.0 / S,
            "runner_constant": S,
        },
        1.0,
        1.0 / S,
        1.0,
    ),
    "volumes": (
        {
            "manifold_volume": S,
            "displaced_volume": S,
            "clearance_volume": S,
            "flow_coefficient": S,
            "throttle.scale": S,
        },
        1.0,
        S,
        S,
    ),
    "time": (
        {
            "flow_coefficient": S,
            "throttle.scale": S,
            "runner_constant": 1.0 / S**2,
            "helmholtz.low_speed_rpm": S,
            "helmholtz.high_speed_rpm": S,
            "helmholtz.low_speed_frequency_hz": S,
            "helmholtz.high_speed_frequency_hz": S,
            "valvetrain.opening_slope_mm_s": S,
            "valvetrain.closing_slope_mm_s": S,
            "valvetrain.seating_slope_mm_s": S,
            "valvetrain.seating_duration": 1.0 / S,
        },
        S,
        1.0,
        1.0,
    ),
    "lift": (
        {
            "flow_coefficient": 1.0 / S,
            "valvetrain.opening_slope_mm_s": S,
            "valvetrain.closing_slope_mm_s": S,
            "valvetrain.seating_slope_mm_s": S,
            "valvetrain.maximum_lift_mm": S,
        },
        1.0,
        1.0,
        1.0,
    ),
}


@pytest.mark.parametrize("law", SCALINGS)
def test_similar_engines_have_similar_cycles(law):
    """Eq. 1 to 20 in units of other pressure, gas, volume, time or lift: the same numbers."""
    factors, speed, charge, loss = SCALINGS[law]
    plant = CrankAnglePlant(resolution=4.0)
    fields = dict(zip(engine_fields(plant.engine), plant._row[0], strict=True))
    points = {"lift_mm": [2.0, 4.0], "duration_deg": [150.0, 300.0], "throttle_deg": [90.0, 20.0]}
    for rpm in (1200.0, 2500.0):
        base = plant.steady_cycles(rpm, **points)
        lift = [(S if law == "lift" else 1.0) * x for x in points["lift_mm"]]
        similar = plant.steady_cycles(
            speed * rpm,
            **{**points, "lift_mm": lift},
            parameters={name: fields[name] * factor for name, factor in factors.items()},
        )
        assert similar["air_charge"].values == pytest.approx(
            charge * base["air_charge"].values, rel=2e-6
        )
        assert similar["pumping_loss"].values == pytest.approx(
            loss * base["pumping_loss"].values, rel=2e-5
        )


def test_plain_arrays_broadcast_as_in_numpy():
    plant = CrankAnglePlant()
    dataset = plant.steady_cycles(
        [[1500.0], [3000.0]],
        [2.0, 3.0, 4.0],
        200.0,
        parameters={"temperature": [[[290.0]], [[316.0]]]},
    )
    assert dataset["air_charge"].dims == ("dim_0", "dim_1", "dim_2", "cylinder")
    assert dataset["air_charge"].shape == (2, 2, 3, 4)
    assert dataset["delivered_lift_mm"].shape == (2, 2, 3)
    assert dataset["speed_rpm"].dims == ("dim_1",)
    assert dataset["temperature"].dims == ("dim_0",)
    hot = CrankAnglePlant(Engine(temperature=316.0)).steady_cycle(3000.0, ValveCommand(4.0, 200.0))
    assert np.array_equal(dataset["air_charge"][1, 1, 2], hot.air_charge)


def test_a_single_point_has_no_dimension_but_the_cylinders():
    dataset = CrankAnglePlant().steady_cycles(1500.0, 3.0, 189.0)
    assert dataset["air_charge"].dims == ("cylinder",)
    assert dataset["cycles"].dims == ()


def test_named_dimensions_and_labels_are_kept():
    plant = CrankAnglePlant()
    speed = xr.DataArray([1500.0, 3000.0], dims="speed", coords={"speed": ["slow", "fast"]})
    lift = xr.DataArray([2.0, 3.0, 4.0], dims="lift_mm", coords={"lift_mm": [2.0, 3.0, 4.0]})
    dataset = plant.steady_cycles(speed, lift, 200.0)
    assert dict(dataset.sizes) == {"speed": 2, "lift_mm": 3, "cylinder": 4}
    cycle = plant.steady_cycle(3000.0, ValveCommand(4.0, 200.0))
    found = dataset["air_charge"].sel(speed="fast", lift_mm=4.0)
    assert np.array_equal(found, cycle.air_charge)
    named = plant.steady_cycles(
        [[1500.0], [3000.0]], [2.0, 3.0, 4.0], 200.0, dims=("speed_rpm", "lift_mm")
    )
    assert np.array_equal(named["air_charge"].sel(speed_rpm=3000.0, lift_mm=4.0), cycle.air_charge)


def test_cylinders_may_have_a_command_each():
    plant = CrankAnglePlant()
    durations = xr.DataArray([[180.0, 190.0, 200.0, 210.0], [150.0] * 4], dims=("case", "cylinder"))
    dataset = plant.steady_cycles(2000.0, 3.0, durations, throttle_deg=25.0)
    for case in range(2):
        commands = [ValveCommand(3.0, d) for d in durations.values[case]]
        cycle = plant.steady_cycle(2000.0, commands, 25.0)
        assert np.array_equal(dataset["air_charge"][case], cycle.air_charge)
    assert dataset["delivered_lift_mm"].dims == ("case", "cylinder")


def test_everything_says_its_name_and_unit():
    dataset = CrankAnglePlant().steady_cycles(
        [1500.0], 3.0, 189.0, parameters={"valvetrain.opening_slope_mm_s": 3000.0}, on_error="nan"
    )
    for name, variable in dataset.variables.items():
        assert variable.attrs["long_name"], name
        assert variable.attrs["units"], name
    assert dataset["valvetrain.opening_slope_mm_s"].attrs["units"] == "mm/s"


def test_means_are_means():
    plant = CrankAnglePlant(ENGINE)
    each = plant.steady_cycles([1500.0, 3000.0], 3.0, 189.0)
    mean = plant.steady_cycles([1500.0, 3000.0], 3.0, 189.0, per_cylinder=False)
    assert mean["air_charge"].values == pytest.approx(
        each["air_charge"].values.mean(axis=1), rel=1e-15
    )
    assert mean["air_charge"].dims == ("dim_0",)


def test_threads_do_not_change_the_results():
    points = random_points(2, 60)
    plant = CrankAnglePlant()
    one, two = (
        plant.steady_cycles(**points, on_infeasible="limit", threads=threads) for threads in (1, 2)
    )
    xr.testing.assert_identical(one, two)


# -- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "options", "error", "fragments"),
    [
        ((1500.0, 3.0, [200.0, 400.0]), {}, ParameterError, ("dim_0=1", "duration_deg is 400 deg")),
        (([1500.0, 0.0], 3.0, 200.0), {}, ParameterError, ("dim_0=1", "speed_rpm is 0 rpm")),
        ((1500.0, [3.0, 9.0], 200.0), {}, ParameterError, ("lift_mm 9", "lift_mm is 9 mm")),
        ((1500.0, 3.0, 200.0, [0.0, 190.0]), {}, ParameterError, ("opening_deg 190", "[-90, 180)")),
        ((1500.0, 3.0, 200.0, 0.0, [9.0]), {}, ParameterError, ("throttle_deg is 9 deg",)),
        ((1500.0, 3.0, [np.nan]), {}, ParameterError, ("duration_deg is nan",)),
        (
            (6000.0, 8.0, [[200.0, 60.0]]),
            {},
            InfeasibleProfileError,
            ("dim_0=0, dim_1=1", "speed_rpm 6000", "cannot reach 8 mm"),
        ),
        (
            (3000.0, 3.0, 189.0),
            {"parameters": {"runner_area": [1.43e-3, 1.43e-4]}},
            SimulationError,
            ("dim_0=1", "runner_area 0.000143", "fell below zero"),
        ),
        (
            (3000.0, 3.0, 189.0),
            {"parameters": {"runner_area": [1.43e-3, -1.0]}},
            ParameterError,
            ("dim_0=1", "runner_area is -1 m2"),
        ),
        (
            (3000.0, 3.0, 189.0),
            {"parameters": {"temperature": [290.0, np.nan, 280.0]}},
            ParameterError,
            ("dim_0=1", "temperature is nan"),
        ),
        (
            (3000.0, 3.0, 189.0),
            {"parameters": {"helmholtz.low_speed_rpm": [1500.0, 3500.0]}},
            ParameterError,
            ("dim_0=1", "high_speed_rpm is 3000 rpm"),
        ),
        (
            (3000.0, 3.0, 189.0),
            {"parameters": {"temprature": 1.0}},
            ParameterError,
            ("did you mean",),
        ),
        ((3000.0, 3.0, []), {}, ParameterError, ("no operating point",)),
        (([1.0, 2.0], 3.0, [1.0, 2.0, 3.0]), {}, ParameterError, ("duration_deg has 3", "another")),
        ((3000.0, "3", 189.0), {}, ParameterError, ("lift_mm holds", "numbers")),
        ((3000.0, 3.0, 189.0), {"threads": 0}, ParameterError, ("threads is 0",)),
        ((3000.0, 3.0, 189.0), {"on_error": "ignore"}, ParameterError, ("on_error is 'ignore'",)),
        (([1500.0], 3.0, 189.0), {"dims": ("a", "b")}, ParameterError, ("1 different names",)),
        (
            (xr.DataArray([1500.0] * 4, dims="cylinder"), 3.0, 189.0),
            {},
            ParameterError,
            ("speed_rpm varies along cylinder",),
        ),
        (
            (1500.0, xr.DataArray([3.0] * 3, dims="cylinder"), 189.0),
            {},
            ParameterError,
            ("3 cylinders", "engine has 4"),
        ),
        (
            (
                xr.DataArray([1500.0], dims="a", coords={"a": [1]}),
                xr.DataArray([3.0], dims="a", coords={"a": [2]}),
                189.0,
            ),
            {},
            ParameterError,
            ("another coordinate a",),
        ),
    ],
)
def test_a_point_that_cannot_be_is_named(points, options, error, fragments):
    with pytest.raises(error) as e:
        CrankAnglePlant().steady_cycles(*points, **options)
    for fragment in fragments:
        assert fragment in str(e.value)


def test_on_request_points_that_fail_are_nan_and_say_why():
    dataset = CrankAnglePlant().steady_cycles(
        [1500.0, 6000.0, -1.0, 3000.0],
        8.0,
        [200.0, 60.0, 200.0, 200.0],
        parameters={"runner_area": [1.43e-3, 1.43e-3, 1.43e-3, 1.43e-4]},
        on_error="nan",
    )
    meanings = dataset["status"].attrs["flag_meanings"].split()
    assert [meanings[k] for k in dataset["status"].values] == [
        "ok",
        "infeasible_profile",
        "out_of_range",
        "runner_collapsed",
    ]
    for name in ("air_charge", "pumping_loss", "delivered_lift_mm", "residual", "cycles"):
        bad = np.isnan(dataset[name].values.reshape(4, -1)).all(axis=1)
        assert bad.tolist() == [False, True, True, True]


@pytest.mark.parametrize("profile", ["camless", "conventional"])
@pytest.mark.parametrize("on_infeasible", ["raise", "limit"])
def test_a_batch_refuses_what_a_steady_cycle_refuses(profile, on_infeasible):
    rng = np.random.default_rng(3)
    count = 150
    points = {
        "speed_rpm": rng.choice(
            [-1.0, 0.0, 1500.0, 6000.0, 2e4, 2.1e4], count, p=[0.05, 0.05, 0.4, 0.4, 0.05, 0.05]
        ),
        "lift_mm": rng.choice([-1.0, 0.0, 0.2, 0.3, 3.0, 8.0, 8.1], count),
        "duration_deg": rng.choice([0.0, 20.0, 60.0, 100.0, 180.0, 300.0, 360.0, 361.0], count),
        "opening_deg": rng.choice(
            [-91.0, -90.0, -20.0, 0.0, 60.0, 179.0, 180.0],
            count,
            p=[0.05, 0.1, 0.2, 0.4, 0.1, 0.1, 0.05],
        ),
        "throttle_deg": rng.choice([9.0, 15.0, 90.0, 91.0], count, p=[0.1, 0.3, 0.5, 0.1]),
    }
    plant = CrankAnglePlant(profile=profile, runner=False)
    status = plant.steady_cycles(**points, on_infeasible=on_infeasible, on_error="nan")[
        "status"
    ].values
    for k in range(count):
        speed, lift, duration, opening, throttle = (float(x[k]) for x in points.values())
        try:
            plant.steady_cycle(
                speed, ValveCommand(lift, duration, opening), throttle, on_infeasible=on_infeasible
            )
            accepted = 0
        except InfeasibleProfileError:
            accepted = 6
        except ParameterError:
            accepted = 5
        assert status[k] == accepted, (speed, lift, duration, opening, throttle)
    assert {0, 5} <= set(status.tolist())


def test_interruption_leaves_nothing_behind():
    plant = CrankAnglePlant()
    before = threading.active_count()

    def interrupt(done, count):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plant.steady_cycles(
            1500.0, 3.0, np.linspace(150.0, 200.0, 500), threads=2, progress=interrupt
        )
    assert threading.active_count() == before
    calls = []
    plant.steady_cycles(
        1500.0,
        3.0,
        np.linspace(150.0, 200.0, 50),
        threads=2,
        progress=lambda *call: calls.append(call),
    )
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    assert calls[-1] == (50, 50)


def test_memory_is_that_of_the_result():
    """20 000 points with shut valves, and a parameter that varies: no table of all engines."""
    plant = CrankAnglePlant()
    shut = np.zeros((200, 1))
    plant.steady_cycles(1500.0, shut[:1], 100.0, parameters={"temperature": [290.0]})
    tracemalloc.start()
    try:
        dataset = plant.steady_cycles(
            1500.0, shut, 100.0, parameters={"temperature": np.linspace(280.0, 300.0, 100)}
        )
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    table = 20_000 * 8 * len(engine_fields(plant.engine))
    assert dataset.nbytes > 20_000 * 8 * 11
    assert peak < dataset.nbytes + 0.5 * table
