"""Result of a delta: what an ignored effect changes, over the operating grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from plant import ParameterError
from plant.region import OperatingPoint

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Quantity = Literal["charge", "loss", "sensitivity"]

QUANTITIES: dict[Quantity, str] = {
    "charge": "air charge",
    "loss": "pumping loss",
    "sensitivity": "sensitivity of the charge to duration",
}

# quantity, colour (Okabe and Ito), hatch and line style in the plot
_LOOKS: tuple[tuple[Quantity, str, str, str], ...] = (
    ("loss", "#D55E00", "//", "--"),
    ("charge", "#0072B2", "", "-"),
)


@dataclass(frozen=True)
class WorstChange:
    """Largest relative change in magnitude, and where it is."""

    value: float  # 1, signed
    at: OperatingPoint

    def __str__(self) -> str:
        """Return the change in per cent and the point."""
        return f"{100.0 * self.value:+.1f} % at {self.at}"


@dataclass(frozen=True)
class DeltaResult:
    """Relative changes over the operating grid, perturbed against nominal.

    Attributes
    ----------
    name : str
        Name of the delta.
    effect : str
        The ignored effect in words that begin a sentence.
    dataset : xarray.Dataset
        ``charge``, ``loss`` and ``sensitivity``, the relative changes (1), with their nominal
        values ``nominal_charge`` (kg), ``nominal_loss`` (J), ``nominal_sensitivity`` (kg/deg)
        and ``feasible``, over ``speed`` (rpm), ``lift`` (mm) and ``duration`` (deg). NaN where
        a point is not feasible.
    """

    name: str
    effect: str
    dataset: xr.Dataset

    @property
    def worst_charge(self) -> WorstChange:
        """Largest relative change of the air charge."""
        return self.worst("charge")

    @property
    def worst_loss(self) -> WorstChange:
        """Largest relative change of the pumping loss."""
        return self.worst("loss")

    def worst(self, quantity: Quantity) -> WorstChange:
        """Largest relative change in magnitude of a quantity."""
        return self._at(quantity, np.abs(self.dataset[quantity].to_numpy()))

    def lowest(self, quantity: Quantity) -> WorstChange:
        """Most negative relative change of a quantity."""
        return self._at(quantity, -self.dataset[quantity].to_numpy())

    def highest(self, quantity: Quantity) -> WorstChange:
        """Most positive relative change of a quantity."""
        return self._at(quantity, self.dataset[quantity].to_numpy())

    def over_speed(self) -> xr.Dataset:
        """Envelope against speed: lowest, highest and rms change over lift and duration.

        Returns
        -------
        xarray.Dataset
            ``charge``, ``loss`` and ``sensitivity`` over ``statistic`` (min, max, rms) and
            ``speed``; NaN at a speed that has no feasible point.
        """
        import xarray as xr

        envelope = {}
        for quantity in QUANTITIES:
            change = np.ma.masked_invalid(self.dataset[quantity].to_numpy())
            over = (1, 2)
            rows = [
                np.ma.filled(part, np.nan)
                for part in (
                    change.min(axis=over),
                    change.max(axis=over),
                    np.ma.sqrt((change**2).mean(axis=over)),
                )
            ]
            envelope[quantity] = (("statistic", "speed"), np.stack(rows), {"units": "1"})
        return xr.Dataset(
            envelope,
            coords={"statistic": ["min", "max", "rms"], "speed": self.dataset["speed"]},
        )

    def sentence(self) -> str:
        """Return what the effect changes, how far it goes and where, in plain words."""
        charge, loss = self.worst_charge, self.worst_loss
        return (
            f"{self.effect} changes the charge by {self._range('charge')} (worst at {charge.at}) "
            f"and the pumping loss by {self._range('loss')} (worst at {loss.at}), "
            "relative to the plant without it (or to 50 mg and 0.5 J where that is less)."
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the envelopes of charge and loss over speed and return the axes."""
        from plant._plotting import axes, styled

        envelope = self.over_speed()
        speed = envelope["speed"].to_numpy()
        with styled():
            ax = axes(ax)
            for quantity, colour, hatch, style in _LOOKS:
                low, high, rms = 100.0 * envelope[quantity].to_numpy()
                ax.fill_between(
                    speed,
                    low,
                    high,
                    facecolor=colour,
                    edgecolor=colour,
                    hatch=hatch,
                    alpha=0.25,
                    label=f"{QUANTITIES[quantity]}: lowest to highest",
                )
                ax.plot(speed, rms, style, c=colour, label=f"{QUANTITIES[quantity]}: rms")
            ax.axhline(0.0, color="0.3", lw=0.8)
            ax.set_xlabel("speed (rpm)")
            ax.set_ylabel("relative change (%)")
            ax.set_title(f"{self.name}: change over all feasible lifts and durations")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return `sentence`."""
        return self.sentence()

    def _range(self, quantity: Quantity) -> str:
        low, high = (100.0 * f(quantity).value for f in (self.lowest, self.highest))
        return f"{low:+.1f} % to {high:+.1f} %"

    def _at(self, quantity: Quantity, score: np.ndarray) -> WorstChange:
        if np.isnan(score).all():
            raise ParameterError(
                f"the grid has no feasible point for the {QUANTITIES[quantity]}: lengthen its "
                "durations"
            )
        index = np.unravel_index(np.nanargmax(score), score.shape)
        point = self.dataset[quantity][tuple(int(i) for i in index)]
        return WorstChange(
            float(point),
            OperatingPoint(*(float(point[dim]) for dim in ("speed", "lift", "duration"))),
        )
