"""Closed-form implicit steps of ``dM/dt = A d(p_down, p_up)``, compiled.

With ``x = M/K`` (``K`` the mass at which the downstream pressure equals the upstream one),
one implicit step reads ``x = m + b D(x)``, with ``m`` the known part and ``b >= 0`` the
effective area times the step, both over ``K``. ``D`` is 1 when choked, positive below
``x = 1`` and negative above: the left side minus the right one is monotone in ``x``, so the
root is unique. Each function returns the root and ``dM/dK`` at constant known mass and area,
which the manifold needs to see how its pressure moves the cylinders.
"""

from __future__ import annotations

import math

from ._compile import compiled

# Eq. 11 at gamma = 1.4
_GAMMA = 1.4
_CRITICAL_RATIO = (2.0 / (_GAMMA + 1.0)) ** (_GAMMA / (_GAMMA - 1.0))
_SONIC = math.sqrt(_GAMMA) * (2.0 / (_GAMMA + 1.0)) ** ((_GAMMA + 1.0) / (2.0 * (_GAMMA - 1.0)))
_EXACT_SCALE = math.sqrt(2.0 * _GAMMA / (_GAMMA - 1.0)) / _SONIC


@compiled
def simplified_step(m: float, b: float) -> tuple[float, float]:
    """Solve ``x = m + b d(x)`` with Eq. 13-14, where ``b`` varies as ``1/K``."""
    if b == 0.0:
        return m, 0.0
    if m <= 1.0:
        if m + b <= 0.5:
            return m + b, 0.0
        # (x - m)^2 = 4 b^2 x (1 - x): the larger root, as x = m + 2 b f with f = D/2 written
        # so that nothing cancels, however small b or 1 - m
        root = math.sqrt(b * b + m * (1.0 - m))
        tilt = b * (2.0 * m - 1.0)
        f = m * (1.0 - m) / (root + tilt) if tilt > 0.0 else (root - tilt) / (1.0 + 4.0 * b * b)
        x = m + 2.0 * b * f
        stiffness = b * (2.0 * x - 1.0)
        return x, x * stiffness / (stiffness + f)
    if m - b >= 2.0:
        return m - b, 0.0
    # Backward: with u^2 = x - 1, (m - 1 - u^2)(1 + u^2) = 2 b u. Newton from the root of the
    # quadratic that remains without u^4, kept inside its bracket.
    c = m - 1.0
    low, high = 0.0, min(math.sqrt(c), 1.0)
    u = c / (b + math.sqrt(max(b * b + (1.0 - c) * c, 0.0)))
    u = min(u, high)
    for _ in range(60):
        u2 = u * u
        residual = (c - u2) * (1.0 + u2) - 2.0 * b * u
        if residual > 0.0:
            low = u
        else:
            high = u
        slope = 2.0 * u * (c - 1.0 - 2.0 * u2) - 2.0 * b
        following = u - residual / slope
        if not low <= following <= high:
            following = 0.5 * (low + high)
        change = following - u
        u = following
        if abs(change) <= 1e-14:
            break
    x = 1.0 + u * u
    stiffness = b * (2.0 - x)
    return x, x * stiffness / (stiffness + u * x * x)


@compiled
def _exact_function(y: float) -> tuple[float, float]:
    """``Psi_o(y)/Psi_o(sonic)`` of Eq. 11 and its derivative, for ``0 <= y < 1``."""
    if y <= _CRITICAL_RATIO:
        return 1.0, 0.0
    low = y ** (1.0 / _GAMMA)
    room = 1.0 - y / low  # 1 - y^((gamma-1)/gamma)
    root = math.sqrt(room)
    value = _EXACT_SCALE * low * root
    slope = _EXACT_SCALE * low / (_GAMMA * y) * (root - 0.5 * (_GAMMA - 1.0) * (1.0 - room) / root)
    return value, slope


@compiled
def exact_step(m: float, b: float) -> tuple[float, float]:
    """Solve ``x = m + b D(x)`` with Eq. 10-11, where ``b`` does not vary with ``K``.

    ``D = Psi(x)`` forward and ``-x Psi(1/x)`` backward. Newton in ``v``, with
    ``x = 1 -+ v^2``, which takes the infinite slope at ``x = 1`` away; kept in its bracket.
    """
    if b == 0.0:
        return m, 0.0  # dM/dK = x - m dx/dm
    forward = m <= 1.0
    sign = 1.0 if forward else -1.0
    low, high = 0.0, math.sqrt(abs(1.0 - m))
    v = min(abs(1.0 - m) / (2.0 * b), high)
    slope_d = 0.0
    x = m
    for _ in range(80):
        x = 1.0 - sign * v * v
        if v == 0.0:
            v = 1e-9 * high
            x = 1.0 - sign * v * v
        if forward:
            flow, slope_d = _exact_function(x)
        else:
            psi, psi_slope = _exact_function(1.0 / x)
            flow, slope_d = -x * psi, -psi + psi_slope / x
        residual = x - m - b * flow  # rises with x
        if sign * residual > 0.0:
            low = v
        else:
            high = v
        following = v - residual / (-2.0 * sign * v * (1.0 - b * slope_d))
        if not low <= following <= high:
            following = 0.5 * (low + high)
        change = following - v
        v = following
        if abs(change) <= 1e-14:
            break
    x = 1.0 - sign * v * v
    if v == 0.0:
        return x, x
    return x, x - m / (1.0 - b * slope_d)


@compiled
def fill_from_ambient(x: float, k: float) -> float:
    """Pressure ratio after a volume fills through one orifice of Eq. 13-14 alone.

    The exact solution of ``dx/dt = rate d(x)`` for a constant upstream pressure; `k` is
    ``rate * time``. With ``x = sin(a)^2`` the angle ``a`` grows at the constant `rate`.
    """
    if x < 0.5:
        until_subsonic = 0.5 - x
        if k <= until_subsonic:
            return x + k
        k -= until_subsonic
        x = 0.5
    if x <= 1.0:
        angle = math.asin(math.sqrt(x)) + k
        return 1.0 if angle >= 0.5 * math.pi else math.sin(angle) ** 2
    if x > 2.0:
        if k <= x - 2.0:
            return x - k
        k -= x - 2.0
        x = 2.0
    # Above ambient: u + u^3/3 with u^2 = x - 1 falls at the constant rate.
    u = math.sqrt(x - 1.0)
    remaining = u + u**3 / 3.0 - k
    if remaining <= 0.0:
        return 1.0
    u = 2.0 * math.sinh(math.asinh(1.5 * remaining) / 3.0)
    return 1.0 + u * u
