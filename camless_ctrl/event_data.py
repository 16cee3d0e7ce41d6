"""What controller, charge model, estimator and adaptation tell each other about an event."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from plant.kinematics import FloatArray

from .cylinder_parameters import CylinderParameters

PARTS = 16  # parts of an event angle, in which inflow is told
EVENTS = 2  # event angles over which the inflow of one event is told


def _nothing() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the controller is told before an IVO.

    Attributes
    ----------
    time : float
        Time of this IVO on the clock of the samples, s.
    speed_rpm : float
        Engine speed.
    sample_time, sample_flow : ndarray (m,)
        MAF samples since the last call: time in s and reading in kg/s.
    pressure_time, pressure : ndarray (k,)
        MAP samples since the last call: time in s and reading in Pa.
    durations : tuple of (int, float)
        Event index and measured duration (s) of each valve that has shut since the last call.
    event_index : int, optional
        Number of the event that opens next, as the cam tells it; the one after the last if it is
        not told. A larger one says that calls were missed.
    """

    time: float
    speed_rpm: float
    sample_time: FloatArray
    sample_flow: FloatArray
    pressure_time: FloatArray = field(default_factory=_nothing)
    pressure: FloatArray = field(default_factory=_nothing)
    durations: tuple[tuple[int, float], ...] = ()
    event_index: int | None = None


class ModelPoint(NamedTuple):
    """A command, and what the charge model says about it with a cylinder's parameters."""

    lift_mm: float
    duration_deg: float  # as commanded: the duration offset is already taken off
    charge: float  # kg
    limited: bool  # whether the charge that was asked for is out of reach
    flow_slope: float  # d ln charge / d ln flow_gain, 1
    duration_slope: float  # d ln charge / d duration, 1/s
    shares: FloatArray  # (EVENTS * PARTS,), net inflow of each part from IVO over the charge


class EventRecord(NamedTuple):
    """An event that was commanded and whose charge is not yet known."""

    event_index: int
    cylinder: int  # from 1
    start: float  # IVO, s
    speed_rpm: float
    point: ModelPoint
    used: CylinderParameters  # with which the command was made
    measured_duration: float  # s; NaN until it is known


class ChargeEstimate(NamedTuple):
    """Estimated charge of one event."""

    event_index: int
    cylinder: int  # from 1
    charge: float  # kg
    variance: float  # kg2
    innovation: float  # normalised innovation squared of the update; NaN if there is none
    degrees: int  # degrees of freedom of the innovation


class ChargeEvidence(NamedTuple):
    """What one event says about its cylinder: input of an adaptation law."""

    cylinder: int  # from 1
    log_ratio: float  # ln(estimated / predicted charge); NaN if there is no estimate
    variance: float  # of log_ratio, 1
    duration_error: float  # measured less commanded duration, s; NaN if not measured
    flow_slope: float  # d ln charge / d ln flow_gain, 1
    duration_slope: float  # d ln charge / d duration, 1/s
    used: CylinderParameters  # with which the command was made
    speed_rpm: float
