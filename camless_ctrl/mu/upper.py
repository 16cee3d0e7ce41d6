"""Upper bound of the structured singular value: D-G scalings, each with its certificate.

With scalings ``D > 0`` that commute with the perturbations and Hermitian ``G`` of the real
blocks, ``mu(M) <= beta`` if

    ``M^H D M + j (G M - M^H G) - beta^2 D <= 0``   (Fan, Tits and Doyle, 1991).

Scalings come from SLICOT's AB13MD. Its report is not relied on: the bound given here is the
smallest ``beta`` for which its scalings satisfy the inequality, from the eigenvalues.

AB13MD knows real scalars that occur once, and full square blocks. A block that is not square is
filled up with zero rows or columns of M, which leaves mu as it is. A scalar that occurs several
times is first treated as so many independent scalars, which is conservative; from there, full
D (and G) scalings of the repeated scalar are found by the method of centres. So are those of a
single matrix and of a peak, where AB13MD stops within some tenths of a per cent.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError

from .blocks import BlockStructure, ComplexArray, FullBlock, is_real

_ACCURATE = 1e-5  # relative accuracy of the scalings of a single matrix


@dataclass(frozen=True)
class UpperBound:
    """Upper bound of the structured singular value of one matrix.

    Attributes
    ----------
    value : float
        The bound, certified by the scalings.
    D, G : ndarray (n, n)
        Scalings, for M filled up to square blocks.
    vector : ndarray (outputs of the perturbation,)
        Direction ``w`` in which the inequality is tight.
    """

    value: float
    D: ComplexArray = field(repr=False)
    G: ComplexArray = field(repr=False)
    vector: ComplexArray = field(repr=False)

    def __float__(self) -> float:
        return self.value


class Padding:
    """Filling up of a structure to square blocks, and AB13MD's description of it."""

    def __init__(self, structure: BlockStructure) -> None:
        self.structure = structure
        sizes = []
        self.rows: list[int] = []
        self.columns: list[int] = []
        nblock, itype = [], []
        start = 0
        for block in structure.blocks:
            size = max(block.inputs, block.outputs)
            self.rows += range(start, start + block.inputs)  # of M
            self.columns += range(start, start + block.outputs)
            if isinstance(block, FullBlock):
                nblock.append(size)
                itype.append(2)
            else:
                nblock += [1] * size
                itype += [1 if is_real(block) else 2] * size
            sizes.append(size)
            start += size
        self.sizes = tuple(sizes)
        self.n = start
        # arrays: slycot counts the real blocks of a list as none
        self.nblock, self.itype = np.array(nblock), np.array(itype)
        self.repeated = any(
            not isinstance(b, FullBlock) and b.repeated > 1 for b in structure.blocks
        )

    def fill(self, M: ComplexArray) -> ComplexArray:
        """Return M (..., inputs, outputs) with zero rows and columns in their places."""
        full = np.zeros((*M.shape[:-2], self.n, self.n), dtype=complex)
        full[..., np.array(self.rows)[:, None], np.array(self.columns)] = M
        return full


def mu_upper(M: ArrayLike, structure: BlockStructure) -> UpperBound:
    """Upper bound of the structured singular value of a matrix.

    Parameters
    ----------
    M : array_like (inputs, outputs)
        Matrix from what the perturbation gives to what it takes.
    structure : BlockStructure
        Structure of the perturbation.

    Raises
    ------
    ParameterError
        If the sizes do not fit, or M is not finite.
    """
    return bound_of(checked(M, structure), Padding(structure), _ACCURATE, polish=True)


def checked(M: ArrayLike, structure: BlockStructure) -> ComplexArray:
    """Return M as a complex matrix after checks of its size and values."""
    matrix = np.asarray(M, dtype=complex)
    if matrix.ndim != 2:
        raise ParameterError(f"M has shape {matrix.shape}, but must be a matrix")
    structure.check(*matrix.shape)
    if not np.all(np.isfinite(matrix)):
        raise ParameterError("M is not finite: shift poles off the boundary, or the frequency")
    return matrix


def bound_of(
    M: ComplexArray, padding: Padding, tolerance: float = 1e-3, *, polish: bool = False
) -> UpperBound:
    """Return the bound of a matrix of the right size; `polish` improves AB13MD's scalings."""
    full = padding.fill(M)
    largest = float(np.linalg.norm(full, 2))
    if largest == 0.0:
        zero = np.zeros((padding.n, padding.n), dtype=complex)
        return UpperBound(0.0, np.eye(padding.n, dtype=complex), zero, np.ones(M.shape[1], complex))
    D, G, reported = _slicot(full / largest, padding)
    G = G * largest
    value, vector = certificate(full, D, G)
    # its scalings do not always prove what it reports, above all where mu is zero
    if polish or padding.repeated or value > reported * largest * (1.0 + 1e-6) + 1e-5 * largest:
        from ._scalings import improve

        starts = [(D, G / largest)]
        if (
            polish
        ):  # from the middle too: AB13MD's scalings may lie near the edge of what is allowed
            starts.append((np.eye(padding.n, dtype=complex), np.zeros_like(G)))
        for start in starts:
            D_new, G_new = improve(full / largest, padding, *start, tolerance)
            better, vector_new = certificate(full, D_new, G_new * largest)
            if better < value:
                value, vector, D, G = better, vector_new, D_new, G_new * largest
    return UpperBound(value, D, G, vector[np.array(padding.columns)])


def _slicot(M: ComplexArray, padding: Padding) -> tuple[ComplexArray, ComplexArray, float]:
    """Scalings of AB13MD, identity and zero if they are not usable, and the bound reported."""
    import slycot
    from slycot.exceptions import SlycotArithmeticError

    try:
        reported, d, g, _ = slycot.ab13md(M, padding.nblock, padding.itype)
    except SlycotArithmeticError:
        reported, d, g = 0.0, np.ones(padding.n), np.zeros(padding.n)
    d = np.asarray(d, dtype=float) ** 2
    if not (np.all(np.isfinite(d)) and np.all(np.isfinite(g)) and d.min() > 1e-12 * d.max()):
        d, g = np.ones(padding.n), np.zeros(padding.n)
    scale = d.max()
    return np.diag(d / scale).astype(complex), np.diag(g / scale).astype(complex), float(reported)


def certificate(M: ComplexArray, D: ComplexArray, G: ComplexArray) -> tuple[float, ComplexArray]:
    """Smallest ``beta`` for which the scalings prove ``mu(M) <= beta``, and the tight direction.

    What rounding may hide in the eigenvalues is added to them.
    """
    if np.count_nonzero(D - np.diag(np.diag(D))) == 0:
        root = np.diag(np.sqrt(np.diag(D).real)).astype(complex)  # exact for scalings far apart
        inverse = np.diag(1.0 / np.diag(root))
    else:
        root = np.linalg.cholesky(D).conj().T.astype(complex)
        inverse = np.linalg.inv(root)
    scaled = root @ M @ inverse
    turned = inverse.conj().T @ (G @ M) @ inverse
    form = scaled.conj().T @ scaled + 1j * (turned - turned.conj().T)
    values, vectors = np.linalg.eigh(0.5 * (form + form.conj().T))
    rounding = 4.0 * np.finfo(float).eps * (np.linalg.norm(scaled) ** 2 + np.linalg.norm(turned))
    return float(np.sqrt(max(values[-1] + rounding, 0.0))), inverse @ vectors[:, -1]
