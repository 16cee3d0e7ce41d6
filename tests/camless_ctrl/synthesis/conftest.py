"""Plants of the textbook."""

from __future__ import annotations

import control
import numpy as np
import pytest


def _labels(name: str) -> list[str]:
    return [f"{name}[0]", f"{name}[1]"]


def _twice(numerator, denominator, source: str, target: str, name: str) -> control.StateSpace:
    one = control.ss(control.tf(numerator, denominator))
    two = control.append(one, one)
    return control.ss(
        two.A, two.B, two.C, two.D, inputs=_labels(source), outputs=_labels(target), name=name
    )


@pytest.fixture(scope="session")
def distillation() -> control.StateSpace:
    """Skogestad and Postlethwaite, 8.12.4, with diagonal input uncertainty: the plant N of D-K.

    Blocks 1, 1 (uncertainty of the inputs) and 2 (performance).
    """
    lag = _twice([1], [75, 1], "input", "lagged", "lag")
    gains = np.array([[87.8, -86.4], [108.2, -109.6]])
    G = control.ss(
        lag.A, lag.B, gains @ lag.C, np.zeros((2, 2)),
        inputs=_labels("input"), outputs=_labels("output"), name="G",
    )  # fmt: skip
    systems = [
        G,
        _twice([1, 0.2], [0.5, 1], "control", "uncertain", "WI"),
        _twice([0.5, 0.05], [1, 1e-4], "disturbed", "error", "WP"),
        control.summing_junction(["control", "perturbation"], "input", dimension=2, name="in"),
        control.summing_junction(["output", "disturbance"], "disturbed", dimension=2, name="out"),
        control.summing_junction(["-disturbed"], "measured", dimension=2, name="minus"),
    ]
    inputs = [*_labels("perturbation"), *_labels("disturbance"), *_labels("control")]
    outputs = [*_labels("uncertain"), *_labels("error"), *_labels("measured")]
    return control.interconnect(systems, inputs=inputs, outputs=outputs)


@pytest.fixture(scope="session")
def example_2_17() -> tuple[control.TransferFunction, control.TransferFunction]:
    """Plant and performance weight of Skogestad and Postlethwaite, Example 2.17."""
    s = control.tf("s")
    G = 200 / ((10 * s + 1) * (0.05 * s + 1) ** 2)
    return G, (s / 1.5 + 10) / (s + 10 * 1e-4)
