"""Whether an engine has what an uncertainty set acts on, and can take its bounds."""

from __future__ import annotations

import numpy as np

from plant import Engine, ParameterError, engine_fields, replace_engine_fields
from plant._checks import one_of
from plant.kinematics import FloatArray

from .parameters import DURATION_OFFSET, SENSOR_TARGETS, UncertaintySet
from .perturbed import perturbed_fields


def check_engine(uncertain: UncertaintySet, engine: Engine) -> None:
    """Raise the errors of `UncertaintySet.check_engine`, which see."""
    offsets = (DURATION_OFFSET, *(f"{DURATION_OFFSET}[{i}]" for i in range(engine.n_cylinders)))
    known = (*engine_fields(engine), *offsets, *SENSOR_TARGETS)
    for parameter in uncertain:
        for target in parameter.acts_on:
            one_of(f"target of {parameter.name}", target, known)
    _try(uncertain, engine, uncertain.nominal)
    for k, parameter in enumerate(uncertain):
        for bound in (parameter.low, parameter.high):
            values = uncertain.nominal
            values[k] = bound
            try:
                _try(uncertain, engine, values)
            except ParameterError as error:
                raise ParameterError(
                    f"{parameter.name} at its bound {bound:g} is impossible for the engine "
                    f"({error}): narrow its bounds"
                ) from None
    _try(uncertain, engine, uncertain.low)  # factors on one field multiply
    _try(uncertain, engine, uncertain.high)


def _try(uncertain: UncertaintySet, engine: Engine, values: FloatArray) -> None:
    fields = perturbed_fields(engine, uncertain, values[np.newaxis])
    replace_engine_fields(engine, {name: float(v[0]) for name, v in fields.items()})
