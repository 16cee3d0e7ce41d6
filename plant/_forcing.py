"""Compiled forcing of the cylinders: crank angle, runner and lift as turning phasors.

All forcing is a sum of exponentials in time, so it turns from stage to stage by a
multiplication. One row of the workspace holds a cylinder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ._compile import compiled
from ._layout import (
    APPROACH,
    CAM,
    DURATION,
    FALL,
    LIFT,
    PHASE,
    RETREAT,
    RISE,
    SINCE,
    TURNED,
    KernelEngine,
    Window,
)
from ._workspace import (
    CONSTANT,
    COS,
    EXPONENTIAL,
    FREE_IM,
    FREE_RE,
    GROWTH_1,
    GROWTH_2,
    GROWTH_3,
    RATE,
    SCALE,
    SIN,
    SLOPE,
    SWING_IM,
    SWING_RE,
)

# A step may not leap over forcing that its nodes do not see: e-folds of the lift's exponential
# and radians of its oscillation while they are a share of the lift, radians of the runner.
LONGEST_FOLD = 1.5
LONGEST_SWING = 0.5
LONGEST_RING = 1.0
SEEN_SHARE = 1e-3


class Turn(NamedTuple):
    """Factors by which the phasors turn over one stage."""

    crank_sin: float
    crank_cos: float
    free_re: float
    free_im: float
    swing_re: float
    swing_im: float


@compiled
def turn_over(window: Window, swing_rate: float, swing_decay: float, time: float) -> Turn:
    free = math.exp(window.pole_re * time)
    swing = math.exp(-swing_decay * time)
    return Turn(
        math.sin(window.omega * time),
        math.cos(window.omega * time),
        free * math.cos(window.pole_im * time),
        free * math.sin(window.pole_im * time),
        swing * math.cos(swing_rate * time),
        swing * math.sin(swing_rate * time),
    )


@compiled
def start_lift(
    engine: KernelEngine, work: np.ndarray, j: int, cylinders: np.ndarray, corners: np.ndarray
) -> None:
    """Write a cylinder's lift over the segment as constant + slope + exponential + phasor."""
    phase = int(cylinders[j, PHASE])
    t = cylinders[j, SINCE]
    lift = cylinders[j, LIFT]
    constant, slope, exponential, rate = 0.0, 0.0, 0.0, 0.0
    swing_re, swing_im, scale = 0.0, 0.0, 0.0
    soft = engine.roundness * lift
    if phase == CAM:
        # u_l sin^2(a) = u_l/2 - u_l/2 cos(2 a)
        turned = 2.0 * math.pi / cylinders[j, DURATION] * cylinders[j, TURNED]
        swing_re, swing_im = math.cos(turned), math.sin(turned)
        constant, scale = 0.5 * lift, -0.5 * lift
    elif phase == RISE:
        constant, slope = engine.opening_slope * t, engine.opening_slope
    elif phase == APPROACH:
        constant, rate = lift, -engine.opening_slope / soft
        exponential = -soft * math.exp(rate * (t - corners[j, RISE - 1]))
    elif phase == RETREAT:
        constant, rate = lift, engine.closing_slope / soft
        exponential = -soft * math.exp(-rate * (corners[j, RETREAT - 1] - t))
    elif phase == FALL:
        ramp = (1.0 - engine.roundness) * lift
        slope = -engine.closing_slope
        constant = ramp + slope * (t - corners[j, RETREAT - 1])
    else:
        slope = -engine.seating_slope
        constant = slope * (t - cylinders[j, DURATION])
    if APPROACH <= phase < CAM and engine.oscillation_amplitude > 0.0:
        since = t - corners[j, RISE - 1]
        size = math.exp(-engine.oscillation_decay * since)
        turned = engine.oscillation_frequency * since
        swing_re, swing_im = size * math.cos(turned), size * math.sin(turned)
        scale = engine.oscillation_amplitude * lift
    work[j, CONSTANT], work[j, SLOPE], work[j, EXPONENTIAL] = constant, slope, exponential
    work[j, RATE] = rate
    work[j, SWING_RE], work[j, SWING_IM], work[j, SCALE] = swing_re, swing_im, scale


@compiled
def lift_at(engine: KernelEngine, work: np.ndarray, j: int, tau: float) -> float:
    """Lift in mm where the phasors stand, `tau` after the segment's start.

    Below zero where the oscillation of Appendix B would take the valve beyond its seat, on
    which it then rests.
    """
    swing = work[j, SWING_RE] if engine.cam else work[j, SWING_IM]
    lift = work[j, CONSTANT] + work[j, SLOPE] * tau + work[j, EXPONENTIAL]
    return lift + work[j, SCALE] * swing


@compiled
def runner_at(engine: KernelEngine, window: Window, work: np.ndarray, j: int) -> float:
    """``p_r/p_m`` where the phasors stand (Eq. 5 and 6)."""
    return 1.0 - engine.runner_gain * (
        window.acceleration_sin * work[j, SIN]
        + window.acceleration_cos * work[j, COS]
        + work[j, FREE_RE]
    )


@compiled
def turn_forcing(work: np.ndarray, j: int, turn: Turn, growth: float) -> None:
    s, c = work[j, SIN], work[j, COS]
    work[j, SIN] = s * turn.crank_cos + c * turn.crank_sin
    work[j, COS] = c * turn.crank_cos - s * turn.crank_sin
    re, im = work[j, FREE_RE], work[j, FREE_IM]
    work[j, FREE_RE] = re * turn.free_re - im * turn.free_im
    work[j, FREE_IM] = re * turn.free_im + im * turn.free_re
    re, im = work[j, SWING_RE], work[j, SWING_IM]
    work[j, SWING_RE] = re * turn.swing_re - im * turn.swing_im
    work[j, SWING_IM] = re * turn.swing_im + im * turn.swing_re
    work[j, EXPONENTIAL] *= growth


@compiled
def forcing_is_seen(
    work: np.ndarray, breathing: np.ndarray, n_breathing: int, h: float, swing_rate: float
) -> bool:
    """Whether a step is short enough for the lifts' exponentials and oscillations."""
    for i in range(n_breathing):
        j = breathing[i]
        share = SEEN_SHARE * work[j, CONSTANT]
        rate = work[j, RATE]
        if abs(rate) * h > LONGEST_FOLD:
            largest = -work[j, EXPONENTIAL]
            if rate > 0.0:
                largest *= work[j, GROWTH_1] * work[j, GROWTH_2] * work[j, GROWTH_3]
            if largest > share:
                return False
        if swing_rate * h > LONGEST_SWING and work[j, SCALE] != 0.0:
            size = abs(work[j, SWING_RE]) + abs(work[j, SWING_IM])
            if abs(work[j, SCALE]) * size > 10.0 * share:
                return False
    return True
