"""Stable all-pass systems through given complex values (Zhou, Doyle and Glover, section 9.3)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant import ParameterError
from plant._checks import in_range

from .blocks import ComplexArray, Delta, FullBlock

if TYPE_CHECKING:
    import control

_REAL = 1e-9  # relative imaginary part below which a value counts as real


class Matrices(NamedTuple):
    """Matrices of a small state-space system."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


def realise(delta: Delta, omega: float, dt: float | bool | None) -> control.StateSpace:
    """Return a stable system of the perturbation's size that equals it at one frequency."""
    import control

    in_range("omega", omega, 0.0, math.inf, "rad per time unit")
    step = 1.0 if dt is True else float(dt or 0.0)
    if omega * step > math.pi * (1.0 + 1e-9):
        raise ParameterError(
            f"omega is {omega:g} rad per time unit, but must be at most the Nyquist frequency "
            f"{math.pi / step:g}"
        )
    parts: list[Matrices] = []
    for block in delta.structure.blocks:
        value = delta[block.name]
        if isinstance(block, FullBlock):
            u, v = dyad(value, block.name)
            column = diagonal([all_pass(x, omega, step, block.name) for x in u])
            row = diagonal([all_pass(x, omega, step, block.name) for x in v])
            ones_in, ones_out = np.ones((u.size, 1)), np.ones((1, v.size))
            column = Matrices(column.A, column.B @ ones_in, column.C, column.D @ ones_in)
            row = Matrices(row.A, row.B, ones_out @ row.C, ones_out @ row.D)
            parts.append(series(row, column))
        else:
            parts += [all_pass(value, omega, step, block.name)] * block.inputs
    return control.ss(*diagonal(parts), dt if step > 0.0 else 0.0, name="delta")


def all_pass(value: complex, omega: float, step: float, name: str) -> Matrices:
    """Return ``+-|value| (s - b)/(s + b)`` with the given value at one frequency.

    In discrete time, ``s`` stands for ``(z - 1)/(z + 1)``.
    """
    value = complex(value)
    if abs(value.imag) <= _REAL * abs(value):
        none = np.zeros((0, 0))
        return Matrices(none, np.zeros((0, 1)), np.zeros((1, 0)), np.array([[value.real]]))
    if omega == 0.0 or (step > 0.0 and omega * step >= math.pi * (1.0 - 1e-12)):
        raise ParameterError(
            f"the value {value:.3g} of block {name} is complex, but a real system is real at "
            f"frequency {omega:g}: realise the worst perturbation at a neighbouring frequency"
        )
    point = math.tan(0.5 * omega * step) if step > 0.0 else omega
    phase = math.atan2(value.imag, value.real)
    sign = 1.0 if phase > 0.0 else -1.0
    # (j point - b)/(j point + b) has the phase pi - 2 atan(point/b), in (0, pi)
    b = point / math.tan(0.5 * (math.pi - phase if phase > 0.0 else -phase))
    size = sign * abs(value)
    if step > 0.0:
        pole = (1.0 - b) / (1.0 + b)
        gain = math.sqrt(1.0 - pole**2)
        numbers = pole, gain, -size * gain, size * pole
    else:
        gain = math.sqrt(2.0 * b)
        numbers = -b, gain, -size * gain, size
    return Matrices(*(np.array([[x]]) for x in numbers))


def dyad(matrix: ComplexArray, name: str) -> tuple[ComplexArray, ComplexArray]:
    """Return ``u, v`` with ``matrix = u v^T``; raise if its rank is above one."""
    left, sizes, right = np.linalg.svd(matrix)
    if sizes.size > 1 and sizes[1] > 1e-6 * sizes[0]:
        raise ParameterError(
            f"the full block {name} has rank above one (singular values "
            f"{', '.join(f'{x:.3g}' for x in sizes)}): only a block of rank one is realised"
        )
    v = right[0]
    turn = v[np.argmax(np.abs(v))]
    turn = turn / abs(turn)  # the largest entry of v becomes real
    return sizes[0] * left[:, 0] * turn, v / turn


def diagonal(parts: list[Matrices]) -> Matrices:
    """Return the systems side by side."""
    from scipy.linalg import block_diag

    return Matrices(*(np.asarray(block_diag(*column)) for column in zip(*parts, strict=True)))


def series(first: Matrices, second: Matrices) -> Matrices:
    """Return `second` fed by `first`."""
    A = np.block(
        [
            [first.A, np.zeros((len(first.A), len(second.A)))],
            [second.B @ first.C, second.A],
        ]
    )
    B = np.vstack((first.B, second.B @ first.D))
    return Matrices(A, B, np.hstack((second.D @ first.C, second.C)), second.D @ first.D)
