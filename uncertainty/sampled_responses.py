"""Mode responses of many perturbed full plants with equal cylinders.

Equal cylinders do the same one event apart: changing one command of one cylinder tells the
response from event to event, and so all modes. Changes of charge are relative to the *nominal*
charge and changes of the command to the *nominal* command, as in a loop that divides by what it
expects: a plant that takes in and changes 10 % more has a gain 10 % higher.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from plant import ValveCommand
from plant._checks import one_of

from .frequency import OUTPUTS, Output
from .perturbed import PerturbedPlants
from .pulse_sampling import sampled_pulses
from .sampled_result import SampledResponses


def sampled_mode_responses(
    plants: PerturbedPlants,
    command: ValveCommand,
    speed_rpm: float,
    *,
    output: Output = "air_charge",
    modes: Sequence[int] | None = None,
    theta: ArrayLike | None = None,
    **options: Any,
) -> SampledResponses:
    """Return the responses of the circulant modes of each plant of a sample.

    Parameters
    ----------
    plants, command, speed_rpm, **options
        As for `sampled_pulses`; ``keep_going`` leaves NaN for a plant that failed.
    output, modes, theta
        As for `SampledPulses.responses`.

    Raises
    ------
    ParameterError, SimulationError
        As for both.
    """
    one_of("output", output, OUTPUTS)
    pulses = sampled_pulses(plants, command, speed_rpm, **options)
    return pulses.responses(output, modes=modes, theta=theta)
