from __future__ import annotations

import numpy as np
import pytest

from plant.kinematics import (
    cylinder_angle,
    cylinder_volume,
    degrees_per_second,
    piston_velocity,
    radians_per_second,
)


def test_volume_at_the_dead_centres_and_half_way():
    """Eq. 3 with V_d = 400 and V_cl = 40 cm3."""
    volume = cylinder_volume([0.0, 60.0, 90.0, 180.0, 360.0, 540.0], 4e-4, 4e-5)
    assert volume == pytest.approx([4e-5, 1.4e-4, 2.4e-4, 4.4e-4, 4e-5, 4.4e-4], rel=1e-12)


def test_crank_turns_six_degrees_per_second_and_rpm():
    assert degrees_per_second(1500.0) == pytest.approx(9000.0)
    assert radians_per_second(60.0) == pytest.approx(2.0 * np.pi)


def test_cylinders_follow_one_another_by_720_over_n():
    assert cylinder_angle(0.0, 1, 4) == pytest.approx(540.0)
    assert cylinder_angle([180.0, 900.0], 1, 4) == pytest.approx([0.0, 0.0])
    assert cylinder_angle(100.0, 0, 6) == pytest.approx(100.0)
    assert cylinder_angle(100.0, 5, 6) == pytest.approx(100.0 - 600.0 + 720.0)


def test_piston_is_fastest_half_way_at_half_the_stroke_times_omega():
    """Eq. 7: 2 pi N/120 S sin(theta); 3000 rpm and 88 mm give 13.82 m/s."""
    assert piston_velocity(90.0, 3000.0, 0.088) == pytest.approx(13.823, abs=5e-4)
    assert piston_velocity([0.0, 180.0], 3000.0, 0.088) == pytest.approx(0.0, abs=1e-12)
    angle = np.linspace(0.0, 360.0, 100001)
    travel = np.trapezoid(np.abs(piston_velocity(angle, 3000.0, 0.088)), angle / 18000.0)
    assert travel == pytest.approx(2.0 * 0.088, rel=1e-8)
