"""Residuals: how far a perturbed response lies from a nominal one, over frequency.

=======================  =======================  ============================
kind                     residual                 the perturbed plant is
=======================  =======================  ============================
additive                 ``G - G0``               ``G0 + D``
input-multiplicative     ``G0^-1 (G - G0)``       ``G0 (I + D)``
output-multiplicative    ``(G - G0) G0^-1``       ``(I + D) G0``
=======================  =======================  ============================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from plant import ParameterError
from plant._checks import in_range, one_of
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._lifted_data import LiftedData
from .frequency import LiftedResponse

Kind = Literal["additive", "input-multiplicative", "output-multiplicative"]

WORST_CONDITION = 1e6  # of a nominal response that is divided by


@dataclass(frozen=True)
class Residual(LiftedData):
    """Residual of a perturbed response against a nominal one.

    Attributes
    ----------
    omega, response, inputs, outputs, cycle_time
        As in `LiftedData`; a multiplicative residual goes from inputs to inputs, or from
        outputs to outputs.
    kind : str
        Which residual.
    title_of : str
        Perturbed plant, nominal plant and signals.
    relative : bool
        Whether signals are relative changes.
    condition : float
        Largest condition number of the nominal response over frequency.
    """

    kind: Kind
    title_of: str
    relative: bool
    condition: float

    @property
    def title(self) -> str:
        """What a picture is headed with."""
        return f"{self.kind} residual,\n{self.title_of}"

    @property
    def peak(self) -> float:
        """Largest singular value over all frequencies."""
        return float(self.largest_singular_value.max())

    @property
    def peak_omega(self) -> float:
        """Frequency of the largest singular value, rad/s."""
        return float(self.omega[int(np.argmax(self.largest_singular_value))])

    def __str__(self) -> str:
        """Return kind, plants, the largest residual and that of each mode."""
        modes = ", ".join(
            f"{np.abs(self.mode_band(q)[1]).max():.3g} in mode {q}"
            for q in range(self.n_cylinders // 2 + 1)
        )
        return (
            f"{self.kind} residual, {self.title_of}: at most {self.peak:.3g}, at "
            f"{self.peak_omega:.3g} rad/s (at most {modes})"
        )


def residual(
    perturbed: LiftedResponse,
    nominal: LiftedResponse,
    kind: Kind = "output-multiplicative",
    *,
    worst_condition: float = WORST_CONDITION,
) -> Residual:
    """Return the residual of a perturbed response against a nominal one.

    Parameters
    ----------
    perturbed, nominal : LiftedResponse
        Responses with the same signals on the same frequencies. Each is relative to its own
        steady values, unless `LiftedResponse.scaled_as` says otherwise.
    kind : {"output-multiplicative", "input-multiplicative", "additive"}
        Which residual.
    worst_condition : float
        Largest condition number of the nominal response that a multiplicative residual may
        divide by.

    Raises
    ------
    ParameterError
        If the responses do not fit together, or the nominal one is singular or nearly so.
    """
    one_of("kind", kind, get_args(Kind))
    in_range("worst_condition", worst_condition, 1.0, 1e15, "1")
    check_same_grid(perturbed, nominal)
    G, G0 = perturbed.response, nominal.response
    condition = _conditions(G0)
    difference = G - G0
    inputs, outputs = nominal.inputs, nominal.outputs
    if kind != "additive":
        k = int(np.argmax(condition))
        if not condition[k] <= worst_condition:
            raise ParameterError(
                f"the nominal response ({nominal.title}) has the condition number "
                f"{condition[k]:.2g} at {nominal.omega[k]:.4g} rad/s, but at most "
                f"{worst_condition:.2g} may be divided by: use the additive residual, leave the "
                "frequency out, or raise worst_condition"
            )
        difference = _divided(difference, G0, kind)
        inputs, outputs = (inputs, inputs) if kind.startswith("input") else (outputs, outputs)
    return Residual(
        omega=nominal.omega,
        response=difference,
        inputs=inputs,
        outputs=outputs,
        cycle_time=nominal.cycle_time,
        kind=kind,
        title_of=(
            f"{nominal.signals}, {perturbed.source} against {nominal.source}, "
            f"{perturbed.speed_rpm:g} rpm"
        ),
        relative=nominal.relative or kind != "additive",
        condition=float(condition.max()),
    )


def check_same_grid(perturbed: LiftedResponse, nominal: LiftedResponse) -> None:
    """Check that two responses have the same signals, frequencies and cycle.

    Raises
    ------
    ParameterError
        If they have not.
    """
    if (perturbed.inputs, perturbed.outputs) != (nominal.inputs, nominal.outputs):
        raise ParameterError(
            f"the perturbed response goes from {len(perturbed.inputs)} {perturbed.signals}, the "
            f"nominal one from {len(nominal.inputs)} {nominal.signals}: ask for the same input "
            "and output of engines with the same number of cylinders"
        )
    if perturbed.relative != nominal.relative:
        raise ParameterError(
            "one response is relative and the other one in units of its own: ask for the same "
            "`relative`"
        )
    if not np.isclose(perturbed.cycle_time, nominal.cycle_time, rtol=1e-9):
        raise ParameterError(
            f"the perturbed response holds at {perturbed.speed_rpm:g} rpm, the nominal one at "
            f"{nominal.speed_rpm:g} rpm: take both at one speed"
        )
    same = perturbed.omega.shape == nominal.omega.shape
    if not same or not np.allclose(perturbed.omega, nominal.omega, rtol=1e-9, atol=1e-12):
        raise ParameterError(
            f"the perturbed response has {_range(perturbed.omega)}, the nominal one "
            f"{_range(nominal.omega)}: give both the same omega"
        )


def _divided(difference: ComplexArray, G0: ComplexArray, kind: Kind) -> ComplexArray:
    if kind == "input-multiplicative":
        return np.asarray(np.linalg.solve(G0, difference))
    # X G0 = difference, transposed
    turned = np.linalg.solve(G0.transpose(0, 2, 1), difference.transpose(0, 2, 1))
    return np.asarray(turned.transpose(0, 2, 1))


def _conditions(G0: ComplexArray) -> FloatArray:
    """Condition number at each frequency; infinite where the response is singular."""
    values = np.linalg.svd(G0, compute_uv=False)
    least, largest = values[:, -1], values[:, 0]
    return np.divide(largest, least, out=np.full(least.shape, np.inf), where=least > 0.0)


def _range(omega: FloatArray) -> str:
    return f"{omega.size} frequencies from {omega[0]:.4g} to {omega[-1]:.4g} rad/s"
