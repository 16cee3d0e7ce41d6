"""Mu over the frequency against stability radii in closed form."""

import control
import matplotlib as mpl
import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from camless_ctrl.margins import stability_margins
from camless_ctrl.mu import (
    BlockStructure,
    ComplexBlock,
    FullBlock,
    RealBlock,
    lft,
    mu_analysis,
    mu_upper,
    skewed_mu,
)
from plant import ParameterError

mpl.use("Agg")


def companion(*coefficients):
    """Polynomial ``s^n + (c1 + d1) s^(n-1) + ...`` with perturbations of its coefficients."""
    n = len(coefficients)
    A = np.eye(n, k=1)
    A[-1] = -np.array(coefficients[::-1])
    B = np.zeros((n, n))
    B[-1] = -1.0
    return control.ss(A, B, np.fliplr(np.eye(n)), np.zeros((n, n)))


def real(count):
    return BlockStructure([RealBlock(f"d{i + 1}") for i in range(count)])


def boundary(poles, dt):
    """Distance of the pole nearest to the stability boundary."""
    return np.min(np.abs(np.abs(poles) - 1.0) if dt else np.abs(poles.real))


@pytest.mark.parametrize(("a", "b"), [(3.0, 1.0), (1.0, 4.0), (0.2, 2.0)])
def test_second_order_parameters_fail_where_the_smaller_one_vanishes(a, b):
    # s^2 + (a + d1) s + b + d2 is stable while both coefficients are positive
    result = mu_analysis(companion(a, b), real(2))
    exact = 1.0 / min(a, b)
    assert result.peak_lower == pytest.approx(exact, rel=1e-6)
    assert exact * (1.0 - 1e-9) <= result.peak_upper <= 1.005 * exact
    assert result.guaranteed
    assert result.ceiling >= exact
    assert result.worst.size == pytest.approx(min(a, b), rel=1e-6)
    assert boundary(lft(_open(companion(a, b)), result.worst).poles(), 0.0) < 1e-6


def test_two_parameters_fail_at_a_vertex():
    # s^3 + (2 + d1) s^2 + (3 + d2) s + 1: Routh and Hurwitz, (2 - t)(3 - t) = 1 at w^2 = 3 - t
    third = companion(2.0, 3.0, 1.0)
    system = control.ss(third.A, third.B[:, :2], third.C[:2], np.zeros((2, 2)))
    radius = 0.5 * (5.0 - np.sqrt(5.0))
    result = mu_analysis(system, real(2))
    assert result.peak_lower == pytest.approx(1.0 / radius, rel=1e-6)
    assert 1.0 / radius <= result.peak_upper * (1.0 + 1e-9) <= 1.005 / radius
    assert result.worst_frequency == pytest.approx(np.sqrt(3.0 - radius), rel=1e-4)
    assert result.worst["d1"] == pytest.approx(-radius, rel=1e-5)
    assert result.worst["d2"] == pytest.approx(-radius, rel=1e-5)
    assert result.peak_gap < 0.005


def test_one_real_parameter_fails_at_one_frequency_alone():
    # s^2 + s + 4 + d: mu is 1/4 at zero frequency, and zero everywhere else
    system = control.ss([[0.0, 1.0], [-4.0, -1.0]], [[0.0], [-1.0]], [[1.0, 0.0]], [[0.0]])
    result = mu_analysis(system, real(1))
    assert result.peak_lower == pytest.approx(0.25, rel=1e-6)
    assert result.peak_upper == pytest.approx(0.25, rel=5e-3)
    assert result.worst_frequency == 0.0
    elsewhere = (result.omega > 1e-3) & (result.omega < 100.0)
    assert result.upper[elsewhere].max() < 1e-3
    assert result.guaranteed


def test_a_crossing_between_the_frequencies_is_found():
    # s^3 + 2 s^2 + (3 + d) s + 1 fails at d = -2.5 and w^2 = 1/2, which is no point of the grid
    third = companion(2.0, 3.0, 1.0)
    system = control.ss(third.A, third.B[:, 1:2], third.C[1:2], np.zeros((1, 1)))
    result = mu_analysis(system, real(1), [0.1, 0.5, 0.9, 2.0])
    assert result.peak_lower == pytest.approx(1.0 / 2.5, rel=1e-6)
    assert result.worst_frequency == pytest.approx(np.sqrt(0.5), rel=1e-6)
    assert result.peak_upper >= result.peak_lower * (1.0 - 1e-9)
    assert result.peak_upper == pytest.approx(0.4, rel=5e-3)
    assert result.guaranteed


@pytest.mark.parametrize(("pole", "end"), [(0.5, 0.0), (-0.5, np.pi / 0.1)])
def test_discrete_peaks_at_both_ends_of_the_circle(pole, end):
    # z - pole - d leaves the circle at z = 1 or at z = -1, the Nyquist frequency
    system = control.ss([[pole]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    for block in (RealBlock("d"), ComplexBlock("d")):
        result = mu_analysis(system, BlockStructure([block]))
        assert result.peak_upper == pytest.approx(2.0, rel=1e-6)
        assert result.peak_lower == pytest.approx(2.0, rel=1e-6)
        assert result.frequency == pytest.approx(end)
        assert result.worst_frequency == pytest.approx(end)
        assert result.guaranteed


def test_the_disk_margin_of_seiler_packard_and_gahinet():
    # L = 25/(s^3 + 10 s^2 + 10 s + 10): balanced disk margin 0.46
    s = control.tf("s")
    loop = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    system = control.ss(control.feedback(1, loop) - 0.5)
    result = mu_analysis(system, BlockStructure([ComplexBlock("disk")]))
    assert 1.0 / result.peak_upper == pytest.approx(0.46, abs=0.005)
    margins = stability_margins(loop)
    assert 1.0 / result.peak_upper == pytest.approx(margins.disk_margin, rel=1e-4)
    assert 1.0 / result.peak_lower == pytest.approx(margins.disk_margin, rel=1e-4)
    assert result.frequency == pytest.approx(margins.frequency, rel=0.01)


@pytest.mark.parametrize("dt", [0.0, 0.02])
def test_the_realised_perturbation_puts_a_pole_on_the_boundary(dt):
    system = control.ss(
        [[-1.0, 2.0, 0.0], [-2.0, -1.0, 1.0], [0.0, -0.5, -4.0]],
        [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [1.0, 0.0, 2.0]],
        [[1.0, 0.0, 1.0], [0.0, 2.0, 0.0], [1.0, 1.0, 0.0]],
        np.zeros((3, 3)),
    )
    if dt:
        system = control.sample_system(system, dt, "bilinear")
    structure = BlockStructure([RealBlock("a"), FullBlock("f", 2, 2)])
    result = mu_analysis(system, structure)
    assert result.peak_gap < 0.05
    assert np.all(result.lower <= result.upper * (1.0 + 1e-9))
    realised = result.worst.realise(result.worst_frequency, system.dt)
    assert boundary(lft(_open(system), realised).poles(), dt) < 1e-8
    # a little smaller: stable
    smaller = result.worst.scaled(0.99).realise(result.worst_frequency, system.dt)
    poles = lft(_open(system), smaller).poles()
    assert np.all(np.abs(poles) < 1.0) if dt else np.all(poles.real < 0.0)


def _open(system):
    """Return the system with one more input and output, which `lft` leaves."""
    n, (p, m) = system.nstates, system.D.shape
    return control.ss(
        system.A,
        np.hstack((system.B, np.ones((n, 1)))),
        np.vstack((system.C, np.ones((1, n)))),
        np.zeros((p + 1, m + 1)) + np.pad(system.D, ((0, 1), (0, 1))),
        system.dt,
    )


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_no_sampled_perturbation_below_the_margin_destabilises(dt):
    rng = np.random.default_rng(11)
    A = rng.standard_normal((5, 5))
    if dt:
        A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    else:
        A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(5)
    structure = BlockStructure([RealBlock("a", 2), RealBlock("b"), FullBlock("f", 2, 1)])
    B, C = rng.standard_normal((5, structure.outputs)), rng.standard_normal((structure.inputs, 5))
    result = mu_analysis(control.ss(A, B, C, 0.0, dt), structure)
    assert result.guaranteed
    worst = -np.inf
    for seed in range(400):
        gain = structure.random(seed).matrix()
        delta = gain.real / max(1.0, np.linalg.norm(gain.real, 2)) * result.margin
        poles = np.linalg.eigvals(A + B @ delta @ C)
        worst = max(worst, np.abs(poles).max() - 1.0 if dt else poles.real.max())
    assert worst < 0.0
    assert np.all(result.lower <= result.upper * (1.0 + 1e-9))


def test_the_proof_finds_a_resonance_that_the_given_frequencies_miss():
    # 1/(s^2 + 2 xi s + 1) peaks at 1/(2 xi sqrt(1 - xi^2)), in a band of 1e-4 rad/s
    xi = 1e-4
    system = control.ss(control.tf([1.0], [1.0, 2.0 * xi, 1.0]))
    result = mu_analysis(system, BlockStructure([ComplexBlock("c")]), np.geomspace(0.01, 70.0, 9))
    exact = 0.5 / xi / np.sqrt(1.0 - xi**2)
    assert result.guaranteed
    assert result.peak_upper <= exact * (1.0 + 1e-9)
    assert result.ceiling >= exact
    assert result.ceiling <= 1.006 * exact


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_the_proof_from_three_frequencies_covers_dense_samples(dt):
    rng = np.random.default_rng(14)
    structure = BlockStructure([RealBlock("a"), ComplexBlock("b"), FullBlock("f", 2, 1)])
    corners, damping = np.array([0.3, 0.9, 1.7]), np.array([1e-2, 1e-3, 3e-2])
    A = block_diag(*corners[:, None, None] * np.array([[[-z, 1.0], [-1.0, -z]] for z in damping]))
    if dt:
        A = expm(A)
    B, C = rng.standard_normal((6, structure.outputs)), rng.standard_normal((structure.inputs, 6))
    system = control.ss(A, B, C, 0.0, dt)
    result = mu_analysis(system, structure, [0.05, 0.5, 3.0])
    assert result.guaranteed
    near = corners[:, None] * (1.0 + damping[:, None] * np.linspace(-4.0, 4.0, 21))
    omega = np.concatenate((np.linspace(0.0, 3.1, 40), near.ravel()))
    points = np.exp(1j * omega) if dt else 1j * omega
    dense = max(mu_upper(system(p), structure).value for p in points)
    assert dense <= result.ceiling <= 1.02 * dense


def test_a_complex_scalar_is_the_norm_of_the_system():
    system = control.ss(control.tf([1.0, 3.0], [1.0, 0.4, 2.0]))
    result = mu_analysis(system, BlockStructure([ComplexBlock("c")]))
    assert result.peak_upper == pytest.approx(control.linfnorm(system)[0], rel=5e-3)
    np.testing.assert_allclose(result.upper, np.abs(system(1j * result.omega)), rtol=1e-9)
    np.testing.assert_allclose(result.lower, result.upper, rtol=1e-6)


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_a_constant_matrix_and_zero(dt):
    # diag(2, -3) against a real and a complex scalar: 3 at every frequency
    structure = BlockStructure([RealBlock("r"), ComplexBlock("c")])
    result = mu_analysis(control.ss([], [], [], np.diag([2.0, -3.0]), dt), structure)
    assert (result.peak_lower, result.peak_upper) == pytest.approx((3.0, 3.0), rel=1e-6)
    assert result.guaranteed
    nothing = mu_analysis(control.ss([], [], [], np.zeros((2, 2)), dt), structure)
    assert nothing.peak_upper == 0.0
    assert nothing.margin == np.inf
    assert nothing.worst is None
    assert "None was found that destabilises" in str(nothing)


def test_an_unstable_system_has_no_mu():
    with pytest.raises(ParameterError, match=r"not stable, pole at 1.*mu says nothing"):
        mu_analysis(control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]]), real(1))
    with pytest.raises(ParameterError, match="not stable"):
        mu_analysis(control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 1.0), real(1))
    with pytest.raises(ParameterError, match="shift a weight's integrator"):
        mu_analysis(control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]]), real(1))
    with pytest.raises(ParameterError, match="1 outputs and 1 inputs"):
        mu_analysis(control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), real(2))


def test_frequency_data_and_functions_need_to_be_known_as_stable():
    omega = np.geomspace(0.01, 100.0, 60)
    system = control.ss(control.tf([2.0], [1.0, 1.0, 2.0]))
    structure = BlockStructure([ComplexBlock("c")])
    exact = np.abs(system(1j * omega))
    data = control.frd(system, omega)

    def function(w):
        return system(1j * np.asarray(w)).reshape(-1, 1, 1)

    for M, frequencies in ((data, None), (function, omega)):
        with pytest.raises(ParameterError, match="not known to be stable"):
            mu_analysis(M, structure, frequencies)
        with pytest.raises(ParameterError, match="is unstable"):
            mu_analysis(M, structure, frequencies, stable=False)
        result = mu_analysis(M, structure, frequencies, stable=True)
        assert not result.guaranteed
        assert result.ceiling == np.inf
        assert "nothing is proved between them" in str(result)
        at = np.isin(result.omega, omega)
        np.testing.assert_allclose(result.upper[at], exact, rtol=1e-9)
    assert result.peak_upper == pytest.approx(control.linfnorm(system)[0], rel=1e-3)
    with pytest.raises(ParameterError, match="needs omega"):
        mu_analysis(function, structure, stable=True)
    with pytest.raises(ParameterError, match="differs from the frequencies of the data"):
        mu_analysis(data, structure, [1.0], stable=True)
    with pytest.raises(ParameterError, match="is no system"):
        mu_analysis(3.0, structure, stable=True)


def test_skewed_mu_of_a_held_parameter():
    # s^3 + (2 + d1) s^2 + (3 + d2) s + 1 with |d1| <= 1: (2 - 1)(3 - t) = 1, t = 2
    third = companion(2.0, 3.0, 1.0)
    system = control.ss(third.A, third.B[:, :2], third.C[:2], np.zeros((2, 2)))
    result = skewed_mu(system, real(2), "d2")
    assert result.held == ("d1",)
    assert result.peak_lower == pytest.approx(0.5, rel=1e-6)
    assert 0.5 <= result.peak_upper * (1.0 + 1e-9) <= 0.5 * 1.011
    assert result.worst["d1"] == pytest.approx(-1.0, rel=1e-6)
    assert result.worst["d2"] == pytest.approx(-2.0, rel=1e-6)
    assert str(result).startswith("With d1 at the assumed size, mu peaks between 0.500")
    with pytest.raises(ParameterError, match="one at least must be free and one held"):
        skewed_mu(system, real(2), ["d1", "d2"])


def test_the_result_speaks_and_draws():
    result = mu_analysis(companion(3.0, 1.0), real(2))
    text = str(result)
    assert "(proved at all frequencies)" in text
    assert "d2 = -1" in text
    assert result.robust is False
    assert mu_analysis(companion(3.0, 2.0), real(2)).robust is True
    ax = result.plot()
    assert ax.get_xlabel() == "frequency (rad per time unit)"
    assert {t.get_text() for t in ax.get_legend().get_texts()} >= {"upper bound", "lower bound"}
    calls = []
    mu_analysis(companion(3.0, 2.0), real(2), [0.1, 1.0], progress=lambda *a: calls.append(a))
    assert calls == [(1, 2), (2, 2)]
