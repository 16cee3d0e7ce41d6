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
FOLD_STEP = 13  # longest step while it counts, s
SWINGS_UNTIL = 14  # time in the segment until which the oscillation counts
CORNERS = 15  # times of the valve's corners since IVO: columns 15 to 19
COEFFICIENT = 20  # of the port flow, kg/s/mm
PER_MASS = 21  # 1 over the mass that its errors are measured by, 1/kg
START, BASE, STAGE = 22, 23, 24  # masses: at the start of the step, known, solved
SENSITIVITY, FRESH_SENSITIVITY = 25, 26  # dM/dp_m of the last stage and of this one
FLOW = 27  # at the nodes, columns 27 to 30: port flow; in the manifold's row, net flow into it
POWER = 31  # likewise (p_exh - p_c) dV/dt; in the manifold's row, flow through the throttle
OPEN = 35  # 1 while the area does not vanish within the segment, else 0
SCRATCH_COLUMNS = 36

# Forcing at the nodes of a step, in a row of its own for each breathing cylinder: the phasors,
# then these. Quantity q at node k is in column LANES q + k.
LIFT, AREA, CAPACITY, PRESSURE_PER_MASS, VOLUME_RATE = 7, 8, 9, 10, 11  # gamma h A_v; K/p_m; ...
FORCED = 12
# The last row of the forcing holds the factors by which phasors turn from the step's start.
TURN_SIN, TURN_COS, TURN_FREE_RE, TURN_FREE_IM, TURN_SWING_RE, TURN_SWING_IM = 0, 1, 2, 3, 4, 5
LANES = 4  # nodes of `_method.NODES`
