"""Chapter: the mean-value maps of charge and loss, and their error against the full plant."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from camless_ctrl.assessment import assess_boundary, assess_maps
from plant.mean_value import MeanValuePlant

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as DrawnFigure

    from plant import BoundaryError

SAMPLES = 1000
DERIVATIVES = 120
SPEEDS_RPM = (1500.0, 4500.0)
# Lift in mm, duration in deg, speed in rpm: light load, half load, full load, high speed.
SENSITIVITY_POINTS = (
    (2.0, 60.0, 750.0),
    (2.0, 90.0, 1500.0),
    (3.0, 180.0, 1500.0),
    (5.0, 180.0, 3000.0),
    (7.0, 220.0, 6000.0),
)


def mean_value_plant(context: Context) -> MeanValuePlant:
    """Return the maps of the context's plant, fitted once."""
    return context.shared("mean_value", lambda: MeanValuePlant.fit(context.plant))


def boundary_maps(context: Context) -> MeanValuePlant:
    """Return the maps with boundary conditions, fitted once."""
    return context.shared(
        "boundary", lambda: mean_value_plant(context).with_boundary_conditions(context.plant)
    )


class MapsChapter:
    """Maps over lift, duration and speed; their error; what they tell the controller."""

    id = "maps"
    title = "Mean-value maps"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Fit the maps, check them at random points, and draw them."""
        maps = mean_value_plant(context)
        error = maps.error_against(context.plant, samples=SAMPLES, seed=context.seed)
        boundary = boundary_error(context)
        numbers = {
            "charge_rms": Number(100.0 * error.charge_rms, "%"),
            "charge_max": Number(100.0 * error.charge_max, "%"),
            "loss_rms": Number(100.0 * error.loss_rms, "%"),
            "loss_max": Number(100.0 * error.loss_max, "%"),
            "samples": Number(SAMPLES),
        }
        return ChapterResult(
            finding=Text(
                "The maps give the charge of the full plant with {charge_rms:.3f} rms and "
                "{charge_max:.2f} at worst, the loss with {loss_rms:.3f} and {loss_max:.2f}.",
                **numbers,
            ),
            blocks=[
                Text(
                    "For control design the intake event is reduced to two maps, charge and "
                    "pumping loss per event against lift, duration and speed, opening at top dead "
                    "centre without a throttle. They are splines through {nodes:.0f} steady "
                    "cycles of the full plant, dense where it curves, over {low:.0f} to "
                    "{high:.0f}, {least:.2g} to {most:.2g} and all durations that the valve can "
                    "drive up to {longest:.0f}. So that they have no rise or fall that the cycles "
                    "do not have, they leave single nodes by up to {adjusted:.2f} of the largest "
                    "charge.",
                    nodes=Number(maps.charge.size),
                    low=Number(maps.region.lowest_speed_rpm, "rpm"),
                    high=Number(maps.region.highest_speed_rpm, "rpm"),
                    least=Number(maps.region.lowest_lift_mm, "mm"),
                    most=Number(maps.region.highest_lift_mm, "mm"),
                    longest=Number(maps.region.longest_deg, "°"),
                    adjusted=Number(100.0 * maps.shape_adjustment[0], "%"),
                ),
                _charge_figure(context, maps),
                _loss_figure(context, maps),
                _surface_figure(context, maps),
                Heading("Error against the full plant"),
                Text(
                    "Error at {samples:.0f} random points between the nodes, relative to the "
                    "largest charge and loss at the speed: charge {charge_rms:.3f} rms, "
                    "{charge_max:.2f} at worst, at {where_charge}; loss {loss_rms:.3f} rms, "
                    "{loss_max:.2f} at worst, at {where_loss}.",
                    where_charge=str(error.worst_charge),
                    where_loss=str(error.worst_loss),
                    **numbers,
                ),
                _error_figure(context, maps),
                _derivatives(context, maps),
                Heading("Other boundary conditions"),
                Text(
                    "At {points:.0f} random operating points with an ambient pressure of 0.7 to "
                    "1.05 bar, 250 to 330 K and an exhaust pressure of 1.0 to 1.3 bar the maps, "
                    "scaled by pressure and temperature and corrected by a polynomial in them, "
                    "miss the charge by {b_charge_rms:.2f} rms and {b_charge_max:.2f} at worst, "
                    "the loss by {b_loss_rms:.2f} and {b_loss_max:.2f}. The orifices keep their "
                    "size in kg/s, as in the paper.",
                    points=Number(boundary.points),
                    b_charge_rms=Number(100.0 * boundary.charge_rms, "%"),
                    b_charge_max=Number(100.0 * boundary.charge_max, "%"),
                    b_loss_rms=Number(100.0 * boundary.loss_rms, "%"),
                    b_loss_max=Number(100.0 * boundary.loss_max, "%"),
                ),
                Heading("What the maps tell the controller"),
                _regions_figure(context, maps),
                _limits(maps),
                _sensitivity(maps),
            ],
            requirements=[*assess_maps(error), *assess_boundary(boundary)],
        )


def boundary_error(context: Context) -> BoundaryError:
    """Error of the maps at other boundary conditions."""
    correction = boundary_maps(context).boundary
    assert correction is not None  # just fitted
    return correction.error


def _surface_figure(context: Context, maps: MeanValuePlant) -> Figure:
    import matplotlib.pyplot as plt

    from plant._plotting import styled

    with styled():
        figure, row = plt.subplots(
            1, 2, figsize=(10.4, 4.6), subplot_kw={"projection": "3d"}, squeeze=False
        )
    maps.plot_charge(1500.0, row[0][0], kind="surface")
    maps.plot_loss(1500.0, row[0][1], kind="surface")
    for ax, title in zip(row[0], ("air charge", "pumping loss"), strict=True):
        ax.set_title("", loc="center")
        ax.set_title(title, loc="left")
        if ax.get_legend() is not None:
            ax.get_legend().remove()
    return Figure(
        "surfaces",
        Text(
            "The maps at 1500 rpm as in Figures 9 and 10 of the paper (black: lift saturation; "
            "dashed: flow reversal; grey: infeasible). Beyond the saturation lift the charge "
            "hardly grows, while the loss falls: the highest lift is the one that pumps least."
        ),
        "Air charge and pumping loss over duration and lift as surfaces.",
        context.draw(figure),
    )


def _error_figure(context: Context, maps: MeanValuePlant) -> Figure:
    field = maps.error_field(context.plant, per_bin=4, seed=context.seed + 1)
    worst = 100.0 * float(field.data["charge_max"].max())
    middle = 100.0 * float(field.data["charge_max"].median())
    return Figure(
        "error",
        Text(
            "Largest error in each part of the operating region, at four random points in each of "
            "{bins:.0f} parts. The charge misses by {worst:.2f} in the worst part; in half of the "
            "parts by less than {middle:.3f}.",
            bins=Number(field.data["charge_max"].size),
            worst=Number(worst, "%"),
            middle=Number(middle, "%"),
        ),
        "Largest relative error over speed and lift, and over speed and share of duration.",
        context.draw(field.plot()),
    )


def _derivatives(context: Context, maps: MeanValuePlant) -> Table:
    error = maps.derivative_error_against(context.plant, samples=DERIVATIVES, seed=context.seed)
    rows: list[list[Cell]] = [
        [
            name.replace("_", ", "),
            *(
                100.0 * values[name]
                for values in (
                    error.charge_rms,
                    error.charge_median,
                    error.loss_rms,
                    error.loss_median,
                    error.reference_rms,
                )
            ),
        ]
        for name in error.charge_rms
    ]
    return Table(
        "derivatives",
        Text(
            "Derivatives of the maps against finite differences of the full plant at "
            "{derivative_points:.0f} points, relative to the rms or the median of the plant's. "
            "Where flow chokes or turns, the plant has kinks: there its second derivative jumps, "
            "which makes the rms large and leaves the median small.",
            derivative_points=Number(error.points),
        ),
        [
            Column("by"),
            Column("charge rms", "%", ".2f"),
            Column("charge median", "%", ".2f"),
            Column("loss rms", "%", ".2f"),
            Column("loss median", "%", ".2f"),
            Column("plant, steps doubled", "%", ".2f"),
        ],
        rows,
    )


def _regions_figure(context: Context, maps: MeanValuePlant) -> Figure:
    saturation = maps.lift_saturation(np.array([750.0, 1500.0, 5500.0]))
    return Figure(
        "regions",
        Text(
            "Regions of section 5 of the paper against speed. Lift saturates at {s750:.2f}, "
            "{s1500:.2f} and {s5500:.2f} at 750, 1500 and 5500 rpm; the paper names about 1.5, 3 "
            "and 5 mm. The last is not reproduced.",
            s750=Number(float(saturation[0]), "mm"),
            s1500=Number(float(saturation[1]), "mm"),
            s5500=Number(float(saturation[2]), "mm"),
        ),
        "Saturation lift, duration of flow reversal and shortest duration against speed.",
        context.draw(maps.regions().plot()),
    )


def _charge_figure(context: Context, maps: MeanValuePlant) -> Figure:
    figure = _contours(maps.plot_charge)
    low, high = SPEEDS_RPM
    return Figure(
        "charge",
        Text(
            "Air charge at {slow:.0f} and {fast:.0f}. At 7 mm the charge peaks at {slow_peak} and "
            "at {fast_peak} of duration: beyond, the flow reverses and more duration gives less "
            "charge.",
            slow=Number(low, "rpm"),
            fast=Number(high, "rpm"),
            slow_peak=_peak(maps, low),
            fast_peak=_peak(maps, high),
        ),
        "Contours of the air charge over duration and lift at two speeds.",
        context.draw(figure),
    )


def _contours(draw: Callable[[float, Axes], Axes]) -> DrawnFigure:
    """Draw contours at each speed in a row, with one legend."""
    from ..figures import one_legend, side_by_side

    figure, row = side_by_side(len(SPEEDS_RPM), height=4.2)
    for ax, speed in zip(row, SPEEDS_RPM, strict=True):
        draw(speed, ax)
        ax.set_title(f"{speed:.0f} rpm", loc="left")
    one_legend(figure)
    return figure


def _peak(maps: MeanValuePlant, speed_rpm: float) -> Number | str:
    peak = float(maps.flow_reversal(speed_rpm, 7.0))
    if math.isfinite(peak):
        return Number(round(peak, 1), "°")
    return f"more than {maps.region.longest_deg:.0f}°"


def _loss_figure(context: Context, maps: MeanValuePlant) -> Figure:
    figure = _contours(maps.plot_loss)
    part = [float(maps.pumping_loss(lift, 120.0, SPEEDS_RPM[0])) for lift in (1.0, 6.0)]
    return Figure(
        "loss",
        Text(
            "Pumping loss at the same speeds. Small lifts throttle at the valve: at 120° and "
            "1500 rpm the loss is {small:.1f} at 1 mm and {large:.1f} at 6 mm.",
            small=Number(part[0], "J"),
            large=Number(part[1], "J"),
        ),
        "Contours of the pumping loss over duration and lift at two speeds.",
        context.draw(figure),
    )


def _limits(maps: MeanValuePlant) -> Table:
    rows: list[list[Cell]] = []
    for speed in (750.0, 1500.0, 3000.0, 4500.0, 6000.0):
        peak = float(maps.flow_reversal(speed, 7.0))
        rows.append(
            [
                speed,
                1e6 * float(maps.largest_charge(speed)),
                float(maps.lift_saturation(speed)),
                peak if math.isfinite(peak) else None,
            ]
        )
    return Table(
        "limits",
        Text(
            "Largest charge, lift that nearly gives it, and duration at which the flow reverses (a "
            "dash: not up to {longest:.0f}).",
            longest=Number(maps.region.longest_deg, "°"),
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("largest charge", "mg", ".1f"),
            Column("saturation lift", "mm", ".2f"),
            Column("flow reversal at 7 mm", "deg", ".0f"),
        ],
        rows,
    )


def _sensitivity(maps: MeanValuePlant) -> Table:
    rows = []
    for lift, duration, speed in SENSITIVITY_POINTS:
        charge = float(maps.air_charge(lift, duration, speed))
        slope = maps.charge_gradient(lift, duration, speed)
        rows.append(
            [
                speed,
                lift,
                duration,
                1e6 * charge,
                100.0 * float(slope.duration) / charge,
                100.0 * float(slope.lift) / charge,
                # One tenth of a millisecond of valve timing at this speed.
                100.0 * float(slope.duration) / charge * 6.0 * speed * 1e-4,
            ]
        )
    return Table(
        "sensitivity",
        Text(
            "Sensitivity of the charge. The last column is what an actuator that is off by a tenth "
            "of a millisecond does."
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("lift", "mm", ".1f"),
            Column("duration", "deg", ".0f"),
            Column("charge", "mg", ".1f"),
            Column("by duration", "%/deg", "+.2f"),
            Column("by lift", "%/mm", "+.1f"),
            Column("by 0.1 ms", "%", "+.2f"),
        ],
        rows,
    )
