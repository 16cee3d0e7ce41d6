"""What other boundary conditions do to the mean-value maps.

In the plant's equations masses and pressures can be told in units of the ambient air:
``m = p_a V_d/(R T) mu`` and ``E = p_a V_d eps``. Then three numbers are left of the boundary
conditions: the size ``T/p_a`` of the orifices, since their areas are normalised at sonic flow
(Eq. 12), the exhaust pressure ``p_exh/p_a``, and ``1/T``, by which a runner's swing is larger
(Eq. 6). `mu` and `eps` are those of the map plus a polynomial in the three, whose
coefficients are splines over the operating points: zero at the map's own conditions.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ._surface import Surface
from .boundary import NAMES, UNITS, BoundaryConditions
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import BoundaryError
from .parameters import Engine

if TYPE_CHECKING:
    from ._map_refinement import Nodes

RANGES = ((0.7e5, 1.05e5), (250.0, 330.0), (1.0e5, 1.3e5))  # Pa, K, Pa
DEGREE = 3  # of the polynomial, in total
_DESIGN = 20  # conditions simulated besides the corners of the ranges
_SEED = 1
_ROUNDING = 1e-9
POWERS = tuple(p for p in itertools.product(range(DEGREE + 1), repeat=3) if 0 < sum(p) <= DEGREE)


@dataclass(frozen=True, eq=False)
class BoundaryCorrection:
    """Polynomials of charge and loss in the boundary conditions, over the operating points.

    Attributes
    ----------
    engine : Engine
        Engine of the map, with the conditions at which the correction is zero.
    nodes : tuple of 3 ndarray
        Nodes of the coefficients in the box of the map.
    charge, loss : ndarray (n1, n2, n3, powers)
        Coefficients at the nodes, in units of the ambient air.
    ranges : tuple of 3 (float, float)
        Conditions that are covered, in the order of `BoundaryConditions`.
    error : BoundaryError
        Measured against the full plant.
    """

    engine: Engine
    nodes: Nodes
    charge: FloatArray
    loss: FloatArray
    ranges: tuple[tuple[float, float], ...]
    error: BoundaryError

    def require(self, conditions: BoundaryConditions) -> None:
        """Check that conditions are covered.

        Raises
        ------
        ParameterError
            Naming the first that is not, and the range.
        """
        for name, unit, (low, high) in zip(NAMES, UNITS, self.ranges, strict=True):
            values = np.asarray(getattr(conditions, name), dtype=float)
            slack = _ROUNDING * high
            outside = ~((values >= low - slack) & (values <= high + slack))
            if outside.any():
                raise ParameterError(
                    f"{name} is {values[outside].flat[0]:g} {unit}, but the maps cover "
                    f"[{low:g}, {high:g}] {unit}: fit the boundary conditions over another range"
                )

    def basis(self, conditions: BoundaryConditions) -> FloatArray:
        """Powers of the three numbers at conditions, (..., powers)."""
        return powers(*numbers(self.engine, conditions))

    @cached_property
    def charge_surface(self) -> Surface:
        """Spline of the charge's coefficients."""
        return Surface.through(self.nodes, self.charge)

    @cached_property
    def loss_surface(self) -> Surface:
        """Spline of the loss's coefficients."""
        return Surface.through(self.nodes, self.loss)


def units_of_air(engine: Engine, conditions: BoundaryConditions) -> tuple[Any, Any]:
    """Units of charge and loss: mass (kg) and work (J) of a displaced volume of ambient air."""
    pressure = np.asarray(conditions.ambient_pressure, dtype=float)
    gas = engine.gas_constant * np.asarray(conditions.temperature, dtype=float)
    work = pressure * engine.displaced_volume
    return work / gas, work


def numbers(engine: Engine, conditions: BoundaryConditions) -> tuple[Any, Any, Any]:
    """Orifice size, exhaust pressure and temperature relative to the engine's; 0 at its own."""
    pressure, temperature, exhaust = (
        np.asarray(getattr(conditions, name), dtype=float) for name in NAMES
    )
    return relative_numbers(engine, pressure, temperature, exhaust)


def relative_numbers(
    engine: Engine, pressure: Any, temperature: Any, exhaust: Any, log: Any = np.log
) -> tuple[Any, Any, Any]:
    """The same for anything that calculates, with the logarithm that suits it."""
    warmth = log(temperature / engine.temperature)
    size = warmth - log(pressure / engine.ambient_pressure)
    return size, exhaust / pressure - engine.exhaust_pressure / engine.ambient_pressure, warmth


def powers(size: Any, exhaust: Any, warmth: Any) -> FloatArray:
    """Products of powers of the three numbers, (..., powers)."""
    x = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (size, exhaust, warmth)))
    return np.stack([x[0] ** a * x[1] ** b * x[2] ** c for a, b, c in POWERS], axis=-1)


def fit_correction(
    engine: Engine,
    simulate: Callable[..., tuple[FloatArray, FloatArray]],
    nodes: Nodes,
    charge: FloatArray,
    loss: FloatArray,
    ranges: tuple[tuple[float, float], ...],
    error: Callable[[BoundaryCorrection], BoundaryError],
) -> BoundaryCorrection:
    """Fit the polynomials to simulated cycles at each node.

    Parameters
    ----------
    engine : Engine
        Engine of the map.
    simulate : callable
        Charge and loss at box coordinates and conditions that broadcast against each other.
    nodes : tuple of 3 ndarray
        Nodes of the coefficients.
    charge, loss : ndarray (n1, n2, n3)
        Those of the map at these nodes.
    ranges : tuple of 3 (float, float)
        Conditions to cover.
    error : callable
        Measures the correction's error.
    """
    from scipy.stats import qmc

    low, high = np.array(ranges).T
    inner = low + (high - low) * qmc.Halton(3, seed=_SEED).random(_DESIGN)
    design = np.vstack((np.array(list(itertools.product(*ranges))), inner))
    conditions = BoundaryConditions(*design.T)
    grid = np.meshgrid(*nodes, indexing="ij")
    found = simulate(*(x[..., None] for x in grid), conditions)
    solve = np.linalg.pinv(powers(*numbers(engine, conditions)))
    own = BoundaryConditions.of(engine)
    fitted = []
    for values, base, unit, unit_0 in zip(
        found,
        (charge, loss),
        units_of_air(engine, conditions),
        units_of_air(engine, own),
        strict=True,
    ):
        change = values / unit - (base / unit_0)[..., None]
        fitted.append(change @ solve.T)
    part = BoundaryCorrection(engine, nodes, fitted[0], fitted[1], ranges, BoundaryError.none())
    return BoundaryCorrection(engine, nodes, fitted[0], fitted[1], ranges, error(part))
