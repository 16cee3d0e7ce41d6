"""Chapter: the intake process, crank angle by crank angle."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from plant import CrankAnglePlant, Cycle, ValveCommand
from plant._plotting import axes, styled

from ..chapter import Context
from ..content import ChapterResult, Column, Figure, Number, Table, Text

SPEED_RPM = 1500.0
FULL = ValveCommand(lift_mm=3.0, duration_deg=189.0)  # Fig. 4
PART = ValveCommand(lift_mm=2.0, duration_deg=99.0)  # Fig. 5
PROFILE = ValveCommand(lift_mm=5.0, duration_deg=189.0)  # reachable up to 6000 rpm
PROFILE_SPEEDS_RPM = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)
HIGHEST_THROTTLE_DEG = 60.0
PUBLISHED_SAVING = 74.0  # %, section 3.2


class IntakeChapter:
    """The intake event of Fig. 4, the pumping loops of Fig. 5, the profiles of Fig. 3."""

    id = "intake"
    title = "The intake process"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Simulate the points and draw them."""
        plant = context.plant
        full = plant.steady_cycle(SPEED_RPM, FULL)
        camless = plant.steady_cycle(SPEED_RPM, PART)
        throttled = same_charge_throttled(context, camless.air_charge[0])
        loss = float(camless.pumping_loss[0]), float(throttled.pumping_loss[0])
        saving = Number(100.0 * (1.0 - loss[0] / loss[1]), "%")
        return ChapterResult(
            finding=Text(
                "At {part_charge:.0f} per event and 1500 rpm, governing the load with the valves "
                "saves {saving:.0f} of the pumping loss of a throttle.",
                part_charge=Number(1e6 * camless.air_charge[0], "mg"),
                saving=saving,
            ),
            blocks=[
                Text(
                    "All figures are periodic solutions of the full plant: manifold, runners as "
                    "Helmholtz resonators, orifices and the isothermal cylinders, without a "
                    "throttle unless one is named."
                ),
                _event(context, full),
                _loops(context, camless, throttled, saving),
                _table(camless, throttled),
                Text(
                    "Part I prints a saving of {printed:.0f} with the throttle at 17°. Equation 19 "
                    "cannot pass this charge at 17°: the angle that gives the same charge is "
                    "{throttle:.1f}, found here by solving for it.",
                    printed=Number(PUBLISHED_SAVING, "%"),
                    throttle=Number(throttled.throttle_deg, "°"),
                ),
                _profiles(context),
            ],
        )


def same_charge_throttled(context: Context, charge: float) -> Cycle:
    """Return the throttled conventional engine's cycle at a charge in kg per event."""
    plant = CrankAnglePlant(context.engine, profile="conventional")
    cam = ValveCommand.conventional()

    def excess(throttle_deg: float) -> float:
        return float(plant.steady_cycle(SPEED_RPM, cam, throttle_deg).air_charge[0]) - charge

    lowest = context.engine.throttle.closed_deg + 3.0
    angle = brentq(excess, lowest, HIGHEST_THROTTLE_DEG, xtol=1e-4)
    return plant.steady_cycle(SPEED_RPM, cam, float(angle))


def _event(context: Context, cycle: Cycle) -> Figure:
    trace = cycle.trace
    early = (trace.crank_angle_deg >= 0.0) & (trace.crank_angle_deg < 60.0)
    flow = np.minimum(trace.port_flow[early, 0], 0.0)
    backflow = -float(np.trapezoid(flow, trace.time[early]))
    dip = float(np.max(np.abs(trace.manifold_pressure - context.engine.ambient_pressure)))
    return Figure(
        "event",
        Text(
            "Intake event at 1500 rpm, 3 mm, 189° (the case of Figure 4 of Part I). {backflow:.1f} "
            "flow back into the runner when the valve opens, because the cylinder starts at "
            "exhaust pressure; {charge:.1f} stay. The manifold leaves ambient pressure by "
            "{dip:.2f} at most, so it tells little about the charge.",
            backflow=Number(1e6 * backflow, "mg"),
            charge=Number(1e6 * cycle.air_charge[0], "mg"),
            dip=Number(dip / 1e3, "kPa"),
        ),
        "Valve lift, runner, manifold and cylinder pressure, port and throttle flow against crank "
        "angle, and the loop of cylinder pressure against volume, at 1500 rpm and full lift "
        "duration.",
        context.draw(cycle.plot()),
    )


def _loops(context: Context, camless: Cycle, throttled: Cycle, saving: Number) -> Figure:
    with styled():
        ax = axes(None, (7.2, 4.2))
        camless.trace.plot_pv(1, ax, label="camless, 2 mm, 99°, no throttle")
        throttled.trace.plot_pv(1, ax, label=f"cam, throttle at {throttled.throttle_deg:.1f}°")
        ax.axhline(context.engine.exhaust_pressure / 1e5, ls=":", c="0.4", lw=1.2)
        top = ax.get_xlim()[1]
        ax.annotate(
            "exhaust pressure",
            (top, context.engine.exhaust_pressure / 1e5),
            xytext=(-2, 3),
            textcoords="offset points",
            ha="right",
            fontsize=8.5,
            color="0.3",
        )
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)
    return Figure(
        "loops",
        Text(
            "Pumping loops of the same charge at 1500 rpm. The throttled engine pulls down the "
            "whole intake stroke; the camless engine shuts the valve early and gets back by "
            "compression what the expansion took. Saving: {saving:.1f}.",
            saving=saving,
        ),
        "Cylinder pressure against volume: the camless loop encloses a much smaller area below "
        "exhaust pressure than the throttled one.",
        context.draw(ax),
    )


def _table(camless: Cycle, throttled: Cycle) -> Table:
    return Table(
        "saving",
        Text("The same charge by two means, at 1500 rpm."),
        [
            Column("engine"),
            Column("throttle", "deg", ".1f"),
            Column("charge", "mg", ".1f"),
            Column("pumping loss", "J", ".2f"),
            Column("specific loss", "J/g", ".1f"),
        ],
        [
            [
                name,
                cycle.throttle_deg,
                1e6 * float(cycle.air_charge[0]),
                float(cycle.pumping_loss[0]),
                1e-3 * float(cycle.specific_pumping_loss[0]),
            ]
            for name, cycle in (("camless, unthrottled", camless), ("cam, throttled", throttled))
        ],
    )


def _profiles(context: Context) -> Figure:
    reached = {
        speed: context.plant.valve_profile(PROFILE, speed, "limit") for speed in PROFILE_SPEEDS_RPM
    }
    summit = reached[PROFILE_SPEEDS_RPM[-1]].lift_mm(np.linspace(0.0, PROFILE.duration_deg, 2001))
    rise_deg = {speed: 6.0 * speed * profile.corners.rise_end for speed, profile in reached.items()}
    with styled():
        ax = axes(None, (7.2, 3.6))
        for speed, profile in reached.items():
            profile.plot(ax, label=f"{speed:.0f} rpm")
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return Figure(
        "profiles",
        Text(
            "Valve profiles at {lift:.0f} and {duration:.0f}. The slopes of the valve are fixed in "
            "time, so the opening ramp takes {slow:.1f} of crank angle at {low_speed:.0f} and "
            "{fast:.1f} at {high_speed:.0f}, where it turns round at {summit:.2f} without resting.",
            lift=Number(PROFILE.lift_mm, "mm"),
            duration=Number(PROFILE.duration_deg, "°"),
            slow=Number(rise_deg[PROFILE_SPEEDS_RPM[0]], "°"),
            fast=Number(rise_deg[PROFILE_SPEEDS_RPM[-1]], "°"),
            low_speed=Number(PROFILE_SPEEDS_RPM[0], "rpm"),
            high_speed=Number(PROFILE_SPEEDS_RPM[-1], "rpm"),
            summit=Number(float(np.max(summit)), "mm"),
        ),
        "Valve lift against crank angle at five speeds; the flanks lean further over as speed "
        "grows.",
        context.draw(ax),
    )
