"""Generalised plant of the mixed-sensitivity problem, with named signals."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from plant._checks import in_range
from plant.errors import ParameterError

from .hinf import state_space

if TYPE_CHECKING:
    import control

    Weight: TypeAlias = control.StateSpace | control.TransferFunction | float | None


def mixed_sensitivity(
    G: control.StateSpace | control.TransferFunction,
    W1: Weight,
    W2: Weight,
    W3: Weight,
) -> control.StateSpace:
    """Plant whose closed loop is ``(W1 S; W2 K S; W3 T)`` (Skogestad and Postlethwaite, 2.8.3).

    Signals with m controls and p outputs: in ``reference[1..p]`` and ``control[1..m]``; out
    ``error_weighted[1..p]``, ``control_weighted[1..m]``, ``output_weighted[1..p]`` (those
    with a weight) and ``error[1..p]``, which is reference minus output and what the
    controller sees: ``n_meas = p``, ``n_ctrl = m``.

    Parameters
    ----------
    G : control.StateSpace or control.TransferFunction
        Plant, continuous or discrete.
    W1, W2, W3 : system, float or None
        Weights of error, control and output. A weight of one signal serves all; a matrix
        weight must be square and of its signal's size.

    Raises
    ------
    ParameterError
        If no weight is given, a size or a sampling time does not fit, or a weight is improper.
    """
    import control

    G = state_space(G, "G")
    p, m = G.noutputs, G.ninputs
    sizes = {"W1": p, "W2": m, "W3": p}
    targets = {"W1": "error", "W2": "control", "W3": "output"}
    plant = _named(G, G.dt, _labels("control", m), _labels("output", p), "plant")
    error = control.ss(
        [], [], [], np.hstack([np.eye(p), -np.eye(p)]), G.dt,
        inputs=_labels("reference", p) + _labels("output", p),
        outputs=_labels("error", p), name="comparison",
    )  # fmt: skip
    systems = [plant, error]
    weighted: list[str] = []
    for name, weight in (("W1", W1), ("W2", W2), ("W3", W3)):
        if weight is None:
            continue
        inputs = _labels(targets[name], sizes[name])
        outputs = _labels(f"{targets[name]}_weighted", sizes[name])
        systems.append(
            _named(_weight(name, weight, sizes[name], G.dt), G.dt, inputs, outputs, name)
        )
        weighted += outputs
    if not weighted:
        raise ParameterError("no weight is given: give at least one of W1, W2 and W3")
    built = control.interconnect(
        systems,
        inputs=_labels("reference", p) + _labels("control", m),
        outputs=weighted + _labels("error", p),
        name="mixed_sensitivity",
    )
    return _named(built, G.dt, built.input_labels, built.output_labels, "mixed_sensitivity")


def _labels(name: str, n: int) -> list[str]:
    return [f"{name}[{i + 1}]" for i in range(n)]


def _weight(
    name: str, weight: control.lti.LTI | float, size: int, dt: float | bool | None
) -> control.StateSpace:
    """Weight as a square system of its signal's size and of the plant's sampling time."""
    import control

    if isinstance(weight, int | float):
        gain = in_range(name, weight, -1e12, 1e12, "1")
        system = control.ss([], [], [], [[gain]], dt)
    else:
        system = state_space(weight, name)
    if system.nstates and system.dt != dt:
        raise ParameterError(
            f"{name} has the sampling time {system.dt}, but the plant has {dt}: convert the "
            "weight with control.sample_system, or build it for the plant's sampling time"
        )
    if (system.noutputs, system.ninputs) == (1, 1) and size > 1:
        return control.append(*[system] * size)
    if (system.noutputs, system.ninputs) != (size, size):
        raise ParameterError(
            f"{name} is {system.noutputs} x {system.ninputs}, but must be 1 x 1 or {size} x {size}"
        )
    return system


def _named(
    system: control.StateSpace,
    dt: float | bool | None,
    inputs: list[str],
    outputs: list[str],
    name: str,
) -> control.StateSpace:
    import control

    return control.ss(
        system.A, system.B, system.C, system.D, dt, inputs=inputs, outputs=outputs, name=name
    )
