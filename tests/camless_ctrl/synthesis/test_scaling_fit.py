"""Magnitude fits: known functions come back, phase included, and all are of minimum phase."""

from __future__ import annotations

import numpy as np
import pytest

from camless_ctrl.synthesis import fit_minimum_phase
from plant import ParameterError

OMEGA = np.geomspace(1e-3, 1e3, 120)
S = 1j * OMEGA


def assert_minimum_phase(fit):
    assert np.all(fit.poles.real < 0)
    assert np.all(fit.zeros.real < 0)
    assert len(fit.poles) == len(fit.zeros) == fit.order
    eigenvalues = np.linalg.eigvals(fit.realisation().A)
    np.testing.assert_allclose(
        np.sort_complex(eigenvalues), np.sort_complex(fit.poles), rtol=1e-6, atol=1e-12
    )


@pytest.mark.parametrize(
    ("order", "function"),
    [
        (0, np.full(OMEGA.shape, 3.0 + 0j)),
        (1, 2 * (S + 0.3) / (S + 40)),
        (2, 3 * (S + 0.1) * (S + 20) / ((S + 1) * (S + 200))),
        (2, (S**2 + 0.6 * S + 1) / (S**2 + 4 * S + 16)),
        (3, (S + 0.1) / (S + 2) * (S**2 + 6 * S + 9) / (S**2 + 20 * S + 400)),
    ],
)
def test_magnitude_gives_the_function_back_with_its_phase(order, function):
    """A stable minimum-phase function is known by its magnitude (Bode)."""
    fit = fit_minimum_phase(OMEGA, np.abs(function), order)
    np.testing.assert_allclose(fit(OMEGA), function, rtol=2e-3)
    assert fit.order == order
    assert_minimum_phase(fit)
    response = fit.realisation().response(S)[:, 0, 0]
    np.testing.assert_allclose(response, fit(OMEGA), rtol=1e-9)


def test_function_of_minimum_phase_stands_for_one_that_is_not():
    function = (S - 2) / (S + 30)
    fit = fit_minimum_phase(OMEGA, np.abs(function), 1)
    assert fit.zeros[0] == pytest.approx(-2.0, rel=1e-4)


def test_bump_is_fitted_better_by_a_higher_order():
    bump = np.exp(2 * np.exp(-(np.log(OMEGA) ** 2) / 2))
    fits = [fit_minimum_phase(OMEGA, bump, order) for order in range(5)]
    for fit in fits:
        assert_minimum_phase(fit)
        true = np.expm1(np.abs(np.log(np.abs(fit(OMEGA)) / bump)).max())
        assert fit.error == pytest.approx(true, rel=1e-9)
    assert fits[2].error < 0.15
    assert fits[4].error < 0.02


def test_inverse():
    fit = fit_minimum_phase(OMEGA, np.abs((S + 1) / (S + 30) * (S + 5) / (S + 0.2)), 3)
    np.testing.assert_allclose(fit.inverse()(OMEGA) * fit(OMEGA), 1.0)
    assert_minimum_phase(fit.inverse())


def test_points_of_little_weight_count_little():
    values = np.where(OMEGA < 1.0, 2.0, 5.0)
    low = fit_minimum_phase(OMEGA, values, 0, weight=np.where(OMEGA < 1.0, 1.0, 1e-6))
    assert low.gain == pytest.approx(2.0, rel=1e-6)


def test_wrong_data_are_refused():
    with pytest.raises(ParameterError, match="above zero"):
        fit_minimum_phase([1.0, 2.0, 3.0], [1.0, 0.0, 1.0], 0)
    with pytest.raises(ParameterError, match="at least 5 rising frequencies"):
        fit_minimum_phase([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], 2)
    with pytest.raises(ParameterError, match="one length"):
        fit_minimum_phase([1.0, 2.0, 3.0], [1.0, 1.0], 0)
    with pytest.raises(ParameterError, match="order is 9"):
        fit_minimum_phase(OMEGA, OMEGA, 9)
