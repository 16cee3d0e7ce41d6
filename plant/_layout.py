"""Data that the compiled kernel works on: parameters, state tables and their columns."""

from __future__ import annotations

from typing import NamedTuple


class KernelEngine(NamedTuple):
    """What the kernel needs of an engine and its options (SI; lift in mm)."""

    n_cylinders: int
    capacity: float  # V_m/(R T), kg/Pa
    gas: float  # R T, J/kg
    half_stroke_volume: float  # V_d/2, m3
    clearance_volume: float  # m3
    ambient_pressure: float  # Pa
    exhaust_pressure: float  # Pa
    runner_gain: float  # c of p_r = p_m (1 - c dv/dt), s2/m; 0 without runner
    runner_forcing: float  # amplitude of the forcing of Eq. 7 over A_r and crank speed, m
    opening_slope: float  # mm/s
    closing_slope: float  # mm/s
    seating_slope: float  # mm/s
    seating_duration: float  # s
    roundness: float  # 1
    oscillation_amplitude: float  # 1; 0 without oscillation
    oscillation_frequency: float  # rad/s
    oscillation_decay: float  # 1/s
    cam: bool  # conventional profile
    exact_orifice: bool  # Eq. 10-11 in place of Eq. 13-14
    exact_scale: float  # sqrt(T_ref/T)/p_ref of the exact orifice, 1/Pa


class Event(NamedTuple):
    """The intake event that begins in a window."""

    cylinder: int
    until_opening_deg: float  # crank angle from the start of the window to IVO
    lift: float  # delivered maximum lift, mm
    duration_deg: float


class Window(NamedTuple):
    """A stretch of crank angle at constant speed and throttle, with what follows from them."""

    length: float  # s
    degree_rate: float  # deg/s
    omega: float  # rad/s
    throttle_area: float  # kg/s
    velocity_sin: float  # steady port velocity = velocity_sin sin + velocity_cos cos, m/s
    velocity_cos: float
    acceleration_sin: float  # likewise its rate, m/s2
    acceleration_cos: float
    pole_re: float  # of the free motion of the runner, 1/s
    pole_im: float
    resolution: float  # multiplies the number of steps
    samples: int  # of the trace over the window; 0 without trace
    spacing: float  # of the samples, s


# Columns of the cylinder table, one row a cylinder.
PHASE = 0  # form of the valve's motion, below
SINCE = 1  # time since IVO, s
TURNED = 2  # crank angle since IVO, deg
LIFT = 3  # delivered maximum lift, mm
DURATION = 4  # s for camless (latched at IVO), deg for a cam
MASS = 5  # kg
MASS_AT_OPENING = 6  # kg
WORK = 7  # integral of (p_exh - p_c) dV since IVO, J
VELOCITY = 8  # port velocity of the runner, m/s
ACCELERATION = 9  # its rate, m/s2
FLOW = 10  # port flow, kg/s
CHARGE = 11  # of the last complete event, kg
LOSS = 12  # of the last complete event, J
COMPLETED = 13  # number of complete events
CYLINDER_COLUMNS = 14

# Forms of the valve's motion.
SHUT, RISE, APPROACH, RETREAT, FALL, SEAT, CAM = 0, 1, 2, 3, 4, 5, 6

# Entries of the manifold vector.
MANIFOLD_MASS = 0  # kg
INFLOW = 1  # integral of the throttle flow since the start, kg
THROTTLE_FLOW = 2  # kg/s
STEPS = 3  # number of steps taken or tried since the start
MANIFOLD_ENTRIES = 4

# Rows of the trace: two of the manifold, then four for each cylinder.
TRACE_PRESSURE, TRACE_THROTTLE = 0, 1
TRACE_FIRST = 2
TRACE_MASS, TRACE_FLOW, TRACE_RUNNER, TRACE_LIFT = 0, 1, 2, 3
TRACE_STRIDE = 4

# Status of a window.
OK, RUNNER_COLLAPSED, NO_STAGE_SOLUTION, OPEN_AT_COMPRESSION_TDC = 0, 1, 2, 3
TOO_MANY_STEPS = 7  # 4 to 6: see `_periodic` and `_batch_kernel`

SAME_TIME = 1e-11  # s, two cuts nearer than this are one
