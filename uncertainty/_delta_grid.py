"""Full plants over the operating grid: what the deltas compare."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant import CrankAnglePlant, Engine, ParameterError, SimulationError
from plant._checks import in_range, positive
from plant._progress import Progress
from plant.kinematics import FloatArray
from plant.region import shortest_deg

from ._delta_quantities import DURATION_STEP_DEG, LIFT_STEP_MM
from .parameters import DURATION_OFFSET, SENSOR_TARGETS, UncertainParameter, UncertaintySet
from .perturbed import PerturbedPlants
from .sampling import Sample

SPEEDS_RPM = (750.0, 1500.0, 2250.0, 3000.0, 3750.0, 4500.0, 5250.0, 6000.0)
LIFTS_MM = (1.0, 2.0, 3.0, 5.0, 7.0)
DURATIONS_DEG = tuple(float(d) for d in range(60, 281, 20))

_TOO_LATE = ("open_at_compression_tdc", "out_of_range")


@dataclass(frozen=True)
class PlantSetting:
    """One full plant: its options, and the parameters that are not as in the engine.

    Attributes
    ----------
    runner, oscillation : bool
        Options of `CrankAnglePlant`.
    values : tuple of (UncertainParameter, float)
        Parameters with their values; sensor fields are not among them.
    """

    runner: bool
    oscillation: bool
    values: tuple[tuple[UncertainParameter, float], ...] = ()

    @classmethod
    def of(
        cls,
        engine: Engine,
        runner: bool,
        oscillation: bool,
        values: Iterable[tuple[UncertainParameter, float]],
    ) -> PlantSetting:
        """Return the setting, free of what changes nothing.

        A ``map.offset`` is the pressure that a model believes: it moves ``ambient_pressure``.
        """
        acting: list[tuple[UncertainParameter, float]] = []
        for parameter, value in values:
            if "map.offset" in parameter.acts_on:
                acting.append(_believed_pressure(engine, parameter, value))
            elif not set(parameter.acts_on) <= set(SENSOR_TARGETS):
                acting.append((parameter, value))
        changed = (pair for pair in acting if not _neutral(*pair))
        return cls(runner, oscillation, tuple(sorted(changed, key=lambda pair: pair[0].name)))

    @property
    def unequal(self) -> bool:
        """Whether the valves have a duration each."""
        return any(
            target.startswith(f"{DURATION_OFFSET}[") for p, _ in self.values for target in p.acts_on
        )


class GridSimulator:
    """Steady cycles of plants at all points of a grid; no plant is simulated twice.

    Parameters
    ----------
    engine : Engine
        The nominal engine.
    speeds_rpm, lifts_mm, durations_deg : sequence of float
        Grid, each rising.
    threads : int
        Threads to simulate on.
    progress : callable, optional
        Called with the number of cycles done and the number in all.

    Raises
    ------
    ParameterError
        If a grid is empty or does not rise, a speed or a duration is not above 0, a lift is not
        the actuator's, or no point is feasible.
    """

    def __init__(
        self,
        engine: Engine,
        speeds_rpm: Sequence[float],
        lifts_mm: Sequence[float],
        durations_deg: Sequence[float],
        threads: int = 2,
        progress: Progress | None = None,
    ) -> None:
        self.engine, self.threads, self._progress = engine, threads, progress
        self.grid = tuple(
            _rising(name, values)
            for name, values in (
                ("speeds_rpm", speeds_rpm),
                ("lifts_mm", lifts_mm),
                ("durations_deg", durations_deg),
            )
        )
        positive("speeds_rpm", float(self.grid[0][0]), "rpm")
        positive("durations_deg", float(self.grid[2][0]), "deg")
        valvetrain = engine.valvetrain
        lifts = valvetrain.lowest_lift_mm, valvetrain.maximum_lift_mm
        for end in (0, -1):
            in_range("lifts_mm", float(self.grid[1][end]), *lifts, "mm")
        speed, lift, duration = np.meshgrid(*self.grid, indexing="ij")
        shortest = shortest_deg(lift, speed, valvetrain)
        self.feasible = duration >= shortest
        if not self.feasible.any():
            raise ParameterError(
                f"no point of the grid is feasible: the longest duration is {duration.max():g} "
                f"deg, but {lift.min():g} mm at {speed.min():g} rpm needs at least "
                f"{np.ceil(10.0 * shortest.min()) / 10.0:.1f} deg: lengthen durations_deg"
            )
        h, k = DURATION_STEP_DEG, LIFT_STEP_MM
        by_duration = duration - h >= shortest
        by_lift = duration >= shortest_deg(lift + k, speed, valvetrain)
        by_lift &= (lift - k >= lifts[0]) & (lift + k <= lifts[1])
        self._masks = (self.feasible, by_duration, by_duration, by_lift, by_lift)
        shifts = ((0.0, 0.0), (0.0, -h), (0.0, h), (-k, 0.0), (k, 0.0))
        pairs = list(zip(self._masks, shifts, strict=True))
        self._points = (
            np.concatenate([speed[mask] for mask, _ in pairs]),
            np.concatenate([lift[mask] + shift for mask, (shift, _) in pairs]),
            np.concatenate([duration[mask] + shift for mask, (_, shift) in pairs]),
        )
        self._cuts = np.cumsum([int(mask.sum()) for mask in self._masks])[:-1]
        self._cache: dict[PlantSetting, FloatArray] = {}
        self._done = self._planned = 0

    def plan(self, plants: int) -> None:
        """Announce that so many plants will be asked for, for the progress."""
        self._planned += plants

    def finish(self) -> None:
        """Report that all is done: fewer plants than planned may have been needed."""
        self._report(self._planned * self._points[0].size)

    def plant(self, runner: bool, oscillation: bool) -> CrankAnglePlant:
        """Return the full plant of the nominal engine."""
        return CrankAnglePlant(self.engine, runner=runner, oscillation=oscillation)

    def values(self, settings: Sequence[PlantSetting]) -> list[FloatArray]:
        """Values of plants, each (quantity, cylinder, speed, lift, duration).

        Quantities are in the order of `QUANTITIES`: charge and loss, each with its slopes by
        duration and by lift. NaN where the nominal valve cannot be
        driven, and where the perturbed one reaches not even its lowest lift.

        Raises
        ------
        ParameterError
            If a valve would be open at the compression TDC.
        SimulationError
            If a plant cannot be simulated at a point.
        """
        groups: dict[tuple[bool, bool, bool], list[PlantSetting]] = {}
        for setting in dict.fromkeys(settings):
            if setting not in self._cache:
                key = setting.runner, setting.oscillation, setting.unequal
                groups.setdefault(key, []).append(setting)
        self._done += len(settings) - sum(map(len, groups.values()))
        for group in groups.values():
            self._simulate(group)
        return [self._cache[setting] for setting in settings]

    def _simulate(self, group: list[PlantSetting]) -> None:
        sample = _sample(group)
        plants = PerturbedPlants(self.plant(group[0].runner, group[0].oscillation), sample)
        count = self._points[0].size

        def report(done: int, _: int) -> None:
            self._report(self._done * count + done)

        result = plants.steady_cycles(
            *self._points, threads=self.threads, on_error="nan", progress=report
        )
        self._check(result["status"].to_numpy(), sample)
        charge, loss = (result[name].to_numpy() for name in ("air_charge", "pumping_loss"))
        for setting, m, e in zip(group, charge, loss, strict=True):
            self._cache[setting] = np.stack([*self._split(m), *self._split(e)])
        self._done += len(group)

    def _split(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values (points, cylinder) as a value and its slopes by duration and by lift."""
        at, shorter, longer, lower, higher = (
            _scatter(part, mask)
            for part, mask in zip(np.split(values, self._cuts), self._masks, strict=True)
        )
        by_duration = (longer - shorter) / (2.0 * DURATION_STEP_DEG)
        return at, by_duration, (higher - lower) / (2.0 * LIFT_STEP_MM)

    def _check(self, status: npt.NDArray[np.int8], sample: Sample) -> None:
        from plant.batch import STATUS_MEANINGS

        allowed = [STATUS_MEANINGS.index(word) for word in ("ok", "infeasible_profile")]
        failed = np.argwhere(~np.isin(status, allowed))
        if not failed.size:
            return
        row, point = (int(i) for i in failed[0])
        meaning = STATUS_MEANINGS[int(status[row, point])]
        speed, lift, duration = (float(axis[point]) for axis in self._points)
        where = (
            f"{meaning.replace('_', ' ')} at {speed:g} rpm, {lift:g} mm, {duration:g} deg with "
            f"{sample.at(row) if len(sample.uncertain) else 'the nominal engine'}"
        )
        if meaning in _TOO_LATE:
            raise ParameterError(
                f"{where}, but a valve must be shut by 360 deg: shorten durations_deg, or narrow "
                "the ranges"
            )
        raise SimulationError(where)

    def _report(self, cycles: int) -> None:
        if self._progress is not None:
            self._progress(cycles, self._planned * self._points[0].size)


def _sample(group: list[PlantSetting]) -> Sample:
    """Sample with a row for each setting; a parameter that it lacks changes nothing."""
    parameters = tuple(dict.fromkeys(p for setting in group for p, _ in setting.values))
    values = np.empty((len(group), len(parameters)))
    for row, setting in zip(values, group, strict=True):
        given = dict(setting.values)
        row[:] = [given.get(p, 1.0 if p.relative else 0.0) for p in parameters]
    return Sample(UncertaintySet(parameters), values)


def _neutral(parameter: UncertainParameter, value: float) -> bool:
    if parameter.relative:
        return value == 1.0
    return value == 0.0 and all(t.startswith(DURATION_OFFSET) for t in parameter.acts_on)


def _believed_pressure(
    engine: Engine, parameter: UncertainParameter, value: float
) -> tuple[UncertainParameter, float]:
    def factor(offset: float) -> float:
        return 1.0 + offset / engine.ambient_pressure

    believed = UncertainParameter(
        parameter.name,
        factor(parameter.low),
        factor(parameter.high),
        factor(parameter.nominal),
        ("ambient_pressure",),
        source=parameter.source,
    )
    return believed, factor(value)


def _rising(name: str, values: Sequence[float]) -> FloatArray:
    grid = np.array(values, dtype=float)
    rising = grid.ndim == 1 and len(grid) > 0 and bool(np.all(np.diff(grid) > 0.0))
    if not rising or not np.isfinite(grid).all():
        raise ParameterError(f"{name} is {grid.tolist()}, but must be rising finite values")
    return grid


def _scatter(values: FloatArray, mask: npt.NDArray[np.bool_]) -> FloatArray:
    """Values (points, cylinder) as (cylinder, *grid), NaN where `mask` is False."""
    full = np.full((values.shape[1], *mask.shape), np.nan)
    full[:, mask] = values.T
    return full
