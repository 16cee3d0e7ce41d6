"""What came of a closed-loop run: signals of each event, errors, imbalance, settling."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import ParameterError
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


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
        IVO of each event, s.
    cylinder : ndarray (m,) of int
        Cylinder of each event, from 1.
    speed_rpm : ndarray (m,)
        Speed.
    demand, charge, estimate : ndarray (m,)
        Demanded, true and estimated charge, kg; NaN where an event did not end in the run.
    estimate_sigma : ndarray (m,)
        Standard deviation that the estimator gives its estimate, kg.
    pumping_loss : ndarray (m,)
        True pumping loss, J.
    lift_mm, duration_deg : ndarray (m,)
        Command.
    flow_gain, duration_offset, charge_factor : ndarray (m,)
        Parameters with which the command was made: 1, s, 1.
    limited : ndarray (m,) of bool
        Whether the demand was outside what can be commanded.
    adapted : ndarray (m,) of bool
        Whether something was learnt before the event.
    final_state
        State of the controller after the run; None for a mean of runs.
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

    @property
    def relative_error(self) -> FloatArray:
        """True charge over demand less 1, a row a cycle and a column a cylinder."""
        n = self.n_cylinders
        whole_cycles = self.charge.size // n * n
        error = self.charge[:whole_cycles] / self.demand[:whole_cycles] - 1.0
        return error.reshape(-1, n)

    @property
    def segments(self) -> tuple[slice, ...]:
        """Stretches of cycles with the same demand."""
        demand = self.demand[:: self.n_cylinders][: self.relative_error.shape[0]]
        edges = [0, *(np.flatnonzero(np.diff(demand)) + 1).tolist(), demand.size]
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    def cylinder_errors(self, after_cycles: int = 10, segment: int = -1) -> FloatArray:
        """Relative error of each cylinder, averaged over a segment from some cycle on, (n,)."""
        part = self._part(after_cycles, segment)
        return np.asarray(np.nanmean(part, axis=0))

    def worst_error(self, after_cycles: int = 10) -> float:
        """Largest averaged error of a cylinder in any segment, 1."""
        return max(
            float(np.max(np.abs(self.cylinder_errors(after_cycles, k))))
            for k in range(len(self.segments))
        )

    def imbalance(self, after_cycles: int = 10, segment: int = -1) -> float:
        """Averaged ``(max - min)/mean`` over the cylinders of a segment, 1."""
        charge = 1.0 + self.cylinder_errors(after_cycles, segment)
        return float((charge.max() - charge.min()) / charge.mean())

    def worst_imbalance(self, after_cycles: int = 10) -> float:
        """Largest averaged imbalance of any segment, 1."""
        return max(self.imbalance(after_cycles, k) for k in range(len(self.segments)))

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
        outside = np.flatnonzero(np.max(np.abs(np.nanmean(windows, axis=-1)), axis=1) > tolerance)
        first = 0 if outside.size == 0 else int(outside[-1]) + 1
        return first if first < windows.shape[0] else None

    def to_dataset(self) -> xr.Dataset:
        """Return the signals over events as an `xarray.Dataset` with units."""
        import xarray as xr

        signals: dict[str, tuple[np.ndarray, str]] = {
            "time": (self.time, "s"),
            "cylinder": (self.cylinder, "1"),
            "speed": (self.speed_rpm, "rpm"),
            "demand": (self.demand, "kg"),
            "charge": (self.charge, "kg"),
            "estimate": (self.estimate, "kg"),
            "estimate_sigma": (self.estimate_sigma, "kg"),
            "pumping_loss": (self.pumping_loss, "J"),
            "lift": (self.lift_mm, "mm"),
            "duration": (self.duration_deg, "deg"),
            "flow_gain": (self.flow_gain, "1"),
            "duration_offset": (self.duration_offset, "s"),
            "charge_factor": (self.charge_factor, "1"),
            "limited": (self.limited, "1"),
            "adapted": (self.adapted, "1"),
        }
        return xr.Dataset(
            {name: ("event", data, {"units": unit}) for name, (data, unit) in signals.items()},
            coords={"event": np.arange(self.time.size)},
            attrs={"name": self.name, "n_cylinders": self.n_cylinders, "seed": self.seed},
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the charge of each cylinder against demand over cycles."""
        from plant._plotting import axes, styled

        n = self.n_cylinders
        cycle = np.arange(self.charge.size) / n
        with styled():
            ax = axes(ax, (8.0, 3.8))
            ax.step(cycle, 1e6 * self.demand, "k--", where="post", lw=1.2, label="demand")
            for i in range(1, n + 1):
                of = self.cylinder == i
                ax.plot(cycle[of], 1e6 * self.charge[of], ".-", ms=3, lw=0.9, label=f"cylinder {i}")
            ax.set_xlabel("engine cycle")
            ax.set_ylabel("air charge (mg per event)")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def plot_error(self, ax: Axes | None = None, *, limit: float = 0.08) -> Axes:
        """Draw the relative charge error of each cylinder over cycles, up to +-`limit`."""
        from plant._plotting import axes, styled

        with styled():
            ax = axes(ax, (8.0, 3.2))
            ax.axhspan(-1.0, 1.0, color="0.92", zorder=0, label="within 1 %")
            for i, error in enumerate(self.relative_error.T):
                ax.plot(100.0 * error, ".-", ms=3, lw=0.9, label=f"cylinder {i + 1}")
            ax.set_ylim(-100.0 * limit, 100.0 * limit)
            ax.set_xlabel("engine cycle")
            ax.set_ylabel("charge error (%)")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return errors, imbalance and settling of each segment."""
        lines = [f"{self.name} ({self.relative_error.shape[0]} cycles, seed {self.seed})"]
        for k, part in enumerate(self.segments):
            demand = 1e6 * self.demand[part.start * self.n_cylinders]
            after = min(10, (part.stop - part.start) // 2)
            errors = 100.0 * self.cylinder_errors(after, k)
            settled = self.settling_cycles(segment=k)
            lines.append(
                f"  demand {demand:.0f} mg: after {after} cycles errors "
                + ", ".join(f"{e:+.2f}" for e in errors)
                + f" %, imbalance {100.0 * self.imbalance(after, k):.2f} %; "
                + (
                    "not settled within 1 %"
                    if settled is None
                    else f"within 1 % after {settled} cycles"
                )
            )
        if self.limited.any():
            lines.append(f"  {int(self.limited.sum())} demands were outside what can be commanded")
        return "\n".join(lines)

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
        If there are none, or they differ in demand, speed or number of cylinders.
    """
    if not runs:
        raise ParameterError("there are no runs to average: give one or more")
    first = runs[0]
    for run in runs[1:]:
        same = run.n_cylinders == first.n_cylinders
        same = same and np.array_equal(run.demand, first.demand)
        if not (same and np.array_equal(run.speed_rpm, first.speed_rpm)):
            raise ParameterError(
                f"run {run.name!r} and run {first.name!r} differ in demand, speed or cylinders: "
                "average runs that differ in their seed alone"
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
    )
