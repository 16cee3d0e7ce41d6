import math

import matplotlib as mpl
import numpy as np
import pytest

from camless_ctrl.adaptation import GainSchedule
from camless_ctrl.delay_boundary import _Growth, delay_boundary
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.linearise import LocalResponse
from camless_ctrl.measurement_response import FlowShape
from plant import ParameterError, ValveCommand

mpl.use("Agg")

SMALL = GainSchedule.constant(0.01, 0.01)


@pytest.fixture(scope="module")
def feedforward(charge_map):
    return Feedforward(charge_map)


@pytest.fixture(scope="module")
def boundary(feedforward):
    return delay_boundary(
        feedforward,
        speeds_rpm=(1500.0, 3000.0),
        simulated=((1500.0, 2), (3000.0, 2), (3000.0, 1)),
        cycles=30,
        processes=1,
    )


def even(speed_rpm):
    return LocalResponse(speed_rpm, 4, ValveCommand(3.0, 100.0), 2e-4, 1.0, 1.0, FlowShape.even())


@pytest.mark.parametrize("speed_rpm", [1500.0, 3000.0, 6000.0])
def test_limit_of_an_even_flow_by_hand(speed_rpm):
    # The lag undone, a window that is late by d shows 1 - d/T of its own charge and d/T of
    # the next cylinder's, which alternates: the sign turns at d = T/2.
    event = 30.0 / speed_rpm
    growth = _Growth(even(speed_rpm), ChargeEstimator(taper=0.0), SMALL, "delay")
    assert growth.limit(2) == pytest.approx(1e-3 + 0.5 * event, rel=0.01)
    # q = 1: 1 - d/T - j d/T has a real part of zero at d = T.
    assert growth.limit(1) == pytest.approx(1e-3 + event, rel=0.02)


def test_limit_is_the_first_value_that_is_unstable():
    growth = _Growth(even(3000.0), ChargeEstimator(), SMALL, "delay")
    limit = growth.limit(2)
    assert growth(limit)[2] >= 1.0
    assert growth(limit - 2e-6)[2] < 1.0
    assert all(growth(share * limit)[2] < 1.0 for share in (0.0, 0.3, 0.6, 0.9))


def test_runs_come_out_as_predicted(boundary):
    # The event average never adapts q = 2 at 3000 rpm, so that nothing is run there.
    assert len(boundary.runs) == 10
    assert boundary.agreeing == len(boundary.runs)
    assert {run.stable for run in boundary.runs} == {True, False}
    for run in boundary.runs:
        assert run.simulated == pytest.approx(run.predicted, abs=0.06)


def test_full_plant_crosses_near_the_predicted_limit(boundary):
    name, speed = "crank-resolved window", 3000.0
    for q, predicted in zip(boundary.modes, boundary.limits[name][:, 1], strict=True):
        inside, outside = (
            run
            for run in boundary.runs
            if (run.estimator, run.speed_rpm, run.q) == (name, speed, q)
        )
        share = (1.0 - inside.simulated) / (outside.simulated - inside.simulated)
        crossed = inside.value + share * (outside.value - inside.value)
        assert crossed == pytest.approx(predicted, rel=0.05)


def test_crank_resolved_window_moves_the_boundary_out(boundary):
    average, window = boundary.limits["event average"], boundary.limits["crank-resolved window"]
    assert np.all(window > 2.0 * average)
    assert average[1, 1] == 0.0  # q = 2 at 3000 rpm
    assert np.all(average[:, 0] > average[:, 1])
    assert "never" in str(boundary)


def test_lag_breaks_the_event_average_alone(feedforward):
    found = delay_boundary(
        feedforward,
        quantity="lag",
        speeds_rpm=(3000.0,),
        simulated=((3000.0, 2),),
        cycles=30,
        processes=1,
    )
    assert [run.estimator for run in found.runs] == ["event average"] * 2
    assert found.agreeing == 2
    assert math.isinf(found.limits["crank-resolved window"][1, 0])
    assert "above 200" in str(found)


def test_plot_shows_lines_and_runs(boundary):
    figure = boundary.plot()
    assert [ax.get_title(loc="left") for ax in figure.axes] == list(boundary.limits)
    lines = [line for ax in figure.axes for line in ax.lines]
    drawn = sum(len(line.get_xdata()) for line in lines if line.get_marker() in "os")
    assert drawn == len(boundary.runs)
    assert "ms" in figure.axes[0].get_ylabel()


def test_held_differences_have_no_boundary(feedforward):
    with pytest.raises(ParameterError, match="held have no limit"):
        delay_boundary(feedforward, gains=GainSchedule(), speeds_rpm=(6000.0,), simulated=())


def test_unknown_quantity_is_refused(feedforward):
    with pytest.raises(ParameterError, match="quantity"):
        delay_boundary(feedforward, quantity="noise")
