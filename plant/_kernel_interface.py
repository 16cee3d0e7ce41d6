"""What the plant makes of the kernel's status."""

from __future__ import annotations

from . import _layout as layout
from ._segment import MOST_STEPS
from .errors import SimulationError


def check_status(status: int, speed_rpm: float) -> None:
    if status == layout.RUNNER_COLLAPSED:
        raise SimulationError(
            f"the runner pressure of Eq. 5 fell below zero at {speed_rpm:g} rpm: the runner's "
            "acceleration term is too strong for this model (check runner_area, m2; the printed "
            "1.43e-4 does this) or switch it off with runner=False"
        )
    if status == layout.OPEN_AT_COMPRESSION_TDC:
        raise SimulationError(
            f"a valve that opened at a lower speed is still open at the compression TDC at "
            f"{speed_rpm:g} rpm: a camless valve moves in time, so raise the speed in smaller "
            "steps or shorten duration_deg before it rises"
        )
    if status == layout.TOO_MANY_STEPS:
        raise SimulationError(
            f"more than {MOST_STEPS:g} steps within one form of a valve's motion at "
            f"{speed_rpm:g} rpm: the crank is too slow, or the runner or actuator too fast, for "
            "this plant (check speed_rpm, the frequencies of helmholtz and oscillation_period)"
        )
    if status == layout.NO_STAGE_SOLUTION:
        raise SimulationError(
            f"the manifold pressure of an implicit step did not settle at {speed_rpm:g} rpm: "
            "raise the plant's resolution"
        )
