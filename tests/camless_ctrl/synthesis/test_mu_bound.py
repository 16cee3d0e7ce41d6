"""Scaled upper bound of mu against closed forms, a second optimiser and perturbations."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from camless_ctrl.synthesis import PerturbationBlock, scaled_bound
from camless_ctrl.synthesis.mu_bound import osborne_scalings
from plant import ParameterError

STRUCTURE = (PerturbationBlock(1, 1), PerturbationBlock(2, 3), PerturbationBlock(2, 2))
STARTS = ((0, 1), (1, 3), (3, 5)), ((0, 1), (1, 4), (4, 6))  # rows and columns of the blocks


def random_responses(n, seed=4):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 5, 6)) + 1j * rng.normal(size=(n, 5, 6))


def test_two_scalar_blocks_off_the_diagonal():
    """Mu of ``(0 b; c 0)`` is ``sqrt(|b c|)``, however far apart b and c are."""
    b, c = np.array([1.0, 1e4, 3e-5]), np.array([1.0, 1e-2, 2e3j])
    M = np.zeros((3, 2, 2), complex)
    M[:, 0, 1], M[:, 1, 0] = b, c
    np.testing.assert_allclose(scaled_bound(M, [1, 1]).values, np.sqrt(np.abs(b * c)), rtol=1e-5)


def test_rank_one():
    """Mu of ``x y*`` is the sum of the products of the blocks' norms (S&P, 8.8)."""
    rng = np.random.default_rng(1)
    x = rng.normal(size=(6, 5)) + 1j * rng.normal(size=(6, 5))
    y = rng.normal(size=(6, 6)) + 1j * rng.normal(size=(6, 6))
    expected = sum(
        np.linalg.norm(x[:, a:b], axis=1) * np.linalg.norm(y[:, c:d], axis=1)
        for (a, b), (c, d) in zip(*STARTS, strict=True)
    )
    bound = scaled_bound(x[:, :, None] * y[:, None, :].conj(), STRUCTURE)
    np.testing.assert_allclose(bound.values, expected, rtol=1e-6)


def test_diagonal_of_one_block_and_one_full_block():
    M = random_responses(3)[:, :, :5]
    one = scaled_bound(M, [5])
    np.testing.assert_allclose(one.values, np.linalg.norm(M, 2, (1, 2)))
    np.testing.assert_array_equal(one.scalings, 1.0)
    diagonal = np.array([[[3.0, 0], [0, -5.0j]]])
    assert scaled_bound(diagonal, [1, 1]).values[0] == pytest.approx(5.0)


def test_second_optimiser_finds_nothing_better():
    M = random_responses(12)
    bound = scaled_bound(M, STRUCTURE)

    def scaled(x, response):
        d = np.exp([x[0], x[1], 0.0])
        left, right = np.repeat(d, [1, 2, 2]), np.repeat(d, [1, 3, 2])
        return np.linalg.norm(response * left[:, None] / right, 2)

    options = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    for k, response in enumerate(M):
        found = minimize(scaled, [0.0, 0.0], (response,), method="Nelder-Mead", options=options)
        assert bound.values[k] == pytest.approx(found.fun, rel=1e-6)
        assert bound.values[k] == pytest.approx(scaled(np.log(bound.scalings[k, :2]), response))


def test_no_perturbation_below_the_bound_destabilises():
    rng = np.random.default_rng(3)
    M = random_responses(1)[0]
    bound = scaled_bound(M[None], STRUCTURE).values[0]
    spectral = 0.0
    for _ in range(2000):
        delta = np.zeros((6, 5), complex)
        for (a, b), (c, d) in zip(*STARTS, strict=True):
            u = rng.normal(size=(d - c, b - a)) + 1j * rng.normal(size=(d - c, b - a))
            left, _, right = np.linalg.svd(u, full_matrices=False)
            delta[c:d, a:b] = left @ right
        spectral = max(spectral, np.abs(np.linalg.eigvals(M @ delta)).max())
    assert 0.6 * bound < spectral <= bound


def test_osborne_is_an_upper_bound_near_the_optimum():
    M = random_responses(20)
    balanced = scaled_bound(M, STRUCTURE, osborne_scalings).values
    best = scaled_bound(M, STRUCTURE).values
    assert np.all(balanced >= best * (1 - 1e-9))
    assert np.all(balanced < 1.15 * best)


def test_scalings_of_another_origin_are_used_and_not_believed():
    M = random_responses(4)
    bound = scaled_bound(M, STRUCTURE, lambda responses, blocks: np.full((4, 3), 7.0))
    np.testing.assert_allclose(bound.values, np.linalg.norm(M, 2, (1, 2)))
    with pytest.raises(ParameterError, match="must be positive numbers of shape"):
        scaled_bound(M, STRUCTURE, lambda responses, blocks: np.zeros((4, 3)))


def test_blocks_of_another_module():
    M = random_responses(2)
    theirs = [SimpleNamespace(name=b.name, inputs=b.inputs, outputs=b.outputs) for b in STRUCTURE]
    expected = scaled_bound(M, STRUCTURE).values
    for given in (theirs, SimpleNamespace(blocks=theirs)):
        np.testing.assert_array_equal(scaled_bound(M, given).values, expected)


def test_zero_response_and_wrong_sizes():
    assert scaled_bound(np.zeros((1, 2, 2)), [1, 1]).values[0] == 0.0
    with pytest.raises(ParameterError, match=r"\(frequencies, 5, 6\)"):
        scaled_bound(np.zeros((1, 2, 2)), STRUCTURE)
    with pytest.raises(ParameterError, match="no block"):
        scaled_bound(np.zeros((1, 2, 2)), [])
    with pytest.raises(ParameterError, match="outputs is 0"):
        PerturbationBlock(1, 0)
