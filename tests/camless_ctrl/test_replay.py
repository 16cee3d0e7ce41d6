import dataclasses
import json

import numpy as np
import pytest
import xarray as xr

from camless_ctrl.closed_loop import ValveErrors
from camless_ctrl.closed_loop_requirement import ClosedLoopRequirement
from camless_ctrl.controller_cases import JITTER
from camless_ctrl.faults import Fault
from camless_ctrl.metrics import WorstError
from camless_ctrl.operating_profile import OperatingProfile
from camless_ctrl.replay import field_differences, replay_result, signal_differences
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
        requirements=(ClosedLoopRequirement("worst", WorstError(), 50.0, "%", "test"),),
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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.update(met=False), "met: False stored, True now"),
        (lambda data: data["verdicts"][0].update(met=False), "verdicts.1.met: False stored"),
        (lambda data: data["verdicts"][0].update(event=3), "verdicts.1.event: 3 stored"),
        (lambda data: data["verdicts"].pop(), "verdicts.1: nothing stored"),
        (lambda data: data["run"].update(n_cylinders=3), "run.n_cylinders: 3 stored, 4 now"),
        (lambda data: data["run"].update(faults=[]), "run.faults.1: nothing stored"),
        (lambda data: data["run"]["faults"][0].update(end=0.6), "run.faults.1.end: 0.6 stored"),
        (lambda data: data["run"].update(name="long"), "run.name: 'long' stored, 'short' now"),
        (lambda data: data["run"].update(seed=8), "run.seed: 8 stored, 7 now"),
        (lambda data: data["scenario"]["engine"].pop("n_cylinders"), "nothing stored, 4 now"),
        (lambda data: data.update(colour="red"), "colour: 'red' stored, nothing now"),
    ],
)
def test_every_field_is_compared(saved, narrow_design, tmp_path, change, said):
    data = json.loads((saved[1] / "result.json").read_text())
    change(data)
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(data))
    found = replay_result(path, narrow_design)
    assert not found
    (difference,) = found.differences
    assert said in difference
    assert difference in str(found)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("met", "false", "met: False stored"),
        ("verdicts", "[]", "verdicts.1: nothing stored"),
        ("n_cylinders", 3, "run.n_cylinders: 3 stored"),
        ("run_faults", "[]", "run.faults.1: nothing stored"),
    ],
)
def test_every_attribute_is_compared(saved, narrow_design, tmp_path, name, value, said):
    data = xr.load_dataset(saved[1] / "result.nc", engine="scipy", decode_times=False)
    data.assign_attrs({name: value}).to_netcdf(tmp_path / "changed.nc", engine="scipy")
    (difference,) = replay_result(tmp_path / "changed.nc", narrow_design).differences
    assert difference.startswith(said)


def test_fields_differ_by_place_and_value():
    same = {"a": [1, {"b": None}], "c": "x"}
    assert field_differences(same, {"c": "x", "a": [1.0, {"b": None}]}) == ()
    assert field_differences(same, {"a": [1, {"b": 0}, 2]}) == (
        "a.2.b: None stored, 0 now",
        "a.3: nothing stored, 2 now",
        "c: 'x' stored, nothing now",
    )
    assert field_differences({"a": True}, {"a": 1}) == ("a: True stored, 1 now",)


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
