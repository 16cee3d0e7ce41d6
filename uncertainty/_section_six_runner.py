"""Statements of section 6.1 judged on the data of Figures 11 to 13, and their captions.

The bounds are those that the validation of the plant holds the claims of section 6 against;
Part I prints none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from plant._claims import RESOLVED
from plant._claims_dynamics import SMALL_CHARGE_CHANGE, SMALL_LOSS_CHANGE
from plant.kinematics import FloatArray

from ._section_six_words import Caption, SectionSixClaim, Value, extreme, per_cent, verdicts
from .section_six_result import relative_change

if TYPE_CHECKING:
    import xarray as xr

EARLY_DEG, AT_EVENT_DEG, LATE_DEG = 80.0, 180.0, 230.0  # section 6.1

_SMALL_CHARGE = "half of the 10 % that section 4 calls rather accurate"
_SMALL_LOSS = "a little below the 11.3 % that section 4 calls rather accurate"
_RESOLVED = "what the accuracy of the plant can tell from none"

Mask = npt.NDArray[np.bool_]
Told = tuple[tuple[SectionSixClaim, ...], Caption]


def slow_runner_words(data: xr.Dataset) -> Told:
    """Judge and describe Figure 11."""
    judged = data["closing"].values >= EARLY_DEG
    judged &= data["closing"].values <= LATE_DEG
    largest, outside, over_lift = {}, {}, {}
    for quantity in ("charge", "loss", "specific_loss"):
        closing = np.abs(relative_change(data[f"{quantity}_over_closing"]).values)
        lift = np.abs(relative_change(data[f"{quantity}_over_lift"]).values)
        over_lift[quantity] = extreme(np.max, lift)
        largest[quantity] = extreme(np.max, closing[judged])
        outside[quantity] = extreme(np.max, closing[~judged])
    small: tuple[tuple[str, str, float, str], ...] = (
        ("charge", "air charge", SMALL_CHARGE_CHANGE, _SMALL_CHARGE),
        ("loss", "pumping loss", SMALL_LOSS_CHANGE, _SMALL_LOSS),
        ("specific_loss", "specific pumping loss", SMALL_LOSS_CHANGE, _SMALL_LOSS),
    )
    claims = tuple(
        SectionSixClaim(
            f"small-{quantity.replace('_', '-')}",
            f'"small discrepancy" of the {name}',
            f"largest change over lift, and over closing timing from {EARLY_DEG:g} to "
            f"{LATE_DEG:g} deg",
            extreme(np.max, np.array([over_lift[quantity], largest[quantity]])),
            bound,
            "at most",
            basis,
        )
        for quantity, name, bound, basis in small
    )
    values = {
        **_operating(data),
        **per_cent(
            charge_lift=over_lift["charge"],
            loss_lift=over_lift["loss"],
            charge_closing=largest["charge"],
            loss_closing=largest["loss"],
            specific_closing=largest["specific_loss"],
        ),
        "early": Value(EARLY_DEG, "deg"),
        "late": Value(LATE_DEG, "deg"),
    }
    template = (
        "At {speed:.0f} the runner changes the charge by at most {charge_lift:.1f} over lift "
        "(closing at {closing:.0f}) and {charge_closing:.1f} over closing timing from {early:.0f} "
        "to {late:.0f} (at {lift:g}), the pumping loss by {loss_lift:.1f} and {loss_closing:.1f}, "
        "and the specific loss over closing timing by {specific_closing:.1f}."
    )
    if np.isfinite(outside["loss"]):
        template += (
            " Before and after these timings the charge changes by up to {charge_outside:.1f} and "
            "the loss by up to {loss_outside:.1f}."
        )
        values |= per_cent(charge_outside=outside["charge"], loss_outside=outside["loss"])
    return claims, _caption(template, values, claims, data)


def fast_runner_words(data: xr.Dataset) -> Told:
    """Judge and describe Figure 12."""
    closing = data["closing"].values
    charge, loss, specific = (
        relative_change(data[f"{quantity}_over_closing"]).values
        for quantity in ("charge", "loss", "specific_loss")
    )
    early, late = closing < AT_EVENT_DEG, closing >= LATE_DEG
    over_all = np.abs([*charge, *relative_change(data["charge_over_lift"]).values])
    first, last = f"closing before {AT_EVENT_DEG:g} deg", f"closing from {LATE_DEG:g} deg on"
    claims = (
        _considerable(extreme(np.max, over_all), "over lift and closing timing"),
        *_runner_claims(charge, loss, specific, early, late, first, last),
    )
    values = _operating(data)
    template = "At {speed:.0f} and {lift:g} the runner"
    if np.isfinite(charge).any():
        low, high = int(np.nanargmin(charge)), int(np.nanargmax(charge))
        template += (
            " changes the charge by {lowest:+.1f} (closing at {lowest_at:g}) to {highest:+.1f} "
            "(closing at {highest_at:g}) and"
        )
        values |= per_cent(lowest=charge[low], highest=charge[high])
        values["lowest_at"] = Value(float(closing[low]), "deg")
        values["highest_at"] = Value(float(closing[high]), "deg")
    template += " changes the specific loss by {specific_low:+.1f} to {specific_high:+.1f}"
    values |= per_cent(
        specific_low=extreme(np.min, specific), specific_high=extreme(np.max, specific)
    )
    turn = _turn(closing, charge)
    if np.isfinite(turn):
        template += "; it raises the charge for closing later than {turn:.0f} only"
        values["turn"] = Value(turn, "deg")
    template += (
        ". Over lift (closing at {closing:.0f}) the charge changes by {lift_low:+.1f} to "
        "{lift_high:+.1f}."
    )
    over_lift = relative_change(data["charge_over_lift"]).values
    values |= per_cent(lift_low=extreme(np.min, over_lift), lift_high=extreme(np.max, over_lift))
    return claims, _caption(template, values, claims, data)


def loop_words(data: xr.Dataset) -> Told:
    """Judge and describe Figure 13."""
    charge, loss, specific = (
        relative_change(data[quantity]).values for quantity in ("charge", "loss", "specific_loss")
    )
    closing = data["closing"].values
    early, late = closing < AT_EVENT_DEG, closing >= LATE_DEG
    claims = (
        _considerable(extreme(np.max, np.abs(charge)), "over the three closing timings"),
        *_runner_claims(
            charge,
            loss,
            specific,
            early,
            late,
            f"closing at {EARLY_DEG:g} deg",
            f"closing at {LATE_DEG:g} deg",
        ),
    )
    values = {
        "speed": Value(data.attrs["speed_rpm"], "rpm"),
        "lift": Value(data.attrs["lift_mm"], "mm"),
        "common": Value(data.attrs["common_lift_mm"], "mm"),
    }
    parts = []
    for k, angle in enumerate(closing.tolist()):
        at = data.isel(closing=k)
        name = f"ivc{angle:.0f}"
        lift = float(at["delivered_lift"])
        limited = " (the most that it allows)" if lift < data.attrs["lift_mm"] else ""
        parts.append(
            f"closing at {{{name}:.0f}} with {{{name}_lift:.2f}}{limited}, charge from "
            f"{{{name}_charge_without:.1f}} to {{{name}_charge_with:.1f}} "
            f"({{{name}_charge_change:+.1f}}) and loss from {{{name}_loss_without:.2f}} to "
            f"{{{name}_loss_with:.2f}} ({{{name}_loss_change:+.1f}})"
        )
        values |= {
            name: Value(angle, "deg"),
            f"{name}_lift": Value(lift, "mm"),
            **per_cent(**{f"{name}_charge_change": charge[k], f"{name}_loss_change": loss[k]}),
        }
        for j, runner in enumerate(("without", "with")):
            values |= {
                f"{name}_charge_{runner}": Value(1e6 * float(at["charge"][j]), "mg"),
                f"{name}_loss_{runner}": Value(float(at["loss"][j]), "J"),
            }
    template = f"From without to with runner at {{speed:.0f}}: {'; '.join(parts)}."
    if data.attrs["common_lift_mm"] < data.attrs["lift_mm"]:
        change = relative_change(data["charge_at_common_lift"]).values
        template += (
            " At {common:.2f}, which all three allow, the charge changes by {common_event:+.1f} "
            "for the middle and {common_late:+.1f} for the late closing."
        )
        values |= per_cent(common_event=change[1], common_late=change[2])
    template += (
        " The loss counts to exhaust pressure or to the shut valve (dots), whichever comes later."
    )
    return claims, _caption(template, values, claims, data)


def _considerable(value: float, where: str) -> SectionSixClaim:
    return SectionSixClaim(
        "considerable",
        'runner dynamics are a "considerable uncertainty" of the charge',
        f"largest change of the charge {where}",
        value,
        SMALL_CHARGE_CHANGE,
        "at least",
        f"the bound of a small one, {_SMALL_CHARGE}",
    )


def _runner_claims(
    charge: FloatArray,
    loss: FloatArray,
    specific: FloatArray,
    early: Mask,
    late: Mask,
    first: str,
    last: str,
) -> tuple[SectionSixClaim, ...]:
    """Judge what section 6.1 says of early and late closing at high speed."""
    return (
        SectionSixClaim(
            "late-charge",
            'late closing: runner dynamics "increase the cylinder air charge"',
            f"least change of the charge, {last}",
            extreme(np.min, charge[late]),
            RESOLVED,
            "at least",
            _RESOLVED,
        ),
        SectionSixClaim(
            "late-specific-loss",
            'late closing: "no adverse effect in specific pumping losses"',
            f"largest change of the specific loss, {last}",
            extreme(np.max, specific[late]),
            SMALL_LOSS_CHANGE,
            "at most",
            _SMALL_LOSS,
        ),
        SectionSixClaim(
            "early-charge",
            'early closing: runner dynamics "reduce the cylinder air charge"',
            f"largest signed change of the charge, {first}",
            extreme(np.max, charge[early]),
            -RESOLVED,
            "at most",
            _RESOLVED,
        ),
        SectionSixClaim(
            "early-specific-loss",
            'early closing: runner dynamics "increase the pumping losses" for a gram of air',
            f"least change of the specific loss, {first}",
            extreme(np.min, specific[early]),
            RESOLVED,
            "at least",
            _RESOLVED,
        ),
        SectionSixClaim(
            "early-loss",
            'early closing: runner dynamics "increase the pumping losses" for an event',
            f"least change of the pumping loss, {first}",
            extreme(np.min, loss[early]),
            RESOLVED,
            "at least",
            _RESOLVED,
        ),
    )


def _caption(
    template: str,
    values: dict[str, Value],
    claims: tuple[SectionSixClaim, ...],
    data: xr.Dataset,
) -> Caption:
    if "reached_over_closing" in data:
        if not bool(data["reached_over_closing"].all()):
            template += " {lift:g} cannot be reached for closing before {earliest:.1f}: no points."
            values["earliest"] = Value(data.attrs["earliest_closing_deg"], "deg")
        if not bool(data["reached_over_lift"].all()):
            lifts = data["lift"].values[data["reached_over_lift"].values]
            template += " Lifts above {highest_lift:.2f} cannot be reached: no points."
            values["highest_lift"] = Value(float(lifts[-1]), "mm")
    return Caption(f"{template} {verdicts(claims)}", values)


def _operating(data: xr.Dataset) -> dict[str, Value]:
    return {
        "speed": Value(data.attrs["speed_rpm"], "rpm"),
        "lift": Value(data.attrs["lift_mm"], "mm"),
        "closing": Value(data.attrs["closing_deg"], "deg"),
    }


def _turn(closing: FloatArray, charge: FloatArray) -> float:
    """Closing timing in deg from which on the charge rises, NaN if there is none."""
    known = np.isfinite(charge)
    x, y = closing[known], charge[known]
    falls = np.flatnonzero(y <= 0.0)
    if not falls.size or falls[-1] == y.size - 1:
        return float("nan")
    k = int(falls[-1])
    return float(x[k] - y[k] * (x[k + 1] - x[k]) / (y[k + 1] - y[k]))
