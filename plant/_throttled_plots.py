"""Pictures of the throttled mean-value plant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ._plotting import COLOURS, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ._throttled_dynamics import ThrottledRun
    from ._throttled_step import ThrottleStep
    from .throttled import ThrottledMeanValuePlant


def plot_maps(plant: ThrottledMeanValuePlant, speeds_rpm: Sequence[float]) -> Figure:
    """See `ThrottledMeanValuePlant.plot`."""
    import matplotlib.pyplot as plt

    with styled():
        figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.6))
        for speed in speeds_rpm:
            low, high = plant.pressure_range(speed)
            pressure = np.linspace(low, high, 200)
            left.plot(
                pressure / 1e3, 1e6 * plant.air_charge(pressure, speed), label=f"{speed:g} rpm"
            )
            right.plot(pressure / 1e3, plant.pumping_loss(pressure, speed))
        left.set_ylabel("air charge (mg per event)")
        right.set_ylabel("pumping loss (J per event)")
        for ax in (left, right):
            ax.set_xlabel("mean manifold pressure (kPa)")
            ax.set_ylim(bottom=0.0)
        left.set_title("Charge of the throttled engine")
        right.set_title("Its pumping loss")
        _legend_below(figure, len(speeds_rpm))
    return figure


def plot_run(run: ThrottledRun) -> Figure:
    """See `ThrottledRun.plot`."""
    import matplotlib.pyplot as plt

    with styled():
        figure, rows = plt.subplots(4, 1, sharex=True, figsize=(6.8, 7.6))
        throttle, pressure, flow, charge = rows
        throttle.plot(run.time, run.throttle_deg)
        throttle.set_ylabel("throttle (deg)")
        if np.ptp(run.speed_rpm) > 0.0:
            speed = throttle.twinx()
            speed.plot(run.time, run.speed_rpm, "--", c=COLOURS[1])
            speed.set_ylabel("speed (rpm)", color=COLOURS[1])
            speed.grid(False)
            speed.spines["right"].set_visible(True)
        else:
            throttle.set_title(f"Throttled mean-value plant at {run.speed_rpm[0]:g} rpm")
        pressure.plot(run.time, run.manifold_pressure / 1e3)
        if not run.identified.all():
            outside = np.where(run.identified, np.nan, run.manifold_pressure / 1e3)
            pressure.plot(run.time, outside, c=COLOURS[1], lw=3.0, label="not identified")
            pressure.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        pressure.set_ylabel("pressure (kPa)")
        flow.plot(run.time, 1e3 * run.throttle_flow, label="throttle")
        flow.plot(run.time, 1e3 * run.cylinder_flow, "--", label="cylinders")
        flow.set_ylabel("air flow (g/s)")
        flow.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        charge.plot(run.time, 1e6 * run.air_charge)
        charge.set_ylabel("charge (mg)")
        charge.set_xlabel("time (s)")
    return figure


def plot_step(step: ThrottleStep) -> Figure:
    """See `ThrottleStep.plot`."""
    import matplotlib.pyplot as plt

    with styled():
        figure, (top, bottom) = plt.subplots(
            2, 1, sharex=True, figsize=(6.8, 5.0), height_ratios=(2.0, 1.0)
        )
        top.plot(
            1e3 * step.run.time,
            step.run.manifold_pressure / 1e3,
            c=COLOURS[1],
            label="mean-value plant",
        )
        top.plot(
            1e3 * step.time,
            step.mean_value_pressure / 1e3,
            "x",
            c=COLOURS[1],
            ms=5,
            label="its event averages",
        )
        top.plot(
            1e3 * step.time,
            step.full_pressure / 1e3,
            "o",
            mfc="none",
            c=COLOURS[0],
            ms=5,
            label="event averages of the crank-angle plant",
        )
        top.set_ylabel("manifold pressure (kPa)")
        path = " → ".join(f"{angle:g}" for angle in step.throttles_deg)
        top.set_title(f"Throttle {path} deg at {step.speed_rpm:g} rpm")
        bottom.axhline(0.0, c="0.4", lw=0.8)
        bottom.plot(1e3 * step.time, 100.0 * step.error, ".-", c=COLOURS[0], lw=0.9)
        bottom.set_ylabel("error (%)")
        bottom.set_xlabel("time after the first step (ms)")
        bottom.set_title(
            f"{100.0 * step.rms:.2f} % rms, {100.0 * step.worst:.2f} % at worst", fontsize=9.5
        )
        _legend_below(figure, 3)
    return figure


def _legend_below(figure: Figure, columns: int) -> None:
    """Put one legend of all that is labelled below the axes, where it covers no data."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)
