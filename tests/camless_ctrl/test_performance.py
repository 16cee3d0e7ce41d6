import matplotlib as mpl
import numpy as np
import pytest

from camless_ctrl.assessment import assess_performance
from camless_ctrl.baselines import ADAPTIVE, FEEDFORWARD, baseline_controllers
from camless_ctrl.closed_loop_result import ClosedLoopResult
from camless_ctrl.controller_cases import AVERAGED, performance_cases
from camless_ctrl.loss_reference import loss_references
from camless_ctrl.performance import PerformanceRow, PerformanceTable, measure_performance, run_case
from plant import CrankAnglePlant, Engine, ValveCommand
from plant.errors import ParameterError

mpl.use("Agg")
WEAK = "unequal flow -15 %, +-5 %, 1500 rpm"


def run_of(charge, demand, loss=None):
    """Result of given charges (cycles, n) at demands (cycles,)."""
    cycles, n = charge.shape
    flat = np.ones(cycles * n)
    return ClosedLoopResult(
        "by hand", n, 0, time=flat, cylinder=np.tile(np.arange(1, n + 1), cycles),
        speed_rpm=1500.0 * flat, demand=np.repeat(demand, n), charge=charge.ravel(),
        estimate=flat, estimate_sigma=flat, pumping_loss=flat if loss is None else loss.ravel(),
        lift_mm=flat, duration_deg=flat, flow_gain=flat, duration_offset=flat,
        charge_factor=flat, limited=flat > 2, adapted=flat > 2,
    )  # fmt: skip


def case_of(part, references=()):
    return next(c for c in performance_cases(references=references) if part in c.name)


def test_settled_figures_by_hand():
    # 10 cycles far off do not count; then +2 % and 0 alternate in cylinder 1, -1 % in cylinder 2
    error = np.zeros((10 + AVERAGED, 4))
    error[:10] = 0.5
    error[10::2, 0] = 0.02
    error[10:, 1] = -0.01
    run = run_of(3e-4 * (1.0 + error), np.full(len(error), 3e-4))
    largest, imbalance = (bar.figure(run) for bar in case_of("5 %, 1500 rpm").bars)
    assert largest == pytest.approx(0.01)
    assert imbalance == pytest.approx(0.02 / (1.0 + (0.01 - 0.01) / 4.0))


def test_step_figures_by_hand():
    cycles = 20 + 2 * (AVERAGED + 10)
    demand = np.concatenate([np.full(20, 1.7e-4), np.full(40, 4e-4), np.full(40, 1.7e-4)])
    error = np.zeros((cycles, 4))
    error[0] = 0.4  # before the first change: adaptation
    error[20, 0], error[60, 2] = 0.015, -0.018  # among the first events
    error[21, 1] = 0.3  # another event
    error[23 : 23 + AVERAGED, 3] = 0.004
    run = run_of(demand[:, None] * (1.0 + error), demand)
    first, settled = (bar.figure(run) for bar in case_of("demand step").bars)
    assert first == pytest.approx(0.018)
    assert settled == pytest.approx(0.004)


def test_ramp_figures_by_hand():
    error = np.zeros((65, 4))
    error[3] = 1.0  # warming up
    error[62] = (0.04, -0.04, 0.02, 0.0)
    run = run_of(3e-4 * (1.0 + error), np.full(65, 3e-4))
    event, cycle = (bar.figure(run) for bar in case_of("speed ramp").bars)
    assert event == pytest.approx(0.04)
    assert cycle == pytest.approx(0.005)


def test_ramp_takes_two_seconds():
    speeds = case_of("speed ramp").speed_rpm
    ramp = speeds[(speeds > 1000.0) & (speeds < 5000.0)]
    assert np.all(np.diff(ramp) > 0.0)
    assert np.sum(30.0 / ramp) == pytest.approx(2.0, abs=0.06)  # one event lasts 30/N s


def test_least_loss_is_below_what_other_lifts_lose():
    plant = CrankAnglePlant(runner=True, oscillation=True)
    (reference,) = loss_references(plant, ((2.5e-4, 1500.0),))
    for lift in (3.0, 5.0, 8.0):
        low, high = 60.0, 180.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            cycle = plant.steady_cycle(1500.0, ValveCommand(lift, middle))
            low, high = (middle, high) if cycle.air_charge[0] < 2.5e-4 else (low, middle)
        assert reference.at(2.5e-4) <= cycle.pumping_loss[0] * 1.001
    assert reference.at(2.5e-4) == pytest.approx(cycle.pumping_loss[0], rel=0.02)  # 8 mm is best
    case = case_of("pumping loss", (reference,))
    n = 4 * (20 + AVERAGED)
    run = run_of(
        np.full((n // 4, 4), 2.5e-4),
        np.full(n // 4, 2.5e-4),
        loss=np.full((n // 4, 4), 1.03 * float(reference.at(2.5e-4))),
    )
    assert case.bars[0].figure(run) == pytest.approx(0.03)
    with pytest.raises(ParameterError, match=r"6\.0 % off the demand"):
        reference.at(2.65e-4)


def test_other_engines_get_demands_in_proportion():
    half = Engine.paper().replace(n_cylinders=3, displaced_volume=2e-4)
    cases = performance_cases(half)
    assert cases[0].demand[0] == pytest.approx(0.5 * 1.7e-4)
    assert len(cases[1].engine.cylinder_flow_factors) == 3


@pytest.fixture(scope="module")
def table(narrow_design):
    controllers = baseline_controllers(narrow_design)
    chosen = {law: controllers[law] for law in (ADAPTIVE, FEEDFORWARD)}
    return measure_performance(chosen, narrow_design, cases=[WEAK], seeds=2, processes=1)


def test_table_holds_every_figure_of_every_law(table, narrow_design):
    assert table.laws == (ADAPTIVE, FEEDFORWARD)
    assert [row.figure for row in table.of(ADAPTIVE)] == [
        "every cylinder after 10 cycles",
        "imbalance after 10 cycles",
    ]
    run = run_case(narrow_design.controller, WEAK, seed=1)
    figure = case_of("5 %, 1500 rpm").bars[0].figure(run)
    assert table.of(ADAPTIVE)[0].values[1] == pytest.approx(100.0 * figure, rel=1e-9)
    assert all(row.met for row in table.of(ADAPTIVE))
    assert not any(row.met for row in table.of(FEEDFORWARD))


def test_table_prints_plots_and_is_plain_data(table):
    found = table.to_dict()["cases"]
    assert {"name", "law", "median", "worst", "bar", "met"} <= set(found[0])
    assert "NOT MET" in str(table)
    assert table.plot().get_xscale() == "log"


def test_bars_of_single_events_do_not_count():
    rows = (
        PerformanceRow("ramp", "every event", "law", (2.0, 4.0), 3.0, single=True),
        PerformanceRow("flow", "every cylinder", "law", (0.5, 0.9), 1.0),
    )
    (found,) = assess_performance(PerformanceTable(rows), "law")
    assert found.met
    assert "4.00 % of 3 % (jitter, not counted)" in found.note
    worse = PerformanceRow("flow", "imbalance", "law", (0.5, float("nan")), 1.0)
    (found,) = assess_performance(PerformanceTable((*rows, worse)), "law")
    assert found.value == 1.0
    (nothing,) = assess_performance(PerformanceTable(rows), "another law")
    assert not nothing.met


def test_unknown_case_is_refused(narrow_design):
    with pytest.raises(ParameterError, match="unequal flow"):
        measure_performance({"law": narrow_design.controller}, narrow_design, cases=["nothing"])
    with pytest.raises(ParameterError, match="must be one of"):
        run_case(narrow_design.controller, "nothing")
