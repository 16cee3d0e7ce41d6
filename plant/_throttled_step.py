"""Throttle steps: the throttled mean-value plant against the crank-angle plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ._checks import whole
from ._throttled_checks import require_cam_driven
from ._throttled_dynamics import ThrottledRun
from ._throttled_storage import event_average
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .throttled import ThrottledMeanValuePlant

_PER_EVENT = 40  # points of the mean-value run


@dataclass(frozen=True, eq=False)
class ThrottleStep:
    """Manifold pressure of both plants through steps of the throttle, averaged over each event.

    Attributes
    ----------
    speed_rpm : float
        Engine speed.
    throttles_deg : tuple of float
        Throttle angles: the first in steady state, each next one for `events` events.
    events : int
        Events after each step.
    time : ndarray (m,)
        Middle of each event, s after the first step.
    throttle_deg : ndarray (m,)
        Throttle angle in each event.
    full_pressure : ndarray (m,)
        Of the crank-angle plant, average over each event, Pa.
    mean_value_pressure : ndarray (m,)
        Of the mean-value plant, average over each event, Pa.
    full_throttle_flow, mean_value_throttle_flow : ndarray (m,)
        Average throttle flow of both over each event, kg/s.
    run : ThrottledRun
        The mean-value plant between the events.
    """

    speed_rpm: float
    throttles_deg: tuple[float, ...]
    events: int
    time: FloatArray
    throttle_deg: FloatArray
    full_pressure: FloatArray
    mean_value_pressure: FloatArray
    full_throttle_flow: FloatArray
    mean_value_throttle_flow: FloatArray
    run: ThrottledRun

    @property
    def error(self) -> FloatArray:
        """Relative error of the mean-value pressure in each event, 1."""
        return self.mean_value_pressure / self.full_pressure - 1.0

    @property
    def rms(self) -> float:
        """Relative root-mean-square error of the pressure over all events, 1."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def rms_each(self) -> FloatArray:
        """Relative root-mean-square error after each step, 1."""
        return np.sqrt(np.mean(self.error.reshape(-1, self.events) ** 2, axis=1))

    @property
    def worst(self) -> float:
        """Largest relative error of the pressure in any event, 1."""
        return float(np.max(np.abs(self.error)))

    def plot(self) -> Figure:
        """Draw both pressures and their difference against time."""
        from ._throttled_plots import plot_step

        return plot_step(self)

    def __str__(self) -> str:
        """Return the errors in a sentence."""
        path = " -> ".join(f"{angle:g}" for angle in self.throttles_deg)
        each = ", ".join(f"{100.0 * rms:.2f}" for rms in self.rms_each)
        k = int(np.argmax(np.abs(self.error)))
        return (
            f"Throttle {path} deg at {self.speed_rpm:g} rpm, {self.events} events after each step: "
            f"mean-value pressure off by {100.0 * self.rms:.2f} % rms ({each} % after each step) "
            f"and {100.0 * self.worst:.2f} % at worst, in event {k % self.events + 1} after step "
            f"{k // self.events + 1}."
        )


def throttle_step(
    plant: CrankAnglePlant,
    mean_value: ThrottledMeanValuePlant | None = None,
    *,
    throttles_deg: Sequence[float] = (20.0, 40.0, 20.0),
    speed_rpm: float = 1500.0,
    events: int = 24,
) -> ThrottleStep:
    """Take both plants through steps of the throttle, and compare their manifold pressures.

    Parameters
    ----------
    plant : CrankAnglePlant
        Cam-driven full plant; it starts from its periodic cycle.
    mean_value : ThrottledMeanValuePlant, optional
        Mean-value plant; by default one is fitted to the full plant.
    throttles_deg : sequence of float
        Throttle angles, at least 2.
    speed_rpm : float
        Engine speed.
    events : int
        Events after each step.

    Raises
    ------
    ParameterError
        For a camless plant, fewer than two angles, and an angle or a speed out of range.
    """
    require_cam_driven(plant)
    events = whole("events", events, 1, 100_000)
    angles = tuple(float(angle) for angle in throttles_deg)
    if len(angles) < 2:
        raise ParameterError(
            f"throttles_deg is {angles}, but must hold at least 2 angles: the first, and one for "
            "each step"
        )
    if mean_value is None:
        from .throttled import ThrottledMeanValuePlant

        mean_value = ThrottledMeanValuePlant.fit(plant)
    if mean_value.engine != plant.engine:
        raise ParameterError(
            "the throttled mean-value plant belongs to another engine than the full plant: fit one "
            "to this plant"
        )
    mean_value.require_inputs(angles, speed_rpm)
    cam = mean_value.cam
    run = plant.start(speed_rpm, cam, angles[0])
    held = np.repeat(angles[1:], events)
    results = [
        run.step_event(cam, throttle_deg=angle, trace_step_deg=1.0) for angle in held.tolist()
    ]
    duration = results[0].duration

    # A repeated time at each step makes a jump of it.
    within = np.linspace(0.0, events * duration, events * _PER_EVENT + 1)
    starts = events * duration * np.arange(len(angles) - 1)
    simulated = mean_value.simulate(
        np.concatenate([[0.0], *(start + within for start in starts)]),
        np.concatenate([[angles[0]], np.repeat(angles[1:], within.size)]),
        speed_rpm,
    )

    def averages(signal: FloatArray) -> FloatArray:
        """Average over each event, by the trapezoidal rule."""
        steps = signal[1:].reshape(len(angles) - 1, within.size)
        parts = 0.5 * (steps[:, 1:] + steps[:, :-1])
        return parts.reshape(held.size, _PER_EVENT).mean(axis=1)

    return ThrottleStep(
        speed_rpm=float(speed_rpm),
        throttles_deg=angles,
        events=events,
        time=duration * np.arange(0.5, held.size),
        throttle_deg=held,
        full_pressure=np.array([event_average(event) for event in results]),
        mean_value_pressure=averages(simulated.manifold_pressure),
        full_throttle_flow=np.array([event.throttle_mass / duration for event in results]),
        mean_value_throttle_flow=averages(simulated.throttle_flow),
        run=simulated,
    )
