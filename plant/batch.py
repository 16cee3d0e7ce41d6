"""Steady cycles of many operating points and engines: broadcast, threaded, labelled."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from . import _batch_kernel as kernel
from ._batch_inputs import CYLINDER, BatchInputs
from ._checks import one_of, positive, truth, whole
from ._engine_numbers import engine_row
from ._progress import Progress
from .errors import ConvergenceError, InfeasibleProfileError, ParameterError, SimulationError
from .kinematics import FloatArray
from .valve import OnInfeasible, ValveCommand

if TYPE_CHECKING:
    from .crank_angle import CrankAnglePlant

OnError = Literal["raise", "nan"]

MOST_CHUNK = 256  # points a task: long enough to hide its cost, short enough to stop soon
TASKS_PER_THREAD = 8  # at least, so that the threads end together
_CHECK_CHUNK = 4096
STATUS_MEANINGS = (  # in the order of the kernel's status
    "ok",
    "runner_collapsed",
    "no_stage_solution",
    "open_at_compression_tdc",
    "not_periodic",
    "out_of_range",
    "infeasible_profile",
    "too_many_steps",
)


@dataclass
class _Results:
    """Arrays that the chunks are written to."""

    air_charge: FloatArray
    pumping_loss: FloatArray
    delivered_lift_mm: FloatArray
    residual: FloatArray
    cycles: FloatArray
    status: NDArray[np.int8] | None


def steady_cycles(
    plant: CrankAnglePlant,
    speed_rpm: ArrayLike | xr.DataArray,
    lift_mm: ArrayLike | xr.DataArray,
    duration_deg: ArrayLike | xr.DataArray,
    opening_deg: ArrayLike | xr.DataArray = 0.0,
    throttle_deg: ArrayLike | xr.DataArray = 90.0,
    *,
    parameters: Mapping[str, ArrayLike | xr.DataArray] | None = None,
    dims: Sequence[str] | None = None,
    per_cylinder: bool = True,
    on_infeasible: OnInfeasible = "raise",
    on_error: OnError = "raise",
    tolerance: float = 1e-10,
    threads: int | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Simulate the steady cycles of `CrankAnglePlant.steady_cycles`, which see."""
    one_of("on_infeasible", on_infeasible, get_args(OnInfeasible))
    one_of("on_error", on_error, get_args(OnError))
    per_cylinder = truth("per_cylinder", per_cylinder)
    tolerance = positive("tolerance", tolerance, "1")
    threads = _usable_cores() if threads is None else whole("threads", threads, 1, 256)
    points = {
        "speed_rpm": speed_rpm,
        "lift_mm": lift_mm,
        "duration_deg": duration_deg,
        "opening_deg": opening_deg,
        "throttle_deg": throttle_deg,
    }
    inputs = BatchInputs.gather(plant.engine, points, parameters or {}, dims)
    batch = _Batch(plant, inputs, on_infeasible, tolerance)
    count, n = inputs.count, plant.engine.n_cylinders
    if on_error == "raise":
        for first in range(0, count, _CHECK_CHUNK):
            batch.solve(first, min(first + _CHECK_CHUNK, count), most_cycles=0)
    width = n if per_cylinder else 1
    results = _Results(
        air_charge=np.empty((count, width)),
        pumping_loss=np.empty((count, width)),
        delivered_lift_mm=np.empty((count, n if inputs.unequal else 1)),
        residual=np.empty(count),
        cycles=np.empty(count),
        status=np.empty(count, np.int8) if on_error == "nan" else None,
    )
    size = min(MOST_CHUNK, max(1, math.ceil(count / (TASKS_PER_THREAD * threads))))

    def work(first: int) -> int:
        last = min(first + size, count)
        values = batch.solve(first, last, most_cycles=None, failures=on_error == "nan")
        _store(results, values, first, last, n)
        return last

    for done in _in_order(work, range(0, count, size), threads):
        if progress is not None:
            progress(done, count)
    return _dataset(batch, results, per_cylinder)


@dataclass(frozen=True)
class _Batch:
    """What the chunks have in common."""

    plant: CrankAnglePlant
    inputs: BatchInputs
    on_infeasible: OnInfeasible
    tolerance: float

    def solve(
        self, first: int, last: int, *, most_cycles: int | None, failures: bool = False
    ) -> FloatArray:
        """Solve a range of points; raise the error of the first that fails, or let it stand."""
        plant, inputs = self.plant, self.inputs
        rows = np.tile(engine_row(plant.engine), (last - first if inputs.parameters else 1, 1))
        for column, values in inputs.parameter_columns(first, last):
            rows[:, column] = values
        points = np.full((last - first, kernel.POINT_COLUMNS), np.nan)
        points[:, kernel.SPEED] = inputs.values("speed_rpm", first, last)
        points[:, kernel.THROTTLE] = inputs.values("throttle_deg", first, last)
        values, _, _ = plant._solve(
            rows,
            points,
            inputs.commands(first, last),
            self.on_infeasible,
            self.tolerance,
            most_cycles,
        )
        if not failures:
            failed = np.flatnonzero(values[:, kernel.STATUS])
            if failed.size:
                raise self.error_at(first + int(failed[0]))
        return values

    def error_at(self, point: int) -> Exception:
        """Error of a point, as `CrankAnglePlant.steady_cycle` words it, with its place."""
        where = self.inputs.place(point)
        at = self.inputs.point(point)
        try:
            plant = self.plant.with_engine(self.inputs.engine_at(point))
            commands = [
                ValveCommand(*triple)
                for triple in self.inputs.commands(point, point + 1).reshape(-1, 3).tolist()
            ]
            plant.steady_cycle(
                at["speed_rpm"],
                commands[0] if len(commands) == 1 else commands,
                at["throttle_deg"],
                on_infeasible=self.on_infeasible,
                tolerance=self.tolerance,
            )
        except InfeasibleProfileError as error:
            return InfeasibleProfileError(f"{where}: {error}", error.highest_lift_mm)
        except (ParameterError, ConvergenceError, SimulationError) as error:
            return type(error)(f"{where}: {error}")
        return SimulationError(f"{where}: the batch refuses what steady_cycle accepts")


def _store(results: _Results, values: FloatArray, first: int, last: int, n: int) -> None:
    part = slice(first, last)
    status = values[:, kernel.STATUS]
    if results.status is not None:
        results.status[part] = status
        values[status != 0.0, 1:] = np.nan
    results.residual[part] = values[:, kernel.RESIDUAL]
    results.cycles[part] = values[:, kernel.WINDOWS] / n
    lift, charge, loss = (
        values[:, kernel.DELIVERED + k * n : kernel.DELIVERED + (k + 1) * n] for k in range(3)
    )
    results.delivered_lift_mm[part] = lift[:, : results.delivered_lift_mm.shape[1]]
    for target, source in ((results.air_charge, charge), (results.pumping_loss, loss)):
        target[part] = source if target.shape[1] == n else source.mean(axis=1, keepdims=True)


def _in_order(work: Callable[[int], int], tasks: Sequence[int], threads: int) -> Iterator[int]:
    """Yield the results of the tasks in their order; few wait, none is left behind."""
    executor = ThreadPoolExecutor(threads)
    waiting: deque[Future[int]] = deque()
    try:
        for task in tasks:
            if len(waiting) > 2 * threads:
                yield waiting.popleft().result()
            waiting.append(executor.submit(work, task))
        while waiting:
            yield waiting.popleft().result()
    finally:
        executor.shutdown(cancel_futures=True)


def _dataset(batch: _Batch, results: _Results, per_cylinder: bool) -> xr.Dataset:
    inputs, plant = batch.inputs, batch.plant
    dims, shape = inputs.dims, inputs.shape

    def variable(
        values: NDArray[Any], long_name: str, units: str, cylinder: bool = False, **attrs: Any
    ) -> xr.Variable:
        place = (*dims, CYLINDER) if cylinder else dims
        whole_shape = (*shape, plant.engine.n_cylinders) if cylinder else shape
        attrs = {"long_name": long_name, "units": units, **attrs}
        return xr.Variable(place, values.reshape(whole_shape), attrs)

    mean = "" if per_cylinder else ", mean over the cylinders"
    values = {
        "air_charge": variable(
            results.air_charge, f"air charge per event{mean}", "kg", per_cylinder
        ),
        "pumping_loss": variable(
            results.pumping_loss, f"pumping loss per event{mean}", "J", per_cylinder
        ),
        "delivered_lift_mm": variable(
            results.delivered_lift_mm, "delivered valve lift", "mm", inputs.unequal
        ),
        "residual": variable(results.residual, "change over the last iteration", "1"),
        "cycles": variable(results.cycles, "cycles simulated", "1"),
    }
    if results.status is not None:
        values["status"] = variable(
            results.status,
            "outcome",
            "1",
            flag_values=np.arange(len(STATUS_MEANINGS), dtype=np.int8),
            flag_meanings=" ".join(STATUS_MEANINGS),
        )
    coordinates = inputs.coordinates()
    if per_cylinder or inputs.unequal:
        coordinates[CYLINDER] = xr.Variable(
            CYLINDER,
            np.arange(1, plant.engine.n_cylinders + 1),
            {"long_name": "cylinder", "units": "1"},
        )
    return xr.Dataset(
        values,
        coordinates,
        {
            "plant_fingerprint": plant.fingerprint,
            "profile": plant.profile,
            "runner": str(plant.runner),
            "oscillation": str(plant.oscillation),
            "orifice": plant.orifice,
            "resolution": plant.resolution,
            "on_infeasible": batch.on_infeasible,
            "tolerance": batch.tolerance,
        },
    )


def _usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
