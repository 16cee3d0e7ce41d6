"""Charge of each intake event from MAF and MAP samples: an extended Kalman filter.

The filter is this project's own design. It is updated once per intake event, with all samples
of one event window, from an IVO to the next. Its states, for the window of event ``w``:

===========  =====================================================================  =====
charge       of event ``w``                                                         kg
before       charge of event ``w - 1``, whose tail flows in the window              kg
output       lagged MAF output at the start of the window                           kg/s
ambient      pressure before the throttle as the MAP sensor sees it: its offset     Pa
             is in it; random walk
ratio        of the flow through the throttle that MAF tells to that which the      1
             pressure drop tells; random walk
lag, delay   of the MAF sensor; random walks                                        s
slow         lag of the MAP sensor; random walk                                     s
===========  =====================================================================  =====

*Prediction.* Each charge flows out of the manifold by its record's shares, in `PARTS` parts of
an event. The manifold balance (Eq. 1) with the throttle of Eq. 13-14 follows, in an implicit
step a part: its weights make the relaxation of the stiff manifold exact about the expected
flow. The MAP sensor lags the pressure; delay and lag of the MAF sensor follow the throttle flow.
The air path runs over two windows, so that what is assumed at the start of the first one (a
quasi-steady manifold, the charge of event ``w - 2`` as it was last estimated) has died out. The
tangent of all this is exact.

*Update.* The samples of the window give normal equations; they are compressed to a measurement
of eight numbers with unit noise, with which `filterpy.kalman.KalmanFilter` updates. The window is
linearised about the prior, and again about what comes out, until that moves no more: the pressure
drop goes with the square of the flow (an iterated filter).

*Why the ratio.* MAF alone fixes the level of the charge, and its gain error is in the estimate:
no estimator can see it. MAP follows within a millisecond and tells the events apart, which the
lag of the MAF sensor blurs; the ratio keeps the two from contradicting each other.

*Lags and delay.* The rhythm of the inflow tells them, so that a wrong assumption leaves no error
once they are learnt. Their spreads are those of the ranges that are assumed of the sensors about
what is assumed here (10 to 20 ms about 15, 0 to 3 about 1, 0.5 to 2 about 1). Wider ones let the
first window explain a delay by a lag that no sensor has; a MAP lag that is taken for known
contradicts the dips of the pressure at 6000 rpm. At high speed a delay looks like one that is an
event time longer: a filter that starts at 6000 rpm with six cylinders may take 3 ms for 0. One
that has run slower does not.

*What is needed of the record.* The shares should be those of the cylinder's own flow gain
(`inflow_share_slopes`): of equal cylinders they cost 0.8 % at 6000 rpm in one that is 15 % weak.

*Normalised innovation.* ``ChargeEstimate.innovation`` is that of all samples used in the window,
``e' S^-1 e``, with as many ``degrees`` of freedom as samples. On the filter's own model it is
chi-square distributed; on the full plant, model errors included, its mean is 0.75 to 1.2 times
the degrees of freedom.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from plant import Engine
from plant._checks import positive, replace_fields
from plant.kinematics import FloatArray
from plant.sensors import MAF_DELAYS, MafSensor, MapSensor, Sensor

from ._estimator_state import DELAY, EstimatorState, EstimatorUpdate
from ._estimator_workspace import Workspace, check, sensor_of
from ._pickling import by_fields
from .event_data import ChargeEstimate, EventRecord, Measurement

__all__ = ["EstimatorState", "EstimatorUpdate", "KalmanEstimator"]

Samples = tuple[FloatArray, FloatArray, FloatArray, FloatArray]  # MAF time, flow; MAP time, Pa

MOST_REJECTIONS = 3  # windows in a row without an update, after which the filter begins anew
SHORTEST_EVENT, LONGEST_EVENT = 1e-4, 2.0  # s; a shorter or longer window is not an event
MOST_PENDING = 12  # events that wait for their samples; older ones go without
_ON_TIME = 1e-9  # s, rounding of times


@dataclass(frozen=True, slots=True)
class KalmanEstimator:
    """Extended Kalman filter for the charge of each event.

    An instance holds a workspace: let one thread at a time call it. States are immutable, so
    one estimator may serve many runs.

    Attributes
    ----------
    n_cylinders : int
        Number of cylinders.
    manifold_capacity : float
        Manifold mass per pressure ``V_m/(R T)``, kg/Pa.
    throttle_area : float
        Throttle at sonic flow, Eq. 19, kg/s.
    ambient_pressure : float
        Where the ambient state begins if there is no MAP sample, Pa.
    maf : MafSensor
        Lag, delay, noise and quantisation that are assumed; its gain error is not.
    map : MapSensor
        The same of the manifold pressure; its offset is not assumed.
    charge_spread : float
        How far off a predicted charge may be (1 sigma), 1. Large, so that the estimate hardly
        leans on the prediction.
    ambient_spread : float
        How far off the ambient state may be at the start, Pa.
    ratio_spread : float
        How far the ratio may be from 1, 1.
    lag_spread, delay_spread, map_lag_spread : float
        How far lag and delay of the MAF sensor and the lag of the MAP sensor may be from what is
        assumed (1 sigma), s; 0 takes them for known.
    longest_delay : float
        Longest delay of the MAF sensor, s. At high speed events look alike, and only the range
        of the delay tells it from one that is an event time shorter or longer.
    ambient_drift : float
        Random walk of the ambient state, Pa/s^0.5.
    ratio_drift : float
        Random walk of the ratio, 1/s^0.5.
    lag_drift, delay_drift, map_lag_drift : float
        Random walks of lags and delay, s/s^0.5.
    flow_error : float
        Model error of a MAF sample, as a share of the reading: inflow that is even over a
        part, charges that flow otherwise than their shares.
    drop_error : float
        Model error of a MAP sample, as a share of the pressure drop over the throttle.
    part_error : float
        Model error of a sample within a part, as a share of the change that the part brings
        it: of MAP the change of pressure, of MAF that of the flow through the lag.
    output_error : float
        Model error of the MAF output from one window to the next, as a share of it.
    shape_error : float
        Error of an estimated charge that comes with the shape of its inflow and does not
        average out within a window, as a share of the charge. It is in the variance of the
        estimates, not in the filter.
    sample_gate : float
        A sample further than this from its prediction is not used, in standard deviations.
    window_gate : float
        A window whose normalised innovation exceeds this many times its degrees of freedom
        gives no estimate, 1.
    """

    n_cylinders: int  # 1
    manifold_capacity: float  # kg/Pa
    throttle_area: float  # kg/s
    ambient_pressure: float = 1e5  # Pa
    maf: MafSensor = field(default_factory=MafSensor)
    map: MapSensor = field(default_factory=MapSensor)
    charge_spread: float = 0.2  # 1
    ambient_spread: float = 2000.0  # Pa
    ratio_spread: float = 0.05  # 1
    lag_spread: float = 3e-3  # s
    delay_spread: float = 1e-3  # s
    map_lag_spread: float = 0.5e-3  # s
    longest_delay: float = MAF_DELAYS[1]  # s
    ambient_drift: float = 20.0  # Pa/s^0.5
    ratio_drift: float = 0.002  # 1/s^0.5
    lag_drift: float = 5e-5  # s/s^0.5
    delay_drift: float = 2e-5  # s/s^0.5
    map_lag_drift: float = 1e-5  # s/s^0.5
    flow_error: float = 0.003  # 1
    drop_error: float = 0.02  # 1
    part_error: float = 0.1  # 1
    output_error: float = 0.0005  # 1
    shape_error: float = 0.003  # 1
    sample_gate: float = 8.0  # 1
    window_gate: float = 10.0  # 1
    _workspace: Workspace = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check(self)
        object.__setattr__(self, "_workspace", Workspace(self))

    @classmethod
    def of(
        cls,
        engine: Engine,
        maf: Sensor | None = None,
        map: Sensor | None = None,
        **options: float,
    ) -> Self:
        """Return the estimator of an unthrottled engine.

        Parameters
        ----------
        engine : Engine
            The engine.
        maf, map : MafSensor, MapSensor, optional
            What is assumed of the sensors; the default ones.
        **options
            The other fields.
        """
        return cls(
            n_cylinders=engine.n_cylinders,
            manifold_capacity=engine.manifold_volume / (engine.gas_constant * engine.temperature),
            throttle_area=engine.throttle.area(engine.throttle.wide_open_deg),
            ambient_pressure=engine.ambient_pressure,
            maf=sensor_of("maf", maf, MafSensor),
            map=sensor_of("map", map, MapSensor),
            **options,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a copy is made: with a workspace of its own."""
        return by_fields(self)

    def replace(self, **changes: Any) -> Self:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    def latency_events(self, event_time: float) -> int:
        """Events from the IVO of an event until its charge is known at an IVO.

        Two where the delay of the sensors is shorter than an event of `event_time` s, and one
        more for each further event that it lasts.
        """
        delay = max(self.maf.delay, self.map.delay)
        return 1 + max(math.ceil(delay / positive("event_time", event_time, "s") - 1e-9), 1)

    def start(self) -> EstimatorState:
        """Return the state before the first event: nothing is known but the ambient pressure."""
        maf, map_ = self.maf, self.map
        return EstimatorState.empty(
            self.ambient_pressure, maf.time_constant, maf.delay, map_.time_constant
        )

    def commanded(self, state: EstimatorState, record: EventRecord) -> EstimatorState:
        """Return the state with the event that was just commanded.

        Parameters
        ----------
        state : EstimatorState
            State before; not changed.
        record : EventRecord
            The event; records come in the order of their IVO.
        """
        return state.appended(record, MOST_PENDING)

    def update(self, state: EstimatorState, measurement: Measurement) -> EstimatorUpdate:
        """Take in new samples; estimate the charge of the window that they complete.

        At an event time longer than the delay this is the window of the event before the last
        one that was commanded. It is known as soon as the next event's IVO and the delay have
        passed. Should two windows become complete at once, as the engine slows
        down, both are worked off, and the estimates of the later one are returned.

        Parameters
        ----------
        state : EstimatorState
            State before; not changed.
        measurement : Measurement
            Samples since the last call. Samples that are not finite, or not later than the one
            before, are dropped; so are those later than an event after `measurement.time`.

        Returns
        -------
        EstimatorUpdate
            The state after it, and the estimates, if there are any.
        """
        work = self._workspace
        time, speed = float(measurement.time), float(measurement.speed_rpm)
        ahead = work.event_by_rpm / speed if speed > 0.0 else 0.0
        latest = time + ahead if ahead < LONGEST_EVENT else time
        if not math.isfinite(latest):
            latest = -math.inf  # without a time, no sample can be placed
        asarray, kind = np.asarray, np.float64
        samples = (
            asarray(measurement.sample_time, kind),
            asarray(measurement.sample_flow, kind),
            asarray(measurement.pressure_time, kind),
            asarray(measurement.pressure, kind),
        )
        delay = state.x.item(DELAY)  # as it was learnt
        arrived = time - (delay if delay > work.map_delay else work.map_delay) + _ON_TIME
        found = None
        while True:
            pending, following = state.pending, state.behind + 1
            if following >= len(pending):
                break
            end = pending[following].start
            if end > arrived and end < math.inf:
                break
            found = self._window(state, samples, latest)
            state, samples = found.state, work.nothing
        if found is not None:
            return found
        if latest > -math.inf:
            state = state.with_samples(work.kernel.keep(state.samples, *samples, latest))
        return EstimatorUpdate(state, None, None, 0, 0)

    def _window(self, state: EstimatorState, samples: Samples, latest: float) -> EstimatorUpdate:
        """Work off the oldest window that waits."""
        work = self._workspace
        kernel = work.kernel
        x, P, carry, kept, pending, behind, rejections = state
        index, cylinder, start, _, point, _, _ = record = pending[behind]
        end = pending[behind + 1].start
        previous = pending[behind - 1] if behind >= 1 else record
        earlier = pending[behind - 2] if behind >= 2 else previous
        length, before = end - start, previous.start
        if not (behind and SHORTEST_EVENT <= start - before <= LONGEST_EVENT):
            before = start - length
        predicted, charge_1 = point.charge, previous.point.charge
        if not (
            SHORTEST_EVENT <= length <= LONGEST_EVENT
            and 0.0 < predicted < math.inf
            and 0.0 < charge_1 < math.inf
        ):
            if latest > -math.inf:
                kept = kernel.keep(kept, *samples, latest)
            return EstimatorUpdate(state.lost(kept), None, None, 0, 0, True)
        kept, carry, status, used, rejected, innovation = kernel.advance(
            work.numbers,
            kept,
            *samples,
            latest,
            before,
            start,
            end,
            predicted,
            charge_1,
            point.shares,
            previous.point.shares,
            earlier.point.shares,
            x,
            P,
            carry,
            rejections < 0 or rejections >= MOST_REJECTIONS,
            work.out,
        )
        if status == kernel.LOST:
            return EstimatorUpdate(state.lost(kept), None, None, used, rejected, True)
        if status != kernel.UPDATED:
            after = state.rejected(work.x.copy(), work.P.copy(), carry, kept)
            return EstimatorUpdate(after, None, None, used, rejected, True)
        filter_ = work.filter
        filter_.x, filter_.P = work.x, work.P
        filter_.update(work.z, None, work.H)  # with H, no time goes into the shape of z
        x, P = filter_.x, filter_.P
        m, m_1 = x.item(0), x.item(1)
        shape = work.shape_variance
        # Built as tuples, which takes half the time of a named tuple's own constructor.
        made, v, v_1 = tuple.__new__, P.item(0, 0) + shape * m * m, P.item(1, 1) + shape * m_1 * m_1
        filtered = made(ChargeEstimate, (index, cylinder, m, v, innovation, used))
        smoothed = None
        if behind:
            smoothed = made(ChargeEstimate, (*previous[:2], m_1, v_1, innovation, used))
        after = state.updated(x, P, carry, kept)
        return made(EstimatorUpdate, (after, filtered, smoothed, used, rejected, False))
