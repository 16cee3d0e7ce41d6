import dataclasses
import json

import numpy as np
import pytest

from camless_ctrl.closed_loop import ValveErrors
from camless_ctrl.controller_cases import JITTER
from camless_ctrl.faults import Fault
from camless_ctrl.operating_profile import OperatingProfile
from camless_ctrl.replay import replay_result, signal_differences
from camless_ctrl.scenario import ControllerChoice, Scenario
from camless_ctrl.scenario_run import run_scenario
from plant.errors import ParameterError


@pytest.fixture(scope="module")
def saved(narrow_design, tmp_path_factory):
    """A short run with noise, jitter, a fault and a warm-up, and its files."""
    scenario = Scenario(
        "short",
        "",
        OperatingProfile(250.0, 1500.0, length=0.8),
        true={"cylinder_flow_factors": [1.03, 0.85, 0.96, 1.05]},
        valves=ValveErrors(0.0, JITTER),
        faults=(Fault("maf-stuck", 0.3, 0.5),),
        controller=ControllerChoice(warm_up_cycles=5),
    )
    result = run_scenario(scenario, narrow_design, seed=7, record_deg=10.0)
    folder = tmp_path_factory.mktemp("saved")
    result.to_json(folder / "result.json")
    result.to_netcdf(folder / "result.nc")
    return result, folder


@pytest.mark.parametrize("name", ["result.json", "result.nc"])
def test_the_same_again_bit_for_bit(saved, narrow_design, name):
    result, folder = saved
    found = replay_result(folder / name, narrow_design)
    assert found
    assert (found.same, found.differences, found.origins) == (True, (), ())
    assert found.stored.seed == 7
    assert found.again.run.charge.tobytes() == result.run.charge.tobytes()
    assert found.again.run.trace.port_flow.tobytes() == result.run.trace.port_flow.tobytes()
    assert "the same, bit for bit" in str(found)


def test_a_changed_number_and_another_version_are_told(saved, narrow_design, tmp_path):
    result, folder = saved
    data = json.loads((folder / "result.json").read_text())
    values = data["run"]["signals"]["charge"]["values"]
    values[30] = float(np.nextafter(values[30], 1.0))  # one bit
    data["provenance"]["numba"] = "0.1"
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(data))
    found = replay_result(path, narrow_design)
    assert not found.same
    (difference,) = found.differences
    assert difference.startswith("charge: 1 of ")
    assert (
        f"event 30 ({result.run.time[30]:.4g} s, cylinder 3): {values[30]!r} stored" in difference
    )
    (origin,) = found.origins
    assert origin.startswith("numba: 0.1 stored")
    assert difference in str(found)
    assert origin in str(found)


def test_another_seed_is_no_replay(saved, narrow_design, tmp_path):
    _, folder = saved
    data = json.loads((folder / "result.json").read_text())
    data["seed"] = 8
    path = tmp_path / "other.json"
    path.write_text(json.dumps(data))
    found = replay_result(path, narrow_design)
    assert any(text.startswith("charge: ") for text in found.differences)
    assert any(text.startswith("crank port_flow: ") for text in found.differences)


def test_what_counts_as_a_difference(saved):
    run = saved[0].run

    def differences(**changes):
        return signal_differences(run, dataclasses.replace(run, **changes))

    assert differences() == ()
    assert np.isnan(run.estimate).any()  # and yet the same
    zero = np.zeros_like(run.charge)
    before = dataclasses.replace(run, flow_gain=zero)
    (text,) = signal_differences(before, dataclasses.replace(run, flow_gain=-zero))
    assert "0.0 stored, -0.0 now" in text
    (text,) = differences(mode=run.mode.astype(float))
    assert text.startswith("mode: int64")
    texts = differences(trace=None)
    assert texts
    assert all("only stored" in text for text in texts)


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(ParameterError, match=r"none\.json cannot be read"):
        replay_result(tmp_path / "none.json")
