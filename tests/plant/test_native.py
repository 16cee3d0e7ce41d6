import math
import sys
import types
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from plant import _compile, _native
from plant._native_call import INDICES, MATRIX, VECTOR, Array


class Options(NamedTuple):
    count: int
    scale: float
    negative: bool


class Answer(NamedTuple):
    total: float
    places: int
    even: bool


def weigh(
    options: Options,
    weights: np.ndarray,
    table: np.ndarray,
    block: np.ndarray,
    order: np.ndarray,
    offset: float,
    first: int,
) -> Answer:
    total = offset
    for k in range(order.size):
        total += weights[order[k]] * table[k, first] * block[1, 0, k]
    total *= -options.scale if options.negative else options.scale
    table[0, 0] = total
    return Answer(total, options.count + table.size, options.count % 2 == 0)


def sine(angle: float, out: np.ndarray) -> None:
    out[0] = math.sin(angle)


def rounded(value: float) -> int:
    return math.floor(value + 0.5)


def allocating(count: int) -> int:
    return np.ones(count).sum()


@pytest.fixture
def library(tmp_path, monkeypatch):
    """Return a library whose entries come from this file, with a cache of its own."""
    module = types.ModuleType("plant._functions_of_a_test")
    vars(module).update(weigh=weigh, sine=sine, rounded=rounded, allocating=allocating)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return _native.Library("test")


def add(library, name, *parameters, returns=None):
    return library.entry("_functions_of_a_test", name, *parameters, returns=returns)


def stored(folder):
    return [path for path in Path(folder).rglob("*") if path.is_file() and path.suffix == ".o"]


def test_every_kind_of_argument_and_result_arrives(library, tmp_path):
    kinds = (Options, VECTOR, MATRIX, Array(3), INDICES, float, int)
    entry = add(library, "weigh", *kinds, returns=Answer)
    table, block = np.arange(6.0).reshape(2, 3), np.arange(12.0).reshape(2, 3, 2)
    arguments = (Options(4, 0.5, True), np.array([2.0, 3.0, 5.0]), table, block)
    order = np.array([2, 0])
    # -0.5 (7 + 5*2*6 + 2*5*7)
    assert entry(*arguments, order, 7.0, 2) == Answer(-68.5, 10, True)
    assert table[0, 0] == -68.5  # in place
    assert stored(tmp_path)[0].stat().st_size > 500  # machine code
    assert entry(Options(3, 0.5, False), *arguments[1:], order, 7.0, 2) == Answer(68.5, 9, False)


def test_functions_of_one_library_share_a_file(library, tmp_path):
    write, near = add(library, "sine", float, VECTOR), add(library, "rounded", float, returns=int)
    out = np.zeros(1)
    assert write(0.5, out) is None
    assert out[0] == pytest.approx(math.sin(0.5), rel=1e-15)
    assert near(2.6) == 3
    assert len(stored(tmp_path)) == 1


def test_what_allocates_is_left_to_numba(library, tmp_path):
    count = add(library, "allocating", int, returns=int)
    assert count(5) == 5
    again = _native.Library("test")  # as another process finds it
    assert add(again, "allocating", int, returns=int)(7) == 7
    assert len(stored(tmp_path)) == 1


def test_arrays_that_the_code_would_misread_are_refused(library):
    write = add(library, "sine", float, VECTOR)
    with pytest.raises(TypeError, match="need float64"):
        write(0.5, np.zeros(1, np.float32))
    with pytest.raises(TypeError, match="not C contiguous"):
        write(0.5, np.zeros(4)[::2])
    with pytest.raises(_native.struct.error, match="expected 2 items"):
        write(0.5, np.zeros((1, 1)))
    frozen = np.zeros(1)
    frozen.flags.writeable = False
    with pytest.raises(TypeError, match="not writable"):
        write(0.5, frozen)


@pytest.mark.parametrize("damage", ["empty", "truncated", "flipped"])
def test_a_damaged_file_is_made_anew(library, tmp_path, damage):
    assert add(library, "rounded", float, returns=int)(2.6) == 3
    (file,) = stored(tmp_path)
    good = file.read_bytes()
    bad = {"empty": b"", "truncated": good[:-9], "flipped": good[:-9] + b"\xff" + good[-8:]}
    file.write_bytes(bad[damage])
    again = _native.Library("test")
    assert add(again, "rounded", float, returns=int)(-2.6) == -3
    assert _compile.read(file.name) is not None


def test_loaded_code_is_not_compiled_again(library, monkeypatch):
    assert add(library, "rounded", float, returns=int)(2.6) == 3
    again = _native.Library("test")
    monkeypatch.setattr(again, "object_code", lambda: pytest.fail("compiled again"))
    assert add(again, "rounded", float, returns=int)(3.6) == 4
