"""Requirements on the uncertainty and on the robustness of the analysed loop."""

from __future__ import annotations

from ._requirement import PROJECT, Requirement

ROBUSTNESS: tuple[Requirement, ...] = (
    Requirement(
        "uncertainty-weights",
        1.0,
        "1",
        "at least",
        PROJECT,
        "smallest ratio of a weight, before its factor for coverage, to the largest residual "
        "of the design sample of full plants, over all channels, at phases that the fit has "
        "not seen",
    ),
    Requirement(
        "uncertainty-coverage",
        0.01,
        "1",
        "at least",
        PROJECT,
        "probability of as few of the fresh full plants inside the weights as were found, if "
        "the claimed share were covered",
    ),
    Requirement(
        "loop-spectral-radius",
        0.999,
        "1",
        "at most",
        PROJECT,
        "largest closed-loop pole radius per cycle of any adapted mode at any speed, plant "
        "and sensors nominal",
    ),
    Requirement(
        "loop-worst-spectral-radius",
        0.999,
        "1",
        "at most",
        PROJECT,
        "largest closed-loop pole radius per cycle of any adapted mode at any speed, over the "
        "corners of the set with remainders of either sign (for the loop of event windows: MAF "
        "lag 10 to 20 ms, delay 0 to 3 ms and the bound on gain error)",
    ),
    Requirement(
        "loop-gain-margin",
        2.0,
        "1",
        "at least",
        PROJECT,
        "smallest gain margin (ratio) of any mode at any speed, plant and sensors nominal",
    ),
    Requirement(
        "loop-disk-margin",
        0.67,
        "1",
        "at least",
        PROJECT,
        "smallest balanced disk margin of any mode at any speed (gain a factor 2, phase 37 "
        "deg), plant and sensors nominal",
    ),
    Requirement(
        "loop-small-gain",
        1.0,
        "1",
        "at most",
        PROJECT,
        "largest |w T| of any mode at any speed, w the size of the whole set as one complex "
        "number (for the loop of event windows: the bound on the relative gain error)",
    ),
    Requirement(
        "loop-robust-performance",
        1.0,
        "1",
        "at most",
        PROJECT,
        "largest structured singular value for robust performance at any speed: no error is "
        "amplified more than twice anywhere in the linear description of the set, proved at "
        "all frequencies",
    ),
    Requirement(
        "loop-sound",
        0.0,
        "cases",
        "at most",
        PROJECT,
        "linear members and full plants in closed loop, sampled from the set, that are "
        "unstable or amplify an error more than was proved, at the speeds at which robust "
        "performance was proved",
    ),
    Requirement(
        "loop-tight",
        1.0,
        "1",
        "at most",
        PROJECT,
        "largest deviation of the break of the full plant from the predicted one, over the "
        "allowed one, at every speed: by raised gains (10 % allowed); for the loop of event "
        "windows along the worst direction, with gains raised until the break is in reach "
        "(25 %), at the speeds at which all modes are adapted",
    ),
    Requirement(
        "loop-coverage",
        0.01,
        "1",
        "at least",
        PROJECT,
        "smallest probability, of all speeds, of as few fresh full plants inside the "
        "description of the loop as were found, if the claimed share were covered",
    ),
)
