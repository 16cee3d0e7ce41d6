"""Maps at other boundary conditions: the correction fitted, its error, and maps derived by it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ._boundary_correction import BoundaryCorrection, fit_correction, units_of_air
from ._map_grid import as_range
from ._progress import Progress
from .boundary import NAMES, UNITS, BoundaryConditions
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import BoundaryError
from .region import OperatingPoint
from .state import fingerprint

if TYPE_CHECKING:
    from .mean_value import MeanValuePlant

Maps = TypeVar("Maps", bound="MeanValuePlant")
Ranges = tuple[tuple[float, float], ...]
# Charge and loss at speeds, lifts, durations and conditions
Cycles = Callable[
    [FloatArray, FloatArray, FloatArray, BoundaryConditions], tuple[FloatArray, FloatArray]
]


def with_boundary_conditions(
    maps: Maps,
    plant: CrankAnglePlant,
    ranges: Ranges,
    samples: int,
    seed: int,
    threads: int,
    progress: Progress | None,
) -> Maps:
    """See `MeanValuePlant.with_boundary_conditions`."""
    if plant.fingerprint != maps.provenance["plant_fingerprint"]:
        raise ParameterError(
            f"the plant is {plant.fingerprint}, but the maps were fitted to "
            f"{maps.provenance['plant_fingerprint']}: give the plant that was fitted"
        )
    ranges = tuple(as_range(n, r, u) for n, r, u in zip(NAMES, ranges, UNITS, strict=True))
    for name, unit, (low, high) in zip(NAMES, UNITS, ranges, strict=True):
        own = getattr(maps.engine, name)
        if not 0.0 < low <= own <= high < np.inf or low == high:
            raise ParameterError(
                f"{name} is to be covered from {low:g} to {high:g} {unit}, but the range must be "
                f"above 0, not empty, and hold the engine's own {own:g} {unit}"
            )
    box = maps.box
    done = 0

    def simulate(
        slowness: FloatArray, log_lift: FloatArray, share: FloatArray, c: BoundaryConditions
    ) -> tuple[FloatArray, FloatArray]:
        speed, lift = box.speed_and_lift(slowness, log_lift)
        return cycles(speed, lift, maps.region.duration_deg(lift, share, speed), c)

    def cycles(
        speed: FloatArray, lift: FloatArray, duration: FloatArray, c: BoundaryConditions
    ) -> tuple[FloatArray, FloatArray]:
        nonlocal done
        before = done

        def tell(k: int, count: int) -> None:
            if progress is not None:
                progress(before + k, before + count)

        found = plant.steady_cycles(
            speed,
            lift,
            duration,
            parameters={name: getattr(c, name) for name in NAMES},
            per_cylinder=False,
            threads=threads,
            progress=tell,
        )
        done += found["air_charge"].size
        return found["air_charge"].values, found["pumping_loss"].values

    def error(correction: BoundaryCorrection) -> BoundaryError:
        return _error(dataclasses.replace(maps, boundary=correction), cycles, ranges, samples, seed)

    # Every second node: a cubic spline over them lies in the space of the maps' own. It needs 4.
    picked = [np.union1d(np.arange(0, n, 2 if n > 5 else 1), [n - 1]) for n in maps.charge.shape]
    speed, lift, share = (
        nodes[k]
        for nodes, k in zip((maps.speeds_rpm, maps.lifts_mm, maps.shares), picked, strict=True)
    )
    nodes = (box.slowness(speed), np.log(lift), share)
    at_nodes = np.ix_(*picked)
    correction = fit_correction(
        maps.engine, simulate, nodes, maps.charge[at_nodes], maps.loss[at_nodes], ranges, error
    )
    return dataclasses.replace(maps, boundary=correction)


def _error(
    maps: MeanValuePlant, cycles: Cycles, ranges: Ranges, samples: int, seed: int
) -> BoundaryError:
    lift, duration, speed = maps.region.sample(samples, seed)
    # Another stream than that of the points: the two must not be related.
    random = np.random.default_rng([seed, 1])
    drawn = np.array([random.uniform(*r, samples) for r in ranges])
    # A fifth of the conditions are corners of the ranges, where a polynomial errs most.
    corners = np.array([random.choice(r, samples) for r in ranges])
    conditions = BoundaryConditions(*np.where(np.arange(samples) % 5 == 0, corners, drawn))
    truth = cycles(speed, lift, duration, conditions)
    own = units_of_air(maps.engine, BoundaryConditions.of(maps.engine))
    units = units_of_air(maps.engine, conditions)
    figures, places = [], []
    for k, (found, largest) in enumerate(
        (
            (maps.air_charge(lift, duration, speed, conditions=conditions), maps.largest_charge),
            (maps.pumping_loss(lift, duration, speed, conditions=conditions), maps.largest_loss),
        )
    ):
        relative = np.abs(found - truth[k]) / (largest(speed) * units[k] / own[k])
        i = int(np.argmax(relative))
        figures += [float(np.sqrt(np.mean(relative**2))), float(relative[i])]
        at = BoundaryConditions(*(np.asarray(getattr(conditions, name))[i] for name in NAMES))
        places.append(f"{OperatingPoint(speed[i], lift[i], duration[i])}, {at}")
    return BoundaryError(
        charge_rms=figures[0],
        charge_max=figures[1],
        loss_rms=figures[2],
        loss_max=figures[3],
        worst_charge=places[0],
        worst_loss=places[1],
        points=samples,
        seed=seed,
    )


def at(maps: Maps, conditions: BoundaryConditions) -> Maps:
    """See `MeanValuePlant.at`."""
    if any(np.ndim(getattr(conditions, name)) for name in NAMES):
        raise ParameterError(
            f"the {conditions} are arrays, but maps are made at numbers: give air_charge(...) "
            "and pumping_loss(...) the arrays"
        )
    maps.require_boundary(conditions)
    values = {name: float(getattr(conditions, name)) for name in NAMES}
    engine = maps.engine.replace(**values)
    lift = maps.lifts_mm[None, :, None]
    speed = maps.speeds_rpm[:, None, None]
    point = np.broadcast_arrays(lift, maps.region.duration_deg(lift, maps.shares, speed), speed)
    # The change of the nodes' own values: the surface may pass beside them for its shape.
    own = BoundaryConditions.of(maps.engine)
    charge = maps.air_charge(*point, conditions=conditions)
    loss = maps.pumping_loss(*point, conditions=conditions)
    for values_at, base, evaluate, unit in (
        (charge, maps.charge, maps.air_charge, 0),
        (loss, maps.loss, maps.pumping_loss, 1),
    ):
        ratio = units_of_air(maps.engine, conditions)[unit] / units_of_air(maps.engine, own)[unit]
        values_at += ratio * (base - evaluate(*point))
    options = {k: maps.provenance[k] for k in ("runner", "oscillation", "orifice", "resolution")}
    return dataclasses.replace(
        maps,
        engine=engine,
        charge=charge,
        loss=loss,
        boundary=None,
        provenance={
            **maps.provenance,
            "plant_fingerprint": fingerprint(
                engine,
                runner=options["runner"] == "True",
                oscillation=options["oscillation"] == "True",
                profile="camless",
                orifice=options["orifice"],
                resolution=options["resolution"],
            ),
            "scaled_from": maps.provenance["plant_fingerprint"],
        },
    )
