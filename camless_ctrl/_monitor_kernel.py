"""Compiled entries of the plausibility monitors. Imported when a monitor is first used.

Their machine code is kept on disk; see `_kernel_stamp` for the stamp that each carries.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numba
import numpy as np

from plant.kinematics import FloatArray

from . import _monitor_layout as k
from . import _monitor_rules as rules
from ._kernel_stamp import stamp_of

_V = "Array(f8, 1, 'C', readonly=True)"
_A = "Array(f8, 1, 'A', readonly=True)"
_TOLD = f"void(f8[::1], i8, i8, f8, {_V})"
_JUDGE = f"void(f8[::1], {_V}, i8, i8, f8, i8, f8, {_A}, {_A}, i8, f8, f8, b1, f8, f8, {_A})"


def _stamp() -> int:
    """Stamp of all that is compiled into the entries."""
    names = ("_monitor_kernel", "_monitor_rules", "_monitor_layout", "alarms", "event_data")
    return stamp_of(Path(__file__).parent / f"{name}.py" for name in names)


def _told(stamp: int) -> Any:
    @numba.njit(_TOLD, cache=True, nogil=True, error_model="numpy")
    def told(values: FloatArray, n: int, cylinder: int, error: float, numbers: FloatArray) -> None:
        """Take in the error of a told duration, s, of a cylinder from 0 (NaN: kept shut)."""
        assert stamp  # is part of the machine code, see `_stamp`
        rows = values[k.HEAD :].reshape(k.ROWS, n)
        rules.take_duration(values, rows, n, cylinder, error, numbers)

    return told


def _judge(stamp: int) -> Any:
    @numba.njit(_JUDGE, cache=True, nogil=True, error_model="numpy")
    def judge(
        values: FloatArray,
        numbers: FloatArray,
        n: int,
        cylinder: int,
        dt: float,
        heard: int,
        late: float,
        maf: FloatArray,
        map_: FloatArray,
        of: int,
        ratio: float,
        innovation: float,
        refused: bool,
        level: float,
        charge: float,
        shares: FloatArray,
    ) -> None:
        """Take in one event and judge; in place.

        `cylinder` opens next, the duration of `heard` is told (-1 for none), `of` has the
        estimate (-1 for none).
        """
        assert stamp  # is part of the machine code, see `_stamp`
        rows, ranked = values[k.HEAD :].reshape(k.ROWS, n), np.empty(n)
        if heard >= 0:
            rules.take_duration(values, rows, n, heard, late, numbers)
        before = int(values[k.ALARMS])
        values[k.EVENTS] += 1.0
        previous, last = values[k.MAF_LAST], (cylinder - 1) % n
        flow = rules.take_readings(values, k.MAF_LAST, maf, dt)
        pressure = rules.take_readings(values, k.MAP_LAST, map_, dt)
        inflow = rules.promised_inflow(values, charge, shares)
        rows[k.FLOW, last], rows[k.DROP, last] = rules.compare_flow(
            values, numbers, dt, inflow, charge, flow, previous
        )
        if charge == 0.0:
            rows[k.RATIO, last] = math.nan
        rows[k.LEVELS, last] = level

        dead = rules.is_dead(values, k.MAP_LAST, numbers, dt, inflow > 0.0)
        rows[k.PRESSURE, last] = math.nan if dead else pressure
        rules.judge_pressure(values, rows, numbers, n, dt, dead, ranked)

        rules.take_ratio(values, rows, n, cylinder, of, ratio, refused, before)
        middle, count = rules.median(rows[k.RATIO], ranked)
        enough = 2 * count >= n
        judged = of if enough and values[k.WAIT] == 0.0 and not before & k.MAF else -1
        suspects = rules.judge_valves(values, rows, numbers, n, cylinder, judged, middle)
        rules.judge_innovations(values, rows, numbers, n, cylinder, innovation, refused, ranked)

        # Valves that scatter are neither a sensor's fault nor a valve's
        scattered = values[k.SPREAD] > (k.SCATTER * numbers[k.ERROR_LIMIT]) ** 2
        dead = rules.is_dead(values, k.MAF_LAST, numbers, dt, True) and inflow > 0.0
        rules.judge_air_flow(
            values, rows, numbers, n, dt, dead, suspects > 0 or scattered, middle, enough, ranked
        )
        rules.judge_durations(values, rows, numbers, n, charge, scattered, ranked)
        rules.follow(values, rows, numbers, n, dt, middle, enough, before, ranked)

    return judge


told, judge = _told(_stamp()), _judge(_stamp())
