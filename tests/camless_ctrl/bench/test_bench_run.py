"""A tiny run of the benchmark: what it writes and prints, not how fast anything is."""

import json
import math
from types import SimpleNamespace

import pytest

from camless_ctrl.bench import BenchOptions, BenchPoint, loop_timing, run_bench
from camless_ctrl.bench._explicit_peers import RungeKutta4
from camless_ctrl.bench._scipy_peers import ScipyOdeint
from camless_ctrl.cli import main
from camless_ctrl.controller import AirChargeController
from camless_ctrl.jsonable import to_json
from plant import ParameterError, PlantRun, ValveCommand
from plant.sensor_run import DurationRun, SensorRun

MISSING = {"a solver": "not installed: pip install a-solver"}


@pytest.fixture(scope="module")
def few_peers():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "camless_ctrl.bench.run.installed_peers",
            lambda: ([ScipyOdeint(), RungeKutta4()], MISSING),
        )
        patch.setattr("camless_ctrl.bench.scaling.TIMED_BATCH", 0.01)
        yield


@pytest.fixture(scope="module")
def result(few_peers):
    options = BenchOptions(
        repeats=1, map_points=3, matching_points=1, batch_points=20, processes=1, seed=3
    )
    return run_bench(options, timed=(BenchPoint(3000.0, ValveCommand(3.0, 189.0)),))


def test_json_has_the_stated_form(result):
    content = json.loads(to_json(result.as_dict()))
    kernel = content["kernel"]
    assert kernel["points"] == 3
    assert kernel["us_per_cycle"] == max(row["us_per_cycle"] for row in kernel["nominal"]) > 0.0
    assert {row["speed_rpm"] for row in kernel["nominal"]} >= {750.0, 6000.0}
    assert {row["n_cylinders"] for row in kernel["nominal"]} == {4}
    assert all(row["runner"] for row in kernel["nominal"])
    for name, bar in (("charge", 2e-4), ("loss", 1e-3)):
        errors = [row[f"{name}_error"] for row in kernel["map"]]
        assert kernel[f"max_{name}_error"] == max(errors)
        assert 0.0 < max(errors) < bar
    assert [peer["name"] for peer in content["peers"]] == [
        "scipy LSODA (odeint)",
        "Runge-Kutta 4 (Numba)",
    ]
    for peer in content["peers"]:
        assert {"name", "us_per_cycle", "charge_error", "ratio"} <= set(peer)
        (own,) = content["kernel_us_at_peer_points"]
        assert peer["ratio"] == pytest.approx(peer["us_per_cycle"] / own)
        assert peer["accuracy_matched"]
        assert peer["charge_error"] <= 2e-4
    assert content["not_installed"] == MISSING
    threads = content["threads"]
    one, two = threads["points_per_second"]
    assert threads["efficiency"] == pytest.approx(two / one / 2.0)
    loop = content["closed_loop"]
    parts = [loop[f"{name}_us"] for name in ("plant", "sensors", "controller", "rest")]
    assert min(parts) > 0.0
    assert loop["event_us"] == pytest.approx(sum(parts))
    # An event of four cylinders at 1500 rpm is 180 deg at 9000 deg/s.
    assert loop["times_real"] == pytest.approx(20e3 / loop["event_us"])
    assert set(content["startup"]) >= {"import_s", "first_cycle_s"}
    assert content["scaling"]["points"] == [10, 20]
    assert content["scaling"]["cylinders"] == list(range(1, 13))
    assert content["reference"]["charge_error"] < 1e-6


def test_goals_are_shown_met_or_missed(result):
    goals = {found.requirement.name: found for found in result.goals}
    bounds = {
        "kernel-time": 40.0,
        "kernel-charge": 0.02,
        "kernel-loss": 0.1,
        "over-scipy-lsoda": 100.0,
        "over-best-compiled": 10.0,
        "thread-efficiency": 0.85,
        "import": 0.5,
        "first-cycle": 0.5,
        "controller-update": 50.0,
        "closed-loop-speed": 20.0,
    }
    assert {name: found.requirement.bound for name, found in goals.items()} == bounds
    assert goals["kernel-charge"].value == pytest.approx(
        100.0 * result.survey.worst_charge.charge_error
    )
    assert goals["over-best-compiled"].note == "Runge-Kutta 4 (Numba)"
    assert not any(math.isnan(found.value) for found in goals.values())
    text = str(result)
    for found in result.goals:
        assert f"{found.requirement}: " in text


def test_worst_point_is_named(result):
    worst = max(result.survey.figures, key=lambda found: found.charge_error)
    assert str(worst.point) in str(result)


def test_time_of_the_loop_is_put_down_to_the_part_that_takes_it(monkeypatch):
    clock = 0.0

    def costly(owner, method, seconds):
        """Let a call take as long by a clock that stands still otherwise."""
        call = getattr(owner, method)

        def taking(*given, **named):
            nonlocal clock
            clock += seconds
            return call(*given, **named)

        monkeypatch.setattr(owner, method, taking)

    monkeypatch.setattr(loop_timing, "time", SimpleNamespace(perf_counter=lambda: clock))
    costly(PlantRun, "step_event", 2e-3)
    costly(SensorRun, "observe", 5e-4)  # of air flow and of pressure
    costly(DurationRun, "measure", 1e-3)
    costly(AirChargeController, "step", 4e-3)
    found = loop_timing.measure_loop(1)
    assert found.plant_us == pytest.approx(2000.0)
    assert found.sensors_us == pytest.approx(2000.0)
    assert found.controller_us == pytest.approx(4000.0)
    assert found.rest_us == pytest.approx(0.0, abs=1e-3)
    assert found.times_real == pytest.approx(20.0 / 8.0)


@pytest.mark.usefixtures("few_peers")
def test_command_prints_tables_and_ends_with_status_0(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["bench", "--quick", "--map-points", "1", "--points", "10", "--repeats", "1"]
    assert main([*arguments, "--json", "b.json"]) == 0
    told = capsys.readouterr().out
    wanted = (
        "this kernel",
        "scipy LSODA",
        "x real time",
        "a solver: not installed",
        "parallel efficiency",
        "import plant",
        "12 cylinders",
        "Closed loop of 4 cylinders at 1500 rpm",
        "closed-loop-speed",
        "kernel-time",
    )
    for words in wanted:
        assert words in told
    assert json.loads((tmp_path / "b.json").read_text())["kernel"]["points"] == 1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"repeats": 0}, "repeats is 0"),
        ({"map_points": 0}, "map_points is 0"),
        ({"map_points": 3, "matching_points": 4}, "matching_points is 4, but must be from 0 to 3"),
        ({"batch_points": 9}, "points is 9, but must be from 10"),
        ({"processes": 0}, "processes is 0"),
    ],
)
def test_options_out_of_range_are_refused(given, said):
    with pytest.raises(ParameterError, match=said):
        BenchOptions(**given)
