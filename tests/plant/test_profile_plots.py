import matplotlib
import numpy as np
import pytest

from plant import ParameterError, ValveCommand, Valvetrain
from plant.profile_plots import plot_valve_profiles

matplotlib.use("agg")

SLOPE, SEATING, LAMBDA = 3500.0, 200.0, 0.3  # mm/s, mm/s, 1; seating lasts 1 ms
DELIVERED_AT_6000 = (90.0 / 36000.0 - 1e-3 * (1.0 - SEATING / SLOPE)) * SLOPE / (2 * (1 - LAMBDA))


@pytest.fixture(autouse=True)
def close_figures():
    yield
    matplotlib.pyplot.close("all")


def line(ax, start):
    return next(line for line in ax.lines if str(line.get_label()).startswith(start))


def eq_20(time, lift, duration):
    """Lift of Eq. 20 for equal slopes, written anew: rise, two exponentials, fall, seating."""
    rise = (1.0 - LAMBDA) * lift / SLOPE
    fall = ((1.0 - LAMBDA) * lift - SEATING * 1e-3) / SLOPE
    dwell = duration - rise - fall - 1e-3
    if time < 0.0 or time >= duration:
        return 0.0
    if time < rise:
        return SLOPE * time
    soft = LAMBDA * lift
    if time < rise + dwell / 2:
        return lift - soft * np.exp(-SLOPE / soft * (time - rise))
    if time < rise + dwell:
        return lift - soft * np.exp(-SLOPE / soft * (rise + dwell - time))
    if time < duration - 1e-3:
        return (1.0 - LAMBDA) * lift - SLOPE * (time - rise - dwell)
    return SEATING * (duration - time)


@pytest.mark.parametrize(("speed", "opening"), [(750.0, 0.0), (1500.0, -10.0), (3000.0, 0.0)])
def test_a_curve_is_eq_20(speed, opening):
    ax = plot_valve_profiles(ValveCommand(7.0, 189.0, opening), [speed])
    angle, lift = line(ax, f"{speed:g} rpm").get_data()
    time = (angle - opening) / (6.0 * speed)
    expected = [eq_20(t, 7.0, 189.0 / (6.0 * speed)) for t in time]
    # At 1 us from a corner the branches differ by less than a slope times that.
    np.testing.assert_allclose(lift, expected, atol=1e-6)
    assert lift.max() == pytest.approx(7.0, rel=1e-2)


def test_chosen_angles_at_1500_rpm():
    # 9 deg is 1 ms. The ramp ends at 4.9 mm after 1.4 ms; the seating starts at 0.2 mm.
    ax = plot_valve_profiles(ValveCommand(7.0, 189.0), [1500.0], conventional=False)
    angle, lift = line(ax, "1500 rpm").get_data()
    for at, expected in ((0.0, 0.0), (9.0, 3.5), (12.6, 4.9), (90.0, 7.0), (180.0, 0.2)):
        assert np.interp(at, angle, lift) == pytest.approx(expected, abs=2e-3)
    assert lift[angle >= 189.0].max() == 0.0


def test_higher_speeds_give_flatter_flanks():
    # Figure 3: slopes are fixed in time.
    ax = plot_valve_profiles(ValveCommand(7.0, 189.0))
    at = [np.interp(10.0, *line(ax, f"{n} rpm").get_data()) for n in (750, 1500, 3000, 6000)]
    assert at[1:] == pytest.approx([3500.0 * 10 / 9000, 3500.0 * 10 / 18000, 3500.0 * 10 / 36000])
    assert at[0] > at[1]


def test_a_limited_profile_is_drawn_and_named_with_the_lift_that_is_delivered():
    ax = plot_valve_profiles(ValveCommand(7.0, 90.0))
    curve = line(ax, "6000 rpm")
    # With no dwell the valve turns round where the ramp ends.
    peak = (1.0 - LAMBDA) * DELIVERED_AT_6000
    assert curve.get_label() == (
        f"6000 rpm: limited to {DELIVERED_AT_6000:.2f} of 7 mm, peak {peak:.2f} mm"
    )
    assert curve.get_ydata().max() == pytest.approx(peak, abs=1e-9)
    assert [t.get_text() for t in ax.get_legend().get_texts()][:2] == ["750 rpm", "1500 rpm"]
    assert line(ax, "750 rpm").get_ydata().max() == pytest.approx(7.0, abs=1e-3)


def test_a_dwell_too_short_to_approach_the_lift_is_named():
    ax = plot_valve_profiles(ValveCommand(7.0, 189.0), [6000.0])
    curve = line(ax, "6000 rpm")
    # From Eq. 20 at half the dwell: 5.25 ms less ramps of 1.4 and 1.4 - 0.057 ms, and 1 ms.
    dwell = 189.0 / 36000.0 - 2 * 1.4e-3 + SEATING * 1e-3 / SLOPE - 1e-3
    peak = 7.0 - 2.1 * np.exp(-SLOPE / 2.1 * dwell / 2)
    assert curve.get_label() == f"6000 rpm: peak {peak:.2f} mm"
    assert curve.get_ydata().max() == pytest.approx(peak, abs=1e-9)


def test_a_speed_at_which_the_valve_cannot_open_is_named_and_has_no_line():
    ax = plot_valve_profiles(ValveCommand(3.0, 30.0), [750.0, 6000.0])
    curve = line(ax, "6000 rpm")
    assert curve.get_label() == "6000 rpm: too fast to open in 30 deg"
    assert len(curve.get_xdata()) == 0


def test_the_cam_of_section_4_on_demand():
    ax = plot_valve_profiles(ValveCommand(3.0, 189.0), [1500.0])
    angle, lift = line(ax, "cam").get_data()
    is_open = (angle >= -8.0) & (angle < 226.0)
    expected = 8.1 * np.sin(np.radians(180.0 / 234.0 * (angle + 8.0))) ** 2 * is_open
    np.testing.assert_allclose(lift, expected, atol=1e-12)
    assert line(ax, "cam").get_linestyle() == ":"
    bare = plot_valve_profiles(ValveCommand(3.0, 189.0), [1500.0], conventional=False)
    assert not any("cam" in str(curve.get_label()) for curve in bare.lines)


def test_the_oscillation_is_dashed_and_that_of_appendix_b():
    speed, lift = 1500.0, 7.0
    ax = plot_valve_profiles(ValveCommand(lift, 189.0), [speed], oscillation=True)
    dashed = next(c for c in ax.lines if c.get_linestyle() == "--" and len(c.get_xdata()))
    assert dashed.get_color() == line(ax, "1500 rpm").get_color()
    # A quarter of the 2.5 ms period after the ramp's end: the first swing.
    rise = 0.7 * lift / SLOPE
    time = rise + 2.5e-3 / 4
    decay = -(4.0 / 2.5e-3) * np.log(0.17 / 0.21)
    swing = 0.21 * lift * np.exp(-decay * 2.5e-3 / 4)
    expected = eq_20(time, lift, 189.0 / 9000.0) + swing
    assert np.interp(9000.0 * time, *dashed.get_data()) == pytest.approx(expected, abs=2e-3)
    labels = [t.get_text() for t in ax.get_legend().get_texts()]
    assert "with the actuator's oscillation" in labels


def test_axes_have_units_and_the_legend_stands_outside():
    ax = plot_valve_profiles(ValveCommand(7.0, 90.0, 5.0))
    assert ax.get_xlabel() == "crank angle after intake TDC (deg)"
    assert ax.get_ylabel() == "valve lift (mm)"
    assert ax.get_title(loc="left") == "Intake valve: 7 mm for 90 deg from 5 deg ATDC"
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().x0 > ax.get_window_extent().x1
    _, given = matplotlib.pyplot.subplots()
    assert plot_valve_profiles(ValveCommand(7.0, 90.0), ax=given) is given


def test_another_valvetrain_and_wrong_input():
    slow = Valvetrain(opening_slope_mm_s=1750.0, closing_slope_mm_s=1750.0)
    ax = plot_valve_profiles(ValveCommand(3.0, 189.0), [1500.0], valvetrain=slow)
    assert np.interp(9.0, *line(ax, "1500 rpm").get_data()) == pytest.approx(1.75, abs=2e-3)
    with pytest.raises(ParameterError, match=r"speeds_rpm has the shape \(0,\)"):
        plot_valve_profiles(ValveCommand(3.0, 189.0), [])
    with pytest.raises(ParameterError, match="speed_rpm"):
        plot_valve_profiles(ValveCommand(3.0, 189.0), [1500.0, -1.0])
    with pytest.raises(ParameterError, match="lift_mm is 9 mm"):
        plot_valve_profiles(ValveCommand(9.0, 189.0))
    with pytest.raises(ParameterError, match="oscillation is 'yes'"):
        plot_valve_profiles(ValveCommand(3.0, 189.0), oscillation="yes")
