"""Errors of the mean-value maps against the full plant: values, derivatives, place by place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ._checks import whole
from ._plotting import styled
from ._progress import Progress
from .crank_angle import CrankAnglePlant
from .errors import ParameterError
from .kinematics import FloatArray
from .map_results import MapError
from .region import OperatingPoint
from .sweep import sweep

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from .mean_value import MeanValuePlant

_RESOLUTION = 32.0  # at which the choice of steps disturbs no second difference
_STEPS = (4e-3, 0.4, 2e-3)  # of lift (relative), duration (deg) and speed (relative)
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_VARIABLES = ("lift", "duration", "speed")


@dataclass(frozen=True, eq=False)
class MapErrorField:
    """Error of the maps over the operating region.

    Attributes
    ----------
    data : xarray.Dataset
        ``charge_max``, ``charge_rms``, ``loss_max``, ``loss_rms`` by bin of speed, lift and
        share (dims ``speed``, ``lift``, ``share``), relative to the largest value at the point's
        speed.
    edges : tuple of 3 ndarray
        Edges of the bins: speed in rpm, lift in mm, share.
    maps : MeanValuePlant
        The maps.
    """

    data: xr.Dataset
    edges: tuple[FloatArray, FloatArray, FloatArray]
    maps: MeanValuePlant

    def charge(
        self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike
    ) -> FloatArray:
        """Largest relative charge error seen in a point's bin and the bins beside it."""
        return self._near("charge_max", lift_mm, duration_deg, speed_rpm)

    def loss(self, lift_mm: ArrayLike, duration_deg: ArrayLike, speed_rpm: ArrayLike) -> FloatArray:
        """Largest relative loss error seen in a point's bin and the bins beside it."""
        return self._near("loss_max", lift_mm, duration_deg, speed_rpm)

    def _near(
        self, name: str, lift: ArrayLike, duration: ArrayLike, speed: ArrayLike
    ) -> FloatArray:
        from scipy.ndimage import maximum_filter

        region = self.maps.region
        region.require(lift, duration, speed)
        point = np.broadcast_arrays(speed, lift, region.share(lift, duration, speed).value)
        index = tuple(
            np.clip(np.searchsorted(edge, x, side="right") - 1, 0, len(edge) - 2)
            for edge, x in zip(self.edges, point, strict=True)
        )
        values = maximum_filter(self.data[name].values, size=3, mode="nearest")
        return np.asarray(values[index])[()]

    def plot(self) -> Figure:
        """Draw the largest errors against speed and lift, and against speed and share."""
        import matplotlib.pyplot as plt

        with styled():
            figure, panels = plt.subplots(2, 2, figsize=(9.6, 6.6), sharex=True)
            for row, (name, label) in zip(
                panels, (("charge_max", "charge"), ("loss_max", "loss")), strict=True
            ):
                for ax, other, axis in zip(row, ("share", "lift"), (1, 2), strict=True):
                    values = 100.0 * self.data[name].max(other).values
                    mesh = ax.pcolormesh(
                        self.edges[0], self.edges[axis], values.T, cmap="viridis", vmin=0.0
                    )
                    bar = figure.colorbar(mesh, ax=ax, label=f"largest {label} error (%)")
                    if bar.solids is not None:
                        bar.solids.set_rasterized(False)  # no bitmap in a vector figure
                    ax.grid(False)
                    ax.set_ylabel("lift (mm)" if axis == 1 else "share of duration (1)")
            ticks = [750, 1000, 1500, 2000, 3000, 4500, 6000]
            for ax in panels[1]:
                ax.set_xlabel("speed (rpm)")
                ax.set_xscale("log")  # the bins are even in 1/N
                ax.set_xticks(ticks, [f"{tick}" for tick in ticks])
                ax.minorticks_off()
                ax.set_xlim(self.edges[0][0], self.edges[0][-1])
        return figure

    def __str__(self) -> str:
        """Return where the errors are largest."""
        lines = []
        for name in ("charge", "loss"):
            field = self.data[f"{name}_max"]
            i, j, k = np.unravel_index(int(np.argmax(field.values)), field.shape)
            n, u, s = (e[[m, m + 1]] for e, m in zip(self.edges, (i, j, k), strict=True))
            lines.append(
                f"largest {name} error {100.0 * float(field.max()):.2f} %, in the bin "
                f"{n[0]:.0f} to {n[1]:.0f} rpm, {u[0]:.2f} to {u[1]:.2f} mm, share {s[0]:.2f} to "
                f"{s[1]:.2f}; half of the bins stay under {100.0 * float(field.median()):.3f} %"
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class MapDerivativeError:
    """Error of the maps' derivatives against finite differences of a full plant.

    Each figure is relative to the rms (or the median size) of the plant's derivative over the
    points, 1, by the name of the derivative, such as ``"lift"`` or ``"lift_speed"``.

    Attributes
    ----------
    charge_rms, charge_median, loss_rms, loss_median : dict of str to float
        Error of the map's derivative.
    reference_rms : dict of str to float
        Change of the plant's own charge difference when its steps are doubled: where it is
        large, the plant has kinks, and the difference is no derivative.
    points, seed : int
        Number of points, and the seed that drew them.
    """

    charge_rms: dict[str, float]
    charge_median: dict[str, float]
    loss_rms: dict[str, float]
    loss_median: dict[str, float]
    reference_rms: dict[str, float]
    points: int
    seed: int

    def __str__(self) -> str:
        """Return the figures as a table."""
        lines = [
            f"derivatives at {self.points} points, error in % of the plant's",
            f"{'by':<20}{'charge rms':>11}{'median':>9}{'loss rms':>10}{'median':>9}"
            f"{'plant itself':>14}",
        ]
        for name in self.charge_rms:
            columns = (
                (self.charge_rms, 11),
                (self.charge_median, 9),
                (self.loss_rms, 10),
                (self.loss_median, 9),
                (self.reference_rms, 14),
            )
            lines.append(
                f"{name:<20}" + "".join(f"{100.0 * c[name]:>{width}.2f}" for c, width in columns)
            )
        return "\n".join(lines)


def relative_errors(
    maps: MeanValuePlant,
    plant: CrankAnglePlant,
    point: tuple[FloatArray, FloatArray, FloatArray],
    threads: int,
    progress: Progress | None,
) -> tuple[FloatArray, FloatArray]:
    """Map less plant at lifts, durations and speeds, relative to the largest at the speed."""
    lift, duration, speed = point
    truth = sweep(plant, speed, lift, duration, threads=threads, progress=progress)
    charge = maps.air_charge(lift, duration, speed) - truth.air_charge
    loss = maps.pumping_loss(lift, duration, speed) - truth.pumping_loss
    return charge / maps.largest_charge(speed), loss / maps.largest_loss(speed)


def error_against(
    maps: MeanValuePlant,
    plant: CrankAnglePlant,
    samples: int,
    seed: int,
    threads: int,
    progress: Progress | None,
) -> MapError:
    """See `MeanValuePlant.error_against`."""
    lift, duration, speed = point = maps.region.sample(samples, seed)
    charge, loss = relative_errors(maps, plant, point, threads, progress)
    worst = [int(np.argmax(np.abs(error))) for error in (charge, loss)]
    places = [OperatingPoint(speed[k], lift[k], duration[k]) for k in worst]
    return MapError(
        charge_rms=float(np.sqrt(np.mean(charge**2))),
        charge_max=float(np.abs(charge[worst[0]])),
        loss_rms=float(np.sqrt(np.mean(loss**2))),
        loss_max=float(np.abs(loss[worst[1]])),
        worst_charge=places[0],
        worst_loss=places[1],
        points=samples,
        seed=seed,
        same_plant=plant.fingerprint == maps.provenance["plant_fingerprint"],
    )


def error_field(
    maps: MeanValuePlant,
    plant: CrankAnglePlant,
    bins: tuple[int, int, int],
    per_bin: int,
    seed: int,
    threads: int,
    progress: Progress | None,
) -> MapErrorField:
    """See `MeanValuePlant.error_field`."""
    import xarray as xr

    counts = [whole(f"bins[{k}]", n, 1, 200) for k, n in enumerate(bins)]
    whole("per_bin", per_bin, 1, 1000)
    random = np.random.default_rng(seed)
    bounds = maps.box.bounds.tolist()
    lines = [np.linspace(low, high, n + 1) for (low, high), n in zip(bounds, counts, strict=True)]
    corner = np.meshgrid(*(line[:-1] for line in lines), indexing="ij")
    shape = (*counts, per_bin)
    x = [
        c[..., None] + (line[1] - line[0]) * random.uniform(size=shape)
        for c, line in zip(corner, lines, strict=True)
    ]
    speed, lift = maps.box.speed_and_lift(x[0], x[1])
    duration = maps.region.duration_deg(lift, x[2], speed)
    flat = (lift.ravel(), duration.ravel(), speed.ravel())
    errors = relative_errors(maps, plant, flat, threads, progress)
    speeds, lifts = maps.box.speed_and_lift(lines[0], lines[1])
    edges = (speeds, lifts, lines[2])
    variables = {}
    for name, error in zip(("charge", "loss"), errors, strict=True):
        by_bin = np.abs(error.reshape(shape))
        attrs = {"units": "1", "long_name": f"relative {name} error"}
        dims = ("speed", "lift", "share")
        variables[f"{name}_max"] = (dims, by_bin.max(axis=-1), attrs)
        variables[f"{name}_rms"] = (dims, np.sqrt((by_bin**2).mean(axis=-1)), attrs)
    middles = [0.5 * (e[1:] + e[:-1]) for e in edges]
    data = xr.Dataset(
        variables,
        coords={
            "speed": ("speed", middles[0], {"units": "rpm"}),
            "lift": ("lift", middles[1], {"units": "mm"}),
            "share": ("share", middles[2], {"units": "1"}),
        },
        attrs={"per_bin": per_bin, "seed": seed, "plant_fingerprint": plant.fingerprint},
    )
    return MapErrorField(data, edges, maps)


def derivative_error_against(
    maps: MeanValuePlant,
    plant: CrankAnglePlant,
    samples: int,
    seed: int,
    threads: int,
    progress: Progress | None,
) -> MapDerivativeError:
    """See `MeanValuePlant.derivative_error_against`."""
    fine = CrankAnglePlant(
        plant.engine,
        runner=plant.runner,
        oscillation=plant.oscillation,
        orifice=plant.orifice,
        resolution=max(_RESOLUTION, plant.resolution),
    )
    whole("samples", samples, 10, 100_000)
    drawn = np.array(maps.region.sample(4 * samples, seed))
    steps = np.array(_STEPS)[:, None] * np.stack((drawn[0], np.ones_like(drawn[1]), drawn[2]))
    x, h = _clear_of_edges(maps, plant, drawn, steps, samples)
    single, double = (_differences(fine, x, k * h, threads, progress) for k in (1.0, 2.0))
    names = list(single)
    results: dict[str, dict[str, float]] = {}
    for k, quantity in enumerate(("charge", "loss")):
        own = _map_derivatives(maps, quantity, x)
        for measure, size in (("rms", _rms), ("median", _median)):
            results[f"{quantity}_{measure}"] = {
                name: size(own[name] - single[name][k]) / size(single[name][k]) for name in names
            }
    reference = {n: _rms(double[n][0] - single[n][0]) / _rms(single[n][0]) for n in names}
    return MapDerivativeError(
        results["charge_rms"],
        results["charge_median"],
        results["loss_rms"],
        results["loss_median"],
        reference,
        x.shape[1],
        seed,
    )


def _clear_of_edges(
    maps: MeanValuePlant, plant: CrankAnglePlant, x: FloatArray, h: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """First points whose stencils neither leave the region nor cross a kink of the runner."""
    reach = 2.0 * h
    clear = np.ones(x.shape[1], dtype=bool)
    for signs in np.ndindex(2, 2, 2):
        corner = x + (2.0 * np.array(signs)[:, None] - 1.0) * reach
        clear &= maps.region.feasible(*corner)
    if plant.runner:
        helmholtz = plant.engine.helmholtz
        for kink in (helmholtz.low_speed_rpm, helmholtz.high_speed_rpm):
            clear &= np.abs(x[2] - kink) > reach[2]
    kept = np.flatnonzero(clear)[:count]
    if not kept.size:
        raise ParameterError(
            f"none of {x.shape[1]} points leaves room for differences over {200 * _STEPS[0]:g} % "
            f"of lift, {2 * _STEPS[1]:g} deg and {200 * _STEPS[2]:g} % of speed each way: fit maps "
            "of a wider region"
        )
    return x[:, kept], h[:, kept]


def _differences(
    plant: CrankAnglePlant, x: FloatArray, h: FloatArray, threads: int, progress: Progress | None
) -> dict[str, FloatArray]:
    """Central first and second differences of charge and loss, (2, points) each."""
    stencil = [_offset()]
    stencil += [_offset((i, a)) for i in range(3) for a in (1, -1)]
    stencil += [_offset((i, a), (j, b)) for i, j in _PAIRS[3:] for a in (1, -1) for b in (1, -1)]
    points = np.stack([x + np.array(s)[:, None] * h for s in stencil], axis=1)
    truth = sweep(plant, points[2], points[0], points[1], threads=threads, progress=progress)
    f = np.stack((truth.air_charge, truth.pumping_loss))
    at = {s: f[:, k] for k, s in enumerate(stencil)}
    found = {}
    for i, name in enumerate(_VARIABLES):
        found[name] = (at[_offset((i, 1))] - at[_offset((i, -1))]) / (2.0 * h[i])
    for i, j in _PAIRS:
        name = f"{_VARIABLES[i]}_{_VARIABLES[j]}"
        if i == j:
            second = at[_offset((i, 1))] - 2.0 * at[_offset()] + at[_offset((i, -1))]
            found[name] = second / h[i] ** 2
            continue
        mixed = sum(a * b * at[_offset((i, a), (j, b))] for a in (1, -1) for b in (1, -1))
        found[name] = mixed / (4.0 * h[i] * h[j])
    return found


def _offset(*moves: tuple[int, int]) -> tuple[int, ...]:
    """Steps in each variable, from pairs of variable and steps."""
    steps = dict(moves)
    return tuple(steps.get(k, 0) for k in range(3))


def _map_derivatives(maps: MeanValuePlant, quantity: str, x: FloatArray) -> dict[str, FloatArray]:
    gradient = maps.charge_gradient(*x) if quantity == "charge" else maps.loss_gradient(*x)
    hessian = maps.charge_hessian(*x) if quantity == "charge" else maps.loss_hessian(*x)
    return {**vars(gradient), **vars(hessian)}


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _median(values: FloatArray) -> float:
    return float(np.median(np.abs(values)))
