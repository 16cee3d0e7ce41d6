import json
import subprocess
import sys
from pathlib import Path

import pytest

import camless_ctrl
from camless_ctrl.cli import main
from camless_ctrl.report import ChapterResult, Text
from camless_ctrl.requirements import REQUIREMENTS, Requirement, RequirementResult
from plant.mean_value import MeanValuePlant


class Light:
    id, title, concludes = "light", "Light", False
    passed, error = True, None

    def compute(self, context):
        if self.error is not None:
            raise self.error
        limit = Requirement("r", 1.0, "mg", "at most", "test", "Limit")
        found = RequirementResult(limit, 0.5 if self.passed else 1.5)
        return ChapterResult(Text("Found."), [], requirements=[found])


@pytest.fixture
def light(monkeypatch):
    chapter = Light()
    monkeypatch.setattr("camless_ctrl.report.chapters.default_chapters", lambda: (chapter,))
    return chapter


@pytest.fixture(autouse=True)
def _work_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(("passed", "status"), [(True, 0), (False, 1)])
def test_report_exit_status_is_the_verdict(light, tmp_path, capsys, passed, status):
    light.passed = passed
    assert main(["report", "--out", "r", "--json", "x.json"]) == status
    assert (tmp_path / "r" / "index.html").exists()
    written = json.loads((tmp_path / "x.json").read_text())
    assert written == json.loads((tmp_path / "r" / "report.json").read_text())
    assert written["passed"] is passed
    assert f"{int(passed)} of 1 requirements hold" in capsys.readouterr().out


def test_quiet_prints_nothing(light, capsys):
    assert main(["report", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_interrupted_report_leaves_nothing(light, tmp_path, capsys):
    light.error = KeyboardInterrupt()
    assert main(["report", "--out", "r", "--json", "x.json"]) == 130
    assert list(tmp_path.iterdir()) == []
    assert "interrupted" in capsys.readouterr().err


def test_unwritable_folder_names_path_and_remedy(light, tmp_path, capsys):
    (tmp_path / "taken").write_text("")
    light.error = AssertionError("no work may begin")
    assert main(["report", "--out", "taken"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err == ("error: taken is a file, but must be a folder: name another --out folder\n")
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]


def test_defect_is_not_hidden(light):
    light.error = ZeroDivisionError("a defect")
    with pytest.raises(ZeroDivisionError):
        main(["report", "--out", "r"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["repot"], "Unknown command"),
        (["report", "--ot", "x"], "Did you mean --out?"),
        (["map", "--lift-mm", "three"], 'unable to convert "three" into float'),
        (["map", "--lift-mm", "99"], "lift_mm is 99 mm, but must be in"),
        (["map", "--speed-rpm", "-5"], "speed_rpm is -5 rpm"),
        (["map", "--speed-rpm", "nan"], "speed_rpm is nan rpm"),
        (["bench", "--repeats", "0"], "repeats is 0, but must be from 1"),
        (["bench", "--points", "9"], "points is 9, but must be from 10"),
        (["bench", "--map-points", "0"], "map_points is 0, but must be from 1"),
        (["bench", "--json", "no/x.json"], "create it or name another file"),
    ],
)
def test_bad_input_is_one_clear_line_and_status_2(tmp_path, capsys, arguments, said):
    assert main([*arguments]) == 2
    told = capsys.readouterr()
    assert said in told.err
    assert told.err.startswith("error: ")
    assert told.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_map_gives_the_published_charge_and_marks_limited_lifts(tmp_path, capsys):
    arguments = ["map", "--speed-rpm", "1500", "--lift-mm", "3", "8"]
    assert main([*arguments, "--duration-deg", "1", "20", "189", "--json", "m.json"]) == 0
    content = json.loads((tmp_path / "m.json").read_text())
    by = {(p["lift_mm"], p["duration_deg"]): p for p in content["table"]}
    assert len(by) == 6
    # Part I, section 3.1: 473 mg, which the identified engine meets within 1 %
    assert by[3.0, 189.0]["air_charge_mg"] == pytest.approx(473.0, rel=0.01)
    assert by[8.0, 20.0]["delivered_lift_mm"] < 8.0
    assert by[3.0, 1.0]["air_charge_mg"] is None
    assert "*" in capsys.readouterr().out


def test_map_tells_its_size_time_and_error_and_saves_maps_that_can_be_loaded(tmp_path, capsys):
    point = ["--speed-rpm", "1500", "--lift-mm", "3", "--duration-deg", "189"]
    assert main(["map", *point, "--save", "m.nc", "--json", "m.json"]) == 0
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["points"] >= 7000
    assert content["build_seconds"] > 0.0
    error = content["error"]
    assert set(error) == {"charge_rms", "charge_max", "loss_rms", "loss_max", "points"}
    assert error["points"] == 1000
    assert (error["charge_rms"], error["charge_max"]) <= (0.003, 0.015)
    assert {row["name"] for row in content["requirements"]} == {
        name for name in REQUIREMENTS if name.startswith("map-") and "boundary" not in name
    }
    assert "reversal" in capsys.readouterr().out.lower()
    assert main(["map", *point, "--load", "m.nc", "--json", "again.json"]) == 0
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["error"] == error
    assert again["build_seconds"] is None  # nothing was built
    assert main(["map", *point, "--load", "m.json"]) == 2
    assert "does not hold mean-value maps" in capsys.readouterr().err
    assert main(["map", *point, "--load", "missing.nc"]) == 2
    assert "missing.nc" in capsys.readouterr().err
    assert main(["map", *point, "--save", "no/m.nc"]) == 2
    capsys.readouterr()
    assert main(["map", *point, "--save", "same", "--json", "same"]) == 2
    assert "both name same" in capsys.readouterr().err
    assert not (tmp_path / "same").exists()
    assert not (tmp_path / "no").exists()


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from camless_ctrl.cli import main; status = main(['--help']);"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'control', 'casadi', 'jinja2'};"
        "sys.exit(status or ', '.join(sorted(heavy & set(sys.modules))) or 0)"
    )
    root = Path(camless_ctrl.__file__).parents[1]  # importable there, installed or not
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=root
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "report" in done.stdout


@pytest.fixture
def _coarse_maps(monkeypatch):
    """Maps with few nodes: what the loop does with them is its own affair."""
    fit = MeanValuePlant.fit
    coarse = {"tolerance": 0.05, "most_points": 512}
    monkeypatch.setattr(MeanValuePlant, "fit", lambda **given: fit(**coarse, **given))


@pytest.fixture
def _known_design(monkeypatch, narrow_design):
    """A design around 1500 rpm in place of one over all speeds."""
    monkeypatch.setattr(
        "camless_ctrl.controller_design.design_controller", lambda **given: narrow_design
    )


@pytest.mark.usefixtures("_known_design")
def test_simulate_tells_balance_with_adaptation_and_its_lack_without(tmp_path, capsys):
    arguments = ["simulate", "--demand-mg", "170", "250", "--cycles", "80"]
    assert main([*arguments, "--json", "s.json"]) == 0
    assert main([*arguments, "--feedforward-alone"]) == 1
    assert "NOT MET" in capsys.readouterr().out
    content = json.loads((tmp_path / "s.json").read_text())
    assert {row["name"]: row["met"] for row in content["requirements"]} == {
        "cylinder-error": True,
        "imbalance": True,
        "command-lift-lowest": True,
        "command-lift-highest": True,
    }
    assert content["signals"]["charge"]["unit"] == "kg"
    demand = content["signals"]["demand"]["values"]
    assert len(demand) == 2 * 80 * 4
    assert (demand[0], demand[-1]) == pytest.approx((170e-6, 250e-6))


@pytest.mark.usefixtures("_known_design")
def test_simulate_bars_writes_every_figure_of_every_law(tmp_path, capsys, monkeypatch):
    from camless_ctrl import baselines, performance

    measure = performance.measure_performance

    def one_case(controllers, design, **given):
        cases = ["unequal flow -15 %, +-5 %, 1500 rpm"]
        return measure(controllers, design, cases=cases, processes=1, **given)

    monkeypatch.setattr(performance, "measure_performance", one_case)
    monkeypatch.setattr(baselines, "lti_controller", lambda design, **_: design.feedforward_alone())
    assert main(["simulate", "--bars", "--seeds", "1", "--json", "b.json"]) == 0
    rows = json.loads((tmp_path / "b.json").read_text())["cases"]
    assert {row["law"] for row in rows} == {
        baselines.ADAPTIVE,
        baselines.GRADIENT,
        baselines.INTEGRAL,
        baselines.LTI,
        baselines.FEEDFORWARD,
    }
    assert len(rows) == 10
    assert all({"name", "law", "median", "worst", "bar", "met"} <= set(row) for row in rows)
    alone = [row["met"] for row in rows if row["law"] == baselines.FEEDFORWARD]
    assert alone == [False, False]
    assert "controller-bars" in capsys.readouterr().out


STRUCTURED = {"loop-robust-performance", "loop-sound", "loop-tight", "loop-coverage"}
LOOP = {name for name in REQUIREMENTS if name.startswith("loop-")}


@pytest.fixture
def _few_samples(monkeypatch):
    from camless_ctrl import robust_analysis

    whole = robust_analysis.analyse_robustness

    def small(maps, speeds, **options):
        return whole(maps, speeds, samples=2, **options)

    monkeypatch.setattr(robust_analysis, "LTI_SAMPLES", 50)
    monkeypatch.setattr(robust_analysis, "analyse_robustness", small)


@pytest.mark.usefixtures("_coarse_maps")
def test_analyse_of_the_window_loop_reports_the_worst_speed(tmp_path, capsys):
    arguments = ["analyse", "--window", "--speed", "1500", "--no-uncertainty", "--no-robustness"]
    status = main([*arguments, "--json", "a.json"])
    content = json.loads((tmp_path / "a.json").read_text())
    assert not {"uncertainty", "robustness"} & set(content)
    assert content["loop"] == "event windows"
    (speed,) = content["speeds"]
    assert speed["speed_rpm"] == 1500.0
    assert speed["delay_limit_mode"] == 2  # the alternating mode breaks first
    assert len(speed["modes"]) == 3  # of four cylinders: mean, once per cycle, alternating
    assert status == int(not all(row["met"] for row in content["requirements"]))
    assert {row["name"] for row in content["requirements"]} == LOOP - STRUCTURED
    assert "1500 rpm" in capsys.readouterr().out


@pytest.mark.usefixtures("_known_design", "_few_samples")
def test_analyse_writes_the_robustness_of_the_controller(tmp_path, capsys):
    status = main(["analyse", "--speed", "1500", "--no-uncertainty", "--json", "a.json"])
    content = json.loads((tmp_path / "a.json").read_text())
    assert content["loop"] == "designed controller"
    (found,) = content["speeds"]
    # The gains are those of the converged law, far below the window loop's.
    assert 0.0 < found["gains"]["imbalance"] < found["gains"]["mean"] < 0.3
    assert all(mode["held"] is False for mode in found["modes"])
    assert found["stable"] is found["robustly_stable"] is True
    (speed,) = content["robustness"]
    assert speed["speed_rpm"] == 1500.0
    assert speed["stable"] is True
    assert [mode["q"] for mode in speed["modes"]] == [0, 1, 2]
    mu = speed["mu"]
    assert {"rs_upper", "rs_lower", "rp_upper", "rp_lower", "frequency"} <= set(mu)
    assert 0.0 < mu["rs_lower"] <= mu["rs_upper"] * (1.0 + 1e-9)
    assert mu["rs_lower"] <= found["small_gain"] * (1.0 + 1e-9)
    assert speed["worst_case_gain"]["lower"] <= speed["worst_case_gain"]["upper"] * (1.0 + 1e-9)
    assert 0.0 < speed["disk_margin"]["all_cylinders"] <= 2.0
    confirmed = speed["confirmed"]
    assert (confirmed["sampled_lti"], confirmed["sampled_plant"]) == (50, 2)
    assert (confirmed["violations_lti"], confirmed["violations_plant"]) == (0, 0)
    assert confirmed["gain_break"]["simulated"] == pytest.approx(
        confirmed["gain_break"]["predicted"], rel=0.1
    )
    assert {row["name"] for row in content["requirements"]} == LOOP
    assert status == int(not all(row["met"] for row in content["requirements"]))
    assert "the description breaks with" in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("_coarse_maps")
def test_analyse_writes_the_uncertainty(tmp_path, capsys, monkeypatch):
    from plant import OperatingPoint
    from uncertainty import attribute, evaluate_all, quantify

    points = (OperatingPoint(1500.0, 3.0, 120.0),)

    def small(maps, seed, progress):
        return (
            evaluate_all(speeds_rpm=(1500.0,), lifts_mm=(3.0,), durations_deg=(120.0,)),
            quantify(maps=maps, points=points, share=0.8, confidence=0.8, design=8, fresh=20),
            attribute(points=points, samples=64),
        )

    monkeypatch.setattr("camless_ctrl.cli.analyse._quantify", small)
    arguments = ["analyse", "--window", "--speed-rpm", "1500", "--no-robustness"]
    main([*arguments, "--json", "a.json"])
    content = json.loads((tmp_path / "a.json").read_text())
    found = content["uncertainty"]
    assert set(found) == {"deltas", "weights", "coverage", "sobol"}
    assert len(found["deltas"]) == 4 + 2  # the four deltas, their sum, and all at once
    for row in found["deltas"]:
        assert {"name", "worst_charge", "worst_loss", "at"} <= set(row)
        assert row["at"]["speed_rpm"] == 1500.0
    assert len(found["weights"]) == 2 * 3  # charge and MAF, modes 0 to 2
    for row in found["weights"]:
        assert {"channel", "order", "min_ratio", "max_ratio"} <= set(row)
        assert 1.0 <= row["min_ratio"] <= row["max_ratio"]
    coverage = found["coverage"]
    assert (coverage["claimed"], coverage["confidence"]) == (0.8, 0.8)
    assert 0 <= coverage["fresh_inside"] <= coverage["fresh_samples"] == 20
    assert {row["quantity"] for row in found["sobol"]} == {
        "charge",
        "loss",
        "loop_gain",
        "imbalance",
    }
    names = {row["name"] for row in content["requirements"]}
    assert {"uncertainty-weights", "uncertainty-coverage"} < names
    assert "of 20 fresh samples" in capsys.readouterr().out


def test_validate_writes_what_it_prints(tmp_path, capsys):
    assert main(["validate", "--json", "v.json"]) == 0
    content = json.loads((tmp_path / "v.json").read_text())
    assert {"id", "quantity", "published", "computed", "relative_error", "reproduced"} <= set(
        content["published"][0]
    )
    assert {"id", "reproduced", "measured", "why"} <= set(content["claims"][0])
    assert "camless-fig4" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["simulate", "--demand-mg"], "--demand-mg"),
        (["analyse", "--speed-rpm"], "--speed-rpm"),
        (["map", "--speed-rpm"], "--speed-rpm"),
        (["map", "--lift-mm"], "--lift-mm"),
        (["analyse", "--speed-rpm", "9000"], "[750, 6000] rpm"),
        (["simulate", "--speed-rpm", "9000"], "[750, 6000] rpm"),
        (["report", "--seed", "-1"], "--seed is -1"),
        (["map", "--seed", "-1"], "--seed is -1"),
        (["simulate", "--seeds", "0"], "--seeds is 0"),
    ],
)
def test_empty_lists_and_values_out_of_range_are_bad_input(arguments, named, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert named in error
