"""Structure of an uncertainty: real and complex scalars and full blocks, and their values.

A perturbation is block diagonal. It takes the signals ``z`` that a system M gives out and
returns the signals ``w`` that M takes in: ``z = M w``, ``w = Delta z``. The blocks are
normalised, so that the set is ``|Delta| <= 1``, and they stand in the order of the signals.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import ParameterError
from plant._checks import in_range, whole

if TYPE_CHECKING:
    import control

ComplexArray: TypeAlias = NDArray[np.complex128]
_MOST = 100  # signals of a block


@dataclass(frozen=True)
class RealBlock:
    """Real scalar times the identity: an uncertain parameter.

    Parameters
    ----------
    name : str
        Name of the parameter.
    repeated : int
        How often it occurs.
    """

    name: str
    repeated: int = 1

    def __post_init__(self) -> None:
        _named(self.name)
        whole(f"repeated of block {self.name}", self.repeated, 1, _MOST)

    @property
    def inputs(self) -> int:
        """Signals that the block takes."""
        return self.repeated

    @property
    def outputs(self) -> int:
        """Signals that the block gives."""
        return self.repeated


@dataclass(frozen=True)
class ComplexBlock(RealBlock):
    """Complex scalar times the identity: unmodelled dynamics of one signal.

    Parameters
    ----------
    name : str
        Name of the block.
    repeated : int
        How often it occurs.
    """


@dataclass(frozen=True)
class FullBlock:
    """Full complex matrix: unmodelled dynamics between several signals, or a performance goal.

    Parameters
    ----------
    name : str
        Name of the block.
    inputs, outputs : int
        Signals that the block takes (outputs of M) and gives (inputs of M).
    """

    name: str
    inputs: int
    outputs: int

    def __post_init__(self) -> None:
        _named(self.name)
        whole(f"inputs of block {self.name}", self.inputs, 1, _MOST)
        whole(f"outputs of block {self.name}", self.outputs, 1, _MOST)


Block: TypeAlias = RealBlock | ComplexBlock | FullBlock


@dataclass(frozen=True)
class BlockStructure:
    """Blocks in the order of their signals.

    Parameters
    ----------
    blocks : iterable of RealBlock, ComplexBlock or FullBlock
        The blocks; at least one, names that differ.
    """

    blocks: tuple[Block, ...]

    def __init__(self, blocks: Iterable[Block]) -> None:
        given = tuple(blocks)
        for block in given:
            if not isinstance(block, RealBlock | FullBlock):
                raise ParameterError(
                    f"{block!r} is no block: give RealBlock, ComplexBlock or FullBlock"
                )
        names = [block.name for block in given]
        if not names:
            raise ParameterError("the structure has no block: give at least one")
        if len(set(names)) < len(names):
            raise ParameterError(
                f"the block names {', '.join(names)} are not all different: rename one"
            )
        object.__setattr__(self, "blocks", given)

    def __len__(self) -> int:
        return len(self.blocks)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the blocks."""
        return tuple(block.name for block in self.blocks)

    @property
    def inputs(self) -> int:
        """Signals that the perturbation takes: outputs of M."""
        return sum(block.inputs for block in self.blocks)

    @property
    def outputs(self) -> int:
        """Signals that the perturbation gives: inputs of M."""
        return sum(block.outputs for block in self.blocks)

    @property
    def only_real(self) -> bool:
        """Whether every block is a real scalar."""
        return all(is_real(block) for block in self.blocks)

    def slices(self) -> list[tuple[slice, slice]]:
        """Return rows (outputs) and columns (inputs) of each block in the perturbation."""
        result, row, column = [], 0, 0
        for block in self.blocks:
            result.append((slice(row, row + block.outputs), slice(column, column + block.inputs)))
            row, column = row + block.outputs, column + block.inputs
        return result

    def check(self, outputs: int, inputs: int) -> None:
        """Raise if a system with these `outputs` and `inputs` does not fit the structure."""
        if (outputs, inputs) != (self.inputs, self.outputs):
            raise ParameterError(
                f"the system has {outputs} outputs and {inputs} inputs, but its blocks "
                f"{', '.join(self.names)} take {self.inputs} signals and give {self.outputs}: "
                "add a block, or leave signals out"
            )

    def plus(self, block: Block) -> BlockStructure:
        """Return the structure with one more block at its end."""
        return BlockStructure((*self.blocks, block))

    def index(self, name: str) -> int:
        """Return the place of a block."""
        if name not in self.names:
            raise ParameterError(f"no block is named {name!r}: there are {', '.join(self.names)}")
        return self.names.index(name)

    def delta(self, matrix: ArrayLike) -> Delta:
        """Return the perturbation with the given block-diagonal matrix (outputs, inputs)."""
        full = np.asarray(matrix, dtype=complex)
        if full.shape != (self.outputs, self.inputs):
            raise ParameterError(
                f"the matrix has shape {full.shape}, but must have {(self.outputs, self.inputs)}"
            )
        values: dict[str, Any] = {}
        for block, (rows, columns) in zip(self.blocks, self.slices(), strict=True):
            part = full[rows, columns]
            if isinstance(block, FullBlock):
                values[block.name] = part
            else:
                values[block.name] = part[0, 0].real if is_real(block) else part[0, 0]
        delta = Delta(self, values)
        if not np.allclose(delta.matrix(), full, rtol=1e-9, atol=1e-12 * np.abs(full).max()):
            raise ParameterError(
                f"the matrix does not have the structure of the blocks {', '.join(self.names)}"
            )
        return delta

    def random(self, seed: int) -> Delta:
        """Return a perturbation drawn from ``|Delta| <= 1``, every block on the boundary.

        Real blocks are drawn from the whole interval, since their worst need not be at an end.
        """
        rng = np.random.default_rng(seed)
        values: dict[str, Any] = {}
        for block in self.blocks:
            if isinstance(block, FullBlock):
                shape = (block.outputs, block.inputs)
                part = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
                values[block.name] = part / np.linalg.norm(part, 2)
            elif is_real(block):
                values[block.name] = rng.uniform(-1.0, 1.0)
            else:
                values[block.name] = np.exp(2j * np.pi * rng.uniform())
        return Delta(self, values)


@dataclass(frozen=True)
class Delta:
    """One perturbation: a value for every block.

    Parameters
    ----------
    structure : BlockStructure
        The blocks.
    values : mapping of str to float, complex or ndarray
        A real number for a `RealBlock`, a complex one for a `ComplexBlock` and a matrix
        (outputs, inputs) for a `FullBlock`. A block that is left out is zero.
    """

    structure: BlockStructure
    values: Mapping[str, Any]

    def __post_init__(self) -> None:
        for name in self.values:
            self.structure.index(name)
        object.__setattr__(
            self,
            "values",
            {block.name: _value(block, self.values) for block in self.structure.blocks},
        )

    def __getitem__(self, name: str) -> Any:
        self.structure.index(name)
        return self.values[name]

    def matrix(self) -> ComplexArray:
        """Return the block-diagonal matrix (outputs, inputs) of the perturbation."""
        s = self.structure
        full = np.zeros((s.outputs, s.inputs), dtype=complex)
        for block, (rows, columns) in zip(s.blocks, s.slices(), strict=True):
            value = self.values[block.name]
            if not isinstance(block, FullBlock):
                value = value * np.eye(block.inputs)
            full[rows, columns] = value
        return full

    @property
    def sizes(self) -> dict[str, float]:
        """Largest singular value of each block."""
        return {
            name: float(np.linalg.norm(value, 2)) if np.ndim(value) else float(abs(value))
            for name, value in self.values.items()
        }

    @property
    def size(self) -> float:
        """Largest singular value of the perturbation."""
        return max(self.sizes.values())

    @property
    def real(self) -> bool:
        """Whether every entry is real, so that the perturbation is a constant gain."""
        return bool(np.all(self.matrix().imag == 0.0))

    def scaled(self, factor: float) -> Delta:
        """Return the perturbation times a real factor."""
        in_range("factor", factor, -np.inf, np.inf, "1")
        return Delta(self.structure, {name: factor * v for name, v in self.values.items()})

    def subset(self, structure: BlockStructure) -> Delta:
        """Return the values of the blocks of another structure alone."""
        return Delta(structure, {name: self[name] for name in structure.names})

    def realise(self, omega: float, dt: float | bool | None = 0.0) -> control.StateSpace:
        """Return a stable real system that equals the perturbation at one frequency.

        Its gain is the same at all frequencies (all-pass interpolation), block by block, so
        that its norm is `size`. A full block is realised if its rank is one, as is that of
        every worst perturbation of this package.

        Parameters
        ----------
        omega : float
            Frequency, rad per time unit.
        dt : float, bool or None
            Sampling time; 0 for continuous time.

        Raises
        ------
        ParameterError
            If a complex value is wanted where a real system is real (frequency 0 and Nyquist).
        """
        from ._realise import realise

        return realise(self, omega, dt)

    def __str__(self) -> str:
        """Return the value of every block."""
        parts = []
        for block in self.structure.blocks:
            value = self.values[block.name]
            if isinstance(block, FullBlock):
                parts.append(f"{block.name} of norm {self.sizes[block.name]:.3g}")
            elif is_real(block):
                parts.append(f"{block.name} = {value:+.3g}")
            else:
                degrees = round(float(np.degrees(np.angle(value)))) + 0.0  # no minus zero
                parts.append(f"{block.name} = {abs(value):.3g} at {degrees:+.0f} deg")
        return ", ".join(parts)


def is_real(block: Block) -> bool:
    """Return whether a block is a real scalar."""
    return isinstance(block, RealBlock) and not isinstance(block, ComplexBlock)


def _value(block: Block, values: Mapping[str, Any]) -> Any:
    """Value of a block after checks of its kind and shape."""
    given = values.get(block.name, 0.0)
    if isinstance(block, FullBlock):
        shape = (block.outputs, block.inputs)
        matrix = np.array(np.broadcast_to(given, shape) if np.ndim(given) == 0 else given, complex)
        if matrix.shape != shape:
            raise ParameterError(
                f"the value of block {block.name} has shape {matrix.shape}, but must have {shape}"
            )
        finite = bool(np.all(np.isfinite(matrix)))
        result: Any = matrix
    else:
        if np.ndim(given) != 0:
            raise ParameterError(f"the value of block {block.name} must be one number")
        number = complex(given)
        if is_real(block) and number.imag != 0.0:
            raise ParameterError(
                f"the value of the real block {block.name} is {number:.3g}: give a real number, "
                "or make it a ComplexBlock"
            )
        finite = bool(np.isfinite(number))
        result = number.real if is_real(block) else number
    if not finite:
        raise ParameterError(f"the value of block {block.name} is not finite")
    return result


def _named(name: Any) -> None:
    if not isinstance(name, str) or not name:
        raise ParameterError(f"a block's name is {name!r}, but must be a text")
