"""Result of a delta: what an uncertainty changes, over the operating grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from plant import ParameterError
from plant._checks import one_of
from plant.kinematics import FloatArray
from plant.region import OperatingPoint

from ._delta_quantities import AXES, QUANTITIES, Quantity

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["QUANTITIES", "Bound", "DeltaResult", "Quantity", "WorstChange", "extreme"]

Bound = Literal["worst", "lowest", "highest"]


@dataclass(frozen=True)
class WorstChange:
    """A relative change, where it is, and in which case."""

    value: float  # 1, signed
    at: OperatingPoint
    case: str = ""

    def __str__(self) -> str:
        """Return the change in per cent, the point and the case."""
        case = f" ({self.case})" if self.case else ""
        return f"{100.0 * self.value:+.1f} % at {self.at}{case}"

    def place(self) -> dict[str, Any]:
        """Return point and case, for a JSON file."""
        return {**self.at._asdict(), "case": self.case}


@dataclass(frozen=True)
class DeltaResult:
    """Relative changes over the operating grid, perturbed against nominal.

    Attributes
    ----------
    name : str
        Name of the delta.
    effect : str
        What changes the plant, in words that begin a sentence.
    against : str
        The nominal plant, in words that follow "relative to".
    dataset : xarray.Dataset
        Relative changes (1) of the six `QUANTITIES` over ``case``, ``speed`` (rpm), ``lift``
        (mm) and ``duration`` (deg), with the nominal values, ``nominal_charge`` (kg) and so on,
        and ``feasible``, over the last three. NaN where the nominal valve cannot be driven; for
        a sensitivity also where it cannot at one of the two points of its difference; for a
        case also where its valve reaches not even the lowest lift.
    """

    name: str
    effect: str
    against: str
    dataset: xr.Dataset

    # -- the largest changes -------------------------------------------------------------------

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
        return self._at(quantity, np.abs(self.changes(quantity)))

    def lowest(self, quantity: Quantity) -> WorstChange:
        """Most negative relative change of a quantity."""
        return self._at(quantity, -self.changes(quantity))

    def highest(self, quantity: Quantity) -> WorstChange:
        """Most positive relative change of a quantity."""
        return self._at(quantity, self.changes(quantity))

    # -- cases and envelopes -------------------------------------------------------------------

    @property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases."""
        return tuple(str(name) for name in self.dataset["case"].to_numpy())

    def only(self, *cases: str) -> Self:
        """Return the result of some of the cases."""
        from dataclasses import replace

        if not cases:
            raise ParameterError(f"no case is named: name one or more of {', '.join(self.cases)}")
        for case in cases:
            one_of("case", case, self.cases)
        return replace(self, dataset=self.dataset.sel(case=list(cases)))

    def changes(self, quantity: Quantity) -> FloatArray:
        """Relative changes of a quantity (case, speed, lift, duration)."""
        one_of("quantity", quantity, QUANTITIES)
        return np.asarray(self.dataset[quantity].to_numpy(), dtype=float)

    def lower(self, quantity: Quantity) -> xr.DataArray:
        """Lowest change over the cases that can be driven, over speed, lift and duration."""
        one_of("quantity", quantity, QUANTITIES)
        return self.dataset[quantity].min("case", skipna=True, keep_attrs=True)

    def upper(self, quantity: Quantity) -> xr.DataArray:
        """Highest change over the cases that can be driven, over speed, lift and duration."""
        one_of("quantity", quantity, QUANTITIES)
        return self.dataset[quantity].max("case", skipna=True, keep_attrs=True)

    def over_speed(self) -> xr.Dataset:
        """Envelope against speed: lowest, highest and rms change over cases, lifts, durations.

        Returns
        -------
        xarray.Dataset
            The six quantities over ``statistic`` (min, max, rms) and ``speed``; NaN at a speed
            that has no feasible point.
        """
        import xarray as xr

        envelope = {}
        for quantity in QUANTITIES:
            change = np.ma.masked_invalid(self.changes(quantity))
            over = (0, 2, 3)
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

    # -- words, pictures, records --------------------------------------------------------------

    def sentence(self) -> str:
        """Return what changes, how far it goes and where, in plain words."""
        charge, loss = self.worst_charge, self.worst_loss
        return (
            f"{self.effect} changes the charge by {self._range('charge')} (worst at {charge.at}: "
            f"{charge.case}) and the pumping loss by {self._range('loss')} (worst at {loss.at}: "
            f"{loss.case}), relative to {self.against} (or to 50 mg and 0.5 J where that is less)."
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the envelopes of charge and loss over speed and return the axes."""
        from ._delta_plots import envelope_plot

        return envelope_plot(self, ax)

    def plot_map(
        self,
        quantity: Quantity = "charge",
        *,
        speed_rpm: float | None = None,
        bound: Bound = "worst",
        ax: Axes | None = None,
    ) -> Axes:
        """Draw the change over lift and duration at a speed and return the axes.

        Parameters
        ----------
        quantity : str
            One of `QUANTITIES`.
        speed_rpm : float, optional
            A speed of the grid; that of the worst change by default.
        bound : {"worst", "lowest", "highest"}
            Which change over the cases: the largest in magnitude, or an end of the envelope.
        ax : matplotlib.axes.Axes, optional
            Where to draw.
        """
        from ._delta_plots import map_plot

        return map_plot(self, quantity, speed_rpm, bound, ax)

    def record(self) -> dict[str, Any]:
        """Return the worst changes of charge and loss (1) and where they are, for a JSON file."""
        charge, loss = self.worst_charge, self.worst_loss
        return {
            "name": self.name,
            "worst_charge": charge.value,
            "worst_loss": loss.value,
            "at": charge.place(),
            "loss_at": loss.place(),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the record with the extremes of all quantities, the cases and the grid."""
        return {
            **self.record(),
            "effect": self.effect,
            "against": self.against,
            "cases": list(self.cases),
            "grid": {dim: self.dataset[dim].to_numpy().tolist() for dim in AXES},
            "quantities": {
                quantity: {
                    bound: {"value": found.value, "unit": "1", "at": found.place()}
                    for bound, found in (
                        ("lowest", self.lowest(quantity)),
                        ("highest", self.highest(quantity)),
                    )
                }
                for quantity in QUANTITIES
                if np.isfinite(self.changes(quantity)).any()
            },
        }

    def __str__(self) -> str:
        """Return `sentence`."""
        return self.sentence()

    def _range(self, quantity: Quantity) -> str:
        low, high = (100.0 * f(quantity).value for f in (self.lowest, self.highest))
        return f"{low:+.1f} % to {high:+.1f} %"

    def _at(self, quantity: Quantity, score: FloatArray) -> WorstChange:
        return extreme(self.dataset[quantity], score, QUANTITIES[quantity])


def extreme(changes: xr.DataArray, score: FloatArray, what: str) -> WorstChange:
    """Change at the highest `score`, with its point and case."""
    if np.isnan(score).all():
        raise ParameterError(
            f"the grid has no feasible point for the {what}: lengthen its durations"
        )
    index = np.unravel_index(np.nanargmax(score), score.shape)
    point = changes[tuple(int(i) for i in index)]
    return WorstChange(
        float(point),
        OperatingPoint(*(float(point[dim]) for dim in AXES)),
        str(point["case"].item()),
    )
