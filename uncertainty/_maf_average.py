"""Event averages of what an ideal MAF sensor reads, from the crank-resolved throttle flow.

The flow is linear between its samples, and the lag is solved exactly. The reading ``z`` without
its delay obeys ``tau dz/dt = u - z``, so its integral over a window is that of the flow less
``tau`` times the rise of the reading.
"""

from __future__ import annotations

import math

import numpy as np

from plant import MafSensor, PulseResponse, lag
from plant.kinematics import FloatArray


def averaged_pulse(
    flow: FloatArray, inflow: FloatArray, event_time: float, maf: MafSensor
) -> PulseResponse:
    """Event averages of the reading of a flow that begins and ends at zero.

    Parameters
    ----------
    flow : ndarray (events, samples)
        Flow at even times from the start of the first event on, kg/s; zero after the last one.
    inflow : ndarray (events,)
        Air of each event, kg. What the samples miss of it is added in the middle of the event.
    event_time : float
        Length of an event, s.
    maf : MafSensor
        Its lag, delay and gain.

    Returns
    -------
    PulseResponse
        Averages event by event from the first one on, kg/s, with their tail in closed form.
    """
    events, samples = flow.shape
    tau, delay = float(maf.time_constant), float(maf.delay)
    step = event_time / samples
    u = np.append(flow.ravel(), 0.0)
    sampled = 0.5 * step * (u[1:] + u[:-1]).reshape(flow.shape).sum(axis=1)
    hat = 1.0 - np.abs(2.0 * np.arange(samples) / samples - 1.0)  # continuous between events
    if samples > 1:
        share = hat / (step * hat.sum())
        u[:-1] += ((inflow - sampled)[:, None] * share).ravel()
    # Windows up to the first one that begins after the flow has passed.
    windows = events + max(math.ceil(delay / event_time - 1e-9), 0) + 1
    integral = _integral(u, step, event_time * np.arange(windows + 1) - delay, tau, 0.0)
    taps = (1.0 + maf.gain_error) * np.diff(integral) / event_time
    return PulseResponse(event_time, 0, taps, math.exp(-event_time / tau) if tau > 0.0 else 0.0)


def steady_averages(
    flow: FloatArray, inflow: float, event_time: float, maf: MafSensor
) -> FloatArray:
    """Event averages (n,) of the reading of a flow that repeats itself every cycle, kg/s.

    Parameters
    ----------
    flow : ndarray (n, samples)
        Flow at even times of the cycle, kg/s.
    inflow : float
        Air of the cycle, kg; what the samples miss of it is spread evenly.
    event_time : float
        Length of an event, s.
    maf : MafSensor
        Its lag, delay, gain and offset.
    """
    n, samples = flow.shape
    tau, delay = float(maf.time_constant), float(maf.delay)
    step, cycle_time = event_time / samples, n * event_time
    once = flow.ravel() + (inflow / cycle_time - flow.mean())
    cycles = math.ceil(delay / cycle_time) + 1
    u = np.append(np.tile(once, cycles), once[0])
    t: FloatArray = step * np.arange(u.size, dtype=np.float64)
    start = 0.0
    if tau > 0.0:  # the reading at which a cycle ends as it began
        end = lag.at_knots(t[: once.size + 1], u[: once.size + 1], 0.0, tau)[-1]
        start = float(end / -math.expm1(-cycle_time / tau))
    edges = event_time * np.arange(n + 1) - delay + (cycles - 1) * cycle_time
    averages = np.diff(_integral(u, step, edges, tau, start)) / event_time
    return np.asarray((1.0 + maf.gain_error) * averages + maf.offset)


def _integral(
    u: FloatArray, step: float, instants: FloatArray, tau: float, start: float
) -> FloatArray:
    """Integral of the lagging reading of a flow from time 0 to instants; zero before it.

    The flow is given at ``0, step, ...`` and holds its last value.
    """
    t: FloatArray = step * np.arange(u.size, dtype=np.float64)
    area = np.concatenate(([0.0], np.cumsum(0.5 * step * (u[1:] + u[:-1]))))
    inside = np.clip(instants, 0.0, t[-1])
    i = np.minimum((inside / step).astype(int), u.size - 2)
    past = inside - t[i]
    slope = (u[i + 1] - u[i]) / step
    passed = area[i] + past * (u[i] + 0.5 * slope * past) + u[-1] * np.maximum(instants - t[-1], 0)
    if tau == 0.0:
        return np.asarray(passed)
    knots = lag.at_knots(t, u, start, tau)
    reading = lag.between_knots(instants, t, u, knots, tau)  # `start` before the first sample
    return np.asarray(passed - tau * (reading - start))
