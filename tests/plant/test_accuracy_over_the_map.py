"""The accuracy that `CrankAnglePlant` promises, over its whole range.

At 240 points spread over the feasible map, the kernel's periodic cycle is held against a general
solver's at a tight tolerance, on the right-hand side that `test_right_hand_side.py` holds
against the second integrator.
"""

import pytest

from camless_ctrl.bench.points import CHARGE_BAR, LOSS_BAR, BenchPoint, random_points
from camless_ctrl.bench.reference import solve_reference
from plant import ValveCommand

POINTS = random_points(240, seed=7, cylinders=(4,))
# Where the flow turns round while the valve falls, opens far from TDC, or closes at the end.
HARD = [
    BenchPoint(825.0, ValveCommand(6.86, 329.3, 30.6), 30.5, runner=False),
    BenchPoint(5720.0, ValveCommand(4.54, 246.2, 56.6)),
    BenchPoint(1601.0, ValveCommand(5.21, 134.3, -56.2), profile="conventional"),
    BenchPoint(5260.0, ValveCommand(7.52, 149.6, -18.5), 45.4, oscillation=True),
]


def test_points_reach_all_that_the_plant_has():
    assert {p.profile for p in POINTS} == {"camless", "conventional"}
    assert {p.oscillation for p in POINTS} == {p.runner for p in POINTS} == {True, False}
    assert sum(p.throttle_deg < 90.0 for p in POINTS) >= 30
    assert sum(p.command.duration_deg > 180.0 for p in POINTS) >= 60  # overlap
    assert sum(p.command.opening_deg < -5.0 for p in POINTS) >= 10
    assert sum(p.command.opening_deg > 5.0 for p in POINTS) >= 10
    assert min(p.speed_rpm for p in POINTS) < 800.0
    assert max(p.speed_rpm for p in POINTS) > 5900.0


@pytest.mark.parametrize("part", range(8))
def test_charge_and_loss_meet_the_bars_at_every_point(part):
    missed = []
    for point in [*POINTS[part::8], *HARD[part : part + 1]]:
        cycle = point.cycle()
        errors = solve_reference(point).errors(cycle.air_charge, cycle.pumping_loss)
        if not (errors[0] <= CHARGE_BAR and errors[1] <= LOSS_BAR):
            missed.append(f"{point}: charge {errors[0]:.1e}, loss {errors[1]:.1e}")
    assert not missed
