"""Signals of a closed-loop run while it goes on: one value an event, and the crank-level trace."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np

from plant import EventResult, Trace
from plant.kinematics import FloatArray

from .controller import Diagnostics

_NUMBERS = (
    "time", "charge", "estimate", "estimate_sigma", "pumping_loss", "lift_mm", "duration_deg",
    "flow_gain", "duration_offset", "charge_factor", "delivered_lift_mm",
    "delivered_duration_deg", "told_speed_rpm",
)  # fmt: skip
_FLAGS = ("limited", "rate_limited", "adapted")
_CODES = ("mode", "alarms")
# What an event without a computation keeps of the last one of its cylinder, whose command it has.
_REPEATED = ("flow_gain", "duration_offset", "charge_factor", "limited")


class EventSignals:
    """Arrays that fill event by event."""

    def __init__(self, events: int, n_cylinders: int) -> None:
        self._n = n_cylinders
        self.arrays: dict[str, Any] = {
            **{name: np.full(events, math.nan) for name in _NUMBERS},
            **{name: np.zeros(events, dtype=bool) for name in _FLAGS},
            **{name: np.zeros(events, dtype=np.int64) for name in _CODES},
        }

    def computed(self, k: int, found: Diagnostics) -> None:
        """Write what the controller says at event `k`."""
        out = self.arrays
        out["flow_gain"][k], out["duration_offset"][k], out["charge_factor"][k] = found.parameters
        out["limited"][k], out["rate_limited"][k] = found.limited, found.rate_limited
        out["adapted"][k] = found.adapted
        out["mode"][k], out["alarms"][k] = found.mode, found.alarms
        if found.estimate is not None:
            of = found.estimate.event_index
            out["estimate"][of] = found.estimate.charge
            out["estimate_sigma"][of] = math.sqrt(found.estimate.variance)

    def missed(self, k: int) -> None:
        """Write what is known at event `k` without a computation."""
        out = self.arrays
        if k >= self._n:
            for name in _REPEATED:
                out[name][k] = out[name][k - self._n]
        if k:
            for name in _CODES:
                out[name][k] = out[name][k - 1]

    def completed(self, k: int, event: EventResult) -> None:
        """Write what the plant says of the events that end in the window of event `k`."""
        out, n = self.arrays, self._n
        for done in event.completed:
            opened = k - (k - (done.cylinder - 1)) % n  # its last IVO
            if opened >= 0:
                out["charge"][opened] = done.air_charge
                out["pumping_loss"][opened] = done.pumping_loss


_ALONG = tuple(field.name for field in fields(Trace) if field.name not in ("time", "engine"))


class TraceRecorder:
    """Crank-level signals of a run at about a step, which divides the windows evenly."""

    def __init__(self, step_deg: float) -> None:
        self._step = step_deg
        self._parts: dict[str, list[FloatArray]] = {name: [] for name in _ALONG}
        self._time: list[FloatArray] = []
        self._engine: Any = None
        self._stride = 0  # points of a window from one kept to the next; 0 until it is known

    def add(self, trace: Trace, start: float) -> None:
        """Keep some points of the trace of a window that starts at a time in s."""
        angle = trace.crank_angle_deg
        if not self._stride:
            wanted = self._step / (angle[1] - angle[0]) if angle.size > 1 else 1.0
            strides = [s for s in range(1, angle.size + 1) if angle.size % s == 0]
            self._stride = min(strides, key=lambda s: abs(math.log(s / wanted)))
        stride = self._stride
        self._time.append(start + trace.time[::stride])
        for name, parts in self._parts.items():
            # A copy, so that the points that are left out are given back.
            parts.append(getattr(trace, name)[::stride].copy())
        if self._engine is None:
            self._engine = trace.engine

    def trace(self) -> Trace:
        """Return all in one."""
        time = np.concatenate(self._time)
        signals: dict[str, Any] = {
            name: np.concatenate(parts) for name, parts in self._parts.items()
        }
        return Trace(time=time - time[0], engine=self._engine, **signals)
