"""Second integrator of Part I's crank-angle model, independent of the plant's physics.

Pressure form, straight from the paper with the corrections of its misprints: Eq. 1 and 2 for
the pressures, Eq. 3 for the volume, Eq. 5 to 8 as an ODE for each runner, Eq. 13-14 for every
orifice, Eq. 15 and 19 for the throttle, Eq. 20 and Appendix B or the cam of section 4 for the
lift. Charge, throttle mass and pumping loss are quadrature states. A general solver goes from
one discontinuity to the next; the loss ends where an event detector says so (section 3.2).

Only numbers are taken from `Engine`; no function of `plant` is called.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

# states: manifold pressure, throttle mass; then for each breathing cylinder
P_M, M_PHI, FIRST = 0, 1, 2
P_C, V_R, A_R, CHARGE, LOSS, STRIDE = 0, 1, 2, 3, 4, 5

# columns of a breathing cylinder's data
TDC, IVO, FLOW_COEFFICIENT, LIFT, DURATION, FORM, COLUMNS = 0, 1, 2, 3, 4, 5, 6
R_RISE, R_APPROACH, R_RETREAT, R_FALL, R_SEAT, R_CAM = 0, 1, 2, 3, 4, 5

# numbers of the engine and the operating point
(
    GAS, V_M, V_D, V_CL, P_O, P_EXH, RUNNER, GAIN, PISTON, W_H, XI, OMEGA, A_PHI,
    S_R, S_C, S_S, D_S, LAM, SWING, SWING_RATE, SWING_DECAY, NUMBERS,
) = range(22)  # fmt: skip


# The slope of Eq. 14 is infinite at equal pressures, where a general solver stands still: a
# manifold that no cylinder breathes from reaches ambient pressure in finite time and stays.
# Within this share of equality the flow is led through zero linearly, which moves a pressure by
# less than that share of itself.
LINEAR_ZONE = 1e-9


@njit
def psi(x):
    """Eq. 14 and its derivative."""
    if x <= 0.5:
        return 1.0, 0.0
    s = x - x * x
    square = s * s + LINEAR_ZONE * LINEAR_ZONE
    fourth = math.sqrt(math.sqrt(square))
    slope = (0.5 * s * s + LINEAR_ZONE * LINEAR_ZONE) / (square * fourth)
    return 2.0 * s / fourth, 2.0 * slope * (1.0 - 2.0 * x)


@njit
def flow(p_1, p_2):
    """Eq. 13: flow from p_2 to p_1, with its derivatives to p_1 and p_2."""
    if p_1 <= p_2:
        x = p_1 / p_2
        value, slope = psi(x)
        return value, slope / p_2, -slope * x / p_2
    x = p_2 / p_1
    value, slope = psi(x)
    return -value, slope * x / p_1, -slope / p_1


@njit
def lift(k, cyl, t):
    """Eq. 20 in its continuous form, Appendix B, or the cam of section 4; t since IVO."""
    u_l, t_d, form = cyl[LIFT], cyl[DURATION], cyl[FORM]
    if form == R_CAM:
        return u_l * math.sin(math.pi * t / t_d) ** 2
    l_s = k[LAM] * u_l
    top = (1.0 - k[LAM]) * u_l
    d_r = top / k[S_R]
    d_f = (top - k[S_S] * k[D_S]) / k[S_C]
    s = t_d - d_r - d_f - k[D_S]
    if form == R_RISE:
        return k[S_R] * t
    if form == R_APPROACH:
        value = u_l - l_s * math.exp(-k[S_R] / l_s * (t - d_r))
    elif form == R_RETREAT:
        value = u_l - l_s * math.exp(-k[S_C] / l_s * (d_r + s - t))
    elif form == R_FALL:
        value = top - k[S_C] * (t - d_r - s)
    else:
        value = k[S_S] * (t_d - t)
    value += (
        k[SWING] * u_l * math.exp(-k[SWING_DECAY] * (t - d_r))
        * math.sin(k[SWING_RATE] * (t - d_r))
    )  # fmt: skip
    return max(value, 0.0)


@njit
def derivative(t, y, k, cyls, jacobian, out):
    """Right-hand side, or its Jacobian; both into `out`."""
    p_m = y[P_M]
    d, d_m, _ = flow(p_m, k[P_O])
    rate_m = k[GAS] / k[V_M]
    if jacobian:
        out[:] = 0.0
        out[P_M, P_M] = rate_m * k[A_PHI] * d_m
        out[M_PHI, P_M] = k[A_PHI] * d_m
    else:
        out[0, M_PHI] = k[A_PHI] * d
        out[0, P_M] = rate_m * k[A_PHI] * d
    for j in range(cyls.shape[0]):
        cyl, o = cyls[j], FIRST + STRIDE * j
        p_c, v, a = y[o + P_C], y[o + V_R], y[o + A_R]
        theta = k[OMEGA] * (t - cyl[TDC])
        volume = 0.5 * k[V_D] * (1.0 - math.cos(theta)) + k[V_CL]
        growth = 0.5 * k[V_D] * k[OMEGA] * math.sin(theta)
        area = cyl[FLOW_COEFFICIENT] * lift(k, cyl, t - cyl[IVO])
        share = 1.0 - k[GAIN] * a  # p_r = p_m - m_r k_r/A_r dv/dt, m_r = p_m V_r/(R T)
        p_r = share * p_m
        d, d_c, d_r = flow(p_c, p_r)
        if jacobian:
            for column, slope in (
                (P_M, d_r * share),
                (o + P_C, d_c),
                (o + A_R, -d_r * k[GAIN] * p_m),
            ):
                out[o + CHARGE, column] += area * slope
                out[o + P_C, column] += k[GAS] / volume * area * slope
                out[P_M, column] -= rate_m * area * slope
            out[o + P_C, o + P_C] -= growth / volume
            out[o + LOSS, o + P_C] = -growth
            if k[RUNNER] > 0.0:
                out[o + V_R, o + A_R] = 1.0
                out[o + A_R, o + V_R] = -k[W_H] * k[W_H]
                out[o + A_R, o + A_R] = -2.0 * k[XI] * k[W_H]
        else:
            m_c = area * d
            out[0, P_M] -= rate_m * m_c
            out[0, o + P_C] = (k[GAS] * m_c - growth * p_c) / volume
            out[0, o + CHARGE] = m_c
            out[0, o + LOSS] = (k[P_EXH] - p_c) * growth
            out[0, o + V_R] = 0.0
            out[0, o + A_R] = 0.0
            if k[RUNNER] > 0.0:
                forcing = k[PISTON] * math.sin(theta)
                out[0, o + V_R] = a
                out[0, o + A_R] = k[W_H] ** 2 * (forcing - v) - 2.0 * k[XI] * k[W_H] * a


@dataclass(frozen=True)
class ReferenceCycle:
    charge: np.ndarray  # (n,), kg
    loss: np.ndarray  # (n,), J
    throttle_mass: float  # kg per cycle
    change: float  # of charge, last cycle against the one before, over the displaced volume


@dataclass
class _Breathing:
    cylinder: int
    cycle: int
    data: np.ndarray
    corners: list  # (time, form that ends there)


def numbers(engine, speed_rpm, throttle_deg, *, runner, oscillation):
    e, v, h = engine, engine.valvetrain, engine.helmholtz
    k = np.zeros(NUMBERS)
    k[GAS] = e.gas_constant * e.temperature
    k[V_M], k[V_D], k[V_CL] = e.manifold_volume, e.displaced_volume, e.clearance_volume
    k[P_O], k[P_EXH] = e.ambient_pressure, e.exhaust_pressure
    k[OMEGA] = 2.0 * math.pi * speed_rpm / 60.0
    k[RUNNER] = float(runner)
    if runner:
        k[GAIN] = e.runner_volume / k[GAS] * e.runner_constant / e.runner_area
        v_p = 2.0 * math.pi * speed_rpm / 120.0 * e.stroke
        k[PISTON] = math.pi * e.bore**2 / 4.0 / e.runner_area * v_p
        share = (speed_rpm - h.low_speed_rpm) / (h.high_speed_rpm - h.low_speed_rpm)
        share = min(max(share, 0.0), 1.0)
        f = h.low_speed_frequency_hz * (1.0 - share) + h.high_speed_frequency_hz * share
        k[W_H] = 2.0 * math.pi * f
        k[XI] = h.low_speed_damping * (1.0 - share) + h.high_speed_damping * share
    k[A_PHI] = 1.268e-4 * (-0.2215 - 2.275 * throttle_deg + 0.23 * throttle_deg**2)
    k[S_R], k[S_C] = v.opening_slope_mm_s, v.closing_slope_mm_s
    k[S_S], k[D_S], k[LAM] = v.seating_slope_mm_s, v.seating_duration, v.roundness
    if oscillation:  # Appendix B, as printed
        k[SWING], k[SWING_RATE] = 0.21, 2.0 * math.pi / 2.5e-3
        k[SWING_DECAY] = -4.0 / 2.5e-3 * math.log(0.17 / 0.21)
    return k


def reference_cycle(
    engine,
    speed_rpm,
    commands,
    throttle_deg=90.0,
    *,
    runner=True,
    oscillation=False,
    profile="camless",
    manifold_pressure=None,
    cycles=3,
    rtol=1e-9,
    method="LSODA",
):
    """Simulate `cycles` cycles from a manifold pressure; charge and loss of the last one."""
    n = engine.n_cylinders
    k = numbers(engine, speed_rpm, throttle_deg, runner=runner, oscillation=oscillation)
    rate = 6.0 * speed_rpm
    factors = engine.cylinder_flow_factors or (1.0,) * n
    openings = []
    for cycle in range(cycles + 1):  # the last one only for its overlap with the one before
        for j in range(n):
            tdc = 720.0 * cycle + 720.0 / n * j
            openings.append(((tdc + commands[j].opening_deg) / rate, tdc / rate, j, cycle))
    openings.sort()
    charge, loss = np.full((cycles + 1, n), np.nan), np.full((cycles + 1, n), np.nan)

    now = openings[0][0]
    start = now
    head = np.array([manifold_pressure or engine.ambient_pressure, 0.0])
    active, states = [], []
    marks = {}  # throttle mass at the ends of whole cycles
    mark_times = [start + c * 120.0 / speed_rpm for c in range(cycles + 1)]
    tiny = 1e-13
    while np.isnan(charge[:cycles]).any() or cycles not in marks:
        ends = [b.corners[0][0] for b in active]
        if openings:
            ends.append(openings[0][0])
        ends += [m for m in mark_times if m > now + tiny]
        end = min(ends)
        if end > now + tiny:
            cyls = np.array([b.data for b in active]).reshape(-1, COLUMNS)
            y = np.concatenate([head, *states])
            y = _integrate(now, end, y, k, cyls, rtol, method)
            head = y[:FIRST]
            states = [y[FIRST + STRIDE * i : FIRST + STRIDE * (i + 1)] for i in range(len(active))]
        now = end
        for c, m in enumerate(mark_times):
            if abs(m - now) <= tiny:
                marks[c] = head[M_PHI]
        kept = []
        for b, state in zip(active, states, strict=True):
            while b.corners and b.corners[0][0] <= now + tiny:
                b.corners.pop(0)
            if b.corners:
                b.data[FORM] = b.corners[0][1]
                kept.append((b, state))
            else:
                angle = math.degrees(k[OMEGA] * (now - b.data[TDC]))
                charge[b.cycle, b.cylinder] = state[CHARGE]
                loss[b.cycle, b.cylinder] = state[LOSS] + loss_after_closing(state[P_C], angle, k)
        while openings and openings[0][0] <= now + tiny:
            opening, tdc, j, cycle = openings.pop(0)
            command = commands[j]
            if command.lift_mm == 0.0:
                charge[cycle, j] = 0.0
                theta = math.degrees(k[OMEGA] * (opening - tdc))
                loss[cycle, j] = loss_after_closing(k[P_EXH], theta, k)
                continue
            data = np.array(
                [tdc, opening, engine.flow_coefficient * factors[j], command.lift_mm,
                 command.duration_deg / rate, R_CAM]
            )  # fmt: skip
            corners = _corners(k, command.lift_mm, data[DURATION], profile)
            corners = [(opening + t, form) for t, form in corners]
            data[FORM] = corners[0][1]
            state = np.zeros(STRIDE)
            state[P_C] = k[P_EXH]
            kept.append((_Breathing(j, cycle, data, corners), state))
        active, states = [b for b, _ in kept], [s for _, s in kept]
    scale = engine.ambient_pressure * engine.displaced_volume / k[GAS]
    return ReferenceCycle(
        charge=charge[-2],
        loss=loss[-2],
        throttle_mass=marks[cycles] - marks[cycles - 1],
        change=float(np.max(np.abs(charge[-2] - charge[-3]))) / scale,
    )


def _corners(k, u_l, t_d, profile):
    if profile == "conventional":
        return [(t_d, R_CAM)]
    top = (1.0 - k[LAM]) * u_l
    d_r = top / k[S_R]
    d_f = (top - k[S_S] * k[D_S]) / k[S_C]
    s = t_d - d_r - d_f - k[D_S]
    assert s >= 0.0
    assert k[S_R] == k[S_C]  # the halves of the dwell meet
    return [
        (d_r, R_RISE),
        (d_r + s / 2.0, R_APPROACH),
        (d_r + s, R_RETREAT),
        (t_d - k[D_S], R_FALL),
        (t_d, R_SEAT),
    ]


def _integrate(now, end, y, k, cyls, rtol, method):
    size = y.size

    def rhs(t, state):
        out = np.empty((1, size))
        derivative(t, state, k, cyls, False, out)
        return out[0]

    def jac(t, state):
        out = np.empty((size, size))
        derivative(t, state, k, cyls, True, out)
        return out

    # Pa, kg, m/s, m/s2 and J: each small against what the bars can see
    atol = np.concatenate(
        [[1e4 * rtol, 1e-4 * rtol], np.tile([1e4 * rtol, rtol, 1e2 * rtol, 1e-4 * rtol, rtol],
                                            cyls.shape[0])]
    )  # fmt: skip
    if cyls.shape[0] == 0:
        method = "BDF"  # LSODA stays with its non-stiff method at a manifold in equilibrium
    solution = solve_ivp(rhs, (now, end), y, method=method, jac=jac, rtol=rtol, atol=atol)
    assert solution.success, solution.message
    return solution.y[:, -1]


def loss_after_closing(pressure, angle_deg, k):
    """Loss from IVC to the first instant after BDC with p_c >= p_exh, by event detection."""

    def rhs(theta, y):
        volume = 0.5 * k[V_D] * (1.0 - math.cos(theta)) + k[V_CL]
        growth = 0.5 * k[V_D] * math.sin(theta)  # dV/dtheta
        return [-growth * y[0] / volume, (k[P_EXH] - y[0]) * growth]

    def reaches(theta, y):
        return y[0] - k[P_EXH]

    reaches.terminal = True
    reaches.direction = 1.0
    options = {"method": "DOP853", "rtol": 1e-11, "atol": [1e-6, 1e-12]}
    y, theta = [pressure, 0.0], math.radians(angle_deg)
    if theta < math.pi:
        y = solve_ivp(rhs, (theta, math.pi), y, **options).y[:, -1]
        theta = math.pi
    if y[0] >= k[P_EXH]:
        return y[1]
    return solve_ivp(rhs, (theta, 2.0 * math.pi), y, events=reaches, **options).y[1, -1]
