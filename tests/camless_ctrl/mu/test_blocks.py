import subprocess
import sys

import numpy as np
import pytest

from camless_ctrl.mu import BlockStructure, ComplexBlock, Delta, FullBlock, RealBlock
from plant import ParameterError

STRUCTURE = BlockStructure([RealBlock("a", 2), ComplexBlock("c"), FullBlock("f", 3, 2)])


def test_sizes_and_order_of_the_blocks():
    assert (STRUCTURE.inputs, STRUCTURE.outputs) == (6, 5)
    assert STRUCTURE.names == ("a", "c", "f")
    assert not STRUCTURE.only_real
    assert BlockStructure([RealBlock("a")]).only_real
    STRUCTURE.check(6, 5)
    with pytest.raises(ParameterError, match=r"5 outputs and 6 inputs.*take 6 .*give 5"):
        STRUCTURE.check(5, 6)


def test_a_perturbation_is_its_matrix_and_back():
    full = np.arange(6).reshape(2, 3) * 1j
    delta = Delta(STRUCTURE, {"a": -0.5, "c": 0.3 + 0.4j, "f": full})
    matrix = delta.matrix()
    expected = np.zeros((5, 6), complex)
    expected[0, 0] = expected[1, 1] = -0.5
    expected[2, 2] = 0.3 + 0.4j
    expected[3:, 3:] = full
    np.testing.assert_array_equal(matrix, expected)
    again = STRUCTURE.delta(matrix)
    np.testing.assert_array_equal(again.matrix(), expected)
    assert again["a"] == -0.5
    assert delta.size == pytest.approx(np.linalg.norm(full, 2))
    assert delta.sizes["c"] == pytest.approx(0.5)
    assert delta.scaled(2.0).size == pytest.approx(2.0 * delta.size)
    assert not delta.real
    assert Delta(STRUCTURE, {"a": 1.0}).real
    assert str(Delta(STRUCTURE, {"a": 1.0, "c": 1j})).startswith("a = +1, c = 1 at +90 deg, f of")


def test_a_matrix_of_another_structure_is_refused():
    with pytest.raises(ParameterError, match="does not have the structure"):
        STRUCTURE.delta(np.ones((5, 6)))
    matrix = np.zeros((5, 6), complex)
    matrix[0, 0] = matrix[1, 1] = 1j  # the block is real
    with pytest.raises(ParameterError, match="does not have the structure"):
        STRUCTURE.delta(matrix)
    with pytest.raises(ParameterError, match=r"must have \(5, 6\)"):
        STRUCTURE.delta(np.ones((2, 2)))


def test_a_random_perturbation_is_in_the_set():
    for seed in range(20):
        delta = STRUCTURE.random(seed)
        assert abs(delta["c"]) == pytest.approx(1.0)
        assert delta.sizes["f"] == pytest.approx(1.0)
        assert abs(delta["a"]) <= 1.0
    assert STRUCTURE.random(1)["a"] != STRUCTURE.random(2)["a"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BlockStructure([]), "no block"),
        (lambda: BlockStructure([RealBlock("a"), ComplexBlock("a")]), "not all different"),
        (lambda: BlockStructure(["a"]), "is no block"),
        (lambda: RealBlock("a", 0), "repeated of block a is 0"),
        (lambda: FullBlock("f", 0, 1), "inputs of block f is 0"),
        (lambda: RealBlock(""), "must be a text"),
        (lambda: Delta(STRUCTURE, {"b": 1.0}), "no block is named 'b'"),
        (lambda: Delta(STRUCTURE, {"a": 1j}), "real block a is"),
        (lambda: Delta(STRUCTURE, {"f": np.ones((3, 2))}), r"must have \(2, 3\)"),
        (lambda: Delta(STRUCTURE, {"c": np.nan}), "not finite"),
        (lambda: Delta(STRUCTURE, {"c": [1.0, 2.0]}), "one number"),
    ],
)
def test_what_makes_no_sense_is_refused(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


def test_import_loads_no_heavy_library():
    code = (
        "import sys, camless_ctrl.mu, camless_ctrl.mu.blocks, camless_ctrl.mu.worst_case, "
        "camless_ctrl.mu.analysis; "
        "heavy = {'scipy', 'control', 'slycot', 'matplotlib', 'numba', 'xarray', 'casadi'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there():
    import camless_ctrl.mu as mu

    for name in mu.__all__:
        assert callable(getattr(mu, name))
    assert dir(mu) == sorted(mu.__all__)
    with pytest.raises(AttributeError, match="nothing"):
        _ = mu.nothing
