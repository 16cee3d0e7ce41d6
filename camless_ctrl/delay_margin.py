"""Delay that the nominal loop withstands: in events, in time, and in delay of the MAF sensor.

Later estimates by whole events are exact systems, so their poles decide. A delay ``tau`` of any
length turns the loop response by ``exp(-j omega tau)``: it first reaches -1 at one of the
frequencies where ``|L| = 1``. A transport delay of the sensor does not only turn the response,
since the window of an event then holds more of its neighbours; the loop is built anew for it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plant._checks import positive

from .nominal_loop import NominalLoop

MOST_EVENTS = 100  # up to which later estimates are tried
LONGEST_DELAY = 0.02  # s, up to which a limit of the sensor's delay is sought
_GRID = 81
_HALVINGS = 30


@dataclass(frozen=True, slots=True)
class DelayMargin:
    """Delay margins of a loop; NaN throughout (and no event) if it is unstable.

    Attributes
    ----------
    stable : bool
        Whether the loop is stable without more delay.
    event_time : float
        Event time, s.
    events : int
        Whole events by which the estimate may come later, one by one from 0 on; `MOST_EVENTS`
        if none of so many destabilises.
    time : float
        Delay whose phase turn first brings the loop response to -1, s; infinite if ``|L|`` is
        nowhere 1.
    frequency : float
        Where it does, rad/s.
    sensor_delay : float
        Delay of the MAF sensor at which the loop is first unstable, s; infinite beyond the
        longest one that was tried, NaN if it was not asked for.
    sensor_nominal : float
        Delay that it has, s.
    """

    stable: bool
    event_time: float
    events: int = 0
    time: float = math.nan
    frequency: float = math.nan
    sensor_delay: float = math.nan
    sensor_nominal: float = math.nan

    @property
    def sensor_margin(self) -> float:
        """Delay that the sensor may have beyond its nominal one, s."""
        return self.sensor_delay - self.sensor_nominal

    def __str__(self) -> str:
        """Return the margins in a sentence."""
        if not self.stable:
            return "unstable: no delay margin"
        time = (
            "a delay of any length turns the loop to nowhere"
            if math.isinf(self.time)
            else f"a delay of {1e3 * self.time:.1f} ms turns it to -1 at "
            f"{math.degrees(self.frequency * self.event_time):.0f} deg per event"
        )
        more = "or more " if self.events == MOST_EVENTS else ""
        text = f"The estimate may come {self.events} {more}events later; {time}"
        if math.isnan(self.sensor_delay):
            return text + "."
        if math.isinf(self.sensor_delay):
            return text + "; no delay of the sensor that was tried destabilises."
        return text + (
            f"; a delay of the sensor of {1e3 * self.sensor_delay:.2f} ms destabilises, "
            f"{1e3 * self.sensor_margin:.2f} ms more than it has."
        )


def delay_margin(
    loop: NominalLoop,
    at_delay: Callable[[float], NominalLoop] | None = None,
    *,
    nominal: float = 1e-3,
    longest: float = LONGEST_DELAY,
) -> DelayMargin:
    """Return the delay margins of a loop.

    Parameters
    ----------
    loop : NominalLoop
        The loop.
    at_delay : callable, optional
        Loop with a delay of the MAF sensor in s, such as
        ``lambda delay: NominalLoop.of_sensor(law, local, estimator, delay=delay)``.
    nominal, longest : float
        Delay that the sensor has, and the longest one that is tried, s.
    """
    if not loop.stable:
        return DelayMargin(False, loop.event_time)
    events = 0
    while events < MOST_EVENTS and loop.later(events + 1).stable:
        events += 1
    time, frequency = _turn(loop)
    sensor = math.nan if at_delay is None else _sensor_limit(at_delay, nominal, longest)
    return DelayMargin(
        True,
        loop.event_time,
        events,
        time,
        frequency,
        sensor,
        math.nan if at_delay is None else nominal,
    )


def _turn(loop: NominalLoop) -> tuple[float, float]:
    """Shortest delay that turns the response to -1, s, and the frequency, rad/s."""
    from .margins import _roots

    T = loop.event_time
    omega = np.unique(np.concatenate([loop.band(q) for q in loop.modes]))

    def log_size(w: float) -> float:
        # Integrators and zeros of the response: far off, but a number to bisect with.
        size = abs(complex(loop(np.exp(1j * w * T))))
        return math.log(min(max(size, 1e-12), 1e12)) if math.isfinite(size) else math.log(1e12)

    crossings = _roots(log_size, omega, np.array([log_size(w) for w in omega]))
    best, where = math.inf, math.nan
    for w in crossings:
        behind = (math.pi + float(np.angle(loop(np.exp(1j * w * T))))) % (2.0 * math.pi)
        if behind / w < best:
            best, where = behind / w, w
    return best, where


def _sensor_limit(
    at_delay: Callable[[float], NominalLoop], nominal: float, longest: float
) -> float:
    """Smallest delay above the nominal one at which the loop is unstable, s."""
    positive("longest - nominal", longest - nominal, "s", remedy="try longer delays")
    for low, high in itertools.pairwise(np.linspace(nominal, longest, _GRID)):
        if at_delay(float(high)).stable:
            continue
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if at_delay(float(middle)).stable else (low, middle)
        return float(high)
    return math.inf
