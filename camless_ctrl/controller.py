"""Per-cylinder adaptive air-charge controller; the law is this project's own.

Run once per intake event, at IVO: it takes in the air-flow samples since the last event,
estimates the charge of the events whose window has ended, adapts the charge factors, and
commands the valve that is about to open. It is a pure function of (state, measurement,
demand), so that a run can be replayed from any of its states.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plant import ValveCommand
from plant._checks import positive, whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray

from .adaptation import AdaptationLaw, NormalisedGradient
from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .measurement_response import event_time


def _nothing() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True, slots=True)
class PendingEvent:
    """An event whose charge is not yet estimated."""

    event_index: int
    cylinder: int  # from 1
    start: float  # s, its IVO
    map_charge: float  # kg, of the map at the commanded valve motion
    factor: float  # with which the command was made


@dataclass(frozen=True, slots=True)
class ControllerState:
    """All that the controller remembers; immutable.

    Attributes
    ----------
    event_index : int
        Number of the next event.
    factors : ndarray (n,)
        Charge factor of each cylinder: true over map charge, as far as known.
    sample_time, sample_flow : ndarray (m,)
        MAF samples that pending events need, s and kg/s.
    pending : tuple of PendingEvent
        Events that wait for their estimate, oldest first.
    """

    event_index: int
    factors: FloatArray
    sample_time: FloatArray = field(default_factory=_nothing, repr=False)
    sample_flow: FloatArray = field(default_factory=_nothing, repr=False)
    pending: tuple[PendingEvent, ...] = field(default=(), repr=False)


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the controller is told at an IVO.

    Attributes
    ----------
    time : float
        Time of this IVO on the clock of the samples, s.
    speed_rpm : float
        Engine speed.
    sample_time, sample_flow : ndarray (m,)
        MAF samples since the last event, s and kg/s.
    """

    time: float
    speed_rpm: float
    sample_time: FloatArray
    sample_flow: FloatArray


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimated charge of one event."""

    event_index: int
    cylinder: int  # from 1
    charge: float  # kg
    error: float  # prediction error that the adaptation used, 1


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What happened in one step.

    Attributes
    ----------
    estimates : tuple of Estimate
        Charges estimated in this step.
    factor : float
        Factor of the cylinder commanded.
    limited : bool
        Whether the demand could not be commanded.
    projected : bool
        Whether a factor was held at its bound.
    skipped : tuple of int
        Events (by index) without a usable estimate: samples missing or not finite.
    """

    estimates: tuple[Estimate, ...]
    factor: float
    limited: bool
    projected: bool
    skipped: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class ControlStep:
    """Outcome of `AirChargeController.step`."""

    state: ControllerState
    command: ValveCommand
    diagnostics: Diagnostics


@dataclass(frozen=True, slots=True)
class AirChargeController:
    """Feedforward on the map, charge estimate from the MAF signal, one factor per cylinder.

    Parameters
    ----------
    feedforward : Feedforward
        From charge to command.
    estimator : ChargeEstimator
        From samples to charge.
    adaptation : AdaptationLaw
        From charge to factors.
    n_cylinders : int
        Number of cylinders.
    adapt : bool
        False leaves the factors as they are: feedforward alone.
    """

    feedforward: Feedforward
    estimator: ChargeEstimator = field(default_factory=ChargeEstimator)
    adaptation: AdaptationLaw = field(default_factory=NormalisedGradient)
    n_cylinders: int = 4
    adapt: bool = True

    def __post_init__(self) -> None:
        whole("n_cylinders", self.n_cylinders, 1, 24)

    def initial_state(self, factors: FloatArray | None = None) -> ControllerState:
        """Return the state before the first event, with factors 1 or those given."""
        values = np.ones(self.n_cylinders) if factors is None else np.array(factors, dtype=float)
        if values.shape != (self.n_cylinders,) or not np.all(np.isfinite(values)):
            raise ParameterError(
                f"factors is {factors!r}, but must hold {self.n_cylinders} finite values"
            )
        return ControllerState(0, values)

    def step(self, state: ControllerState, measurement: Measurement, demand: float) -> ControlStep:
        """Return the command of the next event, and the state after it.

        Parameters
        ----------
        state : ControllerState
            State before; not changed.
        measurement : Measurement
            What is known at this IVO.
        demand : float
            Demanded charge of the event, kg.
        """
        positive("demand", demand, "kg")
        speed = positive("speed_rpm", measurement.speed_rpm, "rpm")
        k = state.event_index
        cylinder = k % self.n_cylinders + 1
        time = np.concatenate((state.sample_time, measurement.sample_time))
        flow = np.concatenate((state.sample_flow, measurement.sample_flow))

        latency = self.estimator.latency_events(event_time(speed, self.n_cylinders))
        starts = [*(event.start for event in state.pending), measurement.time]
        factors, projected = state.factors, False
        estimates, skipped = [], []
        ready = sum(event.event_index <= k - latency for event in state.pending)
        for event, end in zip(state.pending[:ready], starts[1:], strict=False):
            charge = self._estimate(time, flow, event.start, end)
            if charge is None:
                skipped.append(event.event_index)
                continue
            error = charge / event.map_charge - event.factor
            if self.adapt:
                moved = self.adaptation.update(
                    factors, event.cylinder, charge / event.map_charge, event.factor, speed
                )
                factors, error = moved.factors, moved.error
                projected = projected or moved.projected
            estimates.append(Estimate(event.event_index, event.cylinder, charge, error))

        factor = float(factors[cylinder - 1])
        forward = self.feedforward.command(demand / factor, speed)
        event = PendingEvent(k, cylinder, measurement.time, forward.charge, factor)
        pending = (*state.pending[ready:], event)
        # Samples before the oldest window that is still wanted are let go.
        oldest = pending[0].start + self.estimator.delay - self.estimator.taper
        keep = max(int(np.searchsorted(time, oldest)) - 2, 0)
        after = replace(
            state,
            event_index=k + 1,
            factors=factors,
            sample_time=time[keep:],
            sample_flow=flow[keep:],
            pending=pending,
        )
        return ControlStep(
            after,
            forward.command,
            Diagnostics(tuple(estimates), factor, forward.limited, projected, tuple(skipped)),
        )

    def _estimate(
        self, time: FloatArray, flow: FloatArray, start: float, end: float
    ) -> float | None:
        """Charge of a window in kg, or None without usable samples."""
        if not self.estimator.covers(time, start, end):
            return None
        charge = self.estimator.charge(time, flow, start, end)
        return charge if np.isfinite(charge) else None
