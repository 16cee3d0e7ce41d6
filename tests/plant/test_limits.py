from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import CrankAnglePlant, Engine, ValveCommand, Valvetrain

PAPER = Engine.paper()
GAS = PAPER.gas_constant * PAPER.temperature
FAST = Valvetrain(
    opening_slope_mm_s=1e5,
    closing_slope_mm_s=1e5,
    seating_slope_mm_s=1e4,
    seating_duration=1e-5,
    maximum_lift_mm=100.0,
)


def volume(angle_deg):
    """Eq. 3."""
    return 2e-4 * (1.0 - math.cos(math.radians(angle_deg))) + 4e-5


@pytest.mark.parametrize("profile", ["camless", "conventional"])
def test_a_shut_valve_takes_in_nothing(profile):
    plant = CrankAnglePlant(profile=profile)
    cycle = plant.steady_cycle(1500.0, ValveCommand(0.0, 180.0))
    assert np.all(cycle.air_charge == 0.0)
    assert cycle.throttle_mass == 0.0
    # expanded from TDC to BDC and compressed to the same volume, the loop encloses nothing
    assert cycle.pumping_loss == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.isnan(cycle.specific_pumping_loss))


@pytest.mark.parametrize("closing_deg", [90.0, 150.0, 180.0, 220.0])
def test_a_huge_slow_valve_fills_to_manifold_pressure(closing_deg):
    """Charge is ``p_o V(IVC)/(R T)`` less the ``p_exh V(IVO)/(R T)`` that was there."""
    engine = PAPER.replace(valvetrain=FAST)
    plant = CrankAnglePlant(engine, runner=False)
    full = (1e5 * volume(closing_deg) - 1.1e5 * volume(0.0)) / GAS
    shortfall = []
    for speed in (200.0, 50.0):
        cycle = plant.steady_cycle(speed, ValveCommand(30.0, closing_deg))
        shortfall.append(np.max(np.abs(cycle.air_charge / full - 1.0)))
    assert shortfall[0] < 5e-3
    # the time of the closing valve is a share of the cycle that falls with the speed
    assert shortfall[1] < 0.3 * shortfall[0]


def test_a_huge_slow_valve_has_the_loss_of_the_exhaust_overpressure():
    """At ``p_o`` from TDC to BDC, then isothermal compression to ``p_exh``."""
    plant = CrankAnglePlant(PAPER.replace(valvetrain=FAST), runner=False)
    cycle = plant.steady_cycle(50.0, ValveCommand(30.0, 180.0))
    bottom = volume(180.0)
    swept = (1.1e5 - 1e5) * (bottom - volume(0.0))
    end = bottom * 1e5 / 1.1e5
    compression = 1.1e5 * (end - bottom) - 1e5 * bottom * math.log(end / bottom)
    assert cycle.pumping_loss == pytest.approx(swept + compression, rel=1e-3)


def test_a_choked_valve_passes_its_sonic_flow():
    """A valve far too small: while choked, the mass grows by the area-time integral (Eq. 14)."""
    engine = PAPER.replace(flow_coefficient=1e-5)
    command = ValveCommand(5.0, 120.0, 60.0)
    plant = CrankAnglePlant(engine, runner=False, resolution=8.0)
    trace = plant.steady_cycle(1000.0, command).trace
    choked = (trace.cylinder_pressure[:, 0] < 0.5 * trace.manifold_pressure) & (
        trace.lift_mm[:, 0] > 0.0
    )
    first, last = np.flatnonzero(choked)[[0, -1]]
    assert np.all(choked[first : last + 1])
    assert last - first > 50
    mass = trace.cylinder_pressure[:, 0] * trace.volume[:, 0] / GAS
    angle = np.linspace(trace.crank_angle_deg[first], trace.crank_angle_deg[last], 20001)
    lift = plant.valve_profile(command, 1000.0).lift_mm(angle)
    area_time = 1e-5 * np.trapezoid(lift, angle / 6000.0)
    assert mass[last] - mass[first] == pytest.approx(area_time, rel=1e-3)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    lift=st.floats(0.5, 8.0),
    closing=st.floats(90.0, 300.0),
    opening=st.floats(-30.0, 40.0),
    speed=st.floats(750.0, 6000.0),
    throttle=st.floats(15.0, 90.0),
    profile=st.sampled_from(["camless", "conventional"]),
)
def test_no_cylinder_is_fuller_than_the_manifold_allows(
    lift, closing, opening, speed, throttle, profile
):
    """Without runner, flow goes in only below manifold pressure, and never empties a cylinder."""
    plant = PLANTS[profile]
    command = ValveCommand(lift, closing - opening, opening)
    cycle = plant.steady_cycle(speed, command, throttle, on_infeasible="limit", tolerance=1e-6)
    initial = 1.1e5 * volume(opening) / GAS
    highest = np.max(cycle.trace.manifold_pressure) * volume(180.0) / GAS
    assert np.all(cycle.air_charge <= max(1.001 * highest - initial, 1e-9))
    assert np.all(cycle.air_charge > -initial)


PLANTS = {p: CrankAnglePlant(runner=False, profile=p) for p in ("camless", "conventional")}
