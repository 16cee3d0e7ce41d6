"""The controller whose loop is known in closed form: event windows, one charge factor a cylinder.

The robustness analysis in the event domain describes this loop exactly (`EventLoop`): the map
inverse at a scheduled lift, `ChargeEstimator` on the MAF signal alone, and an integral
correction of the charge of each cylinder.
"""

from __future__ import annotations

from .adaptation import AdaptationGains, GainSchedule
from .adaptation_laws import ParameterBounds
from .command_limits import CommandLimits
from .controller import AirChargeController
from .estimator import ChargeEstimator
from .feedforward import Feedforward
from .integral_adaptation import IntegralAdaptation
from .window_estimator import WindowEstimator


def window_controller(
    feedforward: Feedforward,
    estimator: ChargeEstimator,
    gains: AdaptationGains | GainSchedule,
    *,
    n_cylinders: int = 4,
    bounds: tuple[float, float] = (0.6, 1.4),
) -> AirChargeController:
    """Return the controller of event windows.

    Parameters
    ----------
    feedforward : Feedforward
        Map inverse at a scheduled lift.
    estimator : ChargeEstimator
        Window on the MAF signal.
    gains : AdaptationGains or GainSchedule
        Gains per cycle, at every speed or over speed.
    n_cylinders : int
        Number of cylinders.
    bounds : (float, float)
        Bounds of the charge factors, 1.

    Notes
    -----
    Nothing but the actuator's limits acts on the commands: no rate, no density, no measured
    duration, so that small deviations see the loop of the analysis.
    """
    if isinstance(gains, AdaptationGains):
        gains = GainSchedule.constant(gains.mean, gains.imbalance)
    return AirChargeController(
        feedforward,
        WindowEstimator(estimator, n_cylinders),
        IntegralAdaptation(gains, bounds=ParameterBounds(charge_factor=bounds)),
        n_cylinders=n_cylinders,
        limits=CommandLimits(
            lift_mm=feedforward.lift_limits_mm,
            longest_duration_deg=360.0,
            lift_rate_mm=1e3,
            duration_rate=1e3,
            valvetrain=feedforward.valvetrain,
        ),
        duration_jitter=0.0,
        density_gain=0.0,
        hold_events=0,
    )
