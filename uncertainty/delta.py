"""A delta: uncertainty of the plant, evaluated over the operating grid.

A delta compares full plants: a *nominal* one with a list of *cases*, perturbed ones, at every
feasible point of a grid of speed, lift and duration. Its changes are relative to the nominal
plant: they apply to a mean-value plant that was fitted to that one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant import Engine, ParameterError
from plant._checks import truth
from plant._progress import Progress
from plant.kinematics import FloatArray

from ._delta_grid import DURATIONS_DEG, LIFTS_MM, SPEEDS_RPM, GridSimulator, PlantSetting
from ._delta_quantities import QUANTITIES, delta_dataset, references
from .delta_result import DeltaResult
from .parameters import UncertainParameter

if TYPE_CHECKING:
    from .combined_deltas import SumDelta


@dataclass(frozen=True)
class Case:
    """One perturbed plant.

    Parameters
    ----------
    name : str
        Short name, unique in a delta.
    values : tuple of (UncertainParameter, float)
        Parameters off their nominal values.
    runner, oscillation : bool, optional
        Options of the plant; those of the nominal plant where None.
    cylinder : int, optional
        Cylinder whose change is told, from 0; by default the mean over the cylinders.
    """

    name: str
    values: tuple[tuple[UncertainParameter, float], ...] = ()
    runner: bool | None = None
    oscillation: bool | None = None
    cylinder: int | None = None

    @property
    def maf_gain(self) -> float:
        """Gain of the MAF sensor through which the charge is seen, 1."""
        return 1.0 + sum(v for p, v in self.values if "maf.gain_error" in p.acts_on)

    def joined(self, other: Case) -> Case:
        """Return both cases at once.

        Raises
        ------
        ParameterError
            If they tell the change of different cylinders.
        """
        cylinders = {c for c in (self.cylinder, other.cylinder) if c is not None}
        if len(cylinders) > 1:
            raise ParameterError(
                f"the cases {self.name!r} and {other.name!r} are of different cylinders: join "
                "cases of one cylinder"
            )
        return Case(
            f"{self.name} + {other.name}",
            self.values + other.values,
            other.runner if self.runner is None else self.runner,
            other.oscillation if self.oscillation is None else self.oscillation,
            cylinders.pop() if cylinders else None,
        )


@dataclass(frozen=True)
class Nominal:
    """Options of the nominal plant."""

    runner: bool
    oscillation: bool

    @property
    def words(self) -> str:
        """The nominal plant in words."""
        runner = "with" if self.runner else "without"
        profile = "oscillating" if self.oscillation else "simplified"
        return f"the plant {runner} runner and with the {profile} valve profile"


class Delta(ABC):
    """Uncertainty that can be evaluated over the operating grid, and added to another one."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Short name."""

    @property
    @abstractmethod
    def effect(self) -> str:
        """What changes the plant, in words that begin a sentence."""

    @property
    @abstractmethod
    def nominal(self) -> Nominal:
        """Options of the nominal plant."""

    @abstractmethod
    def planned(self, engine: Engine) -> int:
        """Return the number of plants to simulate, at most."""

    @abstractmethod
    def evaluate_on(self, simulator: GridSimulator, nominal: Nominal) -> DeltaResult:
        """Evaluate on a grid whose simulations are shared, against a nominal plant."""

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
        """Evaluate ``(perturbed - nominal)/nominal`` of all cases at the points of a grid.

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
            Its changes are relative to the nominal value, or to a floor where that is smaller
            in magnitude: 50 mg, 1 mg/deg and 10 mg/mm for the charge and its sensitivities,
            0.5 J, 0.01 J/deg and 0.1 J/mm for the loss. Sensitivities are central differences
            over 0.5 deg and 0.05 mm to both sides. A perturbed valve that cannot reach the
            commanded lift turns round early (``on_infeasible="limit"``).

        Raises
        ------
        ParameterError
            If a grid is empty or does not rise, no point of it is feasible, or the engine
            cannot take a parameter.
        """
        engine = Engine.paper() if engine is None else engine
        simulator = GridSimulator(engine, speeds_rpm, lifts_mm, durations_deg, threads, progress)
        simulator.plan(self.planned(engine))
        result = self.evaluate_on(simulator, self.nominal)
        simulator.finish()
        return result

    def __add__(self, other: Delta) -> SumDelta:
        """Return the superposition of two deltas."""
        from .combined_deltas import SumDelta

        if not isinstance(other, Delta):
            return NotImplemented
        return SumDelta((self, other))


class PlantDelta(Delta):
    """Delta whose cases are full plants; a subclass lists them."""

    @abstractmethod
    def cases(self, engine: Engine) -> tuple[Case, ...]:
        """Return the cases."""

    def parameters(self, engine: Engine) -> tuple[UncertainParameter, ...]:
        """Return the parameters that the cases vary."""
        return tuple(dict.fromkeys(p for case in self.cases(engine) for p, _ in case.values))

    def further_cases(
        self, engine: Engine, nominal: Nominal, found: DeltaResult
    ) -> tuple[Case, ...]:
        """Return cases that follow from the changes of the first ones; none by default."""
        return ()

    def planned(self, engine: Engine) -> int:
        """Return the number of plants to simulate, at most."""
        return 1 + len(self.cases(engine))

    def all_cases(self, engine: Engine, nominal: Nominal, result: DeltaResult) -> dict[str, Case]:
        """Return the cases of a result of this delta against a nominal plant, by name."""
        known = (*self.cases(engine), *self.further_cases(engine, nominal, result))
        return {case.name: case for case in known}

    def evaluate_on(self, simulator: GridSimulator, nominal: Nominal) -> DeltaResult:
        """Evaluate on a grid whose simulations are shared, against a nominal plant."""
        engine = simulator.engine
        cases = self.cases(engine)
        found = evaluate_cases(self, simulator, nominal, cases, self.parameters(engine))
        further = self.further_cases(engine, nominal, found)
        if not further:
            return found
        return evaluate_cases(self, simulator, nominal, (*cases, *further), self.parameters(engine))


class SameOptionsDelta(PlantDelta):
    """Delta whose plants all have the same options; a subclass is a dataclass with the two."""

    runner: bool
    oscillation: bool

    def __post_init__(self) -> None:
        truth("runner", self.runner)
        truth("oscillation", self.oscillation)

    @property
    def nominal(self) -> Nominal:
        """Options of all plants."""
        return Nominal(self.runner, self.oscillation)


def evaluate_cases(
    delta: Delta,
    simulator: GridSimulator,
    nominal: Nominal,
    cases: tuple[Case, ...],
    parameters: tuple[UncertainParameter, ...],
) -> DeltaResult:
    """Return the changes of cases against the nominal plant.

    Parameters
    ----------
    delta : Delta
        Gives the result its name and words.
    simulator : GridSimulator
        Engine and grid.
    nominal : Nominal
        The nominal plant.
    cases : tuple of Case
        The perturbed plants.
    parameters : tuple of UncertainParameter
        All that are varied; each is nominal in the cases that do not name it.

    Raises
    ------
    ParameterError
        If there is no case, or two have one name.
    """
    names = [case.name for case in cases]
    if not names or len(set(names)) < len(names):
        raise ParameterError(
            f"{delta.name} has the cases {names}, but must have one or more of different names: "
            "give it uncertain parameters"
        )
    base = Case("nominal", runner=nominal.runner, oscillation=nominal.oscillation)
    settings = [
        PlantSetting.of(
            simulator.engine,
            nominal.runner if case.runner is None else case.runner,
            nominal.oscillation if case.oscillation is None else case.oscillation,
            _values(case, parameters),
        )
        for case in (base, *cases)
    ]
    reference, *perturbed = simulator.values(settings)
    changes = [
        _change(case, reference, values) for case, values in zip(cases, perturbed, strict=True)
    ]
    dataset = delta_dataset(
        names,
        simulator.grid,
        simulator.feasible,
        reference.mean(axis=1),
        np.stack(changes, axis=1),
        {
            "delta": delta.name,
            "nominal": nominal.words,
            "nominal_plant": simulator.plant(nominal.runner, nominal.oscillation).fingerprint,
        },
    )
    return DeltaResult(delta.name, delta.effect, nominal.words, dataset)


def _values(
    case: Case, parameters: tuple[UncertainParameter, ...]
) -> list[tuple[UncertainParameter, float]]:
    given = dict(case.values)
    return [(p, given.get(p, p.nominal)) for p in parameters]


def _change(case: Case, nominal: FloatArray, perturbed: FloatArray) -> FloatArray:
    """Relative change (quantity, speed, lift, duration) of the cylinder concerned."""
    if case.cylinder is None:
        before, after = nominal.mean(axis=1), perturbed.mean(axis=1)
    else:
        before, after = nominal[:, case.cylinder], perturbed[:, case.cylinder]
    gains = [case.maf_gain if name.startswith("charge") else 1.0 for name in QUANTITIES]
    seen = after * np.array(gains)[:, None, None, None]
    return np.asarray((seen - before) / references(before))
