import json
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.io import netcdf_file

from camless_ctrl import replay, scenario_result, scenario_run, shipped
from camless_ctrl.cli import main
from camless_ctrl.cli._common import PIPE_WIDTH
from camless_ctrl.scenario_toml import load_scenario

HEAD = """
name = "{name}"
description = "Demand and speed are held."
seed = 7
[profile]
demand_mg = 250.0
speed_rpm = 1500.0
length = 0.9
[controller]
speed_range_rpm = [1480.0, 1520.0]
"""
REQUIREMENT = """
[[requirements]]
name = "{name}"
kind = "worst-error"
bound = {bound}
source = "{source}"
"""


def scenario(name="steady", bound=50.0, source="the bench", requirement="worst charge"):
    return HEAD.format(name=name) + REQUIREMENT.format(name=requirement, bound=bound, source=source)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def _work_here(tmp_path, monkeypatch, cache):
    """An empty working folder; designs of these few speeds are made once."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAMLESS_CACHE", str(cache))


@pytest.fixture
def idle(monkeypatch):
    """No work may begin."""

    def begun(*given, **named):
        raise AssertionError("work began")

    monkeypatch.setattr(scenario_run, "run_scenario", begun)


def files(folder):
    return sorted(p.name for p in folder.iterdir())


OUTPUTS = ["--plot", "r.png", "--json", "r.json", "--csv", "r.csv", "--netcdf", "r.nc"]


# -- verdict and outputs ----------------------------------------------------------------------


@pytest.mark.parametrize(("bound", "status", "said"), [(50.0, 0, "met"), (1e-6, 1, "NOT MET")])
def test_exit_status_and_table_are_the_verdict(tmp_path, capsys, bound, status, said):
    source = "specification, 12.3"
    name = "largest charge error of any cylinder"
    (tmp_path / "s.toml").write_text(scenario(bound=bound, source=source, requirement=name))
    assert main(["simulate", "s.toml"]) == status
    told = capsys.readouterr().out
    (row,) = [line for line in told.splitlines() if line.strip().startswith("largest")]
    # Whole on one line though this is no terminal.
    for words in (name, f"at most {bound:g} %", source, said, "event", "cylinder"):
        assert words in row
    assert max(map(len, told.splitlines())) <= PIPE_WIDTH
    assert files(tmp_path) == ["s.toml"]


def test_outputs_hold_the_run_that_was_judged(tmp_path):
    (tmp_path / "s.toml").write_text(scenario())
    assert main(["simulate", "s.toml", *OUTPUTS, "--crank-deg", "10", "--quiet"]) == 0
    assert files(tmp_path) == sorted(["s.toml", "r.png", "r.json", "r.csv", "r.nc"])
    stored = scenario_result.load_result(tmp_path / "r.json")
    assert stored.seed == 7
    assert stored.run.time.size == 45  # events of 20 ms in 0.9 s
    head, *rows = (tmp_path / "r.csv").read_text().splitlines()
    place = [name.partition("[")[0] for name in head.split(",")].index("lift")
    lifts = [float(row.split(",")[place]) for row in rows]
    np.testing.assert_array_equal(lifts, stored.run.lift_mm)
    with xr.open_dataset(tmp_path / "r.nc", engine="scipy") as data:
        np.testing.assert_array_equal(data["lift"], stored.run.lift_mm)
        assert any(str(name).startswith("crank") for name in data.variables)
    assert (tmp_path / "r.png").read_bytes().startswith(b"\x89PNG")


def test_without_crank_step_no_signals_over_the_crank_angle_are_kept(tmp_path):
    (tmp_path / "s.toml").write_text(scenario())
    assert main(["simulate", "s.toml", "--netcdf", "r.nc", "-q"]) == 0
    with netcdf_file(tmp_path / "r.nc", mmap=False) as file:
        assert not any(name.startswith("crank") for name in file.variables)


def test_seed_of_the_command_line_is_that_of_the_run(tmp_path):
    (tmp_path / "s.toml").write_text(scenario())
    main(["simulate", "s.toml", "--json", "own.json", "-q"])
    main(["simulate", "s.toml", "--json", "same.json", "--seed", "7", "-q"])
    main(["simulate", "s.toml", "--json", "other.json", "--seed", "8", "-q"])
    own, same, other = (
        scenario_result.load_result(tmp_path / f"{name}.json") for name in ("own", "same", "other")
    )
    assert (own.seed, same.seed, other.seed) == (7, 7, 8)
    np.testing.assert_array_equal(own.run.estimate, same.run.estimate)
    assert np.nanmax(np.abs(own.run.estimate - other.run.estimate)) > 0.0


def test_scenario_without_requirements_says_so(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(HEAD.format(name="bare"))
    assert main(["simulate", "s.toml"]) == 0
    assert capsys.readouterr().out == "bare: states no requirement\n"


# -- which scenario ---------------------------------------------------------------------------


@pytest.fixture
def several(tmp_path):
    """A file with two scenarios, of which the second is not met."""
    met, missed = scenario("good"), scenario("bad", bound=1e-6)
    for table in ("profile", "controller"):
        met, missed = (text.replace(f"[{table}]", f"[scenario.{table}]") for text in (met, missed))
    met, missed = (
        "[[scenario]]" + text.replace("[[requirements]]", "[[scenario.requirements]]")
        for text in (met, missed)
    )
    (tmp_path / "two.toml").write_text(f"{met}\n{missed}")


@pytest.mark.usefixtures("several")
def test_all_scenarios_of_a_file_are_run_or_the_one_that_is_named(tmp_path, capsys):
    assert main(["simulate", "two.toml"]) == 1
    told = capsys.readouterr().out
    assert "good: all 1 met" in told
    assert "bad: 1 of 1 NOT MET" in told
    assert main(["simulate", "two.toml::good", "--csv", "r.csv"]) == 0
    assert "bad" not in capsys.readouterr().out
    assert (tmp_path / "r.csv").exists()


def test_scenarios_of_a_folder_are_run(tmp_path, capsys):
    (tmp_path / "all").mkdir()
    for name in ("a", "b"):
        (tmp_path / "all" / f"{name}.toml").write_text(scenario(f"scenario {name}"))
    assert main(["simulate", "all"]) == 0
    told = capsys.readouterr().out
    assert told.index("scenario a: all 1 met") < told.index("scenario b: all 1 met")


@pytest.fixture
def library(tmp_path_factory, monkeypatch):
    """A library of one scenario in place of the shipped one."""
    file = tmp_path_factory.mktemp("library") / "s.toml"
    file.write_text(scenario("tip-in"))
    known = MappingProxyType({"tip-in": load_scenario(file)})
    monkeypatch.setattr(shipped, "shipped_scenarios", lambda: known)


@pytest.mark.usefixtures("library")
def test_shipped_scenario_is_run_by_its_name_unless_a_file_has_it(tmp_path, capsys):
    assert main(["simulate", "tip-in"]) == 0
    assert "tip-in: all 1 met" in capsys.readouterr().out
    (tmp_path / "tip-in").write_text(scenario("mine"))
    assert main(["simulate", "tip-in"]) == 0
    assert "mine: all 1 met" in capsys.readouterr().out


@pytest.mark.usefixtures("idle")
def test_list_names_and_describes_every_shipped_scenario(capsys):
    assert main(["simulate", "--list"]) == 0
    told = capsys.readouterr().out.splitlines()
    known = shipped.shipped_scenarios()
    assert [line.partition(": ")[0] for line in told] == sorted(known)
    for line in told:
        name, _, description = line.partition(": ")
        assert description.split() == known[name].description.split()


# -- bad input --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["s.toml", "--json", "no/r.json"], "create it or name another file"),
        (["s.toml", "--csv", "folder"], "folder is a folder, but must be a file"),
        (["s.toml", "--csv", "r", "--json", "./r"], "--json and --csv both name r"),
        (["s.toml", "--plot", "r.docx"], "--plot is r.docx, but its name must end with one of"),
        (["s.toml", "--plot", "r"], "--plot is r, but its name must end with one of"),
        (["s.toml", "--crank-deg", "5", "--csv", "r.csv"], "only --netcdf and --json keep them"),
        (["s.toml", "--crank-deg", "0", "--json", "r"], "--crank-deg is 0 deg"),
        (["s.toml", "--seed", "-1"], "--seed is -1"),
        (["s.toml", "--cycles", "20"], "--cycles is given, but a scenario says that itself"),
        (["s.toml", "--demand-mg", "200"], "--demand-mg is given, but a scenario"),
        (["s.toml", "--feedforward-alone"], "--feedforward-alone is given, but a scenario"),
        (["s.toml", "--bars"], "--bars is given, but a scenario"),
        (["s.toml", "--seeds", "2"], "--seeds is given, but a scenario"),
        (["s.toml::other"], "s.toml holds no scenario 'other', but steady"),
        (["two.toml", "--json", "r.json"], "name one as two.toml::good"),
        (["missing.toml"], "missing.toml is neither a file, nor a folder"),
        (["tip-im"], "did you mean tip-in?"),
        (["bad.toml"], "bad.toml:6: [profile] demand_mg"),
        (["folder"], "folder holds no scenario"),
        (["--csv", "r.csv"], "it belongs to a scenario, and none is given"),
        (["--crank-deg", "5"], "it belongs to a scenario, and none is given"),
        (["--list", "s.toml"], "--list takes no other option"),
        (["--list", "--json", "r.json"], "--list takes no other option"),
        (["--replay", "r.json", "s.toml"], "SCENARIO is given, but --replay runs what the file"),
        (["--replay", "r.json", "--seed", "1"], "--seed is given, but --replay runs what the"),
        (["--replay", "missing.json"], "missing.json cannot be read"),
        (["--replay", "s.toml"], "s.toml"),
    ],
)
@pytest.mark.usefixtures("idle", "several", "library")
def test_bad_input_is_one_clear_line_and_status_2(tmp_path, capsys, arguments, said):
    (tmp_path / "s.toml").write_text(scenario())
    (tmp_path / "bad.toml").write_text(scenario().replace("demand_mg = 250.0", "demand_mg = -1.0"))
    (tmp_path / "folder").mkdir()
    before = files(tmp_path)
    assert main(["simulate", *arguments]) == 2
    told = capsys.readouterr()
    assert said in told.err
    assert told.err.startswith("error: ")
    assert (told.err.count("\n"), told.out) == (1, "")
    assert files(tmp_path) == before


TABLE = "time,mg\n0,250\n0.9,260\n"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["s.toml", "--json", "s.toml"], "--json names s.toml"),
        (["s.toml::steady", "--netcdf", "s.toml"], "--netcdf names s.toml"),
        (["s.toml", "--json", "deep/../s.toml"], "--json names"),
        (["s.toml", "--csv", "deep/d.csv"], "--csv names"),
        (["s.toml", "--csv", "link.csv"], "--csv names link.csv"),
        (["s.toml", "--csv", "twin.csv"], "--csv names twin.csv"),
        ([".", "--csv", "deep/d.csv"], "--csv names"),
        (["s.toml", "--json", "new", "--csv", "deep/../new"], "--json and --csv both name"),
        (["--replay", "s.toml", "--json", "s.toml"], "--json is given, but --replay"),
    ],
)
@pytest.mark.usefixtures("idle")
def test_no_output_replaces_a_file_that_is_read(tmp_path, capsys, arguments, named):
    demand = 'demand_mg = { file = "deep/d.csv", column = "mg" }'
    (tmp_path / "deep").mkdir()
    (tmp_path / "s.toml").write_text(scenario().replace("demand_mg = 250.0", demand))
    (tmp_path / "deep" / "d.csv").write_text(TABLE)
    (tmp_path / "link.csv").symlink_to("deep/d.csv")
    (tmp_path / "twin.csv").hardlink_to(tmp_path / "deep" / "d.csv")
    before = {path: path.read_text() for path in tmp_path.rglob("*.*")}
    assert main(["simulate", *arguments]) == 2
    assert named in capsys.readouterr().err
    assert {path: path.read_text() for path in tmp_path.rglob("*.*")} == before


def test_demand_out_of_reach_is_told(tmp_path, capsys):
    # More than twice what the cylinder takes in at ambient pressure.
    (tmp_path / "s.toml").write_text(scenario(bound=99.0).replace("250.0", "1000.0"))
    assert main(["simulate", "s.toml"]) == 0
    told = capsys.readouterr().out
    assert "steady: 45 of 45 events (100 %) were limited" in told
    assert "first at 0.00 s (event 0)" in told


# -- all outputs or none ----------------------------------------------------------------------


@pytest.fixture
def old(tmp_path):
    """Outputs of an earlier run."""
    (tmp_path / "s.toml").write_text(scenario())
    for name in ("r.json", "r.csv"):
        (tmp_path / name).write_text("old")
    return ["r.csv", "r.json", "s.toml"]


def unchanged(folder, names):
    return files(folder) == names and (folder / "r.json").read_text() == "old"


def test_interrupted_run_writes_nothing(tmp_path, capsys, monkeypatch, old):
    reserved = []

    def interrupted(*given, **named):
        reserved.extend(files(tmp_path))
        raise KeyboardInterrupt

    monkeypatch.setattr(scenario_run, "simulate", interrupted)
    assert main(["simulate", "s.toml", *OUTPUTS]) == 130
    assert len(reserved) > len(old)  # the place was taken before the run
    assert unchanged(tmp_path, old)
    told = capsys.readouterr()
    assert (told.out, told.err.count("interrupted; nothing was written")) == ("", 1)


@pytest.mark.parametrize("part", ["to_csv", "to_netcdf", "plot"])
@pytest.mark.parametrize(
    ("error", "status"), [(KeyboardInterrupt(), 130), (OSError(28, "No space left"), 2)]
)
def test_output_that_fails_takes_the_others_with_it(
    tmp_path, capsys, monkeypatch, old, part, error, status
):
    def fails(self, *given):
        raise error

    monkeypatch.setattr(scenario_result.ScenarioResult, part, fails)
    assert main(["simulate", "s.toml", *OUTPUTS]) == status
    assert unchanged(tmp_path, old)
    assert status == 130 or "No space left" in capsys.readouterr().err


def test_outputs_of_several_folders_appear_together(tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text(scenario())
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    arguments = ["simulate", "s.toml", "-q", "--csv", "a/r.csv", "--json", "b/r.json"]
    assert main(arguments) == 0
    assert (files(tmp_path / "a"), files(tmp_path / "b")) == (["r.csv"], ["r.json"])


# -- replay -----------------------------------------------------------------------------------


@pytest.mark.parametrize("option", ["--json", "--netcdf"])
def test_replay_gives_the_same_numbers_bit_for_bit(tmp_path, capsys, option):
    (tmp_path / "s.toml").write_text(scenario())
    assert main(["simulate", "s.toml", option, "r", "--crank-deg", "10", "-q"]) == 0
    before = (tmp_path / "r").read_bytes()
    assert main(["simulate", "--replay", "r"]) == 0
    assert "bit for bit" in capsys.readouterr().out
    assert (tmp_path / "r").read_bytes() == before
    assert files(tmp_path) == ["r", "s.toml"]


def test_replay_tells_a_number_that_is_not_the_same(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(scenario())
    assert main(["simulate", "s.toml", "--json", "r.json", "-q"]) == 0
    content = json.loads((tmp_path / "r.json").read_text())
    # Another seed in the file: noise is not what it was.
    content["seed"] = content["seed"] + 1
    (tmp_path / "r.json").write_text(json.dumps(content))
    assert main(["simulate", "--replay", "r.json"]) == 1
    told = capsys.readouterr().out
    assert "DIFFER" in told
    assert "estimate" in told


@pytest.mark.parametrize(("same", "status"), [(True, 0), (False, 1)])
def test_replay_exit_status_is_whether_it_is_the_same(monkeypatch, capsys, same, status):
    class Found(SimpleNamespace):
        def __str__(self):
            return "what was found [x]"

    monkeypatch.setattr(replay, "replay_result", lambda path: Found(same=same))
    assert main(["simulate", "--replay", "r.json"]) == status
    assert capsys.readouterr().out == "what was found [x]\n"
