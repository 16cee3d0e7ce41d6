"""Smallest disk that covers the samples of a response, frequency by frequency.

Its centre is the nominal response of least additive uncertainty, its radius that uncertainty.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import ConvergenceError, ParameterError
from plant._checks import whole
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

ComplexArray = NDArray[np.complex128]

_ROUNDS = 1000  # each makes the disk larger; about ten are usual


@dataclass(frozen=True, eq=False)
class DiskGain:
    """Radius about a given nominal against the least one.

    Attributes
    ----------
    nominal_radii, radii : ndarray, shape (frequencies,)
        Largest distance of a sample from the nominal, and from the centre.
    """

    nominal_radii: FloatArray
    radii: FloatArray

    @property
    def ratio(self) -> FloatArray:
        """Radius over that about the nominal (1): at most 1, and 1 where both are zero."""
        some = self.nominal_radii > 0.0
        return np.divide(self.radii, self.nominal_radii, out=np.ones_like(self.radii), where=some)

    def __str__(self) -> str:
        """Return the least and the median ratio."""
        ratio = self.ratio
        return (
            f"About the centres the radius is {ratio.min():.3f} times that about the nominal at "
            f"best and {np.median(ratio):.3f} times in the median of {ratio.size} frequencies."
        )


@dataclass(frozen=True, eq=False)
class CoveringDisks:
    """Smallest disks over samples of a response.

    Attributes
    ----------
    centers : ndarray, shape (frequencies,), complex
        Centres, in the response's unit.
    radii : ndarray, shape (frequencies,)
        Radii: the largest distance of a sample from the centre.
    responses : ndarray, shape (samples, frequencies), complex
        The samples.
    omega : ndarray, shape (frequencies,), or None
        Frequencies, rad/s.
    """

    centers: ComplexArray
    radii: FloatArray
    responses: ComplexArray
    omega: FloatArray | None

    @property
    def relative_radius(self) -> FloatArray:
        """Radius over the magnitude of the centre (1); infinite about a centre of zero."""
        size = np.abs(self.centers)
        none = np.where(self.radii > 0.0, np.inf, 0.0)
        return np.divide(self.radii, size, out=none, where=size > 0.0)

    def gain_over(self, nominal: ArrayLike) -> DiskGain:
        """Compare with the radii about a nominal response, shape (frequencies,) or one number."""
        given = np.asarray(nominal, dtype=complex)
        if given.shape not in ((), self.centers.shape) or not np.isfinite(given).all():
            raise ParameterError(
                f"the nominal has the shape {given.shape}, but must be finite numbers of the shape "
                f"{self.centers.shape}: one for each frequency"
            )
        return DiskGain(np.abs(self.responses - given).max(axis=0), self.radii)

    def to_frd(self, dt: float = 0.0, name: str = "centre") -> control.FrequencyResponseData:
        """Return the centres as frequency response data, with a sampling time in s."""
        import control

        if self.omega is None:
            raise ParameterError("the disks have no frequencies: hand omega to smallest_disks")
        return control.FrequencyResponseData(self.centers, self.omega, dt, name=name)

    def plot(self, ax: Axes | None = None, *, most: int = 9) -> Axes:
        """Draw samples, disks and centres at up to `most` frequencies, evenly chosen."""
        from plant._plotting import COLOURS, axes, styled

        count = min(whole("most", most, 1, 1000), self.radii.size)
        chosen = np.unique(np.linspace(0, self.radii.size - 1, count).round().astype(int))
        turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 181))
        with styled():
            ax = axes(ax, (6.4, 4.8))
            for k in chosen:
                points, rim = self.responses[:, k], self.centers[k] + self.radii[k] * turn
                first = k == chosen[0]
                label = {name: name if first else None for name in ("sample", "disk", "centre")}
                ax.plot(points.real, points.imag, ".", c=COLOURS[5], ms=3, label=label["sample"])
                ax.plot(rim.real, rim.imag, c=COLOURS[0], lw=1.2, label=label["disk"])
                ax.plot(
                    self.centers[k].real,
                    self.centers[k].imag,
                    "+",
                    c=COLOURS[1],
                    ms=8,
                    label=label["centre"],
                )
            ax.set_aspect("equal", adjustable="datalim")
            ax.set_xlabel("real part of the response")
            ax.set_ylabel("imaginary part of the response")
            ax.set_title(f"Smallest disks at {chosen.size} of {self.radii.size} frequencies")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return the number of samples and the largest relative radius."""
        relative = self.relative_radius
        worst = int(np.argmax(relative))
        at = f"frequency {worst}" if self.omega is None else f"{self.omega[worst]:.4g} rad/s"
        return (
            f"Smallest disks over {self.responses.shape[0]} samples at {self.radii.size} "
            f"frequencies: the radius is {100 * relative.min():.3g} to {100 * relative.max():.3g} "
            f"% of the centre (most at {at})."
        )


def smallest_disks(responses: ArrayLike, omega: ArrayLike | None = None) -> CoveringDisks:
    """Return the smallest disks in the complex plane over samples at each frequency.

    Parameters
    ----------
    responses : array-like, shape (samples, frequencies), complex
        Responses; at least one sample.
    omega : array-like, shape (frequencies,), optional
        Rising frequencies, rad/s.

    Raises
    ------
    ParameterError
        If a shape does not fit or a number is not finite.

    Examples
    --------
    >>> from uncertainty.disks import smallest_disks
    >>> disks = smallest_disks([[1.0], [3.0], [2.0 + 0.5j]])
    >>> complex(disks.centers[0]), float(disks.radii[0])
    ((2+0j), 1.0)
    """
    samples = np.asarray(responses, dtype=complex)
    if samples.ndim != 2 or 0 in samples.shape:
        raise ParameterError(
            f"the responses have the shape {samples.shape}, but must have (samples, frequencies) "
            "with at least one of each: for one frequency hand in a column"
        )
    if not np.isfinite(samples).all():
        row, column = np.argwhere(~np.isfinite(samples))[0]
        raise ParameterError(
            f"sample {row} at frequency {column} is {samples[row, column]}, but must be finite: "
            "drop the samples that have no response"
        )
    frequencies = None
    if omega is not None:
        frequencies = np.array(omega, dtype=float)
        if frequencies.shape != samples.shape[1:] or not (
            np.isfinite(frequencies).all() and (np.diff(frequencies) > 0.0).all()
        ):
            raise ParameterError(
                f"omega has the shape {frequencies.shape}, but must be {samples.shape[1]} finite "
                "and rising frequencies in rad/s, one for each column of the responses"
            )
    centers = np.array([_smallest_center(column) for column in samples.T])
    radii = np.abs(samples - centers).max(axis=0)
    return CoveringDisks(centers, radii, samples, frequencies)


def _smallest_center(points: ComplexArray) -> complex:
    """Return the centre of the smallest disk over points.

    The disk over two or three points grows by the farthest point until none is outside; of the
    new point and the old support, the disk of the right pair or triple covers all.
    """
    shift = complex(points.mean())
    scale = float(np.abs(points - shift).max())
    if scale == 0.0:
        return shift
    z = (points - shift) / scale
    support = [int(np.argmax(np.abs(z)))]
    center, radius = complex(z[support[0]]), 0.0
    for _ in range(_ROUNDS):
        distance = np.abs(z - center)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= radius * (1.0 + 1e-14) or farthest in support:
            return shift + scale * center
        new_center, new_radius, new_support = _over_few(z, [*support, farthest])
        if new_radius <= radius:  # what is outside is so by rounding
            return shift + scale * center
        center, radius, support = new_center, new_radius, new_support
    raise ConvergenceError(f"the smallest disk of {points.size} points took over {_ROUNDS} rounds")


def _over_few(z: ComplexArray, indices: list[int]) -> tuple[complex, float, list[int]]:
    """Return centre, radius and support of the smallest disk over up to four points.

    It is that of a pair or a triple: the one whose centre has all points nearest.
    """
    points = z[indices]
    candidates = [(0.5 * (z[i] + z[j]), [i, j]) for i, j in combinations(indices, 2)]
    for triple in combinations(indices, 3):
        center = _circumcenter(*(complex(z[i]) for i in triple))
        if center is not None:
            candidates.append((center, list(triple)))
    reach = [float(np.abs(points - center).max()) for center, _ in candidates]
    best = int(np.argmin(reach))
    center, support = candidates[best]
    return complex(center), reach[best], support


def _circumcenter(a: complex, b: complex, c: complex) -> complex | None:
    """Return the point at one distance from three points (None on a line, but for rounding)."""
    b, c = b - a, c - a
    twice_area = 2.0 * (b.conjugate() * c).imag
    if twice_area == 0.0:
        return None
    center = a + 1j * (c * abs(b) ** 2 - b * abs(c) ** 2) / -twice_area
    return center if cmath.isfinite(center) else None
