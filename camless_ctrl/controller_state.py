"""What the controller remembers from event to event, and what it says about each."""

from __future__ import annotations

from typing import Any, NamedTuple

from plant import ValveCommand

from .alarms import Alarm, Mode
from .cylinder_parameters import CylinderParameters
from .event_data import ChargeEstimate, EventRecord
from .fault_reaction import Watch


class PendingEvent(NamedTuple):
    """An event whose charge has not been used yet."""

    record: EventRecord
    exact: bool  # whether the model speaks of the command that was given

    @property
    def shut(self) -> bool:
        """Whether the valve was kept shut."""
        return self.record.point.lift_mm == 0.0


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
    watch: Watch | None = None  # over sensors and valves; None if nothing watches


class Diagnostics(NamedTuple):
    """What happened in one step."""

    estimate: ChargeEstimate | None  # of an earlier event
    parameters: CylinderParameters  # with which this command was made
    predicted: float  # kg, charge that the model promises; 0 of a valve kept shut
    limited: bool  # whether the demand is out of reach, or a limit acts on the command
    rate_limited: bool  # whether the command could not change fast enough
    projected: bool  # whether a parameter was held at its bound
    adapted: bool  # whether anything was learnt
    rejected: bool  # whether samples were missing or contradicted the model
    density: float  # 1
    mode: Mode = Mode.NORMAL  # what is done about the alarms
    alarms: Alarm = Alarm(0)  # that stand
    suspects: tuple[int, ...] = ()  # cylinders (from 1) whose valve has an alarm


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
