import numpy as np
import pytest

from plant import ParameterError, ValveCommand, ValveProfile, Valvetrain
from plant.errors import InfeasibleProfileError
from plant.region import OperatingRegion

REGION = OperatingRegion(
    lowest_speed_rpm=750.0,
    highest_speed_rpm=6000.0,
    lowest_lift_mm=0.5,
    highest_lift_mm=8.0,
    longest_deg=280.0,
    valvetrain=Valvetrain(),
)


@pytest.mark.parametrize(("lift", "speed"), [(0.5, 750.0), (3.0, 1500.0), (8.0, 6000.0)])
def test_the_shortest_duration_is_the_one_with_no_dwell(lift, speed):
    # Eq. 20: rise, fall and seating take up the whole duration.
    rise = 0.7 * lift / 3500.0
    fall = (0.7 * lift - 200.0 * 1e-3) / 3500.0
    expected = 6.0 * speed * (rise + fall + 1e-3)
    shortest = float(REGION.shortest_deg(lift, speed))
    assert shortest == pytest.approx(expected, rel=1e-8)
    assert not ValveProfile.camless(ValveCommand(lift, shortest), speed).limited
    with pytest.raises(InfeasibleProfileError):
        ValveProfile.camless(ValveCommand(lift, 0.999 * shortest), speed)


def test_share_and_duration_are_inverse_and_map_the_region_to_a_box():
    lift, duration, speed = REGION.sample(500, seed=4)
    share = REGION.share(lift, duration, speed).value
    assert REGION.feasible(lift, duration, speed).all()
    assert share.min() > 0.0
    assert share.max() < 1.0
    np.testing.assert_allclose(REGION.duration_deg(lift, share, speed), duration, rtol=1e-12)


def test_derivatives_of_the_share_are_those_of_finite_differences():
    x = np.array(REGION.sample(50, seed=1))
    share = REGION.share(*x)
    for k, derivative in enumerate((share.by_lift, share.by_duration, share.by_speed)):
        h = np.zeros_like(x)
        h[k] = 1e-5 * x[k]
        difference = REGION.share(*(x + h)).value - REGION.share(*(x - h)).value
        np.testing.assert_allclose(derivative, difference / (2.0 * h[k]), rtol=1e-6, atol=1e-12)


def test_the_infeasible_corner_names_the_highest_lift_and_a_duration_that_suffices():
    with pytest.raises(InfeasibleProfileError) as caught:
        REGION.require(7.0, 60.0, 6000.0)
    message = str(caught.value)
    # (60/36000 s - seating share of 1 ms) over the ramps' 0.4 ms per mm
    highest = (60.0 / 36000.0 - 1e-3 * (1.0 - 200.0 / 3500.0)) / (1.4 / 3500.0)
    assert caught.value.highest_lift_mm == pytest.approx(highest)
    assert f"at most {highest:.2f} mm" in message
    advised = float(message.split("at least ")[1].split(" deg")[0])
    REGION.require(7.0, advised, 6000.0)
    assert advised == pytest.approx(float(REGION.shortest_deg(7.0, 6000.0)), abs=0.1)


@pytest.mark.parametrize(
    ("point", "words"),
    [
        ((9.0, 100.0, 1500.0), "lift_mm is 9 mm"),
        ((3.0, 300.0, 1500.0), "duration_deg is 300 deg"),
        ((3.0, 100.0, 500.0), "speed_rpm is 500 rpm"),
        ((np.nan, 100.0, 1500.0), "lift_mm is nan"),
        (([3.0, 3.0], [100.0, 290.0], 1500.0), r"duration_deg \(element 1\) is 290 deg"),
    ],
)
def test_values_out_of_range_are_named(point, words):
    with pytest.raises(ParameterError, match=words):
        REGION.require(*point)


def test_a_region_without_durations_for_its_highest_lift_is_refused():
    with pytest.raises(ParameterError, match=r"needs at least 149\.2 deg"):
        OperatingRegion(750.0, 6000.0, 0.5, 8.0, 140.0, Valvetrain())
    with pytest.raises(ParameterError, match="highest_speed_rpm"):
        OperatingRegion(750.0, 750.0, 0.5, 8.0, 280.0, Valvetrain())
    with pytest.raises(ParameterError, match="highest_lift_mm"):
        OperatingRegion(750.0, 6000.0, 0.5, 8.5, 280.0, Valvetrain())
