"""What a charge model has to stand: even nodes, a rising charge, a known error between nodes.

Private to `charge_model`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from plant import CrankAnglePlant, ParameterError
from plant._checks import in_range, positive, whole
from plant.kinematics import FloatArray

from ._model_table import COLUMNS, MotionPath
from .cylinder_parameters import CylinderParameters

if TYPE_CHECKING:
    from ._model_lookup import ModelLookup

LEAST_NODES = 5  # of a coordinate, which the splines need
TRIALS = 3000  # random points at which the error between the nodes is measured
STRETCH = 0.8  # the positions lie e^0.8 times closer at the least charge
_FINER = 4  # points a cell at which the charge is checked to rise
_PAST_PEAK = 0.01  # share of the peak by which the charge may be below it where it falls, 1
_GAINS = (0.7, 1.0, 1.3)


def check_uniform(name: str, nodes: FloatArray) -> None:
    """Raise where nodes do not rise in equal steps."""
    steps = np.diff(nodes)
    if not (np.all(steps > 0.0) and np.ptp(steps) < 1e-6 * steps.mean()):
        raise ParameterError(
            f"the nodes of {name} are not spaced as the model's are: make the model with "
            "ChargeModel.fit"
        )


def check_rising(model: ModelLookup) -> None:
    """Raise where the charge does not rise with the position, also between the nodes.

    With other flow gains than the nominal it may fall a little after a peak near the path's end,
    since flow then reverses earlier; the inverse stops at the peak.

    Raises
    ------
    ParameterError
        Naming the first place.
    """
    speeds, positions = model.speeds_rpm, model.positions
    cells = [(x.size - 1) * _FINER + 1 for x in (speeds, positions)]
    speed = 1.0 / np.linspace(1.0 / speeds[0], 1.0 / speeds[-1], cells[0])
    speed[[0, -1]] = speeds[[0, -1]]  # to the last digit
    position = np.linspace(positions[0], positions[-1], cells[1])
    for gain in _GAINS:
        charge = model.charge_at(position, speed[:, None], CylinderParameters(gain))
        falling = ~(np.diff(charge, axis=1) > 0.0)
        if gain != 1.0:
            falling &= charge[:, 1:] < (1.0 - _PAST_PEAK) * charge.max(axis=1, keepdims=True)
        for i, j in np.argwhere(falling)[:1]:
            raise ParameterError(
                f"the charge falls from {1e6 * charge[i, j]:.2f} to "
                f"{1e6 * charge[i, j + 1]:.2f} mg from position {position[j]:.4f} to "
                f"{position[j + 1]:.4f} at {speed[i]:.0f} rpm and {gain:g} times the flow "
                "coefficient, but must rise: end the path before the charge's peak, or fit with "
                "more nodes"
            )


def error_between_nodes(
    model: ModelLookup, plant: CrankAnglePlant, threads: int, seed: int
) -> float:
    """Largest relative error of the charge at random points, against the full plant."""
    random = np.random.default_rng(seed)
    speeds, positions = model.speeds_rpm, model.positions
    speed = 1.0 / random.uniform(1.0 / speeds[-1], 1.0 / speeds[0], TRIALS)
    found = model.at(random.uniform(positions[0], positions[-1], TRIALS), speed)
    cycles = plant.steady_cycles(
        speed,
        found["lift_mm"],
        found["duration"] * 6.0 * speed,
        per_cylinder=False,
        on_infeasible="limit",  # where lift and duration are splined off a corner of the path
        threads=threads,
    )
    return float(np.max(np.abs(found["charge"] / cycles["air_charge"].values - 1.0)))


def refuse(demand: float, speed_rpm: float, parameters: CylinderParameters, density: float) -> None:
    """Raise what is wrong with a question to the model, number by number."""
    gain, offset, factor = parameters
    remedy = "skip the event, or hold the last finite value"
    in_range("demand", demand, -math.inf, math.inf, "kg", remedy=remedy)
    in_range("speed_rpm", speed_rpm, -math.inf, math.inf, "rpm", remedy=remedy)
    in_range("duration_offset", offset, -math.inf, math.inf, "s", remedy=remedy)
    positive("flow_gain", gain, "1", remedy="start from CylinderParameters()")
    positive("charge_factor", factor, "1", remedy="start from CylinderParameters()")
    positive("density", density, "1", remedy="1 is the model's own")


def no_command(offset: float, speed_rpm: float, longest_deg: float) -> ParameterError:
    """Return the error of an offset that leaves no command."""
    return ParameterError(
        f"a duration_offset of {1e3 * offset:g} ms leaves no command between the shortest motion "
        f"and {longest_deg:g} deg at {speed_rpm:g} rpm: project the offset to what an actuator "
        "can be off"
    )


def check_table(model: ModelLookup) -> None:
    """Raise where the arrays of a model do not fit each other."""
    shape = (model.speeds_rpm.size, model.positions.size, COLUMNS)
    if model.table.shape != shape or min(shape[:2]) < LEAST_NODES:
        raise ParameterError(
            f"the table has shape {model.table.shape}, but must have {shape}, of at least "
            f"{LEAST_NODES} speeds and positions: make the model with ChargeModel.fit"
        )
    if not np.all(np.isfinite(model.table)) or np.any(model.table[..., 0] <= 0.0):
        raise ParameterError(
            "the table must hold finite numbers and charges above 0 kg: make the model with "
            "ChargeModel.fit"
        )
    check_uniform("1/speed", -1.0 / model.speeds_rpm)
    check_uniform("position", places_along(model.positions, model.positions))
    lowest, highest = model.valvetrain.lowest_lift_mm, model.valvetrain.maximum_lift_mm
    in_range("lowest_lift_mm", model.lowest_lift_mm, lowest, highest, "mm")
    in_range("longest_deg", model.longest_deg, 0.0, 360.0, "deg", open_low=True)


def nodes_of(
    path: MotionPath, speeds: int, positions: int, speed_range_rpm: tuple[float, float] | None
) -> tuple[FloatArray, FloatArray]:
    """Nodes of speed and position that are asked for, checked against the path."""
    n_speeds = whole("speeds", speeds, LEAST_NODES, 2000)
    n_positions = whole("positions", positions, LEAST_NODES, 1000)
    known = float(path.speeds_rpm[0]), float(path.speeds_rpm[-1])
    low, high = known if speed_range_rpm is None else speed_range_rpm
    in_range("lowest speed", low, known[0], known[1], "rpm", remedy="the path's speeds")
    in_range("highest speed", high, low, known[1], "rpm", open_low=True)
    nodes = 1.0 / np.linspace(1.0 / low, 1.0 / high, n_speeds)
    nodes[[0, -1]] = low, high  # to the last digit
    first, last = float(path.positions[0]), float(path.positions[-1])
    along = first + (last - first) * np.expm1(STRETCH * np.linspace(0.0, 1.0, n_positions))
    along = first + (along - first) / math.expm1(STRETCH)
    along[-1] = last  # to the last digit
    return nodes, along


def places_along(positions: FloatArray, nodes: FloatArray) -> FloatArray:
    """Coordinate in cells of positions between nodes: the inverse of how they are spaced."""
    share = (positions - nodes[0]) / (nodes[-1] - nodes[0])
    return (nodes.size - 1) / STRETCH * np.log1p(share * math.expm1(STRETCH))
