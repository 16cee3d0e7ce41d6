"""Requirements on the plant models: published figures, maps, throttle."""

from __future__ import annotations

from ._requirement import PAPER, PROJECT, Requirement

PLANT: tuple[Requirement, ...] = (
    Requirement(
        "published-worst",
        2.0,
        "%",
        "at most",
        PAPER,
        "largest relative error of the nine published model figures",
    ),
    Requirement(
        "published-rms",
        0.7,
        "%",
        "at most",
        PAPER,
        "rms of the relative errors of the nine published model figures",
    ),
    Requirement(
        "published-claims",
        0.0,
        "claims",
        "at most",
        PAPER,
        "published claims that are not reproduced, without a stated reason in the model",
    ),
    Requirement(
        "map-charge-rms",
        0.3,
        "%",
        "at most",
        PROJECT,
        "rms error of the charge map between its nodes, of the largest charge at that speed",
    ),
    Requirement(
        "map-charge-worst",
        1.5,
        "%",
        "at most",
        PROJECT,
        "largest error of the charge map between its nodes, of the largest charge at that speed",
    ),
    Requirement(
        "map-loss-rms",
        0.5,
        "%",
        "at most",
        PROJECT,
        "rms error of the pumping-loss map between its nodes, of the largest loss at that speed",
    ),
    Requirement(
        "map-loss-worst",
        3.0,
        "%",
        "at most",
        PROJECT,
        "largest error of the pumping-loss map between its nodes, of the largest loss at "
        "that speed",
    ),
    Requirement(
        "map-boundary-charge-rms",
        0.5,
        "%",
        "at most",
        PROJECT,
        "rms error of the charge map over ambient pressure 0.7 to 1.05 bar, 250 to 330 K and "
        "exhaust pressure 1.0 to 1.3 bar, of the largest charge at that speed",
    ),
    Requirement(
        "throttle-step",
        2.0,
        "%",
        "at most",
        PROJECT,
        "largest rms error of the throttled mean-value plant's manifold pressure after a "
        "throttle step, against the full plant with the conventional cam",
    ),
)
