"""The requirements, each stated once: name, bound, unit, source.

Report, command line and tests read them from here. A requirement that is not met stays in the
table as not met.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from plant._checks import one_of

from ._controller_requirements import CONTROLLER
from ._plant_requirements import PLANT
from ._requirement import Requirement, RequirementResult, Sense
from ._robustness_requirements import ROBUSTNESS

__all__ = [
    "REQUIREMENTS",
    "Requirement",
    "RequirementResult",
    "Sense",
    "evaluate",
    "requirement",
    "table",
]

REQUIREMENTS: dict[str, Requirement] = {
    requirement.name: requirement for requirement in (*PLANT, *ROBUSTNESS, *CONTROLLER)
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
