import json
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

PROJECT = Path(__file__).with_name("plugin_project")

SCENARIO = """
name = "{name}"
description = "one event is off by {seed} %"
seed = {seed}
[profile]
length = 1.0
speed_rpm = 1500.0
demand_mg = 200.0
[[requirements]]
name = "worst"
kind = "worst-error"
bound = 2.0
source = "test"
[[requirements]]
name = "on average"
kind = "worst-error"
mean_events = 40
bound = 2.0
source = "test"
"""
# At 1500 rpm four cylinders have an event each 20 ms: event 17 is at 0.34 s, of cylinder 2.
WORST = "worst: 3 % at 0.34 s (event 17, cylinder 2)"


@pytest.fixture
def project(tmp_path):
    shutil.copy(PROJECT / "stand_in.py", tmp_path / "conftest.py")
    folder = tmp_path / "scenarios"
    folder.mkdir()
    (folder / "good.toml").write_text(SCENARIO.format(name="good", seed=1))
    (folder / "bad.toml").write_text(SCENARIO.format(name="bad", seed=3))
    return tmp_path


# pytest rewrites the asserts of packages with plugins, which takes seconds where nothing is kept.
QUICK = ("--assert=plain", "-p", "no:hypothesispytest")


def run(folder, *arguments, options=QUICK, seconds=120, **environment):
    keep = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST", "COV"))}
    return subprocess.run(
        [sys.executable, "-m", "pytest", "--color=no", *options, *arguments],
        cwd=folder,
        env=keep | {"MPLBACKEND": "agg", "COLUMNS": "200"} | environment,
        capture_output=True,
        text=True,
        timeout=seconds,
    )


COLLECT = """
import contextlib, io, json, sys
import pytest

for arguments in json.load(sys.stdin):
    with contextlib.redirect_stdout(io.StringIO()) as said:
        pytest.main([*"--collect-only -q --assert=plain -p no:cacheprovider".split(), *arguments])
    print(json.dumps(sorted(line for line in said.getvalue().splitlines() if "::" in line)))
"""


def collected(folder, cases):
    """Ids that pytest collects for each list of arguments, all in one process."""
    done = subprocess.run(
        [sys.executable, "-c", COLLECT],
        cwd=folder,
        input=json.dumps(cases),
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def lines(path):
    return path.read_text().splitlines() if path.exists() else []


def test_a_run_without_options_loads_nothing_of_the_package(tmp_path):
    (tmp_path / "test_empty.py").write_text(
        "import sys\n"
        "HEAVY = {'numpy', 'numba', 'scipy', 'matplotlib', 'xarray', 'casadi', 'jinja2'}\n"
        "def test_nothing(request):\n"
        "    assert request.config.pluginmanager.hasplugin('camless')\n"
        "    assert not HEAVY & set(sys.modules)\n"
        "    ours = {m for m in sys.modules if m.startswith(('plant', 'uncertainty', 'camless'))}\n"
        "    assert ours == {'camless_ctrl', 'camless_ctrl.pytest_plugin'}\n"
    )
    done = run(tmp_path, options=())
    assert done.returncode == 0, done.stdout + done.stderr
    off = run(tmp_path, "-p", "no:camless", "--deselect", "test_empty.py::test_nothing")
    assert off.returncode == 5, off.stdout  # no test left
    unknown = run(tmp_path, "-p", "no:camless", "--camless-report", "report")
    assert unknown.returncode == 4
    assert "unrecognized arguments: --camless-report" in unknown.stderr


def test_what_cannot_be_run_is_an_error_of_collection(project):
    text = (project / "scenarios" / "good.toml").read_text()
    (project / "scenarios" / "bad.toml").write_text(text.replace("1500.0", "700.0"))
    late = text + '[[faults]]\nkind = "maf-nan"\nstart = 3.0\n'
    (project / "scenarios" / "late.toml").write_text(late)
    done = run(project, "--camless-scenarios", "scenarios")
    assert done.returncode == 2
    assert "2 errors during collection" in done.stdout
    for place in ("bad.toml:7: [profile] speed_rpm", "late.toml:22: [[faults]] 1 start"):
        assert place in done.stdout
    assert not (project / "runs.txt").exists()


def test_every_requirement_of_a_file_is_a_test_and_its_scenario_runs_once(project):
    done = run(project, "-v", "--camless-scenarios", "scenarios", "--junitxml", "junit.xml")
    assert done.returncode == 1
    assert "1 failed, 3 passed" in done.stdout
    for part in ("good::worst PASSED", "bad::worst FAILED", "bad::on average PASSED"):
        assert f"scenarios/{part.split('::')[0]}.toml::{part}" in done.stdout
    assert sorted(line.split()[0] for line in lines(project / "runs.txt")) == ["bad", "good"]
    assert len(lines(project / "designs.txt")) == 1  # one engine
    # The failure tells number, instant, bound and picture, and shows no line of Python.
    assert WORST in done.stdout
    assert "must be at most 2 %" in done.stdout
    assert "Traceback" not in done.stdout
    assert ".py:" not in done.stdout
    (plot,) = (project / ".pytest_cache" / "d" / "camless-plots").iterdir()
    assert str(plot) in done.stdout
    assert plot.read_bytes()[1:4] == b"PNG"
    # Machines find the numbers in the JUnit file.
    (case,) = (
        case
        for case in ET.parse(project / "junit.xml").iter("testcase")
        if case.find("failure") is not None
    )
    told = {p.get("name"): p.get("value") for p in case.iter("property")}
    assert float(told["value"]) == pytest.approx(3.0)
    assert (float(told["bound"]), told["unit"]) == (2.0, "%")


def test_what_is_collected(project):
    (project / "test_own.py").write_text("def test_own(): pass\n")
    (project / "scenarios" / "test_beside.py").write_text("def test_beside(): pass\n")
    (project / "elsewhere").mkdir()
    more = SCENARIO.format(name="more", seed=0).split("[[requirements]]")[0]
    (project / "elsewhere" / "more.toml").write_text(more)

    of = {
        name: [f"scenarios/{name}.toml::{name}::{r}" for r in ("on average", "worst")]
        for name in ("bad", "good")
    }
    both = [*of["bad"], *of["good"]]
    own, beside = "test_own.py::test_own", "scenarios/test_beside.py::test_beside"
    asked = ("--camless-scenarios", "scenarios")
    expected = {
        (): [beside, own],  # nobody asked
        asked: [*both, beside, own],
        ("test_own.py", *asked): [*both, own],
        ("scenarios", *asked): [*both, beside],
        ("scenarios/good.toml", *asked): of["good"],
        (of["bad"][1], *asked): [of["bad"][1]],
    }
    # A file may be named; a scenario that requires nothing is run all the same.
    (project / "own.ini").write_text("[pytest]\ncamless_scenarios = elsewhere/more.toml\n")
    ini = ("-c", "own.ini")
    expected |= {
        (*ini, "test_own.py", "--camless-scenarios", "scenarios/good.toml"): [*of["good"], own],
        ini: [beside, "elsewhere/more.toml::more::runs", own],
        (*ini, "test_own.py"): [own],
    }
    assert collected(project, list(expected)) == [sorted(found) for found in expected.values()]


def test_a_file_that_cannot_be_read_is_an_error_that_tells_where(project):
    wrong = SCENARIO.format(name="wrong", seed=1).replace("worst-error", "wurst-error", 1)
    (project / "scenarios" / "wrong.toml").write_text(wrong)
    (project / "scenarios" / "runs.toml").write_text(SCENARIO.format(name="impossible", seed=1))
    options = ("--camless-scenarios", "scenarios", "--camless-report", "out")
    done = run(project, *options, "--continue-on-collection-errors", "-rE", "-k", "impossible")
    assert done.returncode == 1
    line = wrong.splitlines().index('kind = "wurst-error"') + 1
    assert f"wrong.toml:{line}: " in done.stdout
    assert "'wurst-error'" in done.stdout
    assert "did you mean 'worst-error'?" in done.stdout
    # One that cannot be run fails with what the run said, once for each requirement.
    text = "scenario impossible: speed_rpm is 9000 rpm"
    assert done.stdout.count(text) == 2
    assert [line.split()[0] for line in lines(project / "runs.txt")].count("impossible") == 1
    assert "Traceback" not in done.stdout
    assert "1 error" in done.stdout
    report = json.loads((project / "out" / "report.json").read_text())
    (found,) = report["requirements"]
    assert (found["name"], found["met"], found["value"]) == ("impossible: runs", False, None)
    assert "9000 rpm" in found["note"]
    for place, text in (("nowhere", "nowhere does not exist"), (".", "has no .toml file")):
        refused = run(project, "--noconftest", "--camless-scenarios", place)
        assert refused.returncode == 4
        assert text in refused.stderr


def test_fixtures_and_the_report_of_what_was_run(project):
    shutil.copy(PROJECT / "own.py", project / "test_own.py")
    done = run(
        project,
        *("--camless-scenarios", "scenarios", "--camless-report", "out", "--camless-plots", "p"),
        "-v",
        options=(),
    )
    assert done.returncode == 1
    assert "test_own.py::test_not_met FAILED" in done.stdout
    assert "2 failed, 9 passed" in done.stdout
    assert (
        "tight: 1 % at 0.34 s (event 17, cylinder 2) [+1 %], but must be at most 0.5 %"
        in done.stdout
    )
    assert len(list((project / "p").glob("*.png"))) == 3  # bad, tight with seeds 1 and 4
    report = json.loads((project / "out" / "report.json").read_text())
    (chapter,) = (c for c in report["chapters"] if c["id"] == "scenarios")
    (table,) = (t for t in chapter["tables"] if t["id"] == "verdicts")
    found = {(row[0], row[1]): (row[2], row[3], row[6], row[7]) for row in table["rows"]}
    time = pytest.approx(0.34)
    assert found == {
        ("bad", "worst"): ("at most 2", pytest.approx(3.0), time, False),
        ("bad", "on average"): ("at most 2", pytest.approx(3.0 / 40), pytest.approx(0.4), True),
        ("good", "worst"): ("at most 2", pytest.approx(1.0), time, True),
        ("good", "on average"): ("at most 2", pytest.approx(1.0 / 40), pytest.approx(0.4), True),
        ("good", "loose"): ("at most 5", pytest.approx(1.0), time, True),
        ("good", "tight"): ("at most 0.5", pytest.approx(1.0), time, False),
        ("good, seed 0", "worst"): ("at most 2", 0.0, pytest.approx(0.0), True),
        ("good, seed 0", "on average"): ("at most 2", 0.0, pytest.approx(0.4), True),
        ("good, seed 4", "tight"): ("at most 0.5", pytest.approx(4.0), time, False),
    }
    assert report["passed"] is False
    assert sum(r["met"] for r in report["requirements"]) == 6
    assert [figure["id"] for figure in chapter["figures"]] == [f"run-{k}" for k in range(4)]
    (tests,) = (t for t in chapter["tables"] if t["id"] == "tests")
    assert ["good", "test_own.py::test_met"] in tests["rows"]
    page = (project / "out" / "index.html").read_text()
    assert "one event is off by 3 %" in page
    assert page.count("<svg") == 4
    assert "6 of 9 requirements hold" in done.stdout
    assert report["command"].startswith("pytest ")


def test_workers_report_to_one_place(project):
    (project / "tmp").mkdir()
    options = ("--camless-scenarios", "scenarios", "--camless-report", "out")
    done = run(project, "-n", "2", "--dist", "loadscope", *options, TMPDIR=str(project / "tmp"))
    assert done.returncode == 1
    assert WORST in done.stdout
    ran = [line.split() for line in lines(project / "runs.txt")]
    assert sorted(name for name, _ in ran) == ["bad", "good"]  # each once
    report = json.loads((project / "out" / "report.json").read_text())
    names = [found["name"] for found in report["requirements"]]
    assert sorted(names) == sorted(
        f"{scenario}: {which}" for scenario in ("bad", "good") for which in ("worst", "on average")
    )
    assert "3 of 4 requirements hold" in done.stdout
    assert not list((project / "tmp").glob("camless-*"))  # what was passed on is gone


def test_a_report_never_changes_the_exit_status(project):
    (project / "test_fails.py").write_text(
        "def test_it(run_scenario):\n"
        "    assert not run_scenario('scenarios/bad.toml').meets('worst')\n"
    )
    done = run(project, "test_fails.py", "--camless-report", "out")
    assert done.returncode == 0  # that it fails is what the test asks for
    assert "0 of 1 requirements hold" in done.stdout
    (project / "test_nothing.py").write_text("def test_nothing(): pass\n")
    nothing = run(project, "--noconftest", "test_nothing.py", "--camless-report", "none")
    assert nothing.returncode == 0
    assert "no scenario was run, so no report was written" in nothing.stdout
    assert not (project / "none").exists()
    refused = run(project, "--noconftest", "--camless-report", "conftest.py")
    assert refused.returncode == 4
    assert "conftest.py is a file, but must be a folder" in refused.stderr


def test_the_example_project_runs_from_outside(tmp_path):
    source = Path(__file__).parents[2] / "docs" / "example_project"
    project = shutil.copytree(source, tmp_path / "project", ignore=shutil.ignore_patterns(".*"))
    cache = str(tmp_path / "designs")
    # Seconds; minutes where the plant has never been compiled.
    done = run(project, "--camless-report", "report", seconds=600, CAMLESS_CACHE=cache)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads((project / "report" / "report.json").read_text())
    assert report["passed"] is True
    assert report["engine"]["n_cylinders"] == 3
    found = {requirement["name"] for requirement in report["requirements"]}
    assert {"tip-in: steady error", "tip-in: even durations"} <= found
    assert "tip-in without flow sensor: flow sensor missed" in found
