"""What the robust analysis asks of a controller, and the two kinds that it knows.

The window controller has a closed form from end to end. Of a designed controller (optimal path,
Kalman estimator, any of its laws) the response of the estimator is found by feeding it, and the
law is an integral correction with the gains with which it moves the predicted charge once it has
converged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from plant import CrankAnglePlant, ParameterError
from uncertainty.parameters import UncertaintySet

from ._loop_cases import at_speed
from ._sampled_loops import ModelLoops
from .adaptation import AdaptationGains, GainSchedule
from .charge_model import ChargeModel
from .controller_design import ControllerDesign
from .controller_parts import Adaptation
from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .gradient_adaptation import GradientAdaptation
from .integral_adaptation import IntegralAdaptation
from .kalman_adaptation import KalmanAdaptation
from .nominal_loop import NominalLoop
from .pulse_bank import pulse_bank
from .uncertain_loop import adaptation_law
from .uncertain_measurement import UncertainMeasurement, uncertain_measurement


class AnalysedControl(Protocol):
    """A controller as the robust analysis sees it."""

    @property
    def believed(self) -> Feedforward | ChargeModel:
        """What the controller believes of charges."""
        ...

    def map_at(self, speed_rpm: float) -> Feedforward | ChargeModel:
        """Return what it believes at one speed, small to send elsewhere if it can be."""
        ...

    def measurement(
        self, demand: float, speed_rpm: float, uncertain: UncertaintySet | None, seed: int
    ) -> UncertainMeasurement:
        """Return the uncertain measurement at an operating point."""
        ...

    def gains(self, measurement: UncertainMeasurement) -> AdaptationGains:
        """Return the gains per cycle there."""
        ...

    def nominal(self, measurement: UncertainMeasurement, gains: AdaptationGains) -> NominalLoop:
        """Return the loop of the nominal plant."""
        ...

    def at_delay(
        self, measurement: UncertainMeasurement, gains: AdaptationGains
    ) -> Callable[[float], NominalLoop] | None:
        """Return the loop as a function of the MAF sensor's delay (s), if it has one."""
        ...


@dataclass(frozen=True)
class WindowControl:
    """Map inverse at a scheduled lift, window on the air flow, integral correction.

    Attributes
    ----------
    plant : CrankAnglePlant
        Nominal full plant.
    feedforward : Feedforward
        Map that the controller believes.
    estimator : ChargeEstimator
        The estimator.
    schedule : GainSchedule
        Gains over speed.
    """

    plant: CrankAnglePlant = field(repr=False)
    feedforward: Feedforward = field(repr=False)
    estimator: ChargeEstimator
    schedule: GainSchedule

    @property
    def believed(self) -> Feedforward:
        """What the controller believes of charges."""
        return self.feedforward

    def measurement(
        self, demand: float, speed_rpm: float, uncertain: UncertaintySet | None, seed: int
    ) -> UncertainMeasurement:
        """Return the uncertain measurement at an operating point."""
        return uncertain_measurement(
            self.plant,
            self.feedforward,
            demand,
            speed_rpm,
            estimator=self.estimator,
            uncertain=uncertain,
            seed=seed,
        )

    def gains(self, measurement: UncertainMeasurement) -> AdaptationGains:
        """Return the gains of the schedule."""
        return self.schedule.at(measurement.speed_rpm)

    def nominal(self, measurement: UncertainMeasurement, gains: AdaptationGains) -> NominalLoop:
        """Return the loop of the nominal plant, in closed form."""
        return NominalLoop.of_sensor(
            adaptation_law(measurement, gains), measurement.local, self.estimator
        )

    def at_delay(
        self, measurement: UncertainMeasurement, gains: AdaptationGains
    ) -> Callable[[float], NominalLoop]:
        """Return the loop as a function of the MAF sensor's delay (s), in closed form."""
        law, local = adaptation_law(measurement, gains), measurement.local
        return lambda delay: NominalLoop.of_sensor(law, local, self.estimator, delay=delay)

    def map_at(self, speed_rpm: float) -> Feedforward:
        """Return the feedforward with the table of one speed."""
        return at_speed(self.feedforward, speed_rpm)


@dataclass(frozen=True)
class DesignedControl:
    """A designed controller with one of its adaptation laws.

    Attributes
    ----------
    plant : CrankAnglePlant
        Nominal full plant.
    design : ControllerDesign
        The design.
    adaptation : Adaptation
        The law.
    """

    plant: CrankAnglePlant = field(repr=False)
    design: ControllerDesign = field(repr=False)
    adaptation: Adaptation

    @property
    def believed(self) -> ChargeModel:
        """What the controller believes of charges."""
        return self.design.model

    def measurement(
        self, demand: float, speed_rpm: float, uncertain: UncertaintySet | None, seed: int
    ) -> UncertainMeasurement:
        """Return the uncertain measurement at an operating point."""
        return uncertain_measurement(
            self.plant,
            self.design.model,
            demand,
            speed_rpm,
            estimator=self.design.controller.estimator,
            uncertain=uncertain,
            seed=seed,
        )

    def gains(self, measurement: UncertainMeasurement) -> AdaptationGains:
        """Return the gains with which the converged law moves the predicted charge.

        A converged `KalmanAdaptation` takes each error against what it knows by then, with the
        gains of single events: over a cycle that is the integral correction with its
        `steady_gains`, within some per cent. They come from the variance that the estimator
        tells and from the jitter of the delivered duration, as `AirChargeController` adds them up.
        """
        law, speed = self.adaptation, measurement.speed_rpm
        point = self.design.model.inverse(measurement.demand, speed)
        if isinstance(law, KalmanAdaptation):
            rest = self._loops(measurement).nominal
            controller = self.design.controller
            jitter, noise = controller.duration_jitter**2, controller.duration_noise**2
            told = jitter / (jitter + noise) if jitter + noise > 0.0 else 0.0
            variance = rest.deviation**2 + point.duration_slope**2 * jitter * (1.0 - told)
            return law.steady_gains(variance, point.flow_slope, measurement.n_cylinders)
        if isinstance(law, GradientAdaptation):
            return law.gains.at(speed).scaled(law.effective_gain(point.flow_slope))
        if isinstance(law, IntegralAdaptation):
            return law.gains.at(speed)
        raise ParameterError(
            f"the law is a {type(law).__name__}, whose gains are not known here: analyse it as an "
            "UncertainLoop with its law per event"
        )

    def nominal(self, measurement: UncertainMeasurement, gains: AdaptationGains) -> NominalLoop:
        """Return the loop of the nominal plant."""
        bank = pulse_bank(
            [measurement.nominal],
            measurement.latency,
            input="charge",
            outputs=["estimate"],
            name="measurement",
        )
        return NominalLoop(adaptation_law(measurement, gains), bank, measurement.n_cylinders)

    def at_delay(self, measurement: UncertainMeasurement, gains: AdaptationGains) -> None:
        """Return None: the estimator learns the delay, as far as it follows at all."""
        return None

    def map_at(self, speed_rpm: float) -> ChargeModel:
        """Return the charge model."""
        return self.design.model

    def _loops(self, measurement: UncertainMeasurement) -> ModelLoops:
        return ModelLoops(
            self.plant,
            self.design.model,
            self.design.controller.estimator,
            measurement.demand,
            measurement.speed_rpm,
        )
