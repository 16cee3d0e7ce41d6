"""What the controller's plausibility monitors say: alarms, and the mode that follows from them."""

from __future__ import annotations

import enum


class Mode(enum.IntEnum):
    """What the controller does about the alarms that stand."""

    NORMAL = 0  # nothing stands, or nothing that matters
    DEGRADED = 1  # one source of information is not believed; nothing is learnt
    SAFE = 2  # several are not: the demand is limited as well


class Alarm(enum.IntFlag):
    """Findings of the monitors; several may stand at once."""

    MAF = 1  # air flow: stuck, missing, not finite, or against MAP and the model
    MAP = 2  # manifold pressure: likewise
    DURATION = 4  # measured durations: missing, or against the air flow
    VALVE = 8  # a valve does otherwise than it is told, beyond what is adapted to
    SPEED = 16  # engine speed: against the clock
    CLOCK = 32  # a computation was missed, or the times told cannot be
    INNOVATION = 64  # samples scatter more than the sensors' noise explains

    @property
    def names(self) -> tuple[str, ...]:
        """Names of those that stand, in small letters."""
        return tuple(str(alarm.name).lower() for alarm in Alarm if alarm in self)
