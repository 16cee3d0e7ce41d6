"""Figures and claims published in Part I, as printed.

Source: *Control-Oriented Model for Camless Intake Process (Part I)*. Charge is in mg per
intake event and pumping loss in J per event, as in the paper. What was found wrong in a
printed value is told in its note; the value itself stays as printed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ._checks import one_of
from .crank_angle import Profile
from .valve import ValveCommand

PAPER_TITLE = "Control-Oriented Model for Camless Intake Process (Part I)"

PRINTED_SAVING = 0.74  # 1, pumping loss saved against the throttled engine (section 3.2)
PRINTED_CHARGE_ERROR = 0.10  # 1, largest error against the measured engine (section 4)
PRINTED_LOSS_ERROR = 0.113  # 1, largest error against the measured engine (section 4)

Quantity = Literal["air_charge", "pumping_loss"]


@dataclass(frozen=True, slots=True)
class PublishedFigure:
    """One printed number of the model, and the engine's own where it was measured.

    Attributes
    ----------
    point : PublishedPoint
        Where it was taken.
    quantity : {"air_charge", "pumping_loss"}
        What it is.
    unit : str
        mg or J, per intake event.
    value : float
        The model's value as printed.
    measured : float or None
        Value of the experimental engine, where printed.
    """

    point: PublishedPoint
    quantity: Quantity
    unit: str
    value: float
    measured: float | None


@dataclass(frozen=True, slots=True)
class PublishedPoint:
    """One operating point at which Part I prints the charge or the loss of the model.

    Attributes
    ----------
    id : str
        Short name.
    section : str
        Section of Part I.
    profile : {"camless", "conventional"}
        Valve motion; camless is the simplified one of Eq. 20.
    speed_rpm : float
        Engine speed.
    command : ValveCommand
        Lift, duration and opening.
    throttle_deg : float
        Throttle angle; 90 is unthrottled.
    charge_mg, loss_J : float or None
        The model's figures, mg and J per event.
    measured_charge_mg, measured_loss_J : float or None
        The experimental engine's, mg and J per event.
    note : str
        What a reader of the printed figure should know.
    known_exception : str
        Why the figures cannot be reproduced; empty if they can.
    """

    id: str
    section: str
    profile: Profile
    speed_rpm: float
    command: ValveCommand
    throttle_deg: float = 90.0
    charge_mg: float | None = None
    loss_J: float | None = None  # noqa: N815  (the unit is J)
    measured_charge_mg: float | None = None
    measured_loss_J: float | None = None  # noqa: N815
    note: str = ""
    known_exception: str = ""

    @property
    def figures(self) -> tuple[PublishedFigure, ...]:
        """The numbers printed at this point, charge first."""
        found: list[PublishedFigure] = []
        if self.charge_mg is not None:
            found.append(
                PublishedFigure(self, "air_charge", "mg", self.charge_mg, self.measured_charge_mg)
            )
        if self.loss_J is not None:
            found.append(
                PublishedFigure(self, "pumping_loss", "J", self.loss_J, self.measured_loss_J)
            )
        return tuple(found)


@dataclass(frozen=True, slots=True)
class PublishedClaim:
    """One statement of Part I about the intake process.

    Attributes
    ----------
    id : str
        Short name.
    section : str
        Section of Part I.
    text : str
        What is claimed.
    speed_rpm, lift_mm : float or None
        The numbers in it, where it names a lift at a speed.
    """

    id: str
    section: str
    text: str
    speed_rpm: float | None = None
    lift_mm: float | None = None


_CAM = ValveCommand.conventional()

PUBLISHED_POINTS: tuple[PublishedPoint, ...] = (
    PublishedPoint(
        id="cam-1500",
        section="4",
        profile="conventional",
        speed_rpm=1500.0,
        command=_CAM,
        charge_mg=477.4,
        loss_J=5.2,
        measured_charge_mg=506.9,
        measured_loss_J=5.7,
    ),
    PublishedPoint(
        id="cam-3000",
        section="4",
        profile="conventional",
        speed_rpm=3000.0,
        command=_CAM,
        charge_mg=503.3,
        loss_J=8.9,
        measured_charge_mg=545.6,
        measured_loss_J=7.9,
        note="the table's row is labelled 3500 rpm; the text and Figure 7 say 3000 rpm, and "
        "3000 rpm is what reproduces",
    ),
    PublishedPoint(
        id="cam-4000",
        section="4",
        profile="conventional",
        speed_rpm=4000.0,
        command=_CAM,
        charge_mg=493.0,
        loss_J=12.3,
        measured_charge_mg=545.6,
        measured_loss_J=13.0,
    ),
    PublishedPoint(
        id="camless-fig4",
        section="3.1",
        profile="camless",
        speed_rpm=1500.0,
        command=ValveCommand(lift_mm=3.0, duration_deg=189.0, opening_deg=0.0),
        charge_mg=473.0,
        note="closing at 180 deg plus 9 deg of seating, which fixes the seating duration at 1 ms",
    ),
    PublishedPoint(
        id="camless-fig5",
        section="3.2",
        profile="camless",
        speed_rpm=1500.0,
        command=ValveCommand(lift_mm=2.0, duration_deg=99.0, opening_deg=0.0),
        charge_mg=171.0,
        loss_J=3.55,
    ),
    PublishedPoint(
        id="throttled-fig5",
        section="3.2",
        profile="conventional",
        speed_rpm=1500.0,
        command=_CAM,
        throttle_deg=17.0,
        charge_mg=171.0,
        loss_J=13.8,
        note="the cam is that of section 4; section 3.2 prints none",
        known_exception="Eq. 19 as printed passes too little air at 17 deg for the printed charge",
    ),
)

PUBLISHED_CLAIMS: tuple[PublishedClaim, ...] = (
    PublishedClaim("saturation-750", "5", "lift saturates at about 1.5 mm at 750 rpm", 750.0, 1.5),
    PublishedClaim("saturation-1500", "5", "lift saturates at about 3 mm at 1500 rpm", 1500.0, 3.0),
    PublishedClaim("saturation-5500", "5", "lift saturates at about 5 mm at 5500 rpm", 5500.0, 5.0),
    PublishedClaim("lift-linear", "5", "charge grows almost linearly with lift below saturation"),
    PublishedClaim("specific-loss-lift", "5", "specific pumping loss falls as lift grows"),
    PublishedClaim(
        "flow-reversal",
        "5",
        "charge rises with duration up to a peak near 180 deg and falls beyond it; the peak moves "
        "later as speed grows",
    ),
    PublishedClaim(
        "helmholtz-low-speed",
        "6.1",
        "at 1500 rpm the runner dynamics change charge and loss little",
    ),
    PublishedClaim(
        "helmholtz-ram",
        "6.1",
        "at 6000 rpm the runner dynamics raise charge for late closing and lower it for early "
        "closing",
    ),
    PublishedClaim(
        "actuator-oscillation",
        "6.2",
        "the actuator oscillation hardly changes charge and loss at 0/7 mm/180 deg, and changes "
        "them more as speed grows",
    ),
    PublishedClaim("backflow", "3.1", "flow is backward at the beginning of the intake event"),
    PublishedClaim(
        "validation-error",
        "4",
        "against the measured engine: charge within 10 %, loss within 11.3 % of the prediction",
    ),
)


def published_point(point_id: str) -> PublishedPoint:
    """Return a published operating point by its id.

    Raises
    ------
    ParameterError
        If there is none of that id.
    """
    wanted = one_of("point_id", point_id, (point.id for point in PUBLISHED_POINTS))
    return next(point for point in PUBLISHED_POINTS if point.id == wanted)
