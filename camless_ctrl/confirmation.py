"""The robustness verdict put to the test: the controller against sampled full plants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant import CrankAnglePlant, Engine
from plant.sampling import TimeSampling
from plant.sensors import (
    MAF_DELAYS,
    MAF_GAIN_TOLERANCE,
    MAF_TIME_CONSTANTS,
    MafSensor,
    SensorSet,
)

from .closed_loop import simulate
from .controller import AirChargeController
from .cylinder_parameters import ParameterSet
from .feedforward import ChargeMap, Feedforward
from .robustness import MAF_NOMINAL, RobustnessResult
from .window_loop import window_controller

if TYPE_CHECKING:
    from plant.kinematics import FloatArray

FLOW_FACTORS = (0.85, 1.05)  # range of each cylinder's flow factor
SETTLED = 0.01  # largest change of an averaged charge that counts as settled, 1
CLOSE = 0.02  # spectral radii this near to 1 are not decided by a run of this length
_WINDOW = 20  # cycles
_SEED_AMPLITUDE = 2e-3  # of the modal disturbance that growth is measured on


@dataclass(frozen=True, slots=True)
class PlantCheck:
    """One sampled full plant in closed loop, with what was predicted for it."""

    speed_rpm: float
    flow_factors: tuple[float, ...]
    time_constant: float  # s
    delay: float  # s
    gain_error: float  # 1
    predicted_radius: float  # per cycle
    drift: float  # largest change of a cylinder's averaged charge at the end of the run, 1

    @property
    def settled(self) -> bool:
        """Whether the charges came to rest."""
        return self.drift < SETTLED

    @property
    def agrees(self) -> bool:
        """Whether run and prediction agree; a radius close to 1 agrees with either."""
        if abs(self.predicted_radius - 1.0) < CLOSE:
            return True
        return self.settled == (self.predicted_radius < 1.0)

    def __str__(self) -> str:
        """Return the sample, the prediction and the outcome."""
        return (
            f"{self.speed_rpm:g} rpm, lag {1e3 * self.time_constant:.1f} ms, delay "
            f"{1e3 * self.delay:.2f} ms, weakest cylinder {min(self.flow_factors):.2f}: predicted "
            f"radius {self.predicted_radius:.3f}, "
            f"{'settled' if self.settled else 'NOT settled'} (drift {100 * self.drift:.2f} %)"
        )


@dataclass(frozen=True, slots=True)
class GrowthCheck:
    """Growth per cycle of one mode on the full plant, with what was predicted."""

    speed_rpm: float
    q: int
    delay: float  # s
    gain_factor: float  # on the scheduled gains
    predicted: float  # spectral radius per cycle
    simulated: float  # growth per cycle

    @property
    def agrees(self) -> bool:
        """Whether both say stable, both unstable, or both that a held mode stays."""
        if self.predicted == 1.0:
            return abs(self.simulated - 1.0) < CLOSE
        return (self.predicted < 1.0) == (self.simulated < 1.0)

    def __str__(self) -> str:
        """Return both figures and the verdict."""
        verdict = "diverges" if self.simulated >= 1.0 else "decays"
        return (
            f"{self.speed_rpm:g} rpm, mode q={self.q}, delay {1e3 * self.delay:.2f} ms, gain x "
            f"{self.gain_factor:.2f}: predicted {self.predicted:.4f} per cycle, simulated "
            f"{self.simulated:.4f} ({verdict})"
        )


def check_plants(
    results: Sequence[RobustnessResult],
    charge_map: ChargeMap,
    *,
    samples: int = 2,
    cycles: int = 100,
    engine: Engine | None = None,
    seed: int = 0,
) -> list[PlantCheck]:
    """Run the analysed loops against sampled full plants, runner and oscillation on.

    Flow factors, MAF lag, delay and gain are drawn evenly from their ranges; noise is left
    out, so that a drift is the loop's own.

    Parameters
    ----------
    results : sequence of RobustnessResult
        Loops to confirm.
    charge_map : ChargeMap
        Map that the controller believes.
    samples, cycles : int
        Plants per speed, and length of a run.
    engine : Engine, optional
        The engine; the paper's by default.
    seed : int
        Seed of the samples.
    """
    engine = Engine.paper() if engine is None else engine
    random = np.random.default_rng(seed)
    n = engine.n_cylinders
    checks = []
    for result in results:
        for _ in range(samples):
            factors = tuple(random.uniform(*FLOW_FACTORS, n).tolist())
            tau, delay = random.uniform(*MAF_TIME_CONSTANTS), random.uniform(*MAF_DELAYS)
            gain = random.uniform(-MAF_GAIN_TOLERANCE, MAF_GAIN_TOLERANCE)
            plant = CrankAnglePlant(
                engine.replace(cylinder_flow_factors=factors), runner=True, oscillation=True
            )
            run = simulate(
                plant,
                _controller(result, charge_map, engine),
                np.full(n * cycles, result.demand),
                result.speed_rpm,
                sensors=SensorSet(
                    maf=MafSensor(time_constant=tau, delay=delay, gain_error=gain).ideal()
                ),
            )
            last = run.relative_error[:-1]
            before, after = last[-2 * _WINDOW : -_WINDOW], last[-_WINDOW:]
            drift = np.max(np.abs(after.mean(axis=0) - before.mean(axis=0)))
            # An oscillation that does not drift has not settled either.
            swing = np.max(np.ptp(after, axis=0))
            loop = result.loop(time_constant=tau, delay=delay)
            checks.append(
                PlantCheck(
                    result.speed_rpm,
                    factors,
                    tau,
                    delay,
                    gain,
                    max(mode.spectral_radius for mode in loop.modes()),
                    float(max(drift, swing)),
                )
            )
    return checks


def check_growth(
    result: RobustnessResult,
    charge_map: ChargeMap,
    q: int,
    *,
    delay: float = MAF_NOMINAL[1],
    gain_factor: float = 1.0,
    cycles: int = 60,
    engine: Engine | None = None,
) -> GrowthCheck:
    """Measure how a small disturbance of one mode grows on the full plant.

    Parameters
    ----------
    result : RobustnessResult
        Analysed loop.
    charge_map : ChargeMap
        Map that the controller believes.
    q : int
        Mode to disturb.
    delay : float
        Transport delay of the sensor, s.
    gain_factor : float
        Factor on both gains.
    cycles : int
        Length of the run.
    engine : Engine, optional
        The engine, its cylinders equal; the paper's by default.
    """
    engine = Engine.paper() if engine is None else engine
    n = engine.n_cylinders
    plant = CrankAnglePlant(engine, runner=True, oscillation=True)
    controller = _controller(result, charge_map, engine, gain_factor, bounds=(0.11, 5.0))
    balanced = result.local.factor
    wave = np.cos(2.0 * np.pi * q * np.arange(n) / n)
    # The predicted loop reads the flow continuously: at 1 kHz, the place of a sample in the event
    # moves the growth at 6000 rpm by 1 %.
    maf = MafSensor(
        time_constant=MAF_NOMINAL[0], delay=delay, sampling=TimeSampling(0.5e-3)
    ).ideal()

    def run(amplitude: float) -> FloatArray:
        return simulate(
            plant,
            controller,
            np.full(n * cycles, result.demand),
            result.speed_rpm,
            sensors=SensorSet(maf=maf),
            state=controller.initial_state(
                ParameterSet.nominal(n).replace(charge_factor=balanced * (1.0 + amplitude * wave))
            ),
        ).relative_error[:-1]

    # The difference of two runs: what both have in common, such as a bias, drops out.
    difference = run(_SEED_AMPLITUDE) - run(-_SEED_AMPLITUDE)
    size = np.abs(difference @ np.exp(-2j * np.pi * q * np.arange(n) / n)) / n
    linear = np.flatnonzero((size > 1e-7) & (size < 0.1))
    linear = linear[(linear >= 4) & (np.cumprod(np.diff(linear, prepend=-1) == 1) > 0)]
    rate = np.polyfit(linear, np.log(size[linear]), 1)[0] if linear.size > 3 else math.nan
    loop = result.loop(delay=delay, sensitivity=gain_factor * result.local.sensitivity)
    predicted = next(mode.spectral_radius for mode in loop.modes() if mode.q == q)
    if q > 0 and result.gains.imbalance == 0.0:
        predicted = 1.0  # held: what is there stays
    return GrowthCheck(result.speed_rpm, q, delay, gain_factor, predicted, float(np.exp(rate)))


def _controller(
    result: RobustnessResult,
    charge_map: ChargeMap,
    engine: Engine,
    gain_factor: float = 1.0,
    bounds: tuple[float, float] = (0.5, 1.5),
) -> AirChargeController:
    return window_controller(
        Feedforward(charge_map, valvetrain=engine.valvetrain),
        result.estimator,
        result.gains.scaled(gain_factor),
        n_cylinders=engine.n_cylinders,
        bounds=bounds,
    )
