from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant import (
    CrankAnglePlant,
    InfeasibleProfileError,
    ParameterError,
    ValveCommand,
    ValveProfile,
    Valvetrain,
)
from plant.valve import highest_lift_mm, oscillation_lift, shortest_duration

UNEQUAL = Valvetrain(opening_slope_mm_s=4000.0, closing_slope_mm_s=2500.0)
FEASIBLE = [(3.0, 189.0, 1500.0), (0.5, 60.0, 1500.0), (8.0, 240.0, 6000.0), (2.0, 99.0, 1500.0)]


def printed_profile(t, u_l, t_d, s_r=3500.0, s_s=200.0, d_s=1e-3, lam=0.3):
    """Eq. 20 with its misprinted exponents and seating ramp made continuous, s_c = s_r."""
    l_s = lam * u_l
    d_r = (1.0 - lam) * u_l / s_r
    d_f = ((1.0 - lam) * u_l - s_s * d_s) / s_r
    s = t_d - d_r - d_f - d_s
    if t < 0.0 or t >= t_d:
        return 0.0
    if t < d_r:
        return s_r * t
    if t < d_r + s / 2.0:
        return u_l - l_s * math.exp(-s_r / l_s * (t - d_r))
    if t < d_r + s:
        return u_l - l_s * math.exp(-s_r / l_s * (d_r + s - t))
    if t < t_d - d_s:
        return (1.0 - lam) * u_l - s_r * (t - d_r - s)
    return s_s * (t_d - t)


@pytest.mark.parametrize(("lift", "duration", "speed"), FEASIBLE)
def test_camless_profile_is_equation_20(lift, duration, speed):
    profile = ValveProfile.camless(ValveCommand(lift, duration, 12.0), speed)
    angle = np.linspace(0.0, 280.0, 2003)
    expected = [printed_profile((a - 12.0) / (6.0 * speed), lift, profile.duration) for a in angle]
    assert profile.lift_mm(angle) == pytest.approx(np.array(expected), abs=1e-12)


@pytest.mark.parametrize("valvetrain", [Valvetrain(), UNEQUAL])
@pytest.mark.parametrize(("lift", "duration", "speed"), FEASIBLE)
def test_lift_is_continuous_and_no_steeper_than_its_slopes(lift, duration, speed, valvetrain):
    profile = ValveProfile.camless(
        ValveCommand(lift, duration), speed, valvetrain, on_infeasible="limit"
    )
    time = np.linspace(-1e-3, profile.duration + 1e-3, 20001)
    lifts = profile.lift_mm(time * 6.0 * speed)
    slopes = np.diff(lifts) / np.diff(time)
    assert np.max(slopes) <= valvetrain.opening_slope_mm_s * (1.0 + 1e-9)
    assert np.min(slopes) >= -valvetrain.closing_slope_mm_s * (1.0 + 1e-9)
    assert lifts.min() == 0.0
    assert lifts.max() <= profile.delivered_lift_mm
    # half the exponential reaches the lift to this share at the turn
    c = profile.corners
    left = math.exp(
        -valvetrain.opening_slope_mm_s
        / (valvetrain.roundness * profile.delivered_lift_mm)
        * (c.turn - c.rise_end)
    )
    assert lifts.max() == pytest.approx(profile.delivered_lift_mm * (1.0 - 0.3 * left), rel=1e-3)


@pytest.mark.parametrize("valvetrain", [Valvetrain(), UNEQUAL])
def test_corners_have_the_heights_of_the_ramps(valvetrain):
    profile = ValveProfile.camless(ValveCommand(4.0, 200.0), 3000.0, valvetrain)
    c = profile.corners
    assert list(c) == sorted(c)
    heights = profile.lift_mm(np.array(c) * 18000.0)
    top = 0.7 * 4.0
    assert heights[0] == pytest.approx(top, rel=1e-12)
    assert heights[2] == pytest.approx(top, rel=1e-12)
    assert heights[3] == pytest.approx(200.0 * 1e-3, rel=1e-9)  # s_s d_s
    assert heights[4] == 0.0


def test_duration_is_closing_plus_seating():
    """Section 3.1: closing 180 deg at 1500 rpm is IVD 189 deg, 1 ms of seating."""
    profile = ValveProfile.camless(ValveCommand(3.0, 189.0), 1500.0)
    assert profile.corners.seating_start * 9000.0 == pytest.approx(180.0, rel=1e-12)
    assert profile.corners.closing * 9000.0 == pytest.approx(189.0, rel=1e-12)


@given(
    lift=st.floats(0.3, 8.0),
    slope_r=st.floats(500.0, 9000.0),
    slope_c=st.floats(500.0, 9000.0),
    roundness=st.floats(0.05, 0.9),
)
def test_shortest_duration_and_highest_lift_are_inverse(lift, slope_r, slope_c, roundness):
    v = Valvetrain(opening_slope_mm_s=slope_r, closing_slope_mm_s=slope_c, roundness=roundness)
    shortest = shortest_duration(lift, v)
    assert highest_lift_mm(shortest, v) == pytest.approx(lift, rel=1e-12)
    # rise, fall and seating without dwell
    ramp = (1.0 - roundness) * lift
    assert shortest == pytest.approx(ramp / slope_r + (ramp - 0.2) / slope_c + 1e-3, rel=1e-12)


def test_limited_lift_is_told_and_refused_without_leave():
    command = ValveCommand(7.0, 60.0)
    # 60 deg at 6000 rpm are 1/600 s; no dwell leaves u_l = (t_d - d_s + s_s d_s/s_c) / (2 0.7/s_r)
    highest = (60.0 / 36000.0 - 1e-3 + 0.2 / 3500.0) / (1.4 / 3500.0)
    with pytest.raises(InfeasibleProfileError, match=r"60 deg at 6000 rpm cannot reach 7 mm") as e:
        ValveProfile.camless(command, 6000.0)
    assert e.value.highest_lift_mm == pytest.approx(highest, rel=1e-12)
    assert f"at most {highest:.2f} mm" in str(e.value)
    assert "lengthen the duration to at least" in str(e.value)
    profile = ValveProfile.camless(command, 6000.0, on_infeasible="limit")
    assert profile.limited
    assert profile.delivered_lift_mm == pytest.approx(highest, rel=1e-12)
    # it turns round at the end of the ramp
    assert profile.lift_mm(np.linspace(0, 60, 5001)).max() == pytest.approx(0.7 * highest, rel=1e-3)
    cycle = CrankAnglePlant().steady_cycle(6000.0, command, on_infeasible="limit")
    assert np.all(cycle.limited)
    assert "limited from 7" in str(cycle)


def test_needed_duration_in_the_message_is_enough():
    with pytest.raises(InfeasibleProfileError) as e:
        ValveProfile.camless(ValveCommand(7.0, 60.0), 6000.0)
    needed = float(str(e.value).split("at least ")[1].split(" deg")[0])
    assert not ValveProfile.camless(ValveCommand(7.0, needed), 6000.0).limited
    with pytest.raises(InfeasibleProfileError):
        ValveProfile.camless(ValveCommand(7.0, needed - 0.11), 6000.0)


def test_conventional_cam_is_that_of_section_4():
    command = ValveCommand.conventional()
    assert (command.lift_mm, command.opening_deg, command.closing_deg) == (8.1, -8.0, 226.0)
    profile = ValveProfile.conventional(command, 1500.0)
    assert profile.lift_mm(109.0) == pytest.approx(8.1, rel=1e-12)  # half way
    assert profile.lift_mm(-8.0 + 58.5) == pytest.approx(8.1 / 2, rel=1e-12)  # sin^2(45 deg)
    assert profile.lift_mm([-8.1, -8.0, 226.0, 300.0]) == pytest.approx(0.0)
    # a cam follows the crank, whatever the speed
    fast = ValveProfile.conventional(command, 6000.0)
    angle = np.linspace(-20, 250, 301)
    assert np.array_equal(fast.lift_mm(angle), profile.lift_mm(angle))


def test_oscillation_has_the_amplitudes_of_appendix_b():
    """0.21 u_l at the start, 0.17 u_l a quarter of a period later, and so on."""
    v = Valvetrain()
    quarter = 2.5e-3 / 4.0
    swing = oscillation_lift(1e-3 + quarter * np.arange(10), 5.0, 1e-3, v)
    sine = np.array([0, 1, 0, -1, 0, 1, 0, -1, 0, 1])
    assert swing == pytest.approx(5.0 * 0.21 * (0.17 / 0.21) ** np.arange(10) * sine, abs=1e-12)
    assert swing[1] == pytest.approx(5.0 * 0.17, rel=1e-12)
    assert oscillation_lift(0.5e-3, 5.0, 1e-3, v) == 0.0


@pytest.mark.parametrize(("lift", "duration", "speed"), FEASIBLE)
def test_oscillating_lift_is_never_below_its_seat(lift, duration, speed):
    command = ValveCommand(lift, duration)
    profile = ValveProfile.camless(command, speed, oscillation=True)
    plain = ValveProfile.camless(command, speed)
    angle = np.linspace(-5.0, duration + 5.0, 3001)
    lifts = profile.lift_mm(angle)
    assert lifts.min() == 0.0
    rising = angle < plain.corners.rise_end * 6.0 * speed
    assert np.array_equal(lifts[rising], plain.lift_mm(angle[rising]))
    assert np.max(np.abs(lifts - plain.lift_mm(angle))) <= 0.21 * lift
    assert np.max(lifts) > lift  # it overshoots


@pytest.mark.parametrize("oscillation", [False, True])
@pytest.mark.parametrize("valvetrain", [Valvetrain(), UNEQUAL])
@pytest.mark.parametrize(
    ("lift", "duration", "speed"), [*FEASIBLE, (0.5, 300.0, 500.0), (0.5, 330.0, 750.0)]
)
def test_kernel_drives_the_same_profile(lift, duration, speed, valvetrain, oscillation):
    command = ValveCommand(lift, duration, 5.0)
    engine = CrankAnglePlant().engine.replace(valvetrain=valvetrain)
    plant = CrankAnglePlant(engine, oscillation=oscillation)
    trace = plant.steady_cycle(speed, command, on_infeasible="limit", tolerance=1e-6).trace_at(0.1)
    profile = plant.valve_profile(command, speed, on_infeasible="limit")
    angle = trace.crank_angle_deg
    assert trace.lift_mm[:, 0] == pytest.approx(profile.lift_mm(angle), abs=1e-3 * lift)


@pytest.mark.parametrize(
    ("build", "fragments"),
    [
        (lambda: ValveCommand(-0.1, 90.0), ("lift_mm is -0.1 mm", "at least 0 mm")),
        (lambda: ValveCommand(math.nan, 90.0), ("lift_mm is nan mm", "finite")),
        (lambda: ValveCommand("3", 90.0), ("lift_mm", "'3'", "mm")),
        (lambda: ValveCommand(3.0, 0.0), ("duration_deg is 0 deg", "(0, 360] deg")),
        (lambda: ValveCommand(3.0, 361.0), ("duration_deg is 361 deg", "(0, 360] deg")),
        (lambda: ValveCommand(3.0, math.inf), ("duration_deg is inf deg", "(0, 360] deg")),
        (lambda: ValveCommand(3.0, 90.0, -91.0), ("opening_deg is -91 deg", "[-90, 180) deg")),
        (
            lambda: ValveCommand(3.0, 300.0, 100.0),
            ("close at 400 deg", "shut by 360 deg", "shorten duration_deg", "advance opening_deg"),
        ),
        (
            lambda: ValveCommand(3.0, 90.0).replace(lift=2.0),
            ("no field 'lift'", "did you mean 'lift_mm'"),
        ),
        (
            lambda: ValveProfile.camless(ValveCommand(9.0, 189.0), 1500.0),
            ("lift_mm is 9 mm", "8] mm", "change the Valvetrain's limits"),
        ),
        (
            lambda: ValveProfile.camless(ValveCommand(0.1, 189.0), 1500.0),
            ("lift_mm is 0.1 mm", "[0.2857", "0 keeps the valve shut"),
        ),
        (
            lambda: ValveProfile.camless(ValveCommand(3.0, 5.0), 6000.0, on_infeasible="limit"),
            ("duration 5 deg at 6000 rpm is too short", "lengthen the duration to at least"),
        ),
        (
            lambda: ValveProfile.camless(ValveCommand(3.0, 189.0), 0.0),
            ("speed_rpm is 0 rpm", "above 0 rpm"),
        ),
        (
            lambda: ValveProfile.camless(ValveCommand(3.0, 189.0), 1500.0, on_infeasible="clip"),
            ("on_infeasible is 'clip'", "raise, limit"),
        ),
        (
            lambda: ValveProfile.conventional(ValveCommand.conventional(), 1500.0).corners,
            ("has no corners", "camless"),
        ),
    ],
)
def test_bad_commands_are_refused_with_the_remedy(build, fragments):
    with pytest.raises(ParameterError) as e:
        build()
    for fragment in fragments:
        assert fragment in str(e.value)


def test_profile_plots():
    import matplotlib as mpl

    mpl.use("Agg")
    profile = ValveProfile.camless(ValveCommand(3.0, 189.0), 1500.0)
    ax = profile.plot()
    drawn = ax.lines[0].get_ydata()
    assert max(drawn) == pytest.approx(3.0, rel=1e-3)
    assert profile.plot(ax) is ax
    assert len(ax.lines) == 2
