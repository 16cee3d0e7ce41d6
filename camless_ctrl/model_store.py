"""Designs that are kept on disk: maps, optimal motions and charge model are made once.

Making a design takes half a minute, reading it a second. A kept design is known by what it was
made from: engine and plant, options, range of speed, and the source code that makes the tables.
The estimator and the law are no tables, and are made anew each time.
"""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from plant import CrankAnglePlant, Engine, MeanValuePlant, ParameterError
from plant._checks import in_range
from plant._map_grid import SPEED_RANGE_RPM, as_range
from plant.sensors import SensorSet

from ._design_file import Tables, read, write
from ._design_key import SOURCES, design_folder, design_key, source_digest
from .charge_model import ChargeModel
from .controller_design import ControllerDesign, Progress, _of, design_controller
from .controller_parts import Adaptation
from .least_loss_motion import FeedforwardOptions
from .optimal_path import OptimalPath

__all__ = ["load_design", "save_design", "stored_design"]

_KEPT = 32  # designs in the folder; the one that was used longest ago goes first
_PATTERN = "design-{key}.nc"
_ENDS_RPM = 1e-6  # by which a range may miss the whole one

# Nodes of a coarse design: those of the whole range would be 32 speeds of the path instead of 51,
# and 94 of the model instead of 113.
_TOLERANCE, _MOST_POINTS = 0.02, 2000  # of the maps
_PATH_STEP, _PATH_NODES = 0.067, 17  # step of the ln of speed; positions
_MODEL_STEP, _MODEL_NODES = 1.3e-5, 41  # step of 1/speed, 1/rpm; positions
_LEAST_SPEEDS = (5, 9)  # of path and model


def stored_design(
    engine: Engine | None = None,
    *,
    sensors: SensorSet | None = None,
    speed_range_rpm: tuple[float, float] | None = None,
    adaptation: Adaptation | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> ControllerDesign:
    """Return the controller's design of an engine, from disk if it was made before.

    A file that is damaged or holds something else is not read: the design is made anew and
    replaces it. That, and a folder that cannot be written, is no error and no warning; `progress`
    is told.

    Parameters
    ----------
    engine : Engine, optional
        The engine as it is known; the paper's by default. Its cylinders are equal.
    sensors : SensorSet, optional
        Sensors that the estimator assumes; the default ones if not given.
    speed_range_rpm : (float, float), optional
        Lowest and highest speed of the tables, rpm. A range makes a coarser design, quicker to
        make. The whole range, on the grids of `design_controller`, by default.
    adaptation : Adaptation, optional
        Law; `path_adaptation` by default.
    folder : path-like, optional
        Where designs are kept; made if need be. By default the folder that the environment
        variable ``CAMLESS_CACHE`` names, else ``camless-ctrl`` in the user's cache folder
        (``XDG_CACHE_HOME``, or ``~/.cache``); ``CAMLESS_CACHE=off`` keeps nothing.
    progress : callable, optional
        Called with what is being made, the number of parts done and the number in all.

    Raises
    ------
    ParameterError
        For an engine with unequal cylinders, or a range of speed that is empty or leaves the
        one of the maps.
    """
    base = Engine.paper() if engine is None else engine
    _require_equal(base)
    grid = None if speed_range_rpm is None else _Grid.over(speed_range_rpm)
    plant = CrankAnglePlant(base, runner=True, oscillation=True)
    key = design_key(plant, FeedforwardOptions(), None if grid is None else grid._asdict())
    place = design_folder() if folder is None else Path(folder)
    file = None if place is None else place / _PATTERN.format(key=key)
    found = None if file is None else _found(file, key, progress)
    if found is not None:
        return design_controller(
            base, path=found.path, model=found.model, sensors=sensors, adaptation=adaptation
        )
    path = None if grid is None else _coarse_path(plant, grid, progress)
    model = None if grid is None or path is None else _coarse_model(path, plant, grid, progress)
    design = design_controller(
        base, path=path, model=model, sensors=sensors, adaptation=adaptation, progress=progress
    )
    if file is not None:
        _keep(design, file, key, progress)
    return design


def save_design(design: ControllerDesign, path: str | os.PathLike[str]) -> None:
    """Write the tables of a design to a file, which appears whole or not at all.

    Parameters
    ----------
    design : ControllerDesign
        The design. Its estimator, limits and law are not kept.
    path : path-like
        The file, netCDF.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    write(Tables(design.maps, design.path, design.model), path, design.model.plant_fingerprint)


def load_design(
    path: str | os.PathLike[str],
    engine: Engine | None = None,
    *,
    sensors: SensorSet | None = None,
    adaptation: Adaptation | None = None,
) -> ControllerDesign:
    """Read a design that `save_design` wrote.

    Parameters
    ----------
    path : path-like
        The file.
    engine : Engine, optional
        Engine that it must belong to; whatever the file says by default.
    sensors : SensorSet, optional
        Sensors that the estimator assumes; the default ones if not given.
    adaptation : Adaptation, optional
        Law; `path_adaptation` by default.

    Raises
    ------
    ParameterError
        If the file is damaged, holds no design, or the design of another engine.
    OSError
        If it cannot be read.
    """
    tables = read(path)
    base = tables.maps.engine if engine is None else engine
    plant = CrankAnglePlant(base, runner=True, oscillation=True)
    if tables.model.plant_fingerprint != plant.fingerprint:
        raise ParameterError(
            f"{path} holds the design of the full plant {tables.model.plant_fingerprint}, but the "
            f"engine's is {plant.fingerprint}: make a design for this engine, or load it with the "
            "engine that it belongs to"
        )
    return design_controller(
        base, path=tables.path, model=tables.model, sensors=sensors, adaptation=adaptation
    )


class _Grid(NamedTuple):
    """Range and nodes of a coarse design; it is part of the key."""

    low_rpm: float
    high_rpm: float
    path_speeds: int
    model_speeds: int
    tolerance: float = _TOLERANCE
    most_points: int = _MOST_POINTS
    path_nodes: int = _PATH_NODES
    model_nodes: int = _MODEL_NODES

    @classmethod
    def over(cls, speed_range_rpm: tuple[float, float]) -> _Grid | None:
        """Nodes for a range, or None for the whole one."""
        low, high = as_range("speed_range_rpm", speed_range_rpm, "rpm")
        for k, (end, lowest) in enumerate(((low, SPEED_RANGE_RPM[0]), (high, low))):
            in_range(
                f"speed_range_rpm[{k}]",
                end,
                lowest,
                SPEED_RANGE_RPM[1],
                "rpm",
                open_low=k == 1,
                remedy="the maps end there, and a range is not empty",
            )
        whole = np.abs(np.subtract((low, high), SPEED_RANGE_RPM)) < _ENDS_RPM
        if whole.all():
            return None
        path_speeds = math.ceil(math.log(high / low) / _PATH_STEP) + 1
        model_speeds = math.ceil((1.0 / low - 1.0 / high) / _MODEL_STEP) + 1
        least = _LEAST_SPEEDS
        return cls(low, high, max(path_speeds, least[0]), max(model_speeds, least[1]))


def _require_equal(engine: Engine) -> None:
    """Refuse unequal cylinders before any work, as `design_controller` does after it."""
    if len(set(engine.cylinder_flow_factors)) > 1:
        raise ParameterError(
            f"cylinder_flow_factors are {engine.cylinder_flow_factors}, but a design starts from "
            "equal cylinders: leave them out"
        )


def _coarse_path(plant: CrankAnglePlant, grid: _Grid, progress: Progress | None) -> OptimalPath:
    maps = MeanValuePlant.fit(
        plant,
        speed_range_rpm=(grid.low_rpm, grid.high_rpm),
        tolerance=grid.tolerance,
        most_points=grid.most_points,
        progress=_of("maps", progress),
    )
    speeds = np.geomspace(grid.low_rpm, grid.high_rpm, grid.path_speeds)
    speeds[[0, -1]] = grid.low_rpm, grid.high_rpm
    return OptimalPath.fit(
        maps,
        speeds_rpm=speeds,
        nodes=grid.path_nodes,
        progress=_of("optimal motions", progress),
    )


def _coarse_model(
    path: OptimalPath, plant: CrankAnglePlant, grid: _Grid, progress: Progress | None
) -> ChargeModel:
    return ChargeModel.fit(
        path,
        plant,
        speeds=grid.model_speeds,
        positions=grid.model_nodes,
        lowest_lift_mm=path.options.lowest_lift_mm,
        longest_deg=path.options.longest_deg(plant.engine, path.maps.region),
        progress=_of("charge model", progress),
    )


def _found(file: Path, key: str, progress: Progress | None) -> Tables | None:
    """Tables of a kept file; None if there is none, or it is no good."""
    try:
        tables = read(file, key)
    except FileNotFoundError:
        return None
    except (OSError, ParameterError) as error:
        _tell(progress, f"kept design not used, made anew ({error})")
        return None
    with suppress(OSError):  # a folder that may only be read is good enough
        os.utime(file)
    _tell(progress, "design read from disk")
    return tables


def _keep(design: ControllerDesign, file: Path, key: str, progress: Progress | None) -> None:
    """Write a design, and remove the ones that were used longest ago."""
    if source_digest() != SOURCES:  # of what was made the files no longer tell
        _tell(progress, "design not kept (the source code has changed since it was loaded)")
        return
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write(Tables(design.maps, design.path, design.model), file, key)
        kept = [(p.stat().st_mtime, p) for p in file.parent.glob(_PATTERN.format(key="*"))]
        for _, old in sorted(kept)[:-_KEPT]:
            old.unlink(missing_ok=True)
    except OSError as error:
        _tell(progress, f"design not kept ({error})")


def _tell(progress: Progress | None, label: str) -> None:
    if progress is not None:
        progress(label, 1, 1)
