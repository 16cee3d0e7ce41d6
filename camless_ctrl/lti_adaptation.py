"""A linear time-invariant law on the charge factors: the baseline of robust synthesis.

A law of one input and one output per event (`LtiLaw`, or any `control.StateSpace`) takes the
charge error of the event whose estimate has come and gives ``ln f`` of the cylinder that opens
next, `latency` events after the one that was estimated. How the law is found is told in
`docs/robustness.md`; its use as an adaptation is this project's own.

- *Order of events*: the law knows cylinders by their turn alone. The state of the law is led on
  by one step for each event, also without usable evidence of it; then nothing moves.
- *Bounds*: where the output passes a bound, the state is led back by the smallest change with
  which the output is at the bound (``x - C' (C C')^-1 (u - bound)``). So it does not wind up; for
  a law of integrators this is their projection.
- *Change of law*: between speeds the nearest law holds. A new one starts with the smallest state
  that would give the factors of the next cycle as they are, in the least-squares sense.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from plant._checks import positive, replace_fields, whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray

from .adaptation_laws import (
    AdaptationState,
    AdaptationStep,
    ParameterBounds,
    initial_state,
    screened,
    state_from_dict,
    state_to_dict,
)
from .cylinder_parameters import ParameterSet
from .event_data import ChargeEvidence

if TYPE_CHECKING:
    import control

    from .lti_synthesis import LtiLaw

_NAME = "LTI"
_LARGEST = 1e6  # state beyond which it is started anew: an unstable law without evidence


class LtiMemory(NamedTuple):
    """What the law remembers beside the factors."""

    node: int  # law in use, from 0; -1 before the first event
    next_cylinder: int  # cylinder (from 1) whose event is due; 0 before the first event
    x: FloatArray  # state of the law, read-only


class _Node(NamedTuple):
    A: FloatArray  # (m, m)
    B: FloatArray  # (m,)
    C: FloatArray  # (m,)
    D: float
    back: FloatArray  # (m,) C'/(C C'), zero without states


@dataclass(frozen=True, slots=True)
class LtiAdaptation:
    """Laws per event over speed, from the charge error to ``ln`` charge factor.

    Parameters
    ----------
    systems : tuple of (float, control.StateSpace)
        Speed in rpm and law, speeds rising.
    latency : int
        Events from the IVO of an event to the first IVO at which its estimate is used.
    bounds : ParameterBounds
        Projection set.
    """

    systems: tuple[tuple[float, control.StateSpace], ...] = field(repr=False)
    latency: int = 2
    bounds: ParameterBounds = field(default_factory=ParameterBounds)
    _nodes: tuple[_Node, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        whole("latency", self.latency, 1, 100)
        if not self.systems:
            raise ParameterError("systems is empty, but must have at least one speed and law")
        speeds = [positive("speed", speed, "rpm") for speed, _ in self.systems]
        if any(b <= a for a, b in pairwise(speeds)):
            raise ParameterError(f"the speeds are {speeds} rpm, but must rise: sort the laws")
        object.__setattr__(self, "_nodes", tuple(_node(system) for _, system in self.systems))

    @classmethod
    def of_laws(cls, laws: Sequence[LtiLaw], bounds: ParameterBounds | None = None) -> Self:
        """Return the adaptation of laws that were found for measurements at several speeds.

        Raises
        ------
        ParameterError
            If the measurements do not agree in their latency.
        """
        latencies = {law.measurement.latency for law in laws}
        if len(latencies) != 1:
            raise ParameterError(
                f"the laws have the latencies {sorted(latencies)}, but must have one: take one "
                "adaptation for each"
            )
        systems = sorted(((law.measurement.speed_rpm, law.system) for law in laws), key=_speed)
        return cls(tuple(systems), latencies.pop(), bounds or ParameterBounds())

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a copy is made: a `control.StateSpace` cannot be pickled itself."""
        laws = tuple((speed, (s.A, s.B, s.C, s.D, s.dt)) for speed, s in self.systems)
        return _unpacked, (laws, self.latency, self.bounds)

    def replace(self, **changes: object) -> LtiAdaptation:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def start(self, n_cylinders: int, parameters: ParameterSet | None = None) -> AdaptationState:
        """Return the state before any evidence, from given or nominal parameters."""
        state = initial_state(self.bounds, n_cylinders, parameters)
        return _with(state, state.log_charge_factor, LtiMemory(-1, 0, _read_only(np.empty(0))))

    def update(self, state: AdaptationState, evidence: ChargeEvidence) -> AdaptationStep:
        """Return the state after the evidence of one event; events come in firing order."""
        factors = state.log_charge_factor
        n, cylinder = len(factors), evidence.cylinder
        error, _ = screened(evidence, n)
        if not 1 <= cylinder <= n:
            return AdaptationStep(state, error)
        target = (cylinder - 1 + self.latency) % n
        node, due, x = state.memory
        nearest = self._nearest(evidence.speed_rpm, node)
        law = self._nodes[nearest]
        if nearest != node:
            x = _bumpless(law, factors, target)
        elif due != cylinder:  # events without a word of evidence
            for _ in range((cylinder - due) % n):
                x = law.A.dot(x)
        next_cylinder = cylinder % n + 1
        if error != error:
            memory = LtiMemory(nearest, next_cylinder, _read_only(_bounded(law, law.A.dot(x))))
            return AdaptationStep(_with(state, factors, memory), error)
        low, high = self.bounds.log_charge_factor
        asked = float(law.C.dot(x)) + law.D * error
        given = low if asked < low else high if asked > high else asked
        projected = given != asked
        if projected:
            x = x - law.back * (asked - given)
        x = _bounded(law, law.A.dot(x) + law.B * error)
        moved = given != factors[target]
        if moved:
            factors = (*factors[:target], given, *factors[target + 1 :])
        memory = LtiMemory(nearest, next_cylinder, _read_only(x))
        return AdaptationStep(_with(state, factors, memory), error, projected, moved, True)

    def to_dict(self, state: AdaptationState) -> dict[str, Any]:
        """Return a state as plain lists and numbers, for JSON."""
        node, next_cylinder, x = state.memory
        return state_to_dict(_NAME, state, node=node, next_cylinder=next_cylinder, x=x.tolist())

    def from_dict(self, data: Mapping[str, Any]) -> AdaptationState:
        """Return the state of `to_dict`; raises `ParameterError` for data that do not fit."""
        state = state_from_dict(_NAME, self.bounds, data, "node", "next_cylinder", "x")
        node = whole("node", data["node"], -1, len(self._nodes) - 1)
        due = whole("next_cylinder", data["next_cylinder"], 0, state.n_cylinders)
        x = np.array(data["x"], dtype=float)
        order = 0 if node < 0 else self._nodes[node].B.size
        if x.shape != (order,) or not np.all(np.abs(x) <= _LARGEST):
            raise ParameterError(
                f"x is {x.tolist()}, but must hold {order} numbers up to {_LARGEST:g}: export "
                "the state with the same law"
            )
        return _with(state, state.log_charge_factor, LtiMemory(node, due, _read_only(x)))

    def _nearest(self, speed_rpm: float, node: int) -> int:
        """Return the law that is nearest in speed; the one in use at a speed that is no number."""
        if len(self.systems) == 1:
            return 0
        away = [abs(speed - speed_rpm) for speed, _ in self.systems]
        return away.index(min(away)) if speed_rpm == speed_rpm else max(node, 0)


def _unpacked(
    laws: tuple[tuple[float, tuple[Any, ...]], ...], latency: int, bounds: ParameterBounds
) -> LtiAdaptation:
    """Return the adaptation of laws as matrices."""
    import control

    systems = tuple((speed, control.ss(*matrices)) for speed, matrices in laws)
    return LtiAdaptation(systems, latency, bounds)


def _node(system: control.StateSpace) -> _Node:
    if (system.ninputs, system.noutputs) != (1, 1):
        raise ParameterError(
            f"the law has {system.ninputs} inputs and {system.noutputs} outputs, but must have "
            "one each: from the charge error to the correction, per event"
        )
    A = np.array(system.A, dtype=float)
    B, C = np.array(system.B, dtype=float).ravel(), np.array(system.C, dtype=float).ravel()
    square = float(C @ C)
    return _Node(A, B, C, float(np.asarray(system.D).item()), C / square if square > 0.0 else C)


def _bumpless(law: _Node, factors: tuple[float, ...], target: int) -> FloatArray:
    """Smallest state with which the law gives the factors as they are, from `target` on."""
    n = len(factors)
    rows, row = [], law.C
    for _ in range(n):
        rows.append(row)
        row = row @ law.A
    wanted = np.array([factors[(target + k) % n] for k in range(n)])
    return np.asarray(np.linalg.lstsq(np.array(rows), wanted, rcond=None)[0])


def _bounded(law: _Node, x: FloatArray) -> FloatArray:
    """State, started anew where it has lost all proportion."""
    return x if not x.size or float(np.abs(x).max()) <= _LARGEST else np.zeros_like(law.B)


def _with(state: AdaptationState, factors: tuple[float, ...], memory: LtiMemory) -> AdaptationState:
    return AdaptationState(state.log_flow_gain, state.duration_offset, factors, memory)


def _speed(pair: tuple[float, control.StateSpace]) -> float:
    return pair[0]


def _read_only(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values
