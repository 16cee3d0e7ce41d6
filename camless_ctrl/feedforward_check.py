"""Check of the optimal path on the full plant: its loss against a direct search, and its saving.

The search knows no map: on the full plant it looks for the least pumping loss at the charge that
the path reaches. The laws of Part II are not public; this is this project's own design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant._checks import whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from plant import CrankAnglePlant, PumpingComparison, ThrottledMeanValuePlant

    from .optimal_path import OptimalPath

BAR = 0.01  # 1, most loss above the best of a direct search
POINTS = 50
SAVING_SPEEDS_RPM = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)
_CHARGES = 24


@dataclass(frozen=True, eq=False)
class FeedforwardCheck:
    """Pumping loss of the path on the full plant, against the best of a direct search.

    The excess is relative to the best loss at the point, without a floor: `best_loss` tells how
    small that is. It can be slightly negative, by what the search leaves.

    Attributes
    ----------
    charge : ndarray (p,)
        Charge of both on the full plant, kg per event.
    speed_rpm : ndarray (p,)
        Speeds, rpm.
    path_lift_mm, path_duration_deg, path_loss : ndarray (p,)
        Motion of the path, its duration trimmed to the charge on the full plant (mm, deg), and
        its pumping loss, J per event.
    best_lift_mm, best_duration_deg, best_loss : ndarray (p,)
        The same of the best motion that the search found.
    trim_deg : ndarray (p,)
        What the duration was trimmed by, deg.
    given_up : ndarray (p,)
        What the path gives up for continuity, as the map sees it: loss of the path over the least
        loss of any lift on the map at the same charge, less 1.
    seed : int
        Seed that drew the points.
    """

    charge: FloatArray
    speed_rpm: FloatArray
    path_lift_mm: FloatArray
    path_duration_deg: FloatArray
    path_loss: FloatArray
    best_lift_mm: FloatArray
    best_duration_deg: FloatArray
    best_loss: FloatArray
    trim_deg: FloatArray
    given_up: FloatArray
    seed: int

    @property
    def excess(self) -> FloatArray:
        """Loss of the path over the best one, less 1, (p,)."""
        return self.path_loss / self.best_loss - 1.0

    @property
    def worst(self) -> float:
        """Largest excess, 1."""
        return float(self.excess.max())

    @property
    def median(self) -> float:
        """Median excess, 1."""
        return float(np.median(self.excess))

    @property
    def met(self) -> bool:
        """Whether no point exceeds the bar of 1 %."""
        return self.worst <= BAR

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the excess over speed and charge; return the axes."""
        from plant._plotting import COLOURS, axes, styled

        shown = 100.0 * self.excess
        with styled():
            ax = axes(ax)
            for colour, low, high, words in (
                (COLOURS[0], -np.inf, 0.1, "below 0.1 %"),
                (COLOURS[1], 0.1, 0.5, "0.1 to 0.5 %"),
                (COLOURS[2], 0.5, 100.0 * BAR, "0.5 to 1 %"),
                (COLOURS[3], 100.0 * BAR, np.inf, "above 1 %"),
            ):
                of = (shown > low) & (shown <= high)
                ax.plot(
                    self.speed_rpm[of],
                    1e6 * self.charge[of],
                    "o",
                    ms=5,
                    c=colour,
                    label=f"{words} ({int(of.sum())})",
                )
            ax.legend(title="loss above the best", loc="upper left", bbox_to_anchor=(1.0, 1.0))
            ax.set_xlabel("engine speed (rpm)")
            ax.set_ylabel("air charge (mg per event)")
            ax.set_title(f"Optimal path against direct search: {100.0 * self.worst:.2f} % at worst")
        return ax

    def __str__(self) -> str:
        """Return the excess in a sentence."""
        k = int(np.argmax(self.excess))
        over = int(np.count_nonzero(self.excess > BAR))
        return (
            f"pumping loss of the optimal path on the full plant, at the same charge, against a "
            f"direct search at {self.charge.size} random points (seed {self.seed}): "
            f"{100.0 * self.median:z.3f} % above the best at the median, {100.0 * self.worst:.2f} "
            f"% at worst ({1e6 * self.charge[k]:.1f} mg at {self.speed_rpm[k]:.0f} rpm: "
            f"{self.path_loss[k]:.3f} J with {self.path_lift_mm[k]:.2f} mm against "
            f"{self.best_loss[k]:.3f} J with {self.best_lift_mm[k]:.2f} mm; "
            f"the map foresees {100.0 * self.given_up[k]:z.2f} % for continuity); bar "
            f"{100.0 * BAR:g} %: {'met' if self.met else f'missed at {over} points'}; smallest "
            f"best loss {self.best_loss.min():.3f} J"
        )


def check_feedforward(
    path: OptimalPath, plant: CrankAnglePlant, *, points: int = POINTS, seed: int = 0
) -> FeedforwardCheck:
    """Compare the path with a direct search on the full plant, at random demands and speeds.

    Parameters
    ----------
    path : OptimalPath
        The path.
    plant : CrankAnglePlant
        The full plant; it is simulated at a resolution of 3 at least, so that the noise of its
        steps does not disturb the comparison.
    points, seed : int
        Number of points, uniform in position and speed, and the seed that draws them.

    Raises
    ------
    ParameterError
        If the plant is driven by a cam, or does not give the path's charges.
    """
    from ._path_scan import scan
    from ._path_search import least_loss, refined, trimmed

    _require_camless(plant)
    plant = refined(plant)
    count = whole("points", points, 1, 100_000)
    random = np.random.default_rng(whole("seed", seed, 0, 2**63 - 1))
    speed = random.uniform(path.speeds_rpm[0], path.speeds_rpm[-1], count)
    planned = path.at(random.uniform(0.0, 1.0, count), speed)
    own = trimmed(plant, planned.charge, planned.lift_mm, planned.duration_deg, speed)
    sought = scan(path.maps, path.options, speed, planned.charge[:, None]).loss[:, 0]
    on_map = path.maps.pumping_loss(planned.lift_mm, planned.duration_deg, speed)
    # What trimming adds to the path's duration is the search's to use too.
    limit = path.options.longest_deg(plant.engine, path.maps.region)
    longest = np.maximum(limit, own.duration_deg + 1e-3)
    best = least_loss(plant, own.charge, speed, path.options, longest)
    return FeedforwardCheck(
        charge=own.charge,
        speed_rpm=speed,
        path_lift_mm=own.lift_mm,
        path_duration_deg=own.duration_deg,
        path_loss=own.loss,
        best_lift_mm=best.lift_mm,
        best_duration_deg=best.duration_deg,
        best_loss=best.loss,
        trim_deg=own.duration_deg - planned.duration_deg,
        given_up=on_map / np.nanmin(sought, axis=1) - 1.0,
        seed=seed,
    )


def saving(
    path: OptimalPath,
    plant: CrankAnglePlant,
    throttled: ThrottledMeanValuePlant,
    *,
    speeds_rpm: Sequence[float] = SAVING_SPEEDS_RPM,
    charges: int = _CHARGES,
) -> PumpingComparison:
    """Compare the path on the full plant with the throttled engine over the load range.

    Parameters
    ----------
    path : OptimalPath
        The path.
    plant : CrankAnglePlant
        The camless full plant; durations are trimmed so that it gives the charge.
    throttled : ThrottledMeanValuePlant
        The engine with throttle and cam.
    speeds_rpm : sequence of float
        Speeds, rising.
    charges : int
        Number of charges, even from the lowest to the highest of the path at any speed.

    Returns
    -------
    PumpingComparison
        Losses, saving, motions and throttle over speed and charge; it prints and plots. NaN where
        one of the engines cannot give the charge.

    Raises
    ------
    ParameterError
        If the engines differ, or a speed is out of range.
    """
    import xarray as xr

    from plant import PumpingComparison

    from ._path_search import refined, trimmed

    _require_camless(plant)
    if not plant.engine == throttled.engine == path.maps.engine:
        raise ParameterError(
            "the path, the full plant and the throttled plant belong to different engines: make "
            "all three from one engine"
        )
    if throttled.provenance["runner"] != str(plant.runner):
        raise ParameterError(
            f"runner is {throttled.provenance['runner']} for the throttled plant and "
            f"{plant.runner} for the full plant: fit the former to a plant with the same options"
        )
    speeds = np.array(speeds_rpm, dtype=float)
    if speeds.ndim != 1 or not speeds.size or not np.all(np.diff(speeds) > 0.0):
        raise ParameterError(f"speeds_rpm is {speeds.tolist()}, but must be rising values in rpm")
    plant = refined(plant)
    low, high = path.limits(speeds)
    wanted = np.linspace(low.min(), high.max(), whole("charges", charges, 2, 10_000))
    position = path.position_of(wanted, speeds[:, None])
    inside = (position >= 0.0) & (position <= 1.0)
    speed = np.broadcast_to(speeds[:, None], position.shape)
    planned = path.at(position[inside], speed[inside])
    own = trimmed(plant, planned.charge, planned.lift_mm, planned.duration_deg, speed[inside])

    def placed(values: FloatArray) -> FloatArray:
        result = np.full(position.shape, np.nan)
        result[inside] = values
        return result

    other = throttled.throttle_for_charge(wanted, speeds[:, None])
    quantities = {
        "camless_loss": (placed(own.loss), "J", "pumping loss per event of the optimal path"),
        "throttled_loss": (other.pumping_loss, "J", "pumping loss per event, throttled"),
        "lift_mm": (placed(own.lift_mm), "mm", "lift of the path"),
        "duration_deg": (placed(own.duration_deg), "deg", "duration of the path, trimmed"),
        "throttle_deg": (other.throttle_deg, "deg", "throttle angle"),
        "manifold_pressure": (other.manifold_pressure, "Pa", "mean manifold pressure, throttled"),
    }
    dims = ("speed_rpm", "charge")
    data = xr.Dataset(
        {n: (dims, v, {"units": u, "long_name": text}) for n, (v, u, text) in quantities.items()},
        coords={
            "speed_rpm": ("speed_rpm", speeds, {"units": "rpm", "long_name": "engine speed"}),
            "charge": ("charge", wanted, {"units": "kg", "long_name": "air charge per event"}),
        },
    )
    data["saving"] = 1.0 - data["camless_loss"] / data["throttled_loss"]
    data["saving"].attrs = {"units": "1", "long_name": "share of the throttled loss saved"}
    return PumpingComparison(path.maps, throttled, data)


def _require_camless(plant: CrankAnglePlant) -> None:
    if plant.profile != "camless":
        raise ParameterError(
            f"the plant's profile is {plant.profile!r}, but must be 'camless': a cam leaves no "
            "motion to choose"
        )
