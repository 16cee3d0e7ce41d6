"""Chapter: the throttled engine beside the camless one, and the pumping work that is saved."""

from __future__ import annotations

from camless_ctrl.assessment import assess_throttle_steps
from plant import (
    CrankAnglePlant,
    PumpingComparison,
    compare_pumping,
    throttle_step,
)

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Number, Table, Text
from .feedforward import throttled_plant
from .maps import mean_value_plant

STEPS = ((1500.0, (20.0, 40.0, 20.0)), (1500.0, (25.0, 90.0, 25.0)), (5000.0, (25.0, 90.0, 25.0)))
SPEEDS_RPM = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)
PUBLISHED_CHARGE = 171e-6  # kg, Figure 5
PUBLISHED_LIFT_MM = 2.0
PUBLISHED_SPEED_RPM = 1500.0
PUBLISHED_SAVING = 0.74
_SHARES = (0.1, 0.25, 0.5, 0.75, 0.9)  # of the largest common charge


class ThrottledChapter:
    """Figure 5 over the whole load range, and the throttled plant's own check."""

    id = "throttled"
    title = "Against the throttled engine"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Identify the throttled plant, step its throttle, and compare pumping losses."""
        cam = CrankAnglePlant(context.engine, profile="conventional")
        throttled = throttled_plant(context)
        comparison = compare_pumping(mean_value_plant(context), throttled, speeds_rpm=SPEEDS_RPM)
        point = comparison.saving_at(
            PUBLISHED_CHARGE, PUBLISHED_SPEED_RPM, lift_mm=PUBLISHED_LIFT_MM
        )
        least = comparison.saving_at(PUBLISHED_CHARGE, PUBLISHED_SPEED_RPM)
        steps = [
            throttle_step(cam, throttled, throttles_deg=angles, speed_rpm=speed)
            for speed, angles in STEPS
        ]
        found = assess_throttle_steps(steps)
        numbers = {
            "saving": Number(100.0 * point.saving, "%"),
            "least_saving": Number(100.0 * least.saving, "%"),
            "printed_saving": Number(100.0 * PUBLISHED_SAVING, "%"),
        }
        return ChapterResult(
            finding=Text(
                "At the load of the paper's Figure 5 the camless engine saves {saving:.0f} of the "
                "throttled engine's pumping work (printed: {printed_saving:.0f}), and "
                "{least_saving:.0f} with the lift of least loss.",
                **numbers,
            ),
            blocks=[
                Text(
                    "The throttled engine has the conventional cam of section 4; its charge is a "
                    "map of manifold pressure and speed, its manifold fills through the throttle. "
                    "At {charge:.0f} and {speed:.0f} it needs a throttle angle of {angle:.1f} and "
                    "loses {theirs:.1f}; the camless engine loses {ours:.2f} at {lift:.0f} and "
                    "{best:.2f} at the lift of least loss, {best_lift:.1f}. The paper prints 17° "
                    "and 13.8 J for the throttled engine: Eq. 19 does not pass the flow at 17°.",
                    charge=Number(1e6 * PUBLISHED_CHARGE, "mg"),
                    speed=Number(PUBLISHED_SPEED_RPM, "rpm"),
                    angle=Number(point.throttle_deg, "°"),
                    theirs=Number(point.throttled_loss, "J"),
                    ours=Number(point.camless_loss, "J"),
                    lift=Number(PUBLISHED_LIFT_MM, "mm"),
                    best=Number(least.camless_loss, "J"),
                    best_lift=Number(least.lift_mm, "mm"),
                ),
                Figure(
                    "pumping",
                    Text(
                        "Pumping loss of both engines over the load range, and what the camless "
                        "one saves: most at light load, little near full load, where neither is "
                        "throttled."
                    ),
                    "Pumping loss against charge for both engines, and the saving, at five speeds.",
                    context.draw(comparison.plot()),
                ),
                _table(comparison),
                Figure(
                    "step",
                    Text(
                        "Throttle step from 25° to wide open and back at {step_speed:.0f}: the "
                        "manifold pressure of the throttled mean-value plant stays within "
                        "{step_rms:.2f} rms of the full plant's after each step.",
                        step_speed=Number(steps[1].speed_rpm, "rpm"),
                        step_rms=Number(100.0 * float(steps[1].rms_each.max()), "%"),
                    ),
                    "Manifold pressure of both plants in a throttle step.",
                    context.draw(steps[1].plot()),
                ),
            ],
            requirements=found,
        )


def _table(comparison: PumpingComparison) -> Table:
    rows: list[list[Cell]] = []
    for speed in SPEEDS_RPM:
        known = comparison.data["saving"].sel(speed_rpm=speed).dropna("charge")
        largest = float(known["charge"].max())
        savings = [comparison.saving_at(share * largest, speed).saving for share in _SHARES]
        rows.append([speed, 1e6 * largest, *(100.0 * saving for saving in savings)])
    return Table(
        "savings",
        Text(
            "Pumping work that the camless engine saves at the lift of least loss, at shares of "
            "the largest charge that both engines give."
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("largest charge", "mg", ".0f"),
            *(Column(f"at {100.0 * share:.0f} %", "%", ".0f") for share in _SHARES),
        ],
        rows,
    )
