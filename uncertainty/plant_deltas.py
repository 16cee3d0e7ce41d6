"""Deltas of section 6 and of the parameters: runner, actuator oscillation, engine."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from plant import CrankAnglePlant, Engine
from plant._checks import in_range, truth

from ._delta_cases import corner_cases, cylinder_of, single_cases
from .delta import Case, Nominal, PlantDelta, SameOptionsDelta
from .delta_result import DeltaResult
from .parameters import DURATION_JITTER, DURATION_OFFSET, UncertainParameter, UncertaintySet
from .perturbed import PerturbedPlants
from .sampling import corners

MOST_ENUMERATED = 10  # parameters
JITTER_TOLERANCE = 3.0 * DURATION_JITTER  # s, three sigma

_EXTREMES: tuple[Literal["charge", "loss"], ...] = ("charge", "loss")


@dataclass(frozen=True)
class HelmholtzDelta(PlantDelta):
    """Runner dynamics (section 6.1): nominal without the runner, perturbed with it.

    Cases: the runner as identified, each parameter of it at either bound, and the corners of
    their box. Constant and volume of the runner act as a product (Eq. 5-6), so the corners
    move them together.

    Parameters
    ----------
    ranges : UncertaintySet
        Uncertain parameters of the runner.
    oscillation : bool
        Whether the actuator oscillates, in all plants.
    """

    ranges: UncertaintySet = field(default_factory=UncertaintySet.runner)
    oscillation: bool = False

    def __post_init__(self) -> None:
        truth("oscillation", self.oscillation)

    @property
    def name(self) -> str:
        """Short name."""
        return "Helmholtz runner"

    @property
    def effect(self) -> str:
        """What changes the plant, in words that begin a sentence."""
        return "The Helmholtz resonance of the runner"

    @property
    def nominal(self) -> Nominal:
        """Options of the nominal plant, whose ports see the manifold pressure."""
        return Nominal(False, self.oscillation)

    def cases(self, engine: Engine) -> tuple[Case, ...]:
        """Return the cases."""
        product = ("runner constant", "runner volume")
        found = (
            Case("runner"),
            *single_cases(self.ranges),
            *corner_cases(self.ranges, "runner", together=(product,)),
        )
        return tuple(replace(case, runner=True) for case in found)


@dataclass(frozen=True)
class ActuatorOscillationDelta(PlantDelta):
    """Motion of the actuator (section 6.2): nominal Eq. 20, perturbed Appendix B.

    Cases: the oscillation as in the engine's valvetrain, each parameter of it at either bound,
    and the corners of their box; an offset of the delivered duration of all valves, with the
    simplified profile and with the oscillation as in the valvetrain; and, with the simplified
    profile, the jitter of the duration: one valve that shuts early or late. A valve's event
    starts from exhaust pressure and a runner at rest, so the charge of that one event is that
    of a steady cycle in which this valve is always off.

    Parameters
    ----------
    ranges : UncertaintySet
        Uncertain parameters of the oscillation.
    duration : UncertaintySet
        Offset of the delivered duration; an empty set for none.
    jitter : float
        Jitter of the delivered duration in s, to both sides; 0 for none.
    runner : bool
        Whether the runners resonate, in all plants.
    """

    ranges: UncertaintySet = field(default_factory=UncertaintySet.oscillation)
    duration: UncertaintySet = field(default_factory=UncertaintySet.delivered_duration)
    jitter: float = JITTER_TOLERANCE
    runner: bool = True

    def __post_init__(self) -> None:
        in_range("jitter", self.jitter, 0.0, 0.01, "s")
        truth("runner", self.runner)

    @property
    def name(self) -> str:
        """Short name."""
        return "actuator oscillation"

    @property
    def effect(self) -> str:
        """What changes the plant, in words that begin a sentence."""
        return "The motion of the valve actuator"

    @property
    def nominal(self) -> Nominal:
        """Options of the nominal plant, with the simplified profile."""
        return Nominal(self.runner, False)

    def cases(self, engine: Engine) -> tuple[Case, ...]:
        """Return the cases."""
        moving = (
            Case("oscillation"),
            *single_cases(self.ranges),
            *corner_cases(self.ranges, "oscillation"),
        )
        jitter: tuple[Case, ...] = ()
        if self.jitter > 0.0:
            one = UncertainParameter(
                "duration jitter",
                -self.jitter,
                self.jitter,
                0.0,
                (f"{DURATION_OFFSET}[0]",),
                relative=False,
                unit="s",
                source="assumed: three sigma of one event",
            )
            jitter = single_cases(UncertaintySet((one,)))
        moved = tuple(replace(case, oscillation=True) for case in moving)
        offsets = single_cases(self.duration)
        return (*moved, *offsets, *(moved[0].joined(case) for case in offsets), *jitter)


@dataclass(frozen=True)
class ParametricDelta(SameOptionsDelta):
    """Parameters of the engine: one at a time, and all at once.

    The nominal plant is the engine as given. Cases: each parameter at either bound. From their
    changes follow four more, with all parameters of `ranges` at a bound. The sum of the single
    changes of the charge, or of the loss, is lowest or highest at some point of the grid; there
    all corners of the box are simulated (of more than ten parameters, the one alone that the
    signs of the single changes predict), and the worst corner becomes a case. Its changes are
    true ones, but the point is a linear guess: a worse corner, or a worse point inside the box,
    may exist.

    Parameters
    ----------
    ranges : UncertaintySet
        Uncertain parameters that all cylinders have in common.
    cylinders : UncertaintySet, optional
        What differs from cylinder to cylinder; its cases tell the change of the cylinder
        concerned. By default that of ``UncertaintySet.cylinders``, and of the first cylinder
        alone where all have the same flow factor; an empty set for none.
    runner, oscillation : bool
        Options of all plants.
    """

    ranges: UncertaintySet = field(default_factory=UncertaintySet.engine)
    cylinders: UncertaintySet | None = None
    runner: bool = True
    oscillation: bool = False

    @property
    def name(self) -> str:
        """Short name."""
        return "parameters"

    @property
    def effect(self) -> str:
        """What changes the plant, in words that begin a sentence."""
        return "The uncertainty of the engine's parameters"

    def cases(self, engine: Engine) -> tuple[Case, ...]:
        """Return the cases of one parameter at a time."""
        return single_cases(self.ranges) + single_cases(self._cylinders(engine))

    def further_cases(
        self, engine: Engine, nominal: Nominal, found: DeltaResult
    ) -> tuple[Case, ...]:
        """Return the cases of all parameters at once, by the single changes."""
        if len(self.ranges) < 2:
            return ()
        plant = CrankAnglePlant(engine, runner=nominal.runner, oscillation=nominal.oscillation)
        return tuple(
            self._corner(plant, found, quantity, sign) for quantity in _EXTREMES for sign in (-1, 1)
        )

    def planned(self, engine: Engine) -> int:
        """Return the number of plants to simulate, at most."""
        first = super().planned(engine)  # the nominal plant and the first cases are asked twice
        return first if len(self.ranges) < 2 else 2 * first + 4

    def _corner(
        self,
        plant: CrankAnglePlant,
        found: DeltaResult,
        quantity: Literal["charge", "loss"],
        sign: int,
    ) -> Case:
        names = [f"{p.name} {end}" for p in self.ranges for end in ("low", "high")]
        feasible = found.dataset["feasible"].to_numpy()
        changes = np.nan_to_num(found.only(*names).changes(quantity)[:, feasible])
        ends = sign * changes.reshape(len(self.ranges), 2, -1)  # (parameter, end, point)
        worst = int(ends.max(axis=1).sum(axis=0).argmax())
        best = ends[:, :, worst].argmax(axis=1)
        row = np.where(best == 1, self.ranges.high, self.ranges.low)
        if len(self.ranges) <= MOST_ENUMERATED:
            box = corners(self.ranges)
            i, j, k = (int(axis[worst]) for axis in np.nonzero(feasible))
            speed, lift, duration = (
                found.dataset[dim].to_numpy()[at]
                for dim, at in zip(("speed", "lift", "duration"), (i, j, k), strict=True)
            )
            cycles = PerturbedPlants(plant, box).steady_cycles(
                speed, lift, duration, on_error="nan", per_cylinder=False
            )
            name = {"charge": "air_charge", "loss": "pumping_loss"}[quantity]
            values = sign * cycles[name].to_numpy()[:, 0]
            row = box.values[int(np.nanargmax(values))]
        corner = tuple((p, float(v)) for p, v in zip(self.ranges, row, strict=True))
        return Case(f"all, {quantity} {'highest' if sign > 0 else 'lowest'}", corner)

    def _cylinders(self, engine: Engine) -> UncertaintySet:
        if self.cylinders is not None:
            return self.cylinders
        each = UncertaintySet.cylinders(engine.n_cylinders)
        if len(set(engine.cylinder_flow_factors)) > 1:
            return each
        return UncertaintySet(tuple(p for p in each if cylinder_of(p) == 0))
