"""One uncertain parameter at a time, at either bound: what it changes in the full plant.

Unlike Sobol' indices, this needs no density and shows the sign; but it sees no interaction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import CrankAnglePlant
from plant._checks import one_of, whole
from plant.kinematics import FloatArray
from plant.region import OperatingPoint

from ._quantities import (
    CYCLES_PER_POINT,
    DEFAULT_POINTS,
    DEFINITIONS,
    FLOORS,
    SHARED,
    UNITS,
    WORDS,
    check_drivable,
    checked_points,
    full_plant,
    shared_quantities,
)
from .parameters import UncertainParameter, UncertaintySet
from .perturbed import PerturbedPlants
from .sampling import nominal_sample, one_at_a_time

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

SIDES = ("low", "high")
# side, words, colour (Okabe and Ito) and hatch in the plot
_LOOKS = (("low", "lower bound", "#56B4E9", "///"), ("high", "upper bound", "#D55E00", ""))


@dataclass(frozen=True)
class TornadoBar:
    """Relative changes of a quantity when one parameter goes to its bounds.

    Attributes
    ----------
    parameter : str
        Its name.
    low, high : float
        Relative changes at the lower and the upper bound, 1.
    """

    parameter: str
    low: float
    high: float

    @property
    def swing(self) -> float:
        """Range of the changes, the nominal value (no change) included."""
        return max(self.low, self.high, 0.0) - min(self.low, self.high, 0.0)

    def __str__(self) -> str:
        """Return the parameter with both changes."""
        return f"{self.parameter} ({100.0 * self.low:+.1f} % to {100.0 * self.high:+.1f} %)"


@dataclass(frozen=True)
class TornadoResult:
    """Changes of the full plant with one parameter at a time at its bounds.

    Attributes
    ----------
    dataset : xarray.Dataset
        ``change``, the relative change (1), over ``quantity``, ``point``, ``parameter`` and
        ``side`` (low, high); ``nominal`` over ``quantity`` and ``point``, in the quantity's
        ``unit``; ``bound``, the values of the parameters, over ``parameter`` and ``side``.
    uncertain : UncertaintySet
        The set.
    """

    dataset: xr.Dataset
    uncertain: UncertaintySet

    @property
    def quantities(self) -> tuple[str, ...]:
        """Quantities whose change is known."""
        return tuple(str(q) for q in self.dataset["quantity"].to_numpy())

    @property
    def points(self) -> tuple[OperatingPoint, ...]:
        """Operating points."""
        columns = (self.dataset[name].to_numpy() for name in OperatingPoint._fields)
        return tuple(OperatingPoint(*map(float, row)) for row in zip(*columns, strict=True))

    def bars(
        self, quantity: str = "charge", point: int = 0, count: int | None = None
    ) -> tuple[TornadoBar, ...]:
        """Changes of each parameter, by falling swing.

        Parameters
        ----------
        quantity : str
            One of `quantities`.
        point : int
            Place of the operating point in `points`.
        count : int, optional
            How many at most; all by default.
        """
        one_of("quantity", quantity, self.quantities)
        whole("point", point, 0, len(self.points) - 1)
        change = self.dataset["change"].sel(quantity=quantity).isel(point=point)
        values = change.transpose("parameter", "side").to_numpy().tolist()
        found = [
            TornadoBar(name, *pair) for name, pair in zip(self.uncertain.names, values, strict=True)
        ]
        found.sort(key=lambda bar: -bar.swing)
        return tuple(found if count is None else found[: whole("count", count, 1, 10_000)])

    def records(self) -> list[dict[str, Any]]:
        """Return a flat record of plain values for each quantity, point and parameter."""
        return [
            {
                "quantity": quantity,
                **point._asdict(),
                "parameter": bar.parameter,
                "low": bar.low,
                "high": bar.high,
                "swing": bar.swing,
            }
            for quantity in self.quantities
            for i, point in enumerate(self.points)
            for bar in self.bars(quantity, i)
        ]

    def sentence(self, quantity: str = "charge", point: int = 0) -> str:
        """Return what changes a quantity most at a point, in plain words."""
        named = ", ".join(map(str, self.bars(quantity, point, 3)))
        return f"At {self.points[point]} the {WORDS[quantity]} changes most with {named}."

    def plot(
        self,
        quantity: str = "charge",
        point: int = 0,
        count: int = 12,
        ax: Axes | None = None,
    ) -> Axes:
        """Draw the tornado, the value of the bound at the end of each bar; return the axes."""
        from plant._plotting import axes, styled

        bars = self.bars(quantity, point, count)
        place = np.arange(len(bars))
        with styled():
            ax = axes(ax, (7.2, 1.4 + 0.34 * len(bars)))
            for side, words, colour, hatch in _LOOKS:
                ends = [100.0 * getattr(bar, side) for bar in bars]
                drawn = ax.barh(
                    place,
                    ends,
                    0.7,
                    color=colour,
                    hatch=hatch,
                    edgecolor="0.2",
                    lw=0.5,
                    label=words,
                )
                for k, (bar, end) in enumerate(zip(bars, ends, strict=True)):
                    # Where both bars lie on one side of zero, the shorter one is in front.
                    reach = 100.0 * max(abs(bar.low), abs(bar.high))
                    drawn[k].set_zorder(2.0 if abs(end) == reach else 3.0)
                    _label(ax, k, end, self.uncertain[bar.parameter], side, bar)
            ax.set_yticks(place, [bar.parameter for bar in bars])
            ax.invert_yaxis()
            ax.margins(x=0.16)
            ax.axvline(0.0, color="0.2", lw=1.0, zorder=4.0)
            ax.set_axisbelow(True)
            ax.grid(visible=False, axis="y")
            ax.set_xlabel(f"relative change of the {WORDS[quantity]} (%)")
            ax.set_title(f"One parameter at a time, at {self.points[point]}")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return what changes the charge most at each point, in a sentence each."""
        return "\n".join(self.sentence("charge", i) for i in range(len(self.points)))


def tornado(
    plant: CrankAnglePlant | None = None,
    uncertain: UncertaintySet | None = None,
    points: Sequence[OperatingPoint] = DEFAULT_POINTS,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> TornadoResult:
    """Set one parameter at a time to its bounds, in the full plant.

    Parameters
    ----------
    plant : CrankAnglePlant, optional
        Nominal plant; the paper's with runner and oscillation by default.
    uncertain : UncertaintySet, optional
        The set; `UncertaintySet.plant` by default. A parameter of one cylinder changes the
        mean over all.
    points : sequence of OperatingPoint
        Commanded operating points.
    progress : callable, optional
        Called with the number of steady cycles done and the number in all.

    Returns
    -------
    TornadoResult
        Its changes are relative to the nominal value, or to 50 mg, 0.5 J and 1 mg/deg where
        that is smaller in magnitude.

    Raises
    ------
    ParameterError
        If the set is empty, or there is no operating point.
    InfeasibleProfileError
        If the nominal valve cannot be driven at a point, or half a degree shorter.
    """
    plant = full_plant(plant)
    uncertain = UncertaintySet.plant() if uncertain is None else uncertain
    points = checked_points(points)
    check_drivable(plant, points)
    sample = nominal_sample(uncertain).joined(one_at_a_time(uncertain))
    total = len(sample) * len(points) * CYCLES_PER_POINT

    def report(done: int, _: int) -> None:
        if progress is not None:
            progress(done, total)

    found = shared_quantities(PerturbedPlants(plant, sample), points, report)
    return _result(found, uncertain, points, plant.fingerprint)


def _result(
    found: dict[str, FloatArray],
    uncertain: UncertaintySet,
    points: Sequence[OperatingPoint],
    fingerprint: str,
) -> TornadoResult:
    """Changes of quantities (1 + 2 d, points): nominal first, then low and high of each."""
    import xarray as xr

    nominal = np.stack([found[quantity][0] for quantity in SHARED])
    floors = np.array([FLOORS[quantity] for quantity in SHARED])[:, None]
    moved = np.stack([found[quantity][1:] for quantity in SHARED])  # quantity, row, point
    change = (moved - nominal[:, None]) / np.maximum(np.abs(nominal), floors)[:, None]
    change = change.reshape(len(SHARED), len(uncertain), 2, len(points)).transpose(0, 3, 1, 2)
    units = ("rpm", "mm", "deg")
    coords: dict[str, Any] = {
        "quantity": list(SHARED),
        "unit": ("quantity", [UNITS[q] for q in SHARED]),
        "definition": ("quantity", [DEFINITIONS[q] for q in SHARED]),
        "parameter": list(uncertain.names),
        "side": list(SIDES),
    }
    coords |= {
        name: ("point", [getattr(p, name) for p in points], {"units": unit})
        for name, unit in zip(OperatingPoint._fields, units, strict=True)
    }
    bounds = np.column_stack((uncertain.low, uncertain.high))
    dataset = xr.Dataset(
        {
            "change": (("quantity", "point", "parameter", "side"), change, {"units": "1"}),
            "nominal": (("quantity", "point"), nominal, {"units": "that of the quantity"}),
            "bound": (("parameter", "side"), bounds, {"units": "that of the parameter"}),
        },
        coords,
        attrs={"plant": fingerprint},
    )
    return TornadoResult(dataset, uncertain)


def _label(
    ax: Axes, row: int, end: float, parameter: UncertainParameter, side: str, bar: TornadoBar
) -> None:
    """Write the value of a bound beside the end of its bar."""
    value = getattr(parameter, side)
    text = f"{1e3 * value:g} ms" if parameter.unit == "s" else f"{value:g}"
    if parameter.unit not in ("1", "s"):
        text += f" {parameter.unit}"
    other = 100.0 * (bar.high if side == "low" else bar.low)
    right = end > other if end != other else side == "high"
    if end * other > 0.0 and abs(end) < abs(other):
        right = end < 0.0  # both on one side of zero: the shorter one is labelled across zero
        end = 0.0
    ax.annotate(
        text,
        (end, row),
        xytext=(4 if right else -4, 0),
        textcoords="offset points",
        ha="left" if right else "right",
        va="center",
        fontsize=8.0,
    )
