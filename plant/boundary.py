"""Boundary conditions of the intake: the air before the throttle, and the exhaust."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from .errors import ParameterError
from .parameters import Engine, _Replaceable

NAMES = ("ambient_pressure", "temperature", "exhaust_pressure")
UNITS = ("Pa", "K", "Pa")


@dataclass(frozen=True, slots=True)
class BoundaryConditions(_Replaceable):
    """Ambient pressure, intake temperature and exhaust pressure.

    Numbers, or arrays that broadcast against each other and against the operating points.

    Attributes
    ----------
    ambient_pressure : array_like
        Pressure before the throttle, Pa.
    temperature : array_like
        Temperature of the air, K.
    exhaust_pressure : array_like
        Pressure in the cylinder when the intake valve opens, Pa.

    Raises
    ------
    ParameterError
        If one is not finite and above zero.
    """

    ambient_pressure: ArrayLike  # Pa
    temperature: ArrayLike  # K
    exhaust_pressure: ArrayLike  # Pa

    def __post_init__(self) -> None:
        for name, unit in zip(NAMES, UNITS, strict=True):
            try:
                values = np.asarray(getattr(self, name), dtype=float)
            except (TypeError, ValueError) as error:
                raise ParameterError(
                    f"{name} is {getattr(self, name)!r}, but must be a number or an array in {unit}"
                ) from error
            bad = ~(np.isfinite(values) & (values > 0.0))
            if bad.any():
                raise ParameterError(
                    f"{name} is {values[bad].flat[0]:g} {unit}, but must be finite and above 0"
                )

    @classmethod
    def of(cls, engine: Engine) -> Self:
        """Return those of an engine."""
        return cls(*(getattr(engine, name) for name in NAMES))

    def __str__(self) -> str:
        """Return the conditions with their units."""
        if any(np.size(getattr(self, name)) > 1 for name in NAMES):
            shape = np.broadcast_shapes(*(np.shape(getattr(self, name)) for name in NAMES))
            return f"boundary conditions of shape {shape}"
        p, t, e = (float(np.ravel(getattr(self, name))[0]) for name in NAMES)
        return f"ambient {p / 1e5:.3g} bar, {t:.4g} K, exhaust {e / 1e5:.3g} bar"
