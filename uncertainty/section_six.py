"""Section 6 of Part I drawn again: what runner and valve oscillation change (Figures 11 to 14).

A closing timing is where the seating begins, as in section 3.1: the duration is the closing
timing plus the seating, ``IVD = IVC + 6 N d_s``. The valve opens at TDC, and the engine is not
throttled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from plant import CrankAnglePlant, Engine, ValveCommand
from plant._checks import positive, truth
from plant.region import shortest_deg

from ._section_six_motion import motion_words
from ._section_six_runner import fast_runner_words, loop_words, slow_runner_words
from ._section_six_sweep import checked_lift, grid, seating_deg, sweep, values_of, variables
from .section_six_result import LoopComparison, MotionComparison, RunnerComparison

if TYPE_CHECKING:
    import xarray as xr

SLOW_RPM, FAST_RPM = 1500.0, 6000.0
LOWEST_LIFT_MM = 0.5
LIFT_STEP_MM = 0.1
CLOSINGS_DEG = tuple(60.0 + 2.5 * k for k in range(81))  # to 260 deg
LOOP_CLOSINGS_DEG = (80.0, 180.0, 230.0)  # early, at the event, late: Figure 13
# Fine enough for the ringing of the runner, which repeats every 125 rpm at 750 rpm.
SPEEDS_RPM = tuple(750.0 + 25.0 * k for k in range(211))  # to 6000 rpm
LOOP_STEP_DEG = 0.5


def figure_11(
    engine: Engine | None = None,
    *,
    lift_mm: float = 3.0,
    closing_deg: float = 180.0,
    lifts_mm: Sequence[float] | None = None,
    closings_deg: Sequence[float] = CLOSINGS_DEG,
) -> RunnerComparison:
    """Charge and loss over lift and closing timing at 1500 rpm, without and with runner.

    Parameters
    ----------
    engine : Engine, optional
        The paper's by default.
    lift_mm : float
        Lift of the second column. Part I prints none.
    closing_deg : float
        Closing timing of the first column. Part I prints none.
    lifts_mm : sequence of float, optional
        Lifts of the first column, rising; from 0.5 mm to the highest in steps of 0.1 mm.
    closings_deg : sequence of float
        Closing timings of the second column, rising.

    Raises
    ------
    ParameterError
        If a lift or a closing timing is out of range, a list does not rise, or a column has
        no point that can be driven.
    """
    dataset = _runner_dataset(engine, SLOW_RPM, lift_mm, closing_deg, lifts_mm, closings_deg)
    claims, words = slow_runner_words(dataset)
    return RunnerComparison("Figure 11", dataset, claims, words)


def figure_12(
    engine: Engine | None = None,
    *,
    lift_mm: float = 7.0,
    closing_deg: float = 180.0,
    lifts_mm: Sequence[float] | None = None,
    closings_deg: Sequence[float] = CLOSINGS_DEG,
) -> RunnerComparison:
    """Charge and loss over lift and closing timing at 6000 rpm, without and with runner.

    Parameters and errors are those of `figure_11`.
    """
    dataset = _runner_dataset(engine, FAST_RPM, lift_mm, closing_deg, lifts_mm, closings_deg)
    claims, words = fast_runner_words(dataset)
    return RunnerComparison("Figure 12", dataset, claims, words)


def figure_13(
    engine: Engine | None = None, *, speed_rpm: float = FAST_RPM, lift_mm: float = 7.0
) -> LoopComparison:
    """P-V diagrams for closing at 80, 180 and 230 deg, without and with runner.

    Parameters
    ----------
    engine : Engine, optional
        The paper's by default.
    speed_rpm : float
        Engine speed.
    lift_mm : float
        Lift, which is limited to what a closing timing allows; the dataset and the caption
        tell the delivered one. Part I prints none.

    Raises
    ------
    ParameterError
        If speed or lift is out of range, or the early closing leaves no time to open at all.
    """
    import xarray as xr

    engine = Engine.paper() if engine is None else engine
    speed = positive("speed_rpm", speed_rpm, "rpm")
    closings = np.array(LOOP_CLOSINGS_DEG)
    durations = closings + seating_deg(engine, speed)
    cycles = [
        [
            plant.steady_cycle(speed, ValveCommand(lift_mm, duration), on_infeasible="limit")
            for duration in durations.tolist()
        ]
        for plant in _runner_plants(engine)
    ]
    traces = [[cycle.trace_at(LOOP_STEP_DEG) for cycle in row] for row in cycles]
    angle = traces[0][0].crank_angle_deg
    intake = (angle >= 0.0) & (angle <= 360.0)  # to the compression TDC
    delivered = np.array([float(cycle.delivered_lift_mm.min()) for cycle in cycles[0]])
    common = float(delivered.min())
    each = ("runner", "closing")
    at_common = np.stack(
        [
            values_of(plant.steady_cycles(speed, common, durations, on_infeasible="limit"))
            for plant in _runner_plants(engine)
        ],
        axis=1,
    )
    charge, loss = (
        np.array([[float(np.mean(getattr(cycle, name))) for cycle in row] for row in cycles])
        for name in ("air_charge", "pumping_loss")
    )
    dataset = xr.Dataset(
        {
            **variables(each, charge, loss),
            **variables(each, at_common[0], at_common[1], suffix="_at_common_lift"),
            "delivered_lift": ("closing", delivered, {"units": "mm"}),
            "shut": ("closing", durations, {"units": "deg", "long_name": "end of the seating"}),
            "cylinder_pressure": (
                (*each, "crank_angle"),
                np.array([[trace.cylinder_pressure[intake, 0] for trace in row] for row in traces]),
                {"units": "Pa", "long_name": "pressure of the first cylinder"},
            ),
            "volume": ("crank_angle", traces[0][0].volume[intake, 0], {"units": "m3"}),
        },
        coords={
            "runner": ["without", "with"],
            "closing": ("closing", closings, {"units": "deg"}),
            "crank_angle": ("crank_angle", angle[intake], {"units": "deg"}),
        },
        attrs={
            "speed_rpm": speed,
            "lift_mm": float(lift_mm),
            "common_lift_mm": common,
            "exhaust_pressure": engine.exhaust_pressure,
        },
    )
    claims, words = loop_words(dataset)
    return LoopComparison("Figure 13", dataset, claims, words)


def figure_14(
    engine: Engine | None = None,
    *,
    lift_mm: float = 7.0,
    closing_deg: float = 180.0,
    speeds_rpm: Sequence[float] = SPEEDS_RPM,
    runner: bool = True,
) -> MotionComparison:
    """Charge and loss over speed, with the simplified and the oscillating valve motion.

    Parameters
    ----------
    engine : Engine, optional
        The paper's by default.
    lift_mm, closing_deg : float
        Lift and closing timing at every speed.
    speeds_rpm : sequence of float
        Speeds, rising.
    runner : bool
        Whether the runners resonate, for both motions.

    Raises
    ------
    ParameterError
        If lift, closing timing or a speed is out of range, the speeds do not rise, or the lift
        can be driven at none of them.
    """
    import xarray as xr

    engine = Engine.paper() if engine is None else engine
    speeds = grid("speeds_rpm", speeds_rpm)
    positive("speeds_rpm", float(speeds[0]), "rpm")
    closing = positive("closing_deg", closing_deg, "deg")
    runner = truth("runner", runner)
    plants = [
        CrankAnglePlant(engine, runner=runner, oscillation=oscillation)
        for oscillation in (False, True)
    ]
    duration = closing + seating_deg(engine, speeds)
    lift = np.full(speeds.shape, checked_lift(engine, "lift_mm", lift_mm))
    charge, loss, reached = sweep(plants, speeds, lift, duration)
    dataset = xr.Dataset(
        {
            **variables(("motion", "speed"), charge, loss),
            "reached": ("speed", reached, {"units": "1"}),
        },
        coords={
            "motion": ["simplified", "oscillating"],
            "speed": ("speed", speeds, {"units": "rpm"}),
        },
        attrs={
            "lift_mm": float(lift_mm),
            "closing_deg": closing,
            "runner": "with" if runner else "without",
        },
    )
    claims, words = motion_words(dataset)
    return MotionComparison("Figure 14", dataset, claims, words)


def _runner_dataset(
    engine: Engine | None,
    speed_rpm: float,
    lift_mm: float,
    closing_deg: float,
    lifts_mm: Sequence[float] | None,
    closings_deg: Sequence[float],
) -> xr.Dataset:
    """Charge and loss of both plants over lift and over closing timing."""
    import xarray as xr

    engine = Engine.paper() if engine is None else engine
    highest = engine.valvetrain.maximum_lift_mm
    if lifts_mm is None:
        steps = round((highest - LOWEST_LIFT_MM) / LIFT_STEP_MM)
        lifts_mm = np.linspace(LOWEST_LIFT_MM, highest, max(steps, 1) + 1).tolist()
    lifts, closings = grid("lifts_mm", lifts_mm), grid("closings_deg", closings_deg)
    for lift in (lifts[0], lifts[-1]):
        checked_lift(engine, "lifts_mm", float(lift))
    fixed_lift = checked_lift(engine, "lift_mm", lift_mm)
    fixed_closing = positive("closing_deg", closing_deg, "deg")
    positive("closings_deg", float(closings[0]), "deg")
    seating = float(seating_deg(engine, speed_rpm))
    plants = _runner_plants(engine)
    found: dict[str, Any] = {}
    for dim, lift, closing in (
        ("lift", lifts, np.full(lifts.shape, fixed_closing)),
        ("closing", np.full(closings.shape, fixed_lift), closings),
    ):
        speed = np.full(lift.shape, speed_rpm)
        charge, loss, reached = sweep(plants, speed, lift, closing + seating)
        found |= variables(("runner", dim), charge, loss, suffix=f"_over_{dim}")
        found[f"reached_over_{dim}"] = (dim, reached, {"units": "1"})
    shortest = float(shortest_deg(fixed_lift, speed_rpm, engine.valvetrain))
    return xr.Dataset(
        found,
        coords={
            "runner": ["without", "with"],
            "lift": ("lift", lifts, {"units": "mm"}),
            "closing": ("closing", closings, {"units": "deg"}),
        },
        attrs={
            "speed_rpm": speed_rpm,
            "lift_mm": fixed_lift,
            "closing_deg": fixed_closing,
            "earliest_closing_deg": shortest - seating,
            "infeasible": "NaN where the closing timing is too early for the lift",
        },
    )


def _runner_plants(engine: Engine) -> list[CrankAnglePlant]:
    return [CrankAnglePlant(engine, runner=runner) for runner in (False, True)]
