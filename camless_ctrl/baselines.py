"""The controller with its law and with those that it is compared with."""

from __future__ import annotations

from collections.abc import Callable

from .adaptation import GainSchedule
from .controller import AirChargeController
from .controller_design import ControllerDesign
from .gradient_adaptation import GradientAdaptation
from .integral_adaptation import IntegralAdaptation

ADAPTIVE = "adaptive (least squares)"
GRADIENT = "adaptive (gradient)"
INTEGRAL = "integral correction"
LTI = "mu-optimal LTI"
FEEDFORWARD = "feedforward alone"

Progress = Callable[[str, int, int], None]


def baseline_controllers(
    design: ControllerDesign,
    *,
    gains: GainSchedule | None = None,
    progress: Progress | None = None,
) -> dict[str, AirChargeController]:
    """Return controllers by the name of their law; all share feedforward and estimator.

    Parameters
    ----------
    design : ControllerDesign
        The controller that the others are compared with.
    gains : GainSchedule, optional
        Gains of the gradient and of the integral correction; the default ones if not given.
    progress : callable, optional
        Called with what is being made, the number of parts done and the number in all.

    Notes
    -----
    The integral correction and the LTI law move a charge factor per cylinder: they know neither
    flow gains nor duration offsets, and are told no measured duration.
    """
    gains = GainSchedule() if gains is None else gains
    return {
        ADAPTIVE: design.controller,
        GRADIENT: design.with_law(GradientAdaptation(gains=gains)),
        INTEGRAL: design.with_law(IntegralAdaptation(gains=gains)).replace(duration_jitter=0.0),
        FEEDFORWARD: design.feedforward_alone(),
    }
