"""Compiled kernel of the crank-angle plant: one window of crank angle at constant speed.

The state is mass: the manifold's and each breathing cylinder's (Eq. 1 and 2 with
``M = p V/(R T)``, so that the volume work is exact). A window is cut into segments where a
valve opens, closes or changes its form of motion, and at nothing else. A manifold from which
no cylinder breathes fills in closed form.
"""

from __future__ import annotations

import math

import numpy as np

from . import valve
from ._compile import compiled
from ._fill import fill_segment
from ._layout import (
    ACCELERATION,
    CAM,
    CHARGE,
    COMPLETED,
    DURATION,
    FLOW,
    LIFT,
    LOSS,
    MASS,
    MASS_AT_OPENING,
    OK,
    OPEN_AT_COMPRESSION_TDC,
    PHASE,
    RISE,
    SAME_TIME,
    SEAT,
    SHUT,
    SINCE,
    TRACE_FIRST,
    TRACE_FLOW,
    TRACE_LIFT,
    TRACE_MASS,
    TRACE_RUNNER,
    TRACE_STRIDE,
    TURNED,
    VELOCITY,
    WORK,
    Event,
    KernelEngine,
    Window,
)
from ._segment import integrate_segment
from ._workspace import COS, FREE_IM, FREE_RE, POWER_0, SIN, WORKSPACE_COLUMNS

FIRST_STEP_DEG = 0.5  # step that is tried first when a valve opens

LATEST_CLOSING_DEG = valve.LATEST_CLOSING_DEG

_profile_corners = compiled(valve.profile_corners)


@compiled
def make_window(
    engine: KernelEngine,
    window_deg: float,
    speed_rpm: float,
    throttle_area: float,
    natural_frequency: float,
    damping: float,
    resolution: float,
    samples: int,
) -> Window:
    """Return a window with the runner's steady response to the piston (Eq. 7)."""
    omega = math.pi / 30.0 * speed_rpm
    detuning = 1.0 - (omega / natural_frequency) ** 2
    lag = 2.0 * damping * omega / natural_frequency
    amplitude = engine.runner_forcing * omega / (detuning * detuning + lag * lag)
    velocity_sin, velocity_cos = amplitude * detuning, -amplitude * lag
    length = window_deg / (6.0 * speed_rpm)
    return Window(
        length,
        6.0 * speed_rpm,
        omega,
        throttle_area,
        velocity_sin,
        velocity_cos,
        -omega * velocity_cos,
        omega * velocity_sin,
        -damping * natural_frequency,
        natural_frequency * math.sqrt(1.0 - damping * damping),
        resolution,
        samples,
        length / samples if samples > 0 else math.inf,
    )


@compiled
def advance_window(
    engine: KernelEngine,
    window: Window,
    event: Event,
    flow_coefficients: np.ndarray,  # (n,), kg/s/mm
    angles: np.ndarray,  # (n,), crank angle of each cylinder at the start, deg after its TDC
    cylinders: np.ndarray,  # (n, CYLINDER_COLUMNS), changed in place
    manifold: np.ndarray,  # (MANIFOLD_ENTRIES,), changed in place
    trace: np.ndarray,  # (rows, samples of one or more windows)
    first: int,  # column of the trace at which this window starts
) -> int:
    """Advance the plant by one window, in which one cylinder opens. Returns a status."""
    n = engine.n_cylinders
    work = np.empty((n, WORKSPACE_COLUMNS))
    corners = np.empty((n, SEAT))
    breathing = np.empty(n, np.int64)
    n_breathing = 0
    for j in range(n):
        if cylinders[j, PHASE] != SHUT:
            _prepare(engine, window, cylinders[j], corners[j], work[j], angles[j])
            breathing[n_breathing] = j
            n_breathing += 1
    opening_time = event.until_opening_deg / window.degree_rate
    opened = False
    step = FIRST_STEP_DEG / window.degree_rate
    now = 0.0
    sample = 0
    while True:
        end = window.length - now
        if not opened:
            end = min(end, opening_time - now)
        for j in breathing[:n_breathing]:
            end = min(end, _until_cut(window, cylinders[j], corners[j]))
        if end > SAME_TIME:
            seen = sample
            if n_breathing == 0 and not engine.exact_orifice:
                sample = fill_segment(engine, window, manifold, now, end, trace, first, sample)
            else:
                status, sample, step = integrate_segment(
                    engine, window, flow_coefficients, cylinders, corners, manifold, work,
                    breathing, n_breathing, now, end, step, trace, first, sample,
                )  # fmt: skip
                if status != OK:
                    return status
            for k in range(seen, sample):
                _record_shut(window, cylinders, angles, event.cylinder, opened, trace, first, k)
            now += end
            for j in breathing[:n_breathing]:
                cylinders[j, SINCE] += end
                cylinders[j, TURNED] += end * window.degree_rate
        kept = 0
        for j in breathing[:n_breathing]:
            row = cylinders[j]
            # A valve moves in time: a speed that rises carries it past its closing angle.
            if angles[j] + now * window.degree_rate > LATEST_CLOSING_DEG + 1e-6:
                return OPEN_AT_COMPRESSION_TDC
            while row[PHASE] != SHUT and _until_cut(window, row, corners[j]) <= SAME_TIME:
                if row[PHASE] >= SEAT:
                    angle = angles[j] + now * window.degree_rate
                    _finish_event(engine, row, _volume(engine, work[j, COS]), angle >= 180.0)
                else:
                    row[PHASE] += 1.0
            if row[PHASE] != SHUT:
                breathing[kept] = j
                kept += 1
        n_breathing = kept
        if not opened and opening_time - now <= SAME_TIME:
            opened = True
            j = event.cylinder
            angle = angles[j] + event.until_opening_deg
            _open(engine, window, event, cylinders[j], math.cos(math.radians(angle)))
            if cylinders[j, PHASE] != SHUT:
                _prepare(engine, window, cylinders[j], corners[j], work[j], angle)
                step = FIRST_STEP_DEG / window.degree_rate
                breathing[n_breathing] = j
                n_breathing += 1
        if window.length - now <= SAME_TIME:
            break
    for j in breathing[:n_breathing]:
        _keep_runner(window, cylinders[j], work[j])
    return OK


@compiled
def _volume(engine: KernelEngine, cosine: float) -> float:
    return engine.clearance_volume + engine.half_stroke_volume * (1.0 - cosine)


@compiled
def _until_cut(window: Window, row: np.ndarray, corners: np.ndarray) -> float:
    """Time to the end of the present form of the valve's motion, s."""
    if row[PHASE] == CAM:
        return (row[DURATION] - row[TURNED]) / window.degree_rate
    return corners[int(row[PHASE]) - 1] - row[SINCE]


@compiled
def _open(
    engine: KernelEngine, window: Window, event: Event, row: np.ndarray, cosine: float
) -> None:
    """Begin an event at IVO: cylinder at exhaust pressure, runner at rest (Eq. 8)."""
    volume = _volume(engine, cosine)
    row[:FLOW] = 0.0
    row[MASS] = engine.exhaust_pressure * volume / engine.gas
    row[MASS_AT_OPENING] = row[MASS]
    row[FLOW] = 0.0
    row[LIFT] = event.lift
    if event.lift == 0.0:  # a valve that stays shut: its event is over at once
        _finish_event(engine, row, volume, False)
    elif engine.cam:
        row[PHASE] = CAM
        row[DURATION] = event.duration_deg
    else:
        row[PHASE] = RISE
        row[DURATION] = event.duration_deg / window.degree_rate


@compiled
def _prepare(
    engine: KernelEngine,
    window: Window,
    row: np.ndarray,
    corners: np.ndarray,
    space: np.ndarray,
    angle_deg: float,
) -> None:
    """Set a breathing cylinder's corner times, crank phasor and free runner motion."""
    if row[PHASE] != CAM:
        (corners[0], corners[1], corners[2], corners[3], corners[4]) = _profile_corners(
            row[LIFT],
            row[DURATION],
            engine.opening_slope,
            engine.closing_slope,
            engine.seating_slope,
            engine.seating_duration,
            engine.roundness,
        )
    s, c = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    space[SIN], space[COS] = s, c
    pressure = row[MASS] * engine.gas / _volume(engine, c)
    rate = engine.half_stroke_volume * window.omega * s
    space[POWER_0] = (engine.exhaust_pressure - pressure) * rate
    velocity = row[VELOCITY] - window.velocity_sin * s - window.velocity_cos * c
    rate = row[ACCELERATION] - window.acceleration_sin * s - window.acceleration_cos * c
    # Free velocity Re(b exp(pole t)); its rate has the phasor pole b.
    b_im = (window.pole_re * velocity - rate) / window.pole_im
    space[FREE_RE] = window.pole_re * velocity - window.pole_im * b_im
    space[FREE_IM] = window.pole_re * b_im + window.pole_im * velocity


@compiled
def _keep_runner(window: Window, row: np.ndarray, space: np.ndarray) -> None:
    """Store the runner's velocity and acceleration, from which another speed goes on."""
    s, c, re, im = space[SIN], space[COS], space[FREE_RE], space[FREE_IM]
    square = window.pole_re**2 + window.pole_im**2
    free = (re * window.pole_re + im * window.pole_im) / square
    row[VELOCITY] = window.velocity_sin * s + window.velocity_cos * c + free
    row[ACCELERATION] = window.acceleration_sin * s + window.acceleration_cos * c + re


@compiled
def _finish_event(engine: KernelEngine, row: np.ndarray, volume: float, past_bottom: bool) -> None:
    """Close an event at IVC: charge, and loss up to the instant with ``p_c >= p_exh``.

    The shut cylinder keeps its mass, so the rest of the loss integral has a closed form; on
    the way through BDC and back to the same volume it cancels. A mass too small to reach
    exhaust pressure is compressed to TDC.
    """
    mass = row[MASS]
    bottom = 2.0 * engine.half_stroke_volume + engine.clearance_volume
    largest = volume if past_bottom else bottom
    end = max(min(mass * engine.gas / engine.exhaust_pressure, largest), engine.clearance_volume)
    compression = mass * engine.gas * math.log(end / volume)
    row[LOSS] = row[WORK] + engine.exhaust_pressure * (end - volume) - compression
    row[CHARGE] = mass - row[MASS_AT_OPENING]
    row[COMPLETED] += 1.0
    row[FLOW] = 0.0
    row[PHASE] = SHUT


@compiled
def _record_shut(
    window: Window,
    cylinders: np.ndarray,
    angles: np.ndarray,
    opening: int,
    opened: bool,
    trace: np.ndarray,
    first: int,
    k: int,
) -> None:
    """Write a trace sample of the shut cylinders: their mass is known until the firing TDC."""
    for j in range(cylinders.shape[0]):
        if cylinders[j, PHASE] != SHUT:
            continue
        r = TRACE_FIRST + TRACE_STRIDE * j
        angle = angles[j] + k * window.spacing * window.degree_rate
        closed = cylinders[j, COMPLETED] > 0.0 and (opened or j != opening)
        known = closed and angle <= 360.0
        trace[r + TRACE_MASS, first + k] = cylinders[j, MASS] if known else math.nan
        trace[r + TRACE_FLOW, first + k] = 0.0
        trace[r + TRACE_RUNNER, first + k] = math.nan
        trace[r + TRACE_LIFT, first + k] = 0.0


@compiled
def advance_cycle(
    engine: KernelEngine,
    windows: Window,
    commands: np.ndarray,  # (n, 3): delivered lift, duration, crank angle from the start to IVO
    flow_coefficients: np.ndarray,
    advance_deg: float,
    cylinders: np.ndarray,
    manifold: np.ndarray,
    trace: np.ndarray,  # (rows, samples of the whole cycle)
) -> int:
    """Advance the plant by one cycle of equal windows. Returns a status."""
    n = engine.n_cylinders
    angles = np.empty(n)
    for k in range(n):
        for j in range(n):
            angles[j] = ((k - j) % n) * (720.0 / n) - advance_deg
        event = Event(k, commands[k, 2], commands[k, 0], commands[k, 1])
        status = advance_window(
            engine,
            windows,
            event,
            flow_coefficients,
            angles,
            cylinders,
            manifold,
            trace,
            k * windows.samples,
        )
        if status != OK:
            return status
    return OK
