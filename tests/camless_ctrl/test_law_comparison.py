import itertools

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.gain_synthesis import design_gains
from camless_ctrl.law_comparison import compare_laws, standard_laws
from camless_ctrl.mu import robust_performance, robust_stability
from camless_ctrl.uncertain_loop import UncertainLoop, adaptation_law
from plant import ParameterError

PRESENT, QUICK = AdaptationGains(0.4, 0.4), AdaptationGains(0.8, 0.7)


@pytest.fixture(scope="module")
def slow(measured):
    return measured(1500.0)


@pytest.fixture(scope="module")
def compared(slow):
    laws = {
        "present": adaptation_law(slow, PRESENT),
        "quick": adaptation_law(slow, QUICK),
        "mean only": adaptation_law(slow, AdaptationGains(0.4, 0.0)),
        "too quick": adaptation_law(slow, AdaptationGains(3.0, 3.0)),
    }
    return compare_laws(slow, laws, worst_case=False)


def test_figures_of_a_law_are_those_of_their_own_tools(slow, compared):
    law = compared["present"]
    loop = UncertainLoop.adaptive(slow, PRESENT)
    stability = robust_stability(loop.system, loop.structure)
    performance = robust_performance(loop.system, loop.structure)
    assert law.mu_stability == pytest.approx(stability.peak_upper, rel=0.01)
    assert law.mu_performance == pytest.approx(performance.peak_upper, rel=0.01)
    assert law.peak == pytest.approx(
        2.0 * control.system_norm(loop.system["error", "disturbance"], "inf"), rel=1e-3
    )
    assert max(law.radius) == pytest.approx(np.abs(loop.poles).max() ** 4)
    assert law.order == 4


def test_noise_is_the_sum_of_squares_of_the_impulse_response(slow, compared):
    # correction = C (noise - z^-latency E_c correction), in the time domain.
    for name in ("present", "mean only"):
        law = compared[name].loop.law
        loop = control.feedback(law, control.ss(*_centre(slow), slow.event_time))
        impulse = np.zeros(2000)
        impulse[0] = 1.0
        times = np.arange(impulse.size) * slow.event_time
        found = control.forced_response(loop, times, impulse).outputs
        assert compared[name].noise == pytest.approx(np.sqrt(np.sum(found**2)), rel=1e-6)


def _centre(measurement):
    """Impulse response of the centre as a chain of delays."""
    angle = 2.0 * np.pi * np.arange(64) / 64
    z = np.exp(1j * angle)
    taps = np.fft.ifft(z**-measurement.latency * measurement.centre(z)).real
    n = taps.size - 1
    return np.eye(n, k=-1), np.eye(n, 1), taps[None, 1:], [[taps[0]]]


def test_settling_is_that_of_a_simulation(slow, compared):
    closed = UncertainLoop.adaptive(slow, QUICK).system["error", "disturbance"]
    y = (
        2.0
        * control.forced_response(closed, np.arange(400) * slow.event_time, np.ones(400)).outputs
    )
    last = int(np.flatnonzero(np.abs(y) > 0.02)[-1])
    assert compared["quick"].settling_cycles[0] == pytest.approx((last + 1) / 4)


def test_slowest_in_the_set_is_that_of_the_corners(slow, compared):
    loop = UncertainLoop.adaptive(slow, QUICK)
    times = []
    for d in itertools.product((-1.0, 1.0), repeat=3):
        closed = loop.perturbed(dict(zip(slow.directions, d, strict=True)))
        y = (
            2.0
            * control.forced_response(
                closed, np.arange(400) * slow.event_time, np.ones(400)
            ).outputs
        )
        times.append((int(np.flatnonzero(np.abs(y) > 0.02)[-1]) + 1) / 4)
    assert compared["quick"].worst_settling_cycles[0] == pytest.approx(max(times))
    assert max(times) > compared["quick"].settling_cycles[0]


def test_a_set_with_an_unstable_member_never_settles(slow):
    gains = PRESENT.scaled(4.0)
    law = compare_laws(slow, {"fast": adaptation_law(slow, gains)}, worst_case=False)["fast"]
    worst = robust_stability(law.loop.system, law.loop.structure).worst
    assert law.stable  # in the middle of the set
    assert worst.size < 1.0  # a member of it is not
    assert all(np.isinf(law.worst_settling_cycles))
    assert np.isfinite(law.settling_cycles).all()


def test_held_modes_and_instability_are_told(compared):
    assert compared["mean only"].held == (False, True, True)
    assert compared["present"].held == (False, False, False)
    assert not compared["too quick"].stable
    text = str(compared)
    assert "unstable in the middle of the set" in text
    assert "held" in text
    assert compared.fastest is compared["quick" if compared["quick"].robust else "present"]
    with pytest.raises(ParameterError, match="no law 'slow'"):
        compared["slow"]


def test_worst_case_is_proved_and_matches_the_closed_form(slow):
    law = compare_laws(slow, {"present": adaptation_law(slow, PRESENT)})["present"]
    assert law.worst is not None
    assert law.worst_peak == pytest.approx(2.0 * law.worst.peak_lower, rel=0.01)
    assert law.worst_peak < 2.0 * law.worst.ceiling * 1.0001


@pytest.mark.slow
def test_standard_laws_are_compared_and_drawn(slow):
    laws = standard_laws(slow)
    assert list(laws) == ["present gains", "designed gains", "H-infinity", "D-K"]
    found = compare_laws(slow, laws, worst_case=False)
    assert all(law.robust for law in found.laws)
    designed = design_gains(slow, confirm=False)
    assert found["designed gains"].mu_performance == pytest.approx(
        designed.mu_performance, rel=0.01
    )
    present = GainSchedule().at(1500.0)
    assert found["present gains"].loop.law.A.shape == adaptation_law(slow, present).A.shape
    assert found.plot().get_xlabel() == "angle per event (deg)"
    assert found.plot_steps().get_xlabel() == "time (cycles)"
