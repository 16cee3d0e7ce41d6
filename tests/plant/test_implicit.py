"""Closed-form implicit steps against a bracketing root finder and a general solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from plant._implicit import exact_step, fill_from_ambient, simplified_step
from plant.orifice import exact_flow, simplified_flow

masses = st.one_of(
    st.floats(1e-3, 4.0),
    st.floats(-12.0, -1.0).map(lambda k: 1.0 - 10.0**k),
    st.floats(-12.0, -1.0).map(lambda k: 1.0 + 10.0**k),
)
areas = st.floats(-18.0, 1.5).map(lambda k: 10.0**k)


def simplified(x):
    return float(simplified_flow(x, 1.0))


def exact(x):
    """The exact flow over its sonic value at the upstream pressure 1."""
    return float(exact_flow(x * 1e5, 1e5))


STEPS = [(simplified_step, simplified), (exact_step, exact)]


def root(flow, m, b):
    """The root of x = m + b D(x) by bisection and interpolation: it is between m and 1."""
    low, high = sorted((m, 1.0))
    return brentq(lambda x: x - m - b * flow(x), low, high, xtol=1e-15, rtol=1e-15, maxiter=500)


def solved(step, m, b):
    """The mass ratio x that a step of known mass m and area b comes to, and dM/dK, at K = 1."""
    flow, sensitivity = step(m, b, 1.0)
    return m + b * flow, sensitivity


@pytest.mark.parametrize(("step", "flow"), STEPS)
@settings(max_examples=300, deadline=None, derandomize=True)
@given(m=masses, b=areas)
def test_step_solves_its_equation(step, flow, m, b):
    x, sensitivity = solved(step, m, b)
    expected = root(flow, m, b)
    assert x == pytest.approx(expected, rel=1e-11, abs=1e-13)
    assert min(m, 1.0) - 1e-12 <= x <= max(m, 1.0) + 1e-12
    assert math.isfinite(sensitivity)


@pytest.mark.parametrize(
    ("step", "flow", "area_per_full"),
    [(simplified_step, simplified, 1.0), (exact_step, exact, 0.0)],
)
@pytest.mark.parametrize("m", [0.1, 0.3, 0.6, 0.9, 0.999, 1.001, 1.2, 1.8, 3.0])
@pytest.mark.parametrize("b", [1e-3, 0.05, 0.43, 3.0])
def test_sensitivity_is_the_response_to_the_upstream_pressure(step, flow, area_per_full, m, b):
    """dM/dK at constant known mass and area, against a central difference.

    In Eq. 13-14 the area over K falls with K; in Eq. 10-11 the flow itself grows with it.
    """

    def mass(k):
        return k * root(flow, m / k, b / k**area_per_full)

    h = 1e-5
    slope = (mass(1.0 + h) - mass(1.0 - h)) / (2.0 * h)
    _, sensitivity = solved(step, m, b)
    assert sensitivity == pytest.approx(slope, rel=2e-4, abs=2e-6)


@pytest.mark.parametrize(("step", "flow"), STEPS)
@pytest.mark.parametrize("full", [3e-5, 7.0])
def test_a_step_knows_no_unit_of_mass(step, flow, full):
    for m, b in ((0.2, 0.1), (0.9, 0.4), (1.3, 0.2)):
        x, sensitivity = solved(step, m, b)
        scaled, scaled_sensitivity = step(m * full, b * full, full)
        assert m + b * scaled == pytest.approx(x, rel=1e-12)
        assert scaled_sensitivity == pytest.approx(sensitivity, rel=1e-9)


def test_nothing_cancels_in_a_closing_valve():
    """A valve about to close: the mass does not answer to the manifold."""
    for b in (1e-8, 1e-12, 1.3e-17, 1e-30, 1e-200):
        x, sensitivity = solved(simplified_step, 0.7417730432617, b)
        assert x == pytest.approx(0.7417730432617, abs=2.0 * b)
        assert 0.0 <= sensitivity <= 2.0 * b


@pytest.mark.parametrize("x", [0.05, 0.45, 0.7, 0.99, 1.0, 1.05, 1.9, 2.5])
@pytest.mark.parametrize("k", [1e-3, 0.1, 0.5])
def test_filling_from_ambient_is_the_exact_solution(x, k):
    """dx/dk = d(x) by a general solver, up to the instant of equality."""

    def equal(_, y):
        return abs(y[0] - 1.0) - 1e-7

    equal.terminal = True
    if x == 1.0:
        assert fill_from_ambient(x, k) == 1.0
        return
    solution = solve_ivp(
        lambda _, y: [simplified(y[0])], (0.0, k), [x], events=equal, rtol=1e-9, atol=1e-12,
        max_step=k / 50.0,
    )  # fmt: skip
    ended = solution.t[-1]
    assert fill_from_ambient(x, ended) == pytest.approx(solution.y[0, -1], abs=5e-6)
    if ended < k:
        assert fill_from_ambient(x, k) == pytest.approx(1.0, abs=1e-6)


def test_filling_is_one_motion_however_it_is_cut():
    for x in (0.2, 0.8, 1.4, 3.0):
        whole = fill_from_ambient(x, 0.3)
        parts = x
        for _ in range(30):
            parts = fill_from_ambient(parts, 0.01)
        assert parts == pytest.approx(whole, rel=1e-12)
    assert np.isclose(fill_from_ambient(0.5, math.pi / 4), 1.0)  # a quarter turn of sin(a)^2
