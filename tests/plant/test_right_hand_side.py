"""The right-hand side against the second integrator of the tests, and against its own slopes."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand
from plant import right_hand_side as rhs
from plant.intake_problem import IntakeProblem

CASES = {
    "camless": (1500.0, ValveCommand(3.0, 189.0), 90.0, {}),
    "early closing": (6000.0, ValveCommand(4.0, 110.0, -10.0), 90.0, {}),
    "oscillation, throttled": (3000.0, ValveCommand(5.0, 200.0, 12.0), 30.0, {"oscillation": True}),
    "cam without runner": (
        2500.0,
        ValveCommand.conventional(),
        40.0,
        {"profile": "conventional", "runner": False},
    ),
}


def advance(start, end, y, parameters):
    def rate(t, y):
        out = np.empty_like(y)
        rhs.right_hand_side(t, y, parameters, out)
        return out

    def slope(t, y):
        out = np.empty((y.size, y.size))
        rhs.jacobian(t, y, parameters, out)
        return out

    scale = np.r_[1e-3, np.tile([5e-4, 50.0, 5e4, 10.0], y.size // 4)]
    found = solve_ivp(
        rate, (start, end), y, method="LSODA", jac=slope, rtol=1e-9, atol=1e-9 * scale
    )
    assert found.success
    return found.y[:, -1]


def problem_of(case):
    speed, command, throttle, options = CASES[case]
    return IntakeProblem.from_cycle(
        CrankAnglePlant(resolution=8.0, **options).steady_cycle(speed, command, throttle)
    )


@pytest.mark.parametrize("case", CASES)
def test_cycle_is_that_of_the_second_integrator(reference, case):
    """Another state (mass, not pressure) and other code: the same charges and losses."""
    speed, command, throttle, options = CASES[case]
    problem = problem_of(case)
    engine = Engine()
    options = {"runner": True, "oscillation": False, "profile": "camless"} | options
    capacity = engine.manifold_volume / (engine.gas_constant * engine.temperature)
    other = reference.reference_cycle(
        engine,
        speed,
        (command,) * 4,
        throttle,
        manifold_pressure=float(problem.manifold[0]) / capacity,
        cycles=10 if throttle < 90.0 else 3,
        **options,
    )
    for _ in range(2):
        solution = problem.solve(advance)
        problem = problem.restarted(solution)
    assert other.change < 1e-6
    assert solution.air_charge == pytest.approx(other.charge, rel=5e-6)
    assert solution.pumping_loss == pytest.approx(other.loss, rel=2e-5)


@pytest.mark.parametrize("case", CASES)
def test_cuts_part_whole_forms_of_motion(case):
    """The segments cover the cycle, and every event opens and shuts once in it."""
    tables = problem_of(case).tables
    assert tables.start[0] == 0.0
    assert tables.end[-1] == pytest.approx(120.0 / CASES[case][0], rel=1e-14)
    assert np.array_equal(tables.start[1:], tables.end[:-1])
    assert np.all(tables.opening.sum(axis=0) == 1)
    assert np.all(tables.closing.sum(axis=0) == 1)


@pytest.mark.parametrize("case", CASES)
def test_jacobian_is_the_slope_of_the_right_hand_side(case):
    problem = problem_of(case)
    scale = np.array([1e-3, 5e-4, 50.0, 5e4, 10.0])
    seen = 0

    def check(start, end, y, parameters):
        nonlocal seen
        t, size = 0.5 * (start + end), y.size
        middle = advance(start, t, y, parameters)
        slope = np.empty((size, size))
        rhs.jacobian(t, middle, parameters, slope)
        each = np.r_[scale[:1], np.tile(scale[1:], size // 4)]
        up, down = np.empty(size), np.empty(size)
        for j in range(size):
            step = np.zeros(size)
            step[j] = 1e-7 * each[j]
            rhs.right_hand_side(t, middle + step, parameters, up)
            rhs.right_hand_side(t, middle - step, parameters, down)
            numeric = (up - down) / (2.0 * step[j])
            # in units of the states: of the order of 1e3 per second
            found, expected = slope[:, j] / each, numeric / each
            assert found * each[j] == pytest.approx(expected * each[j], rel=2e-3, abs=0.05)
        seen += 1
        return advance(t, end, middle, parameters)

    problem.solve(check)
    assert seen >= 4


def test_air_is_conserved():
    """What the cylinders take leaves the manifold: with the throttle's flow the sum is zero."""
    tables = problem_of("camless").tables
    k = int(np.argmax(tables.n_breathing))
    p = tables.parameters[k]
    n = int(p[rhs.COUNT])
    assert n == 2
    y = np.r_[1.1e-3, np.tile([3e-4, 20.0, 1e4, 0.0], n)]
    rate = np.empty(y.size)
    t = 0.5 * (tables.start[k] + tables.end[k])
    rhs.right_hand_side(t, y, p, rate)
    pressure_ratio = y[0] / p[rhs.CAPACITY] / p[rhs.AMBIENT_PRESSURE]
    assert 0.5 < pressure_ratio < 1.0
    inflow = p[rhs.THROTTLE_AREA] * 2.0 * math.sqrt(pressure_ratio * (1.0 - pressure_ratio))
    flows = rate[1 + rhs.MASS :: rhs.STATE_STRIDE]
    assert np.all(flows != 0.0)
    assert rate[0] + np.sum(flows) == pytest.approx(inflow, rel=1e-12)


@pytest.mark.parametrize(
    ("downstream", "upstream", "flow"),
    [(0.3e5, 1e5, 1.0), (0.5e5, 1e5, 1.0), (0.8e5, 1e5, 0.8), (1e5, 0.8e5, -0.8), (1e5, 1e5, 0.0)],
)
def test_orifice_has_the_values_of_equation_14(downstream, upstream, flow):
    """``2 sqrt(x - x^2)`` is 0.8 at ``x`` of 0.8, and 1 from the choked ratio down."""
    assert rhs.orifice_flow(downstream, upstream)[0] == pytest.approx(flow, abs=1e-12)


def test_exact_orifice_is_refused():
    plant = CrankAnglePlant(orifice="exact")
    cycle = plant.steady_cycle(1500.0, ValveCommand(3.0, 189.0))
    with pytest.raises(ParameterError, match="orifice='simplified'"):
        IntakeProblem.from_cycle(cycle)
