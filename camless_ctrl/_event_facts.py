"""What the controller puts together about one event, from what it remembers and what it is told."""

from __future__ import annotations

import math
from dataclasses import replace

from ._event_timing import Timing
from .controller_parts import EstimatorUpdate
from .controller_state import ControllerState, PendingEvent
from .event_data import ChargeEstimate, ChargeEvidence, EventRecord, Measurement
from .fault_monitor import EventFacts

KEPT = 12  # events that the controller remembers: as many as the estimator
_PLAUSIBLE = 3.0  # estimated over promised charge, or one over it, that is learnt from
_LEAST_RATIO = 1e-3  # of estimated to promised charge: less is nothing


def of_index(pending: tuple[PendingEvent, ...], event_index: int) -> PendingEvent | None:
    """Return the pending event of a number, the latest being looked at first; None without one."""
    for event in reversed(pending):
        if event.record.event_index == event_index:
            return event
    return None


def with_durations(
    pending: tuple[PendingEvent, ...], durations: tuple[tuple[int, float], ...]
) -> tuple[PendingEvent, ...]:
    """Return the pending events with measured durations filled in."""
    for event_index, duration in durations:
        for i in range(len(pending) - 1, -1, -1):
            record, exact = pending[i]
            if record[0] == event_index:
                # Built by place, which takes a third of the time of a replacement by name.
                told = PendingEvent(EventRecord(*record[:-1], duration), exact)
                pending = (*pending[:i], told, *pending[i + 1 :])
                break
    return pending


def without_pressure(measurement: Measurement) -> Measurement:
    """Return the measurement without its pressure samples."""
    return replace(
        measurement,
        pressure_time=measurement.pressure_time[:0],
        pressure=measurement.pressure[:0],
    )


def charge_evidence(
    event: PendingEvent | None,
    estimate: ChargeEstimate,
    jitter: float,
    noise: float,
    most_error: float,
) -> ChargeEvidence | None:
    """Return what an estimate says about its cylinder; None if the model does not know the event.

    The delivered duration is the expected one, plus jitter, and is measured with noise (1 sigma,
    s). The part of the measured deviation that is jitter, ``w``, moves the charge that is
    promised; what is left of charge and duration then have independent errors. A deviation of
    more than `most_error` is none.
    """
    if event is None or not event.exact:
        return None
    charge, variance = estimate.charge, estimate.variance
    _, cylinder, _, speed, point, used, measured = event.record
    ratio = charge / point.charge
    if not 1.0 / _PLAUSIBLE < ratio < _PLAUSIBLE:
        return None
    slope = point.duration_slope
    error = measured - point.duration_deg / (6.0 * speed)
    log_ratio, random, read, w = math.log(ratio), jitter * jitter, noise * noise, 0.0
    if not abs(error) <= most_error:
        error = math.nan  # not measured, or by a sensor that has failed
    elif random + read > 0.0:
        w = random / (random + read)
        log_ratio -= slope * w * (error - used.duration_offset)
    return ChargeEvidence(
        cylinder,
        log_ratio,
        variance / charge**2 + slope**2 * random * (1.0 - w),
        error,
        point.flow_slope,
        slope,
        used,
        speed,
    )


def event_facts(
    timing: Timing,
    cylinder: int,
    pending: tuple[PendingEvent, ...],
    event: PendingEvent | None,
    found: EstimatorUpdate,
) -> EventFacts:
    """Return what the monitors are told; `event` is the one that was estimated."""
    last = pending[-1].record if pending else None
    errors = []
    for event_index, duration in timing.measurement.durations:
        told = of_index(pending, event_index)
        if told is not None and not told.shut and not math.isnan(duration):
            record = told.record
            expected = record.point.duration_deg / (6.0 * record.speed_rpm)
            late = duration - expected - record.used.duration_offset
            errors.append((record.cylinder, late))
    level = math.nan
    if last is not None:
        if last.point.lift_mm == 0.0:
            errors.append((last.cylinder, math.nan))  # kept shut: there is none to be told
        else:
            used = last.used
            level = math.log(used.charge_factor)
            level += last.point.flow_slope * math.log(used.flow_gain)
    estimated, ratio, innovation = 0, math.nan, math.nan
    final = found.final
    if final is not None:
        innovation = final.innovation / final.degrees if final.degrees else math.nan
        if event is not None and event.exact:
            estimated = final.cylinder
            ratio = math.log(max(final.charge / event.record.point.charge, _LEAST_RATIO))
    return EventFacts(
        cylinder,
        timing.elapsed,
        timing.measurement,
        estimated,
        ratio,
        innovation,
        found.rejected,
        level,
        last,
        tuple(errors),
    )


def skipped_events(
    state: ControllerState, timing: Timing, n_cylinders: int
) -> tuple[PendingEvent, ...]:
    """Return the events since the last computation: their valves repeated their last command.

    Nothing if one of them is not remembered, or the number of the event has gone back or far.
    """
    missed = timing.missed
    if not 0 < missed <= n_cylinders or not math.isfinite(state.time):
        return ()
    each = timing.elapsed / (missed + 1)
    made: list[PendingEvent] = []
    for j in range(missed):
        index = state.event_index + j
        before = of_index(state.pending, index - n_cylinders)
        if before is None:
            return ()
        record = before.record._replace(
            event_index=index, start=state.time + (j + 1) * each, measured_duration=math.nan
        )
        made.append(PendingEvent(record, False))
    return tuple(made)
