"""Intake runner as a Helmholtz resonator, Eq. 5 to 8 of Part I.

At constant speed Eq. 7 is linear with sinusoidal forcing, so its solution is written down
rather than integrated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .kinematics import FloatArray, radians_per_second
from .parameters import Engine


def runner_gain(engine: Engine) -> float:
    """Return ``c`` in ``p_r = p_m (1 - c dv/dt)``, s2/m (Eq. 5 and 6, ``m_r = p_m V_r/(R T)``)."""
    return (
        engine.runner_volume
        * engine.runner_constant
        / (engine.gas_constant * engine.temperature * engine.runner_area)
    )


def forcing_amplitude(engine: Engine, speed_rpm: float) -> float:
    """Amplitude of the quasi-static port velocity in m/s (right side of Eq. 7 over ``A_r``)."""
    return float(radians_per_second(speed_rpm)) * forcing_length(engine)


def forcing_length(engine: Engine) -> float:
    """Amplitude of that velocity over crank speed in rad/s, m."""
    return 0.25 * np.pi * engine.bore**2 / engine.runner_area * (0.5 * engine.stroke)


def runner_velocity(
    time: ArrayLike, engine: Engine, speed_rpm: float, opening_deg: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Port velocity and its rate of change since IVO, the solution of Eq. 7 with Eq. 8.

    Parameters
    ----------
    time : array_like
        Time since IVO in s.
    engine : Engine
        Engine.
    speed_rpm : float
        Constant speed.
    opening_deg : float
        Crank angle of IVO after TDC.

    Returns
    -------
    velocity, acceleration : ndarray
        In m/s and m/s2, of the shape of `time`.
    """
    t = np.asarray(time, dtype=float)
    omega = float(radians_per_second(speed_rpm))
    w_h = engine.helmholtz.natural_frequency(speed_rpm)
    xi = engine.helmholtz.damping_ratio(speed_rpm)
    # Forcing Im(F exp(i (omega t + theta_0))); steady response through the transfer function.
    response = 1.0 / complex(1.0 - (omega / w_h) ** 2, 2.0 * xi * omega / w_h)
    forced = forcing_amplitude(engine, speed_rpm) * response * np.exp(1j * np.deg2rad(opening_deg))
    pole = w_h * complex(-xi, np.sqrt(1.0 - xi**2))
    # The free part Re(b exp(pole t)) cancels value and slope of the steady response at IVO.
    value, slope = -forced.imag, -(1j * omega * forced).imag
    free = complex(value, (pole.real * value - slope) / pole.imag)
    steady = forced * np.exp(1j * omega * t)
    transient = free * np.exp(pole * t)
    velocity = steady.imag + transient.real
    acceleration = (1j * omega * steady).imag + (pole * transient).real
    return velocity, acceleration


def runner_pressure(
    manifold_pressure: ArrayLike, acceleration: ArrayLike, engine: Engine
) -> FloatArray:
    """Port pressure in Pa from the manifold pressure and the port acceleration (Eq. 5 and 6)."""
    p_m = np.asarray(manifold_pressure, dtype=float)
    return p_m * (1.0 - runner_gain(engine) * np.asarray(acceleration, dtype=float))
