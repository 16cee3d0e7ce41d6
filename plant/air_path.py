"""Air path from the charge of each event to what a lagging flow sensor shows of it.

The charge of an event flows past the sensor in some shape, through a transport delay and a
lag. Each pulse of charge dies geometrically, so what a window of each event shows is a short
FIR filter with a one-pole tail,

    H(z) = sum_j c_j z^-j + c_J z^-J/(1 - a z^-1),    a = exp(-T/tau),    z per event,

exact for the values at the events.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._checks import in_range, positive, whole
from .errors import ParameterError
from .kinematics import FloatArray

if TYPE_CHECKING:
    import control

ComplexArray = NDArray[np.complex128]


def event_time(speed_rpm: float, n_cylinders: int) -> float:
    """Time from one intake event to the next in s, ``120/(n N)``."""
    speed = positive("speed_rpm", speed_rpm, "rpm")
    return 120.0 / (whole("n_cylinders", n_cylinders, 1, 24) * speed)


def mode_point(q: int, n_cylinders: int) -> complex:
    """Modal shift per event ``exp(j 2 pi q/n)`` of an imbalance that repeats q times a cycle."""
    return complex(np.exp(2j * np.pi * q / n_cylinders))


@dataclass(frozen=True)
class FlowShape:
    """How a charge flows past the sensor: its shares in equal parts of time from IVO on.

    Parameters
    ----------
    shares : ndarray
        Share of the charge in each part, 1; their sum is 1. More than one event may be
        covered, and a share may be negative.
    parts : int
        Parts per event.
    """

    shares: FloatArray
    parts: int

    def __post_init__(self) -> None:
        whole("parts", self.parts, 1, 10_000)
        shares = np.array(self.shares, dtype=float)
        if shares.ndim != 1 or shares.size == 0 or not abs(shares.sum() - 1.0) < 1e-9:
            raise ParameterError(
                f"shares sum up to {shares.sum():g}, but must be a list that sums up to 1: divide "
                "them by their sum"
            )
        shares.setflags(write=False)
        object.__setattr__(self, "shares", shares)

    @classmethod
    def even(cls) -> FlowShape:
        """Return a charge that flows evenly over its event."""
        return cls(np.ones(1), 1)

    @property
    def centre(self) -> float:
        """Mean time of the flow after IVO, in events."""
        return float((np.arange(self.shares.size) + 0.5) @ self.shares / self.parts)


@dataclass(frozen=True)
class PulseResponse:
    """Response of a quantity of each event to the charges: FIR taps and a one-pole tail.

    Attributes
    ----------
    event_time : float
        ``T``, s.
    first : int
        Event lag of the first tap; negative where the window reaches into later events.
    taps : ndarray
        ``c_j`` from ``j = first``; the last one starts the tail.
    pole : float
        ``a`` of the tail.
    """

    event_time: float
    first: int
    taps: FloatArray
    pole: float

    @classmethod
    def of_window(
        cls,
        event_time: float,
        *,
        time_constant: float,
        delay: float,
        shape: FlowShape | None = None,
        shift: float = 0.0,
        taper: float = 0.0,
        correction: float = 0.0,
    ) -> Self:
        """Return the response of what a MAF sensor shows in a window of each event.

        It is the integral of the reading over one event time, plus a multiple of the reading's
        rise over it; in units of charge.

        Parameters
        ----------
        event_time : float
            ``T``, s.
        time_constant, delay : float
            Lag and transport delay of the sensor, s.
        shape : FlowShape, optional
            How the charge flows past the sensor; evenly over its event by default.
        shift : float
            Time from the event's IVO to the start of the window, s.
        taper : float
            Width over which the window's edges are averaged, s.
        correction : float
            Weight of the rise, s.
        """
        T = positive("event_time", event_time, "s")
        tau = positive("time_constant", time_constant, "s")
        in_range("delay", delay, 0.0, 1.0, "s")
        shape = FlowShape.even() if shape is None else shape
        length = T / shape.parts
        begin = length * np.arange(shape.shares.size)
        # Window edges in the time of each pulse, for a pulse that starts in the event itself.
        start = shift - delay - begin
        reach = 0.5 * taper
        first = math.floor(-1.0 - (start.max() + reach) / T + 1e-12) + 1
        last = max(math.ceil((length + reach - start.min()) / T - 1e-12), first)
        low = np.arange(first, last + 1)[:, None] * T + start
        edges = np.stack((low, low + T))
        area = _averaged(pulse_area, _pulse_area_integral, edges, length, tau, reach)
        step = _averaged(_pulse, pulse_area, edges, length, tau, reach)
        per_pulse = (area + correction * step) @ shape.shares
        return cls(T, first, per_pulse[1] - per_pulse[0], math.exp(-T / tau))

    def __call__(self, z: ArrayLike) -> ComplexArray:
        """Return the complex response at points `z` (per event), of the shape of `z`."""
        z = np.asarray(z, dtype=complex)
        lags = self.first + np.arange(self.taps.size)
        terms = self.taps * z[..., None] ** (-lags)
        tail = self.pole / (z - self.pole) * terms[..., -1]
        return np.asarray(terms.sum(axis=-1) + tail, dtype=complex)

    def mode(self, q: int, n_cylinders: int) -> complex:
        """Response to a steady imbalance of mode `q`."""
        return complex(self(mode_point(q, n_cylinders)))

    def matrices(self, latency: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ``A, B, C`` of ``z^-latency H(z)``: a shift register and the tail.

        Raises
        ------
        ParameterError
            If the estimate would need the present or a later charge.
        """
        if self.first + latency < 1:
            raise ParameterError(
                f"latency is {latency} events, but must be at least {1 - self.first}: the "
                "window of the estimate has not ended yet"
            )
        m = latency + self.first + self.taps.size - 1  # lag of the last tap
        A = np.zeros((m + 1, m + 1))
        A[np.arange(1, m), np.arange(m - 1)] = 1.0  # shift register of past charges
        A[m, m - 1], A[m, m] = 1.0, self.pole  # tail
        B = np.zeros((m + 1, 1))
        B[0, 0] = 1.0
        C = np.zeros((1, m + 1))
        C[0, latency + self.first - 1 : m] = self.taps
        C[0, m] = self.taps[-1] * self.pole
        return A, B, C

    def system(self, latency: int) -> control.StateSpace:
        """Return ``z^-latency H(z)`` as a state-space system per event.

        Input ``charge``, output ``estimate``, sampling time ``event_time``.
        """
        import control

        A, B, C = self.matrices(latency)
        m = A.shape[0] - 1
        return control.ss(
            A,
            B,
            C,
            [[0.0]],
            self.event_time,
            inputs=["charge"],
            outputs=["estimate"],
            states=[f"charge_{i + 1}_events_ago" for i in range(m)] + ["maf_tail"],
            name="measurement",
        )


_PulseFunction = Callable[[FloatArray, float, float], FloatArray]

# A pulse of unit charge that flows evenly over `length` s, seen through the lag: its reading,
# the integral of that, and the integral of the integral.


def _pulse(t: FloatArray, length: float, tau: float) -> FloatArray:
    def ramp(s: FloatArray) -> FloatArray:
        s = np.maximum(s, 0.0)
        return -np.expm1(-s / tau)

    return (ramp(t) - ramp(t - length)) / length


def pulse_area(t: FloatArray, length: float, tau: float) -> FloatArray:
    """Integral of the reading of a pulse up to times after its start, of its charge."""

    def ramp(s: FloatArray) -> FloatArray:
        s = np.maximum(s, 0.0)
        return s + tau * np.expm1(-s / tau)

    return (ramp(t) - ramp(t - length)) / length


def _pulse_area_integral(t: FloatArray, length: float, tau: float) -> FloatArray:
    def ramp(s: FloatArray) -> FloatArray:
        s = np.maximum(s, 0.0)
        return 0.5 * s**2 - tau * (s + tau * np.expm1(-s / tau))

    return (ramp(t) - ramp(t - length)) / length


def _averaged(
    function: _PulseFunction,
    integral: _PulseFunction,
    t: FloatArray,
    length: float,
    tau: float,
    reach: float,
) -> FloatArray:
    """`function` averaged over ``t +- reach``, by its `integral`."""
    if reach == 0.0:
        return function(t, length, tau)
    return (integral(t + reach, length, tau) - integral(t - reach, length, tau)) / (2.0 * reach)
