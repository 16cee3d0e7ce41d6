"""The requirements, each stated once: name, bound, unit, source.

Report, command line and tests read them from here. A requirement that is not met stays in the
table as not met.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from plant._checks import in_range, one_of
from plant.errors import ParameterError

Sense = Literal["at most", "at least"]


@dataclass(frozen=True, slots=True)
class Requirement:
    """A bound on one figure.

    Parameters
    ----------
    name : str
        Short name, unique.
    bound : float
        The bound, in `unit`.
    unit : str
        Unit of bound and value.
    sense : {"at most", "at least"}
        Which side of the bound is allowed.
    source : str
        Who asks for it.
    description : str
        What is measured, and how.
    """

    name: str
    bound: float
    unit: str
    sense: Sense
    source: str
    description: str

    def __post_init__(self) -> None:
        if not self.name or not self.description or not self.source:
            raise ParameterError(
                f"requirement {self.name!r} lacks a name, source or description: give all three"
            )
        in_range("bound", self.bound, -1e12, 1e12, self.unit)
        one_of("sense", self.sense, ("at most", "at least"))

    def __str__(self) -> str:
        """Return name, sense and bound."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {self.sense} {self.bound:g}{unit}"


@dataclass(frozen=True, slots=True)
class RequirementResult:
    """A requirement and the figure that was found; NaN is never enough.

    Attributes
    ----------
    requirement : Requirement
        The requirement.
    value : float
        What was found, in its unit.
    note : str
        Remark for the table.
    """

    requirement: Requirement
    value: float
    note: str = ""

    @property
    def margin(self) -> float:
        """Distance to the bound, in its unit; negative if not met."""
        sign = 1.0 if self.requirement.sense == "at least" else -1.0
        return sign * (self.value - self.requirement.bound)

    @property
    def met(self) -> bool:
        """Whether the value is on the allowed side of the bound, or on it."""
        return bool(self.margin >= 0.0)

    def __str__(self) -> str:
        """Return requirement, value and verdict in one line."""
        unit = "" if self.requirement.unit == "1" else f" {self.requirement.unit}"
        value = "none" if math.isnan(self.value) else f"{self.value:.4g}{unit}"
        text = f"{self.requirement}: {value}, {'met' if self.met else 'NOT MET'}"
        return f"{text} ({self.note})" if self.note else text


_PAPER = "Part I, published figures"
_DESIGN = "project"

REQUIREMENTS: dict[str, Requirement] = {
    requirement.name: requirement
    for requirement in (
        Requirement(
            "published-worst",
            2.0,
            "%",
            "at most",
            _PAPER,
            "largest relative error of the nine published model figures",
        ),
        Requirement(
            "published-rms",
            0.7,
            "%",
            "at most",
            _PAPER,
            "rms of the relative errors of the nine published model figures",
        ),
        Requirement(
            "published-claims",
            0.0,
            "claims",
            "at most",
            _PAPER,
            "published claims that are not reproduced, without a stated reason in the model",
        ),
        Requirement(
            "map-charge-rms",
            0.3,
            "%",
            "at most",
            _DESIGN,
            "rms error of the charge map between its nodes, of the largest charge at that speed",
        ),
        Requirement(
            "map-charge-worst",
            1.5,
            "%",
            "at most",
            _DESIGN,
            "largest error of the charge map between its nodes, of the largest charge at that "
            "speed",
        ),
        Requirement(
            "map-loss-rms",
            0.5,
            "%",
            "at most",
            _DESIGN,
            "rms error of the pumping-loss map between its nodes, of the largest loss at that "
            "speed",
        ),
        Requirement(
            "map-loss-worst",
            3.0,
            "%",
            "at most",
            _DESIGN,
            "largest error of the pumping-loss map between its nodes, of the largest loss at "
            "that speed",
        ),
        Requirement(
            "map-boundary-charge-rms",
            0.5,
            "%",
            "at most",
            _DESIGN,
            "rms error of the charge map over ambient pressure 0.7 to 1.05 bar, 250 to 330 K and "
            "exhaust pressure 1.0 to 1.3 bar, of the largest charge at that speed",
        ),
        Requirement(
            "throttle-step",
            2.0,
            "%",
            "at most",
            _DESIGN,
            "largest rms error of the throttled mean-value plant's manifold pressure after a "
            "throttle step, against the full plant with the conventional cam",
        ),
        Requirement(
            "uncertainty-weights",
            1.0,
            "1",
            "at least",
            _DESIGN,
            "smallest ratio of a weight, before its factor for coverage, to the largest residual "
            "of the design sample of full plants, over all channels, at phases that the fit has "
            "not seen",
        ),
        Requirement(
            "uncertainty-coverage",
            0.01,
            "1",
            "at least",
            _DESIGN,
            "probability of as few of the fresh full plants inside the weights as were found, if "
            "the claimed share were covered",
        ),
        Requirement(
            "loop-spectral-radius",
            0.999,
            "1",
            "at most",
            _DESIGN,
            "largest closed-loop pole radius per cycle of any adapted mode at any speed, plant "
            "and sensors nominal",
        ),
        Requirement(
            "loop-worst-spectral-radius",
            0.999,
            "1",
            "at most",
            _DESIGN,
            "largest closed-loop pole radius per cycle of any adapted mode at any speed, over the "
            "corners of the set with remainders of either sign (for the loop of event windows: MAF "
            "lag 10 to 20 ms, delay 0 to 3 ms and the bound on gain error)",
        ),
        Requirement(
            "loop-gain-margin",
            2.0,
            "1",
            "at least",
            _DESIGN,
            "smallest gain margin (ratio) of any mode at any speed, plant and sensors nominal",
        ),
        Requirement(
            "loop-disk-margin",
            0.67,
            "1",
            "at least",
            _DESIGN,
            "smallest balanced disk margin of any mode at any speed (gain a factor 2, phase 37 "
            "deg), plant and sensors nominal",
        ),
        Requirement(
            "loop-small-gain",
            1.0,
            "1",
            "at most",
            _DESIGN,
            "largest |w T| of any mode at any speed, w the size of the whole set as one complex "
            "number (for the loop of event windows: the bound on the relative gain error)",
        ),
        Requirement(
            "loop-robust-performance",
            1.0,
            "1",
            "at most",
            _DESIGN,
            "largest structured singular value for robust performance at any speed: no error is "
            "amplified more than twice anywhere in the linear description of the set, proved at "
            "all frequencies",
        ),
        Requirement(
            "loop-sound",
            0.0,
            "cases",
            "at most",
            _DESIGN,
            "linear members and full plants in closed loop, sampled from the set, that are "
            "unstable or amplify an error more than was proved, at the speeds at which robust "
            "performance was proved",
        ),
        Requirement(
            "loop-tight",
            1.0,
            "1",
            "at most",
            _DESIGN,
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
            _DESIGN,
            "smallest probability, of all speeds, of as few fresh full plants inside the "
            "description of the loop as were found, if the claimed share were covered",
        ),
        Requirement(
            "feedforward-loss",
            1.0,
            "%",
            "at most",
            _DESIGN,
            "pumping loss of the optimal path on the full plant above the best of a direct search "
            "at the same charge, at 50 random demands and speeds",
        ),
        Requirement(
            "estimate-cylinder",
            1.0,
            "%",
            "at most",
            _DESIGN,
            "largest mean error of a cylinder's estimated charge against the full plant, 750 to "
            "6000 rpm and 3, 4, 6 cylinders, one of them 15 % weak; gain error of the sensor apart",
        ),
        Requirement(
            "estimate-honest",
            1.1,
            "1",
            "at most",
            _DESIGN,
            "spread of the estimation error over the standard deviation that the filter tells",
        ),
        Requirement(
            "estimate-innovation",
            0.25,
            "1",
            "at most",
            _DESIGN,
            "distance of the mean normalised innovation on the full plant from 1",
        ),
        Requirement(
            "controller-bars",
            0.0,
            "1",
            "at most",
            _DESIGN,
            "figures of the performance table that the adaptive controller misses in a seed; "
            "those of single events count where the valves do not jitter",
        ),
        Requirement(
            "cylinder-error",
            1.0,
            "%",
            "at most",
            _DESIGN,
            "largest charge error of a cylinder in the load step with one weak cylinder at 1500 "
            "rpm, averaged from 10 cycles after each step on and over the seeds",
        ),
        Requirement(
            "imbalance",
            0.5,
            "%",
            "at most",
            _DESIGN,
            "(max - min)/mean of the cylinders' charges in the load step with one weak cylinder at "
            "1500 rpm, averaged from 10 cycles after each step on and over the seeds",
        ),
        Requirement(
            "command-lift-lowest",
            0.5,
            "mm",
            "at least",
            _DESIGN,
            "lowest lift commanded in the load step",
        ),
        Requirement(
            "command-lift-highest",
            8.0,
            "mm",
            "at most",
            _DESIGN,
            "highest lift commanded in the load step",
        ),
    )
}


def requirement(name: str) -> Requirement:
    """Return a stated requirement by its name.

    Raises
    ------
    ParameterError
        If there is none of that name.
    """
    return REQUIREMENTS[one_of("requirement", name, REQUIREMENTS)]


def evaluate(which: Requirement | str, value: float, note: str = "") -> RequirementResult:
    """Hold a figure against a requirement, given by itself or by name.

    Parameters
    ----------
    which : Requirement or str
        The requirement.
    value : float
        The figure, in the requirement's unit; NaN if there is none, which meets nothing.
    note : str
        Remark for the table.
    """
    return RequirementResult(
        requirement(which) if isinstance(which, str) else which, float(value), note
    )


def table(results: Iterable[RequirementResult]) -> str:
    """Return the results as text, a line each, and how many are met."""
    rows = list(results)
    width = max((len(row.requirement.name) for row in rows), default=0)
    lines = []
    for row in rows:
        r = row.requirement
        unit = "" if r.unit == "1" else f" {r.unit}"
        value = "none" if math.isnan(row.value) else f"{row.value:.4g}{unit}"
        lines.append(
            f"{r.name:<{width}}  {r.sense} {r.bound:g}{unit:<4} {value:>12}  "
            f"{'met' if row.met else 'NOT MET'}{f'  ({row.note})' if row.note else ''}"
        )
    met = sum(row.met for row in rows)
    return "\n".join([*lines, f"{met} of {len(rows)} met"])
