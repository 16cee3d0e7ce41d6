"""Regions of section 5 against speed: lift saturation, flow reversal, what can be driven."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ._checks import in_range
from ._map_regions import SATURATION_SHARE, lift_saturation
from .errors import ParameterError
from .kinematics import FloatArray
from .published import PUBLISHED_CLAIMS
from .valve import highest_lift_mm

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from .mean_value import MeanValuePlant
    from .region import OperatingRegion

LIFTS_MM = (1.0, 3.0, 5.0)
DURATION_DEG = 180.0  # section 5
_STEP_RPM = 50.0
_MOST_ROWS = 25


@dataclass(frozen=True, eq=False)
class MapRegions:
    """Where lift saturates, where flow reverses and what can be driven; made by `map_regions`.

    Attributes
    ----------
    speeds_rpm : ndarray (n,)
        Speeds.
    lifts_mm : ndarray (m,)
        Lifts of `reversal_deg` and `shortest_deg`, rising; the last is the map's highest.
    durations_deg : ndarray (d,)
        Durations of `saturation_mm` and `highest_lift_mm`.
    share : float
        Share of the charge at the highest lift from which on lift counts as saturated.
    saturation_mm : ndarray (d, n)
        Lift at which the charge saturates, mm; NaN where the highest lift cannot be driven.
    saturation_at_peak_mm : ndarray (n,)
        The same, with the duration of the largest charge at each lift.
    reversal_deg : ndarray (m, n)
        Duration beyond which flow reverses, deg; NaN where the charge still rises at the
        longest duration.
    shortest_deg : ndarray (m, n)
        Shortest duration that reaches a lift, deg.
    highest_lift_mm : ndarray (d, n)
        Highest lift that a duration leaves time for, mm, at most the map's highest; NaN where
        there is time for none of the map's lifts.
    region : OperatingRegion
        Where the map holds.
    plant_fingerprint : str
        Fingerprint of the full plant behind the map.

    Notes
    -----
    At low speed the runner rings while the valve is open, and the charge has several peaks over
    duration. Which of them is the largest changes with speed, so flow reversal and the lift
    that saturates with it jump.
    """

    speeds_rpm: FloatArray
    lifts_mm: FloatArray
    durations_deg: FloatArray
    share: float
    saturation_mm: FloatArray
    saturation_at_peak_mm: FloatArray
    reversal_deg: FloatArray
    shortest_deg: FloatArray
    highest_lift_mm: FloatArray
    region: OperatingRegion = field(repr=False)
    plant_fingerprint: str = field(repr=False)

    def to_dataset(self) -> xr.Dataset:
        """Return the regions as an `xarray.Dataset` with units and provenance."""
        import xarray as xr

        by_duration, by_lift = ("duration", "speed"), ("lift", "speed")
        variables = {
            "saturation_lift": (by_duration, self.saturation_mm, "mm", "lift saturation"),
            "saturation_lift_at_peak": (
                ("speed",),
                self.saturation_at_peak_mm,
                "mm",
                "lift saturation at the duration of the largest charge",
            ),
            "reversal_duration": (by_lift, self.reversal_deg, "deg", "flow reversal"),
            "shortest_duration": (
                by_lift,
                self.shortest_deg,
                "deg",
                "shortest duration that reaches the lift",
            ),
            "highest_lift": (
                by_duration,
                self.highest_lift_mm,
                "mm",
                "highest lift that the duration leaves time for, within the map",
            ),
        }
        return xr.Dataset(
            {
                name: (dims, values, {"units": unit, "long_name": text})
                for name, (dims, values, unit, text) in variables.items()
            },
            coords={
                "speed": ("speed", self.speeds_rpm, {"units": "rpm"}),
                "lift": ("lift", self.lifts_mm, {"units": "mm"}),
                "duration": ("duration", self.durations_deg, {"units": "deg"}),
            },
            attrs={
                "saturation_share": self.share,
                "longest_duration_deg": self.region.longest_deg,
                "highest_lift_mm": self.region.highest_lift_mm,
                "plant_fingerprint": self.plant_fingerprint,
            },
        )

    def plot(self) -> Figure:
        """Draw the regions against speed, with the lifts of section 5 as points."""
        from ._region_plots import plot_regions

        return plot_regions(self)

    @property
    def printed_mm(self) -> dict[float, float]:
        """Lifts in mm at which Part I sees saturation, by those of its speeds that are covered."""
        low, high = self.speeds_rpm.min(), self.speeds_rpm.max()
        return {
            claim.speed_rpm: claim.lift_mm
            for claim in PUBLISHED_CLAIMS
            if claim.lift_mm is not None
            and claim.speed_rpm is not None
            and low <= claim.speed_rpm <= high
        }

    def __str__(self) -> str:
        """Return a table, a row per speed, with the lifts printed in section 5 beside it."""
        printed = self.printed_mm
        every = math.ceil(self.speeds_rpm.size / _MOST_ROWS)
        heads = [
            ("", "speed", "rpm"),
            *(("saturation", f"{d:g} deg", "mm") for d in self.durations_deg),
            ("saturation", "at peak", "mm"),
            ("Part I", "about", "mm"),
            *(("reversal", f"{u:g} mm", "deg") for u in self.lifts_mm),
            *(("shortest", f"{u:g} mm", "deg") for u in self.lifts_mm),
            *(("highest", f"{d:g} deg", "mm") for d in self.durations_deg),
        ]
        rows = []
        for k in range(0, self.speeds_rpm.size, every):
            about = printed.get(float(self.speeds_rpm[k]))
            rows.append(
                [
                    f"{self.speeds_rpm[k]:.0f}",
                    *(_cell(x, ".2f") for x in self.saturation_mm[:, k]),
                    _cell(self.saturation_at_peak_mm[k], ".2f"),
                    "" if about is None else f"{about:g}",
                    *(_cell(x, ".0f") for x in self.reversal_deg[:, k]),
                    *(_cell(x, ".0f") for x in self.shortest_deg[:, k]),
                    *(
                        "all" if x >= self.region.highest_lift_mm else _cell(x, ".2f")
                        for x in self.highest_lift_mm[:, k]
                    ),
                ]
            )
        columns = list(zip(*heads, strict=True))
        widths = [max(map(len, column)) for column in zip(*columns, *rows, strict=True)]
        lines = [
            "  ".join(text.rjust(width) for text, width in zip(line, widths, strict=True)).rstrip()
            for line in [*columns, *rows]
        ]
        r = self.region
        lines += [
            f"saturation: lift from which on the charge is at least {100 * self.share:g} % of that "
            f"at {r.highest_lift_mm:g} mm, at a duration or at that of the largest charge (peak)",
            f"reversal: duration of the largest charge; -: not up to {r.longest_deg:g} deg",
            "shortest: duration that a lift needs; highest: lift that a duration leaves time for "
            f"(all: {r.highest_lift_mm:g} mm; -: none from {r.lowest_lift_mm:g} mm on)",
        ]
        if every > 1:
            lines.append(f"one speed in {every} of {self.speeds_rpm.size} is shown")
        return "\n".join(lines)


def map_regions(
    maps: MeanValuePlant,
    speeds_rpm: ArrayLike | None = None,
    *,
    lift_mm: ArrayLike | None = None,
    duration_deg: ArrayLike = DURATION_DEG,
    share: float = SATURATION_SHARE,
) -> MapRegions:
    """Regions of a mean-value map against speed (section 5).

    Parameters
    ----------
    maps : MeanValuePlant
        The maps.
    speeds_rpm : array_like, optional
        Speeds, rising; the map's whole range in steps of 50 rpm by default.
    lift_mm : array_like, optional
        Lifts for flow reversal and the shortest duration; 1, 3 and 5 mm by default, those of
        them that the map holds. The map's highest lift always joins them.
    duration_deg : array_like
        Durations for lift saturation and the highest lift.
    share : float
        Share of the charge at the highest lift from which on lift counts as saturated.

    Raises
    ------
    ParameterError
        For a value out of the map's range, naming it.
    """
    region = maps.region
    speeds = _speeds(region) if speeds_rpm is None else _line("speeds_rpm", speeds_rpm, "rpm")
    if np.any(np.diff(speeds) <= 0.0):
        raise ParameterError(
            f"speeds_rpm is {speeds.tolist()}, but must rise: sort the speeds, in rpm, and name "
            "each once"
        )
    durations = _line("duration_deg", duration_deg, "deg")
    if lift_mm is None:
        lifts = np.array([u for u in LIFTS_MM if u >= region.lowest_lift_mm])
        lifts = lifts[lifts < region.highest_lift_mm]
    else:
        lifts = _line("lift_mm", lift_mm, "mm")
    lifts = np.unique(np.append(lifts, region.highest_lift_mm))
    region.require(region.highest_lift_mm, region.longest_deg, speeds)
    region.require(lifts, region.longest_deg, speeds[0])
    for duration in durations:
        in_range("duration_deg", float(duration), 0.0, region.longest_deg, "deg", open_low=True)
    return MapRegions(
        speeds_rpm=speeds,
        lifts_mm=lifts,
        durations_deg=durations,
        share=float(share),
        saturation_mm=lift_saturation(maps, speeds, durations[:, None], share),
        saturation_at_peak_mm=lift_saturation(maps, speeds, None, share),
        reversal_deg=maps.flow_reversal(speeds, lifts[:, None]),
        shortest_deg=region.shortest_deg(lifts[:, None], speeds),
        highest_lift_mm=_highest_lift(region, durations[:, None], speeds),
        region=region,
        plant_fingerprint=str(maps.provenance["plant_fingerprint"]),
    )


def _highest_lift(
    region: OperatingRegion, duration_deg: FloatArray, speed_rpm: FloatArray
) -> FloatArray:
    """Highest lift in mm of the map that a duration leaves time for, or NaN."""
    # The limit is a straight line in time, so that two points give it.
    at_zero, at_one = (highest_lift_mm(time, region.valvetrain) for time in (0.0, 1.0))
    lift = at_zero + (at_one - at_zero) * duration_deg / (6.0 * speed_rpm)
    possible = region.feasible(region.lowest_lift_mm, duration_deg, speed_rpm)
    return np.where(possible, np.minimum(lift, region.highest_lift_mm), np.nan)


def _speeds(region: OperatingRegion) -> FloatArray:
    low, high = region.lowest_speed_rpm, region.highest_speed_rpm
    inside = _STEP_RPM * np.arange(math.ceil(low / _STEP_RPM), math.floor(high / _STEP_RPM) + 1)
    return np.unique([low, *inside, high])


def _line(name: str, values: ArrayLike, unit: str) -> FloatArray:
    line = np.atleast_1d(np.asarray(values, dtype=float))
    if line.ndim != 1 or not line.size:
        raise ParameterError(
            f"{name} has the shape {line.shape}, but must be a number or a list of them, in {unit}"
        )
    return line


def _cell(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "-"
