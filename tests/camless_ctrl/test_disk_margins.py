import math

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.disk_margins import (
    all_loops_at_once,
    disk_margins,
    factor,
    loop_at_a_time,
)
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.margins import stability_margins
from camless_ctrl.nominal_loop import NominalLoop
from plant import ParameterError

# Seiler, Packard and Gahinet (2020): L = 25/(s^3 + 10 s^2 + 10 s + 10)
SEILER = control.ss(control.tf([25.0], [1.0, 10.0, 10.0, 10.0]))
GAINS = AdaptationGains(0.4, 0.25)


def seiler(omega):
    s = 1j * omega
    return 25.0 / (s**3 + 10.0 * s**2 + 10.0 * s + 10.0)


def satellite(a=10.0):
    """Spinning satellite, G = [[s - a^2, a (s + 1)], [-a (s + 1), s - a^2]]/(s^2 + a^2)."""
    rate = np.array([[0.0, a], [-a, 0.0]])
    return control.ss(rate, np.eye(2), np.array([[1.0, a], [-a, 1.0]]), np.zeros((2, 2)))


def with_gains(loop, gains):
    """Closed loop with a real factor in each loop."""
    n = len(gains)
    factors = control.ss([], [], [], np.diag(gains), loop.dt)
    return control.feedback(
        control.series(loop, factors), control.ss([], [], [], np.eye(n), loop.dt)
    )


def event_loop(n=4, gains=GAINS, speed_rpm=3000.0):
    return EventLoop.at_speed(speed_rpm, ChargeEstimator(), gains, n_cylinders=n, delay=2e-3)


def nominal(n=4, gains=GAINS):
    return NominalLoop.of_event_loop(event_loop(n, gains))


def modal_sensitivities(n, theta):
    """S of every mode at cycle phases (theta,), from the closed form of the loop: (n, theta)."""
    z = np.exp(1j * (theta + 2.0 * np.pi * np.arange(n)[:, None]) / n)
    return 1.0 / (1.0 + event_loop(n)(z))


THETA = np.linspace(-np.pi, np.pi, 40002)  # holds no integrator


def test_published_example():
    (found,) = loop_at_a_time(SEILER)
    assert found.alpha == pytest.approx(0.458, abs=5e-4)
    assert found.gain_margin == pytest.approx((0.63, 1.59), abs=5e-3)
    assert found.phase_margin_deg == pytest.approx(25.8, abs=0.05)
    # |S - 1/2| = |1 - L|/(2 |1 + L|), by a fine grid
    omega = np.linspace(1.5, 2.5, 200001)
    size = np.abs((1.0 - seiler(omega)) / (1.0 + seiler(omega))) / 2.0
    assert found.alpha == pytest.approx(1.0 / size.max(), rel=1e-8)
    assert found.frequency == pytest.approx(omega[np.argmax(size)], abs=1e-3)
    at_once = all_loops_at_once(SEILER)
    assert at_once.proved
    assert at_once.alpha <= found.alpha
    assert at_once.alpha == pytest.approx(found.alpha, rel=2e-3)
    assert at_once.broken_by == pytest.approx(found.alpha, rel=1e-4)


@pytest.mark.parametrize("skew", [-1.0, -0.4, 0.0, 0.7, 1.0])
def test_skew(skew):
    (found,) = loop_at_a_time(SEILER, skew=skew)
    omega = np.linspace(0.01, 8.0, 400001)
    S = 1.0 / (1.0 + seiler(omega))
    assert found.alpha == pytest.approx(1.0 / np.abs(S + 0.5 * (skew - 1.0)).max(), rel=1e-7)
    # The worst factor closes the loop at -1, and lies on the boundary of the disk.
    (worst,) = found.worst
    assert abs(1.0 + worst * seiler(found.frequency)) < 1e-6
    assert np.min(np.abs(found.boundary(20001) - worst)) < 1e-3
    # Gain margins are where the boundary is real, the phase margin where it is of size 1.
    low, high = found.gain_margin
    edge = factor(found.alpha * np.array([-1.0, 1.0]), skew)
    assert edge == pytest.approx([low, high], rel=1e-12)
    turn = np.exp(1j * np.radians(found.phase_margin_deg))
    d = (turn - 1.0) / (0.5 * (1.0 - skew) + 0.5 * (1.0 + skew) * turn)
    assert abs(d) == pytest.approx(found.alpha, rel=1e-9)
    # All that is inside leaves the loop stable, a little more of the worst does not.
    for gain in (low + 1e-3, high - 1e-3):
        assert np.all(control.poles(control.feedback(gain * SEILER, 1)).real < 0.0)


def test_margins_of_the_peaks_of_s_and_t():
    # Textbook: with |S| <= M the gain may be M/(M - 1), the phase 2 asin(1/(2 M)).
    M = stability_margins(SEILER).sensitivity_peak
    (found,) = loop_at_a_time(SEILER, skew=1.0)
    assert found.alpha == pytest.approx(1.0 / M, rel=1e-6)
    assert found.gain_margin[1] == pytest.approx(M / (M - 1.0), rel=1e-6)
    expected = 2.0 * math.degrees(math.asin(0.5 / M))
    assert found.phase_margin_deg == pytest.approx(expected, rel=1e-6)
    M = stability_margins(SEILER).complementary_peak
    (found,) = loop_at_a_time(SEILER, skew=-1.0)
    assert found.gain_margin == pytest.approx((1.0 - 1.0 / M, 1.0 + 1.0 / M), rel=1e-6)


def test_spinning_satellite_is_fine_loop_by_loop_and_fragile_at_once():
    # Each loop alone is 1/s: any gain, 90 deg. S - I/2 is normal, with the largest eigenvalue
    # a/2 + sqrt(1 + a^2)/2, so that the margin of both is 2/(a + sqrt(1 + a^2)).
    loop = satellite()
    for each in loop_at_a_time(loop):
        assert each.alpha == pytest.approx(2.0, rel=1e-7)
        assert each.gain_margin[0] == pytest.approx(0.0, abs=1e-7)
        assert each.gain_margin[1] > 1e6
        assert each.phase_margin_deg == pytest.approx(90.0, abs=1e-4)
    found = all_loops_at_once(loop)
    expected = 2.0 / (10.0 + math.sqrt(101.0))
    assert expected == pytest.approx(0.0998, abs=1e-4)
    assert found.proved
    assert found.alpha <= expected
    assert found.alpha == pytest.approx(expected, rel=2e-3)
    assert found.broken_by == pytest.approx(expected, rel=1e-4)
    # The factors found put a pole on the axis.
    G = loop(1j * found.frequency)
    assert abs(np.linalg.det(np.eye(2) + np.diag(found.worst) @ G)) < 1e-6
    # Real gains of opposite sign: det = s^2 + (2 + e1 + e2) s + 1 + e1 + e2 + (1 + a^2) e1 e2
    assert np.any(control.poles(with_gains(loop, [1.1, 0.9])).real > 0.0)
    assert np.all(control.poles(with_gains(loop, [1.1, 1.1])).real < 0.0)


def largest_radius(M, phases):
    """Mu of complex scalars: the largest spectral radius of M times phases (Doyle, 1982)."""
    n = len(M)
    angles = np.stack(np.meshgrid(*[phases] * (n - 1)), axis=-1).reshape(-1, n - 1)
    turns = np.exp(1j * np.column_stack((np.zeros(len(angles)), angles)))
    return float(np.abs(np.linalg.eigvals(M * turns[:, None, :])).max())


def test_satellite_by_brute_force():
    loop, found = satellite(), all_loops_at_once(satellite())
    phases = np.linspace(-np.pi, np.pi, 181)
    worst = 0.0
    for omega in np.concatenate(([0.0], np.geomspace(1e-3, 100.0, 150))):
        G = loop(1j * omega)
        worst = max(worst, largest_radius(np.linalg.inv(np.eye(2) + G) - 0.5 * np.eye(2), phases))
    assert 1.0 / worst == pytest.approx(found.alpha, rel=3e-3)


@pytest.fixture(scope="module")
def three():
    """Three coupled loops that are not normal, sampled."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((5, 5))
    A *= 0.6 / np.max(np.abs(np.linalg.eigvals(A)))
    B, C = rng.standard_normal((5, 3)), 0.12 * rng.standard_normal((3, 5))
    return control.ss(A, B, C, np.zeros((3, 3)), 0.5)


@pytest.mark.parametrize("skew", [0.0, 0.6])
def test_coupled_loops_by_brute_force_and_by_the_library(three, skew):
    found = all_loops_at_once(three, skew=skew)
    assert found.stable
    L = three(np.exp(0.5j * found.frequency))
    M = np.linalg.inv(np.eye(3) + L) + 0.5 * (skew - 1.0) * np.eye(3)
    radius = largest_radius(M, np.linspace(-np.pi, np.pi, 121))
    # Three complex scalars: bound and value are equal.
    assert 1.0 / radius == pytest.approx(found.broken_by, rel=2e-3)
    assert found.alpha == pytest.approx(found.broken_by, rel=2e-3)
    assert abs(np.linalg.det(np.eye(3) + np.diag(found.worst) @ L)) < 1e-6
    omega = np.linspace(0.0, np.pi / 0.5, 1501)[1:]
    theirs = control.disk_margins(three, omega, skew=skew)[0]
    assert found.alpha == pytest.approx(theirs, rel=3e-3)
    # All at once can be no better than the worst of one at a time, and that is the library's.
    single = loop_at_a_time(three, skew=skew)
    assert found.alpha <= min(each.alpha for each in single)
    S = np.array([np.linalg.inv(np.eye(3) + three(np.exp(0.5j * w))) for w in omega])
    for i, each in enumerate(single):
        size = np.abs(S[:, i, i] + 0.5 * (skew - 1.0)).max()
        assert each.alpha == pytest.approx(1.0 / size, rel=1e-4)


def test_unstable_loop_has_no_margin():
    loop = control.ss(control.tf([3.0], [1.0, -1.0], 1.0))  # pole at -2
    assert control.disk_margins(loop, np.linspace(0.01, np.pi, 200))[0] > 0.3  # the trap
    for found in (*loop_at_a_time(loop), all_loops_at_once(loop)):
        assert not found.stable
        assert math.isnan(found.alpha)
        assert not found.proved
        assert str(found) == "unstable: no disk margin"
    # and the air-charge loop at too high a gain
    whole = disk_margins(nominal(gains=AdaptationGains(4.0, 4.0)))
    assert not whole.stable
    margins = [*whole.one_at_a_time, whole.all_loops, *(m.disk for m in whole.modes)]
    assert all(math.isnan(m.alpha) for m in margins)
    assert all(math.isnan(m.classical.gain_margin) for m in whole.modes)
    assert str(whole).startswith("The loop is unstable (pole radius ")


@pytest.fixture(scope="module")
def four():
    return disk_margins(nominal())


@pytest.fixture(scope="module", params=[2, 3, 4])
def cylinders(request, four):
    n = request.param
    return n, four if n == 4 else disk_margins(nominal(n))


def test_all_cylinders_are_as_good_as_the_weakest_mode(cylinders):
    # Lifted, S is normal: its structured singular value is its largest size over the modes.
    n, found = cylinders
    expected = 1.0 / np.abs(modal_sensitivities(n, THETA) - 0.5).max()
    assert min(m.disk.alpha for m in found.modes) == pytest.approx(expected, rel=1e-6)
    assert found.all_loops.broken_by == pytest.approx(expected, rel=1e-4)
    assert found.all_loops.alpha <= expected * (1.0 + 1e-9)
    assert found.all_loops.alpha == pytest.approx(expected, rel=2e-3)
    assert found.all_loops.proved


def test_one_cylinder_sees_the_mean_over_the_modes(cylinders):
    n, found = cylinders
    expected = 1.0 / np.abs(modal_sensitivities(n, THETA).mean(axis=0) - 0.5).max()
    assert len(found.one_at_a_time) == n
    for each in found.one_at_a_time:
        assert each.alpha == pytest.approx(expected, rel=1e-6)
    assert found.all_loops.alpha <= found.one_at_a_time[0].alpha * (1.0 + 1e-9)


def test_worst_factors_close_the_lifted_loop(four):
    found = four
    zeta = np.exp(1j * found.all_loops.frequency * 4.0 * found.loop.event_time)
    L = event_loop().lifted()(zeta)
    assert abs(np.linalg.det(np.eye(4) + np.diag(found.all_loops.worst) @ L)) < 1e-6
    one = found.one_at_a_time[2]
    F = np.diag([1.0, 1.0, one.worst[0], 1.0])
    L = event_loop().lifted()(np.exp(1j * one.frequency * 4.0 * found.loop.event_time))
    assert abs(np.linalg.det(np.eye(4) + F @ L)) < 1e-6


def test_real_gains_within_the_disk_are_withstood(four):
    found = four
    low, high = found.all_loops.gain_margin
    rng = np.random.default_rng(1)
    lifted = event_loop().lifted()
    for _ in range(20):
        closed = with_gains(lifted, rng.choice([low + 1e-6, high - 1e-6], 4))
        assert np.all(np.abs(control.poles(closed)) < 1.0)


def test_margins_of_the_modes_are_those_of_the_loop(four):
    found = four
    whole = stability_margins(event_loop().system())
    classical = [m.classical for m in found.modes]
    assert min(m.gain_margin for m in classical) == pytest.approx(whole.gain_margin, rel=1e-6)
    assert min(m.phase_margin_deg for m in classical) == pytest.approx(
        whole.phase_margin_deg, rel=1e-6
    )
    for mode in found.modes:
        assert mode.disk.alpha == pytest.approx(mode.classical.disk_margin, rel=1e-6)
        # A disk can promise no more than gain and phase alone withstand.
        assert mode.disk.gain_margin[1] <= mode.classical.gain_margin * (1.0 + 1e-9)
        assert mode.disk.phase_margin_deg <= mode.classical.phase_margin_deg + 1e-6
    assert found.weakest_mode == min(found.modes, key=lambda m: m.disk.alpha).q


def test_it_prints_and_plots(four):
    import matplotlib.pyplot as plt

    found = four
    text = str(found)
    for part in ("Mean mode: disk margin", "One cylinder at a time", "All cylinders at once"):
        assert part in text
    assert "events later" in text
    ax = found.plot()
    curves = ax.get_lines()[:-1]
    assert len({(c.get_linestyle(), c.get_color()) for c in curves}) == len(curves) == 5
    plt.close(ax.figure)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ParameterError, match="2 inputs and 1 outputs"):
        loop_at_a_time(control.ss([], [], [], [[1.0, 2.0]]))
    with pytest.raises(ParameterError, match=r"skew is 1\.5"):
        all_loops_at_once(SEILER, skew=1.5)
    with pytest.raises(ParameterError, match="skew"):
        disk_margins(nominal(), skew=-2.0)
