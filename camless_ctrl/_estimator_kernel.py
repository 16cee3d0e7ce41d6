"""Compiled entries of the Kalman charge estimator: keep samples, weigh a window, invert.

Their machine code is kept on disk; see `_kernel_stamp` for the stamp that each carries.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit, types

import plant
from plant.kinematics import FloatArray

from ._air_path_kernel import (
    AMBIENT,
    AMBIENT_SPREAD,
    BEFORE,
    CARRY,
    CHARGE_SPREAD,
    DELAY,
    HEAD,
    LAG,
    MAF_DELAY,
    MAF_PER_EVENT,
    MAF_RATE,
    MAP_DELAY,
    MOST_SAMPLES,
    OUTPUT,
    STATES,
    WINDOW_GATE,
    inlined,
    trajectory,
)  # fmt: skip
from ._estimator_algebra import (
    COVARIANCE,
    MEASURED,
    PRIOR,
    all_finite,
    ambient_of,
    begin,
    compress,
    far,
    move,
    predict,
    sound,
)  # fmt: skip
from ._kernel_stamp import stamp_of
from .event_data import PARTS

LEAST_SHARE = 0.5  # of the MAF samples that a window should have; with fewer it has no estimate
MOST_PASSES = 3  # that linearise a window again

UPDATED, TOO_FEW, WILD, LOST = range(4)  # what came of a window

_tuple: Any = types.Tuple
_ROW = types.Array(types.float64, 1, "A", readonly=True)
_OWN = types.Array(types.float64, 1, "C")  # of states and workspace
_OWN_TABLE = types.Array(types.float64, 2, "C")
_FASTMATH = {"contract", "arcp", "nsz"}  # as in the plant's kernel


def _stamp() -> int:
    """Stamp of all that is compiled into the entries."""
    own, other = Path(__file__).parent, Path(plant.__file__).parent
    files = (
        own / "_air_path_kernel.py", own / "_estimator_algebra.py", own / "_estimator_kernel.py",
        own / "event_data.py", other / "_implicit.py", other / "_compile.py",
    )  # fmt: skip
    return stamp_of(files)


@inlined
def _kept(
    old: FloatArray,
    at: int,
    n_old: int,
    earliest: float,
    latest: float,
    last: float,
    time: FloatArray,
    value: FloatArray,
    new: FloatArray,
    to: int,
) -> tuple[int, float]:
    """Copy a sensor's samples that are still wanted; return their number and the latest time."""
    count = 0
    for i in range(n_old):
        t = old[at + i]
        if t >= earliest:
            new[to + count] = t
            new[to + MOST_SAMPLES + count] = old[at + n_old + i]
            count += 1
    if last > latest:  # the clock was set back
        last = -math.inf
        count = 0
    for i in range(min(time.size, value.size)):
        t = time[i]
        if not (last < t <= latest) or not math.isfinite(value[i]):
            continue
        last = t
        if t >= earliest and count < MOST_SAMPLES:
            new[to + count] = t
            new[to + MOST_SAMPLES + count] = value[i]
            count += 1
    return count, last


@inlined
def _packed(
    work: FloatArray,
    n_maf: int,
    n_map: int,
    last_maf: float,
    last_map: float,
    first_maf: int,
    first_map: int,
) -> FloatArray:
    """Return the samples of the workspace, from given ones on, in one array."""
    a, b = n_maf - first_maf, n_map - first_map
    packed = np.empty(HEAD + 2 * (a + b))
    packed[0], packed[1], packed[2], packed[3] = a, b, last_maf, last_map
    k = HEAD
    for start, count in ((first_maf, a), (MOST_SAMPLES + first_maf, a)):
        for i in range(count):
            packed[k] = work[start + i]
            k += 1
    for start, count in ((first_map, b), (MOST_SAMPLES + first_map, b)):
        for i in range(count):
            packed[k] = work[2 * MOST_SAMPLES + start + i]
            k += 1
    return packed


def _keep(stamp: int) -> Any:
    @njit(
        types.float64[::1](
            _OWN, _ROW, _ROW, _ROW, _ROW, types.float64
        ),
        cache=True, nogil=True, error_model="numpy", fastmath=_FASTMATH,
    )  # fmt: skip
    def keep(
        old: FloatArray,
        maf_time: FloatArray,
        maf: FloatArray,
        map_time: FloatArray,
        map_: FloatArray,
        latest: float,
    ) -> FloatArray:
        """Return the samples kept so far together with new ones; nothing else."""
        stamp  # noqa: B018 - see `_stamp`
        work = np.empty(4 * MOST_SAMPLES)
        n_maf, last_maf = _kept(
            old, HEAD, int(old[0]), -math.inf, latest, old[2], maf_time, maf, work, 0
        )
        n_map, last_map = _kept(
            old, HEAD + 2 * int(old[0]), int(old[1]), -math.inf, latest, old[3], map_time, map_,
            work, 2 * MOST_SAMPLES,
        )  # fmt: skip
        return _packed(work, n_maf, n_map, last_maf, last_map, 0, 0)

    return keep


def _advance(stamp: int) -> Any:
    @njit(
        _tuple((types.float64[::1], types.float64[::1], types.int64, types.int64, types.int64,
                     types.float64))(
            _OWN, _OWN, _ROW, _ROW, _ROW, _ROW, types.float64, types.float64, types.float64,
            types.float64, types.float64, types.float64, _ROW, _ROW, _ROW, _OWN, _OWN_TABLE, _OWN,
            types.boolean, _OWN,
        ),
        cache=True, nogil=True, error_model="numpy", fastmath=_FASTMATH,
    )  # fmt: skip
    def advance(
        numbers: FloatArray,
        old: FloatArray,
        maf_time: FloatArray,
        maf: FloatArray,
        map_time: FloatArray,
        map_: FloatArray,
        latest: float,
        before: float,
        start: float,
        end: float,
        predicted: float,
        predicted_1: float,
        shares: FloatArray,
        shares_1: FloatArray,
        shares_2: FloatArray,
        x: FloatArray,
        P: FloatArray,
        carry: FloatArray,
        fresh: bool,
        out: FloatArray,
    ) -> tuple[FloatArray, FloatArray, int, int, int, float]:
        """Keep the samples, predict a window and weigh what its samples say.

        Writes prior and measurement to `out` (RESULTS,). Returns the samples that later windows
        need, the carry, what came of the window, the numbers of samples used and rejected, and the
        normalised innovation.
        """
        stamp  # noqa: B018 - see `_stamp`
        work = np.empty(4 * MOST_SAMPLES)
        delay = numbers[MAF_DELAY] if fresh else x[DELAY]
        maf_start, map_start = start + delay, start + numbers[MAP_DELAY]
        if not fresh:
            # A sample that the window before left over stays, though the delay learnt since
            # then places it before this one.
            maf_start -= (end - start) / PARTS
        n_maf, last_maf = _kept(
            old, HEAD, int(old[0]), maf_start, latest, old[2], maf_time, maf, work, 0
        )
        n_map, last_map = _kept(
            old, HEAD + 2 * int(old[0]), int(old[1]), map_start, latest, old[3], map_time, map_,
            work, 2 * MOST_SAMPLES,
        )  # fmt: skip
        inside_maf = inside_map = 0
        while inside_maf < n_maf and work[inside_maf] - delay < end:
            inside_maf += 1
        while inside_map < n_map and work[2 * MOST_SAMPLES + inside_map] - numbers[MAP_DELAY] < end:
            inside_map += 1
        kept = _packed(work, n_maf, n_map, last_maf, last_map, inside_maf, inside_map)

        length = end - start
        expected = math.floor(length * numbers[MAF_RATE] + 1e-6) + numbers[MAF_PER_EVENT]
        fewest = max(LEAST_SHARE * expected, 1.0)
        flow = predicted / length
        prior = out[PRIOR : PRIOR + STATES]
        prior_P = out[COVARIANCE:MEASURED].reshape(STATES, STATES)
        information, scratch = np.empty((STATES, STATES)), np.empty((STATES, STATES))
        vector, at = np.empty(STATES), np.empty(STATES)
        step, change = np.empty(STATES), np.empty(STATES)
        tail = np.empty(CARRY)
        two_before = x[BEFORE]
        if not fresh:
            predict(numbers, x, P, carry, predicted, length, prior, prior_P, scratch)
            fresh = not (sound(prior) and two_before > 0.0 and all_finite(out[COVARIANCE:MEASURED]))
            for i in range(STATES):
                fresh = fresh or not (prior_P[i, i] > 0.0 or (i >= LAG and prior_P[i, i] == 0.0))
        if fresh:
            two_before = predicted_1
            begin(
                numbers, x[AMBIENT], predicted, predicted_1, flow, work, inside_map, prior,
                prior_P,
            )  # fmt: skip

        variance = np.empty(2 * MOST_SAMPLES)
        squares, used = trajectory(
            numbers, before, start, end, two_before, shares, shares_1, shares_2, flow, prior, prior,
            True, prior_P, work, inside_maf, inside_map, variance, information, vector, tail,
        )  # fmt: skip
        flows = 0
        for a in range(inside_maf):
            flows += variance[a] < math.inf
        if 2 * (used - flows) < inside_map:
            # Most MAP samples contradict the ambient pressure: it has jumped, and is set anew.
            prior[AMBIENT] = ambient_of(numbers, prior[AMBIENT], flow, work, inside_map)
            for i in range(STATES):
                prior_P[i, AMBIENT] = prior_P[AMBIENT, i] = 0.0
            prior_P[AMBIENT, AMBIENT] = numbers[AMBIENT_SPREAD] ** 2
            squares, used = trajectory(
                numbers, before, start, end, two_before, shares, shares_1, shares_2, flow, prior,
                prior, True, prior_P, work, inside_maf, inside_map, variance, information, vector,
                tail,
            )  # fmt: skip
            flows = 0
            for a in range(inside_maf):
                flows += variance[a] < math.inf
        rejected = inside_maf + inside_map - used
        innovation = math.nan
        if inside_maf < fewest:
            status = TOO_FEW
        elif flows < fewest:
            status = WILD
        else:
            explained = move(prior_P, information, vector, scratch, step)
            change[:] = step
            for _ in range(MOST_PASSES):
                for i in range(STATES):
                    at[i] = prior[i] + step[i]
                if not (far(change, prior) and sound(at)):
                    break
                squares, used = trajectory(
                    numbers, before, start, end, two_before, shares, shares_1, shares_2, flow, at,
                    prior, False, prior_P, work, inside_maf, inside_map, variance, information,
                    vector, tail,
                )  # fmt: skip
                for i in range(STATES):
                    change[i] = -step[i]
                explained = move(prior_P, information, vector, scratch, step)
                for i in range(STATES):
                    change[i] += step[i]
            innovation = squares - explained
            compress(information, vector, prior, out)
            for i in range(STATES):
                at[i] = prior[i] + step[i]
            good = sound(at) and innovation <= numbers[WINDOW_GATE] * used
            status = UPDATED if good and all_finite(out) and all_finite(tail) else WILD
        if status != UPDATED:
            # The prior stands, and is trusted less.
            trajectory(
                numbers, before, start, end, two_before, shares, shares_1, shares_2, flow, prior,
                prior, True, prior_P, work, 0, 0, variance, information, vector, tail,
            )  # fmt: skip
            prior_P[BEFORE, BEFORE] += (numbers[CHARGE_SPREAD] * prior[BEFORE]) ** 2
            prior_P[OUTPUT, OUTPUT] += (numbers[CHARGE_SPREAD] * prior[OUTPUT]) ** 2
            if not (sound(prior) and all_finite(out[:MEASURED]) and all_finite(tail)):
                status = LOST
        return kept, tail, status, used, rejected, innovation

    return advance


def _inverse(stamp: int) -> Any:
    @njit(
        types.float64[:, ::1](_OWN_TABLE),
        cache=True, nogil=True, error_model="numpy", fastmath=_FASTMATH,
    )  # fmt: skip
    def inverse(matrix: FloatArray) -> FloatArray:
        """Inverse of a positive definite matrix, here that of the innovation (Gauss-Jordan)."""
        stamp  # noqa: B018 - see `_stamp`
        n = matrix.shape[0]
        out = matrix.copy()
        for k in range(n):
            pivot = 1.0 / out[k, k]
            out[k, k] = 1.0
            for j in range(n):
                out[k, j] *= pivot
            for i in range(n):
                if i != k:
                    factor = out[i, k]
                    out[i, k] = 0.0
                    for j in range(n):
                        out[i, j] -= factor * out[k, j]
        return out

    return inverse


keep, advance, inverse = (make(_stamp()) for make in (_keep, _advance, _inverse))
