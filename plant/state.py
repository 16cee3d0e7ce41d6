"""State of the crank-angle plant between two events: kept, copied, saved and restored."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from ._files import replaced
from ._layout import CAM, CYLINDER_COLUMNS, MANIFOLD_ENTRIES, PHASE
from .errors import ParameterError
from .kinematics import FloatArray
from .parameters import Engine

_FORMAT = "camless-ctrl plant state 1"


def fingerprint(engine: Engine, **options: Any) -> str:
    """Short hash that tells engines and plant options apart."""
    text = json.dumps({"engine": asdict(engine), **options}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class PlantState:
    """State at the start of an event window; immutable.

    Attributes
    ----------
    event_index : int
        Number of events since the start; cylinder ``event_index % n`` opens next.
    event_advance_deg : float
        Crank angle by which an event window starts before its cylinder's TDC.
    time : float
        Time since the start, s.
    cylinders : ndarray (n, columns)
        One row a cylinder: valve motion, mass, runner, work and last results.
    manifold : ndarray
        Air mass (kg), throttle flow integrated since the start (kg), throttle flow (kg/s).
    plant : str
        Fingerprint of the plant that it belongs to.
    """

    event_index: int
    event_advance_deg: float
    time: float
    cylinders: FloatArray
    manifold: FloatArray
    plant: str

    def __post_init__(self) -> None:
        for name in ("cylinders", "manifold"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        fault = _fault(self.cylinders, self.manifold)
        if fault:
            raise ParameterError(f"the plant state {fault}")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state to a JSON file, exactly; the file appears whole or not at all."""
        content = {
            "format": _FORMAT,
            "plant": self.plant,
            "event_index": self.event_index,
            "event_advance_deg": self.event_advance_deg,
            "time": self.time,
            "cylinders": self.cylinders.tolist(),
            "manifold": self.manifold.tolist(),
        }
        write_text(Path(path), json.dumps(content, indent=1))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a state that `save` wrote.

        Raises
        ------
        ParameterError
            If the file is not a plant state.
        OSError
            If it cannot be read.
        """
        text = Path(path).read_text(encoding="utf-8")
        try:
            content = json.loads(text)
            if content["format"] != _FORMAT:
                raise ParameterError(f"{path} has format {content['format']!r}, not {_FORMAT!r}")
            state = cls(
                event_index=int(content["event_index"]),
                event_advance_deg=float(content["event_advance_deg"]),
                time=float(content["time"]),
                cylinders=np.array(content["cylinders"], dtype=float),
                manifold=np.array(content["manifold"], dtype=float),
                plant=str(content["plant"]),
            )
        except ParameterError as error:
            raise ParameterError(f"{path}: {error}") from error
        except (KeyError, TypeError, ValueError) as error:
            raise ParameterError(f"{path} is not a plant state: {error!r}") from error
        return state


def _fault(cylinders: FloatArray, manifold: FloatArray) -> str:
    """Say what makes tables unfit for the kernel, which relies on them; empty if nothing does."""
    if cylinders.ndim != 2 or cylinders.shape[1] != CYLINDER_COLUMNS or not len(cylinders):
        return (
            f"holds a cylinder table of shape {cylinders.shape}, but must hold "
            f"(n, {CYLINDER_COLUMNS}): save the state again with this version"
        )
    if manifold.shape != (MANIFOLD_ENTRIES,):
        return (
            f"holds a manifold vector of shape {manifold.shape}, but must hold "
            f"({MANIFOLD_ENTRIES},): save the state again with this version"
        )
    if not (np.all(np.isfinite(cylinders)) and np.all(np.isfinite(manifold))):
        return "holds numbers that are not finite: it is damaged, save the state again"
    phases = cylinders[:, PHASE]
    if not np.all((phases >= 0.0) & (phases <= CAM) & (phases == np.floor(phases))):
        return (
            f"holds valve phases {phases.tolist()}, but they must be whole and from 0 to {CAM}: "
            "it is damaged, save the state again"
        )
    return ""


def write_text(path: Path, text: str) -> None:
    """Write a text file through a temporary file beside it, so that it is never half there."""
    with replaced(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
