import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.measurement_response import (
    mode_point,
)

GAINS = AdaptationGains(0.4, 0.25)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("delay", [0.0, 3e-3])
@pytest.mark.parametrize("gains", [GAINS, AdaptationGains(0.3, 0.0)], ids=["adapted", "held"])
def test_lifted_and_event_loops_have_the_same_poles(n, delay, gains):
    loop = EventLoop.at_speed(
        3000, ChargeEstimator(), gains, n_cylinders=n, delay=delay, sensitivity=1.3
    )
    per_event = loop.poles() ** n
    per_cycle = control.poles(loop.closed_loop())
    # Poles of the delay chains are a defective zero: only their size is known, to eps^(1/m).
    for some, others in ((per_event, per_cycle), (per_cycle, per_event)):
        for pole in some[np.abs(some) > 0.05]:
            assert np.min(np.abs(others - pole)) < 1e-9


def test_poles_are_those_of_the_library_feedback():
    loop = EventLoop.at_speed(4500, ChargeEstimator(), GAINS, delay=2e-3)
    ours, theirs = loop.poles(), control.poles(control.feedback(loop.system(), 1))
    for pole in theirs[np.abs(theirs) > 0.3]:
        assert np.min(np.abs(ours - pole)) < 1e-8


@pytest.mark.parametrize("n", [3, 4])
def test_lifted_response_splits_into_modes(n):
    loop = EventLoop.at_speed(6000, ChargeEstimator(), GAINS, n_cylinders=n, delay=2.5e-3)
    lifted, theta = loop.lifted(), 0.7
    matrix = lifted(np.exp(1j * theta))
    modal = [loop(np.exp(1j * (theta + 2.0 * np.pi * q) / n)) for q in range(n)]
    eigenvalues = np.linalg.eigvals(matrix)
    for value in modal:
        assert np.min(np.abs(eigenvalues - value)) < 1e-10
    # Orthogonal eigenvectors: the largest singular value of T is the largest |T_q|.
    T = matrix @ np.linalg.inv(np.eye(n) + matrix)
    assert np.linalg.norm(T, 2) == pytest.approx(max(abs(v / (1.0 + v)) for v in modal), rel=1e-9)


def test_lifted_loop_equals_the_event_loop_in_time():
    loop = EventLoop.at_speed(1500, ChargeEstimator(), GAINS, delay=0.0)
    charge = np.random.default_rng(0).standard_normal(40)
    per_event = control.forced_response(loop.system(), inputs=charge).outputs
    per_cycle = control.forced_response(loop.lifted(), inputs=charge.reshape(-1, 4).T).outputs
    np.testing.assert_allclose(per_cycle.T.ravel(), per_event, atol=1e-12)


def test_signals_are_named():
    loop = EventLoop.at_speed(1500, ChargeEstimator(), GAINS)
    assert loop.lifted().input_labels == ["charge[1]", "charge[2]", "charge[3]", "charge[4]"]
    assert loop.lifted().output_labels[0] == "correction[1]"
    assert loop.closed_loop().input_labels[3] == "disturbance[4]"
    assert loop.closed_loop().dt == pytest.approx(0.08)
    assert loop.system().dt == pytest.approx(0.02)


def test_ideal_loop_has_the_poles_of_its_gains():
    # A matched estimator: the mean decays by 1 - 0.4 a cycle, were it not for the events that
    # pass until an estimate is used; equal gains leave the pure integrator of each cylinder.
    estimator = ChargeEstimator(taper=0.0)
    loop = EventLoop.at_speed(1500, estimator, AdaptationGains(0.3, 0.3))
    radii = [mode.spectral_radius for mode in loop.modes()]
    np.testing.assert_allclose(radii, 0.7, atol=1e-9)


def test_modes_share_out_all_poles():
    loop = EventLoop.at_speed(6000, ChargeEstimator(), GAINS, n_cylinders=6)
    shared = np.concatenate([mode.poles for mode in loop.modes()])
    assert [mode.q for mode in loop.modes()] == [0, 1, 2, 3]
    assert all(np.min(np.abs(shared - pole)) == 0.0 for pole in loop.poles())


def test_mode_response_is_the_loop_at_its_point():
    loop = EventLoop.at_speed(3000, ChargeEstimator(), GAINS)
    mode = loop.modes()[1]
    assert mode(0.2) == pytest.approx(loop(mode_point(1, 4) * np.exp(0.05j)))
