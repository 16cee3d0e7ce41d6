"""Statements of section 6.2 judged on the data of Figure 14, and its caption."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant._claims import RESOLVED
from plant._claims_dynamics import HARDLY_ANY_CHANGE

from ._section_six_words import Caption, SectionSixClaim, Value, extreme, per_cent, verdicts
from .section_six_result import relative_change

if TYPE_CHECKING:
    import xarray as xr

VISIBLE = 0.01  # 1, width of a 1 pt line in a panel of 100 pt
HALF_OF_THE_SPEEDS = 0.5


def motion_words(data: xr.Dataset) -> tuple[tuple[SectionSixClaim, ...], Caption]:
    """Judge and describe Figure 14."""
    speed = data["speed"].values
    changes = {
        quantity: np.abs(relative_change(data[quantity]).values)
        for quantity in ("charge", "loss", "specific_loss")
    }
    both = np.maximum(changes["charge"], changes["loss"])
    slow = speed <= (speed[0] + speed[-1]) / 2.0
    driven = np.isfinite(both)
    coincide = float(np.mean(both[driven] <= VISIBLE))
    slow_worst, fast_worst = extreme(np.max, both[slow]), extreme(np.max, both[~slow])
    claims = (
        *(
            SectionSixClaim(
                f"neglect-{quantity}",
                f'"the distortion can be neglected" for the {name}',
                "largest change over speed",
                extreme(np.max, changes[quantity]),
                HARDLY_ANY_CHANGE,
                "at most",
                "the bar at which a published figure counts as reproduced",
            )
            for quantity, name in (("charge", "air charge"), ("loss", "pumping loss"))
        ),
        SectionSixClaim(
            "coincide",
            'charge and loss "coincide for most of the speed range"',
            f"share of the speeds at which both change by at most {100.0 * VISIBLE:g} %, the width "
            "of a drawn line",
            coincide,
            HALF_OF_THE_SPEEDS,
            "at least",
            "most is more than half",
        ),
        SectionSixClaim(
            "deviates-when-fast",
            'the behaviour "deviates a little for higher engine speeds"',
            "largest change in the faster half of the speeds, less that in the slower half",
            fast_worst - slow_worst,
            RESOLVED,
            "at least",
            "what the accuracy of the plant can tell from none",
        ),
    )
    resolved = driven & (both > RESOLVED)
    values = {
        "lift": Value(data.attrs["lift_mm"], "mm"),
        "closing": Value(data.attrs["closing_deg"], "deg"),
        "low": Value(float(speed[0]), "rpm"),
        "high": Value(float(speed[-1]), "rpm"),
    }
    sentences = []
    for quantity, name in (
        ("charge", "the charge"),
        ("loss", "the pumping loss"),
        ("specific_loss", "the specific loss"),
    ):
        signed = relative_change(data[quantity]).values
        if not np.isfinite(signed).any():
            continue
        worst = int(np.nanargmax(np.abs(signed)))
        sentences.append(f"{name} by up to {{{quantity}:+.2f}} (at {{{quantity}_at:.0f}})")
        values |= per_cent(**{quantity: signed[worst]})
        values[f"{quantity}_at"] = Value(float(speed[worst]), "rpm")
    template = (
        "At {lift:g} and closing at {closing:.0f}, from {low:.0f} to {high:.0f}, the oscillation "
        f"of the valve changes {', '.join(sentences)}."
    )
    if resolved.any() and not resolved[driven][0]:
        template += " Up to {same_to:.0f} charge and loss are the same within {same:.1f}."
        first = int(np.argmax(resolved))
        values["same_to"] = Value(float(speed[:first][driven[:first]][-1]), "rpm")
        values |= per_cent(same=RESOLVED)
    if not driven.all():
        template += " Above {last:.0f} the lift cannot be reached: no points."
        values["last"] = Value(float(speed[driven][-1]), "rpm")
    return claims, Caption(f"{template} {verdicts(claims)}", values)
