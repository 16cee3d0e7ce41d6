"""The full plant driven by varied commands, and an estimator that watches it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from plant import CrankAnglePlant, Trace, ValveCommand
from plant.errors import ParameterError
from plant.kinematics import FloatArray
from plant.sensors import SensorSet

from .cylinder_parameters import CylinderParameters
from .event_data import EVENTS, ChargeEstimate, EventRecord, Measurement, ModelPoint
from .inflow_shares import inflow_share_slopes, inflow_shares_from_cycle
from .kalman_estimator import KalmanEstimator

_NODES = 15  # durations at which the nominal plant is tabulated
_SHORTEST = 0.3  # of the duration of the operating point


@dataclass(frozen=True)
class NominalCharges:
    """Charges and shares of a plant with equal cylinders at one lift and speed.

    Attributes
    ----------
    duration_deg, charge : ndarray (k,)
        Durations and charges (kg), both rising.
    shares : ndarray (k, EVENTS * PARTS)
        Shares of each.
    slopes : ndarray (EVENTS * PARTS,)
        Their change with ln flow gain, at the duration of the operating point.
    """

    duration_deg: FloatArray
    charge: FloatArray
    shares: FloatArray
    slopes: FloatArray

    @classmethod
    def of(cls, plant: CrankAnglePlant, command: ValveCommand, speed_rpm: float) -> NominalCharges:
        """Tabulate the durations up to that of a command; charges that fall are left out."""
        durations = np.linspace(_SHORTEST, 1.1, _NODES) * command.duration_deg
        rows: list[tuple[float, float, FloatArray]] = []
        for duration in durations[durations <= EVENTS * plant.engine.event_angle_deg]:
            cycle = plant.steady_cycle(
                speed_rpm, command.replace(duration_deg=float(duration)), on_infeasible="limit"
            )
            charge = float(cycle.air_charge[0])
            if charge > (rows[-1][1] if rows else 0.0):
                rows.append((float(duration), charge, inflow_shares_from_cycle(cycle)))
        if len(rows) < 3:
            raise ParameterError(
                f"the charge at {speed_rpm:g} rpm and {command.lift_mm:g} mm does not rise with "
                f"durations up to {command.duration_deg:g} deg: choose another operating point"
            )
        duration, charges, shares = (np.array(column) for column in zip(*rows, strict=True))
        return cls(duration, charges, shares, inflow_share_slopes(plant, command, speed_rpm))

    def duration(self, charge: float) -> float:
        """Duration of a charge (kg), deg; held at the ends of the table."""
        return float(np.interp(charge, self.charge, self.duration_deg))

    def point(
        self, lift_mm: float, duration_deg: float, error: float, flow_gain: float
    ) -> ModelPoint:
        """Return what a charge model with a relative error would say about a command.

        `flow_gain` is what it knows of the cylinder: it changes the shares.
        """
        at = float(np.interp(duration_deg, self.duration_deg, np.arange(self.charge.size)))
        k = min(int(at), self.charge.size - 2)
        part = at - k
        shares = (1.0 - part) * self.shares[k] + part * self.shares[k + 1]
        shares = shares + math.log(flow_gain) * self.slopes
        charge = (1.0 - part) * self.charge[k] + part * self.charge[k + 1]
        return ModelPoint(
            lift_mm, duration_deg, charge * (1.0 + error), False, math.nan, math.nan, shares
        )


@dataclass(frozen=True)
class PlantHistory:
    """Events of a run of the full plant, `m` of them, before any sensor has seen it.

    Attributes
    ----------
    first : Trace
        Periodic cycle before the first event, with which the sensors settle.
    traces : tuple of Trace
        Signals of each event window.
    records : tuple of EventRecord
        What was commanded and predicted; their start counts from the first event.
    charge : ndarray (m,)
        True charge, kg; NaN where the valve was still open at the end.
    length : float
        Event time, s.
    """

    first: Trace = field(repr=False)
    traces: tuple[Trace, ...] = field(repr=False)
    records: tuple[EventRecord, ...] = field(repr=False)
    charge: FloatArray = field(repr=False)
    length: float


def varied_history(
    plant: CrankAnglePlant,
    command: ValveCommand,
    speed_rpm: float,
    *,
    cycles: int,
    variation: float,
    step: float,
    prediction_bias: float,
    prediction_spread: float,
    known_gains: bool,
    trace_step_deg: float,
    seed: int,
) -> PlantHistory:
    """Drive the plant with charges that vary at random; see `check_estimator`."""
    engine = plant.engine
    n = engine.n_cylinders
    nominal = plant.with_engine(engine.replace(cylinder_flow_factors=()))
    table = NominalCharges.of(nominal, command, speed_rpm)
    random = np.random.default_rng(seed)
    factors = engine.cylinder_flow_factors if known_gains else ()
    gains = factors or (1.0,) * n
    base = float(np.interp(command.duration_deg, table.duration_deg, table.charge))
    run = plant.start(speed_rpm, command, event_advance_deg=0.0, on_infeasible="limit")
    first = plant.steady_cycle(speed_rpm, command, on_infeasible="limit").trace_at(trace_step_deg)
    m = cycles * n
    charge = np.full(m, math.nan)
    traces, records = [], []
    length = engine.event_angle_deg / (6.0 * speed_rpm)
    for k in range(m):
        wanted = base * (step if k >= m // 2 else 1.0) * (1.0 + variation * random.normal())
        duration = table.duration(wanted)
        error = prediction_bias + prediction_spread * random.normal()
        event = run.step_event(
            command.replace(duration_deg=duration), trace_step_deg=trace_step_deg
        )
        assert event.trace is not None  # it was asked for
        traces.append(event.trace)
        records.append(
            EventRecord(
                k,
                event.cylinder,
                k * length,
                speed_rpm,
                table.point(command.lift_mm, duration, error, gains[event.cylinder - 1]),
                CylinderParameters(),
                math.nan,
            )
        )
        for done in event.completed:
            opened = k - (k - (done.cylinder - 1)) % n  # its last IVO
            charge[opened] = done.air_charge
    return PlantHistory(first, tuple(traces), tuple(records), charge, length)


@dataclass(frozen=True)
class Watched:
    """What an estimator made of a history: arrays (m,) over events, NaN without an estimate."""

    filtered: FloatArray  # kg
    filtered_variance: FloatArray  # kg2
    smoothed: FloatArray  # kg
    smoothed_variance: FloatArray  # kg2
    innovation: FloatArray  # 1
    degrees: FloatArray  # 1
    used: int  # samples
    rejected: int  # samples


def watch(
    estimator: KalmanEstimator, history: PlantHistory, sensors: SensorSet, seed: int
) -> Watched:
    """Show a history to sensors, and their samples to an estimator, event by event."""
    at_work = sensors.start(seed)
    seen = at_work.observe(history.first)
    settled = 12.0 * max(estimator.maf.time_constant, 1e-3)
    while at_work.maf.state.clock < settled:
        seen = at_work.observe(history.first)
    offset = at_work.maf.state.clock
    m = len(history.traces)
    rows = np.full((6, m), math.nan)
    state = estimator.start()
    used = rejected = 0
    for k, record in enumerate(history.records):
        time = offset + record.start
        measurement = Measurement(
            time, record.speed_rpm, seen.maf.time, seen.maf.value, seen.map.time, seen.map.value
        )
        update = estimator.update(state, measurement)
        state = estimator.commanded(update.state, record._replace(start=time))
        used += update.used_samples
        rejected += update.rejected_samples
        _note(rows[:2], update.filtered)
        _note(rows[2:4], update.smoothed)
        if update.filtered is not None:
            rows[4, update.filtered.event_index] = update.filtered.innovation
            rows[5, update.filtered.event_index] = update.filtered.degrees
        seen = at_work.observe(history.traces[k])
    return Watched(rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], used, rejected)


def _note(rows: FloatArray, estimate: ChargeEstimate | None) -> None:
    if estimate is not None:
        rows[:, estimate.event_index] = estimate.charge, estimate.variance
