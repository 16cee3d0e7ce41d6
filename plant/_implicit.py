"""Closed-form implicit steps of ``dM/dt = A d(p_down, p_up)``, compiled.

One implicit step reads ``M = B + a d(M/K)``: ``B`` the known mass, ``a >= 0`` the effective
area times the step, ``K`` the mass at which the downstream pressure equals the upstream one.
``d`` is 1 when choked, positive below ``M = K`` and negative above: the left side minus the
right one is monotone in ``M``, so the root is unique. Each function returns ``d`` at the root
and ``dM/dK``, which the manifold needs to see how its pressure moves the cylinders.
"""

from __future__ import annotations

import math

from ._compile import compiled

# Eq. 11 at gamma = 1.4
_GAMMA = 1.4
_CRITICAL_RATIO = (2.0 / (_GAMMA + 1.0)) ** (_GAMMA / (_GAMMA - 1.0))
_SONIC = math.sqrt(_GAMMA) * (2.0 / (_GAMMA + 1.0)) ** ((_GAMMA + 1.0) / (2.0 * (_GAMMA - 1.0)))
_EXACT_SCALE = math.sqrt(2.0 * _GAMMA / (_GAMMA - 1.0)) / _SONIC
CLOSE = 1e-6
_NOTHING = 1e-200  # added to a denominator that may be exactly zero


@compiled
def simplified_step(base: float, area: float, full: float) -> tuple[float, float]:
    """Solve ``M = B + a d(M/K)`` with Eq. 13-14; ``dM/dK`` at constant ``B`` and ``a``."""
    if base > full:
        return _simplified_backward(base, area, full)
    if base + area <= 0.5 * full:
        return 1.0, 0.0
    # (M - B)^2 K^2 = 4 a^2 M (K - M), of which the larger root. Root and denominator do not
    # wait for each other, and nothing here waits for a second division but the sensitivity.
    square_area = area * area
    square_full = full * full
    root = math.sqrt(square_area + base * (full - base))
    per = 1.0 / (square_full + 4.0 * square_area)
    half = (root * full - area * (2.0 * base - full)) * per
    mass = base + 2.0 * area * half
    stiffness = area * (2.0 * mass - full)
    return 2.0 * half, mass * stiffness / (full * (stiffness + half * square_full) + _NOTHING)


@compiled
def _simplified_backward(base: float, area: float, full: float) -> tuple[float, float]:
    if base - area >= 2.0 * full:
        return -1.0, 0.0
    # With x = M/K and u^2 = x - 1, (c - u^2)(1 + u^2) = 2 b u. Newton from the root of the
    # quadratic that remains without u^4. Up to c = 1 the difference is concave and falling in u:
    # after one step the iterates fall towards the root. Beyond, they are kept in their bracket.
    c = (base - full) / full
    b = area / full
    if c <= 1.0:
        u = c / (b + math.sqrt(b * b + (1.0 - c) * c) + _NOTHING)
        for _ in range(60):
            u2 = u * u
            slope = 2.0 * u * (c - 1.0 - 2.0 * u2) - 2.0 * b
            change = ((c - u2) * (1.0 + u2) - 2.0 * b * u) / (slope - _NOTHING)
            u -= change
            if abs(change) <= CLOSE * u:  # and the next one would be its square
                break
    else:
        u = _bracketed(c, b)
    x = 1.0 + u * u
    stiffness = b * (2.0 - x)
    return -2.0 * u / x, x * stiffness / (stiffness + u * x * x + _NOTHING)


@compiled
def _bracketed(c: float, b: float) -> float:
    low, high = 0.0, 1.0
    u = 1.0
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
        if abs(change) <= 1e-13:
            break
    return u


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
def exact_step(base: float, area: float, full: float) -> tuple[float, float]:
    """Solve ``M = B + a D(M/K)`` with Eq. 10-11; ``dM/dK`` where ``a`` varies as ``K``.

    ``D = Psi(x)`` forward and ``-x Psi(1/x)`` backward, with ``x = M/K``. Newton in ``v``, with
    ``x = 1 -+ v^2``, which takes the infinite slope at ``x = 1`` away; kept in its bracket.
    """
    m, b = base / full, area / full
    forward = m <= 1.0
    sign = 1.0 if forward else -1.0
    low, high = 0.0, math.sqrt(abs(1.0 - m))
    v = min(abs(1.0 - m) / (2.0 * b + _NOTHING), high)
    flow, slope_d = 0.0, 0.0
    for _ in range(80):
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
        return 0.0, x
    if b > 0.0:
        flow = (x - m) / b  # so that M is to rounding what x is; Psi cancels near x = 1
    return flow, x - m / (1.0 - b * slope_d)


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
