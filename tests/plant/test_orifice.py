from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant import Throttle
from plant.orifice import exact_flow, simplified_flow

pressures = st.floats(1e3, 5e5)


@pytest.mark.parametrize(
    ("ratio", "flow"),
    [(0.1, 1.0), (0.5, 1.0), (0.8, 0.8), (0.9, 0.6), (0.75, math.sqrt(0.75)), (1.0, 0.0)],
)
def test_simplified_flow_at_points_done_by_hand(ratio, flow):
    """Eq. 14: 2 sqrt(x - x^2), e.g. 2 sqrt(0.16) at 0.8 and 2 sqrt(0.09) at 0.9."""
    assert simplified_flow(ratio * 1e5, 1e5) == pytest.approx(flow, abs=1e-12)
    assert simplified_flow(1e5, ratio * 1e5) == pytest.approx(-flow, abs=1e-12)


@given(p_1=pressures, p_2=pressures)
def test_flow_goes_down_the_pressure_and_turns_round_with_it(p_1, p_2):
    for flow in (simplified_flow, exact_flow):
        assert flow(p_1, p_2) == pytest.approx(-flow(p_2, p_1), abs=1e-12)
        assert np.sign(flow(p_1, p_2)) in (np.sign(p_2 - p_1), 0.0)
    assert abs(float(simplified_flow(p_1, p_2))) <= 1.0


def test_exact_flow_chokes_at_heywoods_critical_ratio():
    """Heywood, appendix C: 0.528 for gamma = 1.4, and 0.546 for 1.3."""
    for gamma, critical in ((1.4, 0.528), (1.3, 0.546)):
        ratio = np.linspace(0.3, 0.9999, 70000)
        flow = exact_flow(ratio * 1e5, 1e5, heat_capacity_ratio=gamma)
        assert ratio[np.flatnonzero(flow < 1.0 - 1e-12)[0]] == pytest.approx(critical, abs=1e-3)
        assert np.max(np.abs(np.diff(flow[ratio < 0.95]))) < 1e-4  # continuous through it
        assert flow[0] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("ratio", [0.6, 0.8, 0.9, 0.95, 0.999])
def test_exact_flow_is_that_of_an_isentropic_nozzle(ratio):
    """Heywood, Eq. C.8 over C.9 for gamma = 1.4, whose sonic flow function is 0.6847."""
    by_hand = ratio ** (5 / 7) * math.sqrt(7.0 * (1.0 - ratio ** (2 / 7))) / 0.684731
    assert exact_flow(ratio * 1e5, 1e5) == pytest.approx(by_hand, rel=1e-6)


def test_exact_flow_scales_with_the_feeding_side():
    assert exact_flow(0.8e5, 2e5) == pytest.approx(2.0 * exact_flow(0.4e5, 1e5), rel=1e-12)
    colder = exact_flow(0.8e5, 1e5, temperature=290.0 / 4.0)
    assert colder == pytest.approx(2.0 * exact_flow(0.8e5, 1e5), rel=1e-12)


def test_approximation_is_within_two_per_cent_of_sonic_flow():
    """Eq. 14 parts from Eq. 11 by 1.9 % of the sonic flow at most, and agrees at both ends."""
    ratio = np.linspace(0.01, 1.0, 100001)
    gap = exact_flow(ratio * 1e5, 1e5) - simplified_flow(ratio * 1e5, 1e5)
    assert 0.018 < np.max(np.abs(gap)) < 0.02
    assert gap[[0, -1]] == pytest.approx(0.0, abs=1e-12)


def test_throttle_area_is_equation_19():
    """0.23 90^2 - 2.275 90 - 0.2215 = 1658.03, times 1.268e-4."""
    throttle = Throttle()
    assert throttle.area(90.0) == pytest.approx(1658.0285 * 1.268e-4, rel=1e-9)
    assert throttle.area(20.0) == pytest.approx((92.0 - 45.5 - 0.2215) * 1.268e-4, rel=1e-9)
    assert throttle.area(throttle.closed_deg) == pytest.approx(0.0, abs=1e-15)
    assert throttle.closed_deg == pytest.approx(9.9878, abs=1e-3)
