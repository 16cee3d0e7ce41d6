"""Samples of an uncertainty set: random ones for guarantees, low-discrepancy ones for fits.

Order statistics hold for samples that are drawn *independently* (``"random"``). Scrambled
Sobol' points and Latin hypercubes fill the set more evenly, which serves a fit, but their
points depend on each other and carry no such guarantee.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from plant import ParameterError
from plant._checks import one_of, whole
from plant.kinematics import FloatArray

from .parameters import UncertaintySet

if TYPE_CHECKING:
    import xarray as xr

Method = Literal["random", "sobol", "latin-hypercube", "given"]


@dataclass(frozen=True, eq=False)  # arrays have no truth value to compare by
class Sample:
    """Points of an uncertainty set.

    Attributes
    ----------
    uncertain : UncertaintySet
        The set.
    values : ndarray (samples, d)
        Values, in the units of its parameters.
    method : str
        How they were drawn.
    seed : int
        Seed of the draw.
    """

    uncertain: UncertaintySet = field(repr=False)
    values: FloatArray = field(repr=False)
    method: Method = "given"
    seed: int = 0

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=float)
        d = len(self.uncertain)
        if values.ndim != 2 or values.shape[1] != d or not len(values):
            raise ParameterError(
                f"the values have shape {values.shape}, but must be (samples, {d}): one column a "
                f"parameter of {', '.join(self.uncertain.names)}"
            )
        clearance = 1e-9 * (self.uncertain.high - self.uncertain.low) + 1e-15
        inside = (values >= self.uncertain.low - clearance) & (
            values <= self.uncertain.high + clearance
        )
        if not inside.all():  # NaN is not inside
            row, column = (int(k) for k in np.argwhere(~inside)[0])
            raise ParameterError(
                f"sample {row} has the value {values[row, column]:g}, but must hold "
                f"{self.uncertain.parameters[column]}"
            )
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.values)

    def column(self, name: str) -> FloatArray:
        """Values of one parameter (samples,)."""
        one_of("uncertain parameter", name, self.uncertain.names)
        return self.values[:, self.uncertain.names.index(name)]

    def at(self, i: int) -> dict[str, float]:
        """Values of sample `i`, by name."""
        return dict(zip(self.uncertain.names, self.values[i].tolist(), strict=True))

    def joined(self, other: Sample) -> Sample:
        """Return this sample followed by another one of the same set."""
        if other.uncertain != self.uncertain:
            raise ParameterError(
                f"the samples are of different sets, {', '.join(self.uncertain.names)} and "
                f"{', '.join(other.uncertain.names)}: draw both from one"
            )
        return Sample(self.uncertain, np.vstack((self.values, other.values)))

    def to_xarray(self) -> xr.Dataset:
        """Return a variable for each parameter, against ``sample``, with its unit."""
        import xarray as xr

        return xr.Dataset(
            {
                p.name: ("sample", self.values[:, k], {"units": p.unit, "source": p.source})
                for k, p in enumerate(self.uncertain)
            },
            attrs={"method": self.method, "seed": self.seed},
        )


def draw(uncertain: UncertaintySet, count: int, seed: int, method: Method = "random") -> Sample:
    """Draw a sample, uniform over the box of the set.

    Parameters
    ----------
    uncertain : UncertaintySet
        The set.
    count : int
        Number of samples. For ``"sobol"`` a power of two keeps the balance of the points.
    seed : int
        Seed; the same one gives the same sample.
    method : {"random", "sobol", "latin-hypercube"}
        Independent points, scrambled Sobol' points or a Latin hypercube
        (`scipy.stats.qmc`).

    Raises
    ------
    ParameterError
        For an empty set, a count below 1, a negative seed or an unknown method.
    """
    from scipy.stats import qmc

    whole("count", count, 1, 10_000_000)
    whole("seed", seed, 0, 2**63 - 1)
    one_of("method", method, [m for m in get_args(Method) if m != "given"])
    d = len(uncertain)
    if d == 0:
        raise ParameterError("the uncertainty set is empty: give one parameter or more")
    generator = np.random.default_rng(seed)
    if method == "random":
        unit = generator.random((count, d))
    elif method == "latin-hypercube":
        unit = qmc.LatinHypercube(d, rng=generator).random(count)
    else:
        # One power of two and its head: SciPy warns of any other count.
        unit = qmc.Sobol(d, rng=generator).random_base2((count - 1).bit_length())[:count]
    return Sample(uncertain, _scaled(uncertain, unit), method, seed)


def nominal_sample(uncertain: UncertaintySet) -> Sample:
    """Return the nominal values as a sample of one."""
    return Sample(uncertain, uncertain.nominal[np.newaxis])


def one_at_a_time(uncertain: UncertaintySet) -> Sample:
    """Return each parameter at its lower, then at its upper bound, all others nominal.

    Rows ``2 k`` and ``2 k + 1`` are those of parameter ``k``.
    """
    d = len(uncertain)
    values = np.tile(uncertain.nominal, (2 * d, 1))
    k = np.arange(d)
    values[2 * k, k], values[2 * k + 1, k] = uncertain.low, uncertain.high
    return Sample(uncertain, values)


def corners(uncertain: UncertaintySet, most: int = 4096) -> Sample:
    """Return all corners of the box.

    Raises
    ------
    ParameterError
        If there are more than `most`.
    """
    d = len(uncertain)
    if 2**d > most:
        raise ParameterError(
            f"the box of {d} parameters has {2**d} corners, but at most {most} are taken: choose "
            "fewer parameters, or draw(...) a sample"
        )
    bits = (np.arange(2**d)[:, None] >> np.arange(d)) & 1
    return Sample(uncertain, np.where(bits == 1, uncertain.high, uncertain.low))


def _scaled(uncertain: UncertaintySet, unit: FloatArray) -> FloatArray:
    return uncertain.low + unit * (uncertain.high - uncertain.low)
