"""The claims of Part I on charge, lift and duration, each as a computation.

A claim is a function of the test bench that returns a `Finding`. Its docstring is the
definition that the report shows: what is simulated, what is compared, and the bound. Part I
gives bounds for none of its qualitative claims; those used here are the module's constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ._experiments import Experiments
from .kinematics import FloatArray
from .published import PRINTED_CHARGE_ERROR, PRINTED_LOSS_ERROR, PUBLISHED_POINTS, PublishedClaim

HIGHEST_LIFT_MM = 8.0  # mm, the lift at which charge counts as saturated
SATURATED = 0.98  # 1, share of the charge at HIGHEST_LIFT_MM
SATURATION_TOLERANCE_MM = 0.5  # mm, the printed lifts are multiples of it
LINEAR_BOUND = 0.10  # 1, deviation from the best straight line over the rise along it
PEAK_TOLERANCE_DEG = 10.0  # deg, the cylinder volume is within 1 % of its largest
RESOLVED = 1e-3  # 1, relative change that the plant's accuracy can tell from none

CLOSINGS_DEG = (90.0, 120.0, 150.0, 180.0)  # deg ATDC, where a claim names no closing
PEAK_SPEEDS_RPM = (750.0, 1500.0, 3000.0, 4500.0, 6000.0)


@dataclass(frozen=True, slots=True)
class Measured:
    """A number with its unit."""

    value: float
    unit: str

    def __str__(self) -> str:
        """Return the number and its unit."""
        return f"{self.value:.4g} {self.unit}" if self.unit != "1" else f"{self.value:.4g}"


@dataclass(frozen=True, slots=True)
class Finding:
    """What came of a claim."""

    reproduced: bool
    measured: dict[str, Measured]
    why: str


def saturation(bench: Experiments, claim: PublishedClaim) -> Finding:
    """Lift at which the charge reaches 98 % of that at 8 mm.

    For IVO 0 and IVC 180 deg (seating after it), at the speed of the claim. Reproduced if it
    is within 0.5 mm of the printed lift.
    """
    from scipy.optimize import brentq

    speed, printed = claim.speed_rpm, claim.lift_mm
    assert speed is not None
    assert printed is not None

    def charge(lift: float) -> float:
        return bench.closing_at(speed, lift, 180.0).charge_mg

    full = charge(HIGHEST_LIFT_MM)
    # From the highest lift down, so that the lift found is the one above which all is saturated.
    lifts = np.geomspace(HIGHEST_LIFT_MM, 0.5, 33)
    below = next((k for k, lift in enumerate(lifts) if charge(lift) < SATURATED * full), None)
    if below is None:
        found = float(lifts[-1])
    else:
        found = float(
            brentq(
                lambda lift: charge(float(lift)) - SATURATED * full,
                lifts[below],
                lifts[below - 1],
                xtol=1e-3,
            )
        )
    share = charge(printed) / full
    reproduced = abs(found - printed) <= SATURATION_TOLERANCE_MM
    state = "within" if reproduced else "not within"
    why = (
        f"98 % of the charge at 8 mm is reached at {found:.2f} mm, {state} 0.5 mm of the printed "
        f"{printed:g} mm; at the printed lift the charge is {100 * share:.1f} % of that at 8 mm"
    )
    return Finding(
        reproduced,
        {
            "saturation_lift": Measured(found, "mm"),
            "charge_at_printed_lift_over_charge_at_8_mm": Measured(share, "1"),
        },
        why,
    )


def lift_linear(bench: Experiments, claim: PublishedClaim) -> Finding:
    """Largest deviation of the charge from its best straight line in lift, over the line's rise.

    From 0.5 to 3 mm, where section 5 sees saturation begin, at 1500 rpm, for IVC 90, 120, 150
    and 180 deg (Figure 9). Reproduced if the charge grows all the way and deviates by at most
    10 % at each IVC.
    """
    lifts = np.linspace(0.5, 3.0, 26)
    deviations, qualities, linear_to = [], [], []
    grows = True
    for closing in CLOSINGS_DEG:
        charge = np.array([bench.closing_at(1500.0, lift, closing).charge_mg for lift in lifts])
        grows &= bool(np.all(np.diff(charge) > 0.0))
        deviation, quality = _straightness(lifts, charge)
        deviations.append(deviation)
        qualities.append(quality)
        straight = [
            k
            for k in range(3, lifts.size + 1)
            if _straightness(lifts[:k], charge[:k])[0] <= LINEAR_BOUND
        ]
        linear_to.append(lifts[straight[-1] - 1] if straight else lifts[0])
    worst = max(deviations)
    reproduced = grows and worst <= LINEAR_BOUND
    why = (
        f"the charge {'grows' if grows else 'does not grow'} all the way to 3 mm and deviates "
        f"from a straight line by {100 * min(deviations):.0f} to {100 * worst:.0f} % of its rise "
        f"(bound 10 %): "
        + (
            "it is almost linear"
            if worst <= LINEAR_BOUND
            else f"it bends well before saturation, and is straight within 10 % up to "
            f"{min(linear_to):.1f} mm only"
        )
    )
    return Finding(
        reproduced,
        {
            "largest_deviation_over_rise": Measured(worst, "1"),
            "least_coefficient_of_determination": Measured(min(qualities), "1"),
            "lift_to_which_straight_within_10_percent": Measured(float(min(linear_to)), "mm"),
        },
        why,
    )


def _straightness(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Largest deviation from the least-squares line over its rise, and R squared."""
    slope, intercept = np.polyfit(x, y, 1)
    error = y - (slope * x + intercept)
    rise = abs(slope) * (x[-1] - x[0])
    return float(np.max(np.abs(error)) / rise), float(1.0 - np.var(error) / np.var(y))


def specific_loss_lift(bench: Experiments, claim: PublishedClaim) -> Finding:
    """Change of the specific pumping loss over each step of lift.

    From 0.5 to 8 mm in 24 equal ratios at 1500 rpm, for IVC 90, 120, 150 and 180 deg
    (Figure 10). Reproduced if it falls over every step.
    """
    lifts = np.geomspace(0.5, HIGHEST_LIFT_MM, 25)
    steps, falls = [], []
    for closing in CLOSINGS_DEG:
        loss = np.array([bench.closing_at(1500.0, lift, closing).specific_loss for lift in lifts])
        steps.append(float(np.max(loss[1:] / loss[:-1] - 1.0)))
        falls.append(float(1.0 - loss[-1] / loss[0]))
    largest = max(steps)
    reproduced = largest < 0.0
    why = (
        f"from 0.5 to 8 mm it falls by {100 * min(falls):.0f} to {100 * max(falls):.0f} %, and "
        f"{'over every step' if reproduced else 'not over every step'} (the least favourable "
        f"one changes it by {100 * largest:+.2f} %)"
    )
    return Finding(
        reproduced,
        {
            "largest_change_over_a_step": Measured(largest, "1"),
            "least_fall_from_0.5_to_8_mm": Measured(min(falls), "1"),
        },
        why,
    )


def flow_reversal(bench: Experiments, claim: PublishedClaim) -> Finding:
    """Closing timing at which the charge peaks, at 3 mm (Figure 4) and IVO 0.

    IVC from 60 to 300 deg in steps of 5, the peak refined to 1 deg, at 750, 1500, 3000, 4500
    and 6000 rpm. Reproduced if at 1500 rpm the charge rises over every step up to 180 deg, has
    one peak, within 10 deg of 180 (there the volume is within 1 % of its largest), and falls
    beyond it; and if the peak is later at each higher speed.
    """
    grid = np.arange(60.0, 301.0, 5.0)
    peaks = [_peak(bench, speed, grid) for speed in PEAK_SPEEDS_RPM]
    at_1500 = peaks[PEAK_SPEEDS_RPM.index(1500.0)]
    charge = np.array([bench.closing_at(1500.0, 3.0, closing).charge_mg for closing in grid])
    rises = bool(np.all(np.diff(charge[grid <= 180.0]) > 0.0))
    turns = int(np.sum((np.diff(charge)[:-1] > 0.0) & (np.diff(charge)[1:] <= 0.0)))
    # One peak and an end below it: the charge falls all the way beyond.
    single = turns == 1 and charge[-1] < charge.max()
    near = abs(at_1500 - 180.0) <= PEAK_TOLERANCE_DEG
    later = bool(np.all(np.diff(peaks) > 0.0))
    gain = bench.closing_at(1500.0, 3.0, at_1500).charge_mg / (
        bench.closing_at(1500.0, 3.0, 180.0).charge_mg
    )
    without = _peak(bench, 1500.0, grid, runner=False)
    reproduced = rises and single and near and later
    why = (
        f"at 1500 rpm the charge {'rises' if rises else 'does not rise'} all the way to 180 deg "
        f"and has {'one peak' if single else 'more than one peak or none'}, at {at_1500:.0f} deg, "
        f"{'within' if near else 'not within'} 10 deg of 180, where it is {100 * (gain - 1):.1f} % "
        f"above that at 180 deg (without runners the peak is at {without:.0f} deg); with speed "
        f"the peak {'moves later throughout' if later else 'does not always move later'}, from "
        f"{peaks[0]:.0f} deg at 750 to {peaks[-1]:.0f} deg at 6000 rpm"
    )
    measured = {
        f"peak_closing_at_{speed:g}_rpm": Measured(peak, "deg")
        for speed, peak in zip(PEAK_SPEEDS_RPM, peaks, strict=True)
    }
    measured["peak_closing_at_1500_rpm_without_runner"] = Measured(without, "deg")
    measured["peak_charge_over_charge_at_180_deg"] = Measured(gain, "1")
    measured["peaks_at_1500_rpm"] = Measured(float(turns), "1")
    return Finding(reproduced, measured, why)


def _peak(
    bench: Experiments, speed_rpm: float, grid: FloatArray, *, runner: bool | None = None
) -> float:
    """Closing timing in deg, to 1 deg, at which the charge at 3 mm is largest."""

    def charge(closing: float) -> float:
        return bench.closing_at(speed_rpm, 3.0, closing, runner=runner).charge_mg

    coarse = max(grid, key=charge)
    around = np.arange(max(coarse - 4.0, grid[0]), min(coarse + 4.0, grid[-1]) + 0.5)
    return float(max(around, key=charge))


def backflow(bench: Experiments, claim: PublishedClaim) -> Finding:
    """Port flow from IVO on at the point of Figure 4 (1500 rpm, 3 mm, IVC 180 deg).

    Sampled every 0.1 deg. Reproduced if the flow is out of the cylinder from IVO on for at
    least a sample, and into it later.
    """
    cycle = bench.plant().steady_cycle(
        1500.0, bench.closing_command(1500.0, 3.0, 180.0), on_infeasible="limit"
    )
    trace = cycle.trace_at(0.1)
    after_opening = trace.crank_angle_deg > 0.0
    angle = trace.crank_angle_deg[after_opening]
    flow = trace.port_flow[after_opening, 0]
    inward = np.flatnonzero(flow >= 0.0)
    end = int(inward[0]) if inward.size else flow.size
    reproduced = 0 < end < flow.size and bool(np.max(flow) > 0.0)
    lasts = float(angle[end - 1]) if end else 0.0
    strongest = float(np.min(flow[:end])) if end else 0.0
    mass = float(np.trapezoid(flow[:end], trace.time[after_opening][:end])) if end else 0.0
    why = (
        f"the flow is backward for the first {lasts:.1f} deg, at most {-1e3 * strongest:.1f} g/s, "
        f"and takes {-1e6 * mass:.1f} mg out of the cylinder"
        if reproduced
        else "the flow is not backward at first and forward later"
    )
    return Finding(
        reproduced,
        {
            "backflow_end": Measured(lasts, "deg"),
            "strongest_backflow": Measured(strongest, "kg/s"),
            "mass_returned": Measured(-1e6 * mass, "mg"),
        },
        why,
    )


def validation_error(bench: Experiments, claim: PublishedClaim) -> Finding:
    """Largest error of the simulated cam-driven engine against the measured one (section 4).

    At 1500, 3000 and 4000 rpm. The charge error is relative to the measurement and the loss
    error to the prediction: so taken, and only so, the printed figures themselves (9.6 and
    11.2 %) meet the claim. Reproduced if charge is within 10 % and loss within 11.3 %.
    """
    charge_errors, loss_errors, others = [], [], []
    worst = ""
    for point in PUBLISHED_POINTS:
        if point.measured_charge_mg is None or point.measured_loss_J is None:
            continue
        got = bench.run(point.speed_rpm, point.command, point.throttle_deg, profile=point.profile)
        charge_gap = abs(got.charge_mg - point.measured_charge_mg)
        loss_gap = abs(got.loss_J - point.measured_loss_J)
        charge_errors.append(charge_gap / point.measured_charge_mg)
        loss_errors.append(loss_gap / got.loss_J)
        others.append((charge_gap / got.charge_mg, loss_gap / point.measured_loss_J))
        if loss_errors[-1] == max(loss_errors):
            worst = (
                f"at {point.speed_rpm:g} rpm, where {got.loss_J:.2f} J is simulated, "
                f"{point.loss_J:g} J printed and {point.measured_loss_J:g} J measured"
            )
    charge, loss = max(charge_errors), max(loss_errors)
    charge_holds, loss_holds = charge <= PRINTED_CHARGE_ERROR, loss <= PRINTED_LOSS_ERROR
    why = (
        f"charge is within {100 * charge:.1f} % of the measurement ({_holds(charge_holds)}, bound "
        f"10 %); loss within {100 * loss:.1f} % of the prediction ({_holds(loss_holds)}, bound "
        f"11.3 %), {worst}"
    )
    return Finding(
        charge_holds and loss_holds,
        {
            "largest_charge_error_of_measurement": Measured(charge, "1"),
            "largest_loss_error_of_prediction": Measured(loss, "1"),
            "largest_charge_error_of_prediction": Measured(max(o[0] for o in others), "1"),
            "largest_loss_error_of_measurement": Measured(max(o[1] for o in others), "1"),
        },
        why,
    )


def _holds(value: bool) -> str:
    return "holds" if value else "does not hold"
