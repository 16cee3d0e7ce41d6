"""Valve motion of least pumping loss for an air charge and speed: a certified optimum of the maps.

Among the motions that give a charge at a speed, the one of least pumping loss is sought with
CasADi and IPOPT on the maps of the mean-value plant. What comes back carries the proof: the
gradient of the Lagrangian, the violation of the constraints, the multipliers and the constraints
that are active. The laws of Part II are not public; this is this project's own design.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from plant import ValveCommand
from plant._checks import in_range, positive, replace_fields
from plant.errors import ParameterError
from plant.region import OperatingRegion

if TYPE_CHECKING:
    from plant import Engine, MeanValuePlant

OPTIMALITY = 1e-6  # largest gradient, violation and complementarity of an optimum, all scaled
_EVENT_CLEARANCE_DEG = 10.0  # by which an event ends before the next but one begins


@dataclass(frozen=True, slots=True)
class FeedforwardOptions:
    """Limits and weights of the optimal feedforward.

    Raises
    ------
    ParameterError
        If a value is out of its range or the range of lifts is empty.
    """

    lowest_lift_mm: float = 0.5  # mm, limit of the actuator
    highest_lift_mm: float = 8.0  # mm, limit of the actuator
    longest_duration_deg: float = 240.0  # deg; less where events would overlap too much
    latest_seating_deg: float | None = None  # deg after intake TDC, by which the valve has seated
    least_dwell: float = 0.0  # s, from the end of the rise to the start of the fall, at least
    lowest_charge_share: float = 0.1  # 1, lowest demand over ambient density times displacement
    least_authority: float = 5e-4  # 1/deg, slope of charge over duration per ambient charge
    lift_energy_weight: float = 0.0  # J/mm2, cost of the square of the lift
    lift_move_weight: float = 0.0  # J/mm2, cost of the square of the distance from a lift at rest
    reference_lift_mm: float | None = None  # mm, that lift at rest; None is the highest one
    steepest_lift_mm: float = 300.0  # mm, slope of a path's lift over charge per ambient charge
    steepest_over_speed_mm: float = 100.0  # mm, slope of a path's lift over ln(speed)

    def __post_init__(self) -> None:
        positive("lowest_lift_mm", self.lowest_lift_mm, "mm")
        in_range(
            "highest_lift_mm",
            self.highest_lift_mm,
            self.lowest_lift_mm,
            float("inf"),
            "mm",
            open_low=True,
            remedy="it must exceed lowest_lift_mm",
        )
        in_range(
            "longest_duration_deg", self.longest_duration_deg, 0.0, 360.0, "deg", open_low=True
        )
        if self.latest_seating_deg is not None:
            in_range(
                "latest_seating_deg", self.latest_seating_deg, 0.0, 360.0, "deg", open_low=True
            )
        in_range("least_dwell", self.least_dwell, 0.0, float("inf"), "s")
        in_range("lowest_charge_share", self.lowest_charge_share, 0.01, 0.9, "1")
        in_range("least_authority", self.least_authority, 0.0, 0.1, "1/deg", open_low=True)
        in_range("lift_energy_weight", self.lift_energy_weight, 0.0, float("inf"), "J/mm2")
        in_range("lift_move_weight", self.lift_move_weight, 0.0, float("inf"), "J/mm2")
        positive("steepest_lift_mm", self.steepest_lift_mm, "mm")
        positive("steepest_over_speed_mm", self.steepest_over_speed_mm, "mm")
        if self.reference_lift_mm is not None:
            in_range(
                "reference_lift_mm",
                self.reference_lift_mm,
                self.lowest_lift_mm,
                self.highest_lift_mm,
                "mm",
                remedy="choose a lift within the actuator's limits",
            )

    def replace(self, **changes: Any) -> Self:
        """Return a copy with the given fields changed."""
        return replace_fields(self, changes)

    @property
    def rest_lift_mm(self) -> float:
        """Lift in mm from which moves are counted."""
        return self.highest_lift_mm if self.reference_lift_mm is None else self.reference_lift_mm

    def longest_deg(self, engine: Engine, region: OperatingRegion) -> float:
        """Longest duration in deg: option, seating limit, overlap and map, whichever is least.

        The valve opens at TDC, so a latest crank angle of seating is a longest duration. No more
        than two events overlap: a duration stays 10 deg below twice ``720/n``.
        """
        limits = [
            self.longest_duration_deg,
            2.0 * 720.0 / engine.n_cylinders - _EVENT_CLEARANCE_DEG,
            region.longest_deg,
        ]
        if self.latest_seating_deg is not None:
            limits.append(self.latest_seating_deg)
        return min(limits)

    def require(self, maps: MeanValuePlant) -> None:
        """Check that the maps cover the lifts.

        Raises
        ------
        ParameterError
            If they do not.
        """
        low, high = maps.region.lowest_lift_mm, maps.region.highest_lift_mm
        for name in ("lowest_lift_mm", "highest_lift_mm"):
            in_range(name, getattr(self, name), low, high, "mm", remedy="the range of the maps")

    def penalty(self, lift_mm: Any) -> Any:
        """Cost of a lift in J per event, beside the pumping loss (numbers, arrays or symbols)."""
        moved = lift_mm - self.rest_lift_mm
        return self.lift_energy_weight * lift_mm**2 + self.lift_move_weight * moved**2


@dataclass(frozen=True, slots=True)
class OptimalityCertificate:
    """First-order proof of an optimum (Karush, Kuhn, Tucker).

    All is scaled: cost by its value at the optimum, charge by the demand, lift by the highest
    one, duration by the longest one, authority by its bound.
    """

    gradient: float  # 1, largest element of the Lagrangian's gradient
    violation: float  # 1, largest violation of a constraint
    complementarity: float  # 1, largest product of a multiplier and its slack
    status: str  # as IPOPT words it
    iterations: int
    multipliers: Mapping[str, float]  # 1, of each constraint; 0 where it is not active
    active: tuple[str, ...]  # names of the inequalities that bind

    @property
    def optimal(self) -> bool:
        """Whether the first-order conditions hold to `OPTIMALITY`."""
        return max(self.gradient, self.violation, self.complementarity) <= OPTIMALITY

    def __str__(self) -> str:
        """Return the proof in a sentence."""
        binding = ", ".join(self.active) or "none"
        return (
            f"{'optimal' if self.optimal else 'NOT optimal'} ({self.status}, "
            f"{self.iterations} iterations): gradient {self.gradient:.1e}, violation "
            f"{self.violation:.1e}, complementarity {self.complementarity:.1e}; active: {binding}"
        )


@dataclass(frozen=True, slots=True)
class OptimalMotion:
    """Valve motion of least cost for a charge at a speed."""

    charge: float  # kg per event
    speed_rpm: float  # rpm
    lift_mm: float  # mm
    duration_deg: float  # deg
    loss: float  # J per event, pumping loss of the map
    cost: float  # J per event, loss and penalties
    marginal_cost: float  # J/kg, growth of the cost with the demanded charge
    certificate: OptimalityCertificate

    @property
    def optimal(self) -> bool:
        """Whether the certificate holds."""
        return self.certificate.optimal

    @property
    def command(self) -> ValveCommand:
        """Valve command; the valve opens at TDC."""
        return ValveCommand(self.lift_mm, self.duration_deg)

    def __str__(self) -> str:
        """Return the motion and its proof."""
        return (
            f"{1e6 * self.charge:.1f} mg at {self.speed_rpm:g} rpm: {self.lift_mm:.3f} mm for "
            f"{self.duration_deg:.2f} deg, {self.loss:.3f} J per event; {self.certificate}"
        )


def optimal_motion(
    maps: MeanValuePlant,
    charge: float,
    speed_rpm: float,
    options: FeedforwardOptions | None = None,
    guess: float | None = None,
) -> OptimalMotion:
    """Valve motion of least pumping loss that gives a charge at a speed.

    Minimises the pumping loss of the maps, with the options' penalties, over lift and duration.
    Constraints: the charge; the actuator's lifts; a profile that can be driven, with at least the
    dwell asked for; the longest duration; and the early-closing branch, on which charge rises
    with duration by at least the authority asked for.

    Parameters
    ----------
    maps : MeanValuePlant
        Maps of charge and loss.
    charge : float
        Demanded charge, kg per event.
    speed_rpm : float
        Engine speed.
    options : FeedforwardOptions, optional
        Limits and weights.
    guess : float, optional
        Lift in mm to start from; the minimum next to it is found. By default the lifts are
        scanned and the least of all minima is found.

    Raises
    ------
    ParameterError
        If the speed is out of the maps' range, or no motion within the limits gives the charge.

    Examples
    --------
    >>> motion = optimal_motion(maps, 250e-6, 1500.0)  # doctest: +SKIP
    """
    import numpy as np

    from ._path_problem import motion_problem
    from ._path_scan import scan

    options = FeedforwardOptions() if options is None else options
    options.require(maps)
    charge = positive("charge", charge, "kg", remedy="give the charge of an event in kg")
    region = maps.region
    speed = in_range(
        "speed_rpm", speed_rpm, region.lowest_speed_rpm, region.highest_speed_rpm, "rpm"
    )
    found = scan(maps, options, np.array([speed]), np.array([[charge]]))
    cost = found.cost[0, 0]
    if not np.isfinite(cost).any():
        low, high = found.reach()
        raise ParameterError(
            f"charge is {1e6 * charge:.2f} mg, but at {speed:g} rpm the motions within the limits "
            f"give {1e6 * float(low[0]):.2f} to {1e6 * float(high[0]):.2f} mg: change the charge, "
            "the speed or the options"
        )
    if guess is None:
        start = int(np.argmin(cost))
    else:
        guess = in_range("guess", guess, options.lowest_lift_mm, options.highest_lift_mm, "mm")
        distance = np.abs(found.lifts_mm - guess)
        start = int(np.argmin(np.where(np.isfinite(cost), distance, np.inf)))
    problem = motion_problem(maps, options)
    return problem.solve(
        charge, speed, float(found.lifts_mm[start]), float(found.duration_deg[0, 0, start])
    )
