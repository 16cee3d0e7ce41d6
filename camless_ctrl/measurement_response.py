"""From the true charge of each event to its estimate: the MAF sensor seen once per event.

The response itself is the plant's (`plant.air_path`); here it is that of an estimator's
windows, which average the reading and undo its lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from plant.air_path import ComplexArray, FlowShape, PulseResponse, event_time, mode_point

from .estimator import ChargeEstimator

__all__ = ["ComplexArray", "FlowShape", "MeasurementResponse", "event_time", "mode_point"]


@dataclass(frozen=True)
class MeasurementResponse(PulseResponse):
    """Response of the estimated to the true charge per event."""

    @classmethod
    def of_maf(
        cls,
        estimator: ChargeEstimator,
        event_time: float,
        *,
        time_constant: float,
        delay: float,
        shape: FlowShape | None = None,
    ) -> Self:
        """Return the response through a MAF sensor that may differ from what is assumed of it.

        Parameters
        ----------
        estimator : ChargeEstimator
            The estimator, with the lag and delay that it assumes.
        event_time : float
            ``T``, s.
        time_constant, delay : float
            Lag and transport delay that the sensor has, s.
        shape : FlowShape, optional
            How the charge flows in; evenly over its event by default.
        """
        return cls.of_window(
            event_time,
            time_constant=time_constant,
            delay=delay,
            shape=shape,
            shift=estimator.delay,
            taper=estimator.taper,
            correction=estimator.time_constant,
        )
