from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant import CrankAnglePlant, Engine, ValveCommand
from plant.runner import forcing_amplitude, runner_gain, runner_pressure, runner_velocity

PAPER = Engine.paper()


def resonator(speed_rpm):
    """Frequency and damping of section 4: held outside 1500 and 3000 rpm, linear between."""
    share = min(max((speed_rpm - 1500.0) / 1500.0, 0.0), 1.0)
    return 2.0 * math.pi * (176.0 + 14.0 * share), 0.005 + 0.145 * share


def ode(theta_0, speed_rpm, time, start=(0.0, 0.0)):
    """Eq. 7 by a general solver from crank angle `theta_0` (rad): velocity and acceleration."""
    w, xi = resonator(speed_rpm)
    omega = 2.0 * math.pi * speed_rpm / 60.0

    def rhs(t, y):
        v_p = 2.0 * math.pi * speed_rpm / 120.0 * 0.088 * math.sin(theta_0 + omega * t)
        forcing = math.pi * 0.0806**2 / 4.0 / 1.43e-3 * v_p
        return [y[1], w * w * (forcing - y[0]) - 2.0 * xi * w * y[1]]

    y = solve_ivp(
        rhs, (0.0, time[-1]), start, t_eval=time, method="DOP853", rtol=1e-12, atol=1e-12
    ).y
    return y[0], y[1]


@pytest.mark.parametrize("speed_rpm", [750.0, 1500.0, 2200.0, 6000.0])
@pytest.mark.parametrize("opening_deg", [0.0, -20.0, 35.0])
def test_closed_form_solves_the_equation(speed_rpm, opening_deg):
    time = np.linspace(0.0, 240.0 / (6.0 * speed_rpm), 400)
    velocity, acceleration = runner_velocity(time, PAPER, speed_rpm, opening_deg)
    v, a = ode(math.radians(opening_deg), speed_rpm, time)
    assert velocity == pytest.approx(v, abs=1e-8 * np.max(np.abs(v)))
    assert acceleration == pytest.approx(a, abs=1e-8 * np.max(np.abs(a)))
    assert abs(velocity[0]) < 1e-12  # Eq. 8
    assert abs(acceleration[0]) < 1e-8


def test_gain_and_forcing_are_those_of_the_equations():
    # m_r k_r/(A_r p_m) with m_r = p_m V_r/(R T)
    assert runner_gain(PAPER) == pytest.approx(5e-4 * 1.288 / (287.0 * 290.0 * 1.43e-3), rel=1e-12)
    piston = 2.0 * math.pi * 3000.0 / 120.0 * 0.088
    area_ratio = math.pi * 0.0806**2 / 4.0 / 1.43e-3
    assert forcing_amplitude(PAPER, 3000.0) == pytest.approx(area_ratio * piston, rel=1e-12)
    assert runner_pressure(1e5, 1000.0, PAPER) == pytest.approx(
        1e5 * (1.0 - 1000.0 * runner_gain(PAPER)), rel=1e-12
    )


@pytest.mark.parametrize("speed_rpm", [750.0, 1500.0, 2200.0, 6000.0])
@pytest.mark.parametrize("opening_deg", [0.0, 20.0])
def test_kernel_runner_follows_the_equation(speed_rpm, opening_deg):
    command = ValveCommand(4.0, 200.0, opening_deg)
    trace = CrankAnglePlant().steady_cycle(speed_rpm, command).trace_at(0.5)
    for j in range(4):
        since_deg = trace.crank_angle_deg - 180.0 * j - opening_deg
        is_open = (since_deg >= 0.0) & (since_deg < 200.0 - 1e-9)
        # the tail of the last cylinder's event lies at the start of the cycle
        time = since_deg[is_open] / (6.0 * speed_rpm)
        _, a = ode(math.radians(opening_deg), speed_rpm, time)
        ratio = trace.runner_pressure[is_open, j] / trace.manifold_pressure[is_open]
        assert ratio == pytest.approx(1.0 - runner_gain(PAPER) * a, abs=2e-8)


def test_runner_is_at_manifold_pressure_when_shut_or_switched_off():
    command = ValveCommand(4.0, 150.0)
    trace = CrankAnglePlant().steady_cycle(3000.0, command).trace
    shut = trace.lift_mm[:, 0] == 0.0
    assert shut.sum() > 500
    assert np.array_equal(trace.runner_pressure[shut, 0], trace.manifold_pressure[shut])
    off = CrankAnglePlant(runner=False).steady_cycle(3000.0, command).trace
    assert np.array_equal(off.runner_pressure[:, 0], off.manifold_pressure)


@pytest.mark.parametrize("speeds", [(1500.0, 2400.0), (4000.0, 1000.0)])
def test_speed_change_within_an_event(speeds):
    """Velocity and acceleration go on; frequency, damping and forcing change with the speed."""
    first, second = speeds
    command = ValveCommand(4.0, 240.0, 30.0)  # open from 30 to 270 deg, windows end at 180
    run = CrankAnglePlant().start(first, command)
    traces = [run.step_event(command, trace_step_deg=0.5).trace]
    assert run.next_cylinder == 2
    traces.append(run.step_event(command, speed_rpm=second, trace_step_deg=0.5).trace)

    end = 150.0 / (6.0 * first)
    v, a = ode(math.radians(30.0), first, np.array([0.0, end]))
    for trace, speed, theta_0, start in (
        (traces[0], first, 30.0, (0.0, 0.0)),
        (traces[1], second, 180.0, (v[-1], a[-1])),
    ):
        angle = trace.crank_angle_deg
        is_open = (angle > theta_0 + 1e-9) & (trace.lift_mm[:, 0] > 0.0)
        time = (angle[is_open] - theta_0) / (6.0 * speed)
        assert time.size > 40
        _, expected = ode(math.radians(theta_0), speed, np.concatenate([[0.0], time]), start)
        ratio = trace.runner_pressure[is_open, 0] / trace.manifold_pressure[is_open]
        assert ratio == pytest.approx(1.0 - runner_gain(PAPER) * expected[1:], abs=2e-8)
