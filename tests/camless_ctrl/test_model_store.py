import ast
import hashlib
import itertools
from pathlib import Path

import numpy as np
import pytest

import camless_ctrl
import plant
from camless_ctrl import _design_key, model_store
from camless_ctrl._design_key import MODULES, design_folder, design_key, source_digest
from camless_ctrl.closed_loop import simulate
from camless_ctrl.integral_adaptation import IntegralAdaptation
from camless_ctrl.least_loss_motion import FeedforwardOptions
from camless_ctrl.model_store import load_design, save_design, stored_design
from plant import CrankAnglePlant, Engine, MafSensor, ParameterError
from plant.sensors import SensorSet

HERE = Path(camless_ctrl.__file__).parent
RANGE = (1300.0, 1700.0)


def commands(controller):
    """Commands and what was learnt, on 160 events with a weak cylinder and moving speed."""
    engine = Engine.paper().replace(cylinder_flow_factors=(0.85, 1.0, 1.05, 1.0))
    k = np.arange(160)
    run = simulate(
        CrankAnglePlant(engine, runner=True, oscillation=True),
        controller,
        1e-6 * (200.0 + 40.0 * (k // 40)),
        1500.0 + 60.0 * np.sin(0.1 * k),
        seed=3,
    )
    return np.stack([run.lift_mm, run.duration_deg, run.flow_gain, run.duration_offset])


@pytest.fixture(scope="module")
def saved(narrow_design, tmp_path_factory):
    path = tmp_path_factory.mktemp("design") / "narrow.nc"
    save_design(narrow_design, path)
    return path


@pytest.fixture
def makes(monkeypatch, narrow_design):
    """A store that finds the narrow design wherever it would make one; the makings' count."""
    made = []
    monkeypatch.setattr(
        model_store,
        "_coarse_path",
        lambda plant, grid, progress: made.append(grid) or narrow_design.path,
    )
    monkeypatch.setattr(model_store, "_coarse_model", lambda *given: narrow_design.model)
    return made


class Told(list):
    def __call__(self, label, done, total):
        self.append(label)


# -- a file -----------------------------------------------------------------------------------


def test_loaded_design_commands_the_same_bit_for_bit(saved, narrow_design):
    loaded = load_design(saved)
    fresh = commands(narrow_design.controller)
    assert np.ptp(fresh[2]) > 0.0  # something was learnt
    np.testing.assert_array_equal(commands(loaded.controller), fresh)
    assert loaded.engine == narrow_design.engine
    assert loaded.controller.limits == narrow_design.controller.limits


def test_loaded_tables_are_those_that_were_saved(saved, narrow_design):
    loaded = load_design(saved)
    for name in ("maps", "path", "model"):
        ours, theirs = getattr(narrow_design, name), getattr(loaded, name)
        assert theirs.to_dataset().identical(ours.to_dataset())
    speed = np.array([1300.0, 1444.4, 1700.0])
    np.testing.assert_array_equal(
        loaded.path.at(0.37, speed).duration_deg, narrow_design.path.at(0.37, speed).duration_deg
    )


def test_file_is_a_netcdf_file_that_others_read(saved, narrow_design):
    from scipy.io import netcdf_file

    with netcdf_file(saved, mmap=False) as file:
        charge = file.variables["model_charge"]
        assert charge.units == b"kg"
        np.testing.assert_array_equal(charge[:], narrow_design.model.to_dataset()["charge"])
        assert {v[:].dtype.kind for v in file.variables.values()} <= {"f", "i"}


def test_sensors_and_law_are_those_of_the_call(saved):
    maf = MafSensor(time_constant=0.030)
    loaded = load_design(saved, sensors=SensorSet(maf=maf), adaptation=IntegralAdaptation())
    assert isinstance(loaded.controller.adaptation, IntegralAdaptation)
    usual = load_design(saved).controller.estimator
    assert loaded.controller.estimator.maf.time_constant == 0.030
    assert usual.maf.time_constant == MafSensor().time_constant


def test_another_engine_is_refused(saved):
    other = Engine.paper().replace(ambient_pressure=9e4)
    with pytest.raises(ParameterError, match="load it with the engine that it belongs to"):
        load_design(saved, other)


@pytest.mark.parametrize("place", [0.0, 1e-3, 0.3, 0.77, 1.0])
def test_one_changed_bit_anywhere_is_found(saved, tmp_path, place):
    content = bytearray(saved.read_bytes())
    content[int(place * (len(content) - 1))] ^= 4
    file = tmp_path / "bad.nc"
    file.write_bytes(content)
    with pytest.raises(ParameterError, match=r"bad\.nc"):
        load_design(file)


@pytest.mark.parametrize("size", [0, 10, 40_000, -1])
def test_cut_file_is_found(saved, tmp_path, size):
    file = tmp_path / "cut.nc"
    file.write_bytes(saved.read_bytes()[:size])
    with pytest.raises(ParameterError, match="cut short or is another file"):
        load_design(file)


@pytest.mark.parametrize("content", [b"", b"CDF\x01" + 60 * b"\xff", b"no numbers at all"])
def test_foreign_content_with_a_right_checksum_is_no_design(tmp_path, content):
    file = tmp_path / "foreign.nc"
    file.write_bytes(content + b"\nsha256 " + hashlib.sha256(content).hexdigest().encode() + b"\n")
    with pytest.raises(ParameterError, match="does not hold a controller's design"):
        load_design(file)


def test_missing_file_is_told_as_such(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_design(tmp_path / "none.nc")


def test_interrupted_writing_leaves_the_old_file_and_nothing_else(
    saved, narrow_design, tmp_path, monkeypatch
):
    import xarray as xr

    file = tmp_path / "kept.nc"
    file.write_bytes(saved.read_bytes())

    def half(self, path, **given):
        Path(path).write_bytes(b"CDF\x01")
        raise KeyboardInterrupt

    monkeypatch.setattr(xr.Dataset, "to_netcdf", half)
    with pytest.raises(KeyboardInterrupt):
        save_design(narrow_design, file)
    assert [p.name for p in tmp_path.iterdir()] == ["kept.nc"]
    assert file.read_bytes() == saved.read_bytes()


# -- the store --------------------------------------------------------------------------------


def test_second_call_reads_what_the_first_kept(makes, tmp_path, narrow_design):
    told = Told()
    first = stored_design(speed_range_rpm=RANGE, folder=tmp_path / "new" / "folder")
    again = stored_design(speed_range_rpm=RANGE, folder=tmp_path / "new" / "folder", progress=told)
    assert len(makes) == 1
    assert told == ["design read from disk"]
    assert len(list((tmp_path / "new" / "folder").iterdir())) == 1
    np.testing.assert_array_equal(commands(again.controller), commands(first.controller))
    np.testing.assert_array_equal(commands(again.controller), commands(narrow_design.controller))


def test_sensors_share_a_kept_design(makes, tmp_path):
    stored_design(speed_range_rpm=RANGE, folder=tmp_path)
    slow = SensorSet(maf=MafSensor(time_constant=0.030))
    again = stored_design(sensors=slow, speed_range_rpm=RANGE, folder=tmp_path)
    assert again.controller.estimator.maf.time_constant == 0.030
    assert len(makes) == 1


def damaged(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def emptied(file):
    file.write_bytes(b"")


def of_another_key(file):
    """A sound design under a name that is not its own."""
    save_design(load_design(file), file)


@pytest.mark.parametrize("spoil", [damaged, emptied, of_another_key])
def test_bad_file_is_made_anew_and_replaced(makes, tmp_path, spoil):
    stored_design(speed_range_rpm=RANGE, folder=tmp_path)
    (file,) = tmp_path.iterdir()
    sound = file.read_bytes()
    spoil(file)
    assert file.read_bytes() != sound
    told = Told()
    stored_design(speed_range_rpm=RANGE, folder=tmp_path, progress=told)
    assert len(makes) == 2
    assert told[0].startswith("kept design not used, made anew")
    assert file.read_bytes() == sound
    assert list(tmp_path.iterdir()) == [file]


def test_folder_that_cannot_be_made_does_not_stop_the_work(makes, tmp_path):
    (tmp_path / "file").write_text("in the way")
    told = Told()
    found = stored_design(speed_range_rpm=RANGE, folder=tmp_path / "file", progress=told)
    assert found.model is not None
    assert told[-1].startswith("design not kept")
    assert (tmp_path / "file").read_text() == "in the way"


def test_nothing_is_kept_of_code_that_has_changed_since_it_was_loaded(makes, tmp_path, monkeypatch):
    monkeypatch.setattr(model_store, "SOURCES", "what was loaded")
    told = Told()
    stored_design(speed_range_rpm=RANGE, folder=tmp_path, progress=told)
    assert told[-1].startswith("design not kept (the source code has changed")
    assert list(tmp_path.iterdir()) == []


def test_designs_used_longest_ago_go_first(makes, tmp_path, monkeypatch):
    monkeypatch.setattr(model_store, "_KEPT", 2)
    clock = itertools.count(1_000_000)

    def stamp(file, *given):
        """A clock of whole seconds, so that no two files are of the same age."""
        import os

        os.utime(file, (now := next(clock), now))

    monkeypatch.setattr(model_store, "os", type("Os", (), {"utime": stamp}))
    mine = tmp_path / "design of mine.nc"
    mine.write_text("is not touched")
    kept = {}
    for low in (1300.0, 1310.0):
        stored_design(speed_range_rpm=(low, 1700.0), folder=tmp_path)
        (kept[low],) = set(tmp_path.glob("design-*")) - set(kept.values())
        stamp(kept[low])
    stored_design(speed_range_rpm=(1300.0, 1700.0), folder=tmp_path)  # used again
    stored_design(speed_range_rpm=(1320.0, 1700.0), folder=tmp_path)
    assert len(makes) == 3
    assert kept[1300.0].exists()
    assert not kept[1310.0].exists()
    assert len(list(tmp_path.glob("design-*"))) == 2
    assert mine.exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((1700.0, 1300.0), r"speed_range_rpm\[1\] is 1300 rpm"),
        ((1500.0, 1500.0), r"speed_range_rpm\[1\] is 1500 rpm"),
        ((700.0, 1500.0), r"speed_range_rpm\[0\] is 700 rpm"),
        ((1500.0, 6001.0), r"speed_range_rpm\[1\] is 6001 rpm"),
        ((1500.0,), "the lowest and the highest"),
        ((float("nan"), 1500.0), r"speed_range_rpm\[0\] is nan rpm"),
    ],
)
def test_range_that_is_none_is_refused_before_any_work(makes, tmp_path, given, said):
    with pytest.raises(ParameterError, match=said):
        stored_design(speed_range_rpm=given, folder=tmp_path)
    assert makes == []


def test_unequal_cylinders_are_refused_before_any_work(makes, tmp_path):
    engine = Engine.paper().replace(cylinder_flow_factors=(0.9, 1.0, 1.0, 1.0))
    with pytest.raises(ParameterError, match="equal cylinders"):
        stored_design(engine, speed_range_rpm=RANGE, folder=tmp_path)
    assert makes == []


def test_design_of_a_range_is_one_of_that_range(tmp_path):
    design = stored_design(speed_range_rpm=(1480.0, 1520.0), folder=tmp_path)
    assert (design.model.speeds_rpm[0], design.model.speeds_rpm[-1]) == (1480.0, 1520.0)
    assert design.path.certificates.optimal.all()
    assert design.model.node_error < 0.01
    # What the model promises the full plant takes in.
    full = CrankAnglePlant(runner=True, oscillation=True)
    point = design.model.inverse(250e-6, 1500.0)
    cycle = full.steady_cycle(
        1500.0, plant.ValveCommand(point.lift_mm, point.duration_deg), on_infeasible="limit"
    )
    assert cycle.air_charge[0] == pytest.approx(250e-6, rel=0.01)


def test_whole_range_is_the_design_without_a_range(makes, tmp_path, monkeypatch, narrow_design):
    whole = []
    monkeypatch.setattr(
        model_store,
        "design_controller",
        lambda base, **given: whole.append(given["path"]) or narrow_design,
    )
    stored_design(speed_range_rpm=(750.0, 6000.0), folder=tmp_path)
    stored_design(folder=tmp_path)
    assert makes == []
    assert whole[0] is None  # to be made
    assert whole[1] is not None  # read


# -- its key and its folder -------------------------------------------------------------------


def test_key_tells_apart_what_tables_depend_on(monkeypatch):
    def key(engine=None, options=None, grid=None, **plant_options):
        given = {"runner": True, "oscillation": True} | plant_options
        made = CrankAnglePlant(engine or Engine.paper(), **given)
        return design_key(made, options or FeedforwardOptions(), grid)

    keys = [
        key(),
        key(engine=Engine.paper().replace(ambient_pressure=9e4)),
        key(oscillation=False),
        key(options=FeedforwardOptions(least_dwell=1e-3)),
        key(grid={"low_rpm": 1300.0}),
        key(grid={"low_rpm": 1300.0 + 1e-9}),
    ]
    monkeypatch.setattr(_design_key, "SOURCES", "of other code")
    keys.append(key())
    monkeypatch.undo()
    monkeypatch.setattr(_design_key, "version", lambda package: "0.0")
    keys.append(key())
    assert len(set(keys)) == len(keys)
    monkeypatch.undo()
    assert key() == keys[0]


@pytest.mark.parametrize("changed", ["plant/runner.py", "camless_ctrl/_model_fit.py"])
def test_digest_follows_the_source(tmp_path, monkeypatch, changed):
    import shutil

    for package in (plant, camless_ctrl):
        source = Path(package.__file__).parent
        shutil.copytree(source, tmp_path / source.name, ignore=shutil.ignore_patterns("*.pyc"))
    monkeypatch.setattr(_design_key, "files", lambda name: tmp_path / name.partition(".")[0])
    assert source_digest() == _design_key.SOURCES
    with (tmp_path / changed).open("a") as file:
        file.write("\n")
    assert source_digest() != _design_key.SOURCES


def test_digest_covers_all_modules_that_path_and_model_import():
    reached, left = set(), ["optimal_path", "charge_model"]
    while left:
        name = left.pop()
        if name not in reached:
            reached.add(name)
            for node in ast.walk(ast.parse((HERE / f"{name}.py").read_text())):
                if isinstance(node, ast.ImportFrom) and node.level == 1:
                    names = [node.module] if node.module else [a.name for a in node.names]
                    left += [n for n in names if (HERE / f"{n}.py").exists()]
    assert "_model_kernel" in reached  # which is imported late
    assert reached <= set(MODULES)


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"CAMLESS_CACHE": "/a/b", "XDG_CACHE_HOME": "/x"}, Path("/a/b")),
        ({"CAMLESS_CACHE": "off", "XDG_CACHE_HOME": "/x"}, None),
        ({"CAMLESS_CACHE": "", "XDG_CACHE_HOME": "/x"}, Path("/x/camless-ctrl")),
        ({"XDG_CACHE_HOME": "relative", "HOME": "/h"}, Path("/h/.cache/camless-ctrl")),
        ({"HOME": "/h"}, Path("/h/.cache/camless-ctrl")),
    ],
)
def test_folder_is_the_one_that_the_environment_names(monkeypatch, variables, folder):
    for name in ("CAMLESS_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert design_folder() == folder


def test_nothing_is_kept_when_the_environment_says_so(makes, tmp_path, monkeypatch):
    monkeypatch.setenv("CAMLESS_CACHE", "off")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for _ in range(2):
        stored_design(speed_range_rpm=RANGE)
    assert len(makes) == 2
    assert list(tmp_path.iterdir()) == []
