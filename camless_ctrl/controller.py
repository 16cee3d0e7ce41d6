"""The air-charge controller: feedforward of the adapted inverse, once per intake event.

Shortly before an IVO it takes in the samples since the last one, gets the charge of an earlier
event from its estimator, adapts the parameters of that event's cylinder, and commands the valve
that is about to open: the motion of least pumping loss of which the charge model, with the
parameters learnt, promises the demand. The second part of the paper, which describes such a
controller, is known by its abstract alone: the laws are this project's own.

A step is a pure function of (state, measurement, demand). States are immutable, so that a run
can be replayed from any of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from plant._checks import in_range, positive, whole
from plant.errors import ParameterError

from ._event_facts import (
    KEPT,
    charge_evidence,
    event_facts,
    of_index,
    skipped_events,
    with_durations,
    without_pressure,
)
from ._event_timing import MOST_REFUSED, Timing, usable
from .alarms import Alarm
from .command_limits import CommandLimits
from .controller_parts import Adaptation, ChargeModel, Estimator
from .controller_state import ControllerState, ControlStep, Diagnostics, PendingEvent
from .cylinder_parameters import CylinderParameters, ParameterSet
from .event_data import ChargeEstimate, ChargeEvidence, EventRecord, Measurement, ModelPoint
from .fault_reaction import NOTHING_LEARNT, PRESSURE, FaultReaction, Watch

__all__ = ["AirChargeController", "ControlStep", "ControllerState", "Diagnostics"]

_NOMINAL = CylinderParameters()
_DENSITIES = (0.55, 1.25)  # 1, relative densities that are believed
_GUESSES = (-3.0, 0.5)  # ln of a guessed charge over that of the model's own command
_LEAST = 1e-12  # kg, a charge that is out of reach, to whose command nothing is nearer


@dataclass(frozen=True)
class AirChargeController:
    """Feedforward of the adapted inverse, charge estimate, per-cylinder adaptation.

    Parameters
    ----------
    model : ChargeModel
        From charge to command, with the parameters of a cylinder.
    estimator : Estimator
        From samples to charge.
    adaptation : Adaptation
        From charge to parameters.
    n_cylinders : int
        Number of cylinders.
    limits : CommandLimits
        Of the commands and of their rates.
    duration_noise : float
        Noise of a measured duration, 1 sigma, s.
    duration_jitter : float
        Random part of a delivered duration, 1 sigma, s.
    most_duration_error : float
        Measured less commanded duration, s, beyond which a measurement is none.
    ambient_pressure : float
        Ambient pressure of the charge model, Pa.
    density_gain : float
        Share per event by which the density follows the ambient pressure that the estimator
        sees; 0 leaves it at 1.
    speed_range_rpm : (float, float)
        Speeds that are believed; others are replaced by the last one.
    blend_events : int
        Events over which learnt parameters are brought in or taken out, without a bump.
    hold_events : int
        Events for which nothing is learnt after bad samples.
    faults : FaultReaction or None
        Monitors, and what follows from their alarms; None believes every sensor.
    density_jump : float
        Change of the ambient pressure, Pa, that is not followed before the monitors have judged.
    adapt : bool
        False learns nothing: with nominal parameters this is feedforward alone.
    """

    model: ChargeModel
    estimator: Estimator
    adaptation: Adaptation
    n_cylinders: int = 4
    limits: CommandLimits = field(default_factory=CommandLimits)
    duration_noise: float = 0.05e-3
    duration_jitter: float = 0.05e-3
    most_duration_error: float = 1e-3
    ambient_pressure: float = 1e5
    density_gain: float = 0.1
    speed_range_rpm: tuple[float, float] = (100.0, 10_000.0)
    blend_events: int = 40
    hold_events: int = 8
    adapt: bool = True
    faults: FaultReaction | None = None
    density_jump: float = 1500.0

    def __post_init__(self) -> None:
        whole("n_cylinders", self.n_cylinders, 1, 24)
        in_range("duration_noise", self.duration_noise, 0.0, 0.01, "s")
        in_range("duration_jitter", self.duration_jitter, 0.0, 0.01, "s")
        positive("most_duration_error", self.most_duration_error, "s")
        positive("ambient_pressure", self.ambient_pressure, "Pa")
        in_range("density_gain", self.density_gain, 0.0, 1.0, "1")
        positive("speed_range_rpm[0]", self.speed_range_rpm[0], "rpm")
        in_range("speed_range_rpm[1]", self.speed_range_rpm[1], self.speed_range_rpm[0], 1e5, "rpm")
        whole("blend_events", self.blend_events, 1, 100_000)
        whole("hold_events", self.hold_events, 0, 100_000)
        positive("density_jump", self.density_jump, "Pa")
        if self.faults is not None and self.faults.monitor.n_cylinders != self.n_cylinders:
            raise ParameterError(
                f"the monitors are for {self.faults.monitor.n_cylinders} cylinders, but the "
                f"controller is for {self.n_cylinders}: make them of the same engine"
            )

    def replace(self, **changes: Any) -> AirChargeController:
        """Return a copy with the given fields changed."""
        return replace(self, **changes)

    # -- state -------------------------------------------------------------------------------

    def initial_state(
        self, parameters: ParameterSet | None = None, *, density: float = 1.0
    ) -> ControllerState:
        """Return the state before the first event.

        Parameters
        ----------
        parameters : ParameterSet, optional
            What is known of the cylinders; nominal by default.
        density : float
            Density of the intake air over that of the model, 1.
        """
        if parameters is not None and parameters.n_cylinders != self.n_cylinders:
            raise ParameterError(
                f"the parameters are of {parameters.n_cylinders} cylinders, but the controller "
                f"is for {self.n_cylinders}"
            )
        adaptation = self.adaptation.start(self.n_cylinders, parameters)
        return ControllerState(
            0,
            adaptation,
            self.estimator.start(),
            (),
            (None,) * self.n_cylinders,
            1.0,
            in_range("density", density, *_DENSITIES, "1"),
            0,
            0,
            -math.inf,
            math.nan,
            None if self.faults is None else self.faults.start(adaptation),
        )

    def export_state(self, state: ControllerState) -> dict[str, Any]:
        """Return what was learnt as plain data (for JSON), to start warm with."""
        return {
            "n_cylinders": self.n_cylinders,
            "law": type(self.adaptation).__name__,
            "density": state.density,
            "adaptation": self.adaptation.to_dict(state.adaptation),
        }

    def import_state(self, data: Mapping[str, Any]) -> ControllerState:
        """Return a state before the first event that knows what was learnt.

        Raises
        ------
        ParameterError
            If the data are incomplete, or of another number of cylinders or another law.
        """
        missing = [name for name in ("density", "adaptation") if name not in data]
        if missing or not isinstance(data["adaptation"], Mapping):
            raise ParameterError(
                f"the exported state lacks {' and '.join(missing) or 'what was learnt'}: make it "
                "with export_state"
            )
        own = {"n_cylinders": self.n_cylinders, "law": type(self.adaptation).__name__}
        for name, value in own.items():
            if data.get(name) != value:
                raise ParameterError(
                    f"the exported state has {name} {data.get(name)!r}, but this controller has "
                    f"{value!r}: import it into a controller of the same kind"
                )
        fresh = self.initial_state(density=data["density"])
        learnt = self.adaptation.from_dict(data["adaptation"])
        if learnt.parameters.n_cylinders != self.n_cylinders:
            raise ParameterError(
                f"the exported parameters are of {learnt.parameters.n_cylinders} cylinders, but "
                f"this controller has {self.n_cylinders}: import it into one of the same kind"
            )
        watch = None if self.faults is None else self.faults.start(learnt)
        return fresh._replace(adaptation=learnt, watch=watch)

    # -- one event ---------------------------------------------------------------------------

    def step(
        self,
        state: ControllerState,
        measurement: Measurement,
        demand: float,
        *,
        active: bool = True,
    ) -> ControlStep:
        """Return the command of the next event, and the state after it.

        Parameters
        ----------
        state : ControllerState
            State before; not changed.
        measurement : Measurement
            What is known shortly before this IVO; samples are 1-D arrays of floats. Whatever
            numbers it holds, nothing is raised: a time or speed that cannot be is replaced by
            the last one, samples are for estimator and monitors to judge.
        demand : float
            Demanded charge of the event, kg; 0 keeps the valve shut.
        active : bool
            False takes what was learnt out of the commands, and True brings it back, both over
            `blend_events`. Nothing is learnt in between.

        Raises
        ------
        ParameterError
            If the demand is not a number from 0 up.
        """
        if not 0.0 <= demand < math.inf:
            in_range("demand", demand, 0.0, math.inf, "kg")  # says what is wrong
        n = self.n_cylinders
        timing = usable(state, measurement, n, self.speed_range_rpm, self.faults)
        measurement, k = timing.measurement, timing.event_index
        if timing.missed:
            state = self._without_computation(state, timing)
        cylinder, speed, watch = k % n + 1, measurement.speed_rpm, state.watch

        pending = with_durations(state.pending, measurement.durations)
        estimator = state.estimator
        if state.refused >= MOST_REFUSED and not timing.refused:
            estimator = self.estimator.start()  # the clock has been set: what came before is void
        elif watch is not None and watch.starts_anew:
            estimator = self.estimator.start()
        believed = measurement
        if watch is not None and watch.alarms & PRESSURE:
            believed = without_pressure(measurement)
        found = self.estimator.update(estimator, believed)
        final = found.final
        event = None if final is None else of_index(pending, final.event_index)
        if event is None or event.shut:
            final = None
        strange = found.rejected and not (watch is not None and watch.monitor.suspects)
        held = self.hold_events if strange or timing.alarms else max(state.held - 1, 0)

        adaptation, projected, adapted = state.adaptation, False, False
        if self.faults is not None and watch is not None:
            facts = event_facts(timing, cylinder, pending, event, found)
            watch, adaptation = self.faults.judge(
                watch, facts, timing.alarms, measurement.time, adaptation
            )
        learns = self.adapt and active and held == 0
        if final is not None and learns and (watch is None or watch.learns_from(final.cylinder)):
            evidence = self._evidence(event, final)
            if evidence is not None:
                moved = self.adaptation.update(adaptation, evidence)
                adaptation, projected, adapted = moved.state, moved.projected, moved.moved

        change = 1.0 / self.blend_events
        applied = min(max(state.applied + (change if active else -change), 0.0), 1.0)
        density = self._density(state.density, found.ambient_pressure, watch)
        used = _blended(adaptation.of(cylinder), applied)
        commands, before, limited, share = state.commands, state.commands[cylinder - 1], False, 1.0
        if demand == 0.0:
            point, exact = self._shut(speed), False
            lift, duration_deg = 0.0, point.duration_deg
        else:
            if watch is not None and watch.reach < 1.0:
                most = watch.reach * self.model.limits(speed, used, density)[1]
                limited, demand = demand > most, min(demand, most)
            point = self.model.inverse(demand, speed, used, density)
            lift, duration, share = self.limits.apply(
                point.lift_mm, point.duration_deg, speed, before
            )
            duration_deg = 6.0 * speed * duration
            commands = (*commands[: cylinder - 1], (lift, duration), *commands[cylinder:])
            exact = lift == point.lift_mm and abs(duration_deg - point.duration_deg) < 1e-6
            limited = limited or point.limited or not exact
            if not exact:
                point = _moved(point, lift, duration_deg, speed)
        record = EventRecord(k, cylinder, measurement.time, speed, point, used, math.nan)
        after = ControllerState(
            k + 1,
            adaptation,
            self.estimator.commanded(found.state, record),
            (*pending[1 - KEPT :], PendingEvent(record, exact)),
            commands,
            applied,
            density,
            held,
            timing.refused,
            measurement.time,
            speed,
            watch,
        )
        diagnostics = Diagnostics(
            final,
            used,
            0.0 if demand == 0.0 else point.charge,
            limited,
            share < 1.0,
            projected,
            adapted,
            found.rejected,
            density,
        )
        if watch is not None and watch.alarms:
            diagnostics = diagnostics._replace(
                mode=watch.mode, alarms=Alarm(watch.alarms), suspects=watch.monitor.suspects
            )
        elif timing.alarms:
            diagnostics = diagnostics._replace(alarms=Alarm(timing.alarms))
        return ControlStep(after, lift, duration_deg, diagnostics)

    def _without_computation(self, state: ControllerState, timing: Timing) -> ControllerState:
        """Return the state that knows of events in which nothing was computed.

        Their valves have repeated the last command. Where that is not known, or the number of
        the event has jumped, the estimator begins anew.
        """
        n, k = self.n_cylinders, timing.event_index
        repeated = skipped_events(state, timing, n)
        if not repeated:
            return state._replace(event_index=k, estimator=self.estimator.start(), pending=())
        estimator, pending = state.estimator, state.pending
        for event in repeated:
            estimator = self.estimator.commanded(estimator, event.record)
            pending = (*pending[1 - KEPT :], event)
        return state._replace(event_index=k, estimator=estimator, pending=pending)

    def _shut(self, speed_rpm: float) -> ModelPoint:
        """Return the point of a valve that is kept shut: nothing flows, whatever is guessed."""
        point = self.model.inverse(_LEAST, speed_rpm, _NOMINAL, 1.0)
        return point._replace(
            lift_mm=0.0, flow_slope=0.0, duration_slope=0.0, shares=np.zeros_like(point.shares)
        )

    def _evidence(
        self, event: PendingEvent | None, estimate: ChargeEstimate
    ) -> ChargeEvidence | None:
        """What an estimate says about its cylinder; None if the model does not know the event."""
        return charge_evidence(
            event, estimate, self.duration_jitter, self.duration_noise, self.most_duration_error
        )

    def _density(self, density: float, ambient_pressure: float, watch: Watch | None) -> float:
        """Density after one event, from the ambient pressure that the estimator sees.

        It follows within `_DENSITIES` only, those of the charge model. Where the pressure sensor
        or the air flow is not believed, the monitors tell it.
        """
        if watch is not None:
            trusted = watch.monitor.ambient_pressure
            if watch.alarms & NOTHING_LEARNT:
                ambient_pressure = trusted
            elif abs(ambient_pressure - trusted) > self.density_jump:
                return density  # the monitors have not decided yet
        if not math.isfinite(ambient_pressure) or self.density_gain == 0.0:
            return density
        low, high = _DENSITIES
        wanted = min(max(ambient_pressure / self.ambient_pressure, low), high)
        return density + self.density_gain * (wanted - density)


def _blended(learnt: CylinderParameters, applied: float) -> CylinderParameters:
    """Return parameters between nominal and learnt ones."""
    if applied == 1.0:
        return learnt
    if applied == 0.0:
        return _NOMINAL
    return CylinderParameters(
        learnt.flow_gain**applied, learnt.duration_offset * applied, learnt.charge_factor**applied
    )


def _moved(point: ModelPoint, lift_mm: float, duration_deg: float, speed_rpm: float) -> ModelPoint:
    """Return the point with another command; its charge to first order in the duration.

    It is a guess for the estimator, which leans little on it, and is not learnt from: a lower lift
    is left out, and the guess stays within `_GUESSES`.
    """
    change = (duration_deg - point.duration_deg) / (6.0 * speed_rpm)
    exponent = min(max(point.duration_slope * change, _GUESSES[0]), _GUESSES[1])
    return point._replace(
        lift_mm=lift_mm, duration_deg=duration_deg, charge=point.charge * math.exp(exponent)
    )
