"""What was measured on an engine: charge and loss of an event, or pressure against crank angle.

Each observation knows the experiment that it comes from, its values, the standard error
expected of them, and what a simulated cycle says in their place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from ._checks import in_range, one_of, positive
from .crank_angle import CrankAnglePlant, Orifice, Profile
from .cycle import Cycle
from .errors import ParameterError
from .kinematics import FloatArray
from .parameters import Engine
from .valve import OnInfeasible, ValveCommand

PressureSignal = Literal["cylinder_pressure", "runner_pressure", "manifold_pressure"]
PRESSURE_SIGNALS = ("cylinder_pressure", "runner_pressure", "manifold_pressure")
COARSEST_STEP_DEG = 1.0  # deg, of the trace that a pressure is compared with
FINEST_STEP_DEG = 0.05  # deg
RESOLUTION = 32.0  # of the plant: a fit differentiates it, and the choice of steps is no smooth one


@dataclass(frozen=True, slots=True)
class Experiment:
    """Steady operating point of an engine, and the plant that stands for the engine there.

    Attributes
    ----------
    speed_rpm : float
        Engine speed.
    command : ValveCommand or tuple of ValveCommand
        One command for all cylinders, or one for each.
    throttle_deg : float
        Throttle angle; 90 is wide open.
    profile, runner, oscillation, orifice
        Options of `CrankAnglePlant`.
    """

    speed_rpm: float
    command: ValveCommand | tuple[ValveCommand, ...]
    throttle_deg: float = 90.0
    profile: Profile = "camless"
    runner: bool = True
    oscillation: bool = False
    orifice: Orifice = "simplified"

    def __post_init__(self) -> None:
        positive("speed_rpm", self.speed_rpm, "rpm")
        if not isinstance(self.command, ValveCommand):
            object.__setattr__(self, "command", tuple(self.command))
        one_of("profile", self.profile, ("camless", "conventional"))

    def simulate(self, engine: Engine, on_infeasible: OnInfeasible = "raise") -> Cycle:
        """Return the periodic cycle of an engine at this point."""
        plant = CrankAnglePlant(
            engine,
            runner=self.runner,
            oscillation=self.oscillation,
            profile=self.profile,
            orifice=self.orifice,
            resolution=RESOLUTION,
        )
        return plant.steady_cycle(
            self.speed_rpm, self.command, self.throttle_deg, on_infeasible=on_infeasible
        )

    def __str__(self) -> str:
        """Return the point in a few words."""
        if isinstance(self.command, ValveCommand):
            c = self.command
            valve = f"{c.lift_mm:g} mm/{c.duration_deg:g} deg from {c.opening_deg:g} deg"
        else:
            valve = f"{len(self.command)} valve commands"
        throttle = "" if self.throttle_deg == 90.0 else f", throttle {self.throttle_deg:g} deg"
        return f"{self.profile}, {self.speed_rpm:g} rpm, {valve}{throttle}"


class Observation(Protocol):
    """Values measured in one experiment, with the standard error expected of each."""

    @property
    def experiment(self) -> Experiment:
        """Where they were measured."""
        ...

    @property
    def cylinder(self) -> int:
        """Cylinder at which they were measured, from 1."""
        ...

    @property
    def measured(self) -> FloatArray:
        """Values (k,)."""
        ...

    @property
    def standard_error(self) -> FloatArray:
        """Standard error expected of each value (k,), in its unit."""
        ...

    def predict(self, cycle: Cycle) -> FloatArray:
        """Return what a cycle of the experiment says in place of the values (k,)."""
        ...

    def compare(self, modelled: FloatArray) -> tuple[str, ...]:
        """Return lines of text that set the modelled values against the measured ones."""
        ...


@dataclass(frozen=True, slots=True)
class ChargeObservation:
    """Air charge of an intake event, its pumping loss, or both.

    Attributes
    ----------
    experiment : Experiment
        Where they were measured.
    air_charge : float or None
        kg per event.
    pumping_loss : float or None
        J per event.
    cylinder : int
        From 1.
    relative_error : float
        Standard error expected, as a share of the value; between observations only the
        ratio matters.
    """

    experiment: Experiment
    air_charge: float | None = None
    pumping_loss: float | None = None
    cylinder: int = 1
    relative_error: float = 0.01

    def __post_init__(self) -> None:
        if self.air_charge is None and self.pumping_loss is None:
            raise ParameterError("the observation is empty: give air_charge, pumping_loss or both")
        for name, unit in (("air_charge", "kg"), ("pumping_loss", "J")):
            value = getattr(self, name)
            if value is not None:
                positive(name, value, unit, remedy="its error is stated as a share of it")
        positive("relative_error", self.relative_error, "1")

    @property
    def measured(self) -> FloatArray:
        """Charge (kg) and loss (J), as far as they were measured."""
        return np.array([v for v in (self.air_charge, self.pumping_loss) if v is not None])

    @property
    def standard_error(self) -> FloatArray:
        """Standard error expected of each, in its unit."""
        return self.relative_error * self.measured

    def predict(self, cycle: Cycle) -> FloatArray:
        """Return the cycle's charge (kg) and loss (J) in place of those measured."""
        j = self.cylinder - 1
        pairs = (
            (self.air_charge, cycle.air_charge[j]),
            (self.pumping_loss, cycle.pumping_loss[j]),
        )
        return np.array([value for measured, value in pairs if measured is not None])

    def compare(self, modelled: FloatArray) -> tuple[str, ...]:
        """Return one line for the charge and one for the loss."""
        kinds = [("charge", "mg", 1e6)] * (self.air_charge is not None)
        kinds += [("loss", "J", 1.0)] * (self.pumping_loss is not None)
        return tuple(
            f"{name} {factor * model:.4g} against {factor * value:.4g} {unit} "
            f"({100.0 * (model / value - 1.0):+.2f} %)"
            for (name, unit, factor), value, model in zip(
                kinds, self.measured, modelled, strict=True
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class TraceObservation:
    """Pressure against crank angle over an intake process.

    Attributes
    ----------
    experiment : Experiment
        Where it was measured.
    crank_angle_deg : ndarray (k,)
        Crank angle after the intake TDC of the *first* cylinder, as in `Trace`, deg. It is
        compared modulo 720.
    pressure : ndarray (k,)
        Pa.
    noise : float
        Standard error expected of each value, Pa.
    signal : {"cylinder_pressure", "runner_pressure", "manifold_pressure"}
        What was measured.
    cylinder : int
        From 1.

    Notes
    -----
    The model's pressure is interpolated linearly between points as close as the closest two
    measured ones, but at most 1 deg apart. It says nothing of a cylinder between its
    compression TDC and its next IVO.
    """

    experiment: Experiment
    crank_angle_deg: FloatArray = field(repr=False)
    pressure: FloatArray = field(repr=False)
    noise: float
    signal: PressureSignal = "cylinder_pressure"
    cylinder: int = 1

    def __post_init__(self) -> None:
        angle = np.array(self.crank_angle_deg, dtype=float)
        pressure = np.array(self.pressure, dtype=float)
        if angle.ndim != 1 or angle.size < 2 or angle.shape != pressure.shape:
            raise ParameterError(
                f"crank_angle_deg has shape {angle.shape} and pressure {pressure.shape}, but both "
                "must be one-dimensional, of one length and at least 2 long"
            )
        bad = np.flatnonzero(~(np.isfinite(angle) & np.isfinite(pressure) & (pressure > 0.0)))
        if bad.size:
            i = int(bad[0])
            raise ParameterError(
                f"point {i} of the trace is {pressure[i]:g} Pa at {angle[i]:g} deg, but must be "
                "finite and above 0 Pa: leave such points out"
            )
        positive("noise", self.noise, "Pa")
        one_of("signal", self.signal, PRESSURE_SIGNALS)
        for name, array in (("crank_angle_deg", angle), ("pressure", pressure)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def measured(self) -> FloatArray:
        """Pressure, Pa."""
        return self.pressure

    @property
    def standard_error(self) -> FloatArray:
        """Standard error expected of each value, Pa."""
        return np.full(self.pressure.size, self.noise)

    def predict(self, cycle: Cycle) -> FloatArray:
        """Return the cycle's pressure at the measured crank angles, Pa.

        Raises
        ------
        ParameterError
            If the model says nothing at one of them.
        """
        between = np.diff(np.unique(np.mod(self.crank_angle_deg, 720.0)))
        closest = float(between.min()) if between.size else COARSEST_STEP_DEG
        step = min(max(closest, FINEST_STEP_DEG), COARSEST_STEP_DEG)
        # The cycle keeps its trace at 1 deg, which other observations of it can share.
        trace = cycle.trace if step == COARSEST_STEP_DEG else cycle.trace_at(step)
        signal = getattr(trace, self.signal)
        if signal.ndim == 2:
            signal = signal[:, self.cylinder - 1]
        first, count = trace.crank_angle_deg[0], trace.crank_angle_deg.size
        place = np.mod(self.crank_angle_deg - first, 720.0) / (720.0 / count)
        left = np.floor(place + 1e-9).astype(int)
        share = np.maximum(place - left, 0.0)
        below = signal[left % count]
        # On a point of the trace the next one does not matter, even if it is NaN.
        above = np.where(share > 1e-9, signal[(left + 1) % count], below)
        pressure = (1.0 - share) * below + share * above
        silent = np.flatnonzero(np.isnan(pressure))
        if silent.size:
            raise ParameterError(
                f"the model says nothing of the pressure in cylinder {self.cylinder} at "
                f"{self.crank_angle_deg[silent[0]]:g} deg, which is between its compression TDC "
                "and its next IVO: leave such points out"
            )
        return pressure

    def compare(self, modelled: FloatArray) -> tuple[str, ...]:
        """Return one line with the mean and the rms difference."""
        error = modelled - self.pressure
        where = "" if self.signal == "manifold_pressure" else f" {self.cylinder}"
        return (
            f"{self.signal.replace('_', ' ')}{where}: {error.size} points, difference "
            f"{error.mean():+.3g} Pa mean, {math.sqrt(np.mean(error**2)):.3g} Pa rms "
            f"(expected {self.noise:g})",
        )


def charge_observation(
    profile: str,
    speed_rpm: float,
    command: ValveCommand,
    throttle_deg: float,
    air_charge: float | None,
    pumping_loss: float | None,
) -> ChargeObservation:
    """Return one row of a table of charges (kg) and losses (J) as an observation.

    Parameters
    ----------
    profile : {"camless", "simplified", "conventional"}
        Valve motion; the paper calls the camless one of Eq. 20 simplified.
    speed_rpm, command, throttle_deg
        Operating point.
    air_charge, pumping_loss : float or None
        kg and J per event; None where there is no figure.
    """
    one_of("profile", profile, ("camless", "simplified", "conventional"))
    kind: Profile = "conventional" if profile == "conventional" else "camless"
    in_range("throttle_deg", throttle_deg, 0.0, 90.0, "deg", open_low=True)
    return ChargeObservation(
        Experiment(speed_rpm, command, throttle_deg, kind), air_charge, pumping_loss
    )
