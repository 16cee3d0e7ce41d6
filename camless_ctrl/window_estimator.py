"""Event windows on the MAF signal as the estimator of a controller.

The simple estimator beside `KalmanEstimator`: it needs no model of the manifold and no pressure
sensor, and its response is known in closed form (`MeasurementResponse`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from plant._checks import in_range, whole
from plant.air_path import event_time
from plant.kinematics import FloatArray

from .estimator import ChargeEstimator
from .event_data import ChargeEstimate, EventRecord, Measurement

_LARGEST = 10.0  # kg/s, beyond any engine's air flow
_LATEST = 1e8  # s, beyond which a clock cannot tell milliseconds


class WindowState(NamedTuple):
    """Samples that are still needed, and the events that wait for their estimate."""

    time: FloatArray  # (m,), s
    flow: FloatArray  # (m,), kg/s
    pending: tuple[EventRecord, ...]


class WindowUpdate(NamedTuple):
    """Outcome of one update."""

    state: WindowState
    final: ChargeEstimate | None
    rejected: bool
    ambient_pressure: float = math.nan  # a MAF sensor does not tell


@dataclass(frozen=True, slots=True)
class WindowEstimator:
    """`ChargeEstimator` event by event.

    Parameters
    ----------
    window : ChargeEstimator
        Window, with the lag and delay that it undoes.
    n_cylinders : int
        Number of cylinders.
    relative_noise : float
        Noise of the estimate, 1 sigma over the charge, that its variance tells.
    """

    window: ChargeEstimator = field(default_factory=ChargeEstimator)
    n_cylinders: int = 4
    relative_noise: float = 0.02

    def __post_init__(self) -> None:
        whole("n_cylinders", self.n_cylinders, 1, 24)
        in_range("relative_noise", self.relative_noise, 0.0, 1.0, "1")

    def start(self) -> WindowState:
        """Return the state before the first event."""
        return WindowState(np.empty(0), np.empty(0), ())

    def commanded(self, state: WindowState, record: EventRecord) -> WindowState:
        """Return the state that knows of the event just commanded."""
        return state._replace(pending=(*state.pending, record))

    def update(self, state: WindowState, measurement: Measurement) -> WindowUpdate:
        """Take in samples, and estimate the oldest event whose window has ended.

        A window whose samples are missing or not finite is rejected.
        """
        time = np.concatenate((state.time, measurement.sample_time))
        flow = np.concatenate((state.flow, measurement.sample_flow))
        usable = (np.abs(time) < _LATEST) & (np.abs(flow) < _LARGEST)  # NaN is neither
        if not usable.all():
            time, flow = time[usable], flow[usable]
        if np.any(np.diff(time) <= 0.0):
            rising = np.concatenate(([True], time[1:] > np.maximum.accumulate(time)[:-1]))
            time, flow = time[rising], flow[rising]
        pending, window = state.pending, self.window
        last = pending[-1].event_index if pending else 0
        speed = measurement.speed_rpm
        latency = window.latency_events(event_time(speed, self.n_cylinders))
        final, rejected = None, False
        while pending and pending[0].event_index <= last + 1 - latency and final is None:
            record, pending = pending[0], pending[1:]
            end = pending[0].start if pending else measurement.time
            # Samples that were dropped leave a hole, over which the flow is not known.
            gaps = np.diff(time, prepend=-math.inf) if time.size else time
            inside = (time > record.start) & (time < end + window.delay)
            whole_window = time.size > 1 and float(gaps[inside].max(initial=0.0)) < 2.5 * float(
                np.median(np.diff(time))
            )
            if whole_window and window.covers(time, record.start, end):
                charge = window.charge(time, flow, record.start, end)
                final = ChargeEstimate(
                    record.event_index,
                    record.cylinder,
                    charge,
                    (self.relative_noise * record.point.charge) ** 2,
                    math.nan,
                    0,
                )
            else:
                rejected = True
        if pending:
            oldest = pending[0].start + window.delay - window.taper
            keep = max(int(np.searchsorted(time, oldest)) - 2, 0)
            time, flow = time[keep:], flow[keep:]
        return WindowUpdate(WindowState(time, flow, pending), final, rejected)
