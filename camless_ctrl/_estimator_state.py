"""What the Kalman charge estimator remembers from event to event."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np

from plant.errors import ParameterError
from plant.kinematics import FloatArray

from .cylinder_parameters import CylinderParameters
from .event_data import ChargeEstimate, EventRecord, ModelPoint

STATES = 8
AMBIENT, DELAY = 3, 6  # among them
CARRY = 1 + 2 * STATES  # MAF output at the window's end, its gradient, and the states it holds at
_KEPT = 2  # records that are kept behind the window that is next
_made = tuple.__new__  # half the time of a named tuple's own constructor
_NO_SAMPLES = np.array([0.0, 0.0, -np.inf, -np.inf])


class EstimatorState(NamedTuple):
    """State of a `KalmanEstimator`; do not write into its arrays.

    A named tuple, since two are made per event and one is made in a third of the time of a frozen
    dataclass. It compares by identity.

    Attributes
    ----------
    x : ndarray (8,)
        Charge of the last window's event and of the one before (kg), MAF output at the
        window's start (kg/s), ambient pressure (Pa), throttle ratio (1), lag and delay of the
        MAF sensor and lag of the MAP sensor (s).
    P : ndarray (8, 8)
        Their covariance.
    carry : ndarray (17,)
        MAF output at the window's end, its gradient, and the states it holds at.
    samples : ndarray
        Samples that are still wanted: two counts, the latest times, then times (s) and
        readings of MAF (kg/s) and MAP (Pa).
    pending : tuple of EventRecord
        Up to two events that are done with, then those that wait.
    behind : int
        How many of them are done with.
    rejections : int
        Windows in a row without an update; negative before the first window.
    """

    x: FloatArray
    P: FloatArray
    carry: FloatArray
    samples: FloatArray
    pending: tuple[EventRecord, ...]
    behind: int
    rejections: int

    def __eq__(self, other: object) -> bool:
        return self is other

    def __ne__(self, other: object) -> bool:
        return self is not other

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        return (
            f"EstimatorState(x={self.x!r}, pending={len(self.pending)}, behind={self.behind}, "
            f"rejections={self.rejections})"
        )

    @classmethod
    def empty(cls, ambient_pressure: float, lag: float, delay: float, slow: float) -> Self:
        """Return the state before the first event."""
        return cls(
            np.array([0.0, 0.0, 0.0, ambient_pressure, 1.0, lag, delay, slow]),
            np.zeros((STATES, STATES)),
            np.zeros(CARRY),
            _NO_SAMPLES,
            (),
            0,
            -1,
        )

    def appended(self, record: EventRecord, most: int) -> Self:
        """Return the state with one more record; of more than `most` the oldest are let go."""
        x, P, carry, samples, pending, behind, rejections = self
        pending = (*pending, record)
        if len(pending) > most:
            pending, behind = pending[1:], max(behind - 1, 0)
        return _made(type(self), (x, P, carry, samples, pending, behind, rejections))

    def with_samples(self, samples: FloatArray) -> Self:
        """Return the state with other samples."""
        return self._replace(samples=samples)

    def updated(self, x: FloatArray, P: FloatArray, carry: FloatArray, samples: FloatArray) -> Self:
        """Return the state after a window with an update."""
        return self._moved(x, P, carry, samples, 0)

    def rejected(
        self, x: FloatArray, P: FloatArray, carry: FloatArray, samples: FloatArray
    ) -> Self:
        """Return the state after a window without an update."""
        return self._moved(x, P, carry, samples, max(self.rejections, 0) + 1)

    def lost(self, samples: FloatArray) -> Self:
        """Return the state after a window of which nothing can be said: it begins anew."""
        return self._moved(self.x, self.P, self.carry, samples, -1)

    def _moved(
        self, x: FloatArray, P: FloatArray, carry: FloatArray, samples: FloatArray, rejections: int
    ) -> Self:
        pending, behind = self.pending, self.behind + 1
        if behind > _KEPT:
            pending, behind = pending[behind - _KEPT :], _KEPT
        return _made(type(self), (x, P, carry, samples, pending, behind, rejections))

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, lists and dictionaries."""
        return {
            "x": self.x.tolist(),
            "P": self.P.tolist(),
            "carry": self.carry.tolist(),
            "samples": self.samples.tolist(),
            "pending": [_plain(record) for record in self.pending],
            "behind": self.behind,
            "rejections": self.rejections,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the state of `to_dict`.

        Raises
        ------
        ParameterError
            If something is missing or of another shape.
        """
        names = ("x", "P", "carry", "samples", "pending", "behind", "rejections")
        missing = [name for name in names if name not in data]
        if missing:
            raise ParameterError(
                f"the estimator's state lacks {', '.join(missing)}: export it with to_dict"
            )
        x, P, carry, samples = (np.array(data[name], dtype=float) for name in names[:4])
        shapes = x.shape, P.shape, carry.shape
        wanted = (STATES,), (STATES, STATES), (CARRY,)
        if shapes != wanted:
            raise ParameterError(
                f"x, P and carry have shapes {shapes}, but must have {wanted}: export the state "
                "with to_dict"
            )
        counts = 4 + 2 * int(samples[:2].sum()) if samples.size >= 4 else -1
        if samples.size != counts:
            raise ParameterError(
                f"samples has {samples.size} numbers, but its counts say {counts}: export the "
                "state with to_dict"
            )
        return cls(
            x,
            P,
            carry,
            samples,
            tuple(_record(item) for item in data["pending"]),
            int(data["behind"]),
            int(data["rejections"]),
        )


class EstimatorUpdate(NamedTuple):
    """Outcome of `KalmanEstimator.update`."""

    state: EstimatorState
    filtered: ChargeEstimate | None  # of the latest window that is complete
    smoothed: ChargeEstimate | None  # of the event before it, with that window's samples too
    used_samples: int  # MAF and MAP samples of the window that were used
    rejected_samples: int  # and those that were wild
    rejected: bool = False  # whether a window's samples contradict the model, or are missing

    @property
    def final(self) -> ChargeEstimate | None:
        """The estimate that is not refined any more: the smoothed one."""
        return self.smoothed

    @property
    def ambient_pressure(self) -> float:
        """Ambient pressure as the MAP sensor sees it, Pa; NaN before the first window."""
        return self.state.x.item(AMBIENT) if self.state.rejections >= 0 else math.nan


def _plain(record: EventRecord) -> dict[str, Any]:
    return {
        **record._asdict(),
        "point": {**record.point._asdict(), "shares": record.point.shares.tolist()},
        "used": record.used._asdict(),
    }


def _record(data: Mapping[str, Any]) -> EventRecord:
    point = {**data["point"], "shares": np.array(data["point"]["shares"], dtype=float)}
    return EventRecord(
        **{**data, "point": ModelPoint(**point), "used": CylinderParameters(**data["used"])}
    )
