"""Cases that the controller's performance is measured in, and the figures that are read off.

Every case is a run of the full plant, runner and actuator oscillation on, with the assumed
sensors and actuators. *Noise-averaged* is the mean over the `AVERAGED` cycles that follow: of
one run, not of many.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from plant import CrankAnglePlant, Engine
from plant.kinematics import FloatArray

from .closed_loop import ValveErrors
from .closed_loop_result import ClosedLoopResult
from .loss_reference import LossReference

AVERAGED = 30  # cycles over which noise is averaged out
JITTER = 0.05e-3  # s, 1 sigma, assumed of the actuator
LATE_VALVE = (0.0, 0.2e-3, 0.0, 0.0)  # s
WEAK_CYLINDER = (1.03, 0.85, 0.96, 1.05)  # true over nominal flow coefficient of each cylinder
LOSS_POINTS = ((120.0, 750.0), (250.0, 1500.0), (350.0, 3000.0), (300.0, 6000.0))  # mg, rpm
LOSS = "pumping loss"  # with which the names of those cases begin
SETTLED = 20  # cycles before losses are averaged
WARM_UP = 60  # cycles before a case that starts adapted
EXHAUST_OVER_AMBIENT = 1e4  # Pa, as in the paper's engine

Figure = Callable[[ClosedLoopResult], float]


@dataclass(frozen=True)
class Bar:
    """One figure of a case and the bound that it must keep.

    Attributes
    ----------
    name : str
        What is measured.
    bound : float
        Bound, %.
    figure : callable
        From a run to the figure, a ratio.
    single : bool
        Whether it is of a single event or cycle under jitter, which comes after the command:
        what the controller itself does is told by the like case without jitter.
    """

    name: str
    bound: float
    figure: Figure = field(repr=False)
    single: bool = False


@dataclass(frozen=True)
class PerformanceCase:
    """A closed-loop run and the bars that are read off it.

    Attributes
    ----------
    name : str
        Name of the case.
    engine : Engine
        The true engine.
    demand : ndarray (m,)
        Demanded charge of each event, kg.
    speed_rpm : ndarray (m,)
        Speed of each event.
    bars : tuple of Bar
        What is measured.
    valves : ValveErrors
        Errors of the actuators.
    """

    name: str
    engine: Engine = field(repr=False)
    demand: FloatArray = field(repr=False)
    speed_rpm: FloatArray = field(repr=False)
    bars: tuple[Bar, ...]
    valves: ValveErrors

    @property
    def plant(self) -> CrankAnglePlant:
        """The true plant."""
        return CrankAnglePlant(self.engine, runner=True, oscillation=True)


def loss_points(engine: Engine | None = None) -> tuple[tuple[float, float], ...]:
    """Demands in kg and speeds in rpm at which the pumping loss is measured."""
    mg = _milligram(Engine.paper() if engine is None else engine)
    return tuple((demand * mg, speed) for demand, speed in LOSS_POINTS)


def performance_cases(
    engine: Engine | None = None, references: Sequence[LossReference] = ()
) -> tuple[PerformanceCase, ...]:
    """Return the cases of the performance table.

    Parameters
    ----------
    engine : Engine, optional
        Nominal engine; the paper's by default. Demands are those of the table, scaled with the
        charge of the ambient in the displaced volume.
    references : sequence of LossReference
        Least losses of its full plant at `loss_points`; without, losses are not measured.
    """
    base = Engine.paper() if engine is None else engine
    mg = _milligram(base)
    n = base.n_cylinders
    weak = base.replace(cylinder_flow_factors=each_of(WEAK_CYLINDER, n))
    late = each_of(LATE_VALVE, n)

    def steady(demand: float, cycles: int) -> FloatArray:
        return np.full(cycles * n, demand * mg)

    def case(
        name: str,
        true: Engine,
        demand: FloatArray,
        speed_rpm: float | FloatArray,
        *bars: Bar,
        offset: tuple[float, ...] | float = 0.0,
        jitter: float = JITTER,
    ) -> PerformanceCase:
        speeds = np.broadcast_to(np.asarray(speed_rpm, dtype=float), demand.shape)
        return PerformanceCase(name, true, demand, speeds, bars, ValveErrors(offset, jitter))

    def settled(after: int, error: float, imbalance: float | None = None) -> tuple[Bar, ...]:
        bars = [Bar(f"every cylinder after {after} cycles", error, _settled_error(after))]
        if imbalance is not None:
            bars.append(
                Bar(f"imbalance after {after} cycles", imbalance, _settled_imbalance(after))
            )
        return tuple(bars)

    def flow(factor: float) -> Engine:
        return base.replace(flow_coefficient=factor * base.flow_coefficient)

    step = np.concatenate(
        [steady(170.0, WARM_UP), steady(400.0, AVERAGED + 10), steady(170.0, AVERAGED + 10)]
    )
    ramp = _ramp(1000.0, 5000.0, 2.0, n)
    warm = np.full(WARM_UP * n, 1000.0)
    after = np.full(5 * n, 5000.0)
    speeds = np.concatenate((warm, ramp, after))
    high = base.replace(
        ambient_pressure=0.75 * base.ambient_pressure,
        exhaust_pressure=0.75 * base.ambient_pressure + EXHAUST_OVER_AMBIENT,
        temperature=320.0,
    )
    return (
        case(
            "demand step 170 - 400 - 170 mg, 1500 rpm, adapted",
            weak,
            step,
            1500.0,
            Bar("first commanded event of every cylinder", 2.0, _first_events, single=True),
            Bar("every cylinder after 3 cycles", 0.5, _settled_error(3, skip=1)),
        ),
        case(
            "the same step, valves without jitter",
            weak,
            step,
            1500.0,
            Bar("first commanded event of every cylinder", 2.0, _first_events),
            jitter=0.0,
        ),
        case(
            "unequal flow -15 %, +-5 %, 1500 rpm",
            weak,
            steady(300.0, 10 + AVERAGED),
            1500.0,
            *settled(10, 1.0, 0.5),
        ),
        case(
            "unequal flow -15 %, +-5 %, 3000 rpm",
            weak,
            steady(300.0, 10 + AVERAGED),
            3000.0,
            *settled(10, 1.0, 0.5),
        ),
        case(
            "unequal flow -15 %, +-5 %, 6000 rpm",
            weak,
            steady(300.0, 60 + AVERAGED),
            6000.0,
            *settled(60, 1.5, 1.0),
        ),
        case("flow +20 %, 1500 rpm", flow(1.2), steady(250.0, 5 + AVERAGED), 1500.0,
             *settled(5, 1.0)),
        case("flow -20 %, 1500 rpm", flow(0.8), steady(250.0, 5 + AVERAGED), 1500.0,
             *settled(5, 1.0)),
        case("one valve 0.2 ms late, 1500 rpm", base, steady(250.0, 10 + AVERAGED), 1500.0,
             *settled(10, 1.0), offset=late),
        case(
            "speed ramp 1000 to 5000 rpm in 2 s, adapted",
            weak,
            np.full(speeds.size, 300.0 * mg),
            speeds,
            Bar("every event", 3.0, _largest_from(WARM_UP, 1), single=True),
            Bar("mean of every cycle", 3.0, _largest_from(WARM_UP, n), single=True),
        ),
        case(
            "the same ramp, valves without jitter",
            weak,
            np.full(speeds.size, 300.0 * mg),
            speeds,
            Bar("every event", 3.0, _largest_from(WARM_UP, 1)),
            jitter=0.0,
        ),
        *(
            case(
                f"altitude 0.75 bar, 320 K, {demand:g} mg, 1500 rpm",
                high,
                steady(demand, 10 + AVERAGED),
                1500.0,
                *settled(10, 1.0),
            )
            for demand in (200.0, 280.0)
        ),
        case(
            "intake 320 K, 350 mg, 1500 rpm",
            base.replace(temperature=320.0),
            steady(350.0, 10 + AVERAGED),
            1500.0,
            *settled(10, 1.0),
        ),
        *(
            case(
                f"{LOSS}, {r.demand / mg:.0f} mg, {r.speed_rpm:g} rpm",
                base,
                np.full((SETTLED + AVERAGED) * n, r.demand),
                r.speed_rpm,
                Bar("over the least of the full plant", 2.0, _loss_excess(r)),
            )
            for r in references
        ),
    )  # fmt: skip


def _milligram(engine: Engine) -> float:
    """What stands for 1 mg of the paper's engine, kg."""
    return 1e-6 * _ambient_charge(engine) / _ambient_charge(Engine.paper())


def _ambient_charge(engine: Engine) -> float:
    """Charge of ambient air in the displaced volume, kg."""
    return (
        engine.ambient_pressure
        * engine.displaced_volume
        / (engine.gas_constant * engine.temperature)
    )


def each_of(four: tuple[float, ...], n: int) -> tuple[float, ...]:
    """Four values, repeated for n cylinders."""
    return tuple(four[i % len(four)] for i in range(n))


def _ramp(first_rpm: float, last_rpm: float, seconds: float, n: int) -> FloatArray:
    """Speeds of the events of a ramp over time."""
    rate, speed, speeds = (last_rpm - first_rpm) / seconds, first_rpm, []
    while speed < last_rpm:
        speeds.append(speed)
        speed += rate * 120.0 / (n * speed)
    return np.array(speeds)


def _settled_error(after: int, skip: int = 0) -> Figure:
    """Largest averaged error of a cylinder some cycles after each change of demand."""

    def figure(run: ClosedLoopResult) -> float:
        return max(
            float(np.max(np.abs(_averages(run, part.start + after))))
            for part in run.segments[skip:]
        )

    return figure


def _settled_imbalance(after: int) -> Figure:
    """Averaged (max - min)/mean of the charges some cycles after the start."""

    def figure(run: ClosedLoopResult) -> float:
        charges = 1.0 + _averages(run, after)
        return float(np.ptp(charges) / charges.mean())

    return figure


def _averages(run: ClosedLoopResult, first: int) -> FloatArray:
    """Error of each cylinder over the cycles that noise is averaged over."""
    return np.asarray(np.nanmean(run.relative_error[first : first + AVERAGED], axis=0))


def _first_events(run: ClosedLoopResult) -> float:
    """Largest error of a cylinder's first event after a change of demand."""
    return float(np.max(np.abs([run.relative_error[p.start] for p in run.segments[1:]])))


def _loss_excess(reference: LossReference) -> Figure:
    """Mean loss over the least one at the charge of each cylinder, less 1."""

    def figure(run: ClosedLoopResult) -> float:
        n = run.n_cylinders
        losses = run.pumping_loss[SETTLED * n : (SETTLED + AVERAGED) * n].reshape(-1, n)
        charges = run.charge[SETTLED * n : (SETTLED + AVERAGED) * n].reshape(-1, n)
        least = reference.at(np.nanmean(charges, axis=0))
        return float(np.mean(np.nanmean(losses, axis=0)) / np.mean(least) - 1.0)

    return figure


def _largest_from(cycle: int, events: int) -> Figure:
    """Largest error from a cycle on, of means over some events."""

    def figure(run: ClosedLoopResult) -> float:
        errors = (run.charge / run.demand - 1.0)[cycle * run.n_cylinders :]
        errors = errors[np.isfinite(errors)]
        groups = errors[: errors.size // events * events].reshape(-1, events)
        return float(np.max(np.abs(groups.mean(axis=1))))

    return figure
