import matplotlib
import numpy as np
import pytest
from scipy.optimize import brentq

from camless_ctrl.feedforward_check import check_feedforward, saving
from camless_ctrl.least_loss_motion import FeedforwardOptions
from camless_ctrl.optimal_path import OptimalPath
from plant import (
    CrankAnglePlant,
    Engine,
    MeanValuePlant,
    ParameterError,
    ThrottledMeanValuePlant,
    ValveCommand,
)
from plant.valve import shortest_duration

matplotlib.use("Agg")

SPEEDS = np.linspace(3200.0, 5200.0, 9)


@pytest.fixture(scope="session")
def full_plant():
    return CrankAnglePlant(Engine.paper(), runner=True, oscillation=True)


@pytest.fixture(scope="session")
def check_maps(full_plant):
    return MeanValuePlant.fit(full_plant)


@pytest.fixture(scope="session")
def fast_path(check_maps):
    return OptimalPath.fit(check_maps, speeds_rpm=SPEEDS, nodes=20)


@pytest.fixture(scope="session")
def checked(fast_path, full_plant):
    return check_feedforward(fast_path, full_plant, points=12, seed=4)


@pytest.fixture(scope="session")
def throttled():
    plant = CrankAnglePlant(Engine.paper(), runner=True, profile="conventional")
    return ThrottledMeanValuePlant.fit(plant, speeds_rpm=np.linspace(3000.0, 5200.0, 9))


def test_path_is_within_one_percent_of_the_direct_search_on_the_full_plant(checked):
    assert checked.met
    assert checked.worst <= 0.01
    assert checked.median < 1e-3
    assert checked.excess.min() > -1e-3  # the search is not beaten by more than its grid leaves
    assert np.abs(checked.trim_deg).max() < 1.0  # the map is near the plant
    assert "met" in str(checked)


def test_both_motions_give_the_charge_on_the_full_plant(checked, full_plant):
    for lift, duration, loss in (
        (checked.path_lift_mm, checked.path_duration_deg, checked.path_loss),
        (checked.best_lift_mm, checked.best_duration_deg, checked.best_loss),
    ):
        for k in range(0, checked.charge.size, 4):
            cycle = full_plant.with_resolution(8.0).steady_cycle(
                checked.speed_rpm[k], ValveCommand(float(lift[k]), float(duration[k]))
            )
            assert cycle.air_charge.mean() == pytest.approx(checked.charge[k], rel=3e-4)
            assert cycle.pumping_loss.mean() == pytest.approx(loss[k], rel=1e-3)


def test_no_lift_with_its_duration_by_brent_beats_the_search(checked, full_plant):
    plant = full_plant.with_resolution(3.0)
    valvetrain = plant.engine.valvetrain
    k = int(np.argmin(checked.charge))
    charge, speed = checked.charge[k], float(checked.speed_rpm[k])

    def cycle(lift, duration):
        return plant.steady_cycle(speed, ValveCommand(lift, duration))

    for lift in np.linspace(2.0, 8.0, 13):
        shortest = 6.0 * speed * shortest_duration(lift, valvetrain) * (1.0 + 1e-9)
        durations = np.linspace(shortest, 180.0, 40)
        excess = np.array([cycle(lift, d).air_charge[0] - charge for d in durations])
        above = np.flatnonzero((excess[:-1] < 0.0) & (excess[1:] >= 0.0))
        if not above.size:
            continue
        bracket = durations[above[0]], durations[above[0] + 1]
        duration = brentq(lambda d, u=lift: cycle(u, d).air_charge[0] - charge, *bracket, xtol=1e-4)
        assert cycle(lift, duration).pumping_loss[0] >= checked.best_loss[k] * (1.0 - 1e-3)


def test_a_path_that_is_not_optimal_is_found_out(check_maps, full_plant):
    heavy = FeedforwardOptions(lift_energy_weight=1.0)
    path = OptimalPath.fit(
        check_maps, options=heavy, speeds_rpm=(4000.0, 4300.0, 4600.0, 5000.0), nodes=12
    )
    found = check_feedforward(path, full_plant, points=4, seed=0)
    assert not found.met
    assert found.median > 0.05
    assert "missed at" in str(found)
    k = int(np.argmax(found.excess))
    assert found.path_lift_mm[k] < found.best_lift_mm[k] - 1.0


def test_same_seed_same_points(checked, fast_path, full_plant):
    again = check_feedforward(fast_path, full_plant, points=12, seed=4)
    np.testing.assert_array_equal(again.path_loss, checked.path_loss)
    np.testing.assert_array_equal(again.best_loss, checked.best_loss)
    other = check_feedforward(fast_path, full_plant, points=1, seed=5)
    assert other.speed_rpm[0] != checked.speed_rpm[0]


def test_saving_is_that_of_cycles_of_both_full_plants(fast_path, full_plant, throttled):
    compared = saving(fast_path, full_plant, throttled, speeds_rpm=(3500.0, 5000.0), charges=6)
    data = compared.data
    cam = CrankAnglePlant(Engine.paper(), runner=True, profile="conventional")
    known = 0
    for speed in data["speed_rpm"].values.tolist():
        for charge in data["charge"].values.tolist():
            point = data.sel(speed_rpm=speed, charge=charge)
            if not np.isfinite(point["saving"]):
                continue
            known += 1
            camless = full_plant.steady_cycle(
                speed, ValveCommand(float(point["lift_mm"]), float(point["duration_deg"]))
            )
            other = cam.steady_cycle(
                speed, ValveCommand.conventional(), float(point["throttle_deg"])
            )
            assert camless.air_charge.mean() == pytest.approx(charge, rel=1e-3)
            assert other.air_charge.mean() == pytest.approx(charge, rel=5e-3)
            share = 1.0 - camless.pumping_loss.mean() / other.pumping_loss.mean()
            assert float(point["saving"]) == pytest.approx(share, abs=0.01)
            assert share > 0.0
    assert known >= 8
    assert "on average" in str(compared)


def test_plots(checked):
    import matplotlib.pyplot as plt

    ax = checked.plot()
    drawn = np.concatenate([line.get_ydata() for line in ax.lines])
    np.testing.assert_allclose(np.sort(drawn), np.sort(1e6 * checked.charge))
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[-1] == f"above 1 % ({int((checked.excess > 0.01).sum())})"
    plt.close("all")


def test_plants_that_do_not_fit_are_refused(fast_path, full_plant, throttled):
    cam = CrankAnglePlant(Engine.paper(), runner=True, profile="conventional")
    with pytest.raises(ParameterError, match="must be 'camless'"):
        check_feedforward(fast_path, cam)
    with pytest.raises(ParameterError, match="points"):
        check_feedforward(fast_path, full_plant, points=0)
    with pytest.raises(ParameterError, match="must be 'camless'"):
        saving(fast_path, cam, throttled)
    with pytest.raises(ParameterError, match="different engines"):
        saving(
            fast_path, full_plant.with_engine(Engine.paper().replace(temperature=316.0)), throttled
        )
    with pytest.raises(ParameterError, match="runner is True"):
        saving(fast_path, CrankAnglePlant(Engine.paper(), runner=False), throttled)
    with pytest.raises(ParameterError, match="rising"):
        saving(fast_path, full_plant, throttled, speeds_rpm=(5000.0, 4000.0))
    # A seventh of the flow: the path's durations do not give its charges on this plant.
    weak = full_plant.with_engine(Engine.paper().replace(flow_coefficient=0.0025))
    with pytest.raises(ParameterError, match="gives"):
        check_feedforward(fast_path, weak, points=4)
