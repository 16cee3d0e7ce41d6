"""What came of a closed-loop run: signals of each event, errors, imbalance, settling."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import ParameterError, Trace
from plant.kinematics import FloatArray

from .faults import Fault

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


def _not_given() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True)
class ClosedLoopResult:
    """One closed-loop run, `m` events of `n` cylinders.

    Attributes
    ----------
    name : str
        What was run.
    n_cylinders, seed : int
        Number of cylinders; seed of noise and jitter.
    time : ndarray (m,)
        IVO of each event, s since the first.
    cylinder : ndarray (m,) of int
        Cylinder of each event, from 1.
    speed_rpm : ndarray (m,)
        Speed.
    demand, charge, estimate : ndarray (m,)
        Demanded, true and estimated charge, kg; NaN where an event did not end in the run. A
        demand of 0 keeps the valve shut.
    estimate_sigma : ndarray (m,)
        Standard deviation that the estimator gives its estimate, kg.
    pumping_loss : ndarray (m,)
        True pumping loss, J.
    lift_mm, duration_deg : ndarray (m,)
        Command; the repeated one where a computation was missed.
    flow_gain, duration_offset, charge_factor : ndarray (m,)
        Parameters with which the command was made: 1, s, 1.
    limited : ndarray (m,) of bool
        Whether the demand was outside what can be commanded.
    adapted : ndarray (m,) of bool
        Whether something was learnt before the event.
    final_state
        State of the controller after the run; None for a mean of runs.
    throttle_deg : ndarray (m,)
        Throttle angle; NaN if it is not known.
    delivered_lift_mm, delivered_duration_deg : ndarray (m,)
        Motion of the valve, both 0 where it stayed shut; the command if not given.
    told_speed_rpm : ndarray (m,)
        Speed as the controller was told; the true one if not given.
    rate_limited : ndarray (m,) of bool
        Whether the command could not change fast enough.
    mode, alarms : ndarray (m,) of int
        `Mode` and bit mask of `Alarm` of the controller; what was last said where a computation
        was missed.
    faults : tuple of Fault
        What failed.
    trace : Trace or None
        Crank-level signals, if they were kept.
    """

    name: str
    n_cylinders: int
    seed: int
    time: FloatArray = field(repr=False)
    cylinder: np.ndarray = field(repr=False)
    speed_rpm: FloatArray = field(repr=False)
    demand: FloatArray = field(repr=False)
    charge: FloatArray = field(repr=False)
    estimate: FloatArray = field(repr=False)
    estimate_sigma: FloatArray = field(repr=False)
    pumping_loss: FloatArray = field(repr=False)
    lift_mm: FloatArray = field(repr=False)
    duration_deg: FloatArray = field(repr=False)
    flow_gain: FloatArray = field(repr=False)
    duration_offset: FloatArray = field(repr=False)
    charge_factor: FloatArray = field(repr=False)
    limited: np.ndarray = field(repr=False)
    adapted: np.ndarray = field(repr=False)
    final_state: Any = field(default=None, repr=False)
    throttle_deg: FloatArray = field(default_factory=_not_given, repr=False)
    delivered_lift_mm: FloatArray = field(default_factory=_not_given, repr=False)
    delivered_duration_deg: FloatArray = field(default_factory=_not_given, repr=False)
    told_speed_rpm: FloatArray = field(default_factory=_not_given, repr=False)
    rate_limited: np.ndarray = field(default_factory=_not_given, repr=False)
    mode: np.ndarray = field(default_factory=_not_given, repr=False)
    alarms: np.ndarray = field(default_factory=_not_given, repr=False)
    faults: tuple[Fault, ...] = ()
    trace: Trace | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        m = self.demand.size
        usual = {
            "throttle_deg": np.full(m, np.nan),
            "delivered_lift_mm": self.lift_mm,
            "delivered_duration_deg": self.duration_deg,
            "told_speed_rpm": self.speed_rpm,
            "rate_limited": np.zeros(m, dtype=bool),
            "mode": np.zeros(m, dtype=np.int64),
            "alarms": np.zeros(m, dtype=np.int64),
        }
        for name, values in usual.items():
            if not getattr(self, name).size:
                object.__setattr__(self, name, values)

    @property
    def relative_error(self) -> FloatArray:
        """True charge over demand less 1, a row a cycle and a column a cylinder.

        NaN where the demand is 0, and where an event did not end in the run.
        """
        n = self.n_cylinders
        whole_cycles = self.charge.size // n * n
        demand = self.demand[:whole_cycles]
        error = self.charge[:whole_cycles] / np.where(demand > 0.0, demand, np.nan) - 1.0
        return error.reshape(-1, n)

    @property
    def segments(self) -> tuple[slice, ...]:
        """Stretches of cycles with the same demand, of the same cylinders."""
        demand = self._demands
        shut = self.demand[: demand.size * self.n_cylinders].reshape(demand.size, -1) == 0.0
        changes = (np.diff(demand) != 0.0) | np.any(shut[1:] != shut[:-1], axis=1)
        edges = [0, *(np.flatnonzero(changes) + 1).tolist(), demand.size]
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    def cylinder_errors(self, after_cycles: int = 10, segment: int = -1) -> FloatArray:
        """Relative error of each cylinder, averaged over a segment from some cycle on, (n,).

        NaN of a cylinder whose valve is kept shut.
        """
        return _mean(self._part(after_cycles, segment), 0)

    def worst_error(self, after_cycles: int = 10) -> float:
        """Largest averaged error of a cylinder in any segment, 1; NaN if all valves are shut."""
        errors = [self.cylinder_errors(after_cycles, k) for k in range(len(self.segments))]
        return _largest(np.abs(np.concatenate(errors)))

    def imbalance(self, after_cycles: int = 10, segment: int = -1) -> float:
        """Averaged ``(max - min)/mean`` over the cylinders of a segment that take in air, 1."""
        charge = 1.0 + self.cylinder_errors(after_cycles, segment)
        charge = charge[~np.isnan(charge)]
        if not charge.size:
            return math.nan
        return float((charge.max() - charge.min()) / charge.mean())

    def worst_imbalance(self, after_cycles: int = 10) -> float:
        """Largest averaged imbalance of any segment, 1; NaN if all valves are shut."""
        return _largest(
            np.array([self.imbalance(after_cycles, k) for k in range(len(self.segments))])
        )

    def settling_cycles(
        self, tolerance: float = 0.01, segment: int = -1, average: int = 5
    ) -> int | None:
        """Cycles after which every cylinder stays within a tolerance.

        Each error is averaged over `average` cycles. None if it does not settle.
        """
        part = self._part(0, segment)
        if part.shape[0] < average:
            return None
        windows = np.lib.stride_tricks.sliding_window_view(part, average, axis=0)
        outside = np.flatnonzero(np.any(np.abs(_mean(windows, -1)) > tolerance, axis=1))
        first = 0 if outside.size == 0 else int(outside[-1]) + 1
        return first if first < windows.shape[0] else None

    def to_dataset(self) -> xr.Dataset:
        """Return the signals over events as an `xarray.Dataset` with units."""
        from ._closed_loop_data import event_dataset

        return event_dataset(self)

    def crank_dataset(self) -> xr.Dataset:
        """Return the crank-level signals as an `xarray.Dataset` with units.

        Their time is that of the events: 0 at the first IVO.

        Raises
        ------
        ParameterError
            If none were kept.
        """
        from ._closed_loop_data import crank_dataset

        return crank_dataset(self)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the charge of each cylinder against demand over cycles."""
        from ._closed_loop_plots import plot_charge

        return plot_charge(self, ax)

    def plot_error(self, ax: Axes | None = None, *, limit: float = 0.08) -> Axes:
        """Draw the relative charge error of each cylinder over cycles, up to +-`limit`."""
        from ._closed_loop_plots import plot_error

        return plot_error(self, ax, limit)

    def __str__(self) -> str:
        """Return errors, imbalance and settling of each segment."""
        lines = [f"{self.name} ({self.relative_error.shape[0]} cycles, seed {self.seed})"]
        for k, part in enumerate(self.segments):
            demand = 1e6 * self._demands[part.start]
            after = min(10, (part.stop - part.start) // 2)
            errors = 100.0 * self.cylinder_errors(after, k)
            settled = self.settling_cycles(segment=k)
            lines.append(
                f"  demand {demand:.0f} mg: after {after} cycles errors "
                + ", ".join("shut" if math.isnan(e) else f"{e:+.2f}" for e in errors)
                + f" %, imbalance {100.0 * self.imbalance(after, k):.2f} %; "
                + (
                    "not settled within 1 %"
                    if settled is None
                    else f"within 1 % after {settled} cycles"
                )
            )
        if self.limited.any():
            lines.append(f"  {int(self.limited.sum())} demands were outside what can be commanded")
        lines += [f"  fault: {fault}" for fault in self.faults]
        return "\n".join(lines)

    @property
    def _demands(self) -> FloatArray:
        """Demand of each cycle: that of its first cylinder which is not shut, (cycles,)."""
        n = self.n_cylinders
        rows = self.demand[: self.demand.size // n * n].reshape(-1, n)
        return np.asarray(rows[np.arange(len(rows)), np.argmax(rows != 0.0, axis=1)])

    def _part(self, after_cycles: int, segment: int) -> FloatArray:
        part = self.segments[segment]
        if not 0 <= after_cycles < part.stop - part.start:
            raise ParameterError(
                f"after_cycles is {after_cycles}, but the segment has {part.stop - part.start} "
                "cycles: average from an earlier cycle, or run longer"
            )
        return self.relative_error[part.start + after_cycles : part.stop]


def averaged(runs: Sequence[ClosedLoopResult]) -> ClosedLoopResult:
    """Return the mean of runs that differ in their seed: what noise does not explain.

    Parameters
    ----------
    runs : sequence of ClosedLoopResult
        Runs of the same events.

    Raises
    ------
    ParameterError
        If there are none, or they differ in demand, speed, faults or number of cylinders.
    """
    if not runs:
        raise ParameterError("there are no runs to average: give one or more")
    first = runs[0]
    for run in runs[1:]:
        same = run.n_cylinders == first.n_cylinders
        same = same and np.array_equal(run.demand, first.demand) and run.faults == first.faults
        if not (same and np.array_equal(run.speed_rpm, first.speed_rpm)):
            raise ParameterError(
                f"run {run.name!r} and run {first.name!r} differ in demand, speed, faults or "
                "cylinders: average runs that differ in their seed alone"
            )

    def mean(name: str) -> FloatArray:
        return np.asarray(np.mean([getattr(run, name) for run in runs], axis=0))

    return replace(
        first,
        name=f"{first.name}, mean of {len(runs)} seeds" if len(runs) > 1 else first.name,
        charge=mean("charge"),
        estimate=mean("estimate"),
        estimate_sigma=mean("estimate_sigma"),
        pumping_loss=mean("pumping_loss"),
        lift_mm=mean("lift_mm"),
        duration_deg=mean("duration_deg"),
        flow_gain=mean("flow_gain"),
        duration_offset=mean("duration_offset"),
        charge_factor=mean("charge_factor"),
        limited=np.any([run.limited for run in runs], axis=0),
        adapted=np.any([run.adapted for run in runs], axis=0),
        final_state=first.final_state if len(runs) == 1 else None,
        delivered_lift_mm=mean("delivered_lift_mm"),
        delivered_duration_deg=mean("delivered_duration_deg"),
        told_speed_rpm=mean("told_speed_rpm"),
        rate_limited=np.any([run.rate_limited for run in runs], axis=0),
        mode=np.max([run.mode for run in runs], axis=0),
        alarms=np.bitwise_or.reduce([run.alarms for run in runs], axis=0),
        trace=first.trace if len(runs) == 1 else None,
    )


def _mean(values: np.ndarray, axis: int) -> FloatArray:
    """Mean of what is not NaN; NaN where all is, without a warning."""
    known = ~np.isnan(values)
    mean = np.full(np.any(known, axis=axis).shape, np.nan)
    some = np.any(known, axis=axis)
    mean[some] = np.nanmean(np.moveaxis(values, axis, -1)[some], axis=-1)
    return mean


def _largest(values: FloatArray) -> float:
    """Largest value that is not NaN; NaN if all are."""
    known = values[~np.isnan(values)]
    return float(known.max()) if known.size else math.nan
