"""Result of an attribution: Sobol' indices, with intervals, over operating points."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from plant._checks import one_of, whole
from plant.region import OperatingPoint

from ._quantities import WORDS

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INDEX_FIELDS = ("first", "first_low", "first_high", "total", "total_low", "total_high")


@dataclass(frozen=True)
class SobolIndex:
    """Indices of one parameter for one quantity at one operating point.

    Attributes
    ----------
    parameter : str
        Name of the parameter or of the group.
    first, first_low, first_high : float
        First-order index and its confidence interval, 1.
    total, total_low, total_high : float
        Total index and its confidence interval, 1.
    """

    parameter: str
    first: float
    first_low: float
    first_high: float
    total: float
    total_low: float
    total_high: float

    def __str__(self) -> str:
        """Return the total index with its interval."""
        low, high = 100.0 * self.total_low, 100.0 * self.total_high
        return f"{self.parameter} {100.0 * self.total:.0f} % ({low:.0f} to {high:.0f} %)"


@dataclass(frozen=True)
class SobolResult:
    """Sobol' indices of the full plant over operating points.

    An index may come out slightly below 0 or above 1: it is an estimate, and not clipped.

    Attributes
    ----------
    dataset : xarray.Dataset
        ``first``, ``first_low``, ``first_high``, ``total``, ``total_low`` and ``total_high``
        over ``quantity``, ``point`` and ``parameter``; ``mean`` and ``std`` over ``quantity``
        and ``point``, in the quantity's ``unit``. NaN where a quantity is attributed without
        the parameter.
    confidence : float
        Of each interval by itself.
    samples : int
        Rows of each base matrix.
    evaluations : int
        Steady cycles in all.
    seed : int
        Seed of the samples.
    """

    dataset: xr.Dataset
    confidence: float
    samples: int
    evaluations: int
    seed: int

    @property
    def quantities(self) -> tuple[str, ...]:
        """Quantities that are attributed."""
        return tuple(str(q) for q in self.dataset["quantity"].to_numpy())

    @property
    def points(self) -> tuple[OperatingPoint, ...]:
        """Operating points."""
        columns = (self.dataset[name].to_numpy() for name in OperatingPoint._fields)
        return tuple(OperatingPoint(*map(float, row)) for row in zip(*columns, strict=True))

    def largest(self, quantity: str, point: int = 0, count: int = 3) -> tuple[SobolIndex, ...]:
        """Indices of the parameters with the largest total index, largest first.

        Parameters
        ----------
        quantity : str
            One of `quantities`.
        point : int
            Place of the operating point in `points`.
        count : int
            How many at most.
        """
        whole("count", count, 1, 10_000)
        found = sorted(self._indices(quantity, point), key=lambda index: -index.total)
        return tuple(found[:count])

    def relative_std(self, quantity: str, point: int = 0) -> float:
        """Standard deviation of a quantity, relative to the magnitude of its mean."""
        own = self._at(quantity, point)
        return float(own["std"] / np.abs(own["mean"]))

    def half_width(self, kind: str = "total", quantity: str | None = None) -> float:
        """Half the width of the widest confidence interval.

        Parameters
        ----------
        kind : {"first", "total"}
            Kind of index.
        quantity : str, optional
            One of `quantities`; all of them by default.
        """
        one_of("kind", kind, ("first", "total"))
        data = self.dataset
        if quantity is not None:
            data = data.sel(quantity=one_of("quantity", quantity, self.quantities))
        return 0.5 * float((data[f"{kind}_high"] - data[f"{kind}_low"]).max())

    def records(self) -> list[dict[str, Any]]:
        """Return a flat record of plain values for each quantity, point and parameter."""
        return [
            {"quantity": quantity, **point._asdict(), **asdict(index)}
            for quantity in self.quantities
            for i, point in enumerate(self.points)
            for index in self._indices(quantity, i)
        ]

    def sentence(self, quantity: str = "charge", point: int = 0) -> str:
        """Return what explains the variance of a quantity at a point, in plain words."""
        spread = 100.0 * self.relative_std(quantity, point)
        named = ", ".join(map(str, self.largest(quantity, point)))
        return (
            f"At {self.points[point]} the {WORDS[quantity]} varies by {spread:.1f} % (1 sigma); "
            f"most of its variance comes from {named}."
        )

    def plot(self, quantity: str = "charge", count: int = 8) -> Figure:
        """Draw the indices of the parameters that matter most, a panel for each point.

        Parameters
        ----------
        quantity : str
            One of `quantities`.
        count : int
            How many parameters, by their largest total index at any point.
        """
        import matplotlib.pyplot as plt

        from plant._plotting import styled

        one_of("quantity", quantity, self.quantities)
        whole("count", count, 1, 10_000)
        data = self.dataset.sel(quantity=quantity).dropna("parameter")
        order = data["total"].max("point").argsort().to_numpy()[::-1][:count]
        data = data.isel(parameter=order)
        panels = len(self.points)
        with styled():
            height = 1.5 + 0.42 * len(order)
            figure, row = plt.subplots(
                1,
                panels,
                sharex=True,
                sharey=True,
                squeeze=False,
                figsize=(2.2 + 2.3 * panels, height),
            )
            for i, ax in enumerate(row[0]):
                _draw_panel(ax, data.isel(point=i))
                point = self.points[i]
                ax.set_title(
                    f"{point.speed_rpm:.0f} rpm\n{point.lift_mm:g} mm, {point.duration_deg:g} deg"
                )
            found = row[0][0].get_legend_handles_labels()
            by_label = dict(sorted(zip(found[1], found[0], strict=True), key=lambda x: "{" in x[0]))
            row[0][0].invert_yaxis()
            figure.supxlabel(f"share of the variance of the {WORDS[quantity]} (1)", fontsize=10.0)
            figure.legend(
                by_label.values(),
                [name.format(f"{100.0 * self.confidence:g} %") for name in by_label],
                loc="outside upper center",
                ncols=3,
            )
        return figure

    def __str__(self) -> str:
        """Return what explains the charge at each point, and how sure that is."""
        lines = [self.sentence("charge", i) for i in range(len(self.points))]
        lines.append(
            f"Shares are total Sobol' indices with {100.0 * self.confidence:g} % intervals, from "
            f"{self.evaluations} steady cycles (seed {self.seed}); the widest interval is "
            f"+-{self.half_width('total'):.2f} (first-order: +-{self.half_width('first'):.2f})."
        )
        return "\n".join(lines)

    def _at(self, quantity: str, point: int) -> xr.Dataset:
        one_of("quantity", quantity, self.quantities)
        whole("point", point, 0, len(self.points) - 1)
        return self.dataset.sel(quantity=quantity).isel(point=point)

    def _indices(self, quantity: str, point: int) -> list[SobolIndex]:
        own = self._at(quantity, point).dropna("parameter")
        columns = [own[field].to_numpy().tolist() for field in INDEX_FIELDS]
        names = own["parameter"].to_numpy().tolist()
        return [
            SobolIndex(str(name), *values) for name, *values in zip(names, *columns, strict=True)
        ]


def _draw_panel(ax: Axes, data: xr.Dataset) -> None:
    """Draw first-order and total bars with their intervals."""
    names = [str(name) for name in data["parameter"].to_numpy()]
    place = np.arange(len(names))
    looks = (
        ("first", "first-order index", -0.2, "#0072B2", ""),
        ("total", "total index", 0.2, "#E69F00", "///"),
    )
    for field, label, shift, colour, hatch in looks:
        value, low, high = (data[f"{field}{end}"].to_numpy() for end in ("", "_low", "_high"))
        ax.barh(
            place + shift,
            value,
            0.38,
            color=colour,
            hatch=hatch,
            edgecolor="0.2",
            lw=0.5,
            label=label,
        )
        bars = ax.hlines(place + shift, low, high, color="black", lw=2.0)
    bars.set_label("{} interval")
    ax.set_yticks(place, names)
    ax.axvline(0.0, color="0.3", lw=0.8)
    ax.set_axisbelow(True)
