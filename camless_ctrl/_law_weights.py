"""Weights and generalised plants of the law per event.

The loop has one input and one output. So it may be opened at the estimate as well as at the
correction, and the perturbation of the estimate acts as an additive one on ``z^-latency E_c``:
it is withstood if ``|W_a K S| < 1``. All perturbations add at one point and see one signal, so
taken as complex they are as large together as one of the weight ``W_a = sum_k |H_k| + |W|``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant.kinematics import FloatArray
from uncertainty.weights import fit_weight

from ._rank_one import UncertainValues
from .adaptation import AdaptationGains
from .pulse_bank import pulse_bank
from .synthesis import mixed_sensitivity

if TYPE_CHECKING:
    import control

    from .uncertain_measurement import UncertainMeasurement

_LEAK = 3e-3  # by which the poles of the performance weight lie inside the circle, per cycle
_POINTS = 97  # frequencies for the fit
_MINIMAL = 1e-8  # tolerance of the minimal realisation


def nominal_plant(measurement: UncertainMeasurement) -> control.StateSpace:
    """Return ``z^-latency E_c`` with the fewest states."""
    import control

    m = measurement
    bank = pulse_bank([m.centre], m.latency, input="u", outputs=["y"], name="centre")
    return control.minreal(bank, _MINIMAL, verbose=False)


def performance_weight(
    measurement: UncertainMeasurement, paces: AdaptationGains, bound: float
) -> control.StateSpace:
    """Return W1: ``|S|`` at most `bound`, and small at the harmonics of the cycle.

    Around each n-th root of 1 it asks for the error of an integrator of the given gain per cycle:
    a pole just inside the circle, and a zero where that integrator has its closed-loop pole.
    Without a pace of the imbalance only the mean is weighted.
    """
    import control

    n = measurement.n_cylinders
    pace = np.full(n if paces.imbalance > 0.0 else 1, paces.imbalance)
    pace[0] = paces.mean
    roots = np.exp(2j * np.pi * np.arange(pace.size) / n)
    numerator = np.real(np.poly((1.0 - pace) ** (1.0 / n) * roots)) / bound
    denominator = np.real(np.poly((1.0 - _LEAK) ** (1.0 / n) * roots))
    return control.ss(control.tf(numerator, denominator, measurement.event_time))


def control_weight(
    measurement: UncertainMeasurement, share: float, effort: float
) -> control.StateSpace:
    """Return the weight of ``K S``: a share of all uncertainty, and the effort, in squares."""
    T = measurement.event_time

    def size(omega: FloatArray) -> FloatArray:
        values = UncertainValues.of(measurement, np.asarray(omega) * T)
        total = np.abs(values.directions).sum(axis=0) + values.weight
        return np.asarray(np.hypot(share * total, effort))

    grid = np.linspace(0.0, np.pi, _POINTS) / T
    weight = fit_weight(
        grid, size(grid), dt=T, orders=(0, 1, 2), floor=0.05, finer=size, name="uncertainty"
    )
    return weight.system()


def mixed_plant(
    G: control.StateSpace, W1: control.StateSpace, W2: control.StateSpace
) -> control.StateSpace:
    """Return the plant of ``(W1 S; W2 K S)``, the uncertainty in ``W2``."""
    return mixed_sensitivity(G, W1, W2, None)


def structured_plant(
    G: control.StateSpace, W1: control.StateSpace, W2: control.StateSpace
) -> control.StateSpace:
    """Return the plant with the perturbation and the performance as blocks of their own.

    In ``w``, ``disturbance`` and ``correction``; out ``z``, ``error`` and ``estimate``.
    """
    import control

    def named(system: control.StateSpace, input: str, output: str) -> control.StateSpace:
        return control.ss(
            system.A, system.B, system.C, system.D, G.dt,
            inputs=[input], outputs=[output], name=f"{output}_of_{input}",
        )  # fmt: skip

    added = ["disturbance", "w", "-seen"]
    built = control.interconnect(
        [
            named(G, "correction", "seen"),
            named(W2, "correction", "z"),
            named(W1, "estimate", "error"),
            control.summing_junction(added, "estimate", name="sum"),
        ],
        inputs=["w", "disturbance", "correction"],
        outputs=["z", "error", "estimate"],
        name="structured",
    )
    return control.ss(
        built.A, built.B, built.C, built.D, G.dt,
        inputs=["w", "disturbance", "correction"],
        outputs=["z", "error", "estimate"],
        name="structured",
    )  # fmt: skip
