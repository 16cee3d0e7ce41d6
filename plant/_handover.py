"""A plant's state handed on to a plant whose boundary conditions or flow coefficients differ."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from ._layout import MANIFOLD_MASS
from .boundary import NAMES
from .errors import ParameterError
from .state import PlantState

if TYPE_CHECKING:
    from .crank_angle import CrankAnglePlant

CHANGEABLE = (*NAMES, "flow_coefficient", "cylinder_flow_factors")
_OPTIONS = ("runner", "oscillation", "profile", "orifice", "resolution")


def handed_on(state: PlantState, old: CrankAnglePlant, new: CrankAnglePlant) -> PlantState:
    """Return the state of one plant as that of another.

    The manifold keeps its pressure: its mass follows the temperature. The cylinders keep all.

    Raises
    ------
    ParameterError
        If the plants differ in more than `CHANGEABLE`.
    """
    if new.fingerprint == old.fingerprint:
        return state
    for name in _OPTIONS:
        was, becomes = getattr(old, name), getattr(new, name)
        if was != becomes:
            raise ParameterError(
                f"{name} is {becomes!r} in the plant to go on with, but {was!r} in the run: use "
                "the run's plant.with_engine(...)"
            )
    for field in dataclasses.fields(old.engine):
        was, becomes = getattr(old.engine, field.name), getattr(new.engine, field.name)
        if field.name not in CHANGEABLE and was != becomes:
            raise ParameterError(
                f"{field.name} is {becomes} in the plant to go on with, but {was} in the run: a "
                f"run can only change {', '.join(CHANGEABLE)}"
            )
    manifold = state.manifold.copy()
    manifold[MANIFOLD_MASS] *= old.engine.temperature / new.engine.temperature
    return dataclasses.replace(state, manifold=manifold, plant=new.fingerprint)
