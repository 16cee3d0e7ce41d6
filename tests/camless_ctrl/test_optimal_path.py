import matplotlib
import numpy as np
import pytest

from camless_ctrl.least_loss_motion import FeedforwardOptions
from camless_ctrl.optimal_path import OptimalPath
from plant import CrankAnglePlant, Engine, MeanValuePlant, ParameterError
from plant.valve import highest_lift_mm

matplotlib.use("Agg")

AMBIENT = 1e5 * 4e-4 / (287.0 * Engine.paper().temperature)  # kg, density times displacement
SPEEDS = np.linspace(3600.0, 6000.0, 11)


@pytest.fixture(scope="session")
def path_maps():
    return MeanValuePlant.fit(CrankAnglePlant(Engine.paper(), runner=True, oscillation=True))


@pytest.fixture(scope="session")
def path(path_maps):
    """Speeds at which the best lift is continuous."""
    return OptimalPath.fit(path_maps, speeds_rpm=SPEEDS, nodes=20)


@pytest.fixture(scope="session")
def crossing(path_maps):
    """Speeds at which two minima trade places at low demands."""
    return OptimalPath.fit(path_maps, speeds_rpm=np.linspace(2300.0, 2900.0, 6), nodes=29)


def points(path, count, seed=0):
    random = np.random.default_rng(seed)
    speed = random.uniform(path.speeds_rpm[0], path.speeds_rpm[-1], count)
    return random.uniform(0.0, 1.0, count), speed


@pytest.mark.parametrize("name", ["path", "crossing"])
def test_motions_give_the_promised_charge_within_all_limits(name, path_maps, request):
    path = request.getfixturevalue(name)
    position, speed = points(path, 400)
    point = path.at(position, speed)
    low, high = path.limits(speed)
    np.testing.assert_allclose(point.charge, low + position * (high - low), rtol=1e-12)
    reached = path_maps.air_charge(point.lift_mm, point.duration_deg, speed)
    np.testing.assert_allclose(reached, point.charge, rtol=1e-9)
    assert np.all((point.lift_mm >= 0.5) & (point.lift_mm <= 8.0))
    assert np.all(point.duration_deg <= 240.0 * (1.0 + 1e-9))
    slope = path_maps.charge_gradient(point.lift_mm, point.duration_deg, speed).duration
    assert np.all(slope >= 5e-4 * AMBIENT)
    valvetrain = path_maps.engine.valvetrain
    for lift, duration, n in zip(point.lift_mm, point.duration_deg, speed, strict=True):
        assert lift <= highest_lift_mm(duration / (6.0 * n), valvetrain) * (1.0 + 1e-9)


def test_loss_between_the_nodes_is_within_0_3_percent_of_the_least_of_all_lifts(path, path_maps):
    position, speed = points(path, 200, seed=1)
    point = path.at(position, speed)
    loss = path_maps.pumping_loss(point.lift_mm, point.duration_deg, speed)
    lifts = np.linspace(0.5, 8.0, 301)[:, None]
    duration = path_maps.duration_for_charge(point.charge, lifts, speed).duration_deg
    duration = np.where(duration <= 240.0, duration, np.nan)
    every = path_maps.pumping_loss(lifts, duration, speed, outside="nan")
    excess = loss / np.nanmin(every, axis=0) - 1.0
    assert excess.max() < 3e-3
    assert np.median(excess) < 1e-4


def test_every_node_is_proven(path, crossing):
    for made in (path, crossing):
        proof = made.certificates
        assert proof.optimal.all()
        assert proof.gradient.shape == made.charge.shape == made.loss.shape
        assert np.all(proof.given_up > -1e-6)  # no motion beats the proven one
        np.testing.assert_allclose(
            made.loss, proof.optimal_cost * (1.0 + proof.given_up), rtol=1e-12
        )
    bound = path.certificates.optimal_lift_mm > 8.0 - 1e-4
    assert bound.any()
    for i, j in np.argwhere(bound):
        assert "highest lift" in path.certificates.active_names(i, j)


def test_lift_is_continuous_where_the_best_lift_jumps(crossing):
    best = crossing.certificates.optimal_lift_mm
    assert np.abs(np.diff(best, axis=1)).max() > 2.0  # the best lift jumps between nodes
    fine = np.linspace(0.0, 1.0, 4001)
    share = np.ptp(np.array(crossing.limits(2600.0))) / AMBIENT
    steepest = crossing.options.steepest_lift_mm * share  # mm per unit of position
    for speed in (2300.0, 2433.0, 2600.0, 2777.0, 2900.0):
        lift = crossing.at(fine, speed).lift_mm
        assert np.abs(np.diff(lift)).max() <= 1.1 * steepest * (fine[1] - fine[0])
    speeds = np.linspace(2300.0, 2900.0, 2001)
    for position in (0.0, 0.02, 0.05, 0.1):
        lift = crossing.at(position, speeds).lift_mm
        slope = np.diff(lift) / np.diff(np.log(speeds))
        assert np.abs(slope).max() <= 1.1 * crossing.options.steepest_over_speed_mm


def test_slope_of_the_lift_is_continuous(path, crossing):
    for made in (path, crossing):
        speed = float(made.speeds_rpm[:2].mean())
        jumps = []
        for count in (2001, 8001):
            position = np.linspace(0.0, 1.0, count)
            slope = np.gradient(made.at(position, speed).lift_mm, position)
            jumps.append(np.abs(np.diff(slope)).max())
        assert jumps[1] < 0.35 * jumps[0]  # a kink would stay the same, a smooth slope falls 4-fold


def test_duration_rises_smoothly_with_demand(path, crossing):
    fine = np.linspace(0.0, 1.0, 2001)
    for made, speeds in ((path, (3600.0, 4100.0, 6000.0)), (crossing, (2350.0, 2600.0))):
        for speed in speeds:
            duration = made.at(fine, speed).duration_deg
            assert np.abs(np.diff(duration)).max() < 0.5  # deg per 0.05 % of the range


def test_what_continuity_gives_up_is_told_and_is_small_outside_the_crossing(path, crossing):
    assert crossing.certificates.given_up.max() > 5e-3
    assert np.mean(crossing.certificates.given_up > 5e-3) < 0.15
    assert path.certificates.given_up.max() < 5e-3
    assert "given up for continuity" in str(crossing)


def test_a_steeper_path_gives_up_less(path_maps, crossing):
    gentle = OptimalPath.fit(
        path_maps,
        options=FeedforwardOptions(steepest_lift_mm=60.0),
        speeds_rpm=crossing.speeds_rpm,
        nodes=29,
    )
    assert gentle.certificates.given_up.sum() > crossing.certificates.given_up.sum()
    fine = np.linspace(0.0, 1.0, 2001)
    steepest = [
        np.abs(np.gradient(made.at(fine, 2600.0).lift_mm, fine)).max()
        for made in (gentle, crossing)
    ]
    assert steepest[0] < steepest[1]


def test_demand_out_of_reach_is_limited_and_flagged(path):
    low, high = path.limits(4000.0)
    inside = path.command(0.5 * (low + high), 4000.0)
    assert not inside.limited
    assert inside.charge == 0.5 * (low + high)
    for wanted, nearest in ((0.5 * low, low), (0.0, low), (-1.0, low), (1.5 * high, high)):
        command = path.command(wanted, 4000.0)
        assert command.limited
        assert command.charge == nearest
        reached = path.maps.air_charge(
            command.command.lift_mm, command.command.duration_deg, 4000.0
        )
        assert reached == pytest.approx(nearest, rel=1e-9)
    for limit in (low, high):
        assert not path.command(float(limit), 4000.0).limited


def test_lowest_demand_is_a_tenth_of_the_ambient_charge_and_the_highest_is_near_the_largest(path):
    speed = np.linspace(3600.0, 6000.0, 40)
    low, high = path.limits(speed)
    np.testing.assert_allclose(low, 0.1 * AMBIENT, rtol=1e-12)
    lift = np.full((1, 1), 8.0)
    duration = np.linspace(200.0, 240.0, 401)[:, None]
    largest = path.maps.air_charge(lift, duration, speed).max(axis=0)
    assert np.all(high <= largest)
    assert np.all(high >= 0.99 * largest)


def test_position_of_is_the_inverse(path):
    position, speed = points(path, 50)
    point = path.at(position, speed)
    np.testing.assert_allclose(path.position_of(point.charge, speed), position, atol=1e-12)
    assert path.position_of(0.0, 4000.0) < 0.0
    assert path.position_of(1e-3, 4000.0) > 1.0


def test_points_broadcast(path):
    point = path.at(np.linspace(0.0, 1.0, 5), np.array([[3700.0], [5000.0], [6000.0]]))
    assert point.charge.shape == point.lift_mm.shape == point.duration_deg.shape == (3, 5)
    alone = path.at(0.25, 5000.0)
    assert float(alone.lift_mm) == point.lift_mm[1, 1]
    assert float(alone.duration_deg) == pytest.approx(point.duration_deg[1, 1], rel=1e-12)


def test_options_shape_the_path(path_maps):
    options = FeedforwardOptions(
        highest_lift_mm=5.0,
        latest_seating_deg=150.0,
        least_dwell=3e-4,
        lowest_charge_share=0.2,
    )
    made = OptimalPath.fit(
        path_maps, options=options, speeds_rpm=(2000.0, 2200.0, 2400.0, 2600.0), nodes=12
    )
    assert made.lift_mm.max() <= 5.0
    assert made.duration_deg.max() <= 150.0
    assert made.charge.min() == pytest.approx(0.2 * AMBIENT, rel=1e-12)
    position, speed = points(made, 100)
    point = made.at(position, speed)
    valvetrain = path_maps.engine.valvetrain
    time = point.duration_deg / (6.0 * speed) - 3e-4
    for lift, t in zip(point.lift_mm, time, strict=True):
        assert lift <= highest_lift_mm(t, valvetrain) * (1.0 + 1e-9)
    assert made.command(450e-6, 2400.0).limited
    moved = OptimalPath.fit(
        path_maps,
        options=FeedforwardOptions(lift_move_weight=1e3, reference_lift_mm=4.0),
        speeds_rpm=(2000.0, 2200.0, 2400.0, 2600.0),
        nodes=12,
    )
    inner = moved.at(0.5, moved.speeds_rpm)
    np.testing.assert_allclose(inner.lift_mm, 4.0, atol=0.05)


def test_saved_path_is_read_back_exactly(path, path_maps, tmp_path):
    file = tmp_path / "path.nc"
    path.save(file)
    assert [f.name for f in tmp_path.iterdir()] == ["path.nc"]
    read = OptimalPath.load(file, path_maps)
    assert read.options == path.options
    position, speed = points(path, 60)
    for ours, theirs in zip(path.at(position, speed), read.at(position, speed), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert read.to_dataset().identical(path.to_dataset())
    assert np.array_equal(read.certificates.active, path.certificates.active)
    assert np.array_equal(read.certificates.status, path.certificates.status)


def test_files_that_do_not_fit_are_refused(path, path_maps, tmp_path):
    file = tmp_path / "path.nc"
    path.save(file)
    other = MeanValuePlant.fit(
        CrankAnglePlant(Engine.paper(), runner=False), most_points=600, tolerance=0.5
    )
    with pytest.raises(ParameterError, match="fitted to the maps"):
        OptimalPath.load(file, other)
    path_maps.save(tmp_path / "maps.nc")
    with pytest.raises(ParameterError, match="the format is"):
        OptimalPath.load(tmp_path / "maps.nc", path_maps)
    (tmp_path / "text.nc").write_text("no path")
    with pytest.raises(ParameterError, match="does not hold an optimal path"):
        OptimalPath.load(tmp_path / "text.nc", path_maps)
    with pytest.raises(FileNotFoundError):
        OptimalPath.load(tmp_path / "none.nc", path_maps)
    data = path.to_dataset()
    data["lift_coefficient"][0, 0] = np.nan
    data.to_netcdf(tmp_path / "damaged.nc", engine="scipy")
    with pytest.raises(ParameterError, match="damaged"):
        OptimalPath.load(tmp_path / "damaged.nc", path_maps)


def test_dataset_has_units(path):
    data = path.to_dataset()
    units = {"lift_mm": "mm", "duration_deg": "deg", "charge": "kg", "loss": "J", "given_up": "1"}
    for name, unit in units.items():
        assert data[name].attrs["units"] == unit
        assert data[name].dims == ("speed", "position")
    assert all("units" in data[name].attrs for name in data.variables)


def test_wrong_input_is_named(path, path_maps):
    with pytest.raises(ParameterError, match=r"position is 1\.1"):
        path.at(1.1, 4000.0)
    with pytest.raises(ParameterError, match="position is nan"):
        path.at([0.2, float("nan")], 4000.0)
    with pytest.raises(ParameterError, match=r"speed_rpm is 700 .*more speeds"):
        path.limits(700.0)
    with pytest.raises(ParameterError, match="charge is nan"):
        path.command(float("nan"), 4000.0)
    with pytest.raises(ParameterError, match="rising speeds"):
        OptimalPath.fit(path_maps, speeds_rpm=(3000.0, 2000.0, 4000.0, 5000.0))
    with pytest.raises(ParameterError, match="nodes"):
        OptimalPath.fit(path_maps, nodes=2)
    with pytest.raises(ParameterError, match="lowest_charge_share"):
        OptimalPath.fit(
            path_maps, options=FeedforwardOptions(latest_seating_deg=60.0), speeds_rpm=SPEEDS
        )


def test_progress_counts_the_nodes(path_maps):
    seen = []
    made = OptimalPath.fit(
        path_maps,
        speeds_rpm=(4000.0, 4200.0, 4400.0, 4600.0),
        nodes=8,
        progress=lambda done, count: seen.append((done, count)),
    )
    assert seen == [(k + 1, made.charge.size) for k in range(32)]


def test_plots_draw_what_the_path_holds(path):
    import matplotlib.pyplot as plt

    ax = path.plot_lift(speeds_rpm=[4000.0])
    x, y = ax.lines[0].get_data()
    np.testing.assert_allclose(y, path.at(path.position_of(1e-6 * x, 4000.0), 4000.0).lift_mm)
    assert len(path.plot_duration().lines) == 2  # of the usual speeds the path covers two
    for draw in (path.plot_lift_contours, path.plot_duration_contours, path.plot_given_up):
        assert draw().get_ylabel() == "air charge (mg per event)"
    plt.close("all")
