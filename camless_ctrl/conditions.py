"""Conditions of the true engine over the events of a closed-loop run, and the plants of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError

_UNITS = {
    "ambient_pressure": "Pa",
    "temperature": "K",
    "exhaust_pressure": "Pa",
    "flow_factor": "1",
}


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Boundary conditions and ageing of the true engine; what is None stays as the plant has it.

    Attributes
    ----------
    ambient_pressure : float or array_like (m,), optional
        Pressure before the throttle at each event, Pa.
    temperature : float or array_like (m,), optional
        Temperature of the intake air, K.
    exhaust_pressure : float or array_like (m,), optional
        Pressure in a cylinder when its intake valve opens, Pa.
    flow_factor : float or array_like (m,), optional
        Factor on the flow coefficients of all intake valves, 1.

    Raises
    ------
    ParameterError
        If a value is not a finite number above zero.
    """

    ambient_pressure: ArrayLike | None = None
    temperature: ArrayLike | None = None
    exhaust_pressure: ArrayLike | None = None
    flow_factor: ArrayLike | None = None

    def __post_init__(self) -> None:
        for name, unit in _UNITS.items():
            given = getattr(self, name)
            if given is None:
                continue
            try:
                values = np.asarray(given, dtype=float)
            except (TypeError, ValueError) as error:
                raise ParameterError(
                    f"{name} is {given!r}, but must be a number, or an array, in {unit}"
                ) from error
            bad = ~(np.isfinite(values) & (values > 0.0))
            if bad.any():
                raise ParameterError(
                    f"{name} is {values[bad].flat[0]:g} {unit}, but must be finite and above 0"
                )


class TrueEngine:
    """Plants of the conditions at each event, made when they are first needed."""

    def __init__(self, plant: CrankAnglePlant, conditions: Conditions | None, events: int) -> None:
        self._base = self._plant = plant
        self._changes = np.zeros(events, dtype=bool)
        if conditions is None:
            return
        engine = plant.engine
        own = (engine.ambient_pressure, engine.temperature, engine.exhaust_pressure, 1.0)
        self._own = own
        self._rows = np.empty((events, len(own)))
        for column, (name, value) in enumerate(zip(_UNITS, own, strict=True)):
            given = getattr(conditions, name)
            values = np.asarray(value if given is None else given, dtype=float)
            if values.ndim and values.shape != (events,):
                raise ParameterError(
                    f"{name} has shape {values.shape}, but the run has {events} events: give one "
                    f"value, or {events}"
                )
            self._rows[:, column] = values
        before = np.vstack((own, self._rows[:-1]))
        self._changes = np.any(self._rows != before, axis=1)

    def at(self, event: int) -> CrankAnglePlant:
        """Plant of an event (from 0); they are asked for in order."""
        if self._changes[event]:
            row = tuple(self._rows[event].tolist())
            if row == self._own:
                self._plant = self._base
            else:
                pressure, temperature, exhaust, flow = row
                engine = self._base.engine
                self._plant = self._base.with_engine(
                    engine.replace(
                        ambient_pressure=pressure,
                        temperature=temperature,
                        exhaust_pressure=exhaust,
                        flow_coefficient=engine.flow_coefficient * flow,
                    )
                )
        return self._plant
