"""What one changed command does to each plant of a sample: simulated once, seen in many ways.

Equal cylinders do the same one event apart: changing one command of one cylinder tells the
response from event to event, and so all modes at all frequencies, of the charge and of any
flow sensor alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import (
    ConvergenceError,
    FlowShape,
    InfeasibleProfileError,
    MafSensor,
    ParameterError,
    PulseResponse,
    SimulationError,
    ValveCommand,
)
from plant._checks import in_range, one_of, positive, truth, whole
from plant.air_path import ComplexArray, event_time
from plant.kinematics import FloatArray

from ._event_pulse import PeriodicOperation, Pulse
from ._modes import checked_mode, mode_points
from .frequency import INPUTS, OUTPUTS, Input, ModeResponses, Output, checked_phases
from .lifted_full_plant import changed_pulse, check_windows, operation_steps, series
from .lifted_mean_value import default_phases
from .perturbed import PerturbedPlants
from .sampled_result import SampledResponses
from .sampling import nominal_sample

FINER = 4.0  # resolution at which a plant is tried again
SAMPLES = 360  # of the throttle flow per event


@dataclass(frozen=True)
class SampledPulses:
    """Effect of one changed command on each plant of a sample.

    Attributes
    ----------
    plants : PerturbedPlants
        The plants.
    speed_rpm : float
        Speed.
    command : ValveCommand
        Nominal command.
    input : str
        What is changed of it.
    maf : MafSensor
        Nominal sensor, which the sample may perturb.
    step : float
        Change of the command, in its unit.
    reference_charge : float
        Charge that changes are relative to, kg.
    nominal : Pulse
        Effect on the nominal plant.
    nominal_half : Pulse
        Effect on it of half the change.
    pulses : tuple of Pulse or None
        Effect on each plant; None for one that failed.
    charge : tuple of float
        Steady charge of each plant, kg; NaN for one that failed.
    failures : dict of int to str
        Why a plant failed, by its number.
    """

    plants: PerturbedPlants
    speed_rpm: float
    command: ValveCommand
    input: Input
    maf: MafSensor
    step: float
    reference_charge: float
    nominal: Pulse = field(repr=False)
    nominal_half: Pulse = field(repr=False)
    pulses: tuple[Pulse | None, ...] = field(repr=False)
    charge: tuple[float, ...] = field(repr=False)
    failures: dict[int, str]

    def __len__(self) -> int:
        """Return the number of plants."""
        return len(self.pulses)

    @property
    def n_cylinders(self) -> int:
        """Number of cylinders."""
        return self.plants.plant.engine.n_cylinders

    def linearity_error(self, output: Output = "air_charge") -> float:
        """Change of the nominal plant's response when the change is halved, over its largest gain.

        Parameters
        ----------
        output : {"air_charge", "maf"}
            As for `responses`.
        """
        one_of("output", output, OUTPUTS)
        z = np.exp(1j * np.linspace(0.0, np.pi, 61))
        T = event_time(self.speed_rpm, self.n_cylinders)
        whole_, half = (
            series(pulse, step, output, T, self.maf)(z)
            for pulse, step in ((self.nominal, self.step), (self.nominal_half, 0.5 * self.step))
        )
        return float(np.abs(whole_ - half).max() / np.abs(half).max())

    def flow_shape(self, parts: int = SAMPLES) -> FlowShape:
        """How the charge that a changed command adds to the nominal plant passes the throttle.

        Parameters
        ----------
        parts : int
            Parts per event; a divisor of 360.
        """
        whole("parts", parts, 1, SAMPLES)
        if SAMPLES % parts:
            raise ParameterError(f"parts is {parts}, but must divide {SAMPLES}")
        flow = np.append(self.nominal.flow, 0.0)  # linear between its samples
        shares = (flow[1:] + flow[:-1]).reshape(-1, SAMPLES // parts).sum(axis=1)
        return FlowShape(shares / shares.sum(), parts)

    def responses(
        self,
        output: Output,
        *,
        modes: Sequence[int] | None = None,
        theta: ArrayLike | None = None,
    ) -> SampledResponses:
        """Return the responses of the circulant modes of each plant.

        Parameters
        ----------
        output : {"air_charge", "maf"}
            As for `full_plant_response`.
        modes : sequence of int, optional
            Modes; those from 0 to n/2 by default, which stand for the others as well.
        theta : array_like (f,), optional
            Cycle phases in rad, in ``[-pi, pi]``; 41 even ones by default.

        Returns
        -------
        SampledResponses
            NaN for plants that failed.

        Raises
        ------
        ParameterError
            For an unknown output or mode, or a phase out of range.
        """
        one_of("output", output, OUTPUTS)
        n = self.n_cylinders
        chosen = tuple(range(n // 2 + 1)) if modes is None else tuple(modes)
        phases = default_phases() if theta is None else checked_phases(theta)
        z = np.stack([mode_points(phases, checked_mode(q, n), n) for q in chosen])
        if output == "maf":
            check_windows([self.command])
        T = event_time(self.speed_rpm, n)
        unit = self.reference_charge if output == "air_charge" else self.reference_charge / T
        scale = float(getattr(self.command, self.input)) / unit

        found = scale * self._all(output)(z)
        return SampledResponses(
            modes=chosen,
            theta=phases,
            response=found[:-1],
            nominal=ModeResponses(chosen, phases, found[-1], n, "nominal full plant"),
            sample=self.plants.sample,
            input=self.input,
            output=output,
            speed_rpm=self.speed_rpm,
            command=self.command,
            charge=np.array(self.charge),
            reference_charge=self.reference_charge,
        )

    @cached_property
    def _kept(self) -> dict[Output, _Responses]:
        return {}

    def _all(self, output: Output) -> _Responses:
        """Responses of all plants, then of the nominal one; made once for each output."""
        if output not in self._kept:
            T = event_time(self.speed_rpm, self.n_cylinders)
            nominal = _nominal(self.plants).maf_at(0, self.maf)
            sensors = [self.plants.maf_at(i, self.maf) for i in range(len(self))] + [nominal]
            self._kept[output] = _Responses.of(
                [
                    None if pulse is None else series(pulse, self.step, output, T, sensor)
                    for pulse, sensor in zip((*self.pulses, self.nominal), sensors, strict=True)
                ]
            )
        return self._kept[output]


@dataclass(frozen=True)
class _Responses:
    """`PulseResponse` of many plants at once.

    Attributes
    ----------
    first : int
        Event lag of the first column.
    taps : ndarray (plants, lags)
        Taps; NaN for a plant that failed.
    ends : ndarray of int (plants,)
        Column of the last tap, which starts the tail.
    poles : ndarray (plants,)
        Pole of the tail.
    """

    first: int
    taps: FloatArray
    ends: NDArray[np.int64]
    poles: FloatArray

    @classmethod
    def of(cls, each: Sequence[PulseResponse | None]) -> _Responses:
        known = [r for r in each if r is not None]
        first = min(r.first for r in known)
        lags = max(r.first + r.taps.size for r in known) - first
        taps = np.full((len(each), lags), np.nan)
        ends, poles = np.zeros(len(each), dtype=np.int64), np.zeros(len(each))
        for i, r in enumerate(each):
            if r is not None:
                begin, ends[i] = r.first - first, r.first - first + r.taps.size - 1
                taps[i] = 0.0
                taps[i, begin : ends[i] + 1] = r.taps
                poles[i] = r.pole
        return cls(first, taps, ends, poles)

    def __call__(self, z: ComplexArray) -> ComplexArray:
        """Responses (plants, ...) at points `z` (...)."""
        flat = z.ravel()
        lags = self.first + np.arange(self.taps.shape[1])
        powers = flat ** -lags[:, None]
        # Plant by plant in the same order, so that equal plants have equal responses.
        found = np.zeros((len(self.taps), flat.size), dtype=complex)
        for column, power in zip(self.taps.T, powers, strict=True):
            found += column[:, None] * power
        if self.poles.any():
            last = self.taps[np.arange(len(self.taps)), self.ends]
            pole = self.poles[:, None]
            found += pole / (flat - pole) * (last[:, None] * powers[self.ends])
        return found.reshape(-1, *z.shape)


def _nominal(plants: PerturbedPlants) -> PerturbedPlants:
    """Return the nominal plant of a set, as a sample of one."""
    return PerturbedPlants(plants.plant, nominal_sample(plants.sample.uncertain))


def sampled_pulses(
    plants: PerturbedPlants,
    command: ValveCommand,
    speed_rpm: float,
    *,
    input: Input = "duration_deg",
    maf: MafSensor | None = None,
    throttle_deg: float = 90.0,
    amplitude: float = 0.01,
    reference_charge: float | None = None,
    most_cycles: int = 100,
    tolerance: float = 1e-5,
    keep_going: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SampledPulses:
    """Change one command of each plant of a sample, and follow what comes of it.

    Parameters
    ----------
    plants : PerturbedPlants
        The plants; the cylinders of each are equal. A lift that the duration does not allow is
        limited.
    command : ValveCommand
        Command of all cylinders. Each plant delivers its duration offset besides.
    speed_rpm, throttle_deg : float
        Operating point.
    input
        As for `full_plant_response`.
    maf : MafSensor, optional
        Nominal sensor, which the sample may perturb.
    amplitude : float
        As for `full_plant_response`, of the nominal plant: all plants get its change of command.
    reference_charge : float, optional
        Charge that changes are relative to, kg; that of the nominal plant by default. Readings
        are relative to that charge per event time.
    most_cycles, tolerance
        As for `full_plant_response`.
    keep_going : bool
        Whether a plant that cannot be simulated is told in the result instead of raised.
    progress : callable, optional
        Called with the number of plants done and the number in all.

    Raises
    ------
    ParameterError
        For an unknown signal, and where the cylinders of the plants differ (use
        `full_plant_response` for each plant).
    SimulationError
        If a plant has no response there; with its number and its parameters.

    Notes
    -----
    A plant takes 1 to 2 ms, most of it in Python, so that threads do not help. One in some
    thousand does not come to rest, because the choice of steps holds its two runs apart; it is
    followed once more at `FINER` times the resolution.
    """
    one_of("input", input, INPUTS)
    in_range("amplitude", amplitude, 1e-5, 0.2, "1")
    whole("most_cycles", most_cycles, 1, 10_000)
    in_range("tolerance", tolerance, 1e-10, 0.1, "1")
    truth("keep_going", keep_going)
    most_events = most_cycles * plants.plant.engine.n_cylinders

    def operation(of: PerturbedPlants, i: int) -> PeriodicOperation:
        each = of.commands_at(i, command, speed_rpm)
        found = PeriodicOperation(
            of.plant_at(i),
            each[0] if len(set(each)) == 1 else each,
            speed_rpm,
            throttle_deg,
            samples=SAMPLES,
            on_infeasible="limit",
        )
        if not found.alike:
            raise ParameterError(
                f"the cylinders of sample {i} differ in flow coefficient or delivered duration, "
                "but must be equal: use full_plant_response(...) for each plant"
            )
        return found

    def followed(i: int) -> tuple[PeriodicOperation, Pulse]:
        """Follow one plant, with finer steps if their choice holds its two runs apart."""
        try:
            found = operation(plants, i)
            return found, changed_pulse(found, 0, input, step, most_events, tolerance)
        except ConvergenceError:
            finer = plants.plant.with_resolution(FINER * plants.plant.resolution)
            found = operation(PerturbedPlants(finer, plants.sample), i)
            return found, changed_pulse(found, 0, input, step, most_events, tolerance)

    nominal = operation(_nominal(plants), 0)
    step = float(operation_steps(nominal, input, amplitude, most_events)[0])
    own_charge = float(nominal.cycle.air_charge[0])
    reference = own_charge if reference_charge is None else reference_charge
    pulses: list[Pulse | None] = []
    charges: list[float] = []
    failures: dict[int, str] = {}
    for i in range(len(plants)):
        try:
            found, pulse = followed(i)
        except (ConvergenceError, InfeasibleProfileError, SimulationError) as error:
            what = f"sample {i} ({plants.sample.at(i)}): {error}"
            if not keep_going:
                raise SimulationError(what) from error
            failures[i] = what
            pulses.append(None)
            charges.append(float("nan"))
        else:
            pulses.append(pulse)
            charges.append(float(found.cycle.air_charge[0]))
        if progress is not None:
            progress(i + 1, len(plants))
    return SampledPulses(
        plants=plants,
        speed_rpm=float(speed_rpm),
        command=command,
        input=input,
        maf=MafSensor() if maf is None else maf,
        step=step,
        reference_charge=positive("reference_charge", reference, "kg"),
        nominal=changed_pulse(nominal, 0, input, step, most_events, tolerance),
        nominal_half=changed_pulse(nominal, 0, input, 0.5 * step, most_events, tolerance),
        pulses=tuple(pulses),
        charge=tuple(charges),
        failures=failures,
    )
