"""Robust performance and the worst case, on a plant of the textbooks."""

import control
import matplotlib as mpl
import numpy as np
import pytest

from camless_ctrl.mu import (
    BlockStructure,
    ComplexBlock,
    Delta,
    FullBlock,
    RealBlock,
    lft,
    lft_matrix,
    nominal_performance,
    robust_performance,
    robust_stability,
    skewed_mu,
    worst_case_gain,
)
from plant import ParameterError

mpl.use("Agg")

INPUTS = BlockStructure([ComplexBlock("u1"), ComplexBlock("u2")])


@pytest.fixture(scope="module")
def worst_distillation(distillation):
    return worst_case_gain(distillation, INPUTS)


@pytest.fixture(scope="module")
def worst_spring():
    return worst_case_gain(spring(), PARAMETERS)


def test_distillation_column_of_the_book(distillation):
    # Skogestad and Postlethwaite, section 8.11.3: RS 0.53, NP 0.50, RP 5.78
    assert robust_stability(distillation, INPUTS).peak_upper == pytest.approx(0.53, abs=0.005)
    assert nominal_performance(distillation, INPUTS).peak_upper == pytest.approx(0.50, abs=0.005)
    result = robust_performance(distillation, INPUTS)
    assert result.peak_upper == pytest.approx(5.78, abs=0.005)
    # three complex blocks: the bounds meet (Packard and Doyle, 1993)
    assert result.peak_lower == pytest.approx(result.peak_upper, rel=1e-3)
    assert result.guaranteed


def test_worst_gain_of_the_distillation_column(distillation, worst_distillation):
    result = worst_distillation
    # by brute force over the phases of both inputs: the worst is on the boundary
    angles = np.exp(2j * np.pi * np.arange(180) / 180)
    a, b = (x.ravel() for x in np.meshgrid(angles, angles))
    delta = np.zeros((a.size, 2, 2), dtype=complex)
    delta[:, 0, 0], delta[:, 1, 1] = a, b
    best = 0.0
    for omega in np.geomspace(0.8, 2.5, 40):
        M = distillation(1j * omega)
        inner = np.linalg.solve(np.eye(2) - M[:2, :2] @ delta, M[:2, 2:])
        closed = M[2:, 2:] + M[2:, :2] @ delta @ inner
        best = max(best, np.linalg.norm(closed, 2, axis=(1, 2)).max())
    assert result.peak_lower >= best * (1.0 - 1e-6)
    assert result.peak_lower == pytest.approx(best, rel=2e-3)
    assert result.peak_upper == pytest.approx(best, rel=0.01)
    assert result.guaranteed
    assert result.worst.size <= 1.0 + 1e-9
    # the worst plant, realised in time, has that gain there, in that direction
    system = result.worst_system()
    assert system.input_labels == ["d1", "d2"]
    assert system.output_labels == ["p1", "p2"]
    assert np.all(system.poles().real < 0.0)
    gain = system(1j * result.frequency)
    assert np.linalg.norm(gain, 2) == pytest.approx(result.peak_lower, rel=1e-6)
    response = gain @ result.disturbance
    assert np.linalg.norm(result.disturbance) == pytest.approx(1.0)
    assert np.linalg.norm(response) == pytest.approx(result.peak_lower, rel=1e-6)
    assert abs(result.error.conj() @ response) == pytest.approx(result.peak_lower, rel=1e-6)
    assert result.step_response(np.linspace(0.0, 20.0, 50)).outputs.shape == (2, 2, 50)
    assert "The gain grows from 0.5 to between 45" in str(result)
    assert result.plot().get_ylabel() == "gain from disturbances to errors (1)"


def test_skewed_mu_of_the_performance_block_is_the_worst_gain(distillation, worst_distillation):
    result = skewed_mu(distillation, INPUTS.plus(FullBlock("p", 2, 2)), "p")
    assert result.peak_lower == pytest.approx(worst_distillation.peak_lower, rel=1e-4)
    assert result.held == ("u1", "u2")


def spring(stiffness=0.5, damping=0.5):
    """Mass, spring and damper, s^2 + (1 + damping c) s + 2 + stiffness k; force to position."""
    return control.ss(
        [[0.0, 1.0], [-2.0, -1.0]],
        [[0.0, 0.0, 0.0], [-1.0, -1.0, 1.0]],
        [[stiffness, 0.0], [0.0, damping], [1.0, 0.0]],
        np.zeros((3, 3)),
        inputs=["wk", "wc", "force"],
        outputs=["zk", "zc", "position"],
    )


PARAMETERS = BlockStructure([RealBlock("k"), RealBlock("c")])


def test_worst_real_parameters_are_a_vertex_in_closed_form(worst_spring):
    # the peak of 1/(s^2 + c s + k) is 1/(c sqrt(k - c^2/4)): largest at c = 0.5, k = 1.5
    result = worst_spring
    c, k = 0.5, 1.5
    exact = 1.0 / (c * np.sqrt(k - 0.25 * c**2))
    assert result.peak_lower == pytest.approx(exact, rel=1e-6)
    assert exact <= result.peak_upper * (1.0 + 1e-9)
    assert result.ceiling <= 1.03 * exact
    assert result.worst["k"] == pytest.approx(-1.0, abs=1e-6)
    assert result.worst["c"] == pytest.approx(-1.0, abs=1e-6)
    assert result.frequency == pytest.approx(np.sqrt(k - 0.5 * c**2), rel=1e-3)
    assert np.all(result.lower <= result.upper * (1.0 + 1e-9))
    system = result.worst_system()
    np.testing.assert_allclose(np.sort(np.poly(system.A)), np.sort([1.0, c, k]), atol=1e-6)
    final = result.step_response(np.linspace(0.0, 80.0, 400)).outputs[-1]
    assert final == pytest.approx(1.0 / k, rel=1e-4)


def test_a_destabilising_parameter_leaves_no_bound():
    result = worst_case_gain(spring(damping=1.25), PARAMETERS)
    assert result.peak_lower == np.inf
    assert result.peak_upper == np.inf
    assert result.worst["c"] == pytest.approx(-0.8, rel=1e-4)
    assert "has no bound" in str(result)
    held = skewed_mu(spring(damping=1.25), PARAMETERS.plus(FullBlock("p", 1, 1)), "p")
    assert held.peak_upper == np.inf


def test_no_sampled_perturbation_exceeds_the_bound(worst_spring):
    rng = np.random.default_rng(12)
    omega = 1j * np.linspace(0.0, 3.0, 120)
    for k, c in rng.uniform(-1.0, 1.0, (100, 2)):
        s = omega
        gain = np.abs(1.0 / (s**2 + (1.0 + 0.5 * c) * s + 2.0 + 0.5 * k)).max()
        assert gain <= worst_spring.ceiling


def test_frequency_data_have_a_worst_case_too(worst_spring):
    omega = np.linspace(0.5, 2.0, 40)
    result = worst_case_gain(control.frd(spring(), omega), PARAMETERS, stable=True)
    assert result.peak_lower == pytest.approx(worst_spring.peak_lower, rel=0.01)
    assert not result.guaranteed
    with pytest.raises(ParameterError, match=r"control\.StateSpace"):
        result.worst_system()


def test_lft_is_the_matrix_formula_and_keeps_the_names():
    rng = np.random.default_rng(13)
    D = 0.1 * rng.standard_normal((4, 5))
    A = rng.standard_normal((3, 3)) - 4.0 * np.eye(3)
    system = control.ss(
        A,
        rng.standard_normal((3, 5)),
        rng.standard_normal((4, 3)),
        D,
        inputs=["w1", "w2", "w3", "d1", "d2"],
        outputs=["z1", "z2", "z3", "e"],
    )
    structure = BlockStructure([RealBlock("a"), FullBlock("f", 2, 2)])
    delta = Delta(structure, {"a": 0.7, "f": [[0.2, 0.4], [-0.1, 0.5]]})
    closed = lft(system, delta)
    assert closed.input_labels == ["d1", "d2"]
    assert closed.output_labels == ["e"]
    s = 0.3 + 1.7j
    np.testing.assert_allclose(closed(s), lft_matrix(system(s), delta.matrix()), rtol=1e-10)
    dynamic = control.ss(
        [[-1.0]], rng.standard_normal((1, 3)), rng.standard_normal((3, 1)), 0.1 * np.eye(3)
    )
    np.testing.assert_allclose(
        lft(system, dynamic)(s), lft_matrix(system(s), dynamic(s)), rtol=1e-10
    )
    with pytest.raises(ParameterError, match=r"delta\.realise"):
        lft(system, Delta(BlockStructure([ComplexBlock("c", 3)]), {"c": 1j}))
    with pytest.raises(ParameterError, match="has only 5 inputs"):
        lft(system, np.eye(6))
    with pytest.raises(ParameterError, match="sampling times"):
        lft(system, control.ss(dynamic.A, dynamic.B, dynamic.C, dynamic.D, 0.1))
    singular = control.ss(A, system.B, system.C, np.eye(4, 5))
    with pytest.raises(ParameterError, match="not well posed"):
        lft(singular, np.eye(3))


def test_a_plant_without_performance_signals_is_refused():
    with pytest.raises(ParameterError, match="no error or no disturbance is left"):
        robust_performance(spring(), PARAMETERS.plus(FullBlock("p", 1, 1)))
