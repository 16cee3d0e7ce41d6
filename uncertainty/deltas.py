"""The deltas of the paper's engine, and all of them evaluated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

from plant import Engine
from plant._checks import one_of
from plant._progress import Progress

from ._delta_grid import DURATIONS_DEG, LIFTS_MM, SPEEDS_RPM, GridSimulator
from .combined_deltas import CombinedResult, JointDelta, JointResult, SumDelta
from .delta import Case, Delta, Nominal, PlantDelta
from .delta_result import DeltaResult
from .plant_deltas import ActuatorOscillationDelta, HelmholtzDelta, ParametricDelta
from .sensor_delta import ModeChanges, SensorDelta

__all__ = [
    "ActuatorOscillationDelta",
    "AllDeltas",
    "Case",
    "CombinedResult",
    "Delta",
    "HelmholtzDelta",
    "JointDelta",
    "JointResult",
    "ModeChanges",
    "Nominal",
    "ParametricDelta",
    "PlantDelta",
    "SensorDelta",
    "SumDelta",
    "default_deltas",
    "evaluate_all",
]

_Grid = tuple[Sequence[float], Sequence[float], Sequence[float]]


@dataclass(frozen=True)
class AllDeltas:
    """Results of several deltas, each for itself and all together.

    Attributes
    ----------
    results : tuple of DeltaResult
        Each delta against its own nominal plant.
    total : CombinedResult
        Their superposition, against the common nominal plant, on the thinned grid.
    joint : JointResult
        All at once, likewise.
    """

    results: tuple[DeltaResult, ...]
    total: CombinedResult
    joint: JointResult

    def __iter__(self) -> Iterator[DeltaResult]:
        """Return an iterator over the results of the deltas, then sum and joint."""
        return iter((*self.results, self.total, self.joint))

    def __getitem__(self, name: str) -> DeltaResult:
        """Return the result of a delta by its name."""
        names = [result.name for result in self.results]
        return self.results[names.index(one_of("delta", name, names))]

    def records(self) -> list[dict[str, Any]]:
        """Return the records of all results, for a JSON file."""
        return [result.record() for result in self]

    def __str__(self) -> str:
        """Return a sentence for each result."""
        return "\n".join(str(result) for result in self)


def default_deltas() -> tuple[PlantDelta, ...]:
    """Return the deltas of runner, actuator, parameters and sensors, with their defaults."""
    return HelmholtzDelta(), ActuatorOscillationDelta(), ParametricDelta(), SensorDelta()


def evaluate_all(
    engine: Engine | None = None,
    progress: Progress | None = None,
    *,
    deltas: Sequence[PlantDelta] | None = None,
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    lifts_mm: Sequence[float] = LIFTS_MM,
    durations_deg: Sequence[float] = DURATIONS_DEG,
    threads: int = 2,
) -> AllDeltas:
    """Evaluate deltas, each for itself, and their sum and joint.

    Parameters
    ----------
    engine : Engine, optional
        The paper's by default.
    progress : callable, optional
        Called with the number of cycles done and the number in all.
    deltas : sequence of PlantDelta, optional
        `default_deltas` by default.
    speeds_rpm, lifts_mm, durations_deg : sequence of float
        Grid, each rising. Sum and joint are evaluated at every second speed and duration of
        it, the last ones included.
    threads : int
        Threads to simulate on.

    Raises
    ------
    ParameterError
        As for `Delta.evaluate`.
    """
    engine = Engine.paper() if engine is None else engine
    deltas = default_deltas() if deltas is None else tuple(deltas)
    together = SumDelta(deltas), JointDelta(deltas)
    full: _Grid = speeds_rpm, lifts_mm, durations_deg
    thin: _Grid = _every_second(speeds_rpm), lifts_mm, _every_second(durations_deg)
    shares = [
        prod(map(len, grid)) * sum(delta.planned(engine) for delta in part)
        for grid, part in ((full, deltas), (thin, together))
    ]

    def evaluate(grid: _Grid, part: Sequence[Delta], before: int, share: int) -> list[DeltaResult]:
        def report(done: int, total: int) -> None:
            if progress is not None:
                progress(before + done * share // total, sum(shares))

        simulator = GridSimulator(engine, *grid, threads=threads, progress=report)
        simulator.plan(sum(delta.planned(engine) for delta in part))
        results = [delta.evaluate_on(simulator, delta.nominal) for delta in part]
        simulator.finish()
        return results

    results = evaluate(full, deltas, 0, shares[0])
    total, joint = evaluate(thin, together, *shares)
    assert isinstance(joint, JointResult)
    assert isinstance(total, CombinedResult)
    return AllDeltas(tuple(results), total, joint)


def _every_second(axis: Sequence[float]) -> list[float]:
    return list(axis)[::-2][::-1]
