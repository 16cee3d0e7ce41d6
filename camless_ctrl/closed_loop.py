"""The controller in closed loop with the full plant, and what came of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, Engine, ParameterError
from plant.kinematics import FloatArray
from plant.sensors import MafSensor

from .controller import AirChargeController, Measurement
from .feedforward import ChargeMap, Feedforward

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

TRACE_STEP_DEG = 1.0  # deg, of the flow that the sensor is shown; 3 deg biases it by 0.4 %
SETTLING_LAGS = 12.0  # time constants that the sensor is given before the first event

# One weak cylinder, the others within 5 %: true over nominal flow coefficient.
WEAK_CYLINDER = (1.03, 0.85, 0.96, 1.05)


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
    lift_mm, duration_deg : ndarray (m,)
        Command.
    factor : ndarray (m,)
        Charge factor with which the command was made.
    limited : ndarray (m,) of bool
        Whether the demand was outside what can be commanded.
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
    lift_mm: FloatArray = field(repr=False)
    duration_deg: FloatArray = field(repr=False)
    factor: FloatArray = field(repr=False)
    limited: np.ndarray = field(repr=False)

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
            "lift": (self.lift_mm, "mm"),
            "duration": (self.duration_deg, "deg"),
            "factor": (self.factor, "1"),
            "limited": (self.limited, "1"),
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
        limited=np.any([run.limited for run in runs], axis=0),
        charge=mean("charge"),
        estimate=mean("estimate"),
        lift_mm=mean("lift_mm"),
        duration_deg=mean("duration_deg"),
        factor=mean("factor"),
    )


def simulate(
    plant: CrankAnglePlant,
    controller: AirChargeController,
    demand: ArrayLike,
    speed_rpm: ArrayLike,
    *,
    maf: MafSensor | None = None,
    duration_offset: ArrayLike = 0.0,
    duration_jitter: float = 0.0,
    factors: FloatArray | None = None,
    seed: int = 0,
    name: str = "closed loop",
) -> ClosedLoopResult:
    """Run the controller against the full plant, event by event.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant.
    controller : AirChargeController
        The controller.
    demand : array_like (m,)
        Demanded charge of each event, kg.
    speed_rpm : float or array_like (m,)
        Engine speed of each event.
    maf : MafSensor, optional
        The air-flow sensor; the default one if not given.
    duration_offset : float or array_like (n,)
        Error of the delivered duration of each valve, s.
    duration_jitter : float
        Its random part, 1 sigma, s.
    factors : ndarray (n,), optional
        Charge factors to start with; 1 by default.
    seed : int
        Seed of noise and jitter.
    name : str
        What to call the result.

    Returns
    -------
    ClosedLoopResult
        The run starts from the periodic cycle of the first command, the sensor settled.
    """
    n = plant.engine.n_cylinders
    if controller.n_cylinders != n:
        raise ParameterError(
            f"the controller is for {controller.n_cylinders} cylinders, but the engine has {n}"
        )
    demands = np.atleast_1d(np.asarray(demand, dtype=float))
    m = demands.size
    speeds = np.broadcast_to(np.asarray(speed_rpm, dtype=float), (m,))
    offsets = np.broadcast_to(np.asarray(duration_offset, dtype=float), (n,))
    noise_seed, jitter_seed = np.random.SeedSequence(seed).spawn(2)
    jitter = duration_jitter * np.random.default_rng(jitter_seed).standard_normal(m)

    state = controller.initial_state(factors)
    commands = [
        controller.feedforward.command(demands[0] / f, float(speeds[0])).command
        for f in state.factors
    ]
    run = plant.start(float(speeds[0]), commands, event_advance_deg=0.0)
    sensor = (MafSensor() if maf is None else maf).start(noise_seed)
    cycle = plant.steady_cycle(float(speeds[0]), commands).trace_at(TRACE_STEP_DEG)
    lasting = SETTLING_LAGS * sensor.sensor.time_constant + sensor.sensor.delay
    samples = sensor.observe(cycle)
    while sensor.state.clock < lasting:
        samples = sensor.observe(cycle)

    names = ("time", "charge", "estimate", "lift_mm", "duration_deg", "factor", "limited")
    out = {key: np.full(m, math.nan) for key in names}
    for k in range(m):
        measurement = Measurement(sensor.state.clock, float(speeds[k]), samples.time, samples.value)
        step = controller.step(state, measurement, float(demands[k]))
        state, command = step.state, step.command
        late = 6.0 * speeds[k] * (offsets[k % n] + jitter[k])
        event = run.step_event(
            command.replace(duration_deg=command.duration_deg + late),
            speed_rpm=float(speeds[k]),
            trace_step_deg=TRACE_STEP_DEG,
        )
        assert event.trace is not None
        samples = sensor.observe(event.trace)
        out["time"][k] = measurement.time
        out["lift_mm"][k], out["duration_deg"][k] = command.lift_mm, command.duration_deg
        out["factor"][k] = step.diagnostics.factor
        out["limited"][k] = step.diagnostics.limited
        for done in event.completed:
            opened = k - (k - (done.cylinder - 1)) % n  # its last IVO
            if opened >= 0:
                out["charge"][opened] = done.air_charge
        for estimate in step.diagnostics.estimates:
            out["estimate"][estimate.event_index] = estimate.charge
    return ClosedLoopResult(
        name=name,
        n_cylinders=n,
        seed=seed,
        time=out["time"] - out["time"][0],
        cylinder=np.arange(m) % n + 1,
        speed_rpm=speeds.copy(),
        demand=demands,
        charge=out["charge"],
        estimate=out["estimate"],
        lift_mm=out["lift_mm"],
        duration_deg=out["duration_deg"],
        factor=out["factor"],
        limited=out["limited"].astype(bool),
    )


def run_load_step(
    charge_map: ChargeMap,
    *,
    engine: Engine | None = None,
    flow_factors: tuple[float, ...] = WEAK_CYLINDER,
    speed_rpm: float = 1500.0,
    demand_mg: tuple[float, ...] = (170.0, 400.0, 170.0),
    cycles: int = 40,
    maf: MafSensor | None = None,
    seed: int = 0,
    **controller_options: Any,
) -> ClosedLoopResult:
    """Load step with one weak cylinder: runner and actuator oscillation on, sensor real.

    Parameters
    ----------
    charge_map : ChargeMap
        Map that the controller believes, such as a `plant.MeanValuePlant`.
    engine : Engine, optional
        The engine; the paper's by default.
    flow_factors : tuple of float
        True over nominal flow coefficient of each cylinder.
    speed_rpm : float
        Engine speed.
    demand_mg : tuple of float
        Demands in mg per event, each held for `cycles` cycles. The controller starts
        unadapted, with the first.
    cycles : int
        Cycles per demand.
    maf : MafSensor, optional
        Air-flow sensor; the default one if not given.
    seed : int
        Seed of the noise.
    **controller_options
        Passed on to `AirChargeController`.
    """
    base = Engine.paper() if engine is None else engine
    plant = CrankAnglePlant(
        base.replace(cylinder_flow_factors=flow_factors), runner=True, oscillation=True
    )
    controller = AirChargeController(
        Feedforward(charge_map, valvetrain=base.valvetrain),
        n_cylinders=base.n_cylinders,
        **controller_options,
    )
    demand = np.repeat(1e-6 * np.array(demand_mg), cycles * base.n_cylinders)
    steps = " -> ".join(f"{d:g}" for d in demand_mg)
    return simulate(
        plant,
        controller,
        demand,
        speed_rpm,
        maf=maf,
        seed=seed,
        name=f"load step {steps} mg at {speed_rpm:g} rpm, one weak cylinder",
    )
