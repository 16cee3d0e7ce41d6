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
from typing import Any, NamedTuple

from plant import ValveCommand
from plant._checks import in_range, positive, whole
from plant.air_path import event_time
from plant.errors import ParameterError

from .command_limits import CommandLimits
from .controller_parts import Adaptation, ChargeModel, Estimator
from .cylinder_parameters import CylinderParameters, ParameterSet
from .event_data import ChargeEstimate, ChargeEvidence, EventRecord, Measurement, ModelPoint

_NOMINAL = CylinderParameters()
_DENSITIES = (0.55, 1.25)  # 1, relative densities that are believed
_PLAUSIBLE = 3.0  # estimated over predicted charge, or one over it, that is believed
_GUESSES = (-3.0, 0.5)  # ln of a guessed charge over that of the model's own command
_KEPT = 12  # events that the controller remembers: as many as the estimator
_LONGEST_GAP = 2.0  # s from one IVO to the next; a later time is not believed
_MOST_REFUSED = 8  # times in a row that are refused, after which the clock is believed again


class PendingEvent(NamedTuple):
    """An event whose charge has not been used yet."""

    record: EventRecord
    exact: bool  # whether the model speaks of the command that was given


class ControllerState(NamedTuple):
    """All that the controller remembers; immutable."""

    event_index: int  # of the next event
    adaptation: Any
    estimator: Any
    pending: tuple[PendingEvent, ...]
    commands: tuple[tuple[float, float] | None, ...]  # last lift (mm) and duration (s) of each
    applied: float  # share of the learnt parameters that commands use, 1
    density: float  # of the intake air over the model's, as the pressure sensor shows it, 1
    held: int  # events for which nothing is learnt yet
    refused: int  # times in a row that were not believed
    time: float  # s, IVO of the last event
    speed_rpm: float  # of the last event


class Diagnostics(NamedTuple):
    """What happened in one step."""

    estimate: ChargeEstimate | None  # of an earlier event
    parameters: CylinderParameters  # with which this command was made
    predicted: float  # kg, charge that the model promises
    limited: bool  # whether the demand is out of reach, or a limit acts on the command
    rate_limited: bool  # whether the command could not change fast enough
    projected: bool  # whether a parameter was held at its bound
    adapted: bool  # whether anything was learnt
    rejected: bool  # whether samples were missing or contradicted the model
    density: float  # 1


class ControlStep(NamedTuple):
    """Outcome of `AirChargeController.step`."""

    state: ControllerState
    lift_mm: float
    duration_deg: float
    diagnostics: Diagnostics

    @property
    def command(self) -> ValveCommand:
        """Command of the valve that opens next."""
        return ValveCommand(self.lift_mm, self.duration_deg)


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
        return ControllerState(
            0,
            self.adaptation.start(self.n_cylinders, parameters),
            self.estimator.start(),
            (),
            (None,) * self.n_cylinders,
            1.0,
            in_range("density", density, *_DENSITIES, "1"),
            0,
            0,
            -math.inf,
            math.nan,
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
        return fresh._replace(adaptation=learnt)

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
            the last one, samples are the estimator's to judge.
        demand : float
            Demanded charge of the event, kg.
        active : bool
            False takes what was learnt out of the commands, and True brings it back, both over
            `blend_events`. Nothing is learnt in between.

        Raises
        ------
        ParameterError
            If the demand is not a positive number.
        """
        if not 0.0 < demand < math.inf:
            positive("demand", demand, "kg")  # says what is wrong
        n, k = self.n_cylinders, state.event_index
        cylinder = k % n + 1
        measurement, refused = self._usable(state, measurement)
        speed = measurement.speed_rpm

        pending = _with_durations(state.pending, measurement.durations)
        estimator = state.estimator
        if state.refused >= _MOST_REFUSED and not refused:
            estimator = self.estimator.start()  # the clock has been set: what came before is void
        found = self.estimator.update(estimator, measurement)
        held = self.hold_events if found.rejected else max(state.held - 1, 0)
        adaptation, projected, adapted = state.adaptation, False, False
        final = found.final
        if final is not None and self.adapt and active and held == 0:
            evidence = self._evidence(pending, final)
            if evidence is not None:
                moved = self.adaptation.update(adaptation, evidence)
                adaptation, projected, adapted = moved.state, moved.projected, moved.moved

        change = 1.0 / self.blend_events
        applied = min(max(state.applied + (change if active else -change), 0.0), 1.0)
        density = self._density(state.density, found.ambient_pressure)
        used = _blended(adaptation.of(cylinder), applied)
        point = self.model.inverse(demand, speed, used, density)
        commands = state.commands
        lift, duration, share = self.limits.apply(
            point.lift_mm, point.duration_deg, speed, commands[cylinder - 1]
        )
        duration_deg = 6.0 * speed * duration
        exact = lift == point.lift_mm and abs(duration_deg - point.duration_deg) < 1e-6
        if not exact:
            point = _moved(point, lift, duration_deg, speed)
        record = EventRecord(k, cylinder, measurement.time, speed, point, used, math.nan)
        after = ControllerState(
            k + 1,
            adaptation,
            self.estimator.commanded(found.state, record),
            (*pending[1 - _KEPT :], PendingEvent(record, exact)),
            (*commands[: cylinder - 1], (lift, duration), *commands[cylinder:]),
            applied,
            density,
            held,
            refused,
            measurement.time,
            speed,
        )
        diagnostics = Diagnostics(
            final,
            used,
            point.charge,
            point.limited or not exact,
            share < 1.0,
            projected,
            adapted,
            found.rejected,
            density,
        )
        return ControlStep(after, lift, duration_deg, diagnostics)

    def _usable(self, state: ControllerState, measurement: Measurement) -> tuple[Measurement, int]:
        """Measurement with a usable time and speed, and how many times were refused in a row."""
        speed, time = measurement.speed_rpm, measurement.time
        low, high = self.speed_range_rpm
        if not low <= speed <= high:
            speed = state.speed_rpm if math.isfinite(state.speed_rpm) else max(low, 1000.0)
        refused = 0
        if not state.time < time <= state.time + _LONGEST_GAP and (
            not math.isfinite(time) or (math.isfinite(state.time) and state.refused < _MOST_REFUSED)
        ):
            refused = state.refused + 1
            last = state.time if math.isfinite(state.time) else 0.0
            time = last + event_time(speed, self.n_cylinders)
        if speed is measurement.speed_rpm and time is measurement.time:
            return measurement, refused
        return replace(measurement, speed_rpm=speed, time=time), refused

    def _evidence(
        self, pending: tuple[PendingEvent, ...], estimate: ChargeEstimate
    ) -> ChargeEvidence | None:
        """What an estimate says about its cylinder; None if the model does not know the event.

        The delivered duration is the expected one, plus jitter, and is measured with noise. The
        part of the measured deviation that is jitter, ``w``, moves the charge that is predicted;
        what is left of charge and duration then have independent errors.
        """
        index, _, charge, variance, *_ = estimate
        event = _of_index(pending, index)
        if event is None or not event.exact:
            return None
        _, cylinder, _, speed, point, used, measured = event.record
        ratio = charge / point.charge
        if not 1.0 / _PLAUSIBLE < ratio < _PLAUSIBLE:
            return None
        slope = point.duration_slope
        error = measured - point.duration_deg / (6.0 * speed)
        jitter, noise = self.duration_jitter**2, self.duration_noise**2
        log_ratio, w = math.log(ratio), 0.0
        if not abs(error) <= self.most_duration_error:
            error = math.nan  # not measured, or by a sensor that has failed
        elif jitter + noise > 0.0:
            w = jitter / (jitter + noise)
            log_ratio -= slope * w * (error - used.duration_offset)
        return ChargeEvidence(
            cylinder,
            log_ratio,
            variance / charge**2 + slope**2 * jitter * (1.0 - w),
            error,
            point.flow_slope,
            slope,
            used,
            speed,
        )

    def _density(self, density: float, ambient_pressure: float) -> float:
        """Density after one event, from the ambient pressure that the estimator sees.

        It follows within `_DENSITIES` only, those of the charge model.
        """
        if not math.isfinite(ambient_pressure) or self.density_gain == 0.0:
            return density
        low, high = _DENSITIES
        wanted = min(max(ambient_pressure / self.ambient_pressure, low), high)
        return density + self.density_gain * (wanted - density)


def _of_index(pending: tuple[PendingEvent, ...], event_index: int) -> PendingEvent | None:
    """Return the pending event of a number, the latest being looked at first; None without one."""
    for event in reversed(pending):
        if event.record.event_index == event_index:
            return event
    return None


def _with_durations(
    pending: tuple[PendingEvent, ...], durations: tuple[tuple[int, float], ...]
) -> tuple[PendingEvent, ...]:
    """Return the pending events with measured durations filled in."""
    for event_index, duration in durations:
        for i, (record, exact) in enumerate(pending):
            if record[0] == event_index:
                # Built by place, which takes a third of the time of a replacement by name.
                told = PendingEvent(EventRecord(*record[:-1], duration), exact)
                pending = (*pending[:i], told, *pending[i + 1 :])
                break
    return pending


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
