"""Charge estimates against the true charge of the full plant, cylinder by cylinder.

This project's own design. The plant is driven with charges that vary at random from event to
event, and that step in the middle of the run. The estimator is told predictions that are off, so
that it is the estimate that is tested. What no estimator could see, the gain error of the MAF
sensor, is kept apart: errors are those of the estimate over ``(1 + gain error)`` times the true
charge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from plant import CrankAnglePlant, ValveCommand
from plant._checks import in_range, positive, truth, whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray
from plant.sensors import MafSensor, SensorSet

from ._estimation_runs import varied_history, watch
from .kalman_estimator import KalmanEstimator

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

FIRST_CYCLES = 2  # that do not count: the filter knows nothing yet
TRACE_STEP_DEG = 0.5  # deg, of what the sensors see; 1 deg misstates small changes of duration


@dataclass(frozen=True)
class EstimationPoint:
    """Operating point of a check: the middle of the commands."""

    speed_rpm: float
    lift_mm: float
    duration_deg: float

    def __post_init__(self) -> None:
        positive("speed_rpm", self.speed_rpm, "rpm")
        positive("lift_mm", self.lift_mm, "mm")
        positive("duration_deg", self.duration_deg, "deg")


@dataclass(frozen=True)
class EstimationResult:
    """Estimates of one run, `m` events, the first cycles and the last one left out.

    Attributes
    ----------
    point : EstimationPoint
        Operating point.
    n_cylinders : int
        Number of cylinders.
    gain_error : float
        Gain error of the MAF sensor: the part of the error that no estimator could see, 1.
    charge : ndarray (m,)
        True charge, kg.
    filtered, smoothed : ndarray (m,)
        Estimates, kg; NaN without.
    filtered_variance, smoothed_variance : ndarray (m,)
        Their variances as the filter has them, kg2.
    innovation, degrees : ndarray (m,)
        Normalised innovation squared of each window and its degrees of freedom, 1.
    used, rejected : int
        Samples that were used, and that were not.
    """

    point: EstimationPoint
    n_cylinders: int
    gain_error: float
    charge: FloatArray = field(repr=False)
    filtered: FloatArray = field(repr=False)
    filtered_variance: FloatArray = field(repr=False)
    smoothed: FloatArray = field(repr=False)
    smoothed_variance: FloatArray = field(repr=False)
    innovation: FloatArray = field(repr=False)
    degrees: FloatArray = field(repr=False)
    used: int
    rejected: int

    @property
    def error(self) -> FloatArray:
        """Relative error of the smoothed estimates, the MAF gain error taken off, (m,)."""
        return np.asarray(self.smoothed / ((1.0 + self.gain_error) * self.charge) - 1.0)

    @property
    def filtered_error(self) -> FloatArray:
        """The same of the filtered estimates, (m,)."""
        return np.asarray(self.filtered / ((1.0 + self.gain_error) * self.charge) - 1.0)

    @property
    def bias(self) -> float:
        """Mean error, 1."""
        return _mean(self.error)

    @property
    def spread(self) -> float:
        """Standard deviation of the error of a single event, 1."""
        return math.sqrt(_mean((self.error - self.bias) ** 2))

    @property
    def cylinder_errors(self) -> FloatArray:
        """Mean error of each cylinder, (n,)."""
        columns = self.error.reshape(-1, self.n_cylinders).T
        return np.array([_mean(column) for column in columns])

    @property
    def sigma(self) -> float:
        """Standard deviation that the filter itself gives, root mean square, 1."""
        return math.sqrt(_mean(self.smoothed_variance / self.charge**2))

    @property
    def consistency(self) -> float:
        """Root mean square of error over the filter's own standard deviation; 1 is honest."""
        true = (1.0 + self.gain_error) * self.charge
        return math.sqrt(_mean((self.smoothed - true) ** 2 / self.smoothed_variance))

    @property
    def innovation_ratio(self) -> float:
        """Sum of the normalised innovations over that of their degrees of freedom; 1 is honest."""
        degrees = float(np.nansum(self.degrees))
        return float(np.nansum(self.innovation)) / degrees if degrees else math.nan

    def innovation_interval(self, confidence: float = 0.99) -> tuple[float, float]:
        """Chi-square interval of `innovation_ratio` on the filter's own model."""
        from scipy import stats

        degrees = float(np.nansum(self.degrees))
        if degrees == 0.0:
            return math.nan, math.nan
        low, high = stats.chi2.interval(confidence, degrees)
        return float(low) / degrees, float(high) / degrees

    @property
    def missing(self) -> int:
        """Events without an estimate."""
        return int(np.count_nonzero(np.isnan(self.smoothed)))

    def __str__(self) -> str:
        """Return one row of the table."""
        low, high = self.innovation_interval()
        cylinders = " ".join(f"{100.0 * e:+.2f}" for e in self.cylinder_errors)
        return (
            f"{self.n_cylinders:9d} {self.point.speed_rpm:5.0f} {1e6 * self.charge.mean():5.0f} "
            f"{100.0 * self.bias:+6.2f} {100.0 * self.spread:6.2f} {100.0 * self.sigma:6.2f} "
            f"{self.consistency:6.2f} {self.innovation_ratio:5.2f} ({low:.2f}-{high:.2f}) "
            f"{self.missing:5d}  {cylinders}"
        )


def _mean(values: FloatArray) -> float:
    """Mean of the values that are there; NaN if there are none."""
    there = values[~np.isnan(values)]
    return float(there.mean()) if there.size else math.nan


@dataclass(frozen=True)
class EstimationCheck:
    """Results of all operating points; prints as a table."""

    results: tuple[EstimationResult, ...]

    @property
    def worst_cylinder_error(self) -> float:
        """Largest mean error of a cylinder, 1."""
        return max(float(np.max(np.abs(r.cylinder_errors))) for r in self.results)

    def to_dataset(self) -> xr.Dataset:
        """Return the figures of each operating point as an `xarray.Dataset` with units."""
        import xarray as xr

        columns = {
            "speed": ("rpm", [r.point.speed_rpm for r in self.results]),
            "lift": ("mm", [r.point.lift_mm for r in self.results]),
            "duration": ("deg", [r.point.duration_deg for r in self.results]),
            "n_cylinders": ("1", [r.n_cylinders for r in self.results]),
            "gain_error": ("1", [r.gain_error for r in self.results]),
            "charge": ("kg", [float(r.charge.mean()) for r in self.results]),
            "bias": ("1", [r.bias for r in self.results]),
            "spread": ("1", [r.spread for r in self.results]),
            "sigma": ("1", [r.sigma for r in self.results]),
            "consistency": ("1", [r.consistency for r in self.results]),
            "innovation_ratio": ("1", [r.innovation_ratio for r in self.results]),
            "missing": ("1", [r.missing for r in self.results]),
        }
        data = {
            name: ("point", np.array(values), {"units": unit})
            for name, (unit, values) in columns.items()
        }
        most = max((r.n_cylinders for r in self.results), default=0)
        errors = np.full((len(self.results), most), math.nan)
        for row, result in zip(errors, self.results, strict=True):
            row[: result.n_cylinders] = result.cylinder_errors
        return xr.Dataset(
            {**data, "cylinder_error": (("point", "cylinder"), errors, {"units": "1"})},
            coords={"cylinder": np.arange(1, most + 1)},
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw error and mean error of the cylinders against speed."""
        from plant._plotting import COLOURS, axes, styled

        with styled():
            ax = axes(ax)
            numbers = sorted({r.n_cylinders for r in self.results})
            for colour, n in zip(COLOURS, numbers, strict=False):
                chosen = [r for r in self.results if r.n_cylinders == n]
                speed = [r.point.speed_rpm for r in chosen]
                ax.plot(
                    speed, [100.0 * r.spread for r in chosen], "o", c=colour, label=f"{n} cylinders"
                )
                ax.plot(speed, [100.0 * r.sigma for r in chosen], "_", ms=14, c=colour)
                for r in chosen:
                    errors = 100.0 * np.abs(r.cylinder_errors)
                    ax.plot([r.point.speed_rpm] * errors.size, errors, "x", ms=4, c=colour)
            ax.set_xlabel("speed (rpm)")
            ax.set_ylabel("charge error (%)")
            ax.set_title("one event: o found, - by the filter; x mean of a cylinder")
            ax.legend()
        return ax

    def __str__(self) -> str:
        """Return a table, one row an operating point."""
        head = (
            "cylinders   rpm    mg  bias% event%  sigma  ratio innovation (99 %)    none  "
            "mean error of each cylinder, %"
        )
        lines = [head, *(str(r) for r in self.results)]
        gains = {r.gain_error for r in self.results} - {0.0}
        if gains:
            text = ", ".join(f"{100.0 * g:+.1f} %" for g in sorted(gains))
            lines.append(f"not counted: MAF gain error of {text}, which no estimator could see")
        return "\n".join(lines)


def check_estimator(
    estimator: KalmanEstimator,
    plant: CrankAnglePlant,
    points: Sequence[EstimationPoint],
    *,
    sensors: SensorSet | None = None,
    cycles: int = 80,
    variation: float = 0.05,
    step: float = 0.75,
    prediction_bias: float = 0.03,
    prediction_spread: float = 0.05,
    known_gains: bool = True,
    seed: int = 0,
    trace_step_deg: float = TRACE_STEP_DEG,
) -> EstimationCheck:
    """Compare estimates with the plant's true charges.

    Parameters
    ----------
    estimator : KalmanEstimator
        The estimator, with what it assumes of the sensors.
    plant : CrankAnglePlant
        The full plant; its cylinders may differ (``Engine.cylinder_flow_factors``). What the
        estimator is told comes from a plant with equal cylinders.
    points : sequence of EstimationPoint
        Operating points.
    sensors : SensorSet, optional
        What the sensors are in truth; the default ones. Their lag, delay and gain may differ
        from what the estimator assumes.
    cycles : int
        Length of each run.
    variation : float
        Random variation of the charge from event to event (1 sigma), by the duration, 1.
    step : float
        Factor on the charge in the second half of the run, 1.
    prediction_bias, prediction_spread : float
        Error of the predicted charge: of all events, and random (1 sigma), 1.
    known_gains : bool
        Whether the predicted *shares* of the inflow know the flow gain of each cylinder, as
        those of an adapted charge model do. The predicted *charge* never does.
    seed : int
        Seed of commands and noise.
    trace_step_deg : float
        Fineness of what the sensors see, deg.

    Raises
    ------
    ParameterError
        For arguments out of range, or an engine with another number of cylinders.
    """
    n = plant.engine.n_cylinders
    if estimator.n_cylinders != n:
        raise ParameterError(
            f"the estimator is made for {estimator.n_cylinders} cylinders, but the plant has {n}: "
            "use KalmanEstimator.of(plant.engine)"
        )
    whole("cycles", cycles, FIRST_CYCLES + 2, 100_000)
    in_range("variation", variation, 0.0, 0.3, "1")
    in_range("step", step, 0.3, 1.0, "1")
    in_range("prediction_bias", prediction_bias, -0.5, 0.5, "1")
    in_range("prediction_spread", prediction_spread, 0.0, 0.3, "1")
    truth("known_gains", known_gains)
    sensors = SensorSet() if sensors is None else sensors
    gain = sensors.maf.gain_error if isinstance(sensors.maf, MafSensor) else 0.0
    counted = slice(FIRST_CYCLES * n, (cycles - 1) * n)
    results = []
    for point in points:
        history = varied_history(
            plant,
            ValveCommand(point.lift_mm, point.duration_deg),
            point.speed_rpm,
            cycles=cycles,
            variation=variation,
            step=step,
            prediction_bias=prediction_bias,
            prediction_spread=prediction_spread,
            known_gains=known_gains,
            trace_step_deg=trace_step_deg,
            seed=seed,
        )
        seen = watch(estimator, history, sensors, seed)
        results.append(
            EstimationResult(
                point,
                n,
                gain,
                history.charge[counted],
                seen.filtered[counted],
                seen.filtered_variance[counted],
                seen.smoothed[counted],
                seen.smoothed_variance[counted],
                seen.innovation[counted],
                seen.degrees[counted],
                seen.used,
                seen.rejected,
            )
        )
    return EstimationCheck(tuple(results))
