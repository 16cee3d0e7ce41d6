"""Order reduction judged by the loop: bounds of theory, kept modes, never an unstable loop."""

from __future__ import annotations

import control
import matplotlib
import numpy as np
import pytest

from camless_ctrl.synthesis import (
    ClosedLoopCheck,
    SynthesisError,
    hinf_synthesis,
    mixed_sensitivity,
    reduce_controller,
)

matplotlib.use("Agg")

s = control.tf("s")


def always(measure):
    """Judge that calls every loop stable, to see the reductions themselves."""
    return ClosedLoopCheck(lambda K: True, measure)


def distance(K, discrete=False):
    """Peak of the difference from `K` on a grid."""
    omega = np.linspace(0, np.pi, 500) if discrete else np.geomspace(1e-4, 1e4, 500)
    points = np.exp(1j * omega) if discrete else 1j * omega
    return lambda reduced: 1.0 + float(np.abs(K(points) - reduced(points)).max())


@pytest.mark.parametrize("discrete", [False, True])
def test_error_is_within_the_bound_of_glover(discrete):
    """||K - K_r|| is at most twice the sum of the Hankel singular values left out."""
    rng = np.random.default_rng(5)
    A = rng.normal(size=(6, 6))
    poles = np.linalg.eigvals(A)
    A = 0.9 * A / np.abs(poles).max() if discrete else A - (poles.real.max() + 0.2) * np.eye(6)
    K = control.ss(A, rng.normal(size=(6, 1)), rng.normal(size=(1, 6)), 0.3, 0.1 if discrete else 0)
    result = reduce_controller(K, always(distance(K, discrete)), 0.0)
    hankel = result.hankel_singular_values
    # Independent: square roots of the eigenvalues of the product of the Gramians.
    dlyap = control.dlyap if discrete else control.lyap
    Wc, Wo = dlyap(K.A, K.B @ K.B.T), dlyap(K.A.T, K.C.T @ K.C)
    gramians = np.sort(np.sqrt(np.linalg.eigvals(Wc @ Wo).real))[::-1]
    # Roots of eigenvalues: half of the digits are lost in the small ones.
    np.testing.assert_allclose(hankel, gramians, rtol=1e-6, atol=1e-8 * gramians[0])
    assert [row.order for row in result.table] == list(range(7))
    for row in result.table[:-1]:
        error = row.measure - 1.0
        assert gramians[row.order] * 0.5 <= error <= 2 * gramians[row.order :].sum() * (1 + 1e-6)


@pytest.mark.parametrize("dt", [0, 0.1])
def test_modes_that_are_not_stable_are_kept_exactly(dt):
    poles = [1.0, 1.2, 0.9, 0.5, 0.2] if dt else [0.0, 0.3, -1.0, -5.0, -20.0]
    K = control.ss(np.diag(poles), np.ones((5, 1)), [[1.0, 1.0, 0.2, 0.1, 0.1]], 0.0, dt)
    result = reduce_controller(K, always(lambda K: 1.0), 0.0)
    assert result.kept == result.order == 2
    np.testing.assert_allclose(
        np.sort(result.controller.poles().real), sorted(poles[:2]), atol=1e-9
    )
    assert result.controller.dt == dt


def test_surplus_modes_are_found_and_the_loop_stays():
    G = 200 / ((10 * s + 1) * (0.05 * s + 1) ** 2)
    P = mixed_sensitivity(G, (s / 1.5 + 10) / (s + 1e-3), 1.0, None)
    K = hinf_synthesis(P, 1, 1).controller
    surplus = control.ss(np.diag([-3.0, -30.0, -7.0]), np.ones((3, 1)), 1e-7 * np.ones((1, 3)), 0)
    K = control.ss(K + surplus, inputs=K.input_labels, outputs=K.output_labels)
    result = reduce_controller(K, ClosedLoopCheck.of_plant(P, 1, 1), 0.01)
    assert result.full_order == 7
    assert result.order <= 4
    assert result.measure <= 1.01 * result.full_measure
    assert result.full_measure == pytest.approx(1.367, abs=0.003)
    S = control.feedback(1, control.ss(G) * result.controller)  # closed by the library
    assert np.all(control.poles(S).real < 0)
    assert result.controller.output_labels == ["control[1]"]
    below = [row for row in result.table if row.order < result.order]
    assert not any(row.within for row in below)
    assert f"order {result.order} instead of 7" in str(result)
    assert result.plot().get_xlabel() == "order of the controller"


def test_controller_that_destabilises_is_never_returned():
    """1/(s - 1)^2 needs the controller's lead: low orders lose it and are marked unstable."""
    P = mixed_sensitivity(1 / (s - 1) ** 2, (s / 2 + 0.3) / (s + 1e-3), 1e-2, None)
    K = hinf_synthesis(P, 1, 1).controller
    result = reduce_controller(K, ClosedLoopCheck.of_plant(P, 1, 1), 1e6)  # anything stable will do
    unstable = [row for row in result.table if not row.stable]
    assert unstable
    assert all(np.isinf(row.measure) and not row.within for row in unstable)
    L = control.ss(1 / (s - 1) ** 2) * result.controller
    assert np.all(control.poles(control.feedback(L)).real < 0)
    assert result.order > 0
    assert "unstable" in str(result)


def test_discrete_loop_and_own_measure():
    G = control.sample_system(1 / (s + 1) ** 3, 0.1)
    W1 = control.sample_system((s / 2 + 0.5) / (s + 1e-3), 0.1, "tustin")
    P = mixed_sensitivity(G, W1, 0.2, None)
    K = hinf_synthesis(P, 1, 1).controller

    def error_peak(loop):
        z = np.exp(1j * np.linspace(0.0, np.pi, 300))
        return float(np.abs(loop(z)[0, 0]).max())

    check = ClosedLoopCheck.of_plant(P, 1, 1, error_peak, "peak of the weighted error")
    result = reduce_controller(K, check, 0.1)
    assert result.order < K.nstates
    assert result.name == "peak of the weighted error"
    S = control.feedback(control.ss([], [], [], 1, 0.1), control.ss(G) * result.controller)
    assert np.all(np.abs(control.poles(S)) < 1)


def test_gain_without_states_and_unstable_loops():
    P = mixed_sensitivity(1 / (s + 1), (s + 1) / (s + 0.1), 0.1, None)
    gain = control.ss([], [], [], [[1.0]])
    result = reduce_controller(gain, ClosedLoopCheck.of_plant(P, 1, 1), 0.0)
    assert result.order == 0
    with pytest.raises(SynthesisError, match="full controller is not stable"):
        reduce_controller(control.ss([], [], [], [[-5.0]]), ClosedLoopCheck.of_plant(P, 1, 1), 0.1)
