"""The controller with its own law, and with the laws that it is compared with."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from plant import CrankAnglePlant

from ._processes import in_processes
from .adaptation import GainSchedule
from .analysed_control import DesignedControl
from .controller import AirChargeController
from .controller_design import ControllerDesign
from .gradient_adaptation import GradientAdaptation
from .integral_adaptation import IntegralAdaptation
from .lti_adaptation import LtiAdaptation
from .mu_optimal import mu_optimal_law
from .robustness import demand_at

ADAPTIVE = "adaptive (least squares)"
GRADIENT = "adaptive (gradient)"
INTEGRAL = "integral correction"
LTI = "mu-optimal LTI"
FEEDFORWARD = "feedforward alone"

# Robust at all speeds with the charge estimator: mu for performance is 0.97 at most with 0.4.
ROBUST_GAINS = GainSchedule((750.0, 4500.0, 6000.0), (0.4, 0.4, 0.3), (0.4, 0.4, 0.3))
LTI_SPEEDS_RPM = (1500.0, 3000.0, 6000.0)

Progress = Callable[[str, int, int], None]


def baseline_controllers(
    design: ControllerDesign, gains: GainSchedule = ROBUST_GAINS
) -> dict[str, AirChargeController]:
    """Return controllers by the name of their law; all share feedforward and estimator.

    Parameters
    ----------
    design : ControllerDesign
        The controller that the others are compared with.
    gains : GainSchedule
        Gains of the gradient and of the integral correction.

    Notes
    -----
    The integral correction moves a charge factor per cylinder: it knows neither flow gains nor
    duration offsets, and is told no measured duration. So does the LTI law, see
    `lti_controller`.
    """
    return {
        ADAPTIVE: design.controller,
        GRADIENT: design.with_law(GradientAdaptation(gains=gains)),
        INTEGRAL: design.with_law(IntegralAdaptation(gains=gains)).replace(duration_jitter=0.0),
        FEEDFORWARD: design.feedforward_alone(),
    }


def lti_controller(
    design: ControllerDesign,
    speeds_rpm: tuple[float, ...] = LTI_SPEEDS_RPM,
    *,
    seed: int = 0,
    processes: int = 2,
    progress: Progress | None = None,
) -> AirChargeController:
    """Return the controller with the fastest robust law of the synthesis at each speed.

    Parameters
    ----------
    design : ControllerDesign
        Whose feedforward and estimator it has.
    speeds_rpm : tuple of float
        Speeds of the laws; the nearest one holds in between. One takes about 15 s.
    seed : int
        Seed of the sampled plants of the uncertain measurement.
    processes : int
        Processes to work in.
    progress : callable, optional
        Called with what is being made, the number of laws done and the number in all.

    Raises
    ------
    SynthesisError
        If the synthesis finds no robust law at a speed.
    """
    items = [_Speed(design, speed, seed) for speed in sorted(speeds_rpm)]

    def tell(done: int, total: int) -> None:
        if progress is not None:
            progress("LTI laws", done, total)

    laws = in_processes(_law, items, processes, tell)
    systems = tuple(pair for law in laws for pair in law.systems)
    latency = max(law.latency for law in laws)
    return design.with_law(LtiAdaptation(systems, latency)).replace(duration_jitter=0.0)


class _Speed(NamedTuple):
    """What another process is sent."""

    design: ControllerDesign
    speed_rpm: float
    seed: int


def _law(item: _Speed) -> LtiAdaptation:
    """Adaptation of one speed."""
    design = item.design
    plant = CrankAnglePlant(design.engine, runner=True, oscillation=True)
    analysed = DesignedControl(plant, design, design.controller.adaptation)
    measurement = analysed.measurement(demand_at(item.speed_rpm), item.speed_rpm, None, item.seed)
    return LtiAdaptation.of_laws([mu_optimal_law(measurement, confirm=False)])
