"""Coefficients of the kernel's Runge-Kutta method.

ESDIRK3(2)4L[2]SA of Kennedy and Carpenter (2003): third order, L-stable, stiffly accurate,
stage order 2. The first stage is the end of the step before.
"""

from __future__ import annotations

import numpy as np

GAMMA = 1767732205903 / 4055673282236
C_1, C_2 = 2.0 * GAMMA, 0.6  # nodes of the implicit stages; the last one is the step's end
B_0, B_1 = 1471266399579 / 7840856788654, -4482444167858 / 7529755066697
B_2 = 11266239266428 / 11593286722821
# Explicit parts of the implicit stages, a row each.
EXPLICIT = np.array(
    [
        [GAMMA, 0.0, 0.0],
        [2746238789719 / 10658868560708, -640167445237 / 6845629431997, 0.0],
        [B_0, B_1, B_2],
    ]
)
# Weights of the error estimate: the step less the embedded second-order one.
E_0 = B_0 - 2756255671327 / 12835298489170
E_1 = B_1 + 10771552573575 / 22201958757719
E_2 = B_2 - 9247589265047 / 10645013368117
E_3 = GAMMA - 2193209047091 / 5459859503100
# The nodes, and one more that fills a vector register.
NODES = np.array([C_1, C_2, 1.0, 1.0])
