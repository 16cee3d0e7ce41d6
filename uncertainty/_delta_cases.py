"""Cases of a delta from the bounds of its uncertain parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from plant import ParameterError

from .delta import Case
from .parameters import UncertainParameter, UncertaintySet
from .sampling import corners, one_at_a_time

MOST_CORNERS = 64


def single_cases(uncertain: UncertaintySet) -> tuple[Case, ...]:
    """Return each parameter at its lower, then at its upper bound, all others nominal."""
    if not len(uncertain):
        return ()
    sample = one_at_a_time(uncertain)
    return tuple(
        Case(
            f"{p.name} {end}",
            ((p, float(sample.values[2 * k + j, k])),),
            cylinder=cylinder_of(p),
        )
        for k, p in enumerate(uncertain)
        for j, end in enumerate(("low", "high"))
    )


def corner_cases(
    uncertain: UncertaintySet, prefix: str, together: Iterable[Sequence[str]] = ()
) -> tuple[Case, ...]:
    """Return the corners of a box.

    Parameters
    ----------
    uncertain : UncertaintySet
        The box; a parameter whose bounds are one is left out.
    prefix : str
        First word of the case names, left out of the parameters' names in them.
    together : iterable of sequences of str
        Parameters that are all low or all high, where the set has them.

    Raises
    ------
    ParameterError
        If there are more than 64 corners.
    """
    names = [p.name for p in uncertain if p.low < p.high]
    leaders = {name: name for name in names}
    for group in together:
        present = [name for name in names if name in group]
        leaders.update(dict.fromkeys(present, present[0] if present else ""))
    free = [name for name in names if leaders[name] == name]
    if len(names) < 2:
        return ()  # the corners are the single cases
    box = uncertain.only(free)
    found = []
    for row in corners(box, MOST_CORNERS).values:
        high = {name for name, v in zip(free, row, strict=True) if v == uncertain[name].high}
        ends = {name: leaders[name] in high for name in names}
        words = [
            f"{word} " + ", ".join(n.removeprefix(f"{prefix} ") for n in names if ends[n] is end)
            for word, end in (("low", False), ("high", True))
            if end in ends.values()
        ]
        values = tuple(
            (uncertain[n], uncertain[n].high if ends[n] else uncertain[n].low) for n in names
        )
        found.append(Case(f"{prefix}: {'; '.join(words)}", values))
    return tuple(found)


def cylinder_of(parameter: UncertainParameter) -> int | None:
    """Cylinder on which a parameter acts, from 0; None if it is common to all."""
    targets = [target for target in parameter.acts_on if target.endswith("]")]
    places = {int(target[target.index("[") + 1 : -1]) for target in targets}
    if len(places) > 1:
        raise ParameterError(
            f"{parameter.name} acts on {', '.join(targets)}: give each cylinder its own"
        )
    return places.pop() if places else None
