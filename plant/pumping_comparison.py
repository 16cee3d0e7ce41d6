"""Pumping loss of the camless engine against the throttled one at equal charge (section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ._checks import in_range, positive
from .errors import ParameterError
from .kinematics import FloatArray
from .mean_value import MeanValuePlant
from .throttled import ThrottledMeanValuePlant

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

SPEEDS_RPM = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)
_CHARGES = 60
_LOWEST_SHARE = 0.02  # of the largest charge that both give at any of the speeds
_LIFTS = 80


@dataclass(frozen=True)
class PumpingSaving:
    """Pumping loss of both engines at one charge and speed.

    Attributes
    ----------
    charge : float
        Air charge of both, kg per event.
    speed_rpm : float
        Engine speed.
    lift_mm, duration_deg : float
        What the camless engine is driven with.
    throttle_deg, manifold_pressure : float
        What throttles the other one, deg and Pa.
    camless_loss, throttled_loss : float
        Pumping losses, J per event.
    least : bool
        Whether lift and duration are those of least loss; otherwise the lift was given.
    """

    charge: float
    speed_rpm: float
    lift_mm: float
    duration_deg: float
    throttle_deg: float
    manifold_pressure: float
    camless_loss: float
    throttled_loss: float
    least: bool

    @property
    def saving(self) -> float:
        """Share of the throttled engine's pumping loss that is saved, 1."""
        return 1.0 - self.camless_loss / self.throttled_loss

    def __str__(self) -> str:
        """Return the saving in a sentence."""
        how = "least loss" if self.least else "given lift"
        return (
            f"{1e6 * self.charge:.1f} mg at {self.speed_rpm:g} rpm: {self.camless_loss:.2f} J with "
            f"{self.lift_mm:.2f} mm for {self.duration_deg:.1f} deg ({how}), against "
            f"{self.throttled_loss:.2f} J at a throttle angle of {self.throttle_deg:.1f} deg "
            f"({self.manifold_pressure / 1e3:.1f} kPa): {100.0 * self.saving:.1f} % less"
        )


@dataclass(frozen=True, eq=False)
class PumpingComparison:
    """Pumping losses of the camless and the throttled engine over load and speed.

    Attributes
    ----------
    maps : MeanValuePlant
        The camless engine, unthrottled.
    throttled : ThrottledMeanValuePlant
        The engine with throttle and cam.
    data : xarray.Dataset
        Over ``speed_rpm`` and ``charge`` (kg per event): ``camless_loss`` and
        ``throttled_loss`` (J per event), ``saving`` (1), and what gives them: ``lift_mm`` and
        ``duration_deg`` of least loss, ``throttle_deg`` and ``manifold_pressure`` (Pa). NaN
        where an engine cannot give the charge; ``saving`` is NaN where one of the two cannot.
    """

    maps: MeanValuePlant
    throttled: ThrottledMeanValuePlant
    data: xr.Dataset

    def saving_at(
        self, charge: float, speed_rpm: float, lift_mm: float | None = None
    ) -> PumpingSaving:
        """Compare both engines at any charge and speed.

        Parameters
        ----------
        charge : float
            Air charge, kg per event.
        speed_rpm : float
            Engine speed.
        lift_mm : float, optional
            Lift of the camless engine; that of least loss by default.

        Raises
        ------
        ParameterError
            If the speed or the lift is out of range, or an engine cannot give the charge.
        """
        charge = positive("charge", charge, "kg", remedy="give the charge of an event in kg")
        low, high = _common_speeds(self.maps, self.throttled)
        speed = in_range("speed_rpm", speed_rpm, low, high, "rpm", remedy="both engines' range")
        camless = _least_loss(self.maps, np.array([charge]), speed, lift_mm)
        other = self.throttled.throttle_for_charge(charge, speed)
        at = f"at {speed:g} rpm" if lift_mm is None else f"at {lift_mm:g} mm and {speed:g} rpm"
        if not np.isfinite(camless.loss[0]):
            raise ParameterError(
                f"charge is {1e6 * charge:.2f} mg, but must be in [{1e6 * camless.lowest:.2f}, "
                f"{1e6 * camless.highest:.2f}] mg, what the camless engine gives {at}: change the "
                "charge, the lift or the speed"
            )
        if not other.reachable:
            raise ParameterError(
                f"the throttled engine cannot give the charge at {speed:g} rpm: {other}; change "
                "the charge or the speed"
            )
        return PumpingSaving(
            charge=charge,
            speed_rpm=speed,
            lift_mm=float(camless.lift[0]),
            duration_deg=float(camless.duration[0]),
            throttle_deg=float(other.throttle_deg),
            manifold_pressure=float(other.manifold_pressure),
            camless_loss=float(camless.loss[0]),
            throttled_loss=float(other.pumping_loss),
            least=lift_mm is None,
        )

    def plot(self) -> Figure:
        """Draw the losses of both engines, and the saving, against charge."""
        from ._pumping_plot import plot_comparison

        return plot_comparison(self)

    def __str__(self) -> str:
        """Return the saving at each speed in a sentence."""
        lines = ["Pumping loss of the camless engine against the throttled one at equal charge:"]
        for speed in self.data["speed_rpm"].values.tolist():
            known = self.data["saving"].sel(speed_rpm=speed).dropna("charge")
            if known.size == 0:
                lines.append(f"  at {speed:g} rpm no charge that both engines can give")
                continue
            charge, saving = 1e6 * known["charge"].values, 100.0 * known.values
            # The charges need not be even.
            width = charge[-1] - charge[0]
            mean = np.trapezoid(saving, charge) / width if width else saving[0]
            best, least = int(np.argmax(saving)), int(np.argmin(saving))
            lines.append(
                f"  at {speed:g} rpm, {charge[0]:.0f} to {charge[-1]:.0f} mg: "
                f"{saving[best]:.0f} % less at {charge[best]:.0f} mg to {saving[least]:.0f} % less "
                f"at {charge[least]:.0f} mg, {mean:.0f} % on average"
            )
        return "\n".join(lines)


def compare_pumping(
    maps: MeanValuePlant,
    throttled: ThrottledMeanValuePlant,
    *,
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    charges: ArrayLike | None = None,
) -> PumpingComparison:
    """Compare the pumping losses of both engines over load and speed.

    Parameters
    ----------
    maps : MeanValuePlant
        The camless engine. At each charge it is driven with the lift and the duration, on the
        early-closing branch, of least loss.
    throttled : ThrottledMeanValuePlant
        The engine with throttle and cam.
    speeds_rpm : sequence of float
        Speeds, rising.
    charges : array_like, optional
        Charges, kg per event, rising; by default even over all loads that both can
        give, with the ends of the range at each speed.

    Raises
    ------
    ParameterError
        If the engines differ in more than what drives their valves, or speeds or charges do
        not fit.
    """
    if maps.engine != throttled.engine:
        raise ParameterError(
            "the camless maps and the throttled plant belong to different engines: fit both to "
            "full plants of one engine"
        )
    for name in ("runner", "orifice"):
        ours, theirs = maps.provenance[name], throttled.provenance[name]
        if ours != theirs:
            raise ParameterError(
                f"{name} is {ours} for the camless maps and {theirs} for the throttled plant: fit "
                "both to plants with the same options"
            )
    low, high = _common_speeds(maps, throttled)
    speeds = _rising("speeds_rpm", speeds_rpm, "rpm")
    for k, speed in enumerate(speeds.tolist()):
        in_range(f"speeds_rpm[{k}]", speed, low, high, "rpm", remedy="both engines' range")
    if charges is None:
        reach = throttled.throttle_for_charge(np.zeros_like(speeds), speeds)
        tops = np.minimum(reach.highest_charge, maps.largest_charge(speeds))
        even = np.linspace(_LOWEST_SHARE, 1.0, _CHARGES) * np.max(tops)
        # The ends of each speed's range as well, so that none is cut short.
        wanted = np.unique(np.concatenate([even, tops, reach.lowest_charge]))
        wanted = wanted[wanted > 0.0]
    else:
        wanted = _rising("charges", charges, "kg per event")
        positive("charges[0]", float(wanted[0]), "kg")
    camless = [_least_loss(maps, wanted, speed, None) for speed in speeds.tolist()]
    other = throttled.throttle_for_charge(wanted, speeds[:, None])
    return PumpingComparison(
        maps,
        throttled,
        _dataset(
            speeds,
            wanted,
            {
                "camless_loss": (
                    np.array([c.loss for c in camless]),
                    "J",
                    "pumping loss per event of the camless engine",
                ),
                "throttled_loss": (
                    other.pumping_loss,
                    "J",
                    "pumping loss per event of the throttled engine",
                ),
                "lift_mm": (np.array([c.lift for c in camless]), "mm", "lift of least loss"),
                "duration_deg": (
                    np.array([c.duration for c in camless]),
                    "deg",
                    "duration of least loss",
                ),
                "throttle_deg": (other.throttle_deg, "deg", "throttle angle"),
                "manifold_pressure": (
                    other.manifold_pressure,
                    "Pa",
                    "mean manifold pressure of the throttled engine",
                ),
            },
        ),
    )


@dataclass(frozen=True)
class _LeastLoss:
    """Camless engine at charges (c,) of one speed; NaN where a charge cannot be given."""

    lift: FloatArray
    duration: FloatArray
    loss: FloatArray
    lowest: float  # charge, kg
    highest: float


def _least_loss(
    maps: MeanValuePlant, charge: FloatArray, speed_rpm: float, lift_mm: float | None
) -> _LeastLoss:
    """Lift and duration of least loss for each charge, or the duration at a given lift.

    The loss hardly changes with lift where it is least, so that a scan of the lifts will do.
    """
    region = maps.region
    lowest, highest = region.lowest_lift_mm, region.highest_lift_mm
    if lift_mm is None:
        lifts = np.geomspace(lowest, highest, _LIFTS)
        lifts[[0, -1]] = lowest, highest
    else:
        lifts = np.array([in_range("lift_mm", lift_mm, lowest, highest, "mm")])
    found = maps.duration_for_charge(charge[:, None], lifts, speed_rpm)
    loss = maps.pumping_loss(lifts, found.duration_deg, speed_rpm, outside="nan")
    best = np.argmin(np.where(np.isfinite(loss), loss, np.inf), axis=1)
    row = np.arange(charge.size)
    reached = np.isfinite(loss[row, best])
    return _LeastLoss(
        lift=np.where(reached, lifts[best], np.nan),
        duration=found.duration_deg[row, best],
        loss=loss[row, best],
        lowest=float(np.min(found.lowest_charge)),
        highest=float(np.max(found.highest_charge)),
    )


def _dataset(
    speeds: FloatArray,
    charges: FloatArray,
    quantities: dict[str, tuple[FloatArray, str, str]],
) -> xr.Dataset:
    import xarray as xr

    dims = ("speed_rpm", "charge")
    data = xr.Dataset(
        {
            name: (dims, values, {"units": units, "long_name": long_name})
            for name, (values, units, long_name) in quantities.items()
        },
        coords={
            "speed_rpm": ("speed_rpm", speeds, {"units": "rpm", "long_name": "engine speed"}),
            "charge": ("charge", charges, {"units": "kg", "long_name": "air charge per event"}),
        },
    )
    data["saving"] = 1.0 - data["camless_loss"] / data["throttled_loss"]
    data["saving"].attrs = {
        "units": "1",
        "long_name": "share of the throttled engine's pumping loss that is saved",
    }
    return data


def _common_speeds(maps: MeanValuePlant, throttled: ThrottledMeanValuePlant) -> tuple[float, float]:
    """Lowest and highest speed that both cover, rpm."""
    low = max(maps.region.lowest_speed_rpm, float(throttled.speeds_rpm[0]))
    return low, min(maps.region.highest_speed_rpm, float(throttled.speeds_rpm[-1]))


def _rising(name: str, values: ArrayLike, unit: str) -> FloatArray:
    array = np.atleast_1d(np.asarray(values, dtype=float))
    # A comparison with NaN is False: not a number does not rise.
    if array.ndim != 1 or not array.size or not np.all(np.diff(array) > 0.0):
        raise ParameterError(
            f"{name} is {array.tolist()}, but must be a sequence of rising values in {unit}"
        )
    return array
