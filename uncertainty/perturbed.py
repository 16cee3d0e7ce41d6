"""Full plants of a sample of an uncertainty set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, Engine, ValveCommand, replace_engine_fields
from plant._engine_fields import get_field
from plant.kinematics import FloatArray
from plant.parameters import _Replaceable
from plant.sensors import MafSensor, MapSensor

from .parameters import DURATION_OFFSET, SENSOR_TARGETS, UncertaintySet
from .sampling import Sample

if TYPE_CHECKING:
    import xarray as xr

S = TypeVar("S", bound=_Replaceable)

CYLINDER, POINT = "cylinder", "point"  # dimensions of a batch
SAMPLE = "sample"  # dimension of the samples


@dataclass(frozen=True)
class PerturbedPlants:
    """A full plant for each row of a sample.

    A valve that its slopes no longer let reach the commanded lift turns round early: the plant
    is driven as far as it can be (``on_infeasible="limit"``).

    Parameters
    ----------
    plant : CrankAnglePlant
        Nominal plant, whose options (runner, oscillation) hold for all.
    sample : Sample
        Values of the uncertain parameters.
    """

    plant: CrankAnglePlant
    sample: Sample

    def __post_init__(self) -> None:
        self.sample.uncertain.check_engine(self.plant.engine)

    def __len__(self) -> int:
        """Return the number of plants."""
        return len(self.sample)

    def fields(self) -> dict[str, FloatArray]:
        """Engine fields that vary, each (samples,)."""
        return perturbed_fields(self.plant.engine, self.sample.uncertain, self.sample.values)

    def duration_offsets(self) -> FloatArray:
        """Offset of the delivered duration, (samples, 1), or (samples, n) where valves differ."""
        return duration_offsets(
            self.sample.uncertain, self.sample.values, self.plant.engine.n_cylinders
        )

    def steady_cycles(
        self,
        speed_rpm: ArrayLike,
        lift_mm: ArrayLike,
        duration_deg: ArrayLike,
        *,
        progress: Callable[[int, int], None] | None = None,
        **options: Any,
    ) -> xr.Dataset:
        """Simulate the steady cycles of all plants at operating points.

        Parameters
        ----------
        speed_rpm, lift_mm, duration_deg : array_like (points,)
            Commanded operating points; they broadcast. Each valve is open for its offset
            longer.
        progress : callable, optional
            As for `CrankAnglePlant.steady_cycles`.
        **options
            Passed on to it.

        Returns
        -------
        xarray.Dataset
            As from it, over ``sample`` and ``point`` (and ``cylinder``).
        """
        import xarray as xr

        points = np.broadcast_arrays(*map(np.atleast_1d, (speed_rpm, lift_mm, duration_deg)))
        speed, lift, duration = (
            xr.DataArray(np.asarray(p, dtype=float), dims=POINT) for p in points
        )
        offsets = xr.DataArray(self.duration_offsets(), dims=(SAMPLE, CYLINDER))
        if offsets.sizes[CYLINDER] == 1:
            offsets = offsets.isel({CYLINDER: 0})
        delivered = duration + 6.0 * speed * offsets
        fields = {name: xr.DataArray(v, dims=SAMPLE) for name, v in self.fields().items()}
        result = self.plant.steady_cycles(
            speed,
            lift,
            delivered,
            parameters=fields,
            on_infeasible="limit",
            progress=progress,
            **options,
        )
        return result.transpose(SAMPLE, POINT, ...)

    def plant_at(self, i: int) -> CrankAnglePlant:
        """Return the plant of sample `i`."""
        fields = perturbed_fields(
            self.plant.engine, self.sample.uncertain, self.sample.values[i : i + 1]
        )
        changes = {name: float(v[0]) for name, v in fields.items()}
        if not changes:
            return self.plant
        return self.plant.with_engine(replace_engine_fields(self.plant.engine, changes))

    def commands_at(self, i: int, command: ValveCommand, speed_rpm: float) -> list[ValveCommand]:
        """Return what the valves of sample `i` deliver for a command, one for each cylinder."""
        n = self.plant.engine.n_cylinders
        offsets = duration_offsets(self.sample.uncertain, self.sample.values[i : i + 1], n)[0]
        return [
            command.replace(duration_deg=command.duration_deg + 6.0 * speed_rpm * float(offset))
            for offset in np.broadcast_to(offsets, n)
        ]

    def maf_at(self, i: int, nominal: MafSensor) -> MafSensor:
        """Return the MAF sensor of sample `i`."""
        return _sensor_at(nominal, "maf", self.sample, i)

    def map_at(self, i: int, nominal: MapSensor) -> MapSensor:
        """Return the MAP sensor of sample `i`."""
        return _sensor_at(nominal, "map", self.sample, i)


def perturbed_fields(
    engine: Engine, uncertain: UncertaintySet, values: FloatArray
) -> dict[str, FloatArray]:
    """Engine fields of samples, each (samples,).

    Where two parameters act on one field, their factors multiply, and a value given to it is
    what they multiply, whichever comes first.
    """
    fields: dict[str, FloatArray] = {}
    for parameter, column in sorted(
        zip(uncertain, values.T, strict=True), key=lambda pair: pair[0].relative
    ):
        for target in parameter.acts_on:
            if target in SENSOR_TARGETS or target.startswith(DURATION_OFFSET):
                continue
            if parameter.relative:
                fields[target] = fields.get(target, get_field(engine, target)) * column
            else:
                fields[target] = column.copy()
    return fields


def duration_offsets(uncertain: UncertaintySet, values: FloatArray, n_cylinders: int) -> FloatArray:
    """Offsets of the delivered duration in s: (samples, 1), or (samples, n) where valves differ."""
    common = np.zeros((len(values), 1))
    each = np.zeros((len(values), n_cylinders))
    differ = False
    for parameter, column in zip(uncertain, values.T, strict=True):
        for target in parameter.acts_on:
            if target == DURATION_OFFSET:
                common[:, 0] += column
            elif target.startswith(DURATION_OFFSET):
                each[:, int(target[len(DURATION_OFFSET) + 1 : -1])] += column
                differ = True
    return common + each if differ else common


def _sensor_at(nominal: S, prefix: str, sample: Sample, i: int) -> S:
    changes: dict[str, float] = {}
    for parameter, value in zip(sample.uncertain, sample.values[i], strict=True):
        for target in parameter.acts_on:
            name, _, field = target.partition(".")
            if name == prefix:
                changes[field] = float(value)
    return nominal.replace(**changes) if changes else nominal
