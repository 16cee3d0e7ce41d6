"""A weight that over-bounds a residual, its check, and several orders side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import broadcast, in_range
from plant.kinematics import FloatArray

from ._spectral_factor import ComplexArray, FrequencyAxis, realisation, response

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

GOOD_RATIO = 1.25  # a weight this close to the residual is tight enough
NEAR_BEST = 1.05  # where none is: so close to the tightest one is as good
_LOOKS = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))


@dataclass(frozen=True)
class WeightCheck:
    """Whether a weight over-bounds a residual.

    Attributes
    ----------
    holds : bool
        Whether |W| is at least the residual at every frequency.
    min_ratio : float
        Least |W| over the residual (infinite if the residual is zero everywhere).
    max_ratio : float
        Largest |W| over the residual or, where that is more, over `floor` times its maximum.
    at : float
        Frequency of the least ratio, rad/s.
    """

    holds: bool
    min_ratio: float
    max_ratio: float
    at: float

    def __str__(self) -> str:
        """Return the verdict with the worst frequency."""
        verdict = "over-bounds" if self.holds else "under-bounds"
        return (
            f"The weight {verdict} the residual: {self.min_ratio:.6g} times at {self.at:.4g} rad/s "
            f"at the least, {self.max_ratio:.4g} times at the most."
        )


@dataclass(frozen=True, eq=False)
class OverboundingWeight:
    """Stable, minimum-phase weight W with |W| at or above a residual.

    Attributes
    ----------
    order : int
        Number of poles, and of zeros.
    zeros, poles : ndarray, shape (order,)
        In the open left half plane (rad/s), or in discrete time inside the unit circle.
    gain : float
        W = gain prod(x - zero)/prod(x - pole), with x = j omega or e^(j omega dt).
    dt : float
        Sampling time, s; 0 in continuous time.
    name : str
        Name for prints, plots and the system.
    omega, residual : ndarray, shape (points,)
        Grid in rad/s and the residual on it, with the points that the finer grid added.
    floor : float
        Share of the largest residual that the weight bounds where the residual is less.
    min_ratio, max_ratio : float
        Least and largest |W| over the floored residual on the grid.
    tried : tuple of (int, float)
        Orders that were fitted and the largest ratio of each.
    added : int
        Number of points that the finer grid added.
    converged : bool
        Whether the program met its own criterion; if not, the weight holds all the same, but
        a tighter one may exist.
    """

    order: int
    zeros: ComplexArray
    poles: ComplexArray
    gain: float
    dt: float
    name: str
    omega: FloatArray
    residual: FloatArray
    floor: float
    min_ratio: float
    max_ratio: float
    tried: tuple[tuple[int, float], ...]
    added: int
    converged: bool

    def __call__(self, omega: ArrayLike) -> ComplexArray:
        """Return the complex response at frequencies in rad/s, of the same shape."""
        (frequency,) = broadcast("the frequencies", omega)
        x = FrequencyAxis(self.dt, 1.0).points(frequency)
        return response(x, self.zeros, self.poles, self.gain)

    def magnitude(self, omega: ArrayLike) -> FloatArray:
        """Return |W| at frequencies in rad/s, of the same shape."""
        return np.abs(self(omega))

    def check(self, omega: ArrayLike, residual: ArrayLike) -> WeightCheck:
        """Compare the weight with a residual (1) at frequencies in rad/s.

        Raises
        ------
        ParameterError
            If the two are not as many numbers, or a residual is negative or not finite.
        """
        frequency, wanted = checked_residual(omega, residual, self.dt)
        magnitude = self.magnitude(frequency)
        ratio = np.divide(
            magnitude, wanted, out=np.full_like(magnitude, np.inf), where=wanted > 0.0
        )
        worst = int(np.argmin(ratio))
        least = self.floor * float(wanted.max())
        largest = float((magnitude / np.maximum(wanted, least)).max()) if least else np.inf
        return WeightCheck(
            bool((magnitude >= wanted).all()), float(ratio[worst]), largest, float(frequency[worst])
        )

    def scaled(self, factor: float) -> OverboundingWeight:
        """Return the weight times a factor of at least 1, which bounds the residual as well."""
        factor = in_range(
            "factor", factor, 1.0, 1e12, "1", remedy="a smaller weight bounds nothing for certain"
        )
        return replace(
            self,
            gain=factor * self.gain,
            min_ratio=factor * self.min_ratio,
            max_ratio=factor * self.max_ratio,
        )

    def system(self) -> control.StateSpace:
        """Return the weight as a state-space system, with its sampling time.

        Rounding is that of a state-space model: where the sampling is four and more decades
        faster than the lowest pole, |W| is kept to about 1e-6 there.
        """
        return realisation(self.zeros, self.poles, self.gain, self.dt, self.name)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the residual and the weight over frequency and return the axes."""
        return _plot((self,), ax)

    def __str__(self) -> str:
        """Return order, tightness, range and where the poles are, in a sentence."""
        time = f"sampled at {self.dt:.4g} s" if self.dt else "continuous-time"
        name = f" {self.name!r}" if self.name else ""
        poles = f", poles at {_listed(self.poles)}" if self.order else ""
        zeros = f" and zeros at {_listed(self.zeros)}" if self.order else ""
        added = f", {self.added} of them added from a finer grid" if self.added else ""
        loose = "" if self.converged else " The fit ended early: a tighter one may exist."
        return (
            f"Weight{name} of order {self.order} ({time}{poles}{zeros}): "
            f"{self.min_ratio:.3f} to {self.max_ratio:.3f} times the residual at "
            f"{self.omega.size} frequencies from {self.omega[0]:.4g} to {self.omega[-1]:.4g} rad/s"
            f"{added}.{loose}"
        )


@dataclass(frozen=True)
class WeightTable:
    """Weights of several orders for one residual.

    Attributes
    ----------
    weights : tuple of OverboundingWeight
        By rising order.
    """

    weights: tuple[OverboundingWeight, ...]

    @property
    def chosen(self) -> OverboundingWeight:
        """The weight that the rule of `fit_weight` chooses."""
        order = lowest_order(tuple((w.order, w.max_ratio) for w in self.weights))
        return self.of_order(order)

    def of_order(self, order: int) -> OverboundingWeight:
        """Return the weight of an order."""
        for weight in self.weights:
            if weight.order == order:
                return weight
        orders = ", ".join(str(weight.order) for weight in self.weights)
        raise ParameterError(f"order is {order!r}, but the table has the orders {orders}")

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the residual and all weights over frequency and return the axes."""
        return _plot(self.weights, ax)

    def __str__(self) -> str:
        """Return one row per order; a star marks the chosen one."""
        chosen = self.chosen.order
        rows = [
            f"{w.order:>5}  {w.max_ratio:>11.4g}  {20 * np.log10(w.max_ratio):>7.2f} dB"
            f"{'  *' if w.order == chosen else ''}"
            for w in self.weights
        ]
        return "\n".join(["order  worst ratio  in decibels", *rows])


def lowest_order(tried: tuple[tuple[int, float], ...]) -> int:
    """Return the lowest order with a ratio of at most 1.25, else within 5 % of the best."""
    best = min(ratio for _, ratio in tried)
    limit = max(GOOD_RATIO, NEAR_BEST * best) if best > GOOD_RATIO else GOOD_RATIO
    return min(order for order, ratio in tried if ratio <= limit)


def checked_residual(
    omega: ArrayLike, residual: ArrayLike, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Return frequencies and residual as flat arrays, checked but for their order."""
    sizes = np.shape(omega), np.shape(residual)
    if len(sizes[0]) != 1 or sizes[0] != sizes[1] or sizes[0][0] == 0:
        raise ParameterError(
            f"frequencies and residual have the shapes {sizes[0]} and {sizes[1]}, but must be two "
            "lists of the same length, of at least one number"
        )
    frequency, wanted = broadcast("frequencies and residual", omega, residual)
    highest = np.pi / dt * (1.0 + 1e-9) if dt else np.inf
    bad = ~np.isfinite(frequency) | (frequency < 0.0) | (frequency > highest)
    if bad.any():
        bound = f"in [0, {np.pi / dt:g}] rad/s (pi/dt)" if dt else "finite and at least 0 rad/s"
        raise ParameterError(
            f"a frequency is {frequency[bad][0]:g} rad/s, but must be {bound}: "
            f"{'cut the grid there or shorten dt' if dt else 'drop it'}"
        )
    bad = ~np.isfinite(wanted) | (wanted < 0.0)
    if bad.any():
        raise ParameterError(
            f"the residual at {frequency[bad][0]:g} rad/s is {wanted[bad][0]:g}, but must be a "
            "finite magnitude of at least 0: hand in the absolute value, and drop what is missing"
        )
    return frequency, wanted


def _listed(roots: ComplexArray) -> str:
    parts = [f"{r.real:.4g}" for r in roots if r.imag == 0.0]
    parts += [f"{r.real:.4g} ± {r.imag:.4g}j" for r in roots if r.imag > 0.0]
    return ", ".join(parts)


def _plot(weights: tuple[OverboundingWeight, ...], ax: Axes | None) -> Axes:
    from matplotlib.ticker import NullFormatter

    from plant._plotting import COLOURS, axes, styled

    first = weights[0]
    with styled():
        ax = axes(ax)
        at = (first.omega > 0.0) & (first.residual > 0.0)
        ax.loglog(first.omega[at], first.residual[at], ".", c="k", ms=4, label="residual")
        drawn = first.omega[first.omega > 0.0]
        if drawn.size > 1:
            drawn = np.geomspace(drawn[0], drawn[-1], 600)
        for k, weight in enumerate(weights):
            label = f"weight of order {weight.order}"
            ax.loglog(
                drawn,
                weight.magnitude(drawn),
                ls=_LOOKS[k % len(_LOOKS)],
                c=COLOURS[k % len(COLOURS)],
                label=label,
            )
        if drawn.size > 1 and drawn[-1] > 10.0 * drawn[0]:  # a decade is enough to read them by
            ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set_xlabel("frequency (rad/s)")
        ax.set_ylabel("magnitude (1)")
        ax.set_title(f"{first.name}: weight and residual" if first.name else "Weight and residual")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax
