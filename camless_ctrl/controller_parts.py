"""What the controller asks of its parts: charge model, estimator, adaptation law."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from .cylinder_parameters import CylinderParameters, ParameterSet
from .event_data import ChargeEstimate, ChargeEvidence, EventRecord, Measurement, ModelPoint


class ChargeModel(Protocol):
    """What the controller asks of its model; `charge_model.ChargeModel` is one."""

    def inverse(
        self,
        demand: float,
        speed_rpm: float,
        parameters: CylinderParameters = ...,
        density: float = ...,
    ) -> ModelPoint:
        """Return the command for a charge in kg."""
        ...

    def limits(
        self, speed_rpm: float, parameters: CylinderParameters = ..., density: float = ...
    ) -> tuple[float, float]:
        """Return the least and the largest charge that can be commanded, kg."""
        ...


class EstimatorUpdate(Protocol):
    """What an estimator says after the samples of an event."""

    @property
    def state(self) -> Any:
        """State of the estimator."""
        ...

    @property
    def final(self) -> ChargeEstimate | None:
        """Estimate of an event that will not be refined; None if there is no good one."""
        ...

    @property
    def rejected(self) -> bool:
        """Whether the samples of a window contradict the model or are missing."""
        ...

    @property
    def ambient_pressure(self) -> float:
        """Ambient pressure as the pressure sensor sees it, Pa; NaN if that is not known."""
        ...


class Estimator(Protocol):
    """What the controller asks of an estimator; `KalmanEstimator` is one."""

    def start(self) -> Any:
        """Return the state before the first event."""
        ...

    def update(self, state: Any, measurement: Measurement) -> EstimatorUpdate:
        """Take in the samples since the last event."""
        ...

    def commanded(self, state: Any, record: EventRecord) -> Any:
        """Return the state that knows of the event just commanded."""
        ...


class AdaptationState(Protocol):
    """What an adaptation law has learnt."""

    @property
    def parameters(self) -> ParameterSet:
        """Parameters of all cylinders."""
        ...

    def of(self, cylinder: int) -> CylinderParameters:
        """Parameters of a cylinder (from 1)."""
        ...


class AdaptationStep(Protocol):
    """Outcome of one update of an adaptation law."""

    @property
    def state(self) -> Any:
        """State after it."""
        ...

    @property
    def projected(self) -> bool:
        """Whether a parameter was held at its bound."""
        ...

    @property
    def moved(self) -> bool:
        """Whether anything was learnt."""
        ...


class Adaptation(Protocol):
    """What the controller asks of an adaptation law; see `adaptation_law`."""

    def start(self, n_cylinders: int, parameters: ParameterSet | None = ...) -> Any:
        """Return the state before the first event."""
        ...

    def update(self, state: Any, evidence: ChargeEvidence) -> AdaptationStep:
        """Return the state after what one event says."""
        ...

    def to_dict(self, state: Any) -> dict[str, Any]:
        """Return what was learnt as plain data."""
        ...

    def from_dict(self, data: Mapping[str, Any]) -> Any:
        """Return the state of `to_dict`."""
        ...
