import numpy as np
import pytest

from uncertainty._spectral_factor import FrequencyAxis, factor, response
from uncertainty._weight_program import SquaredMagnitude, basis, lowest_ratio
from uncertainty.weights import fit_weight

OMEGA = np.geomspace(0.01, 100.0, 200)


@pytest.mark.parametrize("dt", [0.0, 0.05])
def test_the_factor_has_the_squared_magnitude(dt):
    rng = np.random.default_rng(3)
    omega = rng.uniform(0.01, np.pi / 0.05, 400)
    axis = FrequencyAxis.of(np.sort(omega), dt)
    for order in range(5):
        p, q = rng.uniform(0.1, 2.0, (2, order + 1))  # all positive: positive for s >= 0
        zeros, poles, gain = factor(SquaredMagnitude(p, q, 1.0, True), axis)
        b = basis(*axis.shares(omega), order)
        got = np.abs(response(axis.points(omega), zeros, poles, gain)) ** 2
        assert got == pytest.approx((b @ p) / (b @ q), rel=1e-9)
        assert (np.abs(zeros) < 1.0).all() if dt else (zeros.real < 0.0).all()


def test_the_basis_is_that_of_polynomials_in_the_cosine():
    # (1 - cos)/2 and (1 + cos)/2 where the middle is 1: P is a polynomial in cos(omega dt).
    omega = np.linspace(0.0, np.pi / 0.1, 50)
    u, v = FrequencyAxis(0.1, 1.0).shares(omega)
    assert v - u == pytest.approx(np.cos(0.1 * omega), abs=1e-15)
    assert u + v == pytest.approx(1.0)
    u, v = FrequencyAxis(0.0, 3.0).shares(omega)
    assert v - u == pytest.approx((9.0 - omega**2) / (9.0 + omega**2))


def test_the_lowest_ratio_on_the_axis_is_exact():
    rng = np.random.default_rng(4)
    s = np.concatenate(([0.0], np.geomspace(1e-6, 1e6, 200001)))
    for _ in range(20):
        value, reference = rng.normal(size=5), rng.uniform(0.1, 1.0, 5)
        at, least = lowest_ratio(value, reference)
        scan = np.polyval(value[::-1], s) / np.polyval(reference[::-1], s)
        assert least <= scan.min() + 1e-12
        assert least == pytest.approx(scan.min(), rel=1e-4, abs=1e-6)
        assert at >= 0.0


@pytest.mark.parametrize("dt", [0.0, 0.02])
@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
def test_the_system_has_the_response(order, dt):
    rng = np.random.default_rng(order)
    residual = np.exp(np.cumsum(rng.normal(size=200)) * 0.2)
    weight = fit_weight(OMEGA, residual, order=order, dt=dt, name="w")
    system = weight.system()
    assert system.dt == dt
    assert system.nstates == order
    assert system.name == "w"
    x = np.exp(1j * dt * OMEGA) if dt else 1j * OMEGA
    assert np.abs(system(x) / weight(OMEGA) - 1.0).max() < 1e-8
    assert sorted(np.abs(system.poles())) == pytest.approx(sorted(np.abs(weight.poles)), rel=1e-6)
    assert (np.abs(system(x)) >= residual * (1.0 - 1e-9)).all()


def test_the_system_keeps_its_precision_where_sampling_is_fast():
    # Poles within 1e-4 of 1: the coefficients of their polynomial would lose half the digits.
    omega = np.geomspace(1e-3, 1.0, 60)
    residual = np.exp(np.cumsum(np.random.default_rng(2).normal(size=60)) * 0.2)
    weight = fit_weight(omega, residual, order=4, dt=1e-3)
    assert np.abs(weight.poles - 1.0).max() < 0.2
    assert np.abs(weight.system()(np.exp(1e-3j * omega)) / weight(omega) - 1.0).max() < 1e-6
