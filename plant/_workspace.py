"""Columns of the kernel's scratch space.

One row a breathing cylinder, and a last one, the manifold's.
"""

from __future__ import annotations

# Phasors at the start of the step.
SIN, COS = 0, 1  # of the crank angle
FREE_RE, FREE_IM = 2, 3  # of the free runner acceleration
SWING_RE, SWING_IM = 4, 5  # of the oscillation (Im) or the cam (Re)
EXPONENTIAL = 6  # part of the lift
PHASORS = 7
CONSTANT, SLOPE, SCALE, RATE = 7, 8, 9, 10  # lift = constant + slope t + exp. + scale swing
FOLDS_FROM, FOLDS_UNTIL = 11, 12  # times in the segment between which the exponential counts
SWINGS_UNTIL = 13  # time in the segment until which the oscillation counts
CORNERS = 14  # times of the valve's corners since IVO: columns 14 to 18
COEFFICIENT = 19  # of the port flow, kg/s/mm
CLOSES_ON_AIR = 20  # mass of ambient air that the cylinder takes in up to its closing angle, kg
OPEN = 21  # 1 while the area does not vanish, else 0
START, BASE, STAGE = 22, 23, 24  # masses: at the start of the step, known, solved
SENSITIVITY, FRESH_SENSITIVITY = 25, 26  # dM/dp_m of the last stage and of this one
FLOW = 27  # at the nodes, columns 27 to 30: port flow; in the manifold's row, net flow into it
POWER = 31  # likewise (p_exh - p_c) dV/dt; in the manifold's row, flow through the throttle
SCRATCH_COLUMNS = 35

# Rows of the forcing of a breathing cylinder at the nodes of a step: first the phasors, then
LIFT, AREA, CAPACITY, PRESSURE_PER_MASS, VOLUME_RATE = 7, 8, 9, 10, 11  # gamma h A_v; K/p_m; ...
FORCING_ROWS = 12
# The last table of forcing holds the factors by which phasors turn from the step's start.
TURN_SIN, TURN_COS, TURN_FREE_RE, TURN_FREE_IM, TURN_SWING_RE, TURN_SWING_IM = 0, 1, 2, 3, 4, 5
LANES = 4  # columns of both: nodes of `_method.NODES`
