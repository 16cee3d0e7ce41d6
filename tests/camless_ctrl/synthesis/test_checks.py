"""Conditions of synthesis: each fails where theory says so, and only there."""

from __future__ import annotations

import control
import numpy as np
import pytest

from camless_ctrl.synthesis import (
    SynthesisError,
    check_synthesis,
    hinf,
    hinf_synthesis,
    mixed_sensitivity,
)

s = control.tf("s")
W1 = (s / 2 + 1) / (s + 1e-4)
LAG = 1 / (s + 1)


def failed(check):
    return {item.name for item in check.failures}


def test_sound_problem_passes():
    check = check_synthesis(mixed_sensitivity(LAG, W1, 0.1, None), 1, 1)
    assert check.passed
    assert str(check) == "the plant is fit for synthesis: all 7 conditions hold"
    check.require()


@pytest.mark.parametrize("discrete", [False, True])
def test_strictly_proper_plant_without_w2_is_refused_before_any_solver(monkeypatch, discrete):
    G, weight = LAG, W1
    if discrete:  # Tustin puts the zero at z = -1: no gain at the Nyquist frequency
        G, weight = (control.sample_system(g, 0.1, "tustin") for g in (LAG, W1))

    def no_solver(*args, **kwargs):
        raise AssertionError("a solver was started")

    monkeypatch.setattr(hinf, "run_stoppable", no_solver)
    P = mixed_sensitivity(G, weight, None, 0.5)
    assert failed(check_synthesis(P, 1, 1)) == {"D12"}
    with pytest.raises(SynthesisError, match=r"rank 0 instead of 1.*add a small W2 weight of"):
        hinf_synthesis(P, 1, 1)


def test_remedy_of_d12_works():
    check = check_synthesis(mixed_sensitivity(LAG, W1, None, 0.5), 1, 1)
    weight = float(check["D12"].remedy.split("about ")[1].split(" on ")[0])
    assert check_synthesis(mixed_sensitivity(LAG, W1, weight, 0.5), 1, 1).passed


def test_one_unweighted_control_of_two_is_named():
    G = control.append(control.ss(LAG), control.ss(LAG))
    W2 = control.ss([], [], [], np.diag([1.0, 0.0]))
    item = check_synthesis(mixed_sensitivity(G, W1, W2, None), 2, 2)["D12"]
    assert not item.passed
    assert "rank 1 instead of 2" in item.sentence
    assert "control[2]" in item.remedy


def test_noise_free_measurement_fails_d21():
    P = control.ss([[-1.0]], [[1.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0], [0, 1], [0, 0]])
    assert failed(check_synthesis(P, 1, 1)) == {"D21"}


@pytest.mark.parametrize("place", [0.0, 1.0, 1e3])
def test_mode_out_of_reach_of_the_controls(place):
    A, B = np.diag([place, -1.0]), np.array([[1.0, 0.0], [0.0, 1.0]])
    P = control.ss(A, B, [[1.0, 1.0], [0, 0], [1.0, 1.0]], [[0, 0], [0, 1.0], [1.0, 0]])
    check = check_synthesis(P, 1, 1)
    assert "stabilisable" in failed(check)
    assert f"s = {place:g}" in check["stabilisable"].sentence
    with pytest.raises(SynthesisError, match="not stabilisable"):
        hinf_synthesis(P, 1, 1)


def test_mode_out_of_sight_of_the_measurements():
    A, B = np.diag([0.5, -1.0]), np.array([[1.0, 1.0], [0.0, 1.0]])
    P = control.ss(A, B, [[1.0, 1.0], [0, 0], [0.0, 1.0]], [[0, 0], [0, 1.0], [1.0, 0]])
    assert "detectable" in failed(check_synthesis(P, 1, 1))


def test_stable_modes_out_of_reach_do_no_harm():
    A, B = np.diag([-1e-4, -1.0]), np.array([[1.0, 0.0], [1.0, 1.0]])
    P = control.ss(A, B, [[1.0, 1.0], [0, 0], [1.0, 1.0]], [[0, 0], [0, 1.0], [1.0, 0]])
    assert check_synthesis(P, 1, 1)["stabilisable"].passed


@pytest.mark.parametrize(
    ("G", "place"),
    [(1 / (s * (s + 1)), "s = 0"), (1 / (s**2 + 4), "s = 0 ± 2j"), (1 / s**2, "s = 0")],
)
def test_poles_of_the_plant_on_the_axis(G, place):
    # S = 0 at a pole of G whatever the controller does: the optimum is on the boundary.
    check = check_synthesis(mixed_sensitivity(G, W1, 0.1, None), 1, 1)
    assert failed(check) == {"measurement zeros"}
    assert place in check["measurement zeros"].sentence


def test_zero_of_the_control_path_on_the_axis():
    # G(2j) = 0 and no weight on the control there: W2 has the same zero.
    W2 = (s**2 + 4) / (s + 1) ** 2
    G = (s**2 + 4) / (s + 1) ** 3
    check = check_synthesis(mixed_sensitivity(G, 1.0, W2, None), 1, 1)
    assert failed(check) == {"control zeros"}
    assert "0 ± 2j" in check["control zeros"].sentence


def test_integrating_weight_is_named_with_its_remedy():
    check = check_synthesis(mixed_sensitivity(LAG, (s + 1) / s, 0.1, None), 1, 1)
    assert "detectable" in failed(check)
    assert "1/(s + 1e-4 times the bandwidth)" in check["detectable"].remedy


def test_places_of_discrete_modes_are_in_the_z_plane():
    G = control.tf([1.0], [1.0, -1.0], 0.1)
    check = check_synthesis(mixed_sensitivity(G, 1.0, 0.1, None), 1, 1)
    assert "on the unit circle, at z = 1" in check["measurement zeros"].sentence


def test_discrete_pole_at_minus_one_is_refused():
    check = check_synthesis(
        control.ss([[-1.0]], np.ones((1, 2)), np.ones((2, 1)), np.eye(2), 1), 1, 1
    )
    assert failed(check) == {"bilinear transform"}
    assert "z = -1" in str(check)


@pytest.mark.parametrize(("n_meas", "n_ctrl"), [(2, 1), (1, 2), (3, 1)])
def test_sizes(n_meas, n_ctrl):
    P = mixed_sensitivity(LAG, W1, None, None)
    assert failed(check_synthesis(P, n_meas, n_ctrl)) == {"dimensions"}


def test_units_do_not_matter():
    """A change of the unit of any signal or state leaves the verdict."""
    P = mixed_sensitivity(1 / (s**2 + 0.2 * s + 4), W1, 0.1, None)
    T = np.diag(10.0 ** np.arange(-4, -4 + 3 * P.nstates, 3))
    scaled = control.ss(
        T @ P.A @ np.linalg.inv(T), 1e6 * T @ P.B, 1e-5 * P.C @ np.linalg.inv(T), 10.0 * P.D
    )
    assert check_synthesis(scaled, 1, 1).passed
    lost = mixed_sensitivity(1 / (s**2 + 4), W1, 0.1, None)
    lost = control.ss(
        T @ lost.A @ np.linalg.inv(T),
        1e6 * T @ lost.B,
        1e-5 * lost.C @ np.linalg.inv(T),
        10 * lost.D,
    )
    assert failed(check_synthesis(lost, 1, 1)) == {"measurement zeros"}
