"""Rows of a validation: a figure, a claim and the throttled engine at equal charge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ._claims import Measured
from .published import PRINTED_SAVING, Quantity

FIGURE_BAR = 0.02  # 1, relative error within which a published figure counts as reproduced


@dataclass(frozen=True, slots=True)
class FigureResult:
    """A published figure beside the simulated one.

    Attributes
    ----------
    id : str
        Operating point, as in `plant.published`.
    quantity : {"air_charge", "pumping_loss"}
        What it is.
    unit : str
        mg or J, per intake event.
    published, computed : float
        As printed, and by simulation.
    measured : float or None
        Value of the experimental engine, where printed.
    known_exception : str
        Why it cannot be reproduced; empty where it can.
    note : str
        Remark on the row, with the reason where it is not reproduced.
    """

    id: str
    quantity: Quantity
    unit: str
    published: float
    computed: float
    measured: float | None = None
    known_exception: str = ""
    note: str = ""

    @property
    def relative_error(self) -> float:
        """Computed over published, less one."""
        return self.computed / self.published - 1.0

    @property
    def reproduced(self) -> bool:
        """Whether the computed figure is within 2 % of the published one."""
        return abs(self.relative_error) <= FIGURE_BAR

    def as_dict(self) -> dict[str, Any]:
        """Return the row as JSON types."""
        return {
            "id": self.id,
            "quantity": self.quantity,
            "unit": self.unit,
            "published": self.published,
            "computed": self.computed,
            "relative_error": self.relative_error,
            "reproduced": self.reproduced,
            "measured": self.measured,
            "known_exception": self.known_exception,
            "note": self.note,
        }


@dataclass(frozen=True, slots=True)
class ClaimResult:
    """A claim of Part I and what simulation says to it.

    Attributes
    ----------
    id, section, text : str
        The claim, as in `plant.published`.
    definition : str
        What is computed, and when it counts as reproduced.
    measured : dict of str to Measured
        What was computed, with units.
    reproduced : bool
        The verdict.
    why : str
        The verdict in words and numbers.
    known_exception : str
        Why the paper engine cannot reproduce it; empty where it does.
    """

    id: str
    section: str
    text: str
    definition: str
    measured: dict[str, Measured]
    reproduced: bool
    why: str
    known_exception: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the claim as JSON types."""
        return {
            "id": self.id,
            "reproduced": self.reproduced,
            "measured": {
                name: {"value": entry.value, "unit": entry.unit}
                for name, entry in self.measured.items()
            },
            "why": self.why,
            "text": self.text,
            "section": self.section,
            "definition": self.definition,
            "known_exception": self.known_exception,
        }


@dataclass(frozen=True, slots=True)
class EqualCharge:
    """The throttled engine at the charge printed for it (section 3.2).

    Attributes
    ----------
    throttle_deg : float
        Throttle angle that gives the printed charge.
    charge_mg, loss_J : float
        Charge and loss there.
    saving : float
        Share of that loss that the unthrottled camless point of Figure 5 saves.
    """

    throttle_deg: float
    charge_mg: float
    loss_J: float  # noqa: N815  (the unit is J)
    saving: float

    def __str__(self) -> str:
        """Return the finding as a clause."""
        return (
            f"{self.charge_mg:.0f} mg takes {self.throttle_deg:.1f} deg and costs "
            f"{self.loss_J:.1f} J, so that unthrottled operation saves {100 * self.saving:.0f} % "
            f"(printed: {100 * PRINTED_SAVING:.0f} %)"
        )
