"""Parameters that are learnt of each cylinder: what explains a charge other than the model's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from plant._checks import replace_fields, whole
from plant.errors import ParameterError
from plant.kinematics import FloatArray

FIELDS = ("flow_gain", "duration_offset", "charge_factor")
_UNITS = ("1", "s", "1")
_NOMINAL = (1.0, 0.0, 1.0)


class CylinderParameters(NamedTuple):
    """Parameters of one cylinder."""

    flow_gain: float = 1.0  # true over nominal flow coefficient of the valve, 1
    duration_offset: float = 0.0  # delivered less commanded duration, s
    charge_factor: float = 1.0  # charge over that which the other two explain, 1


@dataclass(frozen=True, slots=True, eq=False)
class ParameterSet:
    """Parameters of all cylinders, each an array (n,); immutable.

    Attributes
    ----------
    flow_gain : ndarray (n,)
        True over nominal flow coefficient of the valve, 1.
    duration_offset : ndarray (n,)
        Delivered less commanded duration, s.
    charge_factor : ndarray (n,)
        Charge over that which the other two explain, 1.

    Raises
    ------
    ParameterError
        For arrays of different lengths, values that are not finite, and gains or factors that
        are not positive.
    """

    flow_gain: FloatArray
    duration_offset: FloatArray
    charge_factor: FloatArray

    def __post_init__(self) -> None:
        n = np.size(self.flow_gain)
        for name, unit, nominal in zip(FIELDS, _UNITS, _NOMINAL, strict=True):
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != (n,) or n == 0:
                raise ParameterError(
                    f"{name} has shape {values.shape}, but flow_gain has {n} values: give one of "
                    "each for every cylinder"
                )
            if not np.all(np.isfinite(values)) or (nominal == 1.0 and np.any(values <= 0.0)):
                bound = "finite and above 0" if nominal == 1.0 else "finite"
                raise ParameterError(
                    f"{name} is {values.tolist()} {unit}, but must be {bound}: start from "
                    "ParameterSet.nominal"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    @classmethod
    def nominal(cls, n_cylinders: int) -> Self:
        """Return the parameters of the engine that the model describes."""
        n = whole("n_cylinders", n_cylinders, 1, 24)
        return cls(*(np.full(n, value) for value in _NOMINAL))

    @property
    def n_cylinders(self) -> int:
        """Number of cylinders."""
        return int(self.flow_gain.size)

    def of(self, cylinder: int) -> CylinderParameters:
        """Parameters of a cylinder (from 1)."""
        i = cylinder - 1
        return CylinderParameters(
            float(self.flow_gain[i]),
            float(self.duration_offset[i]),
            float(self.charge_factor[i]),
        )

    def replace(self, **changes: ArrayLike) -> Self:
        """Return a copy with the given arrays changed."""
        return replace_fields(self, changes)

    def permuted(self, order: Sequence[int]) -> Self:
        """Return the parameters with cylinder ``order[i]`` (from 1) in the place of ``i + 1``."""
        index = np.asarray(order) - 1
        return type(self)(*(getattr(self, name)[index] for name in FIELDS))

    def to_dict(self) -> dict[str, list[float]]:
        """Return plain lists, for JSON."""
        return {name: getattr(self, name).tolist() for name in FIELDS}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the parameters of `to_dict`; raises `ParameterError` for missing names."""
        missing = [name for name in FIELDS if name not in data]
        if missing:
            raise ParameterError(
                f"the parameters lack {', '.join(missing)}: export them with to_dict"
            )
        return cls(*(np.asarray(data[name], dtype=float) for name in FIELDS))

    def __str__(self) -> str:
        """Return one line a cylinder."""
        return "\n".join(
            f"cylinder {i + 1}: flow gain {g:.4f}, duration offset {1e3 * d:+.3f} ms, charge "
            f"factor {f:.4f}"
            for i, (g, d, f) in enumerate(
                zip(self.flow_gain, self.duration_offset, self.charge_factor, strict=True)
            )
        )
