"""Upper bound of the structured singular value with its scalings, for D-K iteration.

For full complex blocks (a scalar one is a block of size 1) the bound is the least over positive
d of ``sigma_max(D_left M D_right^-1)``, with one d for each block; the last d is 1. What a
provider of scalings returns is not believed: the bound is computed from the scalings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from plant._checks import whole
from plant.errors import ParameterError

from ._realisation import ComplexArray, FloatArray

# Scalings stay in this range: a block that does not matter at a frequency has no scaling there.
_RANGE = 1e8


@dataclass(frozen=True)
class PerturbationBlock:
    """Full complex block of the structure.

    Parameters
    ----------
    inputs : int
        Signals that the block takes: outputs of the plant.
    outputs : int
        Signals that it gives: inputs of the plant.
    name : str
        Name for the words and figures.
    """

    inputs: int
    outputs: int
    name: str = ""

    def __post_init__(self) -> None:
        whole("inputs", self.inputs, 1, 1000)
        whole("outputs", self.outputs, 1, 1000)


@runtime_checkable
class BlockLike(Protocol):
    """Block of another module, taken for a full complex one, which includes it."""

    @property
    def name(self) -> str:
        """Name of the block."""
        ...

    @property
    def inputs(self) -> int:
        """Signals that it takes."""
        ...

    @property
    def outputs(self) -> int:
        """Signals that it gives."""
        ...


class BlockCollection(Protocol):
    """Structure of another module."""

    @property
    def blocks(self) -> Sequence[BlockLike]:
        """Blocks in the order of their signals."""
        ...


Structure = tuple[PerturbationBlock, ...]
Blocks = Sequence[BlockLike | int | tuple[int, int]] | BlockCollection  # see `structure_of`

# Responses (frequencies, outputs, inputs) and the structure in; scalings (frequencies, blocks)
# out, positive. What mu tools of other origin offer is easily brought to this form.
MuBound = Callable[[ComplexArray, Structure], FloatArray]


@dataclass(frozen=True)
class ScaledBound:
    """Upper bound of mu over frequency, with the scalings that prove it.

    Attributes
    ----------
    values : ndarray
        Upper bound at each frequency.
    scalings : ndarray
        ``d`` at each frequency for each block; 1 for the last.
    """

    values: FloatArray
    scalings: FloatArray


def structure_of(blocks: Blocks) -> Structure:
    """Structure from blocks, sizes of square blocks, or pairs of inputs and outputs.

    A repeated or a real block of another module becomes a full complex one: what holds for
    that holds for it too.
    """
    made = []
    for block in blocks if isinstance(blocks, Sequence) else blocks.blocks:
        if isinstance(block, tuple):
            made.append(PerturbationBlock(*block))
        elif isinstance(block, BlockLike):
            made.append(PerturbationBlock(block.inputs, block.outputs, block.name))
        else:
            size = whole("the size of a block", block, 1, 1000)
            made.append(PerturbationBlock(size, size))
    if not made:
        raise ParameterError("the structure has no block: give at least one")
    return tuple(made)


def scaled_bound(
    responses: ComplexArray,
    structure: Blocks,
    scalings: MuBound | None = None,
) -> ScaledBound:
    """Bound mu of each response from above.

    Parameters
    ----------
    responses : ndarray
        Shape (frequencies, outputs, inputs).
    structure : sequence
        Blocks in the order of the signals: `PerturbationBlock`, the size of a square block, or
        a pair of inputs and outputs of the block.
    scalings : callable, optional
        Where the scalings come from; `optimal_scalings` if left out.

    Raises
    ------
    ParameterError
        If sizes do not fit, or the scalings are not positive.
    """
    blocks = structure_of(structure)
    responses = np.asarray(responses, dtype=complex)
    size = (sum(b.inputs for b in blocks), sum(b.outputs for b in blocks))
    if responses.ndim != 3 or responses.shape[1:] != size:
        raise ParameterError(
            f"the responses have shape {responses.shape}, but the structure asks for "
            f"(frequencies, {size[0]}, {size[1]})"
        )
    d = np.asarray((scalings or optimal_scalings)(responses, blocks), dtype=float)
    if d.shape != (len(responses), len(blocks)) or not np.all(np.isfinite(d) & (d > 0.0)):
        raise ParameterError(
            f"the scalings have shape {d.shape}, but must be positive numbers of shape "
            f"{(len(responses), len(blocks))}"
        )
    d = d / d[:, -1:]
    return ScaledBound(largest_gain(responses, blocks, d), d)


def largest_gain(responses: ComplexArray, blocks: Structure, d: FloatArray) -> FloatArray:
    """``sigma_max(D_left M D_right^-1)`` at each frequency."""
    left = np.repeat(d, [b.inputs for b in blocks], axis=1)
    right = np.repeat(d, [b.outputs for b in blocks], axis=1)
    scaled = responses * left[:, :, None] / right[:, None, :]
    return np.asarray(np.linalg.norm(scaled, 2, axis=(1, 2)), dtype=float)


def optimal_scalings(responses: ComplexArray, blocks: Structure) -> FloatArray:
    """Scalings of SLICOT AB13MD, or those of Osborne's balancing where they are better."""
    osborne = osborne_scalings(responses, blocks)
    if len(blocks) == 1:
        return osborne
    d = osborne.copy()
    sizes = [max(b.inputs, b.outputs) for b in blocks]
    rows = np.concatenate([_places(sizes, k)[: b.inputs] for k, b in enumerate(blocks)])
    columns = np.concatenate([_places(sizes, k)[: b.outputs] for k, b in enumerate(blocks)])
    first = [int(_places(sizes, k)[0]) for k in range(len(blocks))]
    for k, response in enumerate(responses):
        square = np.zeros((sum(sizes), sum(sizes)), dtype=complex)
        square[np.ix_(rows, columns)] = response
        found = _ab13md(square, sizes)
        if found is not None:
            d[k] = np.clip(found[first] / found[first[-1]], 1.0 / _RANGE, _RANGE)
    better = largest_gain(responses, blocks, osborne) < largest_gain(responses, blocks, d)
    d[better] = osborne[better]
    return d


def osborne_scalings(responses: ComplexArray, blocks: Structure, sweeps: int = 30) -> FloatArray:
    """Scalings that balance the Frobenius norms of the blocks' rows and columns."""
    rows = np.repeat(np.arange(len(blocks)), [b.inputs for b in blocks])
    columns = np.repeat(np.arange(len(blocks)), [b.outputs for b in blocks])
    power = np.zeros((len(responses), len(blocks), len(blocks)))
    for i in range(len(blocks)):
        for j in range(len(blocks)):
            part = responses[:, rows == i][:, :, columns == j]
            power[:, i, j] = np.sum(np.abs(part) ** 2, axis=(1, 2))
    power[:, range(len(blocks)), range(len(blocks))] = 0.0
    floor = 1e-300 + 1e-24 * power.max(axis=(1, 2), initial=0.0)
    squared = np.ones((len(responses), len(blocks)))
    for _ in range(sweeps):
        for k in range(len(blocks)):
            row = np.sum(power[:, k] / squared, axis=1) + floor
            column = np.sum(power[:, :, k] * squared, axis=1) + floor
            squared[:, k] = np.clip(np.sqrt(column / row), _RANGE**-2, _RANGE**2)
    d = np.sqrt(squared)
    return np.clip(d / d[:, -1:], 1.0 / _RANGE, _RANGE)


def _places(sizes: list[int], block: int) -> NDArray[np.intp]:
    start = sum(sizes[:block])
    return np.arange(start, start + sizes[block], dtype=np.intp)


def _ab13md(square: ComplexArray, sizes: list[int]) -> FloatArray | None:
    """Scalings of SLICOT AB13MD; None where it finds none."""
    import slycot
    from slycot.exceptions import SlycotArithmeticError

    if not np.any(square):
        return None
    try:
        _, d, _, _ = slycot.ab13md(square, sizes, [2] * len(sizes))
    except SlycotArithmeticError:
        return None  # Osborne's scalings stand
    return d if np.all(np.isfinite(d) & (d > 0.0)) else None
