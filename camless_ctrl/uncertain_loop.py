"""The air-charge loop with its uncertainty pulled out: M and Delta.

The measurement is ``E = E_c + sum_k d_k H_k + W D`` (`UncertainMeasurement`). Each real
parameter takes ``z_k = H_k y`` and gives ``w_k = d_k z_k``; the remainder takes ``z = W y`` and
gives ``w = D z``; all ``w`` add to the estimate. With ``y`` the true relative charge error,

    y = disturbance - correction,   estimate = z^-latency (E_c y + sum_k w_k + w),
    correction = C estimate,        error = W_p y.

Per event the loop is a system of one input and one output whose frequencies hold all circulant
modes, one a band. Lifted over a cycle it is the same for n cylinders; there each may differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError
from plant._checks import positive, whole
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from .adaptation import AdaptationGains
from .event_loop import _adaptation_matrices, _as_state_space, lift
from .mu.blocks import BlockStructure, ComplexBlock, Delta, RealBlock
from .pulse_bank import pulse_bank
from .uncertain_measurement import UncertainMeasurement

if TYPE_CHECKING:
    import control

REMAINDER = "remainder"  # name of the complex block
SENSITIVITY_BOUND = 2.0  # largest |S| that performance allows in the worst case


def adaptation_law(measurement: UncertainMeasurement, gains: AdaptationGains) -> control.StateSpace:
    """Return the adaptation as a law per event: ``estimate`` in, ``correction`` out."""
    import control

    A, B, C, D = _adaptation_matrices(measurement.n_cylinders, measurement.latency, gains)
    return control.ss(
        A,
        B,
        C,
        D,
        measurement.event_time,
        inputs=["estimate"],
        outputs=["correction"],
        states=[f"factor_{i}_events_ahead" for i in range(len(A))],
        name="adaptation",
    )


@dataclass(frozen=True)
class UncertainLoop:
    """Loop of a law with an uncertain measurement.

    Parameters
    ----------
    measurement : UncertainMeasurement
        The measurement.
    law : control.StateSpace
        From the estimate to the correction, per event.
    sensitivity_bound : float
        Bound on ``|S|`` that stands for performance: ``W_p = 1/bound``.
    """

    measurement: UncertainMeasurement
    law: control.StateSpace = field(repr=False)
    sensitivity_bound: float = SENSITIVITY_BOUND

    def __post_init__(self) -> None:
        positive("sensitivity_bound", self.sensitivity_bound, "1")
        if (self.law.ninputs, self.law.noutputs) != (1, 1):
            raise ParameterError(
                f"the law has {self.law.ninputs} inputs and {self.law.noutputs} outputs, but must "
                "have one each: from the estimate to the correction"
            )
        dt = self.law.dt
        if dt is None or dt is True or not np.isclose(dt, self.measurement.event_time, rtol=1e-9):
            given = "not given" if dt is None or dt is True else f"{dt:g} s"
            raise ParameterError(
                f"the law's sampling time is {given}, but must be the event time "
                f"of {self.measurement.event_time:g} s at {self.measurement.speed_rpm:g} rpm"
            )

    @classmethod
    def adaptive(
        cls,
        measurement: UncertainMeasurement,
        gains: AdaptationGains,
        sensitivity_bound: float = SENSITIVITY_BOUND,
    ) -> UncertainLoop:
        """Return the loop of the adaptation with the given gains."""
        return cls(measurement, adaptation_law(measurement, gains), sensitivity_bound)

    @property
    def structure(self) -> BlockStructure:
        """Blocks of the uncertainty: a real one a parameter, and the complex remainder."""
        reals = [RealBlock(name) for name in self.measurement.directions]
        return BlockStructure([*reals, ComplexBlock(REMAINDER)])

    @cached_property
    def system(self) -> control.StateSpace:
        """M: inputs ``w[...]`` and ``disturbance``, outputs ``z[...]`` and ``error``."""
        import control

        names = self.structure.names
        m = self.measurement
        bank = pulse_bank(
            [m.centre, *m.directions.values()],
            m.latency,
            input="charge",
            outputs=["seen", *(f"z[{name}]" for name in m.directions)],
            name="measurement",
        )
        weight = m.weight.system()
        weight.set_inputs(["charge"])
        weight.set_outputs([f"z[{REMAINDER}]"])
        weight.name = REMAINDER
        law = self.law.copy()
        law.set_inputs(["estimate"])
        law.set_outputs(["correction"])
        law.name = "law"
        added = ["seen", *(f"w[{name}]" for name in names)]
        parts = [
            bank,
            weight,
            law,
            control.summing_junction(added, "estimate", name="sum_of_estimate"),
            control.summing_junction(["disturbance", "-correction"], "charge", name="sum"),
            control.ss(
                [],
                [],
                [],
                [[1.0 / self.sensitivity_bound]],
                m.event_time,
                inputs=["charge"],
                outputs=["error"],
                name="performance",
            ),
        ]
        found = control.interconnect(
            parts,
            inputs=[*(f"w[{name}]" for name in names), "disturbance"],
            outputs=[*(f"z[{name}]" for name in names), "error"],
            name="uncertain_loop",
        )
        return _as_state_space(found)

    def loop_response(self, z: ComplexArray) -> ComplexArray:
        """Loop response of the middle of the set at points `z` per event."""
        z = np.asarray(z, dtype=complex)
        m = self.measurement
        law = np.asarray(self.law(z, warn_infinite=False), dtype=complex)
        return np.asarray(law * z**-m.latency * m.centre(z))

    @cached_property
    def poles(self) -> ComplexArray:
        """Closed-loop poles per event, for the middle of the set."""
        return np.linalg.eigvals(np.asarray(self.system.A))

    @property
    def stable(self) -> bool:
        """Whether all of them lie inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0))

    def perturbed(
        self, delta: Delta | Mapping[str, float] | control.StateSpace
    ) -> control.StateSpace:
        """Return the closed loop for a perturbation: ``disturbance`` in, ``error`` out.

        Parameters
        ----------
        delta : Delta, mapping of str to float, or control.StateSpace
            Values of the blocks, zero where none is given; or a system, such as
            `Delta.realise` returns.
        """
        import control

        from .mu import lft

        if not isinstance(delta, Delta | control.StateSpace):
            values = {name: 0.0 for name in self.structure.names} | dict(delta)
            delta = Delta(self.structure, values)
        return lft(self.system, delta)

    def spectral_radius(self, delta: Mapping[str, float]) -> float:
        """Largest pole radius per cycle for values of the real parameters (normalised)."""
        poles = np.linalg.eigvals(np.asarray(self.perturbed(delta).A))
        return float(np.max(np.abs(poles))) ** self.measurement.n_cylinders

    def lifted(self) -> control.StateSpace:
        """Return M lifted over a cycle: every input and output n times, event by event."""
        import control

        n, system = self.measurement.n_cylinders, self.system
        return control.ss(
            *lift(system, n),
            n * self.measurement.event_time,
            inputs=[f"{name}({k + 1})" for k in range(n) for name in system.input_labels],
            outputs=[f"{name}({k + 1})" for k in range(n) for name in system.output_labels],
            name="lifted_uncertain_loop",
        )

    def band(self, q: int, points: int = 101) -> FloatArray:
        """Frequencies of mode `q`, rad/s: half-way to its neighbours on the event circle."""
        n = self.measurement.n_cylinders
        whole("q", q, 0, n // 2, remedy="the others are mirrored")
        whole("points", points, 2, 100_000)
        centre = 2.0 * np.pi * q / n
        low, high = max(centre - np.pi / n, 0.0), min(centre + np.pi / n, np.pi)
        return np.linspace(low, high, points) / self.measurement.event_time
