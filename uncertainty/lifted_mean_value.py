"""Frequency response of the mean-value plant in the event domain, exact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from plant import MeanValueDynamics, ValveCommand
from plant._checks import one_of, truth
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._lifted_data import checked_frequencies, default_frequencies
from ._modes import checked_mode, mode_points
from .frequency import (
    INPUTS,
    OUTPUTS,
    Input,
    LiftedResponse,
    ModeResponses,
    Output,
    checked_phases,
)

SOURCE = "mean-value plant"


def mean_value_response(
    dynamics: MeanValueDynamics,
    commands: ValveCommand | Sequence[ValveCommand],
    speed_rpm: float,
    *,
    input: Input = "duration_deg",
    output: Output = "air_charge",
    omega: ArrayLike | None = None,
    relative: bool = True,
) -> LiftedResponse:
    """Return the lifted frequency response of the mean-value plant: `lifted`, evaluated.

    Parameters
    ----------
    dynamics : MeanValueDynamics
        The plant, with its gains, sensor, flow shape and throttle.
    commands, speed_rpm
        As for `MeanValueDynamics.operating_point`.
    input, output, omega, relative
        As for `full_plant_response`.

    Raises
    ------
    ParameterError, InfeasibleProfileError, ConvergenceError
        As for `MeanValueDynamics.lifted`.
    """
    one_of("input", input, INPUTS)
    one_of("output", output, OUTPUTS)
    truth("relative", relative)
    system = dynamics.lifted(
        commands, speed_rpm, inputs=(input,), outputs=(output,), relative=relative
    )
    cycle_time = float(system.dt)
    omega = (
        default_frequencies(cycle_time) if omega is None else checked_frequencies(omega, cycle_time)
    )
    point = dynamics.operating_point(commands, speed_rpm)
    each = [commands] * dynamics.n_cylinders if isinstance(commands, ValveCommand) else commands
    return LiftedResponse(
        omega=omega,
        response=_evaluated(
            system.A, system.B, system.C, system.D, np.exp(1j * omega * cycle_time)
        ),
        inputs=tuple(system.input_labels),
        outputs=tuple(system.output_labels),
        cycle_time=cycle_time,
        source=SOURCE,
        speed_rpm=float(speed_rpm),
        commands=tuple(each),
        input_values=point.inputs[:, INPUTS.index(input)],
        output_values=point.output(output),
        relative=relative,
    )


def mean_value_modes(
    dynamics: MeanValueDynamics,
    command: ValveCommand,
    speed_rpm: float,
    *,
    input: Input = "duration_deg",
    output: Output = "air_charge",
    modes: Sequence[int] = (0, 1, 2),
    theta: ArrayLike | None = None,
) -> ModeResponses:
    """Return relative responses of the mean-value plant's modes, from `linearize`.

    Parameters
    ----------
    dynamics, command, speed_rpm
        As for `MeanValueDynamics.linearize`: equal cylinders.
    input, output
        As for `full_plant_response`.
    modes : sequence of int
        Modes.
    theta : array_like (f,), optional
        Cycle phases in rad, in ``[-pi, pi]``; 41 even ones by default.

    Raises
    ------
    ParameterError, InfeasibleProfileError, ConvergenceError
        As for `MeanValueDynamics.linearize`.
    """
    one_of("input", input, INPUTS)
    one_of("output", output, OUTPUTS)
    n = dynamics.n_cylinders
    phases = default_phases() if theta is None else checked_phases(theta)
    system = dynamics.linearize(command, speed_rpm)[[output], [input]]
    rows = []
    for q in modes:
        z = mode_points(phases, checked_mode(q, n), n)
        rows.append(_evaluated(system.A, system.B, system.C, system.D, z)[:, 0, 0])
    return ModeResponses(tuple(modes), phases, np.array(rows), n, SOURCE)


def default_phases() -> FloatArray:
    """41 cycle phases from -pi to pi, rad."""
    return np.linspace(-np.pi, np.pi, 41)


def _evaluated(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, z: ComplexArray
) -> ComplexArray:
    """``C (z I - A)^-1 B + D`` at points (f,)."""
    shifted = z[:, None, None] * np.eye(A.shape[0]) - A
    return np.asarray(C @ np.linalg.solve(shifted, np.broadcast_to(B, (z.size, *B.shape))) + D)
