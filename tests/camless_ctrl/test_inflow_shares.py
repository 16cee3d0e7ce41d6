import numpy as np
import pytest

from camless_ctrl.event_data import EVENTS, PARTS
from camless_ctrl.inflow_shares import (
    inflow_share_slopes,
    inflow_shares,
    inflow_shares_from_cycle,
    inflow_shares_table,
)
from plant import CrankAnglePlant, Engine, ValveCommand
from plant.errors import ParameterError

PLANT = CrankAnglePlant(oscillation=True)


@pytest.mark.parametrize("n", [3, 4, 6])
@pytest.mark.parametrize(
    ("speed", "command"),
    [
        (750.0, ValveCommand(2.0, 60.0)),
        (1500.0, ValveCommand(4.0, 170.0, 10.0)),
        (6000.0, ValveCommand(7.0, 200.0)),
        (3000.0, ValveCommand(6.0, 150.0, -15.0)),
    ],
)
def test_shares_are_the_integrated_port_flow(n, speed, command):
    plant = CrankAnglePlant(Engine.paper().replace(n_cylinders=n), oscillation=True)
    cycle = plant.steady_cycle(speed, command)
    shares = inflow_shares_from_cycle(cycle)
    assert shares.shape == (EVENTS * PARTS,)
    assert shares.sum() == pytest.approx(1.0, abs=1e-9)
    trace = cycle.trace_at(0.02)
    angle = np.mod(trace.crank_angle_deg - command.opening_deg + 1e-9, 720.0)
    order = np.argsort(angle)
    time = angle[order] / (6.0 * speed)
    flow = trace.port_flow[order, 0]
    taken = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(time) * (flow[1:] + flow[:-1]))))
    edges = np.arange(EVENTS * PARTS + 1) * 720.0 / n / PARTS
    expected = np.diff(np.interp(edges, angle[order], taken)) / cycle.air_charge[0]
    assert shares == pytest.approx(expected, abs=1e-3)
    # what flows back at IVO, where exhaust pressure meets the manifold, is negative
    assert shares[0] < 0.0 or command.opening_deg > 0.0 or speed < 1000.0


def test_each_cylinder_has_its_own():
    factors = (1.0, 0.8, 1.0, 1.0)
    plant = CrankAnglePlant(Engine.paper().replace(cylinder_flow_factors=factors))
    cycle = plant.steady_cycle(6000.0, ValveCommand(7.0, 190.0))
    first, weak = (inflow_shares_from_cycle(cycle, i) for i in (1, 2))
    assert np.max(np.abs(first - weak)) > 0.005
    assert weak.sum() == pytest.approx(1.0, abs=1e-9)


def test_slopes_predict_a_weak_valve():
    command = ValveCommand(7.0, 190.0)
    shares, slopes = (
        inflow_shares(PLANT, command, 6000.0),
        inflow_share_slopes(PLANT, command, 6000.0),
    )
    assert slopes.sum() == pytest.approx(0.0, abs=1e-9)
    engine = PLANT.engine
    weak = inflow_shares(
        PLANT.with_engine(engine.replace(flow_coefficient=0.85 * engine.flow_coefficient)),
        command,
        6000.0,
    )
    left = np.abs(shares + np.log(0.85) * slopes - weak)
    assert np.max(left) < 0.15 * np.max(np.abs(shares - weak))


def test_table_holds_the_single_points():
    speed, lift, duration = [1500.0, 3000.0], 4.0, np.array([[120.0], [150.0]])
    table = inflow_shares_table(PLANT, speed, lift, duration)
    assert table.shape == (2, 2, EVENTS * PARTS)
    single = inflow_shares(PLANT, ValveCommand(4.0, 150.0), 3000.0)
    assert table[1, 1] == pytest.approx(single, abs=1e-12)


def test_what_cannot_be_told_is_refused():
    six = CrankAnglePlant(Engine.paper().replace(n_cylinders=6))
    cycle = six.steady_cycle(3000.0, ValveCommand(5.0, 250.0))
    with pytest.raises(ParameterError, match="open for 250 deg"):
        inflow_shares_from_cycle(cycle)
    idle = PLANT.steady_cycle(1500.0, ValveCommand(0.0, 100.0))
    with pytest.raises(ParameterError, match="must be above 0"):
        inflow_shares_from_cycle(idle)
    with pytest.raises(ParameterError, match="numbers"):
        inflow_shares_table(PLANT, [1500.0, 3000.0], [1.0, 2.0, 3.0], 100.0)
