"""Charge of each intake event from the air-flow (MAF) signal, its lag and delay undone.

The law is this project's own. For a first-order lag ``tau y' = u - y`` the mean of the flow
over a window is exact,

    mean(u) = mean(y) + tau (y_end - y_start)/T,

whatever the flow does inside the window; a transport delay shifts the window. The unthrottled
manifold fills within 0.3 ms, so the flow into the manifold during an event is the charge of
the cylinder that opens in it, as long as the valve shuts within the event. What flows after
that is counted for the next cylinder: overlap is not undone, and a controller that allows it
has to keep its durations below ``Engine.event_angle_deg``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plant._checks import in_range, replace_fields
from plant.errors import ParameterError
from plant.kinematics import FloatArray

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True)
class ChargeEstimator:
    """Event window on the MAF signal, with the lag and delay that it assumes.

    Parameters
    ----------
    time_constant : float
        Lag ``tau`` to undo, s; 0 takes the plain average.
    delay : float
        Transport delay by which the window is shifted, s.
    taper : float
        Width over which the edges of the window are averaged, s. It lowers the noise of the
        edges, which the lag amplifies by ``tau/T``; neighbouring windows still add up to one,
        so that no charge is lost.
    """

    time_constant: float = 15e-3  # s
    delay: float = 1e-3  # s
    taper: float = 2e-3  # s

    def __post_init__(self) -> None:
        in_range("time_constant", self.time_constant, 0.0, 1.0, "s")
        in_range("delay", self.delay, 0.0, 0.1, "s")
        in_range("taper", self.taper, 0.0, 0.1, "s")

    @classmethod
    def event_average(cls) -> ChargeEstimator:
        """Return the plain average over the event: neither lag nor delay undone."""
        return cls(time_constant=0.0, delay=0.0, taper=0.0)

    def replace(self, **changes: float) -> ChargeEstimator:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def latency_events(self, event_time: float) -> int:
        """Events from the IVO of an event until its charge is known at an IVO.

        One where the window ends with the event itself, more where the delay and the taper
        reach into later events of `event_time` s.
        """
        return 1 + math.ceil((self.delay + 0.5 * self.taper) / event_time - 1e-9)

    def covers(self, time: FloatArray, start: float, end: float) -> bool:
        """Whether samples at these times cover the window of an event.

        Up to two sampling intervals may be missing at its end: the last sample before an IVO
        lies before it.
        """
        if time.size < 2:
            return False
        reach, spacing = 0.5 * self.taper, time[1] - time[0]
        begins = time[0] <= start + self.delay - reach + 1e-9
        ends = time[-1] >= end + self.delay + reach - 2.0 * spacing
        return bool(begins and ends)

    def charge(self, time: FloatArray, flow: FloatArray, start: float, end: float) -> float:
        """Estimate the charge that went in between two times.

        Parameters
        ----------
        time, flow : ndarray (m,)
            MAF samples: times in s, rising, and readings in kg/s.
        start, end : float
            Event window in plant time, s.

        Returns
        -------
        float
            Charge in kg. The flow is taken as linear between samples.

        Raises
        ------
        ParameterError
            If the samples do not cover the window.
        """
        if not self.covers(time, start, end):
            raise ParameterError(
                f"{time.size} samples do not cover the window of the event from {start:.4f} to "
                f"{end:.4f} s: keep more samples, or estimate later"
            )
        first, last, reach = start + self.delay, end + self.delay, 0.5 * self.taper
        area = _running_integral(time, flow, first, last, reach)
        if self.time_constant == 0.0:
            return area
        edges = [
            np.interp(edge, time, flow)
            if reach == 0.0
            else _integral(time, flow, np.array([edge - reach, edge + reach])) / self.taper
            for edge in (first, last)
        ]
        return area + self.time_constant * float(edges[1] - edges[0])


def _cumulative(time: FloatArray, flow: FloatArray, at: FloatArray) -> FloatArray:
    """Integral of the piecewise linear flow from its first sample to the times `at`."""
    steps = np.diff(time)
    areas = np.concatenate(([0.0], np.cumsum(0.5 * steps * (flow[1:] + flow[:-1]))))
    k = np.clip(np.searchsorted(time, at, side="right") - 1, 0, time.size - 2)
    since = at - time[k]
    slope = (flow[k + 1] - flow[k]) / steps[k]
    return areas[k] + since * (flow[k] + 0.5 * slope * since)


def _integral(time: FloatArray, flow: FloatArray, bounds: FloatArray) -> float:
    low, high = _cumulative(time, flow, bounds)
    return float(high - low)


def _running_integral(
    time: FloatArray, flow: FloatArray, first: float, last: float, reach: float
) -> float:
    """Integral over the window, its edges averaged over ``+-reach``."""
    if reach == 0.0:
        return _integral(time, flow, np.array([first, last]))
    shifts = reach * _NODES
    low, high = np.split(
        _cumulative(time, flow, np.concatenate((first + shifts, last + shifts))), 2
    )
    return float(0.5 * _WEIGHTS @ (high - low))
