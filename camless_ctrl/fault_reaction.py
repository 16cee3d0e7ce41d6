"""What the controller does about faults: believe, do without, go back, or hold to what is safe.

==========  ======================================  ===========================================
mode        when                                    what
==========  ======================================  ===========================================
NORMAL      no alarm stands
DEGRADED    one source is not believed              it is done without, and nothing is learnt;
                                                    what was learnt since it may have gone wrong
                                                    is taken back. Of a valve alone only its own
                                                    cylinder is not learnt from
SAFE        two sources are not, or half of the     the same, and the demand is held under a
            valves are suspect                      share of what the engine can take in
==========  ======================================  ===========================================

Air flow (or strange innovations): commands follow the model, the density the pressure sensor.
Pressure: the estimator goes on with the air flow, the density stays. Durations: charges alone.
Speed: the clock tells it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from plant._checks import in_range, positive, whole

from .alarms import Alarm, Mode
from .fault_monitor import EventFacts, FaultMonitor, MonitorState

# Plain numbers: what is done with an `IntFlag` takes ten times as long.
NOTHING_LEARNT = int(Alarm.MAF | Alarm.MAP | Alarm.DURATION | Alarm.INNOVATION)
PRESSURE = int(Alarm.MAP)
_SOURCES = (int(Alarm.MAF), PRESSURE, int(Alarm.DURATION))
_VALVE, _SPEED, _INNOVATION = int(Alarm.VALVE), int(Alarm.SPEED), int(Alarm.INNOVATION)
_LOST = int(Alarm.MAF | Alarm.INNOVATION)  # the estimator may have followed a wrong sensor


class Trusted(NamedTuple):
    """What was learnt while nothing was suspicious."""

    time: float  # s
    adaptation: Any


class Watch(NamedTuple):
    """What is remembered of faults; immutable."""

    monitor: MonitorState
    trusted: tuple[Trusted, ...]  # the oldest first
    reach: float  # share of the largest charge that may be demanded, 1
    wrong_speeds: int  # events in a row whose told speed was not believed
    alarms: int  # `Alarm` bits of all that stand
    mode: Mode
    lost: int  # events in a row in which the estimator contradicts a sensor that is wrong
    starts_anew: bool  # whether the estimator is to begin anew
    tolerated: bool  # whether INNOVATION alone has stood so long that the model must be wrong

    def learns_from(self, cylinder: int) -> bool:
        """Whether what is measured of a cylinder (from 1) may be learnt from."""
        doubted = self.alarms & NOTHING_LEARNT
        if doubted == _INNOVATION and self.tolerated:
            doubted = 0
        return not doubted and cylinder not in self.monitor.suspects


@dataclass(frozen=True, slots=True)
class FaultReaction:
    """Monitors of a controller, and what follows from their alarms.

    Attributes
    ----------
    monitor : FaultMonitor
        The monitors.
    safe_share : float
        Share of the largest charge at a speed that may be demanded in SAFE mode, 1.
    reach_events : int
        Events over which the reach goes from 1 to 0, or back; so there is no bump.
    trust_time : float
        Time between two states of what was learnt that are kept to go back to, s.
    kept : int
        How many are kept; the oldest is gone back to.
    speed_tolerance : float
        Share by which a told speed may differ from that of the clock, 1.
    highest_acceleration_rpm_s : float
        Fastest change of speed, rpm/s.
    speed_events : int
        Events in a row with a wrong speed, after which it counts as a source that is not believed.
    lost_events : int
        Events with strange innovations beside a MAF alarm, after which the estimator begins anew:
        it has followed that sensor, and stands in its way back. Again after twice, four times
        and so on as many.
    innovation_patience : float
        Time after which strange innovations for which no sensor is to blame are learnt from, s:
        it is the model that is wrong.
    """

    monitor: FaultMonitor
    safe_share: float = 0.5  # 1
    reach_events: int = 40  # 1
    trust_time: float = 0.5  # s
    kept: int = 3  # 1
    speed_tolerance: float = 0.10  # 1
    highest_acceleration_rpm_s: float = 8000.0  # rpm/s
    speed_events: int = 4  # 1
    lost_events: int = 16  # 1
    innovation_patience: float = 2.0  # s

    def __post_init__(self) -> None:
        in_range("safe_share", self.safe_share, 0.0, 1.0, "1", open_low=True)
        whole("reach_events", self.reach_events, 1, 100_000)
        positive("trust_time", self.trust_time, "s")
        whole("kept", self.kept, 1, 1000)
        positive("speed_tolerance", self.speed_tolerance, "1")
        positive("highest_acceleration_rpm_s", self.highest_acceleration_rpm_s, "rpm/s")
        whole("speed_events", self.speed_events, 1, 100_000)
        whole("lost_events", self.lost_events, 1, 100_000)
        positive("innovation_patience", self.innovation_patience, "s")

    def start(self, adaptation: Any) -> Watch:
        """Return the state before the first event; `adaptation` is what is known by then."""
        first = Trusted(0.0, adaptation)
        return Watch(self.monitor.start(), (first,), 1.0, 0, 0, Mode.NORMAL, 0, False, False)

    def speed_is_wrong(self, told_rpm: float, clock_rpm: float, elapsed: float) -> bool:
        """Whether a told speed contradicts the clock; `elapsed` since the last IVO, s."""
        most = self.speed_tolerance * clock_rpm + self.highest_acceleration_rpm_s * elapsed
        return not abs(told_rpm - clock_rpm) <= most

    def judge(
        self, watch: Watch, facts: EventFacts, brief: int, time: float, adaptation: Any
    ) -> tuple[Watch, Any]:
        """Return what is remembered after an event, and what was learnt as it may be used.

        Parameters
        ----------
        watch : Watch
            State before.
        facts : EventFacts
            What is known of the event.
        brief : int
            `Alarm` bits of speed and clock, of this event alone.
        time : float
            IVO, s.
        adaptation
            What was learnt up to here.
        """
        monitor = self.monitor.judge(watch.monitor, facts)
        alarms, before, trusted = monitor.alarms | brief, watch.alarms, watch.trusted
        stops = alarms & NOTHING_LEARNT and not before & NOTHING_LEARNT
        if stops or (alarms & _VALVE and not before & (_VALVE | NOTHING_LEARNT)):
            adaptation = trusted[0].adaptation  # the fault may have been learnt
        elif monitor.calm and abs(time - trusted[-1].time) >= self.trust_time:
            # A clock that was set back counts as well.
            trusted = (*trusted, Trusted(time, adaptation))[-self.kept :]
        mode, reach, wrong, lost, anew = Mode.NORMAL, watch.reach, 0, 0, False
        if alarms:
            wrong = watch.wrong_speeds + 1 if brief & _SPEED else 0
            mode = self._mode(alarms, monitor.suspects, wrong)
            lost = watch.lost + 1 if alarms & _LOST == _LOST else 0
            turns, rest = divmod(lost, self.lost_events)
            anew = rest == 0 and turns > 0 and turns & (turns - 1) == 0  # 1, 2, 4, 8 ... times
        if mode is Mode.SAFE:
            reach = max(reach - 1.0 / self.reach_events, self.safe_share)
        elif reach < 1.0:
            reach = min(reach + 1.0 / self.reach_events, 1.0)
        tolerated = monitor.unnamed > self.innovation_patience
        return (
            Watch(monitor, trusted, reach, wrong, alarms, mode, lost, anew, tolerated),
            adaptation,
        )

    def _mode(self, alarms: int, suspects: tuple[int, ...], wrong_speeds: int) -> Mode:
        lost = sum(1 for source in _SOURCES if source & alarms)
        lost += wrong_speeds >= self.speed_events
        if lost >= 2 or 2 * len(suspects) >= max(self.monitor.n_cylinders, 2):
            return Mode.SAFE
        return Mode.DEGRADED
