"""Flow through an orifice: Eq. 13-14 (simplified) and Eq. 10-11 (exact) of Part I.

Both functions return the flow relative to sonic flow, so that an effective area in kg/s
times their value is a mass flow in kg/s. Positive flow goes from `upstream` to
`downstream`; with the pressures reversed the flow is negative.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .kinematics import FloatArray

HEAT_CAPACITY_RATIO = 1.4  # gamma, 1 (section 2.2)
# Conditions at which the effective areas in kg/s were identified: the exact orifice scales
# with the upstream pressure and temperature relative to them.
REFERENCE_PRESSURE = 1e5  # Pa
REFERENCE_TEMPERATURE = 290.0  # K


def simplified_flow(downstream: ArrayLike, upstream: ArrayLike) -> FloatArray:
    """Normalised orifice flow ``d(p_1, p_2)``, Eq. 13-14.

    Parameters
    ----------
    downstream, upstream : array_like
        Pressures in Pa, positive; they broadcast.

    Returns
    -------
    ndarray
        Flow relative to sonic flow, in [-1, 1].
    """
    ratio, sign = _ratio(downstream, upstream)
    choked = np.minimum(ratio, 1.0)
    return sign * np.where(ratio <= 0.5, 1.0, 2.0 * np.sqrt(choked - choked**2))


def exact_flow(
    downstream: ArrayLike,
    upstream: ArrayLike,
    temperature: float = REFERENCE_TEMPERATURE,
    heat_capacity_ratio: float = HEAT_CAPACITY_RATIO,
) -> FloatArray:
    """Orifice flow of Eq. 10-11 relative to sonic flow at the reference conditions.

    Parameters
    ----------
    downstream, upstream : array_like
        Pressures in Pa, positive; they broadcast.
    temperature : float
        Gas temperature in K, the same on both sides.
    heat_capacity_ratio : float
        Ratio of the heat capacities, above 1.
    """
    gamma = heat_capacity_ratio
    ratio, sign = _ratio(downstream, upstream)
    critical = (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0))
    sonic = np.sqrt(gamma) * (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (2.0 * (gamma - 1.0)))
    x = np.maximum(ratio, critical)
    subsonic = x ** (1.0 / gamma) * np.sqrt(
        2.0 * gamma / (gamma - 1.0) * (1.0 - x ** ((gamma - 1.0) / gamma))
    )
    feeding = np.maximum(downstream, upstream) / REFERENCE_PRESSURE
    return sign * feeding * np.sqrt(REFERENCE_TEMPERATURE / temperature) * subsonic / sonic


def _ratio(downstream: ArrayLike, upstream: ArrayLike) -> tuple[FloatArray, FloatArray]:
    p_1 = np.asarray(downstream, dtype=float)
    p_2 = np.asarray(upstream, dtype=float)
    forward = p_1 <= p_2
    return np.where(forward, p_1 / p_2, p_2 / p_1), np.where(forward, 1.0, -1.0)
