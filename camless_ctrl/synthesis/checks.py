"""What a generalised plant must satisfy before an H-infinity solver may see it.

The conditions are those of Glover and Doyle (1988), as SLICOT SB10AD states them; Zhou, Doyle
and Glover, *Robust and Optimal Control*, 16.2. A discrete plant is tested after the bilinear
transform: there D12 and D21 are the responses at the Nyquist frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant._checks import whole
from plant.errors import ParameterError

from ._realisation import (
    FloatArray,
    Realisation,
    partition,
    realisation_of,
    to_continuous,
)
from .errors import SynthesisError

if TYPE_CHECKING:
    import control

_RANK = 1e-7  # of the feedthroughs, relative to the largest singular value
_PENCIL = 1e-10  # of the pencils, relative to their norm after scaling
_SMALL_WEIGHT = 1e-2  # of the gain at the fastest pole: felt beyond it only


@dataclass(frozen=True)
class CheckItem:
    """One condition: whether it holds, a sentence on it, and a remedy if it does not."""

    name: str
    passed: bool
    sentence: str
    remedy: str = ""

    def __str__(self) -> str:
        """Return the sentence, with the remedy of a failed item."""
        return self.sentence if self.passed else f"{self.sentence}: {self.remedy}"


@dataclass(frozen=True)
class SynthesisCheck:
    """Conditions of a generalised plant.

    Attributes
    ----------
    items : tuple of CheckItem
        Every condition that was tested.
    """

    items: tuple[CheckItem, ...]

    @property
    def passed(self) -> bool:
        """Whether all conditions hold."""
        return all(item.passed for item in self.items)

    @property
    def failures(self) -> tuple[CheckItem, ...]:
        """Conditions that do not hold."""
        return tuple(item for item in self.items if not item.passed)

    def __getitem__(self, name: str) -> CheckItem:
        """Return the item of that name."""
        for item in self.items:
            if item.name == name:
                return item
        raise KeyError(f"no item {name!r}; there are {', '.join(i.name for i in self.items)}")

    def __str__(self) -> str:
        """Return the verdict and each failed item with its remedy."""
        if self.passed:
            return f"the plant is fit for synthesis: all {len(self.items)} conditions hold"
        failed = len(self.failures)
        count = "1 condition fails" if failed == 1 else f"{failed} conditions fail"
        lines = [f"the plant is not fit for synthesis ({count})"]
        return "\n".join(lines + [f"- {item}" for item in self.failures])

    def require(self) -> None:
        """Raise if a condition does not hold.

        Raises
        ------
        SynthesisError
            With every failed condition and its remedy.
        """
        if not self.passed:
            raise SynthesisError(str(self))


def check_synthesis(
    P: control.StateSpace | control.TransferFunction, n_meas: int, n_ctrl: int
) -> SynthesisCheck:
    """Test whether an H-infinity controller can be computed for a generalised plant.

    Parameters
    ----------
    P : control.StateSpace or control.TransferFunction
        Generalised plant, continuous or discrete; the last `n_meas` outputs go to the
        controller, the last `n_ctrl` inputs come from it.
    n_meas, n_ctrl : int
        Numbers of measurements and of controls.
    """
    import control

    state_space = control.ss(P)
    return check_realisation(
        realisation_of(state_space),
        whole("n_meas", n_meas, 1, 1000),
        whole("n_ctrl", n_ctrl, 1, 1000),
        bool(control.isdtime(state_space, strict=True)),
        state_space.input_labels,
        state_space.output_labels,
    )


def check_realisation(
    P: Realisation,
    n_meas: int,
    n_ctrl: int,
    discrete: bool,
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> SynthesisCheck:
    """Test plain matrices as `check_synthesis` does; the labels serve the sentences."""
    items = [_dimensions(P, n_meas, n_ctrl)]
    if not items[0].passed:
        return SynthesisCheck(tuple(items))
    if discrete:
        try:
            P = to_continuous(P)
        except ParameterError as error:
            sentence, _, remedy = str(error).partition(": ")
            items.append(CheckItem("bilinear transform", False, sentence, remedy))
            return SynthesisCheck(tuple(items))
    g = partition(P, n_meas, n_ctrl)
    controls, measurements = list(inputs)[-n_ctrl:], list(outputs)[-n_meas:]
    items.append(_modes(g.A, g.B2, discrete, "stabilisable", "moved by the controls"))
    items.append(_modes(g.A.T, g.C2.T, discrete, "detectable", "seen in the measurements"))
    d12 = _feedthrough(P, g.D12, n_meas, n_ctrl, discrete, "D12", controls)
    d21 = _feedthrough(P, g.D21.T, n_meas, n_ctrl, discrete, "D21", measurements)
    items += [d12, d21]
    if d12.passed:  # else the rank drops at infinity, and the zeros have no meaning
        items.append(_axis_zeros(g.A, g.B2, g.C1, g.D12, discrete, "control zeros"))
    if d21.passed:
        items.append(_axis_zeros(g.A.T, g.C2.T, g.B1.T, g.D21.T, discrete, "measurement zeros"))
    return SynthesisCheck(tuple(items))


def _dimensions(P: Realisation, n_meas: int, n_ctrl: int) -> CheckItem:
    p, m = P.D.shape
    errors, disturbances = p - n_meas, m - n_ctrl
    sentence = (
        f"the plant has {P.order} states, {disturbances} disturbances and {n_ctrl} controls in, "
        f"{errors} errors and {n_meas} measurements out"
    )
    if P.order < 1:
        return CheckItem(
            "dimensions", False, sentence, "give it dynamics, or choose a constant gain"
        )
    if errors < n_ctrl:
        return CheckItem(
            "dimensions", False, sentence, "weigh every control in the errors (W2), so that "
            "there are at least as many errors as controls"
        )  # fmt: skip
    if disturbances < n_meas:
        return CheckItem(
            "dimensions", False, sentence, "add a noise input to each measurement, so that there "
            "are at least as many disturbances as measurements"
        )  # fmt: skip
    if not all(np.all(np.isfinite(M)) for M in P):
        return CheckItem("dimensions", False, "the plant has entries that are not finite",
                         "look for a division by zero in a weight")  # fmt: skip
    return CheckItem("dimensions", True, sentence)


def _scaled(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """States balanced, inputs and outputs brought to the size of A; that size.

    The rank of the pencil is the same, but its singular values can be judged.
    """
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    A = np.asarray(balanced, dtype=float)
    size = float(np.linalg.norm(A, 2)) or 1.0
    B, C = B / scale[:, None], C * scale
    c = size / (float(np.linalg.norm(C, 2)) or size)
    C, D = c * C, c * D
    b = size / (float(np.linalg.norm(np.vstack([B, D]), 2)) or size)
    return A, b * B, C, b * D, size


def _modes(A: FloatArray, B: FloatArray, discrete: bool, name: str, what: str) -> CheckItem:
    """Popov-Belevitch-Hautus test of the modes that are not strictly stable."""
    none = np.zeros((0, len(A)))
    A, B, _, _, size = _scaled(A, B, none, np.zeros((0, B.shape[1])))
    lost = []
    for pole in np.linalg.eigvals(A):
        if pole.real >= -_PENCIL * size and pole.imag >= 0.0:
            pencil = np.hstack([A - pole * np.eye(len(A)), B])
            if np.linalg.svd(pencil, compute_uv=False)[-1] <= _PENCIL * size:
                lost.append(_place(pole, discrete))
    if not lost:
        return CheckItem(name, True, f"every mode that is not stable can be {what}")
    return CheckItem(
        name,
        False,
        f"the plant is not {name}: the mode at {', '.join(lost)} is not stable and cannot be "
        f"{what}",
        "if it is an integrator in a weight, give it a corner instead, 1/(s + 1e-4 times the "
        "bandwidth); if it belongs to the plant, "
        + ("add an actuator" if name == "stabilisable" else "measure more"),
    )


def _feedthrough(
    P: Realisation,
    D: FloatArray,
    n_meas: int,
    n_ctrl: int,
    discrete: bool,
    name: str,
    labels: Sequence[str],
) -> CheckItem:
    """Full column rank of D12, or of the transpose of D21."""
    _, sizes, right = np.linalg.svd(D)
    where = "at the Nyquist frequency" if discrete else "at infinite frequency"
    from_to = {"D12": "controls to errors", "D21": "disturbances to measurements"}[name]
    least = max(_RANK * sizes[0], _rounding(P) if discrete else 0.0)
    if sizes[-1] > least:
        return CheckItem(name, True, f"the response from {from_to} {where} ({name}) has full rank")
    blind = labels[int(np.argmax(np.abs(right[-1])))]
    weight = _SMALL_WEIGHT * _typical_gain(P, n_meas, n_ctrl, name)
    rank = int(np.sum(sizes > least))
    if name == "D12":
        consequence = f"{blind} costs nothing at high frequency"
        remedy = f"add a small W2 weight of about {weight:.1g} on {blind} to regularise"
    else:
        consequence = f"{blind} is free of noise at high frequency"
        remedy = f"add a noise input of a weight of about {weight:.1g} to {blind} to regularise"
    return CheckItem(
        name,
        False,
        f"the response from {from_to} {where} ({name}) has rank {rank} instead of {len(sizes)}, "
        f"so that {consequence} and a solver may never end",
        remedy,
    )


def _typical_gain(P: Realisation, n_meas: int, n_ctrl: int, name: str) -> float:
    """Gain, at the corner of the fastest pole, of the part that lacks a feedthrough."""
    corner = float(np.abs(np.linalg.eigvals(P.A)).max()) or 1.0
    response = P.response(np.array([1j * corner * (1.0 + 1e-9)]))[0]
    p, m = P.D.shape[0] - n_meas, P.D.shape[1] - n_ctrl
    part = response[:p, m:] if name == "D12" else response[p:, :m]
    return float(np.linalg.norm(part, 2)) or 1.0


def _rounding(P: Realisation) -> float:
    """Size that errors of rounding give a feedthrough which comes from the transform."""
    parts = (np.linalg.norm(P.C, 2), np.linalg.norm(P.B, 2))
    return 1e4 * float(np.finfo(float).eps) * float(parts[0] * parts[1] + np.linalg.norm(P.D, 2))


def _axis_zeros(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, discrete: bool, name: str
) -> CheckItem:
    """Full column rank of ``(A - jw I, B; C, D)`` for all w, given that of D.

    Where the rank drops, s is an eigenvalue of ``A - B D+ C``.
    """
    from_to = {
        "control zeros": "controls to errors",
        "measurement zeros": "disturbances to measurements",
    }[name]
    A, B, C, D, size = _scaled(A, B, C, D)
    lost = []
    for zero in np.linalg.eigvals(A - B @ np.linalg.pinv(D) @ C):
        if abs(zero.real) <= 1e-3 * (abs(zero) + 1e-6 * size) and zero.imag >= 0.0:
            s = 1j * zero.imag
            pencil = np.block([[A - s * np.eye(len(A)), B], [C, D]])
            if np.linalg.svd(pencil, compute_uv=False)[-1] <= _PENCIL * size:
                lost.append(_place(s, discrete))
    boundary = "unit circle" if discrete else "imaginary axis"
    if not lost:
        return CheckItem(name, True, f"the plant from {from_to} has no zero on the {boundary}")
    return CheckItem(
        name,
        False,
        f"the plant from {from_to} has a zero on the {boundary}, at {', '.join(lost)}",
        "move a pole or zero of the plant or of a weight off it by about 1e-4 of the bandwidth, "
        "or add a small weight that sees it (an integrating plant needs a weighted disturbance "
        "at its input)",
    )


def _place(s: complex, discrete: bool) -> str:
    """Place of a mode in words of the plant's own plane."""
    if discrete:
        z = (1.0 + s) / (1.0 - s) if s != 1.0 else complex(np.inf)
        return f"z = {_number(z)}"
    return f"s = {_number(s)}"


def _number(value: complex) -> str:
    if abs(value.imag) <= 1e-9 * max(1.0, abs(value)):
        return f"{value.real + 0.0:.4g}"
    return f"{value.real:.4g} ± {abs(value.imag):.4g}j"
