import matplotlib
import numpy as np
import pytest
from matplotlib.text import Text
from mpl_toolkits.mplot3d import Axes3D

from plant import CrankAnglePlant, ParameterError, ValveCommand
from plant._map_plots import CLEAR_SHARE, contours, draw, surface
from plant.mean_value import MeanValuePlant

matplotlib.use("agg")

PLANT = CrankAnglePlant()
UNITS = {"charge": "mg per event", "loss": "J per event", "specific": "J/g"}


@pytest.fixture(scope="module")
def maps():
    return MeanValuePlant.fit(PLANT)


@pytest.fixture(autouse=True)
def close_figures():
    yield
    matplotlib.pyplot.close("all")


def labels(ax):
    return ax.get_legend_handles_labels()[1]


def line(ax, start):
    return next(line for line in ax.lines if str(line.get_label()).startswith(start))


@pytest.fixture
def drawn(monkeypatch):
    """The arrays that surfaces are drawn from."""
    calls = []
    plot_surface = Axes3D.plot_surface

    def record(self, x, y, z, **options):
        calls.append((x, y, z))
        return plot_surface(self, x, y, z, **options)

    monkeypatch.setattr(Axes3D, "plot_surface", record)
    return calls


# -- contours ----------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", list(UNITS))
@pytest.mark.parametrize("speed", [750.0, 6000.0])
def test_contours_name_units_speed_and_regions(maps, quantity, speed):
    ax = contours(maps, quantity, speed)
    assert ax.get_xlabel() == "duration (deg)"
    assert ax.get_ylabel() == "lift (mm)"
    assert f"at {speed:g} rpm" in ax.get_title(loc="left")
    assert UNITS[quantity] in ax.figure.axes[1].get_ylabel()
    assert "infeasible: too short for the lift" in labels(ax)
    assert "lift saturation: 98 % of charge at 8 mm" in labels(ax)
    assert ("left out: charge below 5 % of largest" in labels(ax)) == (quantity == "specific")


@pytest.mark.parametrize("kind", ["contour", "surface"])
@pytest.mark.parametrize("quantity", list(UNITS))
def test_legend_and_labels_are_on_the_figure_and_off_the_data(maps, kind, quantity):
    ax = draw(maps, quantity, 1500.0, kind=kind)
    figure = ax.figure
    figure.canvas.draw()
    legend = ax.get_legend().get_window_extent()
    if kind == "contour":
        assert legend.y1 < ax.get_window_extent().y0
    texts = [child for child in ax.get_children() if isinstance(child, Text)]
    texts += [ax.xaxis.label, ax.yaxis.label, figure.axes[-1].yaxis.label]
    if kind == "surface":
        texts.append(ax.zaxis.label)
    for box in [legend, *(t.get_window_extent() for t in texts if t.get_text())]:
        assert box.x0 >= 0.0
        assert box.y0 >= 0.0
        assert box.x1 <= figure.bbox.width
        assert box.y1 <= figure.bbox.height


@pytest.mark.parametrize("speed", [750.0, 4500.0])
def test_the_saturation_line_is_where_the_charge_has_its_share(maps, speed):
    duration, lift = line(contours(maps, "charge", speed), "lift saturation").get_data()
    known = np.isfinite(lift)
    duration, lift = duration[known], lift[known]
    assert duration.size > 100
    # From the first duration at which the full lift takes in a clear charge.
    full = maps.air_charge(8.0, duration, speed)
    assert (full >= CLEAR_SHARE * maps.largest_charge(speed)).all()
    np.testing.assert_allclose(maps.air_charge(lift, duration, speed), 0.98 * full, rtol=1e-9)


def test_the_reversal_line_is_where_the_charge_is_flat_in_duration(maps):
    duration, lift = line(contours(maps, "loss", 3000.0), "flow reversal").get_data()
    known = np.isfinite(duration)
    assert 20 < known.sum() < lift.size
    slope = maps.charge_gradient(lift[known], duration[known], 3000.0).duration
    assert np.abs(slope).max() < 1e-6 * maps.largest_charge(3000.0)


def test_without_flow_reversal_there_is_no_line_of_it(maps):
    assert not any("reversal" in label for label in labels(contours(maps, "charge", 6000.0)))


def test_contours_leave_the_infeasible_corner_out(maps):
    ax = contours(maps, "charge", 6000.0)
    filled = next(c for c in ax.collections if hasattr(c, "levels") and c.filled)
    points = np.concatenate([path.vertices for path in filled.get_paths() if len(path.vertices)])
    shortest = maps.region.shortest_deg(points[:, 1], 6000.0)
    assert (points[:, 0] >= shortest - 1e-6).all()


# -- surfaces ----------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", list(UNITS))
@pytest.mark.parametrize("speed", [1500.0, 6000.0])
def test_a_surface_holds_feasible_points_only_and_says_what_it_leaves_out(
    maps, drawn, quantity, speed
):
    ax = surface(maps, quantity, speed)
    ((duration, lift, value),) = drawn
    assert maps.region.feasible(lift, duration, speed).all()
    assert np.isfinite(value).all()
    assert ax.get_xlabel() == "duration (deg)"
    assert ax.get_ylabel() == "lift (mm)"
    assert UNITS[quantity] in ax.get_zlabel()
    assert "infeasible: too short for the lift" in labels(ax)
    assert ("left out: charge below 5 % of largest" in labels(ax)) == (quantity == "specific")
    # It reaches from the limit to the longest duration, unless it says that it does not.
    if quantity != "specific":
        np.testing.assert_allclose(duration[:, 0], maps.region.shortest_deg(lift[:, 0], speed))
    np.testing.assert_allclose(duration[:, -1], 280.0)


@pytest.mark.parametrize(("quantity", "lift"), [("charge", 3.0), ("loss", 6.0), ("specific", 2.0)])
def test_a_surface_shows_the_full_plant(maps, drawn, quantity, lift):
    surface(maps, quantity, 1500.0)
    ((durations, lifts, values),) = drawn
    row = int(np.argmin(np.abs(lifts[:, 0] - lift)))
    for column in (10, 30):
        cycle = PLANT.steady_cycle(1500.0, ValveCommand(lifts[row, column], durations[row, column]))
        charge, loss = cycle.air_charge.mean(), cycle.pumping_loss.mean()
        truth = {"charge": 1e6 * charge, "loss": loss, "specific": loss / (1e3 * charge)}
        assert values[row, column] == pytest.approx(truth[quantity], rel=0.02)


def test_the_specific_loss_is_shown_where_the_charge_is_clear_only(maps, drawn):
    for speed in (750.0, 4500.0):
        surface(maps, "specific", speed)
        durations, lifts, _ = drawn[-1]
        least = CLEAR_SHARE * maps.largest_charge(speed)
        assert (maps.air_charge(lifts, durations, speed) >= least * (1.0 - 1e-5)).all()
        # The edge is where the charge is just clear, or at the limit of the actuator.
        edge = maps.air_charge(lifts[:, 0], durations[:, 0], speed)
        at_limit = np.isclose(durations[:, 0], maps.region.shortest_deg(lifts[:, 0], speed))
        np.testing.assert_allclose(edge[~at_limit], least, rtol=1e-6)


def test_the_specific_loss_of_figure_5(maps):
    # 3.55 J for 171 mg at 2 mm and 99 deg, 1500 rpm: between the contours around it.
    ax = contours(maps, "specific", 1500.0)
    filled = next(c for c in ax.collections if hasattr(c, "levels") and c.filled)
    holds = [
        (low, high)
        for low, high, path in zip(
            filled.levels[:-1], filled.levels[1:], filled.get_paths(), strict=True
        )
        if path.contains_point((99.0, 2.0))
    ]
    ((low, high),) = holds
    assert 0.98 * low <= 3.55 / 0.171 <= 1.02 * high


def test_a_surface_goes_into_axes_that_are_given(maps):
    figure = matplotlib.pyplot.figure()
    given = figure.add_subplot(1, 2, 2, projection="3d")
    assert surface(maps, "loss", 1500.0, given) is given


def test_what_is_asked_for_wrongly_is_named(maps):
    with pytest.raises(ParameterError, match=r"quantity is 'los'.*did you mean 'loss'"):
        contours(maps, "los", 1500.0)
    with pytest.raises(ParameterError, match="kind is 'flat', but must be one of contour, surface"):
        draw(maps, "loss", 1500.0, kind="flat")
    with pytest.raises(ParameterError, match="speed_rpm"):
        draw(maps, "charge", 7000.0, kind="surface")
    with pytest.raises(ParameterError, match="projection='3d'"):
        surface(maps, "charge", 1500.0, matplotlib.pyplot.figure().add_subplot())
    assert isinstance(draw(maps, "charge", 1500.0, kind="surface"), Axes3D)
    assert not isinstance(draw(maps, "charge", 1500.0), Axes3D)
