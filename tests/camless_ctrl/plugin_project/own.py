from pathlib import Path

import pytest

from camless_ctrl.closed_loop_requirement import ClosedLoopRequirement
from camless_ctrl.metrics import WorstError
from camless_ctrl.scenario_toml import load_scenario
from plant import Engine, ParameterError

TIGHT = ClosedLoopRequirement("tight", WorstError(), 0.5, "%", "test")
LOOSE = ClosedLoopRequirement("loose", WorstError(), 5.0, "%", "test")
ENGINE = Engine.paper().replace(n_cylinders=3)


@pytest.fixture(scope="session")
def camless_engine():
    return ENGINE


def test_plant(camless_plant):
    assert camless_plant.engine is ENGINE
    assert camless_plant.runner
    assert camless_plant.oscillation


def test_design_and_maps(camless_design, camless_maps):
    assert camless_design.engine is ENGINE
    assert camless_maps is camless_design.maps


@pytest.fixture(scope="module")
def good(run_scenario):
    return run_scenario("scenarios/good.toml")


def test_met(good):
    assert good.meets(LOOSE)


def test_not_met(good):
    assert good.meets(TIGHT)


def test_seeds(run_scenario, good):
    scenario = load_scenario(Path(__file__).parent / "scenarios" / "good.toml")
    found = run_scenario(scenario, seed=4)
    assert (good.seed, found.seed) == (1, 4)
    assert found.meets(TIGHT).value == pytest.approx(4.0)
    assert run_scenario(Path("scenarios/good.toml")) is not good


def test_all_at_once(run_scenario):
    assert run_scenario("scenarios/good.toml", seed=0).met


def test_shipped(run_scenario):
    with pytest.raises(ParameterError, match="no-such"):
        run_scenario("no-such")
