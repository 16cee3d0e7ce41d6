"""What an identification returns: values, their errors, and the residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ._engine_fields import field_unit
from .errors import ParameterError
from .kinematics import FloatArray
from .observations import Observation
from .parameters import Engine

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True)
class FreeParameter:
    """A number to be fitted, which one or more fields of the engine share.

    Attributes
    ----------
    name : str
        Name in results, `initial` and `bounds`.
    fields : tuple of str
        Fields that take its value; see `plant.engine_fields.engine_fields`.
    """

    name: str
    fields: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", tuple(self.fields))
        if not self.fields:
            raise ParameterError(f"parameter {self.name!r} has no field: name at least one")


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationResult:
    """Parameters fitted to observations, with what is known of their errors.

    Attributes
    ----------
    engine : Engine
        The engine with the fitted values.
    parameters : tuple of FreeParameter
        What was fitted, `p` numbers.
    values : dict of str to float
        Fitted value of each parameter.
    covariance : ndarray (p, p)
        Covariance of the values, from the slope of the model and the scatter of the residuals.
    confidence : float
        Confidence of the intervals.
    observations : tuple of Observation
        The data.
    modelled : tuple of ndarray
        What the fitted engine says in place of each observation.
    at_bound : tuple of str
        Parameters that ended on a bound; their intervals mean little.
    evaluations : int
        Engines simulated.
    """

    engine: Engine
    parameters: tuple[FreeParameter, ...]
    values: dict[str, float]
    covariance: FloatArray
    confidence: float
    observations: tuple[Observation, ...]
    modelled: tuple[FloatArray, ...]
    at_bound: tuple[str, ...]
    evaluations: int

    @property
    def residuals(self) -> FloatArray:
        """Modelled minus measured of every value, in standard errors expected of it."""
        return np.concatenate(
            [
                (m - o.measured) / o.standard_error
                for o, m in zip(self.observations, self.modelled, strict=True)
            ]
        )

    @property
    def rms(self) -> float:
        """Root mean square of `residuals`; about 1 if the expected errors are right."""
        return math.sqrt(float(np.mean(self.residuals**2)))

    @property
    def degrees_of_freedom(self) -> int:
        """Number of values less that of parameters."""
        return self.residuals.size - len(self.parameters)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error of each value."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def confidence_intervals(self) -> dict[str, tuple[float, float]]:
        """Low and high end of each value's interval, from Student's t distribution."""
        from scipy.special import stdtrit

        quantile = float(stdtrit(self.degrees_of_freedom, 0.5 + 0.5 * self.confidence))
        errors = self.standard_errors
        return {
            name: (value - quantile * errors[name], value + quantile * errors[name])
            for name, value in self.values.items()
        }

    @property
    def correlation(self) -> FloatArray:
        """Correlation (p, p) of the errors of the values."""
        deviation = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(deviation, deviation)

    def __str__(self) -> str:
        """Return a table of the parameters and one of the residuals."""
        names, errors = list(self.values), self.standard_errors
        width = max(9, *(len(name) for name in names))
        lines = [
            f"{len(names)} parameters fitted to {self.residuals.size} values "
            f"({self.evaluations} engines simulated)",
            f"  {'parameter':{width}}  {'value':>11}  {'std. error':>10}  "
            f"{f'{100.0 * self.confidence:g} % confidence interval':>25}  unit",
        ]
        for parameter in self.parameters:
            name = parameter.name
            low, high = self.confidence_intervals[name]
            note = "  (on its bound)" if name in self.at_bound else ""
            lines.append(
                f"  {name:{width}}  {self.values[name]:11.5g}  {errors[name]:10.2g}  "
                f"{f'{low:.5g} to {high:.5g}':>25}  {field_unit(parameter.fields[0])}{note}"
            )
        if len(names) > 1:
            apart = np.abs(self.correlation) - np.eye(len(names))
            i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
            lines.append(
                f"  largest correlation: {self.correlation[i, j]:+.2f} of {names[min(i, j)]} and "
                f"{names[max(i, j)]}"
            )
        lines.append(f"  residuals: rms {self.rms:.3g} of the error expected")
        for o, m in zip(self.observations, self.modelled, strict=True):
            lines += [f"  {o.experiment}: {text}" for text in o.compare(m)]
        return "\n".join(lines)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the residuals in the order of the observations."""
        from ._plotting import axes, styled

        with styled():
            ax = axes(ax)
            ax.axhline(0.0, c="0.4", lw=0.8)
            ax.plot(np.arange(1, self.residuals.size + 1), self.residuals, ".")
            ax.set_xlabel("value")
            ax.set_ylabel("residual (standard errors)")
        return ax
