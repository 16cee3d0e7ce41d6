"""Columns of the kernel's workspace, one row a cylinder."""

from __future__ import annotations

# The first seven turn with time.
SIN, COS = 0, 1  # of the crank angle
FREE_RE, FREE_IM = 2, 3  # phasor of the free runner acceleration
SWING_RE, SWING_IM = 4, 5  # of the oscillation (Im) or the cam (Re)
EXPONENTIAL = 6  # part of the lift
TURNING = 7
OLD = 7  # the same seven at the start of the step: columns 7 to 13
GROWTH_1, GROWTH_2, GROWTH_3 = 14, 15, 16  # factors of the exponential from stage to stage
CONSTANT, SLOPE, SCALE, RATE = 17, 18, 19, 20  # lift = constant + slope t + exp. + scale swing
START, BASE, STAGE = 21, 22, 23  # masses: at the start of the step, known, solved
AREA, CAPACITY, SENSITIVITY = 24, 25, 26  # gamma h A_v; K/p_m; dM/dp_m
PRESSURE_PER_MASS = 27  # R T/V
FLOW_0, FLOW_1, FLOW_2, FLOW_3 = 28, 29, 30, 31  # port flow at the nodes
POWER_0, POWER_1, POWER_2, POWER_3 = 32, 33, 34, 35  # (p_exh - p_c) dV/dt at the nodes
RESTED = 36  # whether the lift was held at zero during the step
WORKSPACE_COLUMNS = 37
