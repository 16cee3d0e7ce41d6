"""What the full plant does after one valve command in one cycle was another one.

Around periodic operation the command of one event is raised and lowered, and both runs are
advanced event by event until they agree again. Half their difference is free of all that is
even in the change, and of what a cycle that is periodic to rounding only would drift.

The state that a window hands on is the air of the manifold and of the open cylinders. A shut
cylinder forgets its air at its next opening (section 3 of Part I).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plant import ConvergenceError, CrankAnglePlant, Cycle, ValveCommand
from plant import _entries as kernel
from plant import _layout as layout
from plant._kernel_interface import check_status
from plant.kinematics import FloatArray
from plant.valve import OnInfeasible

# The choice of steps can hold two runs apart for ever, by what it makes results jump.
JITTER = 1e-5  # of a charge, at resolution 1
STUCK = 2  # cycles without a difference of half the size after which it is that


@dataclass(frozen=True)
class Pulse:
    """Changes that follow from one changed command, in units of their own.

    Attributes
    ----------
    first : int
        Event of the first charge, counted from the changed one: valves that were open already
        feel it too.
    charge : ndarray (k,)
        Change of the charge of event ``first`` and those after it, kg. An event's charge is
        that of the cylinder that opens in it.
    flow, pressure : ndarray (events, samples)
        Change of the throttle flow (kg/s) and of the manifold pressure (Pa) from the start of
        the changed event on.
    inflow : ndarray (events,)
        Change of the air through the throttle over each event, kg.
    left : float
        Largest change of air that is left at the end, as a share of the largest there was.
    """

    first: int
    charge: FloatArray
    flow: FloatArray
    pressure: FloatArray
    inflow: FloatArray
    left: float


class PeriodicOperation:
    """Periodic operation of a full plant, from which single events can be changed.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant.
    commands : ValveCommand or sequence of n ValveCommand
        Commands of the operation.
    speed_rpm, throttle_deg : float
        Operating point.
    samples : int
        Samples of the throttle flow per event.
    on_infeasible : {"raise", "limit"}
        As for `CrankAnglePlant.steady_cycle`.
    """

    def __init__(
        self,
        plant: CrankAnglePlant,
        commands: ValveCommand | Sequence[ValveCommand],
        speed_rpm: float,
        throttle_deg: float,
        *,
        samples: int,
        on_infeasible: OnInfeasible,
    ) -> None:
        self.cycle: Cycle = plant.steady_cycle(
            speed_rpm, commands, throttle_deg, on_infeasible=on_infeasible
        )
        self._plant, self._on_infeasible = plant, on_infeasible
        self._advance_deg = self.cycle.state.event_advance_deg
        area = plant.engine.throttle.area(self.cycle.throttle_deg)
        self._window = plant._window(self.cycle.speed_rpm, area, samples)
        self._events = [self._event(j, c) for j, c in enumerate(self.cycle.commands)]
        n = plant.engine.n_cylinders
        self._angles = [
            (k - np.arange(n, dtype=float)) % n * plant.engine.event_angle_deg - self._advance_deg
            for k in range(n)
        ]
        self._trace = np.empty((plant._trace_rows, samples))

    @property
    def n(self) -> int:
        """Number of cylinders."""
        return self._plant.engine.n_cylinders

    @property
    def alike(self) -> bool:
        """Whether all cylinders do the same, one event apart."""
        return len(set(self._plant.engine.flow_coefficients)) == 1 and (
            len({(c.lift_mm, c.duration_deg, c.opening_deg) for c in self.cycle.commands}) == 1
        )

    def steady_flow(self) -> FloatArray:
        """Throttle flow of the cycle, (n, samples), kg/s."""
        return self.steady_signals()[0]

    def steady_signals(self, events: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Throttle flow (kg/s) and manifold pressure (Pa) of the cycle, each (events, samples).

        Parameters
        ----------
        events : int, optional
            Events from the first cylinder's on; a whole cycle by default.
        """
        cylinders, manifold = self._start(0)
        found = np.array(
            [
                self._advance(k, self._events[k], cylinders, manifold)
                for k in range(self.n if events is None else events)
            ]
        )
        return found[:, 0], found[:, 1]

    def pulse(
        self,
        j: int,
        raised: ValveCommand,
        lowered: ValveCommand,
        *,
        most_events: int,
        tolerance: float,
    ) -> Pulse:
        """Change the command of cylinder `j` (from 0) in one cycle to both sides.

        Returns half the difference of the two runs, up to where they agree to `tolerance` of
        their largest difference, or no longer approach each other because the choice of steps
        holds them apart by no more than it may.

        Raises
        ------
        ConvergenceError
            If neither is so after `most_events`.
        """
        n, own = self.n, tuple(self._event(j, c) for c in (raised, lowered))
        runs = [self._start(j) for _ in own]
        latest = [-((j - c) % n) or -n for c in range(n)]  # each cylinder's last event
        charges = np.full((2, n + most_events), np.nan)  # from event -n on
        signals: list[FloatArray] = []
        inflows: list[float] = []
        largest = left = 0.0
        least, at = np.inf, 0
        floor = JITTER / self._plant.resolution**3 * float(np.max(self.cycle.air_charge))
        for k in range(most_events):
            opening = (j + k) % n
            latest[opening] = k
            seen, passed = np.empty((2, 2, self._trace.shape[1])), np.empty(2)
            for r, (cylinders, manifold) in enumerate(runs):
                done, before = cylinders[:, layout.COMPLETED].copy(), manifold[layout.INFLOW]
                event = own[r] if k == 0 else self._events[opening]
                seen[r] = self._advance(opening, event, cylinders, manifold)
                passed[r] = manifold[layout.INFLOW] - before
                for c in np.flatnonzero(cylinders[:, layout.COMPLETED] > done):
                    charges[r, n + latest[c]] = cylinders[c, layout.CHARGE]
            signals.append(0.5 * (seen[0] - seen[1]))
            inflows.append(0.5 * float(passed[0] - passed[1]))
            left = 0.5 * _difference(*runs)
            changes = 0.5 * (charges[0] - charges[1])
            known = ~np.isnan(changes)
            largest = max(largest, left, float(np.abs(changes[known]).max(initial=0.0)))
            # Not in the first window: its end is the earliest at which all is felt.
            if k == 0 or not known[n]:
                continue
            if left < 0.5 * least:
                least, at = left, k
            stuck = k - at >= STUCK * n and least <= floor
            if left <= tolerance * largest or stuck:
                end = at if stuck else k
                changes = changes[: n + end + 1]
                first, last = np.flatnonzero(~np.isnan(changes))[[0, -1]]
                flow, pressure = np.array(signals[: end + 1]).swapaxes(0, 1)
                return Pulse(
                    int(first) - n,
                    np.nan_to_num(changes[first : last + 1]),
                    flow,
                    pressure,
                    np.array(inflows[: end + 1]),
                    min(left, least) / largest if largest else 0.0,
                )
        raise ConvergenceError(
            f"a changed command of cylinder {j + 1} is still felt after {most_events / n:g} "
            f"cycles at {self.cycle.speed_rpm:g} rpm, throttle {self.cycle.throttle_deg:g} deg: "
            f"{left / largest:.1e} of its largest effect is left, but at most {tolerance:.1e} may "
            "be: raise most_cycles, the tolerance or, for a difference that stays, the plant's "
            "resolution"
        )

    # -- internals ---------------------------------------------------------------------------

    def _event(self, j: int, command: ValveCommand) -> layout.Event:
        plant = self._plant
        profile = plant.valve_profile(command, self.cycle.speed_rpm, self._on_infeasible)
        return layout.Event(
            j,
            plant._until_opening(command, self._advance_deg),
            profile.delivered_lift_mm,
            float(command.duration_deg),
        )

    def _start(self, j: int) -> tuple[FloatArray, FloatArray]:
        """State at the start of the event of cylinder `j`."""
        state = self.cycle.state
        cylinders, manifold = state.cylinders.copy(), state.manifold.copy()
        for k in range(j):
            self._advance(k, self._events[k], cylinders, manifold)
        return cylinders, manifold

    def _advance(
        self, opening: int, event: layout.Event, cylinders: FloatArray, manifold: FloatArray
    ) -> FloatArray:
        """Advance a state by a window; return throttle flow and pressure in it, (2, samples)."""
        status = kernel.advance_window(
            self._plant._kernel_engine,
            self._window,
            event,
            self._plant._flow_coefficients,
            self._angles[opening],
            cylinders,
            manifold,
            self._trace,
            0,
        )
        check_status(status, self.cycle.speed_rpm)
        return self._trace[[layout.TRACE_THROTTLE, layout.TRACE_PRESSURE]]


def _difference(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> float:
    """Largest difference of the air that two states hand on, kg."""
    (cylinders, manifold), (others, other_manifold) = one, other
    manifolds = abs(manifold[layout.MANIFOLD_MASS] - other_manifold[layout.MANIFOLD_MASS])
    phase, other_phase = cylinders[:, layout.PHASE], others[:, layout.PHASE]
    either = (phase != layout.SHUT) | (other_phase != layout.SHUT)
    masses = np.abs(cylinders[either, layout.MASS] - others[either, layout.MASS])
    return float(max(manifolds, masses.max(initial=0.0)))
