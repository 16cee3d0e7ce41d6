"""Robustness of a loop at one speed, with what confirmed it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .disk_margins import DiskMargins
from .gain_break import GainBreak
from .gang_of_four import GangOfFour
from .soundness import LtiCheck, SampledPlantRun
from .structured_robustness import StructuredRobustness
from .tightness import TightnessCheck
from .uncertain_measurement import UncertainMeasurement


@dataclass(frozen=True)
class SpeedAnalysis:
    """Robustness of the loop at one speed, and what confirmed it.

    Attributes
    ----------
    structured : StructuredRobustness
        Structured singular value and worst case.
    gang : GangOfFour
        Sensitivity functions of the loop with the nominal sensor.
    margins : DiskMargins
        Margins of it, per mode, of one cylinder and of all.
    lti : LtiCheck or None
        Linear members of the set; None if it was not confirmed.
    plants : tuple of SampledPlantRun
        Sampled full plants in closed loop.
    tightness : TightnessCheck or None
        Full plant along the worst direction; None if it was not asked for or not possible.
    gain_break : GainBreak or None
        Gains at which a designed controller breaks; None as for `tightness`.
    untested : str
        Why the worst direction was not possible, if it was asked for; else empty.
    """

    structured: StructuredRobustness
    gang: GangOfFour = field(repr=False)
    margins: DiskMargins = field(repr=False)
    lti: LtiCheck | None = field(default=None, repr=False)
    plants: tuple[SampledPlantRun, ...] = field(default=(), repr=False)
    tightness: TightnessCheck | None = field(default=None, repr=False)
    gain_break: GainBreak | None = None
    untested: str = ""

    @property
    def speed_rpm(self) -> float:
        """Speed."""
        return self.structured.speed_rpm

    @property
    def measurement(self) -> UncertainMeasurement:
        """Uncertain measurement at the speed."""
        return self.structured.loop.measurement

    @property
    def plant_violations(self) -> int:
        """Sampled full plants that are unstable or beyond the bound of their speed."""
        return sum(run.violation for run in self.plants)

    def record(self) -> dict[str, Any]:
        """Return the figures, for a JSON file."""
        found = self.structured.record()
        margins = self.margins
        one = min(margins.one_at_a_time, key=lambda m: m.alpha) if margins.stable else None
        confirmed: dict[str, Any] = {}
        t, coverage = self.tightness, self.measurement.coverage
        if self.lti is not None:
            confirmed = {
                "sampled_lti": self.lti.samples,
                "violations_lti": self.lti.violations,
                "sampled_plant": len(self.plants),
                "violations_plant": self.plant_violations,
                "predicted_margin": None if t is None else t.predicted,
                "simulated_margin": None if t is None else t.simulated,
                "gain_factor": None if t is None else t.gain_factor,
                "gain_break": None
                if self.gain_break is None
                else {
                    "predicted": self.gain_break.predicted,
                    "simulated": self.gain_break.simulated,
                },
                "untested": self.untested,
            }
        return {
            "speed_rpm": self.speed_rpm,
            "demand_mg": 1e6 * self.measurement.demand,
            "stable": self.structured.stable,
            "robustly_stable": self.structured.robustly_stable,
            "robust_performance": self.structured.robust_performance,
            "modes": [
                {
                    "q": m.q,
                    "disk_margin": m.disk.alpha,
                    "gain_margin": m.classical.gain_margin,
                    "phase_margin_deg": m.classical.phase_margin_deg,
                    "peak_sensitivity": self.gang.peak("S", m.q).value,
                }
                for m in margins.modes
            ],
            "disk_margin": {
                "one_cylinder": one.alpha if one else float("nan"),
                "all_cylinders": margins.all_loops.alpha,
                "delay_s": margins.delay.sensor_delay,
                "delay_events": margins.delay.events,
            },
            "mu": {k: v for k, v in found.items() if k != "worst_case_gain"},
            "worst_case_gain": found["worst_case_gain"],
            "coverage": None if coverage is None else coverage.to_dict(),
            "beyond_reach": self.measurement.beyond_reach,
            "confirmed": confirmed,
        }

    def __str__(self) -> str:
        """Return the verdict and what confirmed it."""
        lines = [str(self.structured)]
        coverage = self.measurement.coverage
        if coverage is not None and not coverage.consistent:
            lines.append(f"  BUT the description of the set is in doubt: {coverage}")
        if self.lti is not None:
            told = (
                "contradict it"
                if self.structured.robust_performance
                else f"are unstable or beyond |S| = {self.lti.bound:.2f}"
            )
            lines.append(
                f"  sampled: {self.lti.violations} of {self.lti.samples} linear members and "
                f"{self.plant_violations} of {len(self.plants)} full plants {told}"
            )
        if self.tightness is not None:
            t = self.tightness
            lines.append(
                f"  tight: with gains x {t.gain_factor:.2f} the break is predicted at "
                f"{t.predicted:.2f} times the bounds, the full plant breaks at {t.simulated:.2f}"
            )
        if self.gain_break is not None:
            lines.append(f"  tight: {self.gain_break}")
        if self.untested:
            lines.append(f"  where it breaks was not tried: {self.untested}")
        return "\n".join(lines)
