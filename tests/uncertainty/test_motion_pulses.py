import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand
from uncertainty.motion_pulses import ChangedMotion, follow_motion

SPEED = 3000.0
REST = ValveCommand(6.0, 150.0)


@pytest.fixture(scope="module")
def plant():
    return CrankAnglePlant(runner=True, oscillation=True)


def moved(lift_mm, duration_deg):
    raised, lowered = (
        ValveCommand(REST.lift_mm + s * lift_mm, REST.duration_deg + s * duration_deg)
        for s in (1.0, -1.0)
    )
    return ChangedMotion(REST, raised, lowered)


@pytest.fixture(scope="module")
def followed(plant):
    return follow_motion(plant, moved(0.02, 0.8), SPEED)


def test_charge_of_all_events_is_that_of_steady_cycles(plant, followed):
    # All events changed alike: whole steady cycles on either side, no pulse followed in time.
    motion = moved(0.02, 0.8)
    high, low = (
        plant.steady_cycle(SPEED, command).air_charge[0]
        for command in (motion.raised, motion.lowered)
    )
    assert followed.pulse.charge.sum() == pytest.approx(0.5 * (high - low), rel=2e-3)
    assert followed.charge == pytest.approx(plant.steady_cycle(SPEED, REST).air_charge[0])


def test_air_that_is_added_comes_through_the_throttle(followed):
    assert followed.pulse.inflow.sum() == pytest.approx(followed.pulse.charge.sum(), rel=1e-4)
    T = 120.0 / (4 * SPEED)
    flow = np.append(followed.pulse.flow, 0.0)
    area = 0.5 * (flow[1:] + flow[:-1]).sum() * T / followed.flow.size
    assert area == pytest.approx(followed.pulse.inflow.sum(), rel=3e-3)


def test_flow_and_pressure_are_of_the_same_instants(plant, followed):
    # Eq. 13: the pressure at each instant gives the flow through the throttle.
    engine = plant.engine
    area = engine.throttle.area(90.0)

    def through(pressure):
        ratio = pressure / engine.ambient_pressure
        return area * 2.0 * np.sqrt(ratio - ratio**2)

    inwards = followed.pressure < 0.9999 * engine.ambient_pressure
    assert inwards.mean() > 0.3
    pressure, change = followed.pressure[inwards], 1e-3 * followed.pulse.pressure[0, inwards]
    # The flow is that of a step, the pressure that of its start.
    np.testing.assert_allclose(followed.flow[inwards], through(pressure), rtol=6e-3)
    slope = (through(pressure + change) - through(pressure - change)) / 2e-3
    size = np.abs(followed.pulse.flow).max()
    assert np.abs(followed.pulse.flow[0, inwards] - slope).max() < 0.02 * size


def test_signals_are_those_of_the_trace(plant, followed):
    trace = plant.steady_cycle(SPEED, REST).trace_at(0.5)
    np.testing.assert_allclose(followed.pressure, trace.manifold_pressure[:360], rtol=1e-6)


def test_lift_and_duration_add_up(plant, followed):
    lift, duration = (
        follow_motion(plant, moved(*change), SPEED).pulse.charge.sum()
        for change in ((0.02, 0.0), (0.0, 0.8))
    )
    assert lift > 0.01 * duration
    assert followed.pulse.charge.sum() == pytest.approx(lift + duration, rel=5e-3)


def test_unequal_cylinders_are_refused():
    engine = Engine.paper().replace(cylinder_flow_factors=(1.0, 0.9, 1.0, 1.0))
    with pytest.raises(ParameterError, match="cylinders differ in flow coefficient"):
        follow_motion(CrankAnglePlant(engine), moved(0.0, 0.5), SPEED)
