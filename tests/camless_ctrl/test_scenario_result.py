import csv
import dataclasses
import json
import math

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

from camless_ctrl.alarms import Alarm
from camless_ctrl.closed_loop_requirement import ClosedLoopRequirement
from camless_ctrl.closed_loop_result import ClosedLoopResult
from camless_ctrl.faults import Fault
from camless_ctrl.loss_reference import loss_references
from camless_ctrl.metrics import LossExcess, SteadyError, WorstError
from camless_ctrl.operating_profile import OperatingProfile
from camless_ctrl.output import OutputError
from camless_ctrl.provenance import provenance_differences, run_provenance
from camless_ctrl.scenario import Scenario
from camless_ctrl.scenario_result import ScenarioResult, load_result
from plant import CrankAnglePlant, Engine, ValveCommand
from plant.errors import ParameterError

mpl.use("Agg")

EVENTS, WARM_UP = 200, 40


def requirement(name, bound, metric=None):
    return ClosedLoopRequirement(name, metric or WorstError(), bound, "%", "customer")


@pytest.fixture(scope="module")
def scenario():
    return Scenario(
        "Step, with a fault",
        "numbers of all sizes",
        OperatingProfile(200.0, 1500.0, length=3.2),
        true={"cylinder_flow_factors": [1.0, 0.85, 1.0, 1.1]},
        faults=(Fault("maf-stuck", 1.0, 2.0), Fault("valve-lift", 2.0, size=0.9, cylinder=2)),
        requirements=(requirement("any event", 0.5), requirement("wide", 50.0)),
    )


@pytest.fixture(scope="module")
def result(scenario):
    """Result of random numbers, with all that a file could lose: NaN, -0, inf, many digits."""
    random = np.random.default_rng(0)
    demand = np.full(EVENTS, 2e-4)
    signals = {
        field.name: random.standard_normal(EVENTS) * 10.0 ** random.integers(-300, 300, EVENTS)
        for field in dataclasses.fields(ClosedLoopResult)
        if field.type == "FloatArray"
    }
    signals |= {
        "time": 0.02 * np.arange(-WARM_UP, EVENTS - WARM_UP),
        "speed_rpm": np.full(EVENTS, 1500.0),
        "told_speed_rpm": np.where(np.arange(EVENTS) == 120, 1700.0, 1500.0),
        "demand": demand,
        "charge": demand * (1.0 + 0.01 * random.standard_normal(EVENTS)),
    }
    signals["charge"][-3:] = math.nan
    signals["estimate"][:6] = math.nan, math.inf, -math.inf, -0.0, 5e-324, 0.1 + 0.2
    run = ClosedLoopResult(
        name="Step",
        n_cylinders=4,
        seed=2**63 - 1,
        cylinder=np.arange(EVENTS) % 4 + 1,
        limited=random.random(EVENTS) < 0.5,
        rate_limited=random.random(EVENTS) < 0.5,
        adapted=random.random(EVENTS) < 0.5,
        mode=random.integers(0, 3, EVENTS),
        alarms=random.integers(0, 128, EVENTS),
        faults=scenario.faults,
        trace=scenario.plant.steady_cycle(1500.0, ValveCommand(4.0, 120.0)).trace_at(2.0),
        **signals,
    )
    return ScenarioResult(scenario, run, run.seed, run_provenance(scenario.plant))


def bits(values):
    """The bits of an array, those of all NaN alike."""
    if values.dtype.kind == "f":
        values = np.where(np.isnan(values), math.nan, values)
    return values.dtype.str, values.shape, values.tobytes()


@pytest.mark.parametrize("ending", ["json", "nc"])
def test_a_file_gives_back_every_bit(result, tmp_path, ending):
    path = tmp_path / f"result.{ending}"
    (result.to_json if ending == "json" else result.to_netcdf)(path)
    found = load_result(path)
    assert found.scenario == result.scenario
    assert found.seed == result.seed == found.run.seed
    assert found.provenance == result.provenance
    for field in dataclasses.fields(ClosedLoopResult):
        value, again = getattr(result.run, field.name), getattr(found.run, field.name)
        if isinstance(value, np.ndarray):
            assert bits(again) == bits(value), field.name
        elif field.name != "trace":
            assert again == value
    for field in dataclasses.fields(result.run.trace):
        value, again = getattr(result.run.trace, field.name), getattr(found.run.trace, field.name)
        if field.name == "engine":
            assert again == result.scenario.true_engine
        else:
            assert bits(again) == bits(value), field.name
    assert found.verdicts == result.verdicts
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_the_json_file_tells_verdicts_and_origin_to_other_programs(result, tmp_path):
    result.to_json(tmp_path / "result.json")
    data = json.loads((tmp_path / "result.json").read_text(), parse_constant=pytest.fail)
    worst = np.nanmax(np.abs(result.run.charge[WARM_UP:] / 2e-4 - 1.0))
    first, second = data["verdicts"]
    assert first["value"] == pytest.approx(100.0 * worst)
    assert (first["met"], second["met"], data["met"]) == (False, True, False)
    assert data["scenario"]["name"] == "Step, with a fault"
    assert data["provenance"]["plant_fingerprint"] == result.scenario.plant.fingerprint
    assert data["provenance"]["numpy"] == np.__version__
    assert data["run"]["signals"]["estimate"]["values"][:4] == [None, "inf", "-inf", 0.0]


def test_the_table_has_a_row_an_event_and_units_in_its_header(result, tmp_path):
    result.to_csv(tmp_path / "result.csv")
    with (tmp_path / "result.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == EVENTS
    assert {"event", "time[s]", "charge[kg]", "speed[rpm]", "lift[mm]", "alarms[1]"} <= set(rows[0])
    charge = [float(row["charge[kg]"]) for row in rows[:-3]]
    assert charge == result.run.charge[:-3].tolist()
    assert {row["charge[kg]"] for row in rows[-3:]} == {""}
    assert [int(row["limited[1]"]) for row in rows] == result.run.limited.tolist()


def test_the_netcdf_file_is_one_of_signals_with_units(result, tmp_path):
    result.to_netcdf(tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc", engine="scipy") as data:
        assert data["charge"].dims == ("event",)
        assert data["charge"].attrs["units"] == "kg"
        assert data["crank_port_flow"].dims == ("crank_angle", "of_cylinder")
        assert data["crank_port_flow"].attrs["units"] == "kg/s"
        assert json.loads(data.attrs["scenario"]) == result.scenario.to_dict()


def test_without_signals_over_the_crank_angle(result, tmp_path):
    bare = dataclasses.replace(result, run=dataclasses.replace(result.run, trace=None))
    for name in ("result.json", "result.nc"):
        (bare.to_json if name.endswith("json") else bare.to_netcdf)(tmp_path / name)
        assert load_result(tmp_path / name).run.trace is None
    with pytest.raises(ParameterError, match="record_deg"):
        bare.crank_dataset()
    assert json.loads(result.crank_dataset().attrs["scenario"])["name"] == result.scenario.name
    assert result.to_dataset().attrs["scenario_seed"] == str(2**63 - 1)


@pytest.mark.parametrize("method", ["to_json", "to_netcdf", "to_csv"])
def test_an_interrupted_writer_leaves_no_file_and_keeps_the_one_before(
    result, tmp_path, monkeypatch, method
):
    path = tmp_path / "result"
    path.write_text("before")

    def interrupted(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(ClosedLoopResult, "to_dataset", interrupted)
    monkeypatch.setattr(Scenario, "to_dict", interrupted)
    with pytest.raises(KeyboardInterrupt):
        getattr(result, method)(path)
    assert path.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["result"]


@pytest.mark.parametrize("method", ["to_json", "to_netcdf", "to_csv"])
def test_a_place_that_does_not_exist(result, tmp_path, method):
    with pytest.raises(OutputError, match="does not exist"):
        getattr(result, method)(tmp_path / "no" / "result")


def damaged(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.pop("run"),
        lambda data: data["run"].pop("faults"),
        lambda data: data.update(format="another"),
        lambda data: data.update(seed="0"),
        lambda data: data.update(scenario=3),
        lambda data: data["scenario"].update(colour="red"),
        lambda data: data["run"]["signals"].pop("charge"),
        lambda data: data["run"]["signals"].update(colour={"dtype": "float64", "values": []}),
        lambda data: data["run"]["signals"]["charge"]["values"].pop(),
        lambda data: data["run"]["signals"]["charge"]["values"].__setitem__(3, "many"),
        lambda data: data["run"]["signals"]["charge"].update(dtype="object"),
        lambda data: data["run"]["signals"]["charge"].update(dtype="no such"),
        lambda data: data["run"]["crank"].pop("time"),
    ],
)
def test_a_damaged_file_is_told_by_its_name(result, tmp_path, change):
    path = tmp_path / "result.json"
    result.to_json(path)
    damaged(path, change)
    with pytest.raises(ParameterError, match=r"result\.json"):
        load_result(path)


@pytest.mark.parametrize("name", ["mode", "alarms", "throttle_deg", "rate_limited", "adapted"])
@pytest.mark.parametrize("ending", ["json", "nc"])
def test_a_signal_that_is_missing_is_not_made_up(result, tmp_path, name, ending):
    path = tmp_path / f"result.{ending}"
    if ending == "json":
        result.to_json(path)
        damaged(path, lambda data: data["run"]["signals"].pop(name))
    else:
        result.to_netcdf(path)
        data = xr.load_dataset(path, engine="scipy")
        kept = {k: v for k, v in json.loads(data.attrs["dtypes"]).items() if k != name}
        data.assign_attrs(dtypes=json.dumps(kept)).to_netcdf(path, engine="scipy")
    with pytest.raises(ParameterError, match=rf"result\.{ending}: signals\.{name} is missing"):
        load_result(path)


@pytest.mark.parametrize("key", ["scenario", "seed", "provenance", "met", "verdicts", "run"])
def test_a_part_that_is_missing_is_named(result, tmp_path, key):
    path = tmp_path / "result.json"
    result.to_json(path)
    damaged(path, lambda data: data.pop(key))
    with pytest.raises(ParameterError, match=rf"result\.json: {key} is missing: .* damaged"):
        load_result(path)


@pytest.mark.parametrize("key", ["name", "n_cylinders", "seed", "faults", "signals", "crank"])
def test_a_part_of_the_run_that_is_missing_is_named(result, tmp_path, key):
    path = tmp_path / "result.json"
    result.to_json(path)
    damaged(path, lambda data: data["run"].pop(key))
    with pytest.raises(ParameterError, match=rf"result\.json: run\.{key} is missing"):
        load_result(path)


@pytest.mark.parametrize(
    "key",
    ["scenario", "scenario_seed", "provenance", "met", "verdicts", "n_cylinders", "run_faults"],
)
def test_an_attribute_that_is_missing_is_named(result, tmp_path, key):
    result.to_netcdf(tmp_path / "result.nc")
    data = xr.load_dataset(tmp_path / "result.nc", engine="scipy")
    del data.attrs[key]
    data.to_netcdf(tmp_path / "result.nc", engine="scipy")
    with pytest.raises(ParameterError, match=rf"result\.nc: {key} is missing"):
        load_result(tmp_path / "result.nc")


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"CDF\x01 and no more", b"\xff\xfe", b"{"])
def test_a_file_of_something_else(tmp_path, content):
    path = tmp_path / "other"
    path.write_bytes(content)
    with pytest.raises(ParameterError, match=r"other.*name a file that to_json"):
        load_result(path)


def test_files_that_are_no_results(tmp_path):
    with pytest.raises(ParameterError, match=r"missing\.json cannot be read"):
        load_result(tmp_path / "missing.json")
    with pytest.raises(ParameterError, match="cannot be read"):
        load_result(tmp_path)
    xr.Dataset({"a": 1.0}).to_netcdf(tmp_path / "other.nc", engine="scipy")
    with pytest.raises(ParameterError, match="no result of a scenario"):
        load_result(tmp_path / "other.nc")


def test_a_requirement_that_is_not_met_leaves_a_picture(result, tmp_path):
    shown = dataclasses.replace(result, plots_to=tmp_path / "new" / "plots")
    assert shown.meets("wide").plot is None
    assert not (tmp_path / "new").exists()
    verdict = shown.meets(requirement("an extra: one", 0.25))
    assert not verdict
    assert verdict.plot.read_bytes().startswith(b"\x89PNG")
    assert list(verdict.plot.parent.iterdir()) == [verdict.plot]
    assert str(verdict).endswith(f"; picture: {verdict.plot}")
    assert result.meets("any event").plot is None  # no folder, no picture
    with pytest.raises(ParameterError, match="has no requirement 'other'; it has 'any event'"):
        result.meets("other")


def test_the_picture_flags_what_is_not_met_and_shades_faults(result):
    import matplotlib.pyplot as plt

    figure = result.plot()
    charge, error, speed, strip = figure.axes
    worst = result.verdicts[0]
    for ax in figure.axes:
        assert [line.get_xdata()[0] for line in ax.lines if line.get_linestyle() == ":"] == [
            worst.time
        ]
    assert "any event" in charge.get_title(loc="left")
    assert "wide" not in charge.get_title(loc="left")
    assert [text.get_text() for text in charge.texts] == ["1"]
    # the warm-up is not shown: every point is at or after the start
    for ax in (charge, error, speed):
        assert all(np.min(line.get_xdata()) >= 0.0 for line in ax.lines if len(line.get_xdata()))
    told = "\n".join(text.get_text() for text in strip.get_legend().get_texts())
    assert "fault 1: maf-stuck" in told
    assert "valve-lift" in told
    plt.close(figure)


def test_text_has_a_line_for_each_verdict(result):
    lines = str(result).splitlines()
    assert lines[0].startswith("Step, with a fault: 1 of 2 NOT MET (200 events")
    assert lines[1:] == [f"  {text}" for text in (*result.verdicts, *result.remarks)]
    assert not result.met
    assert "\n" not in repr(result)
    assert len(repr(result)) < 60


def test_limited_events_and_alarms_without_a_fault_are_told(result):
    # An event each 20 ms, the profile starts with event 40, its first fault at 1 s: event 90.
    limited, alarms = np.zeros(EVENTS, dtype=bool), np.zeros(EVENTS, dtype=int)
    calm = dataclasses.replace(result.run, limited=limited, alarms=alarms)
    assert dataclasses.replace(result, run=calm).remarks == ()
    limited[[10, 50, 60]] = True
    alarms[[3, 45]], alarms[100] = int(Alarm.MAP), int(Alarm.MAF)
    first, second = dataclasses.replace(result, run=calm).remarks
    assert first.startswith("2 of 160 events (1.25 %) were limited")
    assert first.endswith("first at 0.20 s (event 50)")
    assert second.startswith("2 events with an alarm outside of any fault")
    assert second.endswith("first: map at -0.74 s (event 3)")


def test_losses_are_compared_with_those_of_each_true_cylinder_in_its_air(scenario):
    profile = OperatingProfile(150.0, 1500.0, length=2.4, ambient_pressure=0.7e5)
    factors = (1.0, 1.0, 0.9, 1.0)
    unequal = scenario.replace(
        profile=profile, true={"cylinder_flow_factors": list(factors)}, faults=()
    )

    def least(flow_factor):
        engine = Engine.paper()
        engine = engine.replace(
            ambient_pressure=0.7e5, flow_coefficient=flow_factor * engine.flow_coefficient
        )
        plant = CrankAnglePlant(engine, runner=True, oscillation=True)
        return float(loss_references(plant, ((150e-6, 1500.0),))[0].at(150e-6))

    equal, weak = least(1.0), least(0.9)
    assert weak != pytest.approx(equal, rel=1e-3)
    loss = np.tile([equal, equal, 1.1 * weak, equal], 30)
    speed, demand, ones = np.full(120, 1500.0), np.full(120, 150e-6), np.ones(120)
    run = ClosedLoopResult(
        "thin air", 4, 0, 0.02 * np.arange(120), np.arange(120) % 4 + 1, speed, demand, demand,
        demand, ones, loss, ones, ones, ones, ones, ones, ones > 2, ones > 2,
    )  # fmt: skip
    found = LossExcess(5, 25).measure(ScenarioResult(unequal, run, 0, {}))
    assert found.value == pytest.approx(10.0 * weak / (3.0 * equal + weak))
    assert found.cylinder == 3


def test_origins_that_differ_are_told():
    assert provenance_differences({"a": "1"}, {"a": "1"}) == ()
    assert provenance_differences({"a": "1", "b": "x"}, {"a": "2", "c": "y"}) == (
        "a: 1 stored, 2 now",
        "b: x stored, not told now",
        "c: not told stored, y now",
    )


def test_the_origin_tells_engines_apart(scenario):
    first = run_provenance(scenario.plant)
    second = run_provenance(CrankAnglePlant(scenario.engine, runner=True, oscillation=True))
    (difference,) = provenance_differences(first, second)
    assert difference.startswith("plant_fingerprint: ")


def test_equal_metrics_have_equal_verdicts(result):
    same = [requirement("a", 1.0, SteadyError(5, 10)).evaluate(result) for _ in range(2)]
    assert same[0] == same[1]
