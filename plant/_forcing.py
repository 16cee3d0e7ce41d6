"""Compiled forcing of the cylinders: crank angle, runner and lift as turning phasors.

All forcing is a sum of exponentials in time, so it turns from the start of a step to its nodes
by a multiplication. It is known before a step is solved, so all nodes are done at once: the
loops over the columns of a table become vector instructions.
"""

from __future__ import annotations

import math

import numpy as np

from ._compile import compiled
from ._layout import (
    APPROACH,
    CAM,
    DURATION,
    FALL,
    PHASE,
    RETREAT,
    RISE,
    SINCE,
    TURNED,
    KernelEngine,
    Window,
)
from ._layout import LIFT as MAXIMUM_LIFT
from ._method import GAMMA, NODES
from ._workspace import (
    AREA,
    CAPACITY,
    COEFFICIENT,
    CONSTANT,
    CORNERS,
    COS,
    EXPONENTIAL,
    FOLD_STEP,
    FOLDS_FROM,
    FOLDS_UNTIL,
    FORCED,
    FREE_IM,
    FREE_RE,
    LANES,
    LIFT,
    OPEN,
    PRESSURE_PER_MASS,
    RATE,
    SCALE,
    SIN,
    SLOPE,
    SWING_IM,
    SWING_RE,
    SWINGS_UNTIL,
    TURN_COS,
    TURN_FREE_IM,
    TURN_FREE_RE,
    TURN_SIN,
    TURN_SWING_IM,
    TURN_SWING_RE,
    VOLUME_RATE,
)

# A step may not leap over forcing that its nodes do not see: e-folds of the lift's exponential
# and radians of its oscillation while they are a share of the lift, radians of the runner.
LONGEST_FOLD = 1.5
LONGEST_SWING = 0.5
LONGEST_RING = 1.0
FOLD_SHARE = 1e-3
SWING_SHARE = 1e-2
MANY_FOLDS = -math.log(FOLD_SHARE)
# Up to these, the series below hold.
LARGEST_ANGLE = 2.0
LARGEST_EXPONENT = 8.0


@compiled
def sine_and_cosine(angle: float) -> tuple[float, float]:
    """Sine and cosine up to two radians, to 1e-9 and without a branch."""
    half = 0.5 * angle
    q = half * half
    s = 1.0 - q * (1.0 / 110.0)
    s = 1.0 - q * (1.0 / 72.0) * s
    s = 1.0 - q * (1.0 / 42.0) * s
    s = 1.0 - q * (1.0 / 20.0) * s
    s = half * (1.0 - q * (1.0 / 6.0) * s)
    c = 1.0 - q * (1.0 / 132.0)
    c = 1.0 - q * (1.0 / 90.0) * c
    c = 1.0 - q * (1.0 / 56.0) * c
    c = 1.0 - q * (1.0 / 30.0) * c
    c = 1.0 - q * (1.0 / 12.0) * c
    c = 1.0 - q * 0.5 * c
    return 2.0 * s * c, 1.0 - 2.0 * s * s


@compiled
def exponential(exponent: float) -> float:
    """Exponential up to exponents of eight, to 1e-7 and without a branch."""
    x = exponent * (1.0 / 16.0)
    y = 1.0 + x * (1.0 / 8.0)
    y = 1.0 + x * (1.0 / 7.0) * y
    y = 1.0 + x * (1.0 / 6.0) * y
    y = 1.0 + x * (1.0 / 5.0) * y
    y = 1.0 + x * (1.0 / 4.0) * y
    y = 1.0 + x * (1.0 / 3.0) * y
    y = 1.0 + x * (1.0 / 2.0) * y
    y = 1.0 + x * y
    y *= y
    y *= y
    y *= y
    return y * y


@compiled
def start_lift(
    engine: KernelEngine, work: np.ndarray, i: int, cylinders: np.ndarray, j: int
) -> None:
    """Write a cylinder's lift over the segment as constant + slope + exponential + phasor."""
    phase = int(cylinders[j, PHASE])
    t = cylinders[j, SINCE]
    lift = cylinders[j, MAXIMUM_LIFT]
    constant, slope, size, rate = 0.0, 0.0, 0.0, 0.0
    swing_re, swing_im, scale = 0.0, 0.0, 0.0
    folds_from, folds_until, swings_until = math.inf, -math.inf, -math.inf
    soft = engine.roundness * lift
    if phase == CAM:
        # u_l sin^2(a) = u_l/2 - u_l/2 cos(2 a)
        turned = 2.0 * math.pi / cylinders[j, DURATION] * cylinders[j, TURNED]
        swing_re, swing_im = math.cos(turned), math.sin(turned)
        constant, scale = 0.5 * lift, -0.5 * lift
        swings_until = math.inf
    elif phase == RISE:
        constant, slope = engine.opening_slope * t, engine.opening_slope
    elif phase == APPROACH:
        constant, rate = lift, -engine.opening_slope / soft
        since = t - work[i, CORNERS + RISE - 1]
        size = -soft * math.exp(rate * since)
        folds_from, folds_until = -math.inf, -MANY_FOLDS / rate - since
    elif phase == RETREAT:
        constant, rate = lift, engine.closing_slope / soft
        remaining = work[i, CORNERS + RETREAT - 1] - t
        size = -soft * math.exp(-rate * remaining)
        folds_from, folds_until = remaining - MANY_FOLDS / rate, math.inf
    elif phase == FALL:
        ramp = (1.0 - engine.roundness) * lift
        slope = -engine.closing_slope
        constant = ramp + slope * (t - work[i, CORNERS + RETREAT - 1])
    else:
        slope = -engine.seating_slope
        constant = slope * (t - cylinders[j, DURATION])
    if APPROACH <= phase < CAM and engine.oscillation_amplitude > 0.0:
        since = t - work[i, CORNERS + RISE - 1]
        swing = math.exp(-engine.oscillation_decay * since)
        turned = engine.oscillation_frequency * since
        swing_re, swing_im = swing * math.cos(turned), swing * math.sin(turned)
        scale = engine.oscillation_amplitude * lift
        decades = math.log(engine.oscillation_amplitude / SWING_SHARE)
        if engine.oscillation_decay > 0.0:
            swings_until = decades / engine.oscillation_decay - since
        else:
            swings_until = math.inf
    work[i, CONSTANT], work[i, SLOPE], work[i, EXPONENTIAL] = constant, slope, size
    work[i, RATE] = rate
    work[i, SWING_RE], work[i, SWING_IM], work[i, SCALE] = swing_re, swing_im, scale
    work[i, FOLDS_FROM], work[i, FOLDS_UNTIL] = folds_from, folds_until
    work[i, FOLD_STEP] = LONGEST_FOLD / abs(rate) if rate != 0.0 else math.inf
    work[i, SWINGS_UNTIL] = swings_until
    work[i, OPEN] = 1.0 if phase <= FALL else 0.0


@compiled
def longest_step(work: np.ndarray, n_breathing: int, tau: float, swing_step: float) -> float:
    """Longest step from `tau` whose nodes see the lifts' exponentials and oscillations."""
    longest = math.inf
    for i in range(n_breathing):
        if tau < work[i, FOLDS_UNTIL]:
            wait = max(work[i, FOLDS_FROM] - tau, 0.0)
            longest = min(longest, wait + work[i, FOLD_STEP])
        if tau < work[i, SWINGS_UNTIL]:
            longest = min(longest, swing_step)
    return longest


@compiled
def turn_over(
    engine: KernelEngine,
    window: Window,
    swing_rate: float,
    swing_decay: float,
    h: float,
    turns: np.ndarray,
) -> None:
    """Write the factors by which the phasors turn from the start of a step to its nodes."""
    omega, pole_re, pole_im = window.omega, window.pole_re, window.pole_im
    lanes = turns.shape[0] // FORCED
    for k in range(lanes):
        turns[LANES * TURN_SIN + k], turns[LANES * TURN_COS + k] = sine_and_cosine(
            omega * (NODES[k] * h)
        )
    if engine.runner_gain > 0.0:
        for k in range(lanes):
            size = exponential(pole_re * (NODES[k] * h))
            s, c = sine_and_cosine(pole_im * (NODES[k] * h))
            turns[LANES * TURN_FREE_RE + k], turns[LANES * TURN_FREE_IM + k] = size * c, size * s
    if 0.0 < swing_rate * h <= LARGEST_ANGLE and swing_decay * h <= LARGEST_EXPONENT:
        for k in range(lanes):
            size = exponential(-swing_decay * (NODES[k] * h))
            s, c = sine_and_cosine(swing_rate * (NODES[k] * h))
            turns[LANES * TURN_SWING_RE + k], turns[LANES * TURN_SWING_IM + k] = size * c, size * s
    elif swing_rate > 0.0:
        for k in range(lanes):
            size = math.exp(-swing_decay * (NODES[k] * h))
            turned = swing_rate * (NODES[k] * h)
            turns[LANES * TURN_SWING_RE + k] = size * math.cos(turned)
            turns[LANES * TURN_SWING_IM + k] = size * math.sin(turned)


@compiled
def force(
    engine: KernelEngine,
    window: Window,
    work: np.ndarray,
    i: int,
    tau: float,
    h: float,
    swings: bool,
    turns: np.ndarray,
    here: np.ndarray,
) -> None:
    """Write the forcing of a breathing cylinder at the nodes of a step that starts at `tau`."""
    lanes = here.shape[0] // FORCED
    size, rate = work[i, EXPONENTIAL], work[i, RATE] * h
    constant, slope = work[i, CONSTANT] + work[i, SLOPE] * tau, work[i, SLOPE] * h
    for k in range(lanes):
        here[LANES * LIFT + k] = constant + slope * NODES[k]
    if rate != 0.0:
        if abs(rate) <= LARGEST_EXPONENT:
            for k in range(lanes):
                here[LANES * EXPONENTIAL + k] = size * exponential(rate * NODES[k])
        else:
            for k in range(lanes):
                here[LANES * EXPONENTIAL + k] = size * math.exp(rate * NODES[k])
        for k in range(lanes):
            here[LANES * LIFT + k] += here[LANES * EXPONENTIAL + k]
    if swings:
        re_0, im_0 = work[i, SWING_RE], work[i, SWING_IM]
        scale_re = work[i, SCALE] if engine.cam else 0.0
        scale_im = 0.0 if engine.cam else work[i, SCALE]
        for k in range(lanes):
            re = re_0 * turns[LANES * TURN_SWING_RE + k] - im_0 * turns[LANES * TURN_SWING_IM + k]
            im = re_0 * turns[LANES * TURN_SWING_IM + k] + im_0 * turns[LANES * TURN_SWING_RE + k]
            here[LANES * SWING_RE + k], here[LANES * SWING_IM + k] = re, im
            here[LANES * LIFT + k] += scale_re * re + scale_im * im
    s_0, c_0 = work[i, SIN], work[i, COS]
    re_0, im_0 = work[i, FREE_RE], work[i, FREE_IM]
    gain = engine.runner_gain
    gain_sin, gain_cos = gain * window.acceleration_sin, gain * window.acceleration_cos
    area_step = GAMMA * h * work[i, COEFFICIENT]
    half, gas = engine.half_stroke_volume, engine.gas
    mean_volume = engine.clearance_volume + half
    per_gas, volume_rate = 1.0 / gas, half * window.omega
    for k in range(lanes):
        s = s_0 * turns[LANES * TURN_COS + k] + c_0 * turns[LANES * TURN_SIN + k]
        c = c_0 * turns[LANES * TURN_COS + k] - s_0 * turns[LANES * TURN_SIN + k]
        re = re_0 * turns[LANES * TURN_FREE_RE + k] - im_0 * turns[LANES * TURN_FREE_IM + k]
        here[LANES * FREE_IM + k] = (
            re_0 * turns[LANES * TURN_FREE_IM + k] + im_0 * turns[LANES * TURN_FREE_RE + k]
        )
        here[LANES * SIN + k], here[LANES * COS + k], here[LANES * FREE_RE + k] = s, c, re
        runner = 1.0 - gain * re - gain_sin * s - gain_cos * c  # Eq. 5 and 6
        volume = mean_volume - half * c
        # The oscillation of Appendix B would take the valve beyond its seat: there it rests.
        here[LANES * AREA + k] = area_step * max(here[LANES * LIFT + k], 0.0)
        here[LANES * CAPACITY + k] = runner * volume * per_gas
        here[LANES * PRESSURE_PER_MASS + k] = gas / volume
        here[LANES * VOLUME_RATE + k] = volume_rate * s


@compiled
def forcing_at(
    engine: KernelEngine,
    window: Window,
    work: np.ndarray,
    i: int,
    swing_rate: float,
    swing_decay: float,
    tau: float,
    time: float,
) -> tuple[float, float]:
    """Lift in mm and ``p_r/p_m`` at any `time` after the start of a step."""
    turned = window.omega * time
    s = work[i, SIN] * math.cos(turned) + work[i, COS] * math.sin(turned)
    c = work[i, COS] * math.cos(turned) - work[i, SIN] * math.sin(turned)
    turned = window.pole_im * time
    free = work[i, FREE_RE] * math.cos(turned) - work[i, FREE_IM] * math.sin(turned)
    free *= math.exp(window.pole_re * time)
    forced = window.acceleration_sin * s + window.acceleration_cos * c
    lift = work[i, CONSTANT] + work[i, SLOPE] * (tau + time)
    if work[i, RATE] != 0.0:
        lift += work[i, EXPONENTIAL] * math.exp(work[i, RATE] * time)
    turned = swing_rate * time
    if engine.cam:
        swing = work[i, SWING_RE] * math.cos(turned) - work[i, SWING_IM] * math.sin(turned)
    else:
        swing = work[i, SWING_RE] * math.sin(turned) + work[i, SWING_IM] * math.cos(turned)
    lift += work[i, SCALE] * swing * math.exp(-swing_decay * time)
    return max(lift, 0.0), 1.0 - engine.runner_gain * (forced + free)
