"""Frequency responses of a plant in the event domain: lifted over a cycle, and by modes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError, ValveCommand
from plant._checks import in_range
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._lifted_data import LiftedData

Input = Literal["lift_mm", "duration_deg"]
Output = Literal["air_charge", "maf"]
INPUTS: tuple[Input, ...] = ("lift_mm", "duration_deg")
OUTPUTS: tuple[Output, ...] = ("air_charge", "maf")

LINEAR_WITHIN = 0.02  # 1, linearity error up to which a response counts as linear


@dataclass(frozen=True)
class LiftedResponse(LiftedData):
    """Response of the n charges or readings of a cycle to the n commands of a cycle.

    Signals are relative changes, or changes in their own units; see `relative`.

    Attributes
    ----------
    omega, response, inputs, outputs, cycle_time
        As in `LiftedData`: frequencies (f,) in rad/s, response (f, n, n), names, s.
    source : str
        Plant that it is the response of.
    speed_rpm : float
        Speed.
    commands : tuple of ValveCommand
        Command of each cylinder.
    input_values, output_values : ndarray (n,)
        Steady value of each signal, in its own unit (mm, deg; kg, kg/s).
    relative : bool
        Whether changes are relative to these values.
    linearity_error : float
        Change of the response when the perturbation is halved, over its largest gain, 1; 0
        for an exact linearisation.
    left : float
        Share of the perturbation's largest effect that was left where the response was cut, 1.
    """

    source: str
    speed_rpm: float
    commands: tuple[ValveCommand, ...]
    input_values: FloatArray = field(repr=False)
    output_values: FloatArray = field(repr=False)
    relative: bool = True
    linearity_error: float = 0.0
    left: float = 0.0

    @property
    def linear(self) -> bool:
        """Whether the linearity error is at most `LINEAR_WITHIN` (2 %)."""
        return self.linearity_error <= LINEAR_WITHIN

    @property
    def title(self) -> str:
        """What a picture is headed with."""
        return f"{self.signals}: {self.source}, {self.speed_rpm:g} rpm"

    def scaled_as(self, other: LiftedResponse) -> Self:
        """Return the response with changes relative to the steady values of another one.

        A plant that takes in 10 % more for the same commands, and changes by 10 % more, has the
        same response relative to its own charge; relative to the nominal charge its gain is 10 %
        higher, which is what a loop sees that divides by the charge it expects.

        Raises
        ------
        ParameterError
            If one of the two is in units of its own, or their signals differ.
        """
        from dataclasses import replace

        if not (self.relative and other.relative):
            raise ParameterError(
                "a response is in units of its own, but both must be relative: ask for "
                "relative=True"
            )
        if (self.inputs, self.outputs) != (other.inputs, other.outputs):
            raise ParameterError(
                f"the responses are {self.signals} and {other.signals}, but must have the same "
                "inputs and outputs"
            )
        rows = self.output_values / other.output_values
        columns = other.input_values / self.input_values
        return replace(
            self,
            response=self.response * rows[:, None] * columns,
            input_values=other.input_values,
            output_values=other.output_values,
        )

    def __str__(self) -> str:
        """Return plant, operating point, gains of the modes and linearity."""
        gains = []
        for q in range(self.n_cylinders // 2 + 1):
            gain = np.abs(self.mode_band(q)[1])
            gains.append(f"{gain.min():.3g} to {gain.max():.3g} in mode {q}")
        kind = "relative gain" if self.relative else "gain"
        check = (
            f"; halving the perturbation changes it by {100.0 * self.linearity_error:.2g} %"
            if self.linearity_error
            else ""
        )
        return (
            f"{self.source} at {self.speed_rpm:g} rpm, {self.signals}, "
            f"{self.n_cylinders} cylinders: {kind} {', '.join(gains)}{check}"
        )


@dataclass(frozen=True)
class ModeResponses:
    """Responses of circulant modes of equal cylinders on a grid of cycle phases.

    Attributes
    ----------
    modes : tuple of int
        Modes.
    theta : ndarray (f,)
        Cycle phases, rad, in ``[-pi, pi]``; mode q is at ``z = exp(j (theta + 2 pi q)/n)``.
    response : ndarray (modes, f)
        Responses.
    n_cylinders : int
        Number of cylinders.
    name : str
        What they are the response of.
    """

    modes: tuple[int, ...]
    theta: FloatArray = field(repr=False)
    response: ComplexArray = field(repr=False)
    n_cylinders: int
    name: str

    def __post_init__(self) -> None:
        theta, response = np.array(self.theta, dtype=float), np.array(self.response, dtype=complex)
        if response.shape != (len(self.modes), theta.size):
            raise ParameterError(
                f"the response has shape {response.shape}, but must be ({len(self.modes)}, "
                f"{theta.size}): a row a mode, a column a cycle phase"
            )
        for array in (theta, response):
            array.setflags(write=False)
        object.__setattr__(self, "theta", theta)
        object.__setattr__(self, "response", response)

    def mode(self, q: int) -> ComplexArray:
        """Response of mode `q`, (f,)."""
        return self.response[mode_row(self.modes, q)]

    def __str__(self) -> str:
        """Return name and gains."""
        gains = (
            f"{np.abs(row).min():.3g} to {np.abs(row).max():.3g} in mode {q}"
            for q, row in zip(self.modes, self.response, strict=True)
        )
        return f"{self.name}: gain {', '.join(gains)}"


def mode_row(modes: tuple[int, ...], q: int) -> int:
    """Row of a mode, or an error that names those there are."""
    if q not in modes:
        raise ParameterError(
            f"mode q is {q}, but must be one of {', '.join(map(str, modes))}: ask for it in `modes`"
        )
    return modes.index(q)


def checked_phases(theta: ArrayLike) -> FloatArray:
    """Return cycle phases (f,) after checking that they lie in ``[-pi, pi]``."""
    values = np.atleast_1d(np.array(theta, dtype=float))
    if values.ndim != 1 or not values.size:
        raise ParameterError(
            f"theta has shape {values.shape}, but must be a list of cycle phases in rad"
        )
    for value in values:
        in_range("theta", float(value), -np.pi - 1e-9, np.pi + 1e-9, "rad")
    return values
