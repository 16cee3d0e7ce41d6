"""First-order lag of a piecewise-linear signal, solved exactly, and quantisation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from . import _entries as entries
from ._checks import in_range
from .errors import ParameterError
from .kinematics import FloatArray


def first_order_lag(
    time: ArrayLike, signal: ArrayLike, time_constant: float, initial: float | None = None
) -> FloatArray:
    """Response of ``tau dy/dt = u - y`` to a piecewise-linear signal, exactly.

    Parameters
    ----------
    time : array_like (m,)
        Times of the points, s, not falling; a repeated time is a jump.
    signal : array_like (m,)
        Signal ``u`` at the points, linear between them.
    time_constant : float
        ``tau``, s, at least 0.
    initial : float, optional
        Response at the first point; settled at the signal by default.

    Returns
    -------
    ndarray (m,)
        Response ``y`` at the points.

    Raises
    ------
    ParameterError
        If the points are not finite, not in order or not one-dimensional.
    """
    t, u = points(time, signal)
    tau = in_range("time_constant", time_constant, 0.0, math.inf, "s")
    return at_knots(t, u, float(u[0]) if initial is None else float(initial), tau)


def at_knots(
    time: FloatArray, signal: FloatArray, first_response: float, time_constant: float
) -> FloatArray:
    """Response at each point of the signal, from that at the first one."""
    response = np.empty(time.size)
    response[0] = first_response
    entries.fill_response(time, signal, float(time_constant), response)
    return response


def fill_response(
    time: FloatArray, signal: FloatArray, time_constant: float, response: FloatArray
) -> None:
    """Write the response at each point but the first one; compiled on its first use."""
    for i in range(time.size - 1):
        span = time[i + 1] - time[i]
        rise = signal[i + 1] - signal[i]
        if time_constant == 0.0:
            response[i + 1] = signal[i + 1]
        elif span == 0.0:  # a jump of the signal
            response[i + 1] = response[i]
        else:
            ratio = span / time_constant
            settled = -math.expm1(-ratio)
            response[i + 1] = (
                response[i] + (signal[i] - response[i]) * settled + rise * (1.0 - settled / ratio)
            )


def between_knots(
    instants: FloatArray,
    time: FloatArray,
    signal: FloatArray,
    response: FloatArray,
    time_constant: float,
) -> FloatArray:
    """Response at any instants, from those at the points of the signal.

    Before the first point the response is that of the first point, after the last one the
    signal is held.
    """
    i = np.searchsorted(time, instants, side="right") - 1
    before = i < 0
    i = np.maximum(i, 0)
    following = np.minimum(i + 1, time.size - 1)
    span = time[following] - time[i]
    rise = signal[following] - signal[i]
    slope = np.divide(rise, span, out=np.zeros_like(span), where=span > 0.0)
    elapsed = np.where(before, 0.0, instants - time[i])
    if time_constant == 0.0:
        return np.where(before, response[0], signal[i] + slope * elapsed)
    settled = -np.expm1(-elapsed / time_constant)
    lagging = slope * (elapsed - time_constant * settled)
    return response[i] + (signal[i] - response[i]) * settled + lagging


def quantise(
    reading: ArrayLike, lowest: float, highest: float, bits: int | None
) -> tuple[FloatArray, np.ndarray]:
    """Round to the nearest of ``2**bits`` even levels from `lowest` to `highest`.

    Returns the output and whether the reading was outside the range, and so limited. Without
    `bits` the output is limited only.
    """
    reading = np.asarray(reading, dtype=float)
    saturated = (reading < lowest) | (reading > highest)
    limited = np.minimum(np.maximum(reading, lowest), highest)  # np.clip takes twice the time
    if bits is None:
        return limited, saturated
    step = (highest - lowest) / (2**bits - 1)
    return lowest + step * np.round((limited - lowest) / step), saturated


def points(
    time: ArrayLike, signal: ArrayLike, name: str = "time", unit: str = "s"
) -> tuple[FloatArray, FloatArray]:
    """Return both as arrays after checking that they are points of a signal in order."""
    t, u = np.asarray(time, dtype=float), np.asarray(signal, dtype=float)
    if t.ndim != 1 or t.size == 0 or t.shape != u.shape:
        raise ParameterError(
            f"{name} has shape {t.shape} and the signal {u.shape}, but both must be "
            "one-dimensional, of one length and not empty"
        )
    if not (np.isfinite(t).all() and np.isfinite(u).all()):
        bad = int(np.flatnonzero(~(np.isfinite(t) & np.isfinite(u)))[0])
        raise ParameterError(
            f"point {bad} is {name} {t[bad]:g} {unit} with signal {u[bad]:g}, but all points must "
            "be finite"
        )
    falls = t[1:] < t[:-1]
    if falls.any():
        i = int(np.flatnonzero(falls)[0])
        raise ParameterError(
            f"{name} falls from {t[i]:g} to {t[i + 1]:g} {unit} at point {i + 1}, but must not "
            "fall: sort the points"
        )
    return t, u
