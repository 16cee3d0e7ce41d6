"""D-K iteration on the distillation process of Skogestad and Postlethwaite, 8.12.4."""

from __future__ import annotations

import itertools

import control
import matplotlib
import numpy as np
import pytest

from camless_ctrl.synthesis import (
    SynthesisError,
    dk,
    dk_synthesis,
    hinf_synthesis,
    mixed_sensitivity,
)
from plant import ParameterError

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def result(distillation):
    calls = []
    found = dk_synthesis(
        distillation, [1, 1, 2], 2, 2, iterations=3, order=4,
        progress=lambda done, most: calls.append((done, most)),
    )  # fmt: skip
    assert calls == [(1, 3), (2, 3), (3, 3)]
    return found


def test_figures_of_the_book(result):
    """Book: gamma 1.1823 with D = 1, then 1.0238 and 1.019; the least mu is 0.974."""
    assert result.history[0].gamma == pytest.approx(1.1823, abs=0.003)
    assert result.history[0].peak_mu == pytest.approx(1.1818, abs=0.003)
    assert result.history[1].gamma < 1.06
    assert 0.974 < result.peak_mu < 1.03


def test_history_is_kept_and_the_best_iterate_chosen(result):
    assert [step.number for step in result.history] == [1, 2, 3]
    assert result.peak_mu == min(step.peak_mu for step in result.history)
    assert result.peak_mu == pytest.approx(result.mu.max())
    for step in result.history:  # mu is below the norm with any scalings
        assert step.peak_mu <= step.gamma * (1 + 1e-3)
    for before, after in itertools.pairwise(result.history):
        # The fitted scalings with the controller before are one candidate of the K step.
        assert after.gamma <= before.peak_mu * (1 + before.fit_loss) * (1 + 2e-3)
    assert result.history[0].controller_order == 6
    assert result.controller.nstates == result.best.controller_order


def test_scalings_prove_the_bound(result):
    omega = result.frequency
    N = np.moveaxis(result.closed_loop(1j * omega), -1, 0)
    d = np.column_stack([result.scalings[:, [0, 1]], result.scalings[:, [2, 2]]])
    scaled = np.linalg.norm(N * d[:, :, None] / d[:, None, :], 2, (1, 2))
    np.testing.assert_allclose(scaled, result.mu, rtol=1e-8)


def test_performance_holds_for_perturbations_of_the_size_that_mu_allows(result):
    """||F_u(N, Delta)|| <= beta for ||Delta|| <= 1/beta, here for gains and all-pass lags."""
    beta = result.peak_mu * 1.002  # mu is known on a grid
    worst = 0.0
    one = control.ss([], [], [], [[1.0]])
    lag = control.ss(control.tf([1, -0.5], [1, 0.5]))  # |lag| = 1
    for first, second in itertools.product([one, -one, lag, -lag], repeat=2):
        delta = control.append(first, second) * (1.0 / beta)
        perturbed = _upper(result.closed_loop, delta)
        assert np.all(control.poles(perturbed).real < 0)
        omega = np.geomspace(1e-5, 1e3, 400)
        response = np.moveaxis(perturbed(1j * omega), -1, 0)
        worst = max(worst, np.linalg.norm(response, 2, (1, 2)).max())
    assert 0.8 * beta < worst <= beta


def _upper(N, delta):
    """Close `delta` around the first channels of N (whose lft closes the last ones)."""
    order_out, order_in = [2, 3, 0, 1], [2, 3, 0, 1]
    turned = control.ss(N.A, N.B[:, order_in], N.C[order_out], N.D[np.ix_(order_out, order_in)])
    return turned.lft(delta, 2, 2)


def test_words_and_plots(result):
    text = str(result)
    assert text.startswith(f"peak mu {result.peak_mu:.4g}")
    assert "ended because 3 iterations were asked for" in text
    assert text.count("- iteration") == 3
    assert result.robust is (result.peak_mu < 1.0)
    ax = result.plot()
    np.testing.assert_allclose(ax.lines[1].get_ydata(), [s.peak_mu for s in result.history])
    assert ax.get_xlabel() == "iteration"
    assert result.plot_mu().get_xlabel() == "frequency (rad/s)"


def test_discrete_version_gives_the_same(distillation):
    grid = np.geomspace(1e-4, 1e2, 90)
    T = 0.05
    warped = 2.0 / T * np.arctan(0.5 * T * grid)  # the same points through Tustin
    settings = {"iterations": 2, "order": 2}
    continuous = dk_synthesis(distillation, [1, 1, 2], 2, 2, frequency=grid, **settings)
    sampled = control.sample_system(distillation, T, "tustin")
    discrete = dk_synthesis(sampled, [1, 1, 2], 2, 2, frequency=warped, **settings)
    for one, other in zip(continuous.history, discrete.history, strict=True):
        assert other.gamma == pytest.approx(one.gamma, rel=3e-3)
        assert other.peak_mu == pytest.approx(one.peak_mu, rel=3e-3)
    assert discrete.controller.dt == T
    assert np.all(np.abs(control.poles(discrete.closed_loop)) < 1)
    assert discrete.frequency.max() < np.pi / T


def test_single_block_is_plain_h_infinity(example_2_17):
    G, wP = example_2_17
    P = mixed_sensitivity(G, wP, 1.0, None)
    found = dk_synthesis(P, [(2, 1)], 1, 1)
    assert len(found.history) == 1
    assert found.stopped == "a single block needs no scaling"
    assert found.peak_mu == pytest.approx(hinf_synthesis(P, 1, 1).gamma, rel=1e-3)


def test_units_of_the_blocks_do_not_matter_in_the_end():
    """Units that differ a hundredfold start the search elsewhere; it ends at the same peak."""
    s = control.tf("s")
    P = mixed_sensitivity(1 / (s + 1), (s / 2 + 0.3) / (s + 0.01), 1.0, None)
    # A disturbance at the plant's input joins: inputs w1, w2, u and outputs z1, z2, y.
    A, C = P.A, P.C
    B = np.hstack([P.B[:, :1], P.B[:, 1:], P.B[:, 1:]])
    D = np.hstack([P.D[:, :1], np.zeros((3, 1)), P.D[:, 1:]])
    plain = control.ss(A, B, C, D)
    odd = np.diag([100.0, 1.0, 1.0])
    scaled = control.ss(A, B @ np.linalg.inv(odd), odd @ C, odd @ D @ np.linalg.inv(odd))
    expected = dk_synthesis(plain, [1, 1], 1, 1, iterations=8, order=2).peak_mu
    found = dk_synthesis(scaled, [1, 1], 1, 1, iterations=5, order=2)
    assert found.history[0].peak_mu > 1.05 * found.peak_mu
    assert found.peak_mu == pytest.approx(expected, rel=0.01)


def test_failure_after_the_first_step_keeps_the_best(distillation, monkeypatch):
    real, calls = dk.solved, []

    def second_fails(*args):
        calls.append(args)
        if len(calls) == 2:
            raise SynthesisError("the solver gave up")
        return real(*args)

    monkeypatch.setattr(dk, "solved", second_fails)
    found = dk_synthesis(distillation, [1, 1, 2], 2, 2, order=1)
    assert len(found.history) == 1
    assert found.stopped == "the K step of iteration 2 failed: the solver gave up"


def test_wrong_arguments_are_refused(distillation):
    with pytest.raises(ParameterError, match=r"the plant is 6 x 6, but .* asks for 5 x 5"):
        dk_synthesis(distillation, [1, 2], 2, 2)
    with pytest.raises(ParameterError, match="order has 1 entries, but must have 2"):
        dk_synthesis(distillation, [1, 1, 2], 2, 2, order=[2])
    with pytest.raises(ParameterError, match="at least 20 values"):
        dk_synthesis(distillation, [1, 1, 2], 2, 2, frequency=[1.0, 2.0])
