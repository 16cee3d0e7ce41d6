import control
import numpy as np
import pytest


@pytest.fixture(scope="session")
def distillation():
    """Skogestad and Postlethwaite's distillation column with its inverse-based controller.

    Section 8.11.3 of the second edition. The integrators of controller and weight stand at
    -1e-6 instead of 0, since mu needs a stable plant. From (u, d) to (w_I u, w_P y).
    """
    shift = 1e-6
    gain = np.array([[87.8, -86.4], [108.2, -109.6]])
    s = control.tf("s")

    def named(system, inputs, outputs, name):
        return control.ss(
            system.A,
            system.B,
            system.C,
            system.D,
            inputs=[f"{inputs}{i}" for i in (1, 2)],
            outputs=[f"{outputs}{i}" for i in (1, 2)],
            name=name,
        )

    def double(channel):
        return control.append(control.ss(channel), control.ss(channel))

    parts = [
        named(gain * double(1 / (75 * s + 1)), "a", "g", "plant"),
        named(
            double(0.7 * (75 * s + 1) / (s + shift)) * np.linalg.inv(gain), "e", "k", "controller"
        ),
        named(double((s + 0.2) / (0.5 * s + 1)), "k", "z", "input_weight"),
        named(double((0.5 * s + 0.05) / (s + shift)), "y", "p", "performance_weight"),
    ]
    sums = []
    for i in ("1", "2"):
        sums += [
            control.summing_junction(["k" + i, "u" + i], "a" + i, name="input" + i),
            control.summing_junction(["g" + i, "d" + i], "y" + i, name="output" + i),
            control.summing_junction(["-y" + i], "e" + i, name="error" + i),
        ]
    return control.ss(
        control.interconnect(
            parts + sums,
            inputs=["u1", "u2", "d1", "d2"],
            outputs=["z1", "z2", "p1", "p2"],
        )
    )
