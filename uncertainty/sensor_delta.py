"""Delta of the sensors: what the controller believes of charge and loss, and of the modes.

Sensors do not change the charge, but what is known of it. Told here is the change of the
*indicated* values, in a steady mean:

- The MAF sensor indicates the charge, so its gain error changes the charge and its
  sensitivities by the gain. It sees nothing of the loss.
- The MAP sensor tells a model the pressure at the ports: an offset changes charge and loss as
  the full plant changes whose ambient pressure is off by it.
- Lag and delay change nothing in a steady mean. They change the frequency response,
  `SensorDelta.relative_response`, and what is left of an imbalance, `SensorDelta.mode_changes`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant import Engine
from plant._checks import in_range, whole
from plant.air_path import ComplexArray, FlowShape, PulseResponse, event_time
from plant.kinematics import FloatArray
from plant.sensors import MafSensor

from ._delta_cases import single_cases
from .delta import Case, SameOptionsDelta
from .parameters import UncertaintySet

if TYPE_CHECKING:
    import xarray as xr


class MafValues(NamedTuple):
    """Lag and delay in s, and gain error, of a MAF sensor."""

    time_constant: float
    delay: float
    gain_error: float


@dataclass(frozen=True)
class ModeChanges:
    """What the sensor's uncertainty changes of the modes seen through event averages.

    Attributes
    ----------
    speed_rpm : float
        Speed.
    n_cylinders : int
        Number of cylinders.
    dataset : xarray.Dataset
        ``gain_ratio`` (1) and ``phase_change_deg`` (deg) over ``case`` and ``mode``: response
        of the true sensor over that of the nominal one; with ``nominal_gain`` (1) and
        ``nominal_phase_deg`` over ``mode``. The cases are each parameter at either bound, and
        the corners of the box.
    """

    speed_rpm: float
    n_cylinders: int
    dataset: xr.Dataset

    def gain_range(self, q: int) -> tuple[float, float]:
        """Lowest and highest gain ratio of mode `q` over the cases, 1."""
        ratio = self.dataset["gain_ratio"].sel(mode=q)
        return float(ratio.min()), float(ratio.max())

    def phase_range_deg(self, q: int) -> tuple[float, float]:
        """Lowest and highest phase change of mode `q` over the cases, deg."""
        phase = self.dataset["phase_change_deg"].sel(mode=q)
        return float(phase.min()) + 0.0, float(phase.max()) + 0.0

    def __str__(self) -> str:
        """Return the ranges of all modes in a sentence."""
        modes = []
        for q in self.dataset["mode"].to_numpy().tolist():
            gain, phase = self.gain_range(q), self.phase_range_deg(q)
            modes.append(
                f"of mode {q} to {gain[0]:.2f} to {gain[1]:.2f} of nominal and its phase by "
                f"{phase[0]:.0f} to {phase[1]:.0f} deg"
            )
        return (
            f"At {self.speed_rpm:.0f} rpm the uncertainty of the MAF sensor changes the gain "
            f"{'; '.join(modes)}."
        )


@dataclass(frozen=True)
class SensorDelta(SameOptionsDelta):
    """Gain error, lag and delay of the MAF sensor, and offset of the MAP sensor.

    Parameters
    ----------
    ranges : UncertaintySet
        Uncertain parameters of the sensors.
    runner, oscillation : bool
        Options of the plant.
    """

    ranges: UncertaintySet = field(default_factory=UncertaintySet.sensors)
    runner: bool = True
    oscillation: bool = False

    @property
    def name(self) -> str:
        """Short name."""
        return "sensors"

    @property
    def effect(self) -> str:
        """What changes the indicated values, in words that begin a sentence."""
        return "The uncertainty of the sensors"

    def cases(self, engine: Engine) -> tuple[Case, ...]:
        """Return the cases of one parameter at a time."""
        return single_cases(self.ranges)

    # -- frequency response --------------------------------------------------------------------

    @property
    def nominal_maf(self) -> MafValues:
        """Lag, delay and gain error of the nominal MAF sensor."""
        return MafValues(*(nominal for _, nominal, _ in self._bounds()))

    def relative_response(
        self,
        omega: ArrayLike,
        *,
        time_constant: float | None = None,
        delay: float | None = None,
        gain_error: float | None = None,
    ) -> ComplexArray:
        """Relative error of the nominal MAF sensor's response, for a true sensor.

        With ``s = j omega`` it is ``(1 + s tau0)/(1 + s tau) exp(-s (d - d0))
        (1 + g)/(1 + g0) - 1``; what is not given is nominal.

        Parameters
        ----------
        omega : array_like
            Frequencies in rad/s.
        time_constant, delay : float, optional
            ``tau`` and ``d`` of the true sensor, s.
        gain_error : float, optional
            ``g`` of the true sensor, 1.

        Returns
        -------
        ndarray, of the shape of `omega`
        """
        nominal = self.nominal_maf
        tau = nominal.time_constant if time_constant is None else time_constant
        d = nominal.delay if delay is None else delay
        g = nominal.gain_error if gain_error is None else gain_error
        in_range("time_constant", tau, 0.0, 10.0, "s")
        in_range("delay", d, 0.0, 10.0, "s")
        in_range("gain_error", g, -1.0, 1.0, "1", open_low=True)
        s = 1j * np.asarray(omega, dtype=float)
        lag = (1.0 + s * nominal.time_constant) / (1.0 + s * tau)
        gain = (1.0 + g) / (1.0 + nominal.gain_error)
        return np.asarray(gain * lag * np.exp(-s * (d - nominal.delay)) - 1.0, dtype=complex)

    def response_bound(self, omega: ArrayLike, points: int = 17) -> FloatArray:
        """Largest magnitude of `relative_response` over a grid of the ranges.

        The true bound may lie a little above that of the grid.

        Parameters
        ----------
        omega : array_like
            Frequencies in rad/s.
        points : int
            Values of lag and of delay, bounds included. The magnitude is convex in the gain,
            whose bounds therefore suffice.
        """
        whole("points", points, 2, 1000)
        (tau_low, _, tau_high), (d_low, _, d_high), (g_low, _, g_high) = self._bounds()
        bound = np.zeros(np.shape(omega))
        for tau, d, g in product(
            np.unique(np.linspace(tau_low, tau_high, points)),
            np.unique(np.linspace(d_low, d_high, points)),
            {g_low, g_high},
        ):
            error = self.relative_response(
                omega, time_constant=float(tau), delay=float(d), gain_error=g
            )
            bound = np.maximum(bound, np.abs(error))
        return bound

    # -- circulant modes -----------------------------------------------------------------------

    def mode_changes(
        self, speed_rpm: float, n_cylinders: int = 4, shape: FlowShape | None = None
    ) -> ModeChanges:
        """Gain ratio and phase change of each circulant mode, seen through event averages.

        The reading is averaged over each event, later by the nominal delay: that much the
        estimator knows.

        Parameters
        ----------
        speed_rpm : float
            Speed.
        n_cylinders : int
            Number of cylinders; modes ``q`` and ``n - q`` are conjugate, so those up to
            ``n/2`` are told.
        shape : FlowShape, optional
            How a charge flows past the sensor; evenly over its event by default.
        """
        import xarray as xr

        T = event_time(speed_rpm, n_cylinders)
        modes = np.arange(n_cylinders // 2 + 1)
        nominal = self.nominal_maf

        def responses(sensor: MafValues) -> ComplexArray:
            path = PulseResponse.of_window(
                T,
                time_constant=sensor.time_constant,
                delay=sensor.delay,
                shape=shape,
                shift=nominal.delay,
            )
            gain = 1.0 + sensor.gain_error
            return np.array([gain * path.mode(int(q), n_cylinders) for q in modes])

        reference = responses(nominal)
        sensors = self._mode_cases()
        ratio = np.array([responses(sensor) for sensor in sensors.values()]) / reference
        dims = ("case", "mode")
        dataset = xr.Dataset(
            {
                "gain_ratio": (dims, np.abs(ratio), {"units": "1"}),
                "phase_change_deg": (dims, np.angle(ratio, deg=True), {"units": "deg"}),
                "nominal_gain": ("mode", np.abs(reference), {"units": "1"}),
                "nominal_phase_deg": ("mode", np.angle(reference, deg=True), {"units": "deg"}),
            },
            coords={"case": list(sensors), "mode": modes},
        )
        return ModeChanges(float(speed_rpm), n_cylinders, dataset)

    def _bounds(self) -> tuple[tuple[float, float, float], ...]:
        """Lower bound, nominal value and upper bound of the fields of `MafValues`."""
        sensor, found = MafSensor(), []
        for name in MafValues._fields:
            value = float(getattr(sensor, name))
            bounds = (value, value, value)
            for p in self.ranges:
                if f"maf.{name}" in p.acts_on:
                    bounds = (p.low, p.nominal, p.high)
            found.append(bounds)
        return tuple(found)

    def _mode_cases(self) -> dict[str, MafValues]:
        nominal, bounds = self.nominal_maf, self._bounds()
        words = ("lag", "delay", "gain")
        cases = {}
        for k, (low, _, high) in enumerate(bounds):
            for end, value in (("low", low), ("high", high)):
                name = MafValues._fields[k]
                cases[f"{words[k]} {end}"] = nominal._replace(**{name: value})
        for ends in product((0, 2), repeat=3):
            name = ", ".join(
                f"{word} {'high' if end else 'low'}" for word, end in zip(words, ends, strict=True)
            )
            cases[name] = MafValues(*(b[end] for b, end in zip(bounds, ends, strict=True)))
        return cases
