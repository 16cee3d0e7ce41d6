"""Choice of one lift per demand and speed that is continuous and gives up the least cost.

The lift of least cost jumps where two minima trade places. Of all ways over a grid of speeds and
positions, the one is sought whose sum of relative excess cost and of squared changes between
neighbours is least, with changes that stay within a limit. It is a labelling of a grid, solved
row by row by dynamic programming, the neighbouring rows held, until no row changes.
"""

from __future__ import annotations

import numpy as np

from plant.kinematics import FloatArray

_CHANGE = 1e-4  # 1/mm2, excess cost that a squared change between neighbours is worth
_BEYOND = 10.0  # 1/mm2, of a change beyond the limit
_NEVER = 1e6  # of a lift that does not give the charge
_MOST_SWEEPS = 40


def choose_lifts(
    cost: FloatArray, lifts_mm: FloatArray, along: FloatArray, across: FloatArray
) -> FloatArray:
    """Lift in mm at each speed and position.

    Parameters
    ----------
    cost : ndarray (s, q, m)
        Cost of each lift, inf where it cannot be used; at each node one at least can.
    lifts_mm : ndarray (m,)
        Lifts, evenly spaced.
    along : ndarray (s, q - 1)
        Largest change between neighbouring positions, mm.
    across : ndarray (s - 1,)
        Largest change between neighbouring speeds, mm.

    Returns
    -------
    ndarray (s, q)
    """
    best = cost.min(axis=2, keepdims=True)
    excess = np.where(np.isfinite(cost), cost / np.abs(best) - 1.0, _NEVER)
    distance = np.abs(lifts_mm[:, None] - lifts_mm)

    def change(limit: float) -> FloatArray:
        return _CHANGE * distance**2 + _BEYOND * np.maximum(distance - limit, 0.0) ** 2

    steps = [[change(limit) for limit in row] for row in along]
    rows = [change(limit) for limit in across]
    count = excess.shape[0]
    chosen: list[np.ndarray] = []
    for i in range(count):
        held = rows[i - 1][:, chosen[-1]].T if i else 0.0
        chosen.append(_row(excess[i] + held, steps[i]))
    for _ in range(_MOST_SWEEPS):
        moved = False
        for i in range(count):
            total = excess[i].copy()
            if i:
                total += rows[i - 1][:, chosen[i - 1]].T
            if i < count - 1:
                total += rows[i][:, chosen[i + 1]].T
            new = _row(total, steps[i])
            moved |= not np.array_equal(new, chosen[i])
            chosen[i] = new
        if not moved:
            break
    return lifts_mm[np.array(chosen)]


def _row(cost: FloatArray, steps: list[FloatArray]) -> np.ndarray:
    """Lifts (their indices) of least total along a row of (q, m) costs: dynamic programming."""
    total, origin = cost[0], list[np.ndarray]()
    for j, step in enumerate(steps):
        through = total[:, None] + step
        best = np.argmin(through, axis=0)
        origin.append(best)
        total = through[best, np.arange(best.size)] + cost[j + 1]
    index = [int(np.argmin(total))]
    for best in reversed(origin):
        index.append(int(best[index[-1]]))
    return np.array(index[::-1])
