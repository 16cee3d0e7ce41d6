"""Bounds of single matrices against closed forms."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from camless_ctrl.mu import (
    BlockStructure,
    ComplexBlock,
    FullBlock,
    RealBlock,
    mu_lower,
    mu_upper,
)
from camless_ctrl.mu._scalings import improve
from camless_ctrl.mu.upper import Padding, certificate
from plant import ParameterError


def gaussian(rng, rows, columns):
    return rng.standard_normal((rows, columns)) + 1j * rng.standard_normal((rows, columns))


def both(M, blocks):
    structure = BlockStructure(blocks)
    return mu_upper(M, structure).value, mu_lower(M, structure, starts=8).value


def check(M, structure, bound):
    """The perturbation destabilises and has the size that the bound says."""
    delta = bound.delta
    assert delta.size == pytest.approx(1.0 / bound.value, rel=1e-9)
    loop = np.eye(structure.inputs) - M @ delta.matrix()
    assert bound.determinant <= 1e-6
    # singular in relation to its size, by another way than the eigenvalues
    sizes = np.linalg.svd(loop, compute_uv=False)
    assert sizes[-1] <= 1e-6 * sizes[0]


def test_a_complex_scalar_is_the_modulus():
    np.testing.assert_allclose(both([[3.0 - 4.0j]], [ComplexBlock("c")]), 5.0, rtol=1e-9)


@pytest.mark.parametrize("shape", [(3, 3), (2, 4), (4, 2), (1, 3)])
def test_a_full_block_is_the_largest_singular_value(shape):
    M = gaussian(np.random.default_rng(0), *shape)
    np.testing.assert_allclose(both(M, [FullBlock("f", *shape)]), np.linalg.norm(M, 2), rtol=1e-8)


def test_a_repeated_complex_scalar_is_the_spectral_radius():
    M = gaussian(np.random.default_rng(1), 4, 4)
    radius = np.abs(np.linalg.eigvals(M)).max()
    upper, lower = both(M, [ComplexBlock("c", 4)])
    assert lower == pytest.approx(radius, rel=1e-9)
    assert radius * (1.0 - 1e-9) <= upper <= radius * 1.003


def test_a_repeated_real_scalar_is_the_largest_real_eigenvalue():
    T = np.random.default_rng(2).standard_normal((4, 4))
    # eigenvalues 2, -3 and 4 exp(+-j): the pair is larger, but not real
    pair = 4.0 * np.array([[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]])
    middle = np.diag([2.0, -3.0, 0.0, 0.0])
    middle[2:, 2:] = pair
    M = T @ middle @ np.linalg.inv(T)
    upper, lower = both(M, [RealBlock("r", 4)])
    assert lower == pytest.approx(3.0, rel=1e-9)
    assert 3.0 * (1.0 - 1e-9) <= upper <= 3.0 * 1.003
    none = np.kron(np.eye(2), pair)
    upper, lower = both(none, [RealBlock("r", 4)])
    assert upper <= 1e-3 * 4.0
    assert lower == 0.0


def test_a_real_scalar_jumps():
    # 1 - M delta = 0 has a real solution for real M alone
    assert both([[2.0]], [RealBlock("r")]) == pytest.approx((2.0, 2.0))
    upper, lower = both([[2.0 + 0.1j]], [RealBlock("r")])
    assert upper < 1e-3
    assert lower == 0.0


def test_two_scalars_in_a_ring_are_the_geometric_mean():
    M = np.array([[0.0, 2.0 + 1.0j], [3.0j, 0.0]])
    exact = np.sqrt(abs(M[0, 1] * M[1, 0]))
    for blocks in ([ComplexBlock("a"), ComplexBlock("b")], [RealBlock("a"), ComplexBlock("b")]):
        np.testing.assert_allclose(both(M, blocks), exact, rtol=1e-6)


def test_diagonal_matrices_are_their_largest_entry():
    M = np.diag([1.0 + 1.0j, -3.0, 2.0j])
    blocks = [ComplexBlock("a"), ComplexBlock("b"), ComplexBlock("c")]
    np.testing.assert_allclose(both(M, blocks), 3.0, rtol=1e-6)
    # of real blocks only the real entry counts
    np.testing.assert_allclose(
        both(M, [RealBlock("a"), RealBlock("b"), RealBlock("c")]), 3.0, rtol=1e-3
    )


def test_rank_one_is_the_sum_of_the_products():
    # M = u v^H with complex scalars: mu = sum |u_i v_i|
    rng = np.random.default_rng(4)
    u, v = gaussian(rng, 4, 1), gaussian(rng, 4, 1)
    np.testing.assert_allclose(
        both(u @ v.conj().T, [ComplexBlock(f"c{i}") for i in range(4)]),
        np.abs(u * v).sum(),
        rtol=1e-6,
    )


def test_rank_one_with_real_scalars_is_a_linear_programme():
    # M = u v^H: mu = max sum d_i Re(c_i), |d_i| <= 1, sum d_i Im(c_i) = 0, c = conj(v) u
    from scipy.optimize import linprog

    rng = np.random.default_rng(5)
    for _ in range(5):
        u, v = gaussian(rng, 4, 1), gaussian(rng, 4, 1)
        c = (v.conj() * u)[:, 0]
        exact = -linprog(-c.real, A_eq=[c.imag], b_eq=[0.0], bounds=[(-1.0, 1.0)] * 4).fun
        upper, lower = both(u @ v.conj().T, [RealBlock(f"r{i}") for i in range(4)])
        assert lower == pytest.approx(exact, rel=1e-6)
        assert upper == pytest.approx(exact, rel=1e-3)  # exact for rank one (Young, 1994)


def test_two_full_blocks_are_the_least_scaled_gain():
    # two full blocks: the upper bound is exact (Doyle, 1982); here by one scalar scaling
    rng = np.random.default_rng(6)
    M = gaussian(rng, 5, 5)

    def scaled(log_d):
        d = np.exp(np.r_[[log_d] * 2, [0.0] * 3])
        return np.linalg.norm(d[:, None] * M / d, 2)

    exact = minimize_scalar(scaled, bounds=(-3.0, 3.0), method="bounded").fun
    np.testing.assert_allclose(
        both(M, [FullBlock("a", 2, 2), FullBlock("b", 3, 3)]), exact, rtol=1e-6
    )


def test_bounds_of_random_mixed_problems_enclose_each_other():
    rng = np.random.default_rng(7)
    gaps = []
    for _ in range(25):
        blocks = []
        for i in range(rng.integers(2, 5)):
            kind = rng.integers(3)
            if kind == 0:
                blocks.append(RealBlock(f"r{i}", int(rng.integers(1, 3))))
            elif kind == 1:
                blocks.append(ComplexBlock(f"c{i}", int(rng.integers(1, 3))))
            else:
                blocks.append(FullBlock(f"f{i}", *(int(k) for k in rng.integers(1, 4, 2))))
        structure = BlockStructure(blocks)
        M = gaussian(rng, structure.inputs, structure.outputs)
        upper, lower = mu_upper(M, structure), mu_lower(M, structure, starts=8)
        assert lower.value <= upper.value * (1.0 + 1e-9)
        if lower.delta is not None:
            check(M, structure, lower)
        gaps.append(1.0 - lower.value / upper.value)
    assert np.median(gaps) < 0.01


def test_the_upper_bound_is_certified_and_no_sample_exceeds_it():
    rng = np.random.default_rng(8)
    structure = BlockStructure([ComplexBlock("a", 2), FullBlock("f", 2, 3), ComplexBlock("c")])
    for trial in range(5):
        M = gaussian(rng, structure.inputs, structure.outputs)
        bound = mu_upper(M, structure)
        full = Padding(structure).fill(M)
        form = full.conj().T @ bound.D @ full - bound.value**2 * bound.D
        assert np.linalg.eigvalsh(form)[-1] <= 1e-9 * np.linalg.norm(form)
        assert np.linalg.eigvalsh(bound.D)[0] > 0.0
        worst = max(
            np.abs(np.linalg.eigvals(M @ structure.random(100 * trial + k).matrix())).max()
            for k in range(200)
        )
        assert 0.3 * bound.value < worst <= bound.value


def test_scalings_of_ab13md_and_of_the_method_of_centres_agree():
    rng = np.random.default_rng(9)
    structure = BlockStructure([RealBlock("a"), RealBlock("b"), FullBlock("f", 2, 3)])
    padding = Padding(structure)
    for _ in range(6):
        M = gaussian(rng, structure.inputs, structure.outputs)
        full = padding.fill(M)
        size = np.linalg.norm(full, 2)
        start = np.eye(padding.n, dtype=complex), np.zeros((padding.n, padding.n), dtype=complex)
        D, G = improve(full / size, padding, *start, 1e-6)
        own, _ = certificate(full, D, G * size)
        assert own == pytest.approx(mu_upper(M, structure).value, rel=2e-3)


def test_what_makes_no_sense_is_refused():
    structure = BlockStructure([ComplexBlock("c", 2)])
    with pytest.raises(ParameterError, match="3 outputs and 2 inputs"):
        mu_upper(np.ones((3, 2)), structure)
    with pytest.raises(ParameterError, match="must be a matrix"):
        mu_lower(np.ones(3), structure)
    with pytest.raises(ParameterError, match="not finite"):
        mu_upper(np.full((2, 2), np.inf), structure)
    assert mu_upper(np.zeros((2, 2)), structure).value == 0.0
    assert mu_lower(np.zeros((2, 2)), structure).delta is None


def test_a_block_without_effect_does_not_disturb_the_search():
    # The eigenvalue of a nilpotent part has no slope; mu is that of the block that acts.
    M = np.array([[0.0, 2.0, 1.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    structure = BlockStructure([RealBlock("idle"), RealBlock("acting"), ComplexBlock("rest")])
    found = mu_lower(M, structure)
    assert found.value == pytest.approx(0.5, rel=1e-6)
