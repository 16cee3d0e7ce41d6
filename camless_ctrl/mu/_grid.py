"""Frequencies at which to look: from the poles of a system, with both ends."""

from __future__ import annotations

import math

import numpy as np

from ._response import FloatArray, Response

_FINE, _COARSE = 140, 60
_BESIDE = (-3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0)  # half-widths of a resonance


def frequency_grid(response: Response, fine: bool) -> FloatArray:
    """Return rising frequencies, rad per time unit.

    Discrete: the upper unit circle with 0 and the Nyquist frequency, dense beside 0 as far as
    the slowest pole demands. Continuous: 0, and two decades beyond the poles. Resonances get
    points of their own.
    """
    count = _FINE if fine else _COARSE
    poles = response.poles
    if response.dt > 0.0:
        poles = poles[np.abs(poles) > 1e-12]
        logs = np.log(poles)
        corners, width, place = np.abs(logs), np.abs(logs.real), np.abs(logs.imag)
        slow = min(0.1 * corners.min(initial=0.1), 0.01)
        low = np.geomspace(max(slow, 1e-6), 0.1, count // 3)
        grid = np.concatenate(([0.0], low, np.linspace(0.1, math.pi, 2 * count // 3)[1:]))
        end, unit = math.pi, 1.0 / response.dt
    else:
        corners, width, place = np.abs(poles), np.abs(poles.real), np.abs(poles.imag)
        seen = corners[corners > 0.0]
        first, last = (seen.min(), seen.max()) if seen.size else (1.0, 1.0)
        grid = np.concatenate(([0.0], np.geomspace(0.01 * first, 100.0 * last, count)))
        end, unit = math.inf, 1.0
    sharp = (width < 0.3 * corners) & (place > 0.0)
    near = (place[sharp, None] + width[sharp, None] * np.array(_BESIDE)).ravel()
    grid = np.concatenate((grid, near[(near > 0.0) & (near < end)]))
    grid = np.unique(grid)
    return grid * unit if end == math.inf else np.minimum(grid * unit, response.nyquist)
