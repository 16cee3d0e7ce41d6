"""Deltas of section 6: how much the mean-value plant errs by an effect that it ignores.

A delta compares two full plants, *nominal* without the effect and *perturbed* with it, over
the operating grid. The reference is the nominal plant: the changes apply to a mean-value plant
that was fitted to the plant without the effect. A map of the plant with the effect has it
inside already.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from plant import CrankAnglePlant, Engine, ParameterError
from plant.region import shortest_deg
from plant.sweep import Progress, sweep

from .delta_result import QUANTITIES, DeltaResult, Quantity

if TYPE_CHECKING:
    import xarray as xr

FloatArray = npt.NDArray[np.float64]

SPEEDS_RPM = (750.0, 1500.0, 2250.0, 3000.0, 3750.0, 4500.0, 5250.0, 6000.0)
LIFTS_MM = (1.0, 2.0, 3.0, 5.0, 7.0)
DURATIONS_DEG = tuple(float(d) for d in range(60, 281, 20))

# Relative changes are taken of the nominal value, or of these where it is smaller.
FLOORS: dict[Quantity, float] = {
    "charge": 50e-6,  # kg per event
    "loss": 0.5,  # J per event
    "sensitivity": 1e-6,  # kg per event and deg
}
UNITS: dict[Quantity, str] = {"charge": "kg", "loss": "J", "sensitivity": "kg/deg"}

SENSITIVITY_STEP_DEG = 1.0  # deg, to both sides


class Delta(Protocol):
    """Uncertainty that can be evaluated over the operating grid."""

    @property
    def name(self) -> str:
        """Short name."""

    def evaluate(
        self,
        engine: Engine | None = None,
        *,
        speeds_rpm: Sequence[float] = SPEEDS_RPM,
        lifts_mm: Sequence[float] = LIFTS_MM,
        durations_deg: Sequence[float] = DURATIONS_DEG,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> DeltaResult:
        """Evaluate the relative changes of charge, loss and sensitivity on a grid."""


class PlantDelta(ABC):
    """Delta between two full plants of one engine; a subclass says which."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Short name."""

    @property
    @abstractmethod
    def effect(self) -> str:
        """The effect, in words that begin a sentence."""

    @abstractmethod
    def nominal(self, engine: Engine) -> CrankAnglePlant:
        """Return the plant without the effect."""

    @abstractmethod
    def perturbed(self, engine: Engine) -> CrankAnglePlant:
        """Return the plant with the effect."""

    def evaluate(
        self,
        engine: Engine | None = None,
        *,
        speeds_rpm: Sequence[float] = SPEEDS_RPM,
        lifts_mm: Sequence[float] = LIFTS_MM,
        durations_deg: Sequence[float] = DURATIONS_DEG,
        threads: int = 2,
        progress: Progress | None = None,
    ) -> DeltaResult:
        """Evaluate ``(perturbed - nominal)/nominal`` at every feasible point of a grid.

        Parameters
        ----------
        engine : Engine, optional
            The paper's by default.
        speeds_rpm, lifts_mm, durations_deg : sequence of float
            Grid, each rising.
        threads : int
            Threads to simulate on.
        progress : callable, optional
            Called with the number of cycles done and the number in all.

        Returns
        -------
        DeltaResult
            Its changes are relative to the nominal value, or to 50 mg, 0.5 J and 1 mg/deg
            where that is smaller in magnitude. The sensitivity is the central difference of
            the charge over 1 deg to both sides; it is NaN as well where only the shorter of
            the two durations is not feasible.

        Raises
        ------
        ParameterError
            If a grid is empty or does not rise, or no point of it is feasible.
        """
        engine = Engine.paper() if engine is None else engine
        grids = [
            _grid(name, values)
            for name, values in (
                ("speeds_rpm", speeds_rpm),
                ("lifts_mm", lifts_mm),
                ("durations_deg", durations_deg),
            )
        ]
        speed, lift, duration = np.meshgrid(*grids, indexing="ij")
        shortest = shortest_deg(lift, speed, engine.valvetrain)
        step = SENSITIVITY_STEP_DEG
        feasible, both_sides = duration >= shortest, duration - step >= shortest
        if not feasible.any():
            raise ParameterError(
                f"no point of the grid is feasible: the longest duration is {duration.max():g} "
                f"deg, but {lift.min():g} mm at {speed.min():g} rpm needs at least "
                f"{np.ceil(10.0 * shortest.min()) / 10.0:.1f} deg: lengthen durations_deg"
            )
        masks = feasible, both_sides, both_sides
        points = [
            np.concatenate([x[mask] for x, mask in zip(axis, masks, strict=True)])
            for axis in ([speed] * 3, [lift] * 3, [duration, duration - step, duration + step])
        ]
        count = len(points[0])

        def values(plant: CrankAnglePlant, done_before: int) -> dict[Quantity, FloatArray]:
            def report(done: int, _: int) -> None:
                if progress is not None:
                    progress(done_before + done, 2 * count)

            results = sweep(plant, *points, threads=threads, progress=report)
            cuts = np.cumsum([int(mask.sum()) for mask in masks])[:-1]
            charge, before, after = np.split(results.air_charge, cuts)
            loss = results.pumping_loss[: cuts[0]]
            return {
                "charge": _scatter(charge, feasible),
                "loss": _scatter(loss, feasible),
                "sensitivity": _scatter((after - before) / (2.0 * step), both_sides),
            }

        nominal = values(self.nominal(engine), 0)
        perturbed = values(self.perturbed(engine), count)
        dataset = _dataset(nominal, perturbed, grids, feasible)
        dataset.attrs.update(
            delta=self.name,
            nominal_plant=self.nominal(engine).fingerprint,
            perturbed_plant=self.perturbed(engine).fingerprint,
        )
        return DeltaResult(self.name, self.effect, dataset)


@dataclass(frozen=True)
class HelmholtzDelta(PlantDelta):
    """Runner dynamics (section 6.1): nominal without the runner, perturbed with it.

    Parameters
    ----------
    oscillation : bool
        Whether the actuator oscillates, in both plants.
    """

    oscillation: bool = False

    @property
    def name(self) -> str:
        """Short name."""
        return "Helmholtz runner"

    @property
    def effect(self) -> str:
        """The effect, in words that begin a sentence."""
        return "The Helmholtz resonance of the runner"

    def nominal(self, engine: Engine) -> CrankAnglePlant:
        """Return the plant whose ports see the manifold pressure."""
        return CrankAnglePlant(engine, runner=False, oscillation=self.oscillation)

    def perturbed(self, engine: Engine) -> CrankAnglePlant:
        """Return the plant with resonating runners."""
        return CrankAnglePlant(engine, runner=True, oscillation=self.oscillation)


@dataclass(frozen=True)
class ActuatorOscillationDelta(PlantDelta):
    """Actuator oscillation (section 6.2): nominal Eq. 20, perturbed Appendix B.

    Amplitude, period and decay are those of the engine's valvetrain.

    Parameters
    ----------
    runner : bool
        Whether the runners resonate, in both plants.
    """

    runner: bool = True

    @property
    def name(self) -> str:
        """Short name."""
        return "actuator oscillation"

    @property
    def effect(self) -> str:
        """The effect, in words that begin a sentence."""
        return "The oscillation of the valve actuator"

    def nominal(self, engine: Engine) -> CrankAnglePlant:
        """Return the plant with the simplified profile."""
        return CrankAnglePlant(engine, runner=self.runner, oscillation=False)

    def perturbed(self, engine: Engine) -> CrankAnglePlant:
        """Return the plant with the oscillating profile."""
        return CrankAnglePlant(engine, runner=self.runner, oscillation=True)


def _grid(name: str, values: Sequence[float]) -> FloatArray:
    grid = np.array(values, dtype=float)
    rising = grid.ndim == 1 and len(grid) > 0 and bool(np.all(np.diff(grid) > 0.0))
    if not rising or not np.isfinite(grid).all():
        raise ParameterError(f"{name} is {grid.tolist()}, but must be rising finite values")
    return grid


def _scatter(values: FloatArray, mask: npt.NDArray[np.bool_]) -> FloatArray:
    """Values on the full grid, NaN where `mask` is False."""
    full = np.full(mask.shape, np.nan)
    full[mask] = values
    return full


def _dataset(
    nominal: dict[Quantity, FloatArray],
    perturbed: dict[Quantity, FloatArray],
    grids: list[FloatArray],
    feasible: npt.NDArray[np.bool_],
) -> xr.Dataset:
    import xarray as xr

    dims = ("speed", "lift", "duration")
    variables: dict[str, Any] = {"feasible": (dims, feasible)}
    for quantity, name in QUANTITIES.items():
        reference = np.maximum(np.abs(nominal[quantity]), FLOORS[quantity])
        change = (perturbed[quantity] - nominal[quantity]) / reference
        floor = f"{FLOORS[quantity]:g} {UNITS[quantity]}"
        variables[quantity] = (
            dims,
            change,
            {
                "units": "1",
                "long_name": f"relative change of the {name}",
                "reference": f"nominal value, or {floor} where its magnitude is smaller",
            },
        )
        variables[f"nominal_{quantity}"] = (
            dims,
            nominal[quantity],
            {"units": UNITS[quantity], "long_name": f"{name} without the effect"},
        )
    units = ("rpm", "mm", "deg")
    return xr.Dataset(
        variables,
        coords={
            dim: (dim, grid, {"units": unit})
            for dim, grid, unit in zip(dims, grids, units, strict=True)
        },
        attrs={"infeasible": "NaN where the duration is too short for the lift at the speed"},
    )
