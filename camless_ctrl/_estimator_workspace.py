"""What a Kalman charge estimator makes once: the numbers of its kernel, and its filter."""

from __future__ import annotations

import functools
import math
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from plant._checks import in_range, positive, whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray
from plant.sampling import CrankSampling, TimeSampling
from plant.sensors import AirSensor, MafSensor, MapSensor

from ._estimator_state import STATES

if TYPE_CHECKING:
    from .kalman_estimator import KalmanEstimator


S = TypeVar("S", bound=AirSensor)

_POSITIVE = {
    "manifold_capacity": "kg/Pa",
    "throttle_area": "kg/s",
    "ambient_pressure": "Pa",
    "charge_spread": "1",
    "ambient_spread": "Pa",
    "ratio_spread": "1",
    "sample_gate": "1",
    "window_gate": "1",
}
_NOT_NEGATIVE = {
    "lag_spread": "s",
    "delay_spread": "s",
    "map_lag_spread": "s",
    "longest_delay": "s",
    "ambient_drift": "Pa/s^0.5",
    "ratio_drift": "1/s^0.5",
    "lag_drift": "s/s^0.5",
    "delay_drift": "s/s^0.5",
    "map_lag_drift": "s/s^0.5",
    "flow_error": "1",
    "drop_error": "1",
    "part_error": "1",
    "output_error": "1",
    "shape_error": "1",
}


def check(e: KalmanEstimator) -> None:
    """Check the fields of an estimator; raises `ParameterError` for an impossible one."""
    whole("n_cylinders", e.n_cylinders, 1, 24)
    for name, unit in _POSITIVE.items():
        positive(name, getattr(e, name), unit)
    for name, unit in _NOT_NEGATIVE.items():
        in_range(name, getattr(e, name), 0.0, math.inf, unit)
    maf, map_ = sensor_of("maf", e.maf, MafSensor), sensor_of("map", e.map, MapSensor)
    for name, sensor in (("maf", maf), ("map", map_)):
        if noise_variance(sensor) == 0.0:
            raise ParameterError(
                f"the {name} sensor has neither noise nor quantisation, but a filter that trusts "
                "a sample without bound has no solution: give it some noise"
            )


def sensor_of(name: str, given: object, kind: type[S]) -> S:
    """Return a sensor after checking its kind; the default one if none is given."""
    sensor = kind() if given is None else given
    if not isinstance(sensor, kind):
        raise ParameterError(f"{name} is {sensor!r}, but must be a {kind.__name__}")
    return sensor


def noise_variance(sensor: AirSensor) -> float:
    """Variance of a reading but for what goes with it: noise and quantisation."""
    return sensor.noise**2 + sensor.step**2 / 12.0


def kernel_numbers(e: KalmanEstimator) -> FloatArray:
    """Return the numbers of an estimator in the order of `_air_path_kernel`."""
    maf, map_, sampling = e.maf, e.map, e.maf.sampling
    # MAF samples to be expected: by their rate in 1/s, or their number in an event
    rate = 1.0 / sampling.period if isinstance(sampling, TimeSampling) else 0.0
    per_event = 0.0
    if isinstance(sampling, CrankSampling):
        per_event = float(int(720.0 / e.n_cylinders / sampling.step_deg + 1e-6))
    return np.array(
        [
            e.manifold_capacity,
            e.throttle_area,
            maf.time_constant,
            maf.delay,
            maf.relative_noise**2 + e.flow_error**2,
            noise_variance(maf),
            min(maf.highest - maf.lowest, 1e3),
            map_.time_constant,
            noise_variance(map_),
            e.drop_error**2,
            e.part_error**2,
            map_.delay,
            e.charge_spread,
            e.ambient_spread,
            e.ratio_spread,
            e.lag_spread if e.maf.time_constant > 0.0 else 0.0,
            e.delay_spread if e.maf.time_constant > 0.0 else 0.0,
            e.map_lag_spread if e.map.time_constant > 0.0 else 0.0,
            e.ambient_drift**2,
            e.ratio_drift**2,
            e.lag_drift**2,
            e.delay_drift**2,
            e.map_lag_drift**2,
            max(e.longest_delay, maf.delay),
            e.output_error**2,
            e.sample_gate**2,
            e.window_gate,
            rate,
            per_event,
        ]
    )


class Workspace:
    """Numbers, filter, and where the kernel writes prior, covariance and measurement."""

    def __init__(self, estimator: KalmanEstimator) -> None:
        self.numbers = kernel_numbers(estimator)
        self.map_delay = estimator.map.delay
        self.event_by_rpm = 120.0 / estimator.n_cylinders  # event time times speed, s rpm
        self.shape_variance = estimator.shape_error**2
        empty = np.empty(0)
        self.nothing = (empty, empty, empty, empty)
        n, square = STATES, (STATES, STATES)
        half = n + n * n
        self.out = np.zeros(2 * half)
        self.x, self.P = self.out[:n], self.out[n:half].reshape(square)
        self.z, self.H = self.out[half : half + n], self.out[half + n :].reshape(square)

    @functools.cached_property
    def kernel(self) -> ModuleType:
        from . import _estimator_kernel

        return _estimator_kernel

    @functools.cached_property
    def filter(self) -> Any:
        from filterpy.kalman import KalmanFilter

        from ._estimator_kernel import inverse

        made = KalmanFilter(dim_x=STATES, dim_z=STATES)  # its noise R is the unit matrix
        made.H = self.H
        made.inv = inverse  # of a small matrix, four times as fast as NumPy's
        return made
