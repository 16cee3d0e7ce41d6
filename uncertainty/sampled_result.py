"""Mode responses of a sample of plants, and their residuals against a nominal one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError, ValveCommand
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from .frequency import Input, ModeResponses, Output, mode_row
from .sampling import Sample

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class SampledResiduals:
    """Relative residuals ``(g - g0)/g0`` of each mode of each plant of a sample.

    Attributes
    ----------
    modes : tuple of int
        Modes.
    theta : ndarray (f,)
        Cycle phases, rad.
    response : ndarray (samples, modes, f)
        Residuals, 1.
    n_cylinders : int
        Number of cylinders.
    title : str
        Of what against what.
    """

    modes: tuple[int, ...]
    theta: FloatArray = field(repr=False)
    response: ComplexArray = field(repr=False)
    n_cylinders: int
    title: str

    def mode(self, q: int) -> ComplexArray:
        """Residuals of mode `q`, (samples, f)."""
        return self.response[:, mode_row(self.modes, q)]

    @property
    def envelope(self) -> FloatArray:
        """Largest magnitude over the samples, (modes, f)."""
        return np.asarray(np.abs(self.response).max(axis=0))

    @property
    def worst(self) -> int:
        """Sample with the largest residual of all."""
        return int(np.argmax(np.abs(self.response).max(axis=(1, 2))))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw largest and median magnitude of each mode over the angle per event."""
        from plant._plotting import COLOURS, axes, styled

        from ._mode_plot import mark_modes

        sizes = np.abs(self.response)
        with styled():
            ax = axes(ax)
            for k, q in enumerate(self.modes):
                angle = np.degrees((self.theta + 2.0 * np.pi * q) / self.n_cylinders)
                shown = (angle > -1e-9) & (angle < 180.0 + 1e-9)
                colour = COLOURS[k % len(COLOURS)]
                for values, style, name in (
                    (sizes[:, k].max(axis=0), "-", "largest"),
                    (np.median(sizes[:, k], axis=0), "--", "median"),
                ):
                    label = f"mode {q}, {name}"
                    ax.plot(angle[shown], values[shown], style, c=colour, label=label)
            mark_modes(ax, self.n_cylinders)
            ax.set_ylim(bottom=0.0)
            ax.set_xlabel("angle per event (deg)")
            ax.set_ylabel("relative residual (1)")
            ax.set_title(self.title)
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return what it is of, and the largest residual of each mode."""
        parts = (
            f"{row.max():.3g} in mode {q}" for q, row in zip(self.modes, self.envelope, strict=True)
        )
        return f"{self.title}: at most {', '.join(parts)} over {len(self.response)} plants"


@dataclass(frozen=True)
class SampledResponses:
    """Responses of the modes of each plant of a sample at one operating point.

    Attributes
    ----------
    modes : tuple of int
        Modes.
    theta : ndarray (f,)
        Cycle phases, rad, in ``[-pi, pi]``; mode q is at ``z = exp(j (theta + 2 pi q)/n)``.
    response : ndarray (samples, modes, f)
        Responses, relative to the reference charge and the nominal command.
    nominal : ModeResponses
        Those of the nominal full plant.
    sample : Sample
        Parameters of the plants.
    input, output : str
        Signals.
    speed_rpm : float
        Speed.
    command : ValveCommand
        Nominal command.
    charge : ndarray (samples,)
        Steady charge of each plant, kg.
    reference_charge : float
        Charge that changes are relative to, kg.
    """

    modes: tuple[int, ...]
    theta: FloatArray = field(repr=False)
    response: ComplexArray = field(repr=False)
    nominal: ModeResponses = field(repr=False)
    sample: Sample = field(repr=False)
    input: Input
    output: Output
    speed_rpm: float
    command: ValveCommand
    charge: FloatArray = field(repr=False)
    reference_charge: float

    def __len__(self) -> int:
        """Return the number of plants."""
        return len(self.response)

    def mode(self, q: int) -> ComplexArray:
        """Responses of mode `q`, (samples, f)."""
        return self.response[:, mode_row(self.modes, q)]

    def relative_to(self, nominal: ModeResponses | None = None) -> SampledResiduals:
        """Return the relative residuals ``(g - g0)/g0`` of each mode.

        Parameters
        ----------
        nominal : ModeResponses, optional
            Nominal responses on the same grid, such as those of `mean_value_modes`; those of the
            nominal full plant by default.

        Raises
        ------
        ParameterError
            If the grids differ, or a nominal response is zero.
        """
        g0 = self.nominal if nominal is None else nominal
        same = g0.modes == self.modes and g0.n_cylinders == self.nominal.n_cylinders
        if not same or g0.theta.shape != self.theta.shape or not np.allclose(g0.theta, self.theta):
            raise ParameterError(
                f"{g0.name} has modes {g0.modes} of {g0.n_cylinders} cylinders at {g0.theta.size} "
                f"cycle phases, but the sample has modes {self.modes} of "
                f"{self.nominal.n_cylinders} at {self.theta.size}: give both the same modes and "
                "theta"
            )
        size = np.abs(g0.response)
        if not size.min() > 1e-9 * size.max():
            row, column = np.unravel_index(int(np.argmin(size)), size.shape)
            raise ParameterError(
                f"{g0.name} has the gain {size.min():.2g} in mode {g0.modes[row]} at the cycle "
                f"phase {g0.theta[column]:.3g} rad, where nothing can be relative to it: leave "
                "the mode or the phase out"
            )
        return SampledResiduals(
            self.modes,
            self.theta,
            (self.response - g0.response) / g0.response,
            g0.n_cylinders,
            f"{self.input} to {self.output} at {self.speed_rpm:g} rpm against {g0.name}",
        )

    def __str__(self) -> str:
        """Return the operating point and the spread of the gains."""
        parts = []
        for k, q in enumerate(self.modes):
            gain = np.abs(self.response[:, k])
            parts.append(f"{gain.min():.3g} to {gain.max():.3g} in mode {q}")
        return (
            f"{len(self)} plants at {self.speed_rpm:g} rpm, {self.input} to {self.output}: "
            f"relative gain {', '.join(parts)}"
        )
