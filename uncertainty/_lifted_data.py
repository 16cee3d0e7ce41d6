"""Frequency data of a plant or a residual that is lifted over a cycle of n events."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import in_range
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

from ._modes import checked_mode, in_modes

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

_SAME_ANGLE = 1e-9  # rad per event, two points of the event circle nearer than this are one


@dataclass(frozen=True)
class LiftedData:
    """Lifted frequency data: from n inputs to n outputs of a cycle.

    Frequencies are those of the cycle, up to its Nyquist frequency. On the circle of *events*
    mode q is the band of the angles ``(theta + 2 pi q)/n`` with the cycle phase ``theta`` in
    ``[-pi, pi]``. A real plant repeats itself conjugated: at ``-theta`` mode q is the conjugate
    of mode ``n - q`` at ``theta``. So the modes at ``theta >= 0`` tell all.

    Attributes
    ----------
    omega : ndarray (f,)
        Frequency, rad/s, rising, from 0 to ``pi/cycle_time``.
    response : ndarray (f, n, n)
        Response ``[frequency, output, input]``.
    inputs, outputs : tuple of str
        Names such as ``duration_deg[1]``.
    cycle_time : float
        Length of a cycle, s.
    """

    omega: FloatArray = field(repr=False)
    response: ComplexArray = field(repr=False)
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    cycle_time: float

    def __post_init__(self) -> None:
        omega = checked_frequencies(self.omega, self.cycle_time)
        response = np.array(self.response, dtype=complex)
        n = len(self.inputs)
        if response.shape != (omega.size, n, n) or len(self.outputs) != n:
            raise ParameterError(
                f"the response has shape {response.shape}, but must be ({omega.size}, {n}, {n}): "
                f"{omega.size} frequencies, {len(self.outputs)} outputs and {n} inputs, as many "
                "of them as cylinders"
            )
        omega.setflags(write=False)
        response.setflags(write=False)
        object.__setattr__(self, "omega", omega)
        object.__setattr__(self, "response", response)

    @property
    def n_cylinders(self) -> int:
        """Number of cylinders."""
        return len(self.inputs)

    @property
    def event_time(self) -> float:
        """Length of an event, s."""
        return self.cycle_time / self.n_cylinders

    @property
    def theta(self) -> FloatArray:
        """Cycle phase of each frequency, rad per cycle, (f,)."""
        return self.omega * self.cycle_time

    @property
    def largest_singular_value(self) -> FloatArray:
        """Largest gain over all directions at each frequency, (f,)."""
        return np.asarray(np.linalg.norm(self.response, 2, axis=(1, 2)))

    # -- modes -------------------------------------------------------------------------------

    @cached_property
    def _modal(self) -> ComplexArray:
        return in_modes(self.response, self.theta)

    def mode(self, q: int) -> ComplexArray:
        """Response of circulant mode `q`, (f,), at the cycle phases ``theta >= 0``.

        It belongs to the event shift ``z = exp(j (theta + 2 pi q)/n)``. At ``-theta`` the mode
        is the conjugate of ``mode(n - q)``.
        """
        checked_mode(q, self.n_cylinders)
        return self._modal[:, q, q].copy()

    @property
    def leakage(self) -> FloatArray:
        """What modes hand on to each other, over the largest gain of a mode, (f,).

        Equal cylinders have none. NaN where all gains are 0.
        """
        own = np.abs(np.einsum("fqq->fq", self._modal)).max(axis=1)
        others = self._modal * (1.0 - np.eye(self.n_cylinders))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.linalg.norm(others, 2, axis=(1, 2)) / own)

    def mode_band(self, q: int) -> tuple[FloatArray, ComplexArray]:
        """Mode `q` on both sides: cycle phases from ``-pi`` to ``pi`` (g,), and its response."""
        n = self.n_cylinders
        above, below = self.mode(q), np.conj(self.mode(-q % n))
        keep = slice(1, None) if self.theta[0] == 0.0 else slice(None)
        theta = np.concatenate((-self.theta[keep][::-1], self.theta))
        return theta, np.concatenate((below[keep][::-1], above))

    # -- the circle of events ----------------------------------------------------------------

    @cached_property
    def _circle(self) -> tuple[FloatArray, ComplexArray]:
        """Angles from 0 to pi per event, rising, and the response there."""
        n = self.n_cylinders
        angles, values = [], []
        for q in range(n):
            angle = (self.theta + 2.0 * np.pi * q) / n
            upper = angle > np.pi + _SAME_ANGLE
            angles.append(np.where(upper, 2.0 * np.pi - angle, angle))
            values.append(np.where(upper, np.conj(self.mode(q)), self.mode(q)))
        angle = np.concatenate(angles)
        order = np.argsort(angle, kind="stable")
        kept = order[np.diff(angle[order], prepend=-1.0) > _SAME_ANGLE]
        return angle[kept], np.concatenate(values)[kept]

    @property
    def event_omega(self) -> FloatArray:
        """Frequencies on the circle of events that the grid gives, rad/s, rising."""
        return self._circle[0] / self.event_time

    def event_response(self, omega: ArrayLike | None = None) -> ComplexArray:
        """Response from event to event, in which the modes are bands.

        It is the whole response of equal cylinders; of others, the part that stays in its mode.

        Parameters
        ----------
        omega : array_like, optional
            Frequencies in rad/s, up to ``pi/event_time``; linear between those of the grid.
            Those of `event_omega` by default.

        Raises
        ------
        ParameterError
            For a frequency that lies outside the grid.
        """
        angle, values = self._circle
        if omega is None:
            return values.copy()
        asked = np.asarray(omega, dtype=float)
        wanted = np.clip(asked * self.event_time, None, np.pi)
        for value in np.ravel(asked):
            in_range(
                "omega",
                float(value),
                float(angle[0] / self.event_time) * (1.0 - 1e-9),
                float(angle[-1] / self.event_time) * (1.0 + 1e-9),
                "rad/s",
                remedy="the frequencies of the grid end there",
            )
        real, imaginary = (np.interp(wanted, angle, part) for part in (values.real, values.imag))
        return np.asarray(real + 1j * imaginary)

    # -- python-control ----------------------------------------------------------------------

    def frd(self) -> control.FrequencyResponseData:
        """Return the response for python-control, n x n per cycle."""
        import control

        return control.FrequencyResponseData(
            self.response.transpose(1, 2, 0),
            self.omega,
            dt=self.cycle_time,
            inputs=list(self.inputs),
            outputs=list(self.outputs),
        )

    def mode_frd(self, q: int) -> control.FrequencyResponseData:
        """Return mode `q` for python-control, against the frequency of the cycle.

        Only modes 0 and n/2 are those of a real system; the others are complex.
        """
        return self._single(self.mode(q), self.omega, self.cycle_time, f"mode {q}")

    def event_frd(self) -> control.FrequencyResponseData:
        """Return the response from event to event for python-control."""
        return self._single(self.event_response(), self.event_omega, self.event_time, "events")

    def _single(
        self, values: ComplexArray, omega: FloatArray, dt: float, name: str
    ) -> control.FrequencyResponseData:
        import control

        input_, _, output = self.signals.partition(" to ")
        return control.FrequencyResponseData(
            values[None, None], omega, dt=dt, inputs=[input_], outputs=[output], name=name
        )

    # -- pictures ----------------------------------------------------------------------------

    @property
    def signals(self) -> str:
        """From which signal to which, such as ``duration_deg to maf``."""
        return " to ".join(names[0].partition("[")[0] for names in (self.inputs, self.outputs))

    @property
    def title(self) -> str:
        """What a picture is headed with."""
        return self.signals

    def plot(self, figure: Figure | None = None, **options: Any) -> Figure:
        """Draw gain and phase of the modes over the angle per event and return the figure.

        Parameters
        ----------
        figure : matplotlib.figure.Figure, optional
            Figure of another plot, to draw over it.
        **options
            ``label`` names the plant in the legend.
        """
        from ._mode_plot import plot_modes

        return plot_modes(self, figure, **options)


def checked_frequencies(omega: ArrayLike, cycle_time: float) -> FloatArray:
    """Return frequencies (f,) after checking that they rise from 0 to the cycle's Nyquist one."""
    values = np.array(omega, dtype=float)
    if values.ndim != 1 or not values.size or not np.isfinite(values).all():
        raise ParameterError(
            f"omega has shape {values.shape}, but must be a list of finite frequencies in rad/s"
        )
    highest = np.pi / cycle_time
    for value in values:
        in_range(
            "omega",
            float(value),
            0.0,
            highest * (1.0 + 1e-9),
            "rad/s",
            remedy="the Nyquist frequency of a cycle; what is faster is in the modes",
        )
    if np.any(np.diff(values) <= 0.0):
        raise ParameterError("the frequencies omega do not rise: sort them, each one once")
    return values


def default_frequencies(cycle_time: float) -> FloatArray:
    """33 frequencies from 0 to the Nyquist frequency of a cycle, rad/s."""
    return np.linspace(0.0, np.pi / cycle_time, 33)
