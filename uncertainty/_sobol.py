"""Sobol' indices of any vectorised model over a box, with seeded confidence intervals.

The indices are those of `scipy.stats.sobol_indices` (Saltelli et al. 2010, Table 2 (b) and
(f)). Their percentile intervals come from resampling the rows of the two base matrices. Both
indices are quotients of means over the rows, so all resamples are one product of matrices, are
seeded, and give a parameter without any effect the interval 0 to 0. (The bootstrap of SciPy's
result is not seeded, and gives NaN there.)

Resampling takes the rows as independent. For a Latin hypercube that is safe: its means vary at
most ``n/(n - 1)`` times as much as those of independent rows (Owen 1997). Sobol' points are
far more accurate than their intervals in few dimensions; where parameters are many and rows
few, their projections form patterns, and the intervals may be too narrow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import in_range, one_of, whole
from plant.kinematics import FloatArray

Base = Literal["sobol", "latin-hypercube"]
Model = Callable[[FloatArray], FloatArray]
LEAST_SAMPLES, MOST_SAMPLES = 64, 2**20
RESAMPLES = 1000


@dataclass(frozen=True)
class SobolIndices:
    """First-order and total indices (outputs, groups), with their confidence intervals.

    Attributes
    ----------
    first, first_low, first_high : ndarray (outputs, groups)
        Share of the variance that goes when the group alone becomes known, 1.
    total, total_low, total_high : ndarray (outputs, groups)
        Share that is left when all but the group is known, 1.
    mean, std : ndarray (outputs,)
        Mean and standard deviation of each output.
    evaluations : int
        Points at which the model was evaluated.
    """

    first: FloatArray
    first_low: FloatArray
    first_high: FloatArray
    total: FloatArray
    total_low: FloatArray
    total_high: FloatArray
    mean: FloatArray
    std: FloatArray
    evaluations: int


def sobol(
    model: Model,
    low: ArrayLike,
    high: ArrayLike,
    samples: int,
    *,
    groups: Sequence[Sequence[int]] | None = None,
    base: Base = "sobol",
    confidence: float = 0.95,
    seed: int = 0,
) -> SobolIndices:
    """Estimate Sobol' indices of a model whose parameters are uniform and independent.

    Parameters
    ----------
    model : callable
        Gives outputs (rows, s) for values (rows, d) of the parameters; called once.
    low, high : array_like (d,)
        Bounds.
    samples : int
        Rows of each base matrix, a power of two of 64 or more.
    groups : sequence of sequences of int, optional
        Columns that vary together, whose joint index is wanted; each column by default.
    base : {"sobol", "latin-hypercube"}
        Points of the base matrices.
    confidence : float
        Of each interval.
    seed : int
        Of the points and of the resampling.

    Raises
    ------
    ParameterError
        If an argument is out of range, there are fewer than two groups, or an output is not
        finite or does not vary.
    """
    from scipy.stats import qmc, sobol_indices

    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    check(samples, confidence, seed)
    one_of("base", base, get_args(Base))
    d = len(low)
    groups = [[k] for k in range(d)] if groups is None else groups
    if len(groups) < 2:
        raise ParameterError(
            f"there are {len(groups)} parameters to compare, but must be 2 or more: a variance is "
            "shared out among several"
        )
    generator = np.random.default_rng(seed)
    if base == "sobol":
        exponent = samples.bit_length() - 1
        unit = qmc.Sobol(2 * d, rng=generator, bits=64).random_base2(exponent)
    else:
        unit = qmc.LatinHypercube(2 * d, rng=generator).random(samples)
    a, b = (low + (high - low) * half for half in (unit[:, :d], unit[:, d:]))
    rows = [a, b]
    for columns in groups:
        mixed = a.copy()
        mixed[:, list(columns)] = b[:, list(columns)]
        rows.append(mixed)
    values = np.vstack(rows)
    outputs = np.asarray(model(values), dtype=float)
    _check_outputs(outputs, values)
    s = outputs.shape[1]
    blocks = outputs.reshape(len(rows), samples, s).transpose(0, 2, 1)  # block, output, row
    f_a, f_b, f_ab = blocks[0], blocks[1], blocks[2:]
    both = blocks[:2]
    mean, std = both.mean(axis=(0, 2)), both.std(axis=(0, 2))
    constant = np.flatnonzero(std <= 1e-12 * np.abs(both).max(axis=(0, 2)))
    if constant.size:
        raise ParameterError(
            f"output {constant[0]} is {mean[constant[0]]:g} at every sample: none of the "
            "parameters acts on it, so its variance cannot be shared out"
        )
    indices = sobol_indices(func={"f_A": f_a, "f_B": f_b, "f_AB": f_ab}, n=samples)
    shape = (s, len(groups))  # SciPy drops dimensions of length one
    first, total = (
        np.reshape(index, shape) for index in (indices.first_order, indices.total_order)
    )
    f_a, f_b, f_ab = (f - mean[:, None] for f in (f_a, f_b, f_ab))
    variance = 0.5 * (f_a**2 + f_b**2), 0.5 * (f_a + f_b)
    weights = generator.multinomial(samples, np.full(samples, 1.0 / samples), size=RESAMPLES)
    intervals = [
        _interval(terms, *variance, weights / samples, confidence)
        for terms in (f_b * (f_ab - f_a), 0.5 * (f_a - f_ab) ** 2)
    ]
    return SobolIndices(first, *intervals[0], total, *intervals[1], mean, std, len(values))


def check(samples: int, confidence: float, seed: int) -> None:
    """Check what an estimate is asked for."""
    whole("samples", samples, LEAST_SAMPLES, MOST_SAMPLES)
    if samples & (samples - 1):
        near = 2 ** round(np.log2(samples))
        raise ParameterError(
            f"samples is {samples}, but must be a power of two, for the balance of the Sobol' "
            f"points: take {near}"
        )
    in_range("confidence", confidence, 0.0, 1.0, "1", open_low=True, open_high=True)
    whole("seed", seed, 0, 2**63 - 1)


def _check_outputs(outputs: FloatArray, values: FloatArray) -> None:
    if outputs.ndim != 2 or len(outputs) != len(values):
        raise ParameterError(
            f"the model gives an array of shape {outputs.shape}, but must give "
            f"({len(values)}, outputs): a row for each sample"
        )
    bad = ~np.isfinite(outputs)
    if bad.any():
        row, column = (int(k) for k in np.argwhere(bad)[0])
        at = ", ".join(f"{x:.6g}" for x in values[row])
        raise ParameterError(
            f"output {column} of sample {row} is {outputs[row, column]:g}, but must be finite: the "
            f"model fails at ({at}); {int(bad.any(axis=1).sum())} of {len(values)} samples fail"
        )


def _interval(
    terms: FloatArray,
    square: FloatArray,
    centre: FloatArray,
    weights: FloatArray,
    confidence: float,
) -> tuple[FloatArray, FloatArray]:
    """Interval (low, high) of ``mean(terms)/(mean(square) - mean(centre)^2)``.

    Terms are (groups, outputs, rows), `square` and `centre` (outputs, rows), weights
    (resamples, rows); the interval is (outputs, groups).
    """
    g, s, n = terms.shape
    means = (weights @ terms.reshape(g * s, n).T).reshape(len(weights), g, s)
    variance = weights @ square.T - (weights @ centre.T) ** 2
    tails = 0.5 * (1.0 - confidence), 0.5 * (1.0 + confidence)
    low, high = np.quantile(means / variance[:, None, :], tails, axis=0)
    return low.T, high.T
