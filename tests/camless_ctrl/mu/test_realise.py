import numpy as np
import pytest

from camless_ctrl.mu import BlockStructure, ComplexBlock, Delta, FullBlock, RealBlock
from plant import ParameterError

STRUCTURE = BlockStructure([RealBlock("a"), ComplexBlock("c", 2), FullBlock("f", 3, 2)])
RNG = np.random.default_rng(3)


def perturbation(angle):
    u = RNG.standard_normal(2) + 1j * RNG.standard_normal(2)
    v = RNG.standard_normal(3) + 1j * RNG.standard_normal(3)
    return Delta(STRUCTURE, {"a": -0.7, "c": 0.6 * np.exp(1j * angle), "f": np.outer(u, v)})


@pytest.mark.parametrize("dt", [0.0, 0.01, True])
@pytest.mark.parametrize("angle", [-3.1, -2.0, -0.1, 1e-4, 0.7, 3.1])
def test_the_system_is_stable_of_the_same_size_and_takes_the_value(dt, angle):
    delta = perturbation(angle)
    step = 1.0 if dt is True else dt
    omega = 1.3 if step == 1.0 else 40.0
    system = delta.realise(omega, dt)
    assert system.dt == dt
    poles = system.poles()
    assert np.all(np.abs(poles) < 1.0) if step else np.all(poles.real < 0.0)
    point = np.exp(1j * omega * step) if step else 1j * omega
    np.testing.assert_allclose(system(point), delta.matrix(), atol=1e-9 * delta.size)
    # the gain of an all-pass system is the same at all frequencies
    for w in (0.0, 0.1, 1.0, 3.0):
        at = np.exp(1j * w) if step else 1j * 30.0 * w
        assert np.linalg.norm(system(at), 2) == pytest.approx(delta.size, rel=1e-9)


def test_real_values_need_no_state():
    delta = Delta(STRUCTURE, {"a": 1.0, "c": -0.5, "f": np.ones((2, 3))})
    assert delta.realise(0.0).nstates == 0
    np.testing.assert_allclose(delta.realise(2.0, 0.1).D, delta.matrix().real, atol=1e-12)


def test_what_no_real_system_can_be_is_refused():
    delta = Delta(STRUCTURE, {"c": 1j})
    with pytest.raises(ParameterError, match="real at frequency 0"):
        delta.realise(0.0)
    with pytest.raises(ParameterError, match="neighbouring frequency"):
        delta.realise(np.pi / 0.1, 0.1)
    with pytest.raises(ParameterError, match="at most the Nyquist frequency"):
        delta.realise(40.0, 0.1)
    full = Delta(STRUCTURE, {"f": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]})
    with pytest.raises(ParameterError, match="rank above one"):
        full.realise(1.0)
