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
from ._error import LEAST_AIR
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
from ._workspace import (
    COEFFICIENT,
    CORNERS,
    COS,
    FREE_IM,
    FREE_RE,
    PER_MASS,
    POWER,
    SENSITIVITY,
    SIN,
)

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
    work: np.ndarray,  # (n + 1, SCRATCH_COLUMNS), scratch: nothing is allocated here
    forcing: np.ndarray,  # (n + 1, FORCED * LANES), scratch
    breathing: np.ndarray,  # (n,) integers, scratch: the open cylinders, a row of `work` each
) -> int:
    """Advance the plant by one window, in which one cylinder opens. Returns a status."""
    work[:] = 0.0
    forcing[:] = 0.0
    n_breathing = 0
    for j in range(engine.n_cylinders):
        if cylinders[j, PHASE] != SHUT:
            _prepare(
                engine, window, flow_coefficients[j], cylinders, j, work, n_breathing, angles[j]
            )
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
        for i in range(n_breathing):
            end = min(end, _until_cut(window, cylinders, breathing[i], work, i))
        if end > SAME_TIME:
            seen = sample
            if n_breathing == 0 and not engine.exact_orifice:
                sample = fill_segment(engine, window, manifold, now, end, trace, first, sample)
            else:
                status, sample, step = integrate_segment(
                    engine, window, cylinders, manifold, work, forcing, breathing, n_breathing,
                    now, end, step, trace, first, sample,
                )  # fmt: skip
                if status != OK:
                    return status
            for k in range(seen, sample):
                _record_shut(window, cylinders, angles, event.cylinder, opened, trace, first, k)
            now += end
            for i in range(n_breathing):
                cylinders[breathing[i], SINCE] += end
                cylinders[breathing[i], TURNED] += end * window.degree_rate
        kept = 0
        for i in range(n_breathing):
            j = breathing[i]
            # A valve moves in time: a speed that rises carries it past its closing angle.
            angle = angles[j] + now * window.degree_rate
            if angle > LATEST_CLOSING_DEG + 1e-6:
                return OPEN_AT_COMPRESSION_TDC
            while cylinders[j, PHASE] != SHUT:
                if _until_cut(window, cylinders, j, work, i) > SAME_TIME:
                    break
                if cylinders[j, PHASE] >= SEAT:
                    _finish_event(engine, cylinders, j, _volume(engine, work[i, COS]), angle >= 180)
                else:
                    cylinders[j, PHASE] += 1.0
            if cylinders[j, PHASE] != SHUT:
                breathing[kept] = j
                if kept < i:
                    for c in range(work.shape[1]):
                        work[kept, c] = work[i, c]
                kept += 1
        n_breathing = kept
        if not opened and opening_time - now <= SAME_TIME:
            opened = True
            j = event.cylinder
            angle = angles[j] + event.until_opening_deg
            _open(engine, window, event, cylinders, math.cos(math.radians(angle)))
            if cylinders[j, PHASE] != SHUT:
                _prepare(
                    engine, window, flow_coefficients[j], cylinders, j, work, n_breathing, angle
                )
                step = FIRST_STEP_DEG / window.degree_rate
                breathing[n_breathing] = j
                n_breathing += 1
        if window.length - now <= SAME_TIME:
            break
    for i in range(n_breathing):
        _keep_runner(window, cylinders, breathing[i], work, i)
    return OK


@compiled
def _volume(engine: KernelEngine, cosine: float) -> float:
    return engine.clearance_volume + engine.half_stroke_volume * (1.0 - cosine)


@compiled
def _until_cut(window: Window, cylinders: np.ndarray, j: int, work: np.ndarray, i: int) -> float:
    """Time to the end of the present form of the valve's motion, s."""
    if cylinders[j, PHASE] == CAM:
        return (cylinders[j, DURATION] - cylinders[j, TURNED]) / window.degree_rate
    return work[i, CORNERS - 1 + int(cylinders[j, PHASE])] - cylinders[j, SINCE]


@compiled
def _open(
    engine: KernelEngine, window: Window, event: Event, cylinders: np.ndarray, cosine: float
) -> None:
    """Begin an event at IVO: cylinder at exhaust pressure, runner at rest (Eq. 8)."""
    j = event.cylinder
    volume = _volume(engine, cosine)
    for c in range(FLOW + 1):
        cylinders[j, c] = 0.0
    cylinders[j, MASS] = engine.exhaust_pressure * volume / engine.gas
    cylinders[j, MASS_AT_OPENING] = cylinders[j, MASS]
    cylinders[j, LIFT] = event.lift
    if event.lift == 0.0:  # a valve that stays shut: its event is over at once
        _finish_event(engine, cylinders, j, volume, False)
    elif engine.cam:
        cylinders[j, PHASE] = CAM
        cylinders[j, DURATION] = event.duration_deg
    else:
        cylinders[j, PHASE] = RISE
        cylinders[j, DURATION] = event.duration_deg / window.degree_rate


@compiled
def _prepare(
    engine: KernelEngine,
    window: Window,
    flow_coefficient: float,
    cylinders: np.ndarray,
    j: int,
    work: np.ndarray,
    i: int,
    angle_deg: float,
) -> None:
    """Give an open cylinder its row: corners, measure of its errors, crank and runner phasors."""
    if cylinders[j, PHASE] == CAM:
        open_deg = cylinders[j, DURATION]
    else:
        open_deg = cylinders[j, DURATION] * window.degree_rate
        rise_end, turn, dwell_end, seating_start, closing = _profile_corners(
            cylinders[j, LIFT],
            cylinders[j, DURATION],
            engine.opening_slope,
            engine.closing_slope,
            engine.seating_slope,
            engine.seating_duration,
            engine.roundness,
        )
        work[i, CORNERS], work[i, CORNERS + 1], work[i, CORNERS + 2] = rise_end, turn, dwell_end
        work[i, CORNERS + 3], work[i, CORNERS + 4] = seating_start, closing
    work[i, COEFFICIENT] = flow_coefficient
    closing_deg = angle_deg - cylinders[j, TURNED] + open_deg
    # Errors are measured by about what it takes in: the stroke up to closing full of ambient
    # air, or half of what would pass at sonic flow.
    stroke = engine.half_stroke_volume * (1.0 - math.cos(math.radians(closing_deg)))
    sonic = flow_coefficient * cylinders[j, LIFT] * (open_deg / window.degree_rate)
    air = engine.ambient_pressure / engine.gas
    least = LEAST_AIR * air * 2.0 * engine.half_stroke_volume
    work[i, PER_MASS] = 1.0 / max(min(air * stroke, 0.5 * sonic), least)
    work[i, SENSITIVITY] = 0.0
    s, c = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    work[i, SIN], work[i, COS] = s, c
    pressure = cylinders[j, MASS] * engine.gas / _volume(engine, c)
    rate = engine.half_stroke_volume * window.omega * s
    work[i, POWER] = (engine.exhaust_pressure - pressure) * rate
    velocity = cylinders[j, VELOCITY] - window.velocity_sin * s - window.velocity_cos * c
    rate = cylinders[j, ACCELERATION] - window.acceleration_sin * s - window.acceleration_cos * c
    # Free velocity Re(b exp(pole t)); its rate has the phasor pole b.
    b_im = (window.pole_re * velocity - rate) / window.pole_im
    work[i, FREE_RE] = window.pole_re * velocity - window.pole_im * b_im
    work[i, FREE_IM] = window.pole_re * b_im + window.pole_im * velocity


@compiled
def _keep_runner(window: Window, cylinders: np.ndarray, j: int, work: np.ndarray, i: int) -> None:
    """Store the runner's velocity and acceleration, from which another speed goes on."""
    s, c, re, im = work[i, SIN], work[i, COS], work[i, FREE_RE], work[i, FREE_IM]
    square = window.pole_re**2 + window.pole_im**2
    free = (re * window.pole_re + im * window.pole_im) / square
    cylinders[j, VELOCITY] = window.velocity_sin * s + window.velocity_cos * c + free
    cylinders[j, ACCELERATION] = window.acceleration_sin * s + window.acceleration_cos * c + re


@compiled
def _finish_event(
    engine: KernelEngine, cylinders: np.ndarray, j: int, volume: float, past_bottom: bool
) -> None:
    """Close an event at IVC: charge, and loss up to the instant with ``p_c >= p_exh``.

    The shut cylinder keeps its mass, so the rest of the loss integral has a closed form; on
    the way through BDC and back to the same volume it cancels. A mass too small to reach
    exhaust pressure is compressed to TDC.
    """
    mass = cylinders[j, MASS]
    bottom = 2.0 * engine.half_stroke_volume + engine.clearance_volume
    largest = volume if past_bottom else bottom
    end = max(min(mass * engine.gas / engine.exhaust_pressure, largest), engine.clearance_volume)
    compression = mass * engine.gas * math.log(end / volume)
    work = cylinders[j, WORK] + engine.exhaust_pressure * (end - volume) - compression
    cylinders[j, LOSS] = work
    cylinders[j, CHARGE] = mass - cylinders[j, MASS_AT_OPENING]
    cylinders[j, COMPLETED] += 1.0
    cylinders[j, FLOW] = 0.0
    cylinders[j, PHASE] = SHUT


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
def advance_cycles(
    engine: KernelEngine,
    windows: Window,
    commands: np.ndarray,  # (n, 3): delivered lift, duration, crank angle from the start to IVO
    flow_coefficients: np.ndarray,
    advance_deg: float,
    cylinders: np.ndarray,
    manifold: np.ndarray,
    trace: np.ndarray,  # (rows, samples of a whole cycle)
    cycles: int,  # one, if there are samples
    work: np.ndarray,  # scratch, see advance_window
    forcing: np.ndarray,
    breathing: np.ndarray,
    angles: np.ndarray,  # (n,), scratch
) -> int:
    """Advance the plant by cycles of equal windows. Returns a status."""
    n = engine.n_cylinders
    for window in range(cycles * n):
        k = window % n
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
            work,
            forcing,
            breathing,
        )
        if status != OK:
            return status
    return OK
