"""A law and a measurement in closed loop, without uncertainty: per event and over a cycle.

Signals are relative: the charge error ``y = disturbance - correction`` is measured as
``estimate = P y + noise``, and the law gives ``correction = C estimate``. So the loop is
``L = C P`` under negative feedback, for each event the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import whole
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from .estimator import ChargeEstimator
from .event_loop import EventLoop, _adaptation_matrices, _as_state_space, lift
from .linearise import LocalResponse
from .measurement_response import MeasurementResponse, event_time
from .pulse_bank import pulse_bank
from .uncertain_loop import UncertainLoop

if TYPE_CHECKING:
    import control

_POINTS = 200  # frequencies on either side of the middle of a mode


@dataclass(frozen=True)
class NominalLoop:
    """Loop of equal cylinders without uncertainty.

    Parameters
    ----------
    law : control.StateSpace
        ``C`` per event, from the estimate to the correction.
    measurement : control.StateSpace
        ``P`` per event, from the charge to its estimate, delays and latency included.
    n_cylinders : int
        Number of cylinders.
    """

    law: control.StateSpace = field(repr=False)
    measurement: control.StateSpace = field(repr=False)
    n_cylinders: int

    def __post_init__(self) -> None:
        whole("n_cylinders", self.n_cylinders, 1, 24)
        for name, system in (("law", self.law), ("measurement", self.measurement)):
            if not system.issiso():
                raise ParameterError(
                    f"the {name} has {system.ninputs} inputs and {system.noutputs} outputs, but "
                    "must have one each: give it per event"
                )
            if system.dt is None or system.dt is True or not system.dt > 0.0:
                raise ParameterError(
                    f"the {name} has the sampling time {system.dt}, but must have the event time "
                    "in s: set dt"
                )
        if not np.isclose(self.law.dt, self.measurement.dt, rtol=1e-9):
            raise ParameterError(
                f"the law's sampling time is {self.law.dt:g} s, but must be that of the "
                f"measurement, {self.measurement.dt:g} s: take both at one speed"
            )

    @classmethod
    def of_event_loop(cls, loop: EventLoop) -> Self:
        """Return the parts of an `EventLoop`; its sensitivity goes to the measurement."""
        import control

        T = loop.measurement.event_time
        law = control.ss(*_adaptation_matrices(loop.n_cylinders, loop.latency, loop.gains), T)
        return cls(law, loop.sensitivity * loop.measurement.system(loop.latency), loop.n_cylinders)

    @classmethod
    def of_uncertain_loop(
        cls, loop: UncertainLoop, deltas: Mapping[str, float] | None = None
    ) -> Self:
        """Return the loop for normalised values of the real parameters, the middle by default."""
        m = loop.measurement
        total = m.centre
        for name, delta in (deltas or {}).items():
            if name not in m.directions:
                raise ParameterError(
                    f"no parameter is named {name!r}: there are {', '.join(m.directions)}"
                )
            total = total + m.directions[name].scaled(delta)
        bank = pulse_bank(
            [total], m.latency, input="charge", outputs=["estimate"], name="measurement"
        )
        return cls(loop.law, bank, m.n_cylinders)

    @classmethod
    def of_sensor(
        cls,
        law: control.StateSpace,
        local: LocalResponse,
        estimator: ChargeEstimator,
        *,
        time_constant: float = 15e-3,
        delay: float = 1e-3,
    ) -> Self:
        """Return the loop of a full plant through a MAF sensor of given lag and delay (s).

        Parameters
        ----------
        law : control.StateSpace
            From the estimate to the correction, per event.
        local : LocalResponse
            Full plant around the operating point.
        estimator : ChargeEstimator
            The estimator, with the lag and delay that it assumes.
        time_constant, delay : float
            Lag and delay that the sensor has, s.
        """
        T = event_time(local.speed_rpm, local.n_cylinders)
        response = MeasurementResponse.of_maf(
            estimator, T, time_constant=time_constant, delay=delay, shape=local.shape
        )
        seen = local.sensitivity * response.system(estimator.latency_events(T))
        return cls(law, seen, local.n_cylinders)

    @property
    def event_time(self) -> float:
        """Event time, s."""
        return float(self.measurement.dt)

    def __call__(self, z: ArrayLike) -> ComplexArray:
        """Loop response ``L`` at points `z` per event; infinite at the integrators."""
        z = np.asarray(z, dtype=complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            law = np.asarray(self.law(z, warn_infinite=False), dtype=complex)
            seen = np.asarray(self.measurement(z, warn_infinite=False), dtype=complex)
            return np.asarray(law * seen, dtype=complex)

    @cached_property
    def closed(self) -> control.StateSpace:
        """Closed loop: ``disturbance``, ``noise`` in; ``charge``, ``correction``, ``estimate`` out.

        Per event.
        """
        import control

        Ap, Bp, Cp, Dp = _matrices(self.measurement)
        Ac, Bc, Cc, Dc = _matrices(self.law)
        direct = 1.0 + float(Dp[0, 0] * Dc[0, 0])
        if direct == 0.0:
            raise ParameterError(
                "law times measurement is -1 within the event, so that the loop has no solution: "
                "let one of them take an event"
            )
        # Rows on (states of measurement, of law), then on (disturbance, noise).
        estimate = np.hstack((Cp, -Dp @ Cc)) / direct
        estimate_in = np.hstack((Dp, [[1.0]])) / direct
        correction = np.hstack((np.zeros_like(Cp), Cc)) + Dc @ estimate
        correction_in = Dc @ estimate_in
        charge, charge_in = -correction, np.array([[1.0, 0.0]]) - correction_in
        own = np.block(
            [
                [Ap, np.zeros((len(Ap), len(Ac)))],
                [np.zeros((len(Ac), len(Ap))), Ac],
            ]
        )
        return control.ss(
            own + np.vstack((Bp @ charge, Bc @ estimate)),
            np.vstack((Bp @ charge_in, Bc @ estimate_in)),
            np.vstack((charge, correction, estimate)),
            np.vstack((charge_in, correction_in, estimate_in)),
            self.event_time,
            inputs=["disturbance", "noise"],
            outputs=["charge", "correction", "estimate"],
            name="closed_loop",
        )

    def lifted(self, output: str, input: str) -> control.StateSpace:
        """Return one map of the closed loop over a cycle, n cylinders in and out.

        Parameters
        ----------
        output, input : str
            Names of `closed`.
        """
        import control

        names = self.closed.output_labels, self.closed.input_labels
        for name, known in zip((output, input), names, strict=True):
            if name not in known:
                raise ParameterError(f"no signal is named {name!r}: there are {', '.join(known)}")
        i, j = names[0].index(output), names[1].index(input)
        A, B, C, D = _matrices(self.closed)
        T, n = self.event_time, self.n_cylinders
        one = control.ss(A, B[:, j : j + 1], C[i : i + 1], D[i : i + 1, j : j + 1], T)
        return control.ss(
            *lift(one, n),
            n * T,
            inputs=[f"{input}[{k + 1}]" for k in range(n)],
            outputs=[f"{output}[{k + 1}]" for k in range(n)],
            name=f"{output}_of_{input}",
        )

    @cached_property
    def poles(self) -> ComplexArray:
        """Closed-loop poles per event."""
        return np.linalg.eigvals(np.asarray(self.closed.A))

    @property
    def stable(self) -> bool:
        """Whether all of them lie inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0))

    def later(self, events: int) -> NominalLoop:
        """Return the loop whose estimate comes some events later."""
        import control

        whole("events", events, 0, 1000)
        if events == 0:
            return self
        chain = control.ss(
            np.eye(events, k=-1),
            np.eye(events, 1),
            np.eye(1, events, k=events - 1),
            [[0.0]],
            self.event_time,
        )
        return replace(self, measurement=_as_state_space(control.series(self.measurement, chain)))

    @property
    def modes(self) -> range:
        """Circulant modes from 0 (the mean) to n/2; they stand for the others as well."""
        return range(self.n_cylinders // 2 + 1)

    def band(self, q: int) -> FloatArray:
        """Frequencies of mode `q`, rad/s, dense at its middle, where the integrators are.

        They reach half-way to the neighbours on the event circle.
        """
        n = self.n_cylinders
        whole("q", q, 0, n // 2, remedy="the others are mirrored")
        away = np.concatenate(([0.0], np.geomspace(1e-4, 1.0, _POINTS))) * np.pi / n
        angles = 2.0 * np.pi * q / n + np.concatenate((-away[:0:-1], away))
        inside = (angles > 0.0) & (angles < np.pi)
        ends = [a for a in (0.0, np.pi) if angles[0] <= a <= angles[-1] + 1e-12]
        found = np.unique(np.concatenate((angles[inside], ends)))
        return np.asarray(found / self.event_time)

    def mode_name(self, q: int) -> str:
        """What a mode is."""
        if q == 0:
            return "mean"
        alternating = " (alternating)" if 2 * q == self.n_cylinders else ""
        return f"imbalance q={q}{alternating}"


def _matrices(
    system: control.StateSpace,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    return (
        np.asarray(system.A, dtype=float),
        np.asarray(system.B, dtype=float),
        np.asarray(system.C, dtype=float),
        np.asarray(system.D, dtype=float),
    )
