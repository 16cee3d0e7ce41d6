"""Frequency response of the full plant in the event domain, by small changes of its commands.

In one cycle the command of one cylinder is changed to both sides, and the plant is run event by
event until nothing is felt of it. The charges and readings that follow, cycle by cycle, are a
column of the lifted plant's Markov parameters; their sum with the powers of ``1/zeta`` is its
frequency response. A valve that is open already feels a command of the next cylinder: that
charge belongs to an earlier event, and counts with a positive power.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from plant import (
    CrankAnglePlant,
    InfeasibleProfileError,
    MafSensor,
    ParameterError,
    PulseResponse,
    ValveCommand,
)
from plant._checks import in_range, one_of, positive, truth, whole
from plant.air_path import event_time
from plant.kinematics import FloatArray
from plant.valve import OnInfeasible

from ._event_pulse import PeriodicOperation, Pulse
from ._lifted_data import checked_frequencies, default_frequencies
from ._maf_average import averaged_pulse, steady_averages
from ._modes import lifted_matrix
from .frequency import INPUTS, OUTPUTS, Input, LiftedResponse, Output

SAMPLES = 720  # of the throttle flow per event
PILOT = 2e-3  # relative change of the command that finds how much is needed


def full_plant_response(
    plant: CrankAnglePlant,
    commands: ValveCommand | Sequence[ValveCommand],
    speed_rpm: float,
    *,
    input: Input = "duration_deg",
    output: Output = "air_charge",
    omega: ArrayLike | None = None,
    maf: MafSensor | None = None,
    throttle_deg: float = 90.0,
    relative: bool = True,
    amplitude: float = 0.01,
    most_cycles: int = 100,
    tolerance: float = 1e-6,
    on_infeasible: OnInfeasible = "raise",
) -> LiftedResponse:
    """Return the lifted frequency response of the full plant around periodic operation.

    Parameters
    ----------
    plant : CrankAnglePlant
        The plant; its cylinders may differ.
    commands : ValveCommand or sequence of n ValveCommand
        One command for all cylinders, or one for each.
    speed_rpm, throttle_deg : float
        Operating point.
    input : {"duration_deg", "lift_mm"}
        What is changed of a command.
    output : {"air_charge", "maf"}
        True charge of each event, that of the cylinder that opens in it; or the reading of the
        MAF sensor averaged over each event, from its IVO to the next.
    omega : array_like (f,), optional
        Frequencies in rad/s, rising, up to the Nyquist frequency of a cycle; 33 even ones by
        default.
    maf : MafSensor, optional
        Sensor, of which lag, delay, gain error and offset count.
    relative : bool
        Whether changes are relative to the steady values, or in units of their own.
    amplitude : float
        Relative change of the charge to both sides; or of the command, where the charge follows
        it by less.
    most_cycles : int
        Cycles after which a change that is still felt is an error.
    tolerance : float
        Share of the largest effect that may be left where the response is cut.
    on_infeasible : {"raise", "limit"}
        As for `CrankAnglePlant.steady_cycle`.

    Raises
    ------
    ParameterError, InfeasibleProfileError, ConvergenceError, SimulationError
        As for `CrankAnglePlant.steady_cycle`, also for a changed command; for an unknown signal;
        for MAF windows of valves that do not open at TDC; and if the change is still felt after
        `most_cycles`.

    Notes
    -----
    The integration's choice of steps makes charges jump by about 1e-6, which at 1 % of charge is
    some 1e-4 of the response, and more at smaller amplitudes; a plant with a higher `resolution`
    jumps less. Where the charge hardly follows its command (a valve that shuts near BDC), the
    linearity error is one of a small gain.
    """
    one_of("input", input, INPUTS)
    one_of("output", output, OUTPUTS)
    truth("relative", relative)
    in_range("amplitude", amplitude, 1e-5, 0.2, "1")
    whole("most_cycles", most_cycles, 1, 10_000)
    in_range("tolerance", tolerance, 1e-10, 0.1, "1")
    operation = PeriodicOperation(
        plant, commands, speed_rpm, throttle_deg, samples=SAMPLES, on_infeasible=on_infeasible
    )
    maf = MafSensor() if maf is None else maf
    n, cycle = operation.n, operation.cycle
    if output == "maf":
        check_windows(cycle.commands)
    T = event_time(cycle.speed_rpm, n)
    omega = default_frequencies(n * T) if omega is None else checked_frequencies(omega, n * T)
    steps = operation_steps(operation, input, amplitude, most_cycles * n)

    columns: tuple[list[PulseResponse], ...] = ([], [])
    left = 0.0
    for j in range(1 if operation.alike else n):
        for column, share in zip(columns, (1.0, 0.5), strict=True):
            pulse = changed_pulse(operation, j, input, share * steps[j], most_cycles * n, tolerance)
            column.append(series(pulse, share * steps[j], output, T, maf))
            left = max(left, pulse.left)
    theta = np.asarray(omega * n * T)
    whole_, half = (
        lifted_matrix(column * (n if operation.alike else 1), theta) for column in columns
    )

    u = np.array([getattr(c, input) for c in cycle.commands], dtype=float)
    y = steady_output(operation, output, T, maf)
    if relative:
        scale = u / checked_outputs(y, output)[:, None]
        whole_, half = whole_ * scale, half * scale
    size = np.linalg.norm(half, 2, axis=(1, 2)).max()
    change = np.linalg.norm(whole_ - half, 2, axis=(1, 2)).max()
    return LiftedResponse(
        omega=omega,
        response=whole_,
        inputs=tuple(f"{input}[{k + 1}]" for k in range(n)),
        outputs=tuple(f"{output}[{k + 1}]" for k in range(n)),
        cycle_time=n * T,
        source="full plant",
        speed_rpm=cycle.speed_rpm,
        commands=cycle.commands,
        input_values=u,
        output_values=y,
        relative=relative,
        linearity_error=float(change / size) if size > 0.0 else 0.0,
        left=left,
    )


def operation_steps(
    operation: PeriodicOperation, input: Input, amplitude: float, most_events: int
) -> FloatArray:
    """Changes of each cylinder's command (n,) that change it or its charge by `amplitude`."""
    steps = []
    alike = operation.alike
    for j in range(1 if alike else operation.n):
        value = float(getattr(operation.cycle.commands[j], input))
        charge = abs(float(operation.cycle.air_charge[j]))
        most = amplitude * positive(input, value, "mm" if input == "lift_mm" else "deg")
        # Its own charge is all that is asked: a tolerance of 1 ends with that.
        pilot = changed_pulse(operation, j, input, PILOT * value, most_events, 1.0)
        slope = abs(float(pilot.charge[-pilot.first])) / (PILOT * value)
        enough = slope * most > amplitude * charge
        steps.append(amplitude * charge / slope if enough else most)
    return np.array(steps * operation.n if alike else steps)


def changed_pulse(
    operation: PeriodicOperation,
    j: int,
    input: Input,
    step: float,
    most_events: int,
    tolerance: float,
) -> Pulse:
    """Effect of a change of one command by `step` to both sides, named in what it refuses."""
    command = operation.cycle.commands[j]
    value = float(getattr(command, input))
    try:
        raised, lowered = (command.replace(**{input: value + s * step}) for s in (1.0, -1.0))
        return operation.pulse(j, raised, lowered, most_events=most_events, tolerance=tolerance)
    except InfeasibleProfileError as error:
        raise InfeasibleProfileError(
            f"{input} changed by {step:.3g} to both sides: {error}", error.highest_lift_mm
        ) from error
    except ParameterError as error:
        raise ParameterError(f"{input} changed by {step:.3g} to both sides: {error}") from error


def series(
    pulse: Pulse, step: float, output: Output, event_time: float, maf: MafSensor
) -> PulseResponse:
    """Response of an output event by event to a unit of change, in units of its own."""
    if output == "maf":
        found = averaged_pulse(pulse.flow, pulse.inflow, event_time, maf)
        return PulseResponse(event_time, 0, found.taps / step, found.pole)
    return PulseResponse(event_time, pulse.first, pulse.charge / step, 0.0)


def steady_output(
    operation: PeriodicOperation, output: Output, event_time: float, maf: MafSensor
) -> FloatArray:
    """Steady output of each event (n,), kg or kg/s."""
    if output == "air_charge":
        return operation.cycle.air_charge
    flow, inflow = operation.steady_flow(), operation.cycle.throttle_mass
    return steady_averages(flow, inflow, event_time, maf)


def check_windows(commands: Sequence[ValveCommand]) -> None:
    """Check that the windows of the MAF averages are those of the mean-value plant."""
    for c in commands:
        if c.opening_deg != 0.0:
            raise ParameterError(
                f"opening_deg is {c.opening_deg:g} deg, but must be 0 deg for the output 'maf': "
                "its windows go from one TDC to the next"
            )


def checked_outputs(values: FloatArray, output: Output) -> FloatArray:
    """Return steady outputs after checking that changes can be relative to them."""
    for k, value in enumerate(values):
        if not value > 0.0:
            raise ParameterError(
                f"{output}[{k + 1}] is {value:g} in steady operation, but must be above 0 to be "
                "what changes are relative to: ask for relative=False"
            )
    return values
