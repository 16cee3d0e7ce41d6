"""Metrics on runs of the full plant: the same figures as those of the performance table."""

import math
from types import SimpleNamespace

import pytest

from camless_ctrl.closed_loop import simulate
from camless_ctrl.controller_cases import WARM_UP, performance_cases
from camless_ctrl.loss_reference import loss_references
from camless_ctrl.metrics import (
    CommandViolations,
    FirstEventsError,
    Imbalance,
    LossExcess,
    Settling,
    SteadyError,
)
from camless_ctrl.operating_profile import OperatingProfile
from camless_ctrl.scenario import Scenario
from plant import CrankAnglePlant, Engine


def in_case(case, design):
    run = simulate(case.plant, design.controller, case.demand, case.speed_rpm, valves=case.valves)
    return SimpleNamespace(run=run, scenario=SimpleNamespace(faults=()))


def test_figures_of_the_demand_step_are_those_of_the_performance_table(narrow_design):
    case = performance_cases()[0]
    result = in_case(case, narrow_design)
    run = result.run
    first, settled = (bar.figure(run) for bar in case.bars)
    assert FirstEventsError().measure(result).value == pytest.approx(100.0 * first, rel=1e-12)
    found = SteadyError(3, 30, from_s=float(run.time[WARM_UP * 4])).measure(result)
    assert found.value == pytest.approx(100.0 * settled, rel=1e-12)
    for tolerance in (0.1, 0.3, 1.0):
        cycles = run.settling_cycles(0.01 * tolerance)
        assert Settling(tolerance).measure(result).value == (math.inf if cycles is None else cycles)


def test_figures_of_unequal_flow_are_those_of_the_performance_table(narrow_design):
    case = performance_cases()[2]
    result = in_case(case, narrow_design)
    error, imbalance = (bar.figure(result.run) for bar in case.bars)
    assert SteadyError(10, 30).measure(result).value == pytest.approx(100.0 * error, rel=1e-12)
    assert Imbalance(10, 30).measure(result).value == pytest.approx(100.0 * imbalance, rel=1e-9)
    # the controller says itself that it keeps these limits
    assert CommandViolations().measure(result).value == 0.0


def test_loss_excess_is_that_of_the_performance_table(narrow_design):
    plant = CrankAnglePlant(Engine.paper(), runner=True, oscillation=True)
    case = performance_cases(None, loss_references(plant, ((250e-6, 1500.0),)))[-1]
    result = in_case(case, narrow_design)
    profile = OperatingProfile(250.0, 1500.0, length=50.0, axis="cycles")
    result.scenario = Scenario("loss", "", profile)
    found = LossExcess().measure(result)
    assert found.value == pytest.approx(100.0 * case.bars[0].figure(result.run), rel=1e-6)
    assert found.event in range(80, 84)
