import numpy as np
import pytest

from camless_ctrl.feedforward import Feedforward
from plant.valve import shortest_duration

SPEED = 1500.0


class Wavy:
    """Charge that rises, falls back between 90 and 110 deg, and rises on."""

    def air_charge(self, lift_mm, duration_deg, speed_rpm, /):
        return 1e-6 * np.interp(duration_deg, [0.0, 90.0, 110.0, 180.0], [0.0, 180.0, 160.0, 300.0])


class Curved:
    """Charge of ``d^2/100`` mg at ``d`` deg."""

    def air_charge(self, lift_mm, duration_deg, speed_rpm, /):
        return 1e-8 * np.asarray(duration_deg) ** 2


def test_promised_charge_of_a_line(linear_map):
    feedforward = Feedforward(linear_map)
    for duration in (30.0, 77.7, 120.0, 180.0):
        promised = feedforward.charge_at(duration, SPEED)
        assert promised == pytest.approx(2e-6 * (duration - 20.0), rel=1e-9)
        assert feedforward.sensitivity(promised, SPEED) == pytest.approx(2e-6, rel=1e-9)


def test_promised_charge_of_a_curve_and_its_slope():
    feedforward = Feedforward(Curved())
    for duration in (40.0, 111.1, 165.0):
        promised = feedforward.charge_at(duration, SPEED)
        # Between two of 256 durations, 0.62 deg apart, a chord is above by step^2/8 p''.
        assert 0.0 <= promised / (1e-8 * duration**2) - 1.0 < 0.62**2 / 4.0 / duration**2 + 1e-12
        assert feedforward.sensitivity(promised, SPEED) == pytest.approx(2e-8 * duration, rel=1e-3)


@pytest.mark.parametrize("charge_map", [Wavy(), Curved()])
def test_promised_charge_inverts_the_command(charge_map):
    feedforward = Feedforward(charge_map)
    for charge in (5e-5, 1e-4, 1.79e-4, 1.9e-4, 2.8e-4):
        forward = feedforward.command(charge, SPEED)
        assert not forward.limited
        assert feedforward.charge_at(forward.command.duration_deg, SPEED) == pytest.approx(
            charge, rel=1e-12
        )


def test_promised_charge_never_falls_with_duration():
    # Where the charge falls back the first rise to it counts, and the branch goes on from there.
    feedforward = Feedforward(Wavy())
    durations = np.linspace(30.0, 180.0, 301)
    promised = np.array([feedforward.charge_at(d, SPEED) for d in durations])
    assert np.all(np.diff(promised) > 0.0)
    assert feedforward.charge_at(70.0, SPEED) == pytest.approx(1.4e-4, rel=1e-9)
    assert feedforward.charge_at(100.0, SPEED) == pytest.approx(1.8e-4, rel=0.02)  # not 1.7e-4
    assert feedforward.charge_at(150.0, SPEED) == pytest.approx(2.4e-4, rel=1e-9)


def test_promised_charge_is_held_beyond_the_branch(linear_map):
    feedforward = Feedforward(linear_map, longest_duration_deg=150.0)
    assert feedforward.charge_at(179.0, SPEED) == pytest.approx(2.6e-4, rel=1e-9)
    shortest = 6.0 * SPEED * shortest_duration(3.0, feedforward.valvetrain)  # 3 mm at 1500 rpm
    promised = Feedforward(Curved()).charge_at(5.0, SPEED)
    assert promised == pytest.approx(1e-8 * shortest**2, rel=1e-5)
    # What is held is what the command reaches at most.
    assert feedforward.charge_at(179.0, SPEED) == feedforward.command(1.0, SPEED).charge
