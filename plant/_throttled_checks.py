"""Checks of the throttled mean-value plant."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ._checks import in_range
from .crank_angle import CrankAnglePlant
from .errors import ParameterError

_ROUNDING = 1e-7  # share by which an input may miss its limit and still count as on it


def require_cam_driven(plant: CrankAnglePlant) -> None:
    """Check that a full plant is driven by a cam."""
    if plant.profile != "conventional":
        raise ParameterError(
            f"the plant's profile is {plant.profile!r}, but must be 'conventional': the throttled "
            "engine has a cam; make it with CrankAnglePlant(profile='conventional')"
        )


def require_range(
    name: str, values: ArrayLike, low: float, high: float, unit: str, remedy: str
) -> None:
    """Check that all values are in a range, up to rounding."""
    array = np.asarray(values, dtype=float)
    slack = _ROUNDING * high
    # A comparison with NaN is False: not a number is not inside.
    outside = ~((array >= low - slack) & (array <= high + slack))
    if outside.any():
        k = tuple(int(i) for i in np.argwhere(outside)[0])
        at = f" (element {', '.join(map(str, k))})" if array.size > 1 else ""
        in_range(f"{name}{at}", float(array[k]), low, high, unit, remedy=remedy)
