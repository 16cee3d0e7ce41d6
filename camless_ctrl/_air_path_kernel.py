"""Compiled air path of the Kalman charge estimator: samples kept, prediction, tangent.

Imported when an estimator is used first, since Numba takes its time to load. States are, in
this order, the charge of the window's event and of the event before (kg), the lagged MAF output
at the window's start (kg/s), the ambient pressure that the MAP sensor sees (Pa), the throttle
ratio (1), lag and delay of the MAF sensor and lag of the MAP sensor (s); the design is explained
in `kalman_estimator`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from plant._implicit import simplified_step
from plant.kinematics import FloatArray

from .event_data import PARTS

STATES = 8
FLOW = 5  # the first of them, on which flow and pressure depend
CHARGE, BEFORE, OUTPUT, AMBIENT, RATIO, LAG, DELAY, SLOW = range(STATES)

# Numbers of an estimator, all in SI
(
    CAPACITY,  # manifold mass per pressure V_m/(R T), kg/Pa
    AREA,  # throttle at sonic flow, kg/s
    MAF_LAG,  # s, where its state begins
    MAF_DELAY,  # s, where its state begins
    MAF_RELATIVE,  # variance as a share of the reading squared, model error included
    MAF_VARIANCE,  # (kg/s)^2, additive noise and quantisation
    MAF_SPAN,  # kg/s, range of the output
    MAP_LAG,  # s, where its state begins
    MAP_VARIANCE,  # Pa^2, noise and quantisation
    MAP_SHARE,  # variance as a share of the pressure drop squared: model error
    PART_SHARE,  # variance as a share of the change in a part squared: model error
    MAP_DELAY,  # s
    CHARGE_SPREAD,  # 1
    AMBIENT_SPREAD,  # Pa
    RATIO_SPREAD,  # 1
    LAG_SPREAD,  # s
    DELAY_SPREAD,  # s
    SLOW_SPREAD,  # s, of the lag of the MAP sensor
    AMBIENT_DRIFT,  # Pa^2/s
    RATIO_DRIFT,  # 1/s
    LAG_DRIFT,  # s^2/s
    DELAY_DRIFT,  # s^2/s
    SLOW_DRIFT,  # s^2/s
    LONGEST_DELAY,  # s
    OUTPUT_DRIFT,  # variance per window as a share of the output squared
    SAMPLE_GATE,  # squared, of the normalised innovation of a sample
    WINDOW_GATE,  # of the normalised innovation of a window, per degree of freedom
    MAF_RATE,  # 1/s, of samples; 0 where they come by crank angle
    MAF_PER_EVENT,  # samples in an event where they come by crank angle, 1
) = range(29)

# What is kept of samples: two counts, two latest times, then times and values of both sensors
HEAD = 4
MOST_SAMPLES = 512  # of a sensor

CARRY = 1 + 2 * STATES  # output at the window's end, its gradient, the states it holds at

_LAGS = 10.0  # time constants in which the start of a trajectory dies out

# Not kept on disk one by one: Numba would not notice a change of what they call. The entries
# of `_estimator_kernel` are, with all that is in them.
inlined = njit(nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})


@inlined
def _share_of_end(rate_time: float) -> float:
    """Weight of the end of a step that makes a linear relaxation exact."""
    if rate_time < 1e-3:
        return 0.5 + rate_time / 12.0
    return 1.0 / -math.expm1(-rate_time) - 1.0 / rate_time


@inlined
def quasi_steady(normalised: float) -> float:
    """Pressure ratio at which the throttle passes a flow relative to sonic flow."""
    q = min(max(normalised, 0.0), 0.999)
    return 0.5 * (1.0 + math.sqrt(1.0 - q * q))


def _adding(n: int, last: int) -> Any:
    """Return the function that adds a sample on which the first `n` states and one more act."""
    # Loops whose length is known when they are compiled are unrolled.

    @inlined
    def add(
        residual: float,
        h: FloatArray,
        lin: FloatArray,
        k: int,
        first: bool,
        P: FloatArray,
        gate: float,
        variance: FloatArray,
        information: FloatArray,
        vector: FloatArray,
        squares: float,
        used: int,
    ) -> tuple[float, int]:
        """Add a sample to the normal equations about the prior, unless it is wild."""
        r, h_last = variance[k], h[last]
        if first:
            spread = r + h_last * h_last * P[last, last]
            for i in range(n):
                cross = 0.5 * h[i] * P[i, i] + h_last * P[last, i]
                for j in range(i):
                    cross += h[j] * P[i, j]
                spread += 2.0 * h[i] * cross
            if not residual * residual <= gate * spread:
                variance[k] = math.inf
                return squares, used
        elif r == math.inf:
            return squares, used
        else:
            residual += h_last * lin[last]
            for i in range(n):
                residual += h[i] * lin[i]
        per = 1.0 / r
        weighted = h_last * per
        vector[last] += weighted * residual
        information[last, last] += weighted * h_last
        for i in range(n):
            information[last, i] += weighted * h[i]
            each = h[i] * per
            vector[i] += each * residual
            for j in range(i + 1):
                information[i, j] += each * h[j]
        return squares + residual * residual * per, used + 1

    return add


_add_flow, _add_pressure = _adding(DELAY, DELAY), _adding(FLOW, SLOW)


@inlined
def trajectory(
    numbers: FloatArray,
    before: float,
    start: float,
    end: float,
    two_before: float,
    shares: FloatArray,
    shares_1: FloatArray,
    shares_2: FloatArray,
    flow: float,
    x: FloatArray,
    prior: FloatArray,
    first: bool,
    P: FloatArray,
    samples: FloatArray,
    n_maf: int,
    n_map: int,
    variance: FloatArray,
    information: FloatArray,
    vector: FloatArray,
    tail: FloatArray,
) -> tuple[float, int]:
    """Run the air path over two windows; add up what the samples of the second one say.

    `variance` holds each sample's, infinite where it is not used; the first pass sets it.
    `information` (lower half) and `vector` are the normal equations about the prior. `tail` is
    the carry. Returns the sum of squared residuals, and the samples used.
    """
    capacity = numbers[CAPACITY]
    ratio_area = x[RATIO] * numbers[AREA]
    full = x[AMBIENT] * capacity
    # How stiff the manifold is about the flow that is expected; fixed, so that the tangent is
    # exact.
    q = min(max(flow / numbers[AREA], 0.005), 0.99)
    rate = 2.0 * numbers[AREA] * math.sqrt(1.0 - q * q) / (q * 1e5 * capacity)

    information[:] = 0.0
    vector[:] = 0.0
    # Tangents: manifold mass, normalised flow, step's known mass, throttle flow and its rise,
    # pressure, lagged pressure, MAF output
    work = np.zeros((8, FLOW))
    y_x, h, h_p = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    mass_x, d_x, base_x, flux_x, rise_x = work[0], work[1], work[2], work[3], work[4]
    p_x, p_end_x, z_x = work[5], work[6], work[7]
    lin = x - prior

    d = min(max(two_before / (start - before) / ratio_area, 0.0), 0.999)
    mass = quasi_steady(d) * full
    d_x[RATIO] = -d / x[RATIO]
    mass_x[RATIO] = full * 0.5 * d * d / (math.sqrt(1.0 - d * d) * x[RATIO])
    mass_x[AMBIENT] = mass / x[AMBIENT]
    z = p = mass / capacity
    for i in range(FLOW):
        z_x[i] = mass_x[i] / capacity
        p_x[i] = z_x[i]
    y, y_x[OUTPUT] = x[OUTPUT], 1.0

    maf_lag, map_lag = x[LAG], x[SLOW]
    z_slow = 0.0  # change of the lagged pressure with the lag of the MAP sensor
    # The first window is long enough when what is assumed at its start has died out.
    memory = _LAGS * max(map_lag, 1.0 / rate)
    skip = PARTS - min(math.ceil(memory * PARTS / (start - before)), PARTS)
    a, b = 0, 0
    used = 0
    squares = 0.0
    # Inflow of a part for each kg of its event and of the event before, and of the parts beside
    of_now, of_last, rest = 0.0, shares_1[skip], two_before * shares_2[PARTS + skip]
    now_1, last_1, rest_1 = of_now, of_last, rest
    for part in range(skip, 2 * PARTS):
        watched = part >= PARTS
        k = part - PARTS
        length = ((end - start) if watched else (start - before)) / PARTS
        if part == skip or k == 0:
            weight = _share_of_end(length * rate)
            area = weight * length * ratio_area
            maf_decay = math.exp(-length / maf_lag) if maf_lag > 0.0 else 0.0
            map_decay = math.exp(-length / map_lag) if map_lag > 0.0 else 0.0
        # of the next part; the event that follows the window begins as that of the window
        now_2, last_2, rest_2 = 0.0, 0.0, 0.0
        if part < PARTS - 1:
            last_2, rest_2 = shares_1[part + 1], two_before * shares_2[PARTS + part + 1]
        elif k < PARTS - 1:
            now_2, last_2 = shares[k + 1], shares_1[PARTS + k + 1]
        else:
            now_2 = shares[PARTS] + shares[0]
        # The inflow is linear in the part, its ends the means of neighbouring parts.
        early, late = 0.5 * (1.0 - weight), 0.5 * weight
        now = 0.5 * of_now + early * now_1 + late * now_2
        last = 0.5 * of_last + early * last_1 + late * last_2
        inflow = x[CHARGE] * now + x[BEFORE] * last + 0.5 * rest + early * rest_1 + late * rest_2
        # Manifold balance: mass_end = base + area d(mass_end/full)
        early = (1.0 - weight) * length
        for i in range(FLOW):
            base_x[i] = mass_x[i] + early * ratio_area * d_x[i]
        base_x[RATIO] += early * numbers[AREA] * d
        base_x[CHARGE] -= now
        base_x[BEFORE] -= last
        base = mass - inflow + early * ratio_area * d
        d_end, by_full = simplified_step(base, area, full)
        mass_end = base + area * d_end
        by_base = 1.0 if by_full == 0.0 else 1.0 - by_full * full / mass_end
        p_end = mass_end / capacity
        # What passes the throttle makes up for exactly what flows in.
        flux = (mass_end - mass + x[CHARGE] * of_now + x[BEFORE] * of_last + rest) / length
        rise = ratio_area * (d_end - d)
        for i in range(FLOW):
            change = by_base * base_x[i]
            if i == AMBIENT:
                change += by_full * capacity
            elif i == RATIO:
                change += by_base * d_end * weight * length * numbers[AREA]
            d_change = (change - base_x[i]) / area
            if i == RATIO:
                d_change -= d_end / x[RATIO]
            rise_x[i] = ratio_area * (d_change - d_x[i])
            flux_x[i] = (change - mass_x[i]) / length
            p_end_x[i] = change / capacity
            d_x[i] = d_change
            mass_x[i] = change
        rise_x[RATIO] += numbers[AREA] * (d_end - d)
        flux_x[CHARGE] += of_now / length
        flux_x[BEFORE] += of_last / length
        mass, d = mass_end, d_end

        if watched:
            until = (k + 1) * length
            if k == PARTS - 1:
                until = math.inf  # no sample is left out by rounding, or by another delay
            while a < n_maf:
                since = samples[a] - x[DELAY] - start
                if since >= until:
                    break
                since -= k * length
                e = math.exp(-since / maf_lag) if maf_lag > 0.0 else 0.0
                c = (since - maf_lag * (1.0 - e)) / length - 0.5 * (1.0 - e)
                value = flux + (y - flux) * e + rise * c
                for i in range(FLOW):
                    h[i] = flux_x[i] + (y_x[i] - flux_x[i]) * e + rise_x[i] * c
                if maf_lag > 0.0:
                    by_lag = e * since / (maf_lag * maf_lag)
                    c = by_lag * (maf_lag / length + 0.5) - (1.0 - e) / length
                    h[LAG] = y_x[LAG] * e + (y - flux) * by_lag + rise * c
                    h[DELAY] = (value - flux - rise * (since / length - 0.5)) / maf_lag
                if first:
                    variance[a] = (
                        numbers[MAF_VARIANCE]
                        + numbers[MAF_RELATIVE] * value * value
                        + numbers[PART_SHARE] * rise * rise * (1.0 - maf_decay) ** 2
                    )
                squares, used = _add_flow(
                    samples[MOST_SAMPLES + a] - value, h, lin, a, first, P,
                    numbers[SAMPLE_GATE], variance, information, vector, squares, used,
                )  # fmt: skip
                a += 1
            while b < n_map:
                since = samples[2 * MOST_SAMPLES + b] - numbers[MAP_DELAY] - start
                if since >= until:
                    break
                since -= k * length
                e = math.exp(-since / map_lag) if map_lag > 0.0 else 0.0
                c = (since - map_lag * (1.0 - e)) / length
                value = p + (z - p) * e + (p_end - p) * c
                for i in range(FLOW):
                    h_p[i] = p_x[i] + (z_x[i] - p_x[i]) * e + (p_end_x[i] - p_x[i]) * c
                if map_lag > 0.0:
                    by_lag = e * since / (map_lag * map_lag)
                    c = (by_lag * map_lag - (1.0 - e)) / length
                    h_p[SLOW] = z_slow * e + (z - p) * by_lag + (p_end - p) * c
                if first:
                    drop = x[AMBIENT] - value
                    variance[MOST_SAMPLES + b] = (
                        numbers[MAP_VARIANCE]
                        + numbers[MAP_SHARE] * drop * drop
                        + numbers[PART_SHARE] * (p_end - p) * (p_end - p)
                    )
                squares, used = _add_pressure(
                    samples[3 * MOST_SAMPLES + b] - value, h_p, lin, MOST_SAMPLES + b, first, P,
                    numbers[SAMPLE_GATE], variance, information, vector, squares, used,
                )  # fmt: skip
                b += 1
            c = 1.0 - maf_lag * (1.0 - maf_decay) / length - 0.5 * (1.0 - maf_decay)
            if maf_lag > 0.0:
                by_lag = maf_decay * length / (maf_lag * maf_lag)
                y_x[LAG] = (
                    y_x[LAG] * maf_decay
                    + (y - flux) * by_lag
                    + rise * (by_lag * (maf_lag / length + 0.5) - (1.0 - maf_decay) / length)
                )
            y = flux + (y - flux) * maf_decay + rise * c
            for i in range(FLOW):
                y_x[i] = flux_x[i] + (y_x[i] - flux_x[i]) * maf_decay + rise_x[i] * c
        c = 1.0 - map_lag * (1.0 - map_decay) / length
        if map_lag > 0.0:
            by_lag = map_decay * length / (map_lag * map_lag)
            z_slow = z_slow * map_decay + (z - p) * by_lag
            z_slow += (p_end - p) * (by_lag * map_lag - (1.0 - map_decay)) / length
        z = p + (z - p) * map_decay + (p_end - p) * c
        for i in range(FLOW):
            z_x[i] = p_x[i] + (z_x[i] - p_x[i]) * map_decay + (p_end_x[i] - p_x[i]) * c
            p_x[i] = p_end_x[i]
        p = p_end
        now_1, last_1, rest_1 = of_now, of_last, rest
        of_now, of_last, rest = now_2, last_2, rest_2
        if k == -1:  # the events move on by one
            of_now, of_last, rest = shares[0], shares_1[PARTS], 0.0
    tail[0], tail[1 : 1 + STATES], tail[1 + STATES :] = y, y_x, x
    return squares, used
