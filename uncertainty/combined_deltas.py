"""Deltas together: their superposition, and all at once on one full plant.

Members of a combination are evaluated against one nominal plant: an effect that the nominal
plant of any member leaves out is left out of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from itertools import product
from math import prod
from typing import Any

import numpy as np

from plant import Engine, ParameterError
from plant._checks import one_of, whole

from ._delta_grid import GridSimulator
from ._delta_quantities import QUANTITIES, Quantity
from .delta import Case, Delta, Nominal, PlantDelta, evaluate_cases
from .delta_result import DeltaResult, WorstChange, extreme

LOWEST, HIGHEST = "sum of the lowest", "sum of the highest"


@dataclass(frozen=True)
class CombinedResult(DeltaResult):
    """Result of several deltas together.

    Attributes
    ----------
    members : tuple of DeltaResult
        Results of the members, against the common nominal plant.
    """

    members: tuple[DeltaResult, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class JointResult(CombinedResult):
    """Result of deltas all at once, with what their sum leaves out.

    The dataset holds ``interaction_charge`` and so on as well: the joint change less the sum
    of the members' changes, case by case.
    """

    def interaction(self, quantity: Quantity = "charge") -> WorstChange:
        """Largest interaction in magnitude, of one sign or the other: joint less sum."""
        one_of("quantity", quantity, QUANTITIES)
        values = self.dataset[f"interaction_{quantity}"]
        return extreme(values, np.abs(values.to_numpy()), QUANTITIES[quantity])

    def sentence(self) -> str:
        """Return the changes, and how far the sum of the members misses them."""
        return (
            f"{super().sentence()} The members' changes added up miss the charge by up to "
            f"{self.interaction('charge')} and the loss by up to {self.interaction('loss')}."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return what `DeltaResult.to_dict` does, with the interactions."""
        found = {name: self.interaction(name) for name in QUANTITIES if self._has(name)}
        return {
            **super().to_dict(),
            "interaction": {
                name: {"value": worst.value, "unit": "1", "at": worst.place()}
                for name, worst in found.items()
            },
        }

    def _has(self, quantity: Quantity) -> bool:
        return bool(np.isfinite(self.dataset[f"interaction_{quantity}"].to_numpy()).any())


@dataclass(frozen=True)
class _Combination(Delta):
    deltas: tuple[PlantDelta, ...]

    def __init__(self, deltas: Sequence[Delta]) -> None:
        members: list[PlantDelta] = []
        for delta in deltas:
            if isinstance(delta, SumDelta):
                members += delta.deltas
            elif isinstance(delta, PlantDelta):
                members.append(delta)
            else:
                raise ParameterError(
                    f"a member is {delta!r}, but must be a delta of full plants: combine the "
                    "members of a joint delta instead"
                )
        if not members:
            raise ParameterError("the combination has no member: give one delta or more")
        object.__setattr__(self, "deltas", tuple(members))

    @property
    def nominal(self) -> Nominal:
        """Options of the common nominal plant."""
        return Nominal(
            all(delta.nominal.runner for delta in self.deltas),
            all(delta.nominal.oscillation for delta in self.deltas),
        )

    def _check(self, engine: Engine) -> None:
        names = [p.name for delta in self.deltas for p in delta.parameters(engine)]
        twice = sorted({name for name in names if names.count(name) > 1})
        twice += sorted(
            {d.name for d in self.deltas if sum(e.name == d.name for e in self.deltas) > 1}
        )
        if twice:
            raise ParameterError(
                f"two members vary {', '.join(twice)}, which would count twice: leave it out of one"
            )

    def _members(self, simulator: GridSimulator, nominal: Nominal) -> tuple[DeltaResult, ...]:
        self._check(simulator.engine)
        return tuple(delta.evaluate_on(simulator, nominal) for delta in self.deltas)

    def _list(self) -> str:
        return " + ".join(delta.name for delta in self.deltas)


@dataclass(frozen=True, init=False)
class SumDelta(_Combination):
    """Superposition: the members' envelopes added up, point by point.

    The sum is exact to first order in the changes. What members do to each other is left out;
    `JointDelta` tells how much that is. Its two cases are the sums of the lower and of the
    upper envelopes.

    Parameters
    ----------
    deltas : sequence of Delta
        Members; the members of a sum among them are taken one by one.
    """

    @property
    def name(self) -> str:
        """Short name."""
        return f"sum of {self._list()}"

    @property
    def effect(self) -> str:
        """What changes the plant, in words that begin a sentence."""
        return f"The sum of the changes by {', '.join(d.name for d in self.deltas)}"

    def planned(self, engine: Engine) -> int:
        """Return the number of plants to simulate, at most."""
        return sum(delta.planned(engine) for delta in self.deltas)

    def evaluate_on(self, simulator: GridSimulator, nominal: Nominal) -> CombinedResult:
        """Evaluate on a grid whose simulations are shared, against a nominal plant."""
        members = self._members(simulator, nominal)
        # The dataset of a sum is that of its first member, with two cases of other values.
        dataset = members[0].dataset.isel(case=[0, 0]).assign_coords(case=[LOWEST, HIGHEST])
        for quantity in QUANTITIES:
            ends = [
                np.sum([getattr(member, end)(quantity).to_numpy() for member in members], axis=0)
                for end in ("lower", "upper")
            ]
            dataset[quantity] = dataset[quantity].copy(data=np.stack(ends))
        dataset.attrs["delta"] = self.name
        return CombinedResult(self.name, self.effect, nominal.words, dataset, members)


@dataclass(frozen=True, init=False)
class JointDelta(_Combination):
    """All members at once, on one full plant.

    Its cases are the product of the members' cases. Where these are more than `most_cases`, a
    member takes part with the two cases alone that lower and raise the charge most, and two
    cases with all members' worst ones for the loss are added: then a worse combination may
    exist.

    Parameters
    ----------
    deltas : sequence of Delta
        Members.
    most_cases : int
        Largest number of cases for the full product.
    """

    most_cases: int = 32

    def __init__(self, deltas: Sequence[Delta], most_cases: int = 32) -> None:
        super().__init__(deltas)
        object.__setattr__(self, "most_cases", whole("most_cases", most_cases, 1, 10_000))

    @property
    def name(self) -> str:
        """Short name."""
        return f"{self._list()} at once"

    @property
    def effect(self) -> str:
        """What changes the plant, in words that begin a sentence."""
        return f"The combination of {', '.join(d.name for d in self.deltas)}, all at once,"

    def planned(self, engine: Engine) -> int:
        """Return the number of plants to simulate, at most."""
        first = sum(delta.planned(engine) for delta in self.deltas)
        return first + 1 + max(self.most_cases, 2 ** len(self.deltas) + 2)

    def evaluate_on(self, simulator: GridSimulator, nominal: Nominal) -> JointResult:
        """Evaluate on a grid whose simulations are shared, against a nominal plant."""
        engine = simulator.engine
        members = self._members(simulator, nominal)
        chosen = self._chosen(members)
        known = [
            delta.all_cases(engine, nominal, member)
            for delta, member in zip(self.deltas, members, strict=True)
        ]
        cases = [
            reduce(Case.joined, (table[name] for table, name in zip(known, names, strict=True)))
            for names in chosen
        ]
        parameters = tuple(p for delta in self.deltas for p in delta.parameters(engine))
        result = evaluate_cases(self, simulator, nominal, tuple(cases), parameters)
        dataset = result.dataset
        for quantity in QUANTITIES:
            total = np.zeros(dataset[quantity].shape)
            for k, member in enumerate(members):
                total += member.dataset[quantity].sel(case=[names[k] for names in chosen]).values
            joint = dataset[quantity]
            interaction = joint.copy(data=joint.to_numpy() - total)
            interaction.attrs = {
                "units": "1",
                "long_name": f"{joint.attrs['long_name']}, joint less sum of the members",
            }
            dataset[f"interaction_{quantity}"] = interaction
        return JointResult(result.name, result.effect, result.against, dataset, members)

    def _chosen(self, members: tuple[DeltaResult, ...]) -> list[tuple[str, ...]]:
        """Names of the members' cases that make each joint case."""
        if prod(len(member.cases) for member in members) <= self.most_cases:
            return list(product(*(member.cases for member in members)))
        ends: tuple[Callable[[DeltaResult, Quantity], WorstChange], ...] = (
            DeltaResult.lowest,
            DeltaResult.highest,
        )
        pairs = [
            tuple(dict.fromkeys(end(member, "charge").case for end in ends)) for member in members
        ]
        loss = [tuple(end(member, "loss").case for member in members) for end in ends]
        return list(dict.fromkeys((*product(*pairs), *loss)))
