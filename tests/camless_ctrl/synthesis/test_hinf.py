"""H-infinity synthesis against the textbook, interpolation, Nehari and the bilinear transform."""

from __future__ import annotations

import control
import matplotlib
import numpy as np
import pytest
import slycot
from scipy.linalg import toeplitz

from camless_ctrl.margins import stability_margins
from camless_ctrl.synthesis import (
    SynthesisError,
    hinf_synthesis,
    mixed_sensitivity,
    run_stoppable,
)
from camless_ctrl.synthesis._realisation import (
    close,
    hinf_norm,
    realisation_of,
    to_continuous,
    to_discrete,
)
from plant import ParameterError

matplotlib.use("Agg")

s = control.tf("s")


def gain_on_grid(system, omega):
    response = system(1j * omega if system.dt == 0 else np.exp(1j * omega * system.dt))
    return np.linalg.norm(np.moveaxis(np.atleast_3d(response), -1, 0), 2, (1, 2)).max()


def test_example_2_17(example_2_17):
    G, wP = example_2_17
    P = mixed_sensitivity(G, wP, 1.0, None)
    result = hinf_synthesis(P, 1, 1)
    assert result.gamma == pytest.approx(1.37, abs=0.005)  # the book's figure
    # The loop closed by the library, from its own pieces.
    K = result.controller
    L = control.ss(G) * K
    S, KS = control.feedback(1, L), control.feedback(K, control.ss(G))
    assert np.all(control.poles(S).real < 0)
    omega = np.geomspace(1e-3, 1e4, 3000)
    stacked = np.hypot(np.abs((wP * S)(1j * omega)), np.abs(KS(1j * omega)))
    assert stacked.max() == pytest.approx(result.gamma, rel=1e-3)
    assert K.input_labels == ["error[1]"]
    assert K.output_labels == ["control[1]"]
    assert "verified closed-loop H-infinity norm of 1.367" in str(result)


@pytest.mark.parametrize("zero", [0.5, 2.0])
def test_zero_in_the_right_half_plane_bounds_the_weighted_sensitivity(zero):
    """S(zero) = 1, so that gamma = |W1(zero)| by the maximum principle."""
    G, W1 = (zero - s) / (s + 1), (s / 2 + 1) / (s + 0.1)
    result = hinf_synthesis(mixed_sensitivity(G, W1, 1e-3, None), 1, 1)
    bound = abs(W1(zero))
    assert bound <= result.gamma <= bound * 1.005


@pytest.mark.parametrize(("pole", "delay"), [(0.9, 3), (0.98, 5), (0.5, 2)])
def test_delay_of_whole_samples(pole, delay):
    """For G = z^-k the least norm of W S is that of the Toeplitz matrix of W's first k samples.

    Caratheodory and Fejer: what a k-sample delay leaves of W is fixed, the rest is free.
    """
    G = control.tf([1.0], [1.0] + [0.0] * delay, 0.02)
    W1 = control.tf([1.0, 0.0], [1.0, -pole], 0.02)
    first = pole ** np.arange(delay)
    bound = np.linalg.norm(toeplitz(first, np.eye(1, delay)[0]), 2)
    result = hinf_synthesis(mixed_sensitivity(G, W1, 1e-2, None), 1, 1)
    assert bound <= result.gamma <= bound * 1.003
    assert result.controller.dt == 0.02


def test_control_out_of_reach_of_the_error_leaves_the_open_loop_norm():
    P = control.ss(
        [[-1.0]], [[2.0, 0.0]], [[1.0], [0.0], [0.0]], [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]
    )  # z1 = 2/(s + 1) w
    assert hinf_synthesis(P, 1, 1).gamma == pytest.approx(2.0, rel=2e-3)


@pytest.mark.parametrize("dt", [0.01, 0.2])
def test_discrete_equals_continuous_through_tustin(example_2_17, dt):
    G, wP = example_2_17
    P = mixed_sensitivity(G, wP, 1.0, None)
    discrete = hinf_synthesis(control.sample_system(P, dt, "tustin"), 1, 1, tolerance=1e-4)
    continuous = hinf_synthesis(P, 1, 1, tolerance=1e-4)
    assert discrete.gamma == pytest.approx(continuous.gamma, rel=2e-4)
    loop = discrete.closed_loop
    assert np.all(np.abs(control.poles(loop)) < 1)
    omega = np.geomspace(1e-4, np.pi / dt, 4000)
    assert gain_on_grid(loop, omega) == pytest.approx(discrete.gamma, rel=1e-3)


def test_bilinear_transform_is_tustin_and_goes_back():
    G = control.drss(4, 2, 3)
    G = control.ss(0.9 * G.A / max(1.0, np.abs(G.poles()).max()), G.B, G.C, G.D, 0.5)
    there = to_continuous(realisation_of(G))
    z = np.exp(1j * np.array([0.1, 1.0, 3.0]))
    image = there.response((z - 1) / (z + 1))
    np.testing.assert_allclose(image, np.moveaxis(G(z), -1, 0), rtol=1e-9, atol=1e-9)
    back = to_discrete(there)
    for matrix, original in zip(back, (G.A, G.B, G.C, G.D), strict=True):
        np.testing.assert_allclose(matrix, original, atol=1e-10)


@pytest.mark.parametrize("damping", [0.5, 0.1, 1e-3])
def test_norm_of_a_resonance(damping):
    G = control.ss(control.tf([1], [1, 2 * damping, 1]))
    peak = 1 / (2 * damping * np.sqrt(1 - damping**2))
    assert hinf_norm(realisation_of(G), False) == pytest.approx(peak, rel=1e-6)
    there = to_discrete(realisation_of(G))
    assert hinf_norm(there, True) == pytest.approx(peak, rel=1e-6)
    assert hinf_norm(realisation_of(control.ss(control.tf([1], [1, -1]))), False) == np.inf


def test_closing_agrees_with_the_library():
    rng = np.random.default_rng(2)
    P = control.ss(*(rng.normal(size=s) for s in ((3, 3), (3, 5), (4, 3), (4, 5))))
    K = control.ss(*(rng.normal(size=s) for s in ((2, 2), (2, 1), (2, 2), (2, 1))))
    ours = close(realisation_of(P), realisation_of(K), 1, 2)
    theirs = P.lft(K, 2, 1)
    points = 1j * np.array([0.0, 0.3, 2.0, 50.0])
    np.testing.assert_allclose(
        ours.response(points), np.moveaxis(theirs(points), -1, 0), rtol=1e-8, atol=1e-10
    )
    with pytest.raises(ParameterError, match="singular algebraic loop"):
        close(realisation_of(control.ss([], [], [], np.ones((2, 2)))), realisation_of(
            control.ss([], [], [], [[1.0]])), 1, 1)  # fmt: skip


def test_norm_that_can_be_made_zero_ends_too():
    """The controls alone disturb (z = u): no control is best, the norm is zero."""
    P = control.ss([[-1.0]], [[1.0, 1.0]], [[0.0], [1.0]], [[0.0, 1.0], [1.0, 0.0]])
    result = hinf_synthesis(P, 1, 1)
    assert result.gamma < 1e-8


def test_solver_without_end_is_stopped_and_agrees_once_regularised():
    """SB10AD searches by itself for ever without W2; with it, its least gamma is ours."""
    G, W1, W3 = 1 / (s + 1) ** 2, (s / 2 + 1) / (s + 1e-4), (s + 0.1) / (s + 10)

    def search(P, timeout_s):
        sizes = (P.nstates, P.ninputs, P.noutputs, 1, 1)
        args = (*sizes, 1e100, P.A, P.B, P.C, P.D)
        return run_stoppable(slycot.sb10ad, args, timeout_s)[0]

    with pytest.raises(SynthesisError, match="sb10ad was stopped at its time limit of 1 s"):
        search(mixed_sensitivity(G, W1, None, W3), 1.0)
    P = mixed_sensitivity(G, W1, 1e-2, W3)
    result = hinf_synthesis(P, 1, 1)
    assert result.smallest_gamma == pytest.approx(search(P, 20.0), rel=1e-3)


def test_unstable_plant_is_stabilised():
    G = 1 / (s - 1)
    result = hinf_synthesis(mixed_sensitivity(G, (s / 2 + 1) / (s + 1e-4), 0.1, None), 1, 1)
    assert np.all(control.poles(control.feedback(control.ss(G) * result.controller)).real < 0)


def test_plant_of_two_inputs_and_its_signals():
    G = control.tf([[[1], [0.2]], [[0.1], [1]]], [[[1, 1], [2, 1]], [[1, 3], [1, 2]]])
    P = mixed_sensitivity(G, (s / 2 + 1) / (s + 1e-3), 0.1, 0.5)
    assert P.input_labels == ["reference[1]", "reference[2]", "control[1]", "control[2]"]
    assert P.output_labels[0::2] == [
        "error_weighted[1]", "control_weighted[1]", "output_weighted[1]", "error[1]",
    ]  # fmt: skip
    result = hinf_synthesis(P, 2, 2)
    G = control.ss(G)
    S = control.feedback(control.ss([], [], [], np.eye(2)), G * result.controller)
    omega = np.geomspace(1e-4, 1e3, 800)
    W = control.ss((s / 2 + 1) / (s + 1e-3))
    weighted = gain_on_grid(control.append(W, W) * S, omega)
    assert weighted <= result.gamma * (1 + 1e-6)
    assert gain_on_grid(result.closed_loop, omega) == pytest.approx(result.gamma, rel=1e-2)


def test_lqg_has_no_guaranteed_margin_but_this_has():
    """Doyle (1978): the gain margin of LQG vanishes as the weights grow."""
    A, B, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    margins = []
    for q in (1e1, 1e2, 1e3, 1e4):
        F = control.lqr(A, B, q * np.ones((2, 2)), 1.0)[0]
        H = control.lqe(A, np.eye(2), C, q * np.ones((2, 2)), 1.0)[0]
        f = 2 + np.sqrt(4 + q)  # Doyle's closed form
        np.testing.assert_allclose(F, [[f, f]], rtol=1e-6)
        K = control.ss(A - B @ F - H @ C, H, F, 0)
        found = stability_margins(control.ss(A, B, C, 0) * K)
        assert found.stable
        margins.append(found.gain_margin)
    assert np.all(np.diff(margins) < 0)
    assert margins[-1] < 1.01
    # The balanced-disk design for the same plant: perturbations enter with the control.
    P = control.ss(
        A,
        np.hstack([B, np.zeros((2, 1)), B]),
        np.vstack([np.zeros((1, 2)), C, C]),
        [[0, 0, 1], [0, 1, 0], [0, 1, 0]],
    )
    robust = hinf_synthesis(P, 1, 1)
    loop = control.ss(A, B, C, 0) * -robust.controller
    assert stability_margins(loop).gain_margin > 1.1


def test_improper_central_controller_is_told_with_its_remedy():
    """One-block problem: ``S -> 0`` at infinite frequency asks for an infinite gain there."""
    G, W1 = (1 - s) / (s + 1), (s / 2 + 1) / (s + 0.1)
    with pytest.raises(SynthesisError, match=r"no controller makes .* add a small W2 weight"):
        hinf_synthesis(mixed_sensitivity(G, W1, None, None), 1, 1)


def test_wrong_arguments_and_too_short_a_limit(example_2_17):
    G, wP = example_2_17
    P = mixed_sensitivity(G, wP, 1.0, None)
    with pytest.raises(ParameterError, match="tolerance is 0, but must be in"):
        hinf_synthesis(P, 1, 1, tolerance=0.0)
    with pytest.raises(ParameterError, match="n_meas must be a whole number"):
        hinf_synthesis(P, 1.5, 1)
    with pytest.raises(ParameterError, match="FrequencyResponseData"):
        hinf_synthesis(control.frd([1.0, 2.0], [1.0, 2.0]), 1, 1)
    with pytest.raises(SynthesisError, match=r"stopped at its time limit of 0\.01 s"):
        hinf_synthesis(P, 1, 1, timeout_s=0.01)


def test_wrong_weights_are_refused(example_2_17):
    G, wP = example_2_17
    with pytest.raises(ParameterError, match="no weight is given"):
        mixed_sensitivity(G, None, None, None)
    with pytest.raises(ParameterError, match="W3 is improper"):
        mixed_sensitivity(G, wP, 1.0, s + 1)
    with pytest.raises(ParameterError, match=r"W1 has the sampling time 0, but the plant has 0\.1"):
        mixed_sensitivity(control.sample_system(G, 0.1), wP, 1.0, None)
    with pytest.raises(ParameterError, match="W2 is 2 x 2, but must be 1 x 1"):
        mixed_sensitivity(G, wP, control.ss([], [], [], np.eye(2)), None)


def test_plant_of_order_15_has_the_norm_that_is_told():
    poles = np.linspace(0.5, 6.0, 12)
    G = control.ss(control.zpk([], -poles, np.prod(poles)))
    P = mixed_sensitivity(G, (s / 2 + 0.1) / (s + 1e-4), 0.5, (s + 0.1) ** 2 / (s + 20) ** 2)
    assert P.nstates == 15
    result = hinf_synthesis(P, 1, 1)
    assert result.controller.nstates == 15
    omega = np.geomspace(1e-5, 1e4, 4000)
    response = np.asarray(result.closed_loop(1j * omega, squeeze=False))
    peak = np.linalg.svd(np.moveaxis(response, -1, 0), compute_uv=False).max()
    assert peak == pytest.approx(result.gamma, rel=5e-3)


def test_plot(example_2_17):
    G, wP = example_2_17
    result = hinf_synthesis(mixed_sensitivity(G, wP, 1.0, None), 1, 1)
    ax = result.plot()
    assert ax.get_xlabel() == "frequency (rad/s)"
    assert ax.lines[0].get_ydata().max() == pytest.approx(result.gamma, rel=1e-3)
