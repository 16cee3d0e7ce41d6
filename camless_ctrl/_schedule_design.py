"""Result of a gain synthesis over speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .adaptation import GainSchedule
from .estimator import ChargeEstimator
from .estimator_response import LatentEstimator

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .gain_synthesis import GainDesign

_EDGE = 0.02  # relative width in speed over which a schedule lets go of the differences


@dataclass(frozen=True)
class ScheduleDesign:
    """Fastest robust gains over speed, against a schedule in use.

    At each speed they are as large as robustness allows. Between the speeds the gains are
    interpolated and nothing is proved: give more speeds, or a smaller limit of mu.

    Attributes
    ----------
    designs : tuple of GainDesign
        One a speed, rising.
    present : GainSchedule
        Schedule to compare with.
    present_mu : tuple of float
        Largest mu for robust performance of its gains at each speed.
    estimators : tuple of (LatentEstimator, float)
        Estimators that were compared, with the sum of the time constants over all speeds that
        each allows, cycles; infinite where another one holds the differences at fewer speeds.
    """

    designs: tuple[GainDesign, ...]
    present: GainSchedule
    present_mu: tuple[float, ...]
    estimators: tuple[tuple[LatentEstimator, float], ...]

    @property
    def estimator(self) -> LatentEstimator:
        """Estimator of the designs."""
        return self.designs[0].measurement.estimator

    @property
    def schedule(self) -> GainSchedule:
        """Gains over speed.

        From a speed with imbalance gain to one without it falls to zero at once, within 2 % of
        the speed: in between nothing is known to be robust.
        """
        nodes = [(d.speed_rpm, d.gains.mean, d.gains.imbalance) for d in self.designs]
        speeds, means, _ = (np.array(column) for column in zip(*nodes, strict=True))
        for k in range(len(nodes) - 1):
            here, after = nodes[k][2], nodes[k + 1][2]
            if (here == 0.0) != (after == 0.0):
                edge = (1.0 + _EDGE) * nodes[k][0] if here else (1.0 - _EDGE) * nodes[k + 1][0]
                nodes.append((edge, float(np.interp(edge, speeds, means)), 0.0))
        nodes.sort()
        speed, mean, imbalance = zip(*nodes, strict=True)
        return GainSchedule(speed, mean, imbalance)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw both gains over speed, designed and present."""
        from plant._plotting import COLOURS, axes, styled

        schedule = self.schedule
        with styled():
            ax = axes(ax)
            for gains, style, what in (
                (schedule, "-", "designed"),
                (self.present, "--", "present"),
            ):
                for k, name in enumerate(("mean", "imbalance")):
                    ax.plot(
                        gains.speed_rpm,
                        getattr(gains, name),
                        style,
                        marker="os"[k],
                        ms=4,
                        c=COLOURS[k],
                        label=f"{name}, {what}",
                    )
            ax.set_ylim(bottom=0.0)
            ax.set_xlabel("speed (rpm)")
            ax.set_ylabel("gain per cycle (1)")
            ax.set_title("Fastest gains with robust performance")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return a row a speed: gains, settling and mu, and mu of the present gains."""
        lines = [
            f"Fastest gains per cycle with robust performance (estimator: {_told(self.estimator)})",
            "   rpm   mean  imbalance  settled after (cycles)     mu | present  imbalance     mu",
        ]
        for design, mu in zip(self.designs, self.present_mu, strict=True):
            mean, imbalance = design.settling_cycles
            present = self.present.at(design.speed_rpm)
            settled = f"{mean:.1f}, " + ("held" if design.held else f"{imbalance:.1f}")
            lines.append(
                f"{design.speed_rpm:6g}  {design.gains.mean:5.3f}  {design.gains.imbalance:9.3f}  "
                f"{settled:>22}  {design.mu_performance:5.3f} | {present.mean:7.3f}  "
                f"{present.imbalance:9.3f}  {mu:5.3f}" + (" NOT robust" if mu >= 1.0 else "")
            )
        return "\n".join(lines)


def _told(estimator: LatentEstimator) -> str:
    """What tells estimators apart."""
    if isinstance(estimator, ChargeEstimator):
        return f"delay {1e3 * estimator.delay:g} ms, taper {1e3 * estimator.taper:g} ms"
    return str(estimator)
